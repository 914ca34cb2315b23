//! Rays through fields whose integrals are known.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::*;
use glam::DVec3;
use mcvr_raycast::{Counters, Integrator};
use mcvr_scene::{Camera, Density, DensityMap, Estimand, Extent, Kernel};
use mcvr_volume::{Grid, Phantom};
use proptest::prelude::*;

fn cast(density: &Density, kernel: Kernel, camera: &Camera, px: f64, py: f64) -> f64 {
    let field = Integrator::new(density, kernel).unwrap();
    let rays = field.view(camera, Estimand::Line);
    rays.integrate(px, py, &mut Counters::default())
}

/// A parallel camera along a world axis whose pixel coordinates are the two other world coordinates (cyclic) in mm.
fn along(axis: usize, grid: &Grid) -> Camera {
    let mut m = [[0.0; 4]; 3];
    m[0][(axis + 1) % 3] = 1.0;
    m[1][(axis + 2) % 3] = 1.0;
    m[2][3] = 1.0;
    Camera::from_matrix(m, Extent::new(16, 16).unwrap(), grid, None).unwrap()
}

/// Length in mm of the camera's ray inside the box [low, high] (index coordinates), by clipping in world space.
fn chord(grid: &Grid, camera: &Camera, px: f64, py: f64, low: DVec3, high: DVec3) -> f64 {
    let ray = camera.ray(px, py);
    let to_index = grid.world_to_index();
    let o = to_index.transform_point3(ray.origin);
    let d = to_index.transform_vector3(ray.direction);
    let (p, q) = ((low - o) / d, (high - o) / d);
    let (from, to) = (p.min(q).max_element().max(ray.start), p.max(q).min_element());
    (to - from).max(0.0)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn a_uniform_box_gives_the_chord(
        px in 0.0..20.0f64, py in 0.0..20.0f64, azimuth in 0.0..360.0f64, elevation in -90.0..90.0f64, parallel: bool,
    ) {
        let grid = skewed_grid([7, 30, 11]);
        let d = density(grid.clone(), vec![100u8; grid.len()]);
        let camera = look(&grid, azimuth, elevation, parallel, 20);
        let high = DVec3::new(6.5, 29.5, 10.5);
        let exact = 100.0 * chord(&grid, &camera, px, py, DVec3::splat(-0.5), high);
        let value = cast(&d, Kernel::Box, &camera, px, py);
        prop_assert!((value - exact).abs() <= 1e-9 * (exact + 100.0), "{value} {exact}");
    }

    #[test]
    fn one_voxel_gives_the_integral_of_its_kernel(
        px in 4.0..16.0f64, py in 4.0..16.0f64, azimuth in 0.0..360.0f64, elevation in -90.0..90.0f64, parallel: bool,
    ) {
        let grid = skewed_grid([3, 3, 3]);
        let mut voxels = vec![0u8; 27];
        voxels[13] = 200;
        let d = density(grid.clone(), voxels);
        let camera = look(&grid, azimuth, elevation, parallel, 20);
        let ray = camera.ray(px, py);
        let to_index = grid.world_to_index();
        for kernel in [Kernel::Tent, Kernel::Bspline3] {
            let value = cast(&d, kernel, &camera, px, py);
            let (n, reach) = (4000, 2.0 * grid.spacing().length());
            let middle = (grid.centre() - ray.origin).dot(ray.direction);
            let dl = 2.0 * reach / n as f64;
            let sum: f64 = (0..n)
                .map(|i| {
                    let l = middle - reach + (i as f64 + 0.5) * dl;
                    let t = to_index.transform_point3(ray.origin + ray.direction * l) - 1.0;
                    (0..3).map(|a| kernel.density(t[a]).unwrap()).product::<f64>()
                })
                .sum();
            // Midpoint rule: second derivative (with its jumps) times dl² / 24.
            prop_assert!((value - 200.0 * sum * dl).abs() < 2e-3, "{kernel}: {value} {}", 200.0 * sum * dl);
        }
    }
}

#[test]
fn one_voxels_tent_along_an_axis_through_its_centre_is_one_spacing() {
    let grid = Grid::with_spacing([5, 5, 5], [0.5, 2.0, 3.0]).unwrap();
    let mut voxels = vec![0u8; 125];
    voxels[62] = 10;
    let d = density(grid.clone(), voxels);
    for axis in 0..3 {
        let h = grid.spacing();
        let camera = along(axis, &grid);
        let (px, py) = (2.0 * h[(axis + 1) % 3], 2.0 * h[(axis + 2) % 3]);
        for (kernel, peak) in [(Kernel::Box, 1.0), (Kernel::Tent, 1.0), (Kernel::Bspline3, 4.0 / 9.0)] {
            let value = cast(&d, kernel, &camera, px, py);
            assert!((value - 10.0 * h[axis] * peak).abs() < 1e-12, "{kernel} along {axis}: {value}");
        }
    }
}

#[test]
fn a_linear_ramp_is_reproduced_between_voxels() {
    let dims = [12, 9, 8];
    let grid = plain_grid(dims);
    let d = density(grid.clone(), (0..grid.len()).map(|n| (n % 12) as u16).collect());
    for kernel in [Kernel::Tent, Kernel::Bspline3] {
        for (x, z) in [(4.0, 3.0), (3.25, 4.5), (7.9, 2.1), (2.0, 5.0)] {
            // Along y at height x: x per voxel, 9 voxels with their whole kernels; px is z, py is x.
            let value = cast(&d, kernel, &along(1, &grid), z, x);
            assert!((value - 9.0 * x).abs() < 1e-11, "{kernel}: {value} {}", 9.0 * x);
            // Along x the integral is the sum of all voxels of the row.
            let value = cast(&d, kernel, &along(0, &grid), 4.0, z);
            assert!((value - 66.0).abs() < 1e-11, "{kernel}: {value}");
        }
    }
    assert_eq!(cast(&d, Kernel::Box, &along(1, &grid), 3.2, 6.7), 63.0);
}

#[test]
fn ellipsoid_chords_agree_within_the_voxelisation() {
    for (name, limit) in [("ellipsoids@96", 0.08), ("shepp-logan@96", 0.15)] {
        let phantom = Phantom::parse(name).unwrap();
        let volume = phantom.generate().unwrap();
        let table = phantom.ellipsoids().unwrap();
        let d = Density::new(&volume, DensityMap::default()).unwrap();
        for parallel in [false, true] {
            let camera = look(volume.grid(), 33.0, 21.0, parallel, 40);
            let (mut error, mut sum) = (0.0, 0.0);
            for y in 0..40 {
                for x in 0..40 {
                    let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
                    let ray = camera.ray(px, py);
                    let exact: f64 = table.iter().map(|e| e.line_integral(ray.origin, ray.direction)).sum();
                    let value = cast(&d, Kernel::Tent, &camera, px, py);
                    error += (value - exact).powi(2);
                    sum += exact;
                }
            }
            let rmse = (error / 1600.0).sqrt() / (sum / 1600.0);
            assert!(rmse < limit, "{name} parallel {parallel}: RMSE {rmse} of the mean");
        }
    }
}
