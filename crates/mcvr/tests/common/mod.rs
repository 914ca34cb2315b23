//! Scenes that several tests use, and the statistical test that holds an image to its reference.
#![allow(dead_code, reason = "each test binary uses its own part")]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

pub mod agreement;
pub mod convergence;

use glam::{DMat3, DQuat, DVec3};
use mcvr::raycast::{Reference, ReferenceOptions, reference};
use mcvr::sampling::{PointStream, VoxelOrder};
use mcvr::scene::{Camera, Density, DensityMap, Estimand, Extent, Kernel, View, Watch};
use mcvr::volume::{Grid, Volume, Voxel};
use mcvr::{Made, Method, Request, Scenery, make};

/// Kernels that a ray caster can integrate.
pub const SEPARABLE: [Kernel; 3] = [Kernel::Box, Kernel::Tent, Kernel::Bspline3];

/// Every method that draws samples.
pub const SAMPLERS: [Method; 6] =
    [Method::Mc, Method::McQuicksort, Method::McBinary, Method::McLinear, Method::Stratified, Method::Qmc];

/// Extents of the small volume: odd, unequal, three bricks of voxels in all.
pub const DIMS: [usize; 3] = [11, 9, 7];

/// Reproducible bytes, by a linear congruential generator.
pub fn noise(n: usize, seed: u64) -> Vec<u8> {
    let mut state = seed;
    (0..n)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        })
        .collect()
}

/// Voxels of the small volume: about half of them 0, the last one among the largest.
pub fn speckle() -> Vec<u8> {
    let mut voxels = noise(DIMS.iter().product(), 12345);
    voxels.iter_mut().for_each(|v| *v = if *v < 128 { 0 } else { *v });
    voxels[0] = 255;
    *voxels.last_mut().unwrap() = 255;
    voxels
}

/// Unequal spacings, axes turned and one mirrored, first voxel away from the world's origin.
pub fn skewed_grid() -> Grid {
    let turn = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -0.7, 1.1));
    let mirror = DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
    Grid::new(DIMS, DVec3::new(0.7, 1.0, 1.6), DVec3::new(-31.0, 12.0, 55.0), turn * mirror).unwrap()
}

/// A volume of any voxel type on the skewed grid.
pub fn skewed<T: Voxel>(voxels: Vec<T>) -> Volume {
    Volume::from_vec(skewed_grid(), voxels, "speckle").unwrap()
}

/// The small volume under the identity map, 20×16 pixels, from `view`.
pub fn speckled_scene(view: &View) -> Scenery {
    scene_of(skewed(speckle()), DensityMap::default(), view)
}

/// Any volume, 20×16 pixels, from `view`.
pub fn scene_of(volume: Volume, map: DensityMap, view: &View) -> Scenery {
    let camera = Camera::look(view, volume.grid(), Extent::new(20, 16).unwrap()).unwrap();
    Scenery::new(volume, map, camera)
}

/// A pinhole close by: perspective strong enough that `count` and `line` differ by tens of percent.
pub fn pinhole() -> View {
    View { azimuth: 31.0, elevation: 17.0, distance: Some(1.1 * skewed_grid().diameter()), ..View::default() }
}

/// The scenery's density.
pub fn density(scenery: &Scenery) -> Density {
    Density::new(&scenery.volume, scenery.map.clone()).unwrap()
}

/// The exact image.
pub fn exact(scenery: &Scenery, kernel: Kernel, estimand: Estimand, tolerance: f64, max_depth: u32) -> Reference {
    let options = ReferenceOptions { estimand, kernel, tolerance, max_depth };
    reference(&density(scenery), &scenery.camera, &options, &Watch::default()).unwrap()
}

/// An image by request.
pub fn made(scenery: &Scenery, request: &Request) -> Made {
    make(scenery, request, &Watch::default()).unwrap()
}

/// The stream that a method stands for, for a distribution of the given total.
pub fn stream(method: Method, samples: u64, seed: u64, total: u64) -> Box<dyn PointStream> {
    match method {
        Method::Mc => Box::new(mcvr::mc::OrderStatistics::new(samples, seed)),
        Method::McQuicksort => Box::new(mcvr::mc::Quicksorted::new(samples, seed, total)),
        Method::McBinary => Box::new(mcvr::mc::Unsorted::binary(samples, seed)),
        Method::McLinear => Box::new(mcvr::mc::Unsorted::linear(samples, seed)),
        Method::Stratified => Box::new(mcvr::mc::Stratified::new(samples, seed)),
        Method::Qmc => Box::new(mcvr::qmc::SobolNet::new(samples, seed, mcvr::qmc::Scramble::default())),
        Method::March | Method::Rays | Method::Comb | Method::Footprint | Method::Auto | Method::Exact => {
            panic!("{method} draws no samples")
        }
    }
}

/// Every order of the voxels.
pub fn orders() -> impl Iterator<Item = VoxelOrder> {
    VoxelOrder::ALL.into_iter().map(|(_, order)| order)
}
