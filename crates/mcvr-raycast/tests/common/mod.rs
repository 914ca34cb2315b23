//! Volumes and cameras that several tests use.
#![allow(dead_code, reason = "each test binary uses its own part")]

use glam::{DMat3, DQuat, DVec3};
use mcvr_raycast::{Reference, ReferenceOptions, Watch, reference};
use mcvr_scene::{Camera, Density, DensityMap, Estimand, Extent, Kernel, View};
use mcvr_volume::{Grid, Volume, Voxel};

pub const KERNELS: [Kernel; 3] = [Kernel::Box, Kernel::Tent, Kernel::Bspline3];

pub fn density<T: Voxel>(grid: Grid, voxels: Vec<T>) -> Density {
    Density::new(&Volume::from_vec(grid, voxels, "test").unwrap(), DensityMap::default()).unwrap()
}

/// Anisotropic spacing, turned and mirrored axes, an origin away from 0.
pub fn skewed_grid(dims: [usize; 3]) -> Grid {
    let turn = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -0.7, 1.1));
    let mirror = DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
    Grid::new(dims, DVec3::new(0.7, 1.0, 1.9), DVec3::new(-31.0, 12.0, 55.0), turn * mirror).unwrap()
}

pub fn plain_grid(dims: [usize; 3]) -> Grid {
    Grid::with_spacing(dims, [1.0; 3]).unwrap()
}

/// Reproducible voxels, about a third of them 0.
pub fn noise(n: usize) -> Vec<u8> {
    let mut state = 12345u64;
    (0..n)
        .map(|_| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let v = (state >> 56) as u8;
            if v < 80 { 0 } else { v }
        })
        .collect()
}

pub fn look(grid: &Grid, azimuth: f64, elevation: f64, parallel: bool, side: usize) -> Camera {
    let view = View { azimuth, elevation, parallel, ..View::default() };
    Camera::look(&view, grid, Extent::new(side, side).unwrap()).unwrap()
}

pub fn options(estimand: Estimand, kernel: Kernel, tolerance: f64) -> ReferenceOptions {
    ReferenceOptions { estimand, kernel, tolerance, ..ReferenceOptions::default() }
}

pub fn run(density: &Density, camera: &Camera, options: &ReferenceOptions) -> Reference {
    reference(density, camera, options, &Watch::default()).unwrap()
}

/// The field by its definition: `Σ w_i K(x - i)` at a continuous index.
pub fn field(density: &Density, kernel: Kernel, index: DVec3) -> f64 {
    let grid = density.volume().grid();
    let mut sum = 0.0;
    for n in 0..grid.len() {
        let c = grid.unravel(n);
        let k: f64 = (0..3).map(|a| kernel.density(index[a] - c[a] as f64).unwrap()).product();
        sum += density.weight(n) * k;
    }
    sum
}
