//! Every unit of mass arrives: `count` sums to 1 over an image that holds the whole volume.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::*;
use glam::DVec3;
use mcvr_raycast::ReferenceOptions;
use mcvr_scene::{Camera, Estimand, Kernel};

fn whole(kernel: Kernel, views: &[(f64, f64)], tolerance: f64, max_depth: u32) -> f64 {
    let dims = [5, 4, 3];
    let mut worst: f64 = 0.0;
    for grid in [plain_grid(dims), skewed_grid(dims)] {
        let d = density(grid.clone(), noise(grid.len()));
        for &(azimuth, elevation) in views {
            for parallel in [false, true] {
                let camera = look(&grid, azimuth, elevation, parallel, 9);
                let o = ReferenceOptions { max_depth, ..options(Estimand::Count, kernel, tolerance) };
                let r = run(&d, &camera, &o);
                let off = (r.image.sum() - 1.0).abs();
                let claim = r.error.image.sum();
                assert!(
                    off <= claim + 1e-9,
                    "{kernel} {azimuth},{elevation} {parallel}: off by {off:e}, not {claim:e}"
                );
                worst = worst.max(off);
            }
        }
    }
    worst
}

#[test]
fn count_sums_to_one_for_tent_and_bspline3() {
    for kernel in [Kernel::Tent, Kernel::Bspline3] {
        let worst = whole(kernel, &[(3.0, 2.0), (30.0, 20.0), (-125.0, -61.0)], 1e-5, 7);
        assert!(worst < 1e-6, "{kernel}: {worst:e}");
    }
}

#[test]
fn count_sums_to_one_for_box() {
    let worst = whole(Kernel::Box, &[(30.0, 20.0), (-125.0, -61.0)], 1e-5, 10);
    assert!(worst < 1e-6, "{worst:e}");
    // Faces seen edge-on by a pinhole are steep ramps that cost millions of rays at that tolerance.
    let worst = whole(Kernel::Box, &[(3.0, 2.0)], 3e-4, 6);
    assert!(worst < 5e-4, "{worst:e}");
}

#[test]
fn line_of_a_parallel_camera_is_count_times_mass_per_pixel_area() {
    let grid = skewed_grid([6, 5, 4]);
    let d = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 12.0, 34.0, true, 16);
    for kernel in KERNELS {
        let count = run(&d, &camera, &options(Estimand::Count, kernel, 1e-4));
        let line = run(&d, &camera, &options(Estimand::Line, kernel, 1e-4));
        let factor = camera.line_factor(0.0, 0.0, 1.0) * d.mass();
        for (c, l) in count.image.values().iter().zip(line.image.values()) {
            assert!((c * factor - l).abs() <= 1e-9 * line.image.max(), "{kernel}");
        }
    }
}

#[test]
fn a_distant_pinhole_approaches_the_parallel_image() {
    // Same middle, same magnification there: what is left is the perspective, some part in the distance.
    let grid = plain_grid([6, 5, 4]);
    let d = density(grid.clone(), noise(grid.len()));
    let axis = DVec3::new(0.36, 0.48, 0.8);
    let (right, up) = (axis.any_orthonormal_vector(), axis.cross(axis.any_orthonormal_vector()));
    let centre = grid.centre();
    let extent = mcvr_scene::Extent::new(12, 12).unwrap();
    let row = |v: DVec3, w: f64| [v.x, v.y, v.z, w];
    let distance = 1e7;
    let parallel = [row(right, 6.0 - right.dot(centre)), row(up, 6.0 - up.dot(centre)), [0.0, 0.0, 0.0, 1.0]];
    let tilt = |v: DVec3| row(v * distance + axis * 6.0, 6.0 * distance - (v * distance + axis * 6.0).dot(centre));
    let pinhole = [tilt(right), tilt(up), row(axis, distance - axis.dot(centre))];
    for kernel in KERNELS {
        let tolerance = if kernel == Kernel::Box { 1e-3 } else { 1e-4 };
        let image = |m| {
            let camera = Camera::from_matrix(m, extent, &grid, None).unwrap();
            run(&d, &camera, &options(Estimand::Line, kernel, tolerance)).image
        };
        let (p, q) = (image(parallel), image(pinhole));
        let worst = p.difference(&q).unwrap().values().iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        assert!(worst < tolerance * p.max(), "{kernel}: {}", worst / p.max());
    }
}
