//! Projecting voxels by the batch.

use mcvr_volume::vectorised;

use crate::profiles::Widths;
use crate::projection::Projection;
use crate::refine::Tap;

/// Voxels projected at a time.
pub(crate) const BATCH: usize = 256;

/// Some projected voxels: first pixel, profiles along x and y, amount in units.
pub(crate) struct Batch {
    pub start: [u32; BATCH],
    pub across: [u32; BATCH],
    pub down: [u32; BATCH],
    pub amount: [f32; BATCH],
    /// Voxels whose footprints are too large for profiles; their amount is 0.
    pub large: [u32; BATCH],
}

impl Batch {
    pub fn new() -> Box<Self> {
        Box::new(Self {
            start: [0; BATCH],
            across: [0; BATCH],
            down: [0; BATCH],
            amount: [0.0; BATCH],
            large: [0; BATCH],
        })
    }
}

/// What projecting needs to know.
pub(crate) struct Frame {
    pub projection: Projection,
    pub widths: [Widths; 2],
    /// Offsets below a pixel.
    pub offsets: u32,
    /// Knot distances that profiles hold.
    pub widest: f32,
    /// Pixels of the image with its margins, of the margin, and of a footprint's side.
    pub width: f32,
    pub height: f32,
    pub side: f32,
    /// Largest reciprocal depth that counts.
    pub nearest: f32,
    /// Whether amounts have the factor of `line`.
    pub line: bool,
}

/// The profile of a width, below the axis' first.
#[inline(always)]
fn run(widths: &Widths, width: f32) -> i32 {
    ((width.to_bits() as i32 - widths.from) >> widths.shift).max(0).min(widths.many as i32 - 1)
}

/// Projects up to a batch of voxels at index coordinates from the grid's middle. Returns how many footprints there are, and how many
/// are too large for profiles.
#[inline(always)]
fn project(frame: &Frame, at: [&[f32]; 3], weight: &[f32], tap: &Tap, batch: &mut Batch) -> [u32; 2] {
    let many = weight.len().min(BATCH);
    let (x, y, z, weight) = (&at[0][..many], &at[1][..many], &at[2][..many], &weight[..many]);
    let (start, across, large) = (&mut batch.start[..many], &mut batch.across[..many], &mut batch.large[..many]);
    let (down, amount) = (&mut batch.down[..many], &mut batch.amount[..many]);
    let [dx, dy, dz] = tap.at;
    let first = 0.5 * frame.side + 1.0;
    let (right, bottom) = (frame.width - frame.side, frame.height - frame.side);
    let (wx, wy) = (frame.widths[0], frame.widths[1]);
    let offsets = frame.offsets as f32;
    let (mut seen, mut too_large) = (0u32, 0u32);
    for n in 0..many {
        let [px, py, near, wide, high] = frame.projection.at([x[n] + dx, y[n] + dy, z[n] + dz]);
        // The footprint's first pixel is half of it less one before the pixel whose centre is at or before the position.
        let (gx, gy) = (px - 0.5, py - 0.5);
        let (ix, iy) = (gx.floor(), gy.floor());
        let (sx, sy) = (ix + first, iy + first);
        let counts = (near > 0.0) & (near <= frame.nearest);
        let fits = (wide <= frame.widest) & (high <= frame.widest);
        let inside = counts & fits & (sx >= 0.0) & (sy >= 0.0) & (sx <= right) & (sy <= bottom);
        let (ox, oy) = (((gx - ix) * offsets).min(offsets - 1.0), ((gy - iy) * offsets).min(offsets - 1.0));
        let factor = if frame.line { frame.projection.line_factor(px, py, near) } else { 1.0 };
        let (sx, sy) = (if inside { sx } else { 0.0 }, if inside { sy } else { 0.0 });
        let (ox, oy) = (if inside { ox } else { 0.0 }, if inside { oy } else { 0.0 });
        amount[n] = if inside { weight[n] * tap.share * factor } else { 0.0 };
        let (w, h) = (run(&wx, wide) as u32 + wx.first, run(&wy, high) as u32 + wy.first);
        let left_out = u32::from(counts & !fits);
        large[n] = left_out;
        too_large += left_out;
        seen += u32::from(inside);
        // SAFETY: all four lie between 0 and what `i32` holds: no side of an image has more than 2^30 pixels, and its margins add
        // less than 2^7.
        unsafe {
            start[n] = sy.to_int_unchecked::<i32>() as u32 * frame.width as u32 + sx.to_int_unchecked::<i32>() as u32;
            across[n] = w * frame.offsets + ox.to_int_unchecked::<i32>() as u32;
            down[n] = h * frame.offsets + oy.to_int_unchecked::<i32>() as u32;
        }
    }
    [seen, too_large]
}

vectorised! {
    /// Projects up to a batch of voxels.
    pub(crate) fn projected(frame: &Frame, at: [&[f32]; 3], weight: &[f32], tap: &Tap, batch: &mut Batch) -> [u32; 2] = project
}
