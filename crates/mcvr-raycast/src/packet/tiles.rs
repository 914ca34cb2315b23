//! Where along the rays of a tile of pixels there can be density: occupied bricks, seen from the camera.
//!
//! Every occupied brick marks the depths that it covers in the tiles that its outline meets. Rays then visit the marked depths of
//! their tile only; everything is rounded outwards, so no density is missed. The map costs a few microseconds per thousand
//! bricks, whatever the number of rays.

use std::ops::Range;

use mcvr_scene::{Camera, Occupancy};
use mcvr_volume::{Grid, SimdLevel, vectorised};
use rayon::prelude::*;

/// Pixels along a tile's side.
pub(crate) const TILE: usize = 8;

/// Depths that a tile tells apart: the bits of its mask.
const SLOTS: usize = 128;

/// Bricks are merged until there are at most this many.
const MOST_BRICKS: usize = 1 << 15;

/// Slack on a brick's box, in cells, for the rounding of rays to 32 bits.
const SLACK: f64 = 1.0 / 64.0;

/// The boxes of occupied bricks, in cell coordinates.
struct Boxes<'a> {
    occupancy: &'a Occupancy,
    /// Cells along each axis.
    cells: [usize; 3],
    /// Bricks along the side of a block, a power of two.
    merge: usize,
    /// Blocks along each axis.
    blocks: [usize; 3],
}

impl<'a> Boxes<'a> {
    fn new(occupancy: &'a Occupancy, dims: [usize; 3]) -> Self {
        let mut merge = 1;
        while occupancy.bricks().map(|n| n.div_ceil(merge)).iter().product::<usize>() > MOST_BRICKS {
            merge *= 2;
        }
        Self { occupancy, cells: dims.map(|n| n + 1), merge, blocks: occupancy.bricks().map(|n| n.div_ceil(merge)) }
    }

    /// True when the block holds an occupied brick.
    fn occupied(&self, [x, y, z]: [usize; 3]) -> bool {
        let (m, [nx, ny, nz]) = (self.merge, self.occupancy.bricks());
        let (first, last) = (x * m, (x * m + m).min(nx) - 1);
        (z * m..(z * m + m).min(nz)).any(|bz| {
            (y * m..(y * m + m).min(ny)).any(|by| {
                let row = self.occupancy.row(by, bz);
                if m >= 64 {
                    return row[first / 64..=last / 64].iter().any(|w| *w != 0);
                }
                // Blocks are aligned, so none crosses from one word to the next.
                row[first / 64] >> (first % 64) & (u64::MAX >> (63 - (last - first))) != 0
            })
        })
    }

    /// A bit for each of the blocks along x from `first` on, up to [`LANES`] of them; `first` is a multiple of that.
    fn full(&self, first: usize, y: usize, z: usize) -> u8 {
        if self.merge == 1 {
            // Bits beyond the last block are 0, and runs do not cross words.
            return (self.occupancy.row(y, z)[first / 64] >> (first % 64)) as u8;
        }
        let number = LANES.min(self.blocks[0] - first);
        (0..number).fold(0, |m, l| m | u8::from(self.occupied([first + l, y, z])) << l)
    }

    /// What a run of blocks on an axis reaches: voxel `v` weighs between the cell coordinates `v` and `v + 2`.
    fn span(&self, axis: usize, first: usize, last: usize) -> [f64; 2] {
        let side = Occupancy::SIDE * self.merge;
        let end = ((last + 1) * side + 1).min(self.cells[axis]);
        [(first * side) as f64, end as f64]
    }

    /// The box around all occupied blocks; the whole grid when there is none.
    fn bounds(&self) -> [[f64; 2]; 3] {
        let (mut first, mut last) = (self.blocks, [0; 3]);
        for z in 0..self.blocks[2] {
            for y in 0..self.blocks[1] {
                for from in (0..self.blocks[0]).step_by(LANES) {
                    let full = self.full(from, y, z);
                    if full == 0 {
                        continue;
                    }
                    let ends = [from + full.trailing_zeros() as usize, from + full.ilog2() as usize];
                    for (a, v) in [ends, [y; 2], [z; 2]].into_iter().enumerate() {
                        first[a] = first[a].min(v[0]);
                        last[a] = last[a].max(v[1]);
                    }
                }
            }
        }
        std::array::from_fn(|a| if first[a] <= last[a] { self.span(a, first[a], last[a]) } else { [0.0; 2] })
    }
}

/// The occupied depths of every tile.
pub(crate) struct Tiles {
    columns: usize,
    masks: Vec<u128>,
    /// Parameter at which slot 0 begins, and the length of a slot.
    start: f64,
    length: f64,
    /// Box around all density, in cell coordinates.
    pub low: [f64; 3],
    pub high: [f64; 3],
}

/// Cell coordinates to pixels, exact as the camera is.
struct Outliner {
    /// Images of the origin and of the three unit vectors: pixel x and y (times depth for a pinhole) and parameter.
    at: [[f64; 3]; 4],
    parallel: bool,
    near: f64,
}

/// Boxes whose outlines are found together.
const LANES: usize = 8;

/// First tile and the one after the last along x and along y, and first and last slot, of boxes side by side.
type Outlines = [[[i32; LANES]; 2]; 3];

/// What outlines are told in.
struct Frame {
    /// As of [`Outliner`].
    at: [[f64; 3]; 4],
    parallel: bool,
    /// Pixels along x and y.
    pixels: [f64; 2],
    /// Parameter at which slot 0 begins, and the length of a slot.
    start: f64,
    length: f64,
}

/// Pixels by which an outline is widened, for the rounding of rays to 32 bits.
const RIM: f64 = 1.0 / 64.0;

vectorised! {
    /// Outlines of boxes that share their extent along y and z and lie beyond a pinhole's eye.
    fn outlines(
        frame: &Frame, x: &[[f64; LANES]; 2], y: [f64; 2], z: [f64; 2], out: &mut Outlines,
    ) = outlines_body
}

#[inline(always)]
fn outlines_body(frame: &Frame, x: &[[f64; LANES]; 2], y: [f64; 2], z: [f64; 2], out: &mut Outlines) {
    let Frame { at, parallel, .. } = frame;
    let mut ends = [[[f64::MAX; LANES], [f64::MIN; LANES]]; 3];
    for v in y {
        for w in z {
            let mut origin = at[0];
            for n in 0..3 {
                origin[n] += v * at[2][n] + w * at[3][n];
            }
            for u in x {
                for l in 0..LANES {
                    let q0 = origin[0] + u[l] * at[1][0];
                    let q1 = origin[1] + u[l] * at[1][1];
                    let t = origin[2] + u[l] * at[1][2];
                    let nearness = if *parallel { 1.0 } else { 1.0 / t };
                    let (px, py) = (q0 * nearness, q1 * nearness);
                    ends[0][0][l] = if px < ends[0][0][l] { px } else { ends[0][0][l] };
                    ends[0][1][l] = if px > ends[0][1][l] { px } else { ends[0][1][l] };
                    ends[1][0][l] = if py < ends[1][0][l] { py } else { ends[1][0][l] };
                    ends[1][1][l] = if py > ends[1][1][l] { py } else { ends[1][1][l] };
                    ends[2][0][l] = if t < ends[2][0][l] { t } else { ends[2][0][l] };
                    ends[2][1][l] = if t > ends[2][1][l] { t } else { ends[2][1][l] };
                }
            }
        }
    }
    for axis in 0..2 {
        for l in 0..LANES {
            let (a, _) = whole(ends[axis][0][l] - RIM, frame.pixels[axis]);
            let (b, more) = whole(ends[axis][1][l] + RIM, frame.pixels[axis]);
            let b = b + more;
            // Nothing beside the image.
            out[axis][0][l] = if a < b { a >> TILE.ilog2() } else { 0 };
            out[axis][1][l] = if a < b { (b + TILE as i32 - 1) >> TILE.ilog2() } else { 0 };
        }
    }
    for l in 0..LANES {
        let slot = |t: f64| whole((t - frame.start) / frame.length, (SLOTS - 1) as f64).0;
        out[2][0][l] = slot(ends[2][0][l] - SLACK * frame.length);
        out[2][1][l] = slot(ends[2][1][l] + SLACK * frame.length);
    }
}

/// The whole part of a number brought between 0 and `most`, and 1 where something is left. `most` is below 2^31.
#[inline(always)]
fn whole(v: f64, most: f64) -> (i32, i32) {
    // What is no number becomes 0.
    let v = if v > 0.0 { v } else { 0.0 };
    let v = if v < most { v } else { most };
    // SAFETY: finite, and within the range of the type.
    let n: i32 = unsafe { v.to_int_unchecked() };
    (n, i32::from(f64::from(n) < v))
}

impl Outliner {
    fn new(camera: &Camera, grid: &Grid, depth: f64) -> Self {
        let to_world = grid.index_to_world();
        let rows = camera.world_to_pixel();
        let axis = camera.axis();
        let parallel = camera.is_parallel();
        let image = |v: glam::DVec3, point: f64| {
            let row = |r: usize| rows[r][0] * v.x + rows[r][1] * v.y + rows[r][2] * v.z + point * rows[r][3];
            let t = if parallel { axis.dot(v) - point * depth } else { row(2) };
            [row(0), row(1), t]
        };
        // Cell coordinate 0 is voxel -1 (`tent` reaches one voxel).
        let origin = image(to_world.transform_point3(glam::DVec3::splat(-1.0)), 1.0);
        let unit = |v: glam::DVec3| image(to_world.transform_vector3(v), 0.0);
        let at = [origin, unit(glam::DVec3::X), unit(glam::DVec3::Y), unit(glam::DVec3::Z)];
        Self { at, parallel, near: camera.near() }
    }

    /// Parameters that a box covers; `None` when it reaches before a pinhole's near plane.
    fn depths(&self, low: [f64; 3], high: [f64; 3]) -> Option<[f64; 2]> {
        let mut ends = [f64::MAX, f64::MIN];
        for corner in 0..8 {
            let end = |a: usize| if corner >> a & 1 == 0 { low[a] } else { high[a] };
            let t = (0..3).fold(self.at[0][2], |t, a| t + end(a) * self.at[a + 1][2]);
            if !self.parallel && t < self.near {
                return None;
            }
            ends = [ends[0].min(t), ends[1].max(t)];
        }
        Some(ends)
    }
}

impl Tiles {
    /// Marks what the occupied bricks cover; `depth` is the camera's depth at parameter 0.
    pub fn new(occupancy: &Occupancy, camera: &Camera, grid: &Grid, depth: f64) -> Self {
        let extent = camera.extent();
        let (columns, rows) = (extent.width.div_ceil(TILE), extent.height.div_ceil(TILE));
        let outliner = Outliner::new(camera, grid, depth);
        let boxes = Boxes::new(occupancy, grid.dims());
        let bounds = boxes.bounds();
        let (low, high) = (bounds.map(|b| b[0]), bounds.map(|b| b[1]));
        let Some(range) = outliner.depths(low.map(|v| v - SLACK), high.map(|v| v + SLACK)) else {
            // The box reaches the eye: everything may be anywhere.
            let masks = vec![1; columns * rows];
            return Self { columns, masks, start: f64::NEG_INFINITY, length: f64::INFINITY, low, high };
        };
        let (start, length) = (range[0], (range[1] - range[0]) / SLOTS as f64);
        let Outliner { at, parallel, .. } = outliner;
        let frame = Frame { at, parallel, pixels: [extent.width, extent.height].map(|n| n as f64), start, length };
        let (blocks, level) = (boxes.blocks, SimdLevel::detect());
        let none = || vec![0u128; columns * rows];
        let slack = |[low, high]: [f64; 2]| [low - SLACK, high + SLACK];
        // Where blocks begin and end along x; there are none beyond the last.
        let along_x: Vec<[f64; 2]> = (0..blocks[0].next_multiple_of(LANES))
            .map(|n| n.min(blocks[0] - 1))
            .map(|n| slack(boxes.span(0, n, n)))
            .collect();
        let masks = (0..blocks[2])
            .into_par_iter()
            .with_min_len(4)
            .fold(none, |mut masks, bz| {
                let mut found: Outlines = [[[0; LANES]; 2]; 3];
                let z = slack(boxes.span(2, bz, bz));
                for by in 0..blocks[1] {
                    let y = slack(boxes.span(1, by, by));
                    for first in (0..blocks[0]).step_by(LANES) {
                        let mut full = boxes.full(first, by, bz);
                        if full == 0 {
                            continue;
                        }
                        let mut x = [[0.0; LANES]; 2];
                        for l in 0..LANES {
                            let [from, to] = along_x[first + l];
                            (x[0][l], x[1][l]) = (from, to);
                        }
                        // The whole box lies beyond the near plane, and so do its parts.
                        outlines(level, &frame, &x, y, z, &mut found);
                        while full != 0 {
                            let l = full.trailing_zeros() as usize;
                            full &= full - 1;
                            let at = |axis: usize| (found[axis][0][l] as usize, found[axis][1][l] as usize);
                            let (x, y, (a, b)) = (at(0), at(1), at(2));
                            let bits = (u128::MAX >> (SLOTS - 1 - (b - a))) << a;
                            for row in y.0..y.1 {
                                for mask in &mut masks[row * columns..][x.0..x.1] {
                                    *mask |= bits;
                                }
                            }
                        }
                    }
                }
                masks
            })
            .reduce(none, |mut a, b| {
                a.iter_mut().zip(b).for_each(|(a, b)| *a |= b);
                a
            });
        Self { columns, masks, start, length, low, high }
    }

    /// Columns and rows of the tiles with any density.
    pub fn occupied(&self) -> Vec<(usize, usize)> {
        let full = self.masks.iter().enumerate().filter(|(_, m)| **m != 0);
        full.map(|(n, _)| (n % self.columns, n / self.columns)).collect()
    }

    /// Largest parameter at which there is density.
    pub fn farthest(&self) -> f64 {
        self.start + SLOTS as f64 * self.length
    }

    /// Slots with density of the tile in a column and row of tiles.
    pub fn mask(&self, column: usize, row: usize) -> u128 {
        self.masks[column + self.columns * row]
    }

    /// The same of several tiles together.
    pub fn mask_of(&self, columns: &Range<usize>, rows: &Range<usize>) -> u128 {
        let row = |row: usize| &self.masks[row * self.columns..][columns.clone()];
        rows.clone().flat_map(row).fold(0, |all, mask| all | mask)
    }

    /// Tiles that places along an axis (0: x, 1: y) of the image lie in, of which those beyond the image count to the outermost.
    pub fn met(&self, places: &[f64], axis: usize) -> Range<usize> {
        let number = if axis == 0 { self.columns } else { self.masks.len() / self.columns };
        // `as` saturates.
        let of = |place: f64| ((place / TILE as f64) as usize).min(number - 1);
        let ends = places.iter().fold([f64::MAX, f64::MIN], |[a, b], v| [a.min(*v), b.max(*v)]);
        of(ends[0])..of(ends[1]) + 1
    }

    /// Pieces of parameter that are marked, from near to far and disjoint. Gaps of less than `gap` between them are taken along.
    #[inline(always)]
    pub fn pieces(&self, mask: u128, gap: f64) -> Pieces<'_> {
        Pieces { tiles: self, mask, gap }
    }

    /// Parameter from one slot to the one after the last. Outermost pieces have no end, so that no rounding cuts the box's rim; the ray's
    /// own range ends them.
    #[inline(always)]
    fn span(&self, first: u32, end: u32) -> [f64; 2] {
        let at = |slot: u32| self.start + f64::from(slot) * self.length;
        let near = if first == 0 { f64::NEG_INFINITY } else { at(first) };
        let far = if end >= SLOTS as u32 || self.length == f64::INFINITY { f64::INFINITY } else { at(end) };
        [near, far]
    }
}

/// Pieces of parameter.
pub(crate) struct Pieces<'a> {
    tiles: &'a Tiles,
    mask: u128,
    gap: f64,
}

impl Pieces<'_> {
    /// The next run of slots.
    #[inline(always)]
    fn run(&self) -> (u32, u32) {
        let first = self.mask.trailing_zeros();
        (first, first + (!(self.mask >> first)).trailing_zeros())
    }
}

impl Iterator for Pieces<'_> {
    type Item = [f64; 2];

    #[inline(always)]
    fn next(&mut self) -> Option<[f64; 2]> {
        if self.mask == 0 {
            return None;
        }
        let mut piece: Option<[f64; 2]> = None;
        while self.mask != 0 {
            let (first, end) = self.run();
            let [near, far] = self.tiles.span(first, end);
            match &mut piece {
                None => piece = Some([near, far]),
                Some(piece) if near - piece[1] < self.gap => piece[1] = far,
                Some(_) => break,
            }
            self.mask = if end >= SLOTS as u32 { 0 } else { self.mask >> end << end };
        }
        piece
    }
}
