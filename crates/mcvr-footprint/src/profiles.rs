//! The profiles of footprints: the projection of a tent onto each axis of the image, integrated over pixels, by width and by offset
//! below a pixel.

use crate::projection::Projection;
use crate::shape::Shape;

/// A row of pixels of a footprint's profile.
pub(crate) trait Row: Copy + Send + Sync + 'static {
    /// Pixels.
    const SIDE: usize;
    /// All zeros.
    const ZERO: Self;
    /// The pixels.
    fn pixels(&self) -> &[f32];
    /// The pixels.
    fn pixels_mut(&mut self) -> &mut [f32];
}

impl<const N: usize> Row for [f32; N] {
    const SIDE: usize = N;
    const ZERO: Self = [0.0; N];
    #[inline(always)]
    fn pixels(&self) -> &[f32] {
        self
    }
    #[inline(always)]
    fn pixels_mut(&mut self) -> &mut [f32] {
        self
    }
}

/// Offsets below a pixel, where there are many widths and where there are few: voxels in a row along the view share theirs.
const OFFSETS: [usize; 2] = [256, 4096];
/// Few widths.
const FEW: u32 = 8;

/// Most widths along an axis of the image.
const MOST_WIDTHS: u32 = 128;
/// Bits of a float that do not tell a width: 64 widths from 1 to 2.
const FINEST: u32 = 17;
/// A footprint less wide than this (a knot distance in pixels) is a point.
const LEAST: f32 = 1.0 / 64.0;

/// Knot distances beyond which a side's pixels do not hold the footprint.
pub(crate) fn widest(side: usize) -> f32 {
    (0.5 * side as f32 - 0.5) / 1.75
}

/// Widths along one axis of the image: runs of floats that share their leading bits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Widths {
    /// Bits of the first run's first float.
    pub from: i32,
    /// Bits that do not tell runs apart.
    pub shift: u32,
    /// Runs.
    pub many: u32,
    /// Where they begin among the rows.
    pub first: u32,
}

impl Widths {
    fn new([least, most]: [f32; 2], limit: f32, first: u32) -> Self {
        let least = least.clamp(LEAST, limit);
        let most = most.clamp(least, limit);
        let (mut shift, bits) = (FINEST, [least, most].map(f32::to_bits));
        while (bits[1] - bits[0]) >> shift >= MOST_WIDTHS {
            shift += 1;
        }
        Self { from: bits[0] as i32, shift, many: ((bits[1] - bits[0]) >> shift) + 1, first }
    }

    /// The width that stands for a run: the middle of it, or of the part up to `most`.
    fn middle(&self, n: u32, most: f32) -> f32 {
        let low = self.from as u32 + (n << self.shift);
        let high = (low + (1 << self.shift)).min(most.to_bits().max(low));
        0.5 * (f32::from_bits(low) + f32::from_bits(high))
    }
}

/// Profiles by axis, width and offset.
pub(crate) struct Profiles<R> {
    pub rows: Vec<R>,
    pub widths: [Widths; 2],
    /// Offsets below a pixel.
    pub offsets: usize,
}

impl<R: Row> Profiles<R> {
    pub fn new(projection: &Projection, shapes: &[Shape; 2]) -> Self {
        let limit = widest(R::SIDE);
        let x = Widths::new(projection.spans[0], limit, 0);
        let y = Widths::new(projection.spans[1], limit, x.many);
        let offsets = OFFSETS[usize::from(x.many + y.many <= FEW)];
        let mut rows = vec![R::ZERO; (x.many + y.many) as usize * offsets];
        let mut edges = vec![0f32; (R::SIDE + 1) * offsets];
        for (axis, widths) in [x, y].into_iter().enumerate() {
            for n in 0..widths.many {
                let knot = widths.middle(n, projection.spans[axis][1].min(limit));
                fill(&shapes[axis], knot, &mut edges, &mut rows[(widths.first + n) as usize * offsets..][..offsets]);
            }
        }
        Self { rows, widths: [x, y], offsets }
    }
}

/// The profiles of one width.
fn fill<R: Row>(shape: &Shape, knot: f32, edges: &mut [f32], rows: &mut [R]) {
    let (side, offsets) = (R::SIDE, rows.len());
    let last = (side + 1) * offsets - 1;
    let inverse = 1.0 / knot;
    // Integrals up to the edges of pixels, which lie at all places an offset apart; the second half mirrors the first.
    for n in 0..=last / 2 {
        let x = (n as f32 + 0.5) / offsets as f32 - 0.5 * (side + 1) as f32;
        edges[n] = shape.integral(x * inverse);
        edges[last - n] = 1.0 - edges[n];
    }
    for (offset, row) in rows.iter_mut().enumerate() {
        // Edge `n` lies `n - side / 2 + 1/2 - f` pixels from the centre, `f` the offset; the place of the first is the last of all.
        let from = offsets - 1 - offset;
        let pixels = row.pixels_mut();
        let mut sum = 0.0;
        for n in 0..side {
            pixels[n] = edges[from + (n + 1) * offsets] - edges[from + n * offsets];
            sum += pixels[n];
        }
        // What lies beyond the last pixels is shared out.
        let whole = 1.0 / sum;
        for p in pixels.iter_mut() {
            *p *= whole;
        }
    }
}
