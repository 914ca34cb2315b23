//! Rays in awkward places, awkward volumes, bad options, threads and cancellation.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use common::*;
use mcvr_raycast::{
    Counters, Integrator, MarchOptions, RayOptions, RaycastError, ReferenceOptions, Watch, march, reference,
};
use mcvr_scene::{Camera, Density, Estimand, Extent, Kernel, View};
use mcvr_volume::Grid;

/// A parallel camera along z: pixel coordinates are world x and y.
fn down(grid: &Grid, side: usize) -> Camera {
    let m = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    Camera::from_matrix(m, Extent::new(side, side).unwrap(), grid, None).unwrap()
}

fn cast(density: &Density, kernel: Kernel, camera: &Camera, px: f64, py: f64) -> f64 {
    let field = Integrator::new(density, kernel).unwrap();
    field.view(camera, Estimand::Line).integrate(px, py, &mut Counters::default())
}

#[test]
fn rays_on_faces_edges_and_corners_get_one_side_or_the_continuous_value() {
    let grid = plain_grid([20, 20, 20]);
    let d = density(grid.clone(), vec![1u8; grid.len()]);
    let camera = down(&grid, 20);
    for (x, y) in [(8.0, 8.0), (7.5, 7.5), (8.0, 7.5), (0.0, 0.0), (19.0, 19.0), (16.0, 3.0)] {
        for kernel in [Kernel::Box, Kernel::Tent] {
            assert!((cast(&d, kernel, &camera, x, y) - 20.0).abs() < 1e-12, "{kernel} at {x},{y}");
        }
    }
    // The border of the support: half-open for box, 0 for the continuous kernels.
    assert_eq!(cast(&d, Kernel::Box, &camera, -0.5, 5.0), 20.0);
    assert_eq!(cast(&d, Kernel::Box, &camera, 19.5, 5.0), 0.0);
    for (x, y) in [(-1.0, 5.0), (20.0, 5.0), (-1.0, -1.0), (25.0, 25.0)] {
        assert!(cast(&d, Kernel::Tent, &camera, x, y).abs() < 1e-12);
    }
}

#[test]
fn diagonal_rays_through_corners_see_the_whole_diagonal() {
    // Along (1, 1, 1) through voxel centres (cell corners of tent) and through voxel corners (box).
    let grid = plain_grid([16, 16, 16]);
    let d = density(grid.clone(), vec![1u8; grid.len()]);
    let view =
        View { azimuth: 225.0, elevation: -(0.5f64.sqrt()).atan().to_degrees(), parallel: true, ..View::default() };
    let camera = Camera::look(&view, &grid, Extent::new(30, 30).unwrap()).unwrap();
    let value = cast(&d, Kernel::Box, &camera, 15.0, 15.0);
    assert!((value - 16.0 * 3f64.sqrt()).abs() < 1e-6, "{value}");
    // Tent: the sum of 1 over 15 voxels and two ends of ∫ (1-t)³ dt = 1/4 each.
    let value = cast(&d, Kernel::Tent, &camera, 15.0, 15.0);
    assert!((value - 15.5 * 3f64.sqrt()).abs() < 1e-6, "{value}");
}

#[test]
fn empty_bricks_change_nothing_but_the_work() {
    // A faint constant makes every brick occupied; the field is linear in the weights, so subtract it again.
    let grid = plain_grid([40, 33, 27]);
    let mut voxels = vec![0f32; grid.len()];
    for n in (0..grid.len()).step_by(2971) {
        voxels[n] = 50.0 + (n % 97) as f32;
    }
    let sparse = density(grid.clone(), voxels.clone());
    let full = density(grid.clone(), voxels.iter().map(|v| v + 1.0).collect());
    let ones = density(grid.clone(), vec![1f32; grid.len()]);
    let camera = look(&grid, 37.0, -12.0, false, 32);
    for kernel in KERNELS {
        let fields = [&sparse, &full, &ones].map(|d| Integrator::new(d, kernel).unwrap());
        let mut work = [Counters::default(); 3];
        for i in 0..2000 {
            let (px, py) = (32.0 * (i as f64 * 0.618).fract(), 32.0 * (i as f64 * 0.754).fract());
            let v: Vec<f64> =
                (0..3).map(|f| fields[f].view(&camera, Estimand::Line).integrate(px, py, &mut work[f])).collect();
            assert!((v[0] - (v[1] - v[2])).abs() < 1e-9, "{kernel} at {px},{py}: {v:?}");
        }
        assert!(work[0].empty_bricks > 0 && work[0].cells < work[1].cells, "{:?}", work);
    }
}

#[test]
fn flat_and_single_voxel_volumes_keep_their_mass() {
    for dims in [[1, 1, 1], [1, 6, 1], [5, 1, 3], [1, 1, 9]] {
        let grid = plain_grid(dims);
        let d = density(grid.clone(), vec![7u8; grid.len()]);
        for parallel in [false, true] {
            let camera = look(&grid, 30.0, 20.0, parallel, 12);
            for kernel in KERNELS {
                let r = run(&d, &camera, &options(Estimand::Count, kernel, 1e-4));
                assert!((r.image.sum() - 1.0).abs() < 1e-5, "{dims:?} {kernel}: {}", r.image.sum());
                let rays =
                    RayOptions { kernel, estimand: Estimand::Count, rays_per_pixel: 64, ..RayOptions::default() };
                let o = MarchOptions { step: 0.1, ..rays.into() };
                let m = march(&d, &camera, &o, &Watch::default()).unwrap();
                assert!((m.image.sum() - 1.0).abs() < 0.02, "{dims:?} {kernel}: {}", m.image.sum());
            }
        }
    }
}

#[test]
fn an_eye_inside_the_volume_sees_only_what_lies_beyond_the_near_plane() {
    let grid = plain_grid([30, 30, 30]);
    let d = density(grid.clone(), vec![1u8; grid.len()]);
    for near in [0.5, 3.0, 10.0] {
        let view = View { azimuth: 0.0, elevation: 0.0, distance: Some(5.0), near: Some(near), ..View::default() };
        let camera = Camera::look(&view, &grid, Extent::new(11, 11).unwrap()).unwrap();
        // From x = 14.5 + 5 towards -x: the box ends at -0.5, 20 mm ahead.
        let value = cast(&d, Kernel::Box, &camera, 5.5, 5.5);
        assert!((value - (20.0 - near)).abs() < 1e-9, "near {near}: {value}");
        for estimand in Estimand::ALL {
            for kernel in KERNELS {
                let r = run(&d, &camera, &options(estimand, kernel, 1e-3));
                assert!(r.image.values().iter().all(|v| v.is_finite() && *v > 0.0));
            }
        }
    }
}

#[test]
fn images_do_not_depend_on_the_number_of_threads() {
    let grid = skewed_grid([20, 17, 14]);
    let d = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 30.0, 20.0, false, 25);
    let all = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let r = run(&d, &camera, &options(Estimand::Line, Kernel::Tent, 1e-3));
            let o = MarchOptions::from(RayOptions { rays_per_pixel: 3, seed: 5, ..RayOptions::default() });
            let m = march(&d, &camera, &o, &Watch::default()).unwrap();
            (r.image, r.error, r.counters, m.image, m.counters)
        })
    };
    let one = all(1);
    assert_eq!(one, all(2));
    assert_eq!(one, all(16));
}

#[test]
fn unusable_options_are_refused_with_the_value() {
    let grid = plain_grid([2, 2, 2]);
    let d = density(grid.clone(), vec![1u8; 8]);
    let camera = look(&grid, 0.0, 0.0, false, 2);
    let w = Watch::default();
    let good = ReferenceOptions::default();
    let o = ReferenceOptions { kernel: Kernel::Shell, ..good };
    assert_eq!(reference(&d, &camera, &o, &w), Err(RaycastError::Shell));
    for tolerance in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let o = ReferenceOptions { tolerance, ..good };
        assert!(matches!(reference(&d, &camera, &o, &w), Err(RaycastError::Tolerance(_))));
    }
    let o = ReferenceOptions { max_depth: 17, ..good };
    assert!(reference(&d, &camera, &o, &w).unwrap_err().to_string().contains("16 times, got 17"));
    let good = MarchOptions::default();
    for step in [0.0, -0.5, f64::NAN] {
        assert!(matches!(march(&d, &camera, &MarchOptions { step, ..good }, &w), Err(RaycastError::Step(_))));
    }
    let smallest = good.smallest_step(d.volume().grid());
    let march_with = |step| march(&d, &camera, &MarchOptions { step, ..good }, &w);
    assert!(matches!(march_with(1e-30), Err(RaycastError::Steps { .. })));
    assert!(matches!(march_with(0.999 * smallest), Err(RaycastError::Steps { .. })));
    let o = MarchOptions::from(RayOptions { rays_per_pixel: 0, ..good.rays });
    assert!(matches!(march(&d, &camera, &o, &w), Err(RaycastError::Rays { given: 0, .. })));
    let o = MarchOptions::from(RayOptions { kernel: Kernel::Shell, ..good.rays });
    assert_eq!(march(&d, &camera, &o, &w), Err(RaycastError::Shell));
}

#[test]
fn work_reports_every_row_and_stops_when_told() {
    let grid = plain_grid([9, 9, 9]);
    let d = density(grid.clone(), vec![1u8; grid.len()]);
    let camera = look(&grid, 30.0, 20.0, false, 20);
    let (rows, stop) = (AtomicU64::new(0), AtomicBool::new(false));
    let count = |n: u64| {
        rows.fetch_add(n, Ordering::Relaxed);
    };
    let watch = Watch { progress: Some(&count), cancel: Some(&stop) };
    reference(&d, &camera, &ReferenceOptions::default(), &watch).unwrap();
    assert_eq!(rows.swap(0, Ordering::Relaxed), 20);
    march(&d, &camera, &MarchOptions::default(), &watch).unwrap();
    assert_eq!(rows.load(Ordering::Relaxed), 20);
    stop.store(true, Ordering::Relaxed);
    assert_eq!(reference(&d, &camera, &ReferenceOptions::default(), &watch), Err(RaycastError::Cancelled));
    assert_eq!(march(&d, &camera, &MarchOptions::default(), &watch), Err(RaycastError::Cancelled));
}

#[test]
fn a_volume_far_smaller_than_a_pixel_is_found() {
    // Every centre ray misses; the first squares are no wider than two voxels, so the fine points cannot.
    let grid = plain_grid([2, 2, 2]);
    let d = density(grid.clone(), vec![5u8; 8]);
    let view = View { distance: Some(300.0), fov: Some(40.0), ..View::default() };
    let camera = Camera::look(&view, &grid, Extent::new(4, 4).unwrap()).unwrap();
    let o = ReferenceOptions { max_depth: 8, ..options(Estimand::Count, Kernel::Tent, 1e-4) };
    let r = run(&d, &camera, &o);
    assert!((r.image.sum() - 1.0).abs() < 1e-3, "{}", r.image.sum());
}

/// From so far away that a double's coordinates in voxels mean nothing, a march still gives finite pixels.
#[test]
fn views_from_beyond_all_precision_stay_within_the_volume() {
    let grid = skewed_grid([9, 8, 7]);
    let d = density(grid.clone(), (0..grid.len()).map(|n| (n * 7919 % 251) as u8).collect());
    for distance in [1e9, 1e15, 1e18, 1e25, 1e30, 1e100] {
        for parallel in [false, true] {
            let view = View { distance: Some(distance * grid.diameter()), parallel, ..View::default() };
            let Ok(camera) = Camera::look(&view, &grid, Extent::new(12, 9).unwrap()) else { continue };
            for kernel in [Kernel::Box, Kernel::Tent, Kernel::Bspline3] {
                for estimand in Estimand::ALL {
                    let options = MarchOptions::from(RayOptions { kernel, estimand, ..RayOptions::default() });
                    let image = march(&d, &camera, &options, &Watch::default()).unwrap().image;
                    assert!(
                        image.values().iter().all(|v| v.is_finite()),
                        "march {kernel} {estimand} from {distance:e}"
                    );
                }
            }
        }
    }
}
