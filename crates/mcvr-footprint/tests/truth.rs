//! Holds footprints to the reference, and to themselves.
#![allow(clippy::unwrap_used, reason = "tests fail so")]

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use glam::{DMat3, DQuat, DVec3};
use mcvr_footprint::{FootprintError, FootprintOptions, Refine, footprints, footprints_in_all, predicted_error};
use mcvr_raycast::{ReferenceOptions, reference};
use mcvr_scene::{Camera, Density, DensityMap, Estimand, Extent, Image, Kernel, Transfer, View, Watch};
use mcvr_volume::{Grid, SimdLevel, Volume, Voxel};

/// Reproducible numbers from 0 to 1.
fn random(n: usize) -> Vec<f64> {
    let mut state = 99u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1u64 << 24) as f64
    };
    (0..n).map(|_| next()).collect()
}

/// Independent voxels, a bump, or a bent tube with nothing around it.
fn field(kind: &str, grid: Grid) -> Density {
    let dims = grid.dims();
    let random = random(grid.len());
    let value = |n: usize| {
        let p = grid.unravel(n);
        let u: [f64; 3] = std::array::from_fn(|a| (p[a] as f64 + 0.5) / dims[a] as f64 - 0.5);
        match kind {
            "noise" => random[n] as f32,
            "bump" => (-25.0 * u.iter().map(|u| u * u).sum::<f64>()).exp() as f32,
            _ => f32::from(u8::from((u[0] - 0.2 * (7.0 * u[2]).sin()).hypot(u[1] - 0.3 * u[2]) < 0.1)),
        }
    };
    density((0..grid.len()).map(value).collect(), grid, DensityMap::default())
}

fn density<T: Voxel>(voxels: Vec<T>, grid: Grid, map: DensityMap) -> Density {
    Density::new(&Volume::from_vec(grid, voxels, "test").unwrap(), map).unwrap()
}

fn cubic(n: usize) -> Grid {
    Grid::with_spacing([n, n - 1, n + 2], [0.8; 3]).unwrap()
}

/// Unequal spacings, turned, one axis mirrored, away from the origin.
fn skewed(n: usize) -> Grid {
    let turn = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -0.7, 1.1));
    let mirror = DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
    Grid::new([n, n - 3, n - 5], DVec3::new(0.7, 1.0, 1.6), DVec3::new(-31.0, 12.0, 55.0), turn * mirror).unwrap()
}

fn camera(density: &Density, view: &View, side: usize) -> Camera {
    Camera::look(view, density.volume().grid(), Extent::new(side, side + 7).unwrap()).unwrap()
}

fn made(density: &Density, camera: &Camera, options: &FootprintOptions) -> Image {
    footprints(density, camera, options, &Watch::default()).unwrap().image
}

fn truth(density: &Density, camera: &Camera, estimand: Estimand) -> Image {
    let options = ReferenceOptions { estimand, tolerance: 3e-4, ..ReferenceOptions::default() };
    reference(density, camera, &options, &Watch::default()).unwrap().image
}

/// RMSE over the mean pixel of the truth.
fn error(image: &Image, truth: &Image) -> f64 {
    let sum: f64 = image.values().iter().zip(truth.values()).map(|(a, b)| (a - b) * (a - b)).sum();
    (sum / truth.values().len() as f64).sqrt() / truth.mean()
}

const OBLIQUE: View = View { azimuth: 30.0, elevation: 20.0, distance: None, fov: None, parallel: false, near: None };

/// Every field, estimand, view and size of voxels, below what the law says.
#[test]
fn bias_is_what_is_stated() {
    let mut sums = 0.0;
    for kind in ["noise", "bump", "tube"] {
        for (azimuth, elevation) in [(30.0, 20.0), (0.0, 0.0), (45.0, 35.26)] {
            for (n, side) in [(48, 24), (28, 60), (14, 90), (8, 150)] {
                for (parallel, estimand) in [(false, Estimand::Line), (false, Estimand::Count), (true, Estimand::Line)]
                {
                    let density = field(kind, cubic(n));
                    let camera = camera(&density, &View { azimuth, elevation, parallel, ..OBLIQUE }, side);
                    let options = FootprintOptions { estimand, ..FootprintOptions::default() };
                    let (image, mut truth) = (made(&density, &camera, &options), truth(&density, &camera, estimand));
                    let (off, stated) = (error(&image, &truth), predicted_error(&density, &camera, &options));
                    let what = format!("{kind} {azimuth},{elevation} {n} in {side}, parallel {parallel}, {estimand}");
                    assert!(off < 2.0 * stated + 3e-4, "{what}: {off} of {stated}");
                    sums += off / stated;
                    truth.values_mut().rotate_right(1);
                    assert!(error(&image, &truth) > 2.0 * stated, "{what}: the check is blind");
                }
            }
        }
    }
    assert!((0.2 * 108.0..108.0).contains(&sums), "the law is about right: {sums}");
}

#[test]
fn parts_make_up_for_voxels_that_are_no_cubes() {
    for kind in ["noise", "tube"] {
        for (n, side) in [(28, 50), (14, 80)] {
            let density = field(kind, skewed(n));
            let camera = camera(&density, &OBLIQUE, side);
            let truth = truth(&density, &camera, Estimand::Line);
            let options = |refine| FootprintOptions { refine, ..Default::default() };
            let off = |refine| error(&made(&density, &camera, &options(refine)), &truth);
            let stated = predicted_error(&density, &camera, &options(Refine::Cubic(1)));
            let (one, parts, two) = (off(Refine::Each(1)), off(Refine::Cubic(1)), off(Refine::Each(2)));
            assert!(
                parts < one && parts < 2.0 * stated && two < 0.5 * one,
                "{kind} {n}: {one} {parts} {two}, {stated}"
            );
        }
    }
}

/// All that a voxel has lands in the image, wherever it is seen from; `line` by the factor at its place.
#[test]
fn the_whole_mass_of_one_voxel_lands() {
    for grid in [cubic(9), skewed(9)] {
        let mut voxels = vec![0u8; grid.len()];
        voxels[grid.linear([3, 4, 2])] = 17;
        let density = density(voxels, grid, DensityMap::default());
        let at = density.volume().grid().index_to_world().transform_point3(DVec3::new(3.0, 4.0, 2.0));
        for parallel in [false, true] {
            for side in [5, 40, 700] {
                let camera = camera(&density, &View { parallel, ..OBLIQUE }, side);
                for refine in [Refine::Cubic(1), Refine::Each(1)] {
                    let options = FootprintOptions { estimand: Estimand::Count, refine, ..Default::default() };
                    let sum = made(&density, &camera, &options).sum();
                    assert!((sum - 1.0).abs() < 1e-6, "{side} {refine:?}: {sum}");
                    let (px, py, z) = camera.project(at);
                    let line = density.mass() * camera.line_factor(px, py, z);
                    let sum = made(&density, &camera, &FootprintOptions { estimand: Estimand::Line, ..options }).sum();
                    assert!((sum / line - 1.0).abs() < 1e-3, "{side} {refine:?}: {sum} {line}");
                }
            }
        }
    }
}

#[test]
fn voxels_beside_and_behind_the_image_are_left_out() {
    let density = field("noise", cubic(24));
    let diameter = density.volume().grid().diameter();
    for view in [
        View { fov: Some(6.0), ..OBLIQUE },
        // The eye is in the volume: voxels before the near plane count for nothing, those cut by it wholly or not.
        View { distance: Some(0.2 * diameter), near: Some(0.1 * diameter), fov: Some(40.0), ..OBLIQUE },
    ] {
        for estimand in Estimand::ALL {
            let camera = camera(&density, &view, 60);
            let truth = truth(&density, &camera, estimand);
            let off = error(&made(&density, &camera, &FootprintOptions { estimand, ..Default::default() }), &truth);
            let bound = if view.distance.is_some() { 0.06 } else { 0.01 };
            assert!(off < bound, "{view:?} {estimand}: {off}");
        }
    }
    let grid = density.volume().grid();
    let away = Camera::from_matrix(
        [[0.0, 30.0, 0.0, 1e6], [0.0, 0.0, 30.0, 0.0], [1.0, 0.0, 0.0, 60.0]],
        Extent::new(20, 20).unwrap(),
        grid,
        None,
    );
    let beside = footprints(&density, &away.unwrap(), &FootprintOptions::default(), &Watch::default()).unwrap();
    assert_eq!((beside.image.max(), beside.counters.footprints), (0.0, 0));
}

/// Threads and vector instructions.
#[test]
fn bits_are_the_same_however_they_are_made() {
    let views = [OBLIQUE, View { parallel: true, ..OBLIQUE }, View { distance: Some(9.0), near: Some(2.0), ..OBLIQUE }];
    for (grid, view) in [cubic(40), skewed(30)].into_iter().flat_map(|g| views.map(|v| (g.clone(), v))) {
        let density = field("noise", grid);
        let camera = camera(&density, &view, 90);
        let run = |threads, level| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let options = FootprintOptions { level, ..Default::default() };
            let made = pool.install(|| footprints(&density, &camera, &options, &Watch::default())).unwrap();
            (made.image, made.counters)
        };
        let expected = run(1, Some(SimdLevel::Portable));
        assert!(expected.1.footprints > 1 << 15 && expected.0.mean() > 0.0);
        for level in SimdLevel::available() {
            assert!(run(1, Some(level)) == expected, "{level:?}");
        }
        for threads in [2, 4] {
            assert!(run(threads, None) == expected, "{threads} threads");
        }
    }
}

#[test]
fn every_type_and_map_weighs_what_the_density_says() {
    fn check<T: Voxel>(map: DensityMap, value: impl Fn(usize) -> T) {
        let grid = Grid::with_spacing([19, 13, 10], [1.0; 3]).unwrap();
        let density = density((0..grid.len()).map(value).collect(), grid.clone(), map);
        let weights: Vec<f64> = (0..grid.len()).map(|n| density.weight(n)).collect();
        let plain = self::density(weights, grid, DensityMap::default());
        let camera = camera(&density, &OBLIQUE, 30);
        let options = FootprintOptions::default();
        let (image, expected) = (made(&density, &camera, &options), made(&plain, &camera, &options));
        assert!(error(&image, &expected) < 1e-6, "{}", T::TYPE);
        let counters = footprints(&density, &camera, &options, &Watch::default()).unwrap().counters;
        assert_eq!(counters.footprints, footprints_in_all(&density, &options), "all are in view");
        assert!([16, 36].map(|n| n * counters.footprints).contains(&counters.pixels_touched), "{counters:?}");
        assert!(counters.voxels_visited >= counters.footprints && counters.voxels_visited <= 19 * 13 * 10);
    }
    let line = |slope, intercept| DensityMap { transfer: Transfer::Linear { slope, intercept }, ..Default::default() };
    let ends = DensityMap {
        transfer: Transfer::Piecewise(vec![[0.0, 0.0], [10.0, 1.0], [20.0, 0.0], [30.0, 0.0], [40.0, 1.0]]),
        ..Default::default()
    };
    check(DensityMap::default(), |i| (i * 37 % 251) as u8);
    check(line(1.0, -200.0), |i| (i * 37 % 251) as u8);
    check(ends, |i| (i * 37 % 100) as i8);
    check(line(0.3, -5.0), |i| (i * 37 % 251) as u16);
    check(line(0.3, 5.0), |i| (i * 37 % 251) as i16 - 120);
    check(line(1e-30, -1e-29), |i| (i * 37 % 251) as u32);
    check(line(1e30, 0.0), |i| (i * 37 % 251) as i32 - 100);
    check(DensityMap::default(), |i| (i * 37 % 251) as f32 - 100.0);
    check(line(1e200, 0.0), |i| (i * 37 % 251) as f64 * 1e-10);
}

#[test]
fn progress_is_told_and_work_is_stopped() {
    let density = field("noise", cubic(40));
    let camera = camera(&density, &OBLIQUE, 50);
    let told = AtomicU64::new(0);
    let count = |n: u64| {
        told.fetch_add(n, Ordering::Relaxed);
    };
    let options = FootprintOptions::default();
    footprints(&density, &camera, &options, &Watch { progress: Some(&count), cancel: None }).unwrap();
    assert_eq!(told.load(Ordering::Relaxed), 57);
    let cancel = AtomicBool::new(false);
    let stop = |_: u64| cancel.store(true, Ordering::Relaxed);
    let watch = Watch { progress: Some(&stop), cancel: Some(&cancel) };
    assert_eq!(footprints(&density, &camera, &options, &watch), Err(FootprintError::Cancelled));
}

#[test]
fn unusable_input_is_refused_in_words() {
    let density = field("bump", cubic(9));
    let camera = camera(&density, &OBLIQUE, 20);
    let refused =
        |options: FootprintOptions| footprints(&density, &camera, &options, &Watch::default()).unwrap_err().to_string();
    for kernel in [Kernel::Box, Kernel::Bspline3, Kernel::Shell] {
        let text = refused(FootprintOptions { kernel, ..Default::default() });
        assert!(text.contains(kernel.name()) && text.contains("tent"), "{text}");
    }
    for refine in [0, 9] {
        let text = refused(FootprintOptions { refine: Refine::Each(refine), ..Default::default() });
        assert!(text.contains(&format!("got {refine}")) && text.contains("1 to 8"), "{text}");
    }
    let long = Grid::with_spacing([(1 << 24) + 1, 1, 1], [1.0; 3]).unwrap();
    let text = FootprintOptions::default().check(&long).unwrap_err().to_string();
    assert!(text.contains("16777217") && text.contains("16777216"), "{text}");
}
