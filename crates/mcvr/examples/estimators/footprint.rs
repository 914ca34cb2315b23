//! Footprints: every voxel that is not 0 adds the projection of its tent, averaged over pixels, to the image (L. Westover,
//! *Footprint evaluation for volume rendering*, SIGGRAPH 1990). No noise; what is wrong is the footprint's shape:
//!
//! - `separable`: a cubic B-spline along x and along y with the tent's own variance at that depth. The projected tent of cubic voxels is
//!   nearly round, so that no product of the two axes is missing in its variance; its fourth moments are.
//! - `table`: the tent's projection itself, tabulated for a few places and depths of the view (the perspective turns and scales it).
//!
//! Both are tabulated for a number of offsets below a pixel, and centred on the voxel's projection; the factor of the estimand is that of the
//! voxel's centre (its change over a voxel is of second order, about 1e-6).

use mcvr::scene::{Camera, Density, Image, Occupancy, WeightFn};

use crate::footprint_table::{Separable, Tables};
use crate::scenes::Scene;
use crate::{Entry, Made, Outcome, Preparation};

/// List of the voxels.
const LIST: &str = "list of voxels";

/// Voxels projected at a time.
const BATCH: usize = 512;

/// All voxels that are not 0, in the order of bricks.
pub struct Splats {
    at: [Vec<f32>; 3],
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
        let (mut at, mut weight) = ([vec![], vec![], vec![]], vec![]);
        let lookup = density.lookup();
        mcvr::volume::with_voxels!(density.volume().voxels(), v => {
            for (z, y, x) in (0..bz).flat_map(|z| (0..by).flat_map(move |y| (0..bx).map(move |x| (z, y, x)))) {
                if !map.occupied(x, y, z) {
                    continue;
                }
                for k in z * side..nz.min((z + 1) * side) {
                    for j in y * side..ny.min((y + 1) * side) {
                        for i in x * side..nx.min((x + 1) * side) {
                            let w = lookup.weight(v[i + nx * (j + ny * k)]) as f32;
                            if w > 0.0 {
                                at[0].push(i as f32);
                                at[1].push(j as f32);
                                at[2].push(k as f32);
                                weight.push(w);
                            }
                        }
                    }
                }
            }
        });
        let m = grid.index_to_world();
        let world = [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis, m.translation];
        Self { at, weight, volume: grid.voxel_volume(), dims: grid.dims(), world }
    }
}

/// From index coordinates to pixels, as numbers.
pub struct Projection {
    /// Rows of the camera's matrix over index coordinates.
    pub rows: [[f32; 4]; 3],
    /// The ray's direction per mm of depth: `c[0] px + c[1] py + c[2]`.
    stretch: [[f32; 3]; 3],
    /// Determinant times the voxel's volume.
    unit: f32,
    parallel: bool,
}

impl Projection {
    pub fn new(list: &Splats, camera: &Camera) -> Self {
        let m = camera.world_to_pixel();
        let row = |r: usize, v: glam::DVec3| m[r][0] * v.x + m[r][1] * v.y + m[r][2] * v.z;
        let rows = std::array::from_fn(|r| {
            std::array::from_fn(|c| (row(r, list.world[c]) + if c == 3 { m[r][3] } else { 0.0 }) as f32)
        });
        let inverse = camera.inverse();
        let columns = [inverse.x_axis, inverse.y_axis, inverse.z_axis];
        let stretch = columns.map(|c| c.to_array().map(|v| v as f32));
        let unit = (camera.det() * list.volume) as f32;
        Self { rows, stretch, unit, parallel: camera.is_parallel() }
    }

    /// Pixel coordinates and depth (1 for a parallel camera) of a point.
    #[inline(always)]
    pub fn at(&self, p: [f32; 3]) -> [f32; 3] {
        let q = self.rows.map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3]);
        let inverse = 1.0 / q[2];
        [q[0] * inverse, q[1] * inverse, q[2]]
    }

    /// Pixels that a step of one voxel along an axis moves, at a point.
    #[inline(always)]
    pub fn step(&self, axis: usize, [px, py, z]: [f32; 3]) -> [f32; 2] {
        let away = self.rows[2][axis];
        [(self.rows[0][axis] - px * away) / z, (self.rows[1][axis] - py * away) / z]
    }

    /// What a voxel of weight 1 adds to the image in all.
    #[inline(always)]
    fn amount(&self, [px, py, z]: [f32; 3]) -> f32 {
        if self.parallel {
            return self.unit;
        }
        let [a, b, c] = &self.stretch;
        let [x, y, w] = [0, 1, 2].map(|n| a[n] * px + b[n] * py + c[n]);
        self.unit * (x * x + y * y + w * w).sqrt() / (z * z)
    }

    /// Least and largest pixel coordinates and depths of the grid's corners.
    pub fn range(&self, dims: [usize; 3]) -> [[f32; 2]; 3] {
        let mut range = [[f32::INFINITY, f32::NEG_INFINITY]; 3];
        for corner in 0..8 {
            let p = [0, 1, 2].map(|a| if corner >> a & 1 == 0 { 0.0 } else { dims[a] as f32 - 1.0 });
            for (r, v) in range.iter_mut().zip(self.at(p)) {
                *r = [r[0].min(v), r[1].max(v)];
            }
        }
        range
    }
}

/// Shapes of footprints of `N` by `N` pixels.
pub trait Footprint<const N: usize> {
    /// Adds a voxel: `row` begins at the footprint's first pixel; the fractions are those of the position in its pixel.
    fn add(&mut self, image: &mut [f32], width: usize, at: [f32; 3], fraction: [f32; 2], amount: f32);
}

impl Splats {
    /// The image, with pixels to spare on all sides while it is made.
    pub fn image<const N: usize>(&self, camera: &Camera, mut shape: impl Footprint<N>) -> Outcome<Made> {
        let extent = camera.extent();
        let (width, height) = (extent.width + 2 * N, extent.height + 2 * N);
        let mut wide = vec![0f32; width * height];
        let projection = Projection::new(self, camera);
        let mut drawn = 0;
        let mut places = [[0f32; 4]; BATCH];
        let all = self.weight.len();
        for first in (0..all).step_by(BATCH) {
            let many = BATCH.min(all - first);
            let [x, y, z] = [0, 1, 2].map(|a| &self.at[a][first..first + many]);
            let weight = &self.weight[first..first + many];
            for n in 0..many {
                let at = projection.at([x[n], y[n], z[n]]);
                places[n] = [at[0], at[1], at[2], weight[n] * projection.amount(at)];
            }
            for &[px, py, depth, amount] in &places[..many] {
                // The footprint's first pixel is N/2 - 1 before the pixel whose centre is at or before the position.
                let (gx, gy) = (px - 0.5, py - 0.5);
                let (ix, iy) = (gx.floor(), gy.floor());
                let (sx, sy) = (ix as i32 + (N / 2 + 1) as i32, iy as i32 + (N / 2 + 1) as i32);
                let beside = sx < 0 || sy < 0 || sx as usize + N > width || sy as usize + N > height;
                if beside || (!projection.parallel && f64::from(depth) < camera.near()) {
                    continue;
                }
                drawn += 1;
                let start = sy as usize * width + sx as usize;
                shape.add(&mut wide[start..], width, [px, py, depth], [gx - ix, gy - iy], amount);
            }
        }
        let rows = (0..extent.height).flat_map(|y| &wide[(y + N) * width + N..][..extent.width]);
        let image = Image::from_values(extent, rows.map(|v| f64::from(*v)).collect())?;
        Ok(Made { image, work: drawn })
    }

    /// By separable footprints.
    pub fn separable<const N: usize>(&self, camera: &Camera) -> Outcome<Made> {
        let projection = Projection::new(self, camera);
        self.image::<N>(camera, Separable::<N>::new(projection, self.dims))
    }

    /// By tabulated projections: tables by place in the view (x, y, depth), with this many offsets a pixel.
    pub fn tabulated<const N: usize>(&self, camera: &Camera, bins: [usize; 3], offsets: usize) -> Outcome<Made> {
        let projection = Projection::new(self, camera);
        self.image::<N>(camera, Tables::<N>::new(projection, self.dims, bins, offsets))
    }
}

pub fn preparation(scene: &Scene) -> Preparation<'_> {
    Preparation { name: LIST, work: Box::new(|| Ok(drop(std::hint::black_box(Splats::new(&scene.density))))) }
}

pub fn entries<'a>(scene: &'a Scene, list: &'a Splats) -> Vec<Entry<'a>> {
    let mut all = vec![];
    let mut add = |setting: &str, work: Box<dyn FnMut(u64) -> Outcome<Made> + Send + 'a>| {
        let needs = vec![crate::baseline::BRICKS, LIST];
        all.push(Entry { family: "footprint", setting: setting.to_owned(), needs, work });
    };
    let camera = &scene.camera;
    add("separable 4x4", Box::new(|_| list.separable::<4>(camera)));
    add("separable 6x6", Box::new(|_| list.separable::<6>(camera)));
    add("table 4x4, 2x2x4, 8 offsets", Box::new(|_| list.tabulated::<4>(camera, [2, 2, 4], 8)));
    add("table 4x4, 4x4x8, 8 offsets", Box::new(|_| list.tabulated::<4>(camera, [4, 4, 8], 8)));
    add("table 4x4, 4x4x8, 16 offsets", Box::new(|_| list.tabulated::<4>(camera, [4, 4, 8], 16)));
    add("table 6x6, 4x4x8, 16 offsets", Box::new(|_| list.tabulated::<6>(camera, [4, 4, 8], 16)));
    add("table 6x6, 8x8x16, 16 offsets", Box::new(|_| list.tabulated::<6>(camera, [8, 8, 16], 16)));
    add("table 6x6, 8x8x16, 32 offsets", Box::new(|_| list.tabulated::<6>(camera, [8, 8, 16], 32)));
    all
}
