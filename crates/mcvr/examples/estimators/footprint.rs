//! Footprints: every voxel that is not 0 adds the projection of its tent, averaged over pixels, to the image (L. Westover,
//! *Footprint evaluation for volume rendering*, SIGGRAPH 1990). There is no noise. What is wrong is the footprint's shape: it is the
//! product of the tent's projections onto the image's two axes, each with its variance at that place and depth and its shape in the middle
//! of the view. The projected tent of cubic voxels is nearly round, so that the product lacks nothing of second order. Then the
//! profiles are tabulated by offset below a pixel and by width, and the nearest entry is taken: the larger error below 256 offsets.
//! The factor of the estimand is that at the voxel's centre (its change over a voxel is of second order, about 1e-6).
//!
//! Tried and left: cubic B-splines for both axes (as good in oblique views, 0.7 to 1.5 % off along an axis of the grid); tables of the true
//! projection by place in the view, which need both offsets at once and so have to be coarser (8 to 32 offsets: 6 to 2 % off on
//! the aneurism, and slower to make).

use mcvr::scene::{Camera, Density, Image, Occupancy, WeightFn};
use mcvr::volume::SimdLevel;

use crate::footprint_table::{Fineness, Profiles};
use crate::scenes::Scene;
use crate::{Entry, Made, Outcome, Preparation};

/// List of the voxels.
const LIST: &str = "list of voxels";

/// Voxels projected at a time, and places of the list that take turns.
const BATCH: usize = 256;
const STREAMS: usize = 8;

/// All voxels that are not 0, in the order of bricks.
pub struct Splats {
    at: [Vec<u16>; 3],
    weight: Vec<f32>,
    /// Voxel's volume, mm³.
    volume: f64,
    dims: [usize; 3],
    /// From index coordinates to world mm: columns of the matrix, then the shift.
    world: [glam::DVec3; 4],
}

impl Splats {
    pub fn new(density: &Density) -> Self {
        let grid = density.volume().grid();
        let [nx, ny, nz] = grid.dims();
        let map = density.occupancy();
        let [bx, by, bz] = map.bricks();
        let side = Occupancy::SIDE;
        // Places are written whether or not they are kept, which a branch would cost more than; so there is room for one more.
        let room = density.report().positive as usize + 1;
        let (mut at, mut weight) = ([vec![0u16; room], vec![0; room], vec![0; room]], vec![0f32; room]);
        let lookup = density.lookup();
        // The table as floats, for types that have one; an empty one otherwise.
        let table: Vec<f32> = density.table().unwrap_or_default().iter().map(|w| *w as f32).collect();
        let mut n = 0;
        mcvr::volume::with_voxels!(density.volume().voxels(), v => {
            for (z, y, x) in (0..bz).flat_map(|z| (0..by).flat_map(move |y| (0..bx).map(move |x| (z, y, x)))) {
                if !map.occupied(x, y, z) {
                    continue;
                }
                for k in z * side..nz.min((z + 1) * side) {
                    for j in y * side..ny.min((y + 1) * side) {
                        let (from, to) = (x * side, nx.min((x + 1) * side));
                        let mut weights = [0f32; Occupancy::SIDE];
                        for (w, stored) in weights.iter_mut().zip(&v[nx * (j + ny * k) + from..nx * (j + ny * k) + to]) {
                            let tabled = mcvr::volume::Voxel::ordinal(*stored).and_then(|o| table.get(o));
                            *w = tabled.map_or_else(|| lookup.weight(*stored) as f32, |w| *w);
                        }
                        if weights == [0.0; Occupancy::SIDE] {
                            continue;
                        }
                        for (i, w) in (from..to).zip(weights) {
                            (at[0][n], at[1][n], at[2][n], weight[n]) = (i as u16, j as u16, k as u16, w);
                            n += usize::from(w > 0.0);
                        }
                    }
                }
            }
        });
        at.iter_mut().for_each(|a| a.truncate(n));
        weight.truncate(n);
        let m = grid.index_to_world();
        let world = [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis, m.translation];
        Self { at, weight, volume: grid.voxel_volume(), dims: grid.dims(), world }
    }
}

/// From index coordinates to pixels, as numbers.
struct Projection {
    /// Rows of the camera's matrix over index coordinates.
    rows: [[f32; 4]; 3],
    /// Square of the ray's way per mm of depth, and of the footprints' knot distances along x and y times the depth, as
    /// `c[0] + c[1] v + c[2] v²` (the way: in px, then what py adds).
    wide: [f32; 3],
    high: [f32; 3],
    /// The ray's direction per mm of depth: `c[0] px + c[1] py + c[2]`.
    stretch: [[f32; 3]; 3],
    /// Determinant times the voxel's volume.
    unit: f32,
    parallel: bool,
}

impl Projection {
    fn new(list: &Splats, camera: &Camera) -> Self {
        let m = camera.world_to_pixel();
        let row = |r: usize, v: glam::DVec3| m[r][0] * v.x + m[r][1] * v.y + m[r][2] * v.z;
        let rows: [[f64; 4]; 3] = std::array::from_fn(|r| {
            std::array::from_fn(|c| row(r, list.world[c]) + if c == 3 { m[r][3] } else { 0.0 })
        });
        // A voxel's step along an axis moves `(rows[r][axis] - v rows[2][axis]) / z` pixels; the tent's variance is a sixth of the
        // squares' sum, the cubic B-spline's a third of its knot distance's square.
        let half = |r: usize, s: usize| 0.5 * (0..3).map(|a| rows[r][a] * rows[s][a]).sum::<f64>();
        let knots = |r: usize| [half(r, r), -2.0 * half(r, 2), half(2, 2)].map(|v| v as f32);
        let inverse = camera.inverse();
        let columns = [inverse.x_axis, inverse.y_axis, inverse.z_axis];
        Self {
            wide: knots(0),
            high: knots(1),
            rows: rows.map(|r| r.map(|v| v as f32)),
            stretch: columns.map(|c| c.to_array().map(|v| v as f32)),
            unit: (camera.det() * list.volume) as f32,
            parallel: camera.is_parallel(),
        }
    }

    /// Pixel coordinates, the depth's reciprocal, and knot distances in pixels along x and y.
    #[inline(always)]
    fn at(&self, p: [f32; 3]) -> [f32; 5] {
        let [a, b, c] = &self.rows;
        let x = a[0] * p[0] + a[1] * p[1] + a[2] * p[2] + a[3];
        let y = b[0] * p[0] + b[1] * p[1] + b[2] * p[2] + b[3];
        let near = 1.0 / (c[0] * p[0] + c[1] * p[1] + c[2] * p[2] + c[3]);
        let (x, y) = (x * near, y * near);
        let wide = (self.wide[0] + x * (self.wide[1] + x * self.wide[2])).sqrt() * near;
        let high = (self.high[0] + y * (self.high[1] + y * self.high[2])).sqrt() * near;
        [x, y, near, wide, high]
    }

    /// What a voxel of weight 1 adds to the image in all.
    #[inline(always)]
    fn amount(&self, px: f32, py: f32, near: f32) -> f32 {
        let [a, b, c] = &self.stretch;
        let x = a[0] * px + b[0] * py + c[0];
        let y = a[1] * px + b[1] * py + c[1];
        let z = a[2] * px + b[2] * py + c[2];
        if self.parallel { self.unit } else { self.unit * (x * x + y * y + z * z).sqrt() * (near * near) }
    }

    /// Pixels along x and along y that a voxel's step along each axis moves, in the middle of the grid.
    fn steps(&self, dims: [usize; 3]) -> [[f32; 3]; 2] {
        let [x, y, near, ..] = self.at(dims.map(|n| 0.5 * (n as f32 - 1.0)));
        let [a, b, c] = &self.rows;
        [[0, 1, 2].map(|n| (a[n] - x * c[n]) * near), [0, 1, 2].map(|n| (b[n] - y * c[n]) * near)]
    }

    /// Least and largest knot distance in the grid.
    fn span(&self, dims: [usize; 3]) -> [f32; 2] {
        let mut span = [f32::INFINITY, f32::NEG_INFINITY];
        for corner in 0..8 {
            let p = [0, 1, 2].map(|a| if corner >> a & 1 == 0 { 0.0 } else { dims[a] as f32 - 1.0 });
            let [_, _, _, wide, high] = self.at(p);
            span = [span[0].min(wide).min(high), span[1].max(wide).max(high)];
        }
        span
    }
}

/// Some projected voxels: first pixel, profiles along x and y, amount.
struct Batch {
    start: [i32; BATCH],
    across: [i32; BATCH],
    down: [i32; BATCH],
    amount: [f32; BATCH],
}

/// What projecting needs to know of image and profiles.
struct Frame {
    projection: Projection,
    offsets: f32,
    widths: f32,
    least: f32,
    per: f32,
    /// Pixels of the image with its margins, and the footprint's side.
    width: f32,
    height: f32,
    side: f32,
    farthest: f32,
}

#[inline(always)]
fn project(frame: &Frame, at: [&[u16]; 3], weight: &[f32], batch: &mut Batch) {
    let many = weight.len().min(BATCH);
    let (x, y, z, weight) = (&at[0][..many], &at[1][..many], &at[2][..many], &weight[..many]);
    let (start, across) = (&mut batch.start[..many], &mut batch.across[..many]);
    let (down, amount) = (&mut batch.down[..many], &mut batch.amount[..many]);
    let first = 0.5 * frame.side + 1.0;
    let (right, bottom) = (frame.width - frame.side, frame.height - frame.side);
    let (offsets, widths) = (frame.offsets, frame.widths);
    for n in 0..many {
        let [px, py, near, wide, high] = frame.projection.at([f32::from(x[n]), f32::from(y[n]), f32::from(z[n])]);
        // The footprint's first pixel is half of it less one before the pixel whose centre is at or before the position.
        let (gx, gy) = (px - 0.5, py - 0.5);
        let (ix, iy) = (gx.floor(), gy.floor());
        let (sx, sy) = (ix + first, iy + first);
        let inside =
            (sx >= 0.0) & (sy >= 0.0) & (sx <= right) & (sy <= bottom) & (near > 0.0) & (near <= frame.farthest);
        let (ox, oy) = (((gx - ix) * offsets).min(offsets - 1.0), ((gy - iy) * offsets).min(offsets - 1.0));
        let w = ((wide - frame.least) * frame.per + 0.5).max(0.0).min(widths - 1.0);
        let h = ((high - frame.least) * frame.per + 0.5).max(0.0).min(widths - 1.0);
        let (sx, sy) = (if inside { sx } else { 0.0 }, if inside { sy } else { 0.0 });
        amount[n] = if inside { weight[n] * frame.projection.amount(px, py, near) } else { 0.0 };
        let (ox, oy) = (if inside { ox } else { 0.0 }, if inside { oy } else { 0.0 });
        let (w, h) = (if inside { w } else { 0.0 }, if inside { h } else { 0.0 });
        // SAFETY: all six lie between 0 and what `i32` holds: images have at most 2^30 pixels.
        unsafe {
            let (w, h) = (w.to_int_unchecked::<i32>(), h.to_int_unchecked::<i32>());
            start[n] = sy.to_int_unchecked::<i32>() * frame.width as i32 + sx.to_int_unchecked::<i32>();
            across[n] = w * offsets as i32 + ox.to_int_unchecked::<i32>();
            down[n] = (h + widths as i32) * offsets as i32 + oy.to_int_unchecked::<i32>();
        }
    }
}

mcvr::volume::vectorised! {
    fn projected(frame: &Frame, at: [&[u16]; 3], weight: &[f32], batch: &mut Batch) = project
}

/// Adds a voxel to the image.
#[inline(always)]
fn splat<const N: usize>(image: &mut [f32], width: usize, profiles: &Profiles<N>, batch: &Batch, n: usize) {
    let (across, down) = (profiles.rows[batch.across[n] as usize], profiles.rows[batch.down[n] as usize]);
    let (amount, start) = (batch.amount[n], batch.start[n] as usize);
    assert!(start + (N - 1) * width + N <= image.len());
    for r in 0..N {
        // SAFETY: the last row ends within the image, as just checked, and the others before it.
        let row = unsafe { image.get_unchecked_mut(start + r * width..start + r * width + N) };
        let down = amount * down[r];
        for c in 0..N {
            row[c] += down * across[c];
        }
    }
}

impl Splats {
    /// The image by footprints that hold all but a thousandth of their shapes, of 24 by 24 pixels at most.
    pub fn fitting(&self, camera: &Camera, fineness: Fineness) -> Outcome<Made> {
        let [_, widest] = Projection::new(self, camera).span(self.dims);
        match 2.0 * (1.75 * widest + 0.5) {
            side if side <= 4.0 => self.image::<4>(camera, fineness),
            side if side <= 6.0 => self.image::<6>(camera, fineness),
            side if side <= 8.0 => self.image::<8>(camera, fineness),
            side if side <= 12.0 => self.image::<12>(camera, fineness),
            side if side <= 16.0 => self.image::<16>(camera, fineness),
            _ => self.image::<24>(camera, fineness),
        }
    }

    /// The image by footprints of `N` by `N` pixels, with pixels to spare on all sides while it is made.
    pub fn image<const N: usize>(&self, camera: &Camera, fineness: Fineness) -> Outcome<Made> {
        let extent = camera.extent();
        let (width, height) = (extent.width + 2 * N, extent.height + 2 * N);
        let mut wide = vec![0f32; width * height];
        let projection = Projection::new(self, camera);
        let profiles = Profiles::<N>::new(projection.span(self.dims), projection.steps(self.dims), fineness);
        let frame = Frame {
            farthest: if projection.parallel { f32::INFINITY } else { 1.0 / camera.near() as f32 },
            projection,
            offsets: fineness.offsets as f32,
            widths: fineness.widths as f32,
            least: profiles.least,
            per: profiles.per,
            width: width as f32,
            height: height as f32,
            side: N as f32,
        };
        let level = SimdLevel::detect();
        // Neighbours overlap in the image, where adding to pixels just written is slow: voxels far apart take turns.
        let share = self.weight.len().div_ceil(STREAMS);
        let empty = || Batch { start: [0; BATCH], across: [0; BATCH], down: [0; BATCH], amount: [0.0; BATCH] };
        let mut batches: Vec<Batch> = (0..STREAMS).map(|_| empty()).collect();
        for first in (0..share).step_by(BATCH) {
            let mut most = 0;
            for (stream, batch) in batches.iter_mut().enumerate() {
                let end = ((stream + 1) * share).min(self.weight.len());
                let from = (stream * share + first).min(end);
                let to = (from + BATCH).min(end);
                let at = [0, 1, 2].map(|a| &self.at[a][from..to]);
                projected(level, &frame, at, &self.weight[from..to], batch);
                batch.amount[to - from..].fill(0.0);
                most = most.max(to - from);
            }
            for n in 0..most {
                for batch in &batches {
                    splat(&mut wide, width, &profiles, batch, n);
                }
            }
        }
        let rows = (0..extent.height).flat_map(|y| &wide[(y + N) * width + N..][..extent.width]);
        let image = Image::from_values(extent, rows.map(|v| f64::from(*v)).collect())?;
        Ok(Made { image, work: self.weight.len() as u64 })
    }
}

pub fn preparation(scene: &Scene) -> Preparation<'_> {
    Preparation {
        name: LIST,
        work: Box::new(|| {
            std::hint::black_box(Splats::new(&scene.density));
            Ok(())
        }),
    }
}

/// Fineness of the profiles that serves errors of 1 % and more, and of 0.3 %.
pub const COARSE: Fineness = Fineness { offsets: 64, widths: 32 };
pub const FINE: Fineness = Fineness { offsets: 256, widths: 64 };

pub fn entries<'a>(scene: &'a Scene, list: &'a Splats) -> Vec<Entry<'a>> {
    let mut all = vec![];
    let camera = &scene.camera;
    let mut add = |setting: String, work: Box<dyn FnMut(u64) -> Outcome<Made> + Send + 'a>| {
        let needs = vec![crate::baseline::BRICKS, LIST];
        all.push(Entry { family: "footprint", setting, needs, work });
    };
    for fineness in [COARSE, Fineness { offsets: 128, ..COARSE }, FINE, Fineness { offsets: 1024, widths: 128 }] {
        let Fineness { offsets, widths } = fineness;
        let work = Box::new(move |_| list.image::<4>(camera, fineness));
        add(format!("4x4, {offsets} offsets, {widths} widths"), work);
    }
    add("fitting, 256 offsets, 64 widths".into(), Box::new(move |_| list.fitting(camera, FINE)));
    all
}
