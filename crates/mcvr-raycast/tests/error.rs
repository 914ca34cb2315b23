//! The reference's own error estimate holds, and the march converges to the reference as it should.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::*;
use mcvr_raycast::{MarchOptions, RayOptions, RaycastError, ReferenceOptions, Watch, cast_rays, march};
use mcvr_scene::{Camera, Density, Estimand, Image, Kernel};

fn rmse(a: &Image, b: &Image) -> f64 {
    let d = a.difference(b).unwrap();
    (d.values().iter().map(|v| v * v).sum::<f64>() / d.values().len() as f64).sqrt() / b.mean()
}

#[test]
fn the_true_error_is_below_the_estimate() {
    let grid = plain_grid([13, 11, 9]);
    let d = density(grid.clone(), noise(grid.len()));
    // (azimuth, elevation, parallel): oblique, near an axis, faces edge-on, and exactly along an axis.
    let views = [(30.0, 20.0, false), (1.0, 0.5, false), (30.0, 0.0, true), (0.0, 0.0, true), (0.0, 0.0, false)];
    for kernel in KERNELS {
        for (azimuth, elevation, parallel) in views {
            let camera = look(&grid, azimuth, elevation, parallel, 17);
            let coarse = ReferenceOptions { max_depth: 3, ..options(Estimand::Line, kernel, 1e-2) };
            let r = run(&d, &camera, &coarse);
            let fine = ReferenceOptions { max_depth: 6, ..options(Estimand::Line, kernel, 3e-4) };
            let truth = run(&d, &camera, &fine);
            let (error, estimate) = (rmse(&r.image, &truth.image), r.error.rel_rmse_estimate);
            // The truth's own error counts against the claim, so it stays part of the comparison.
            assert!(
                error <= estimate,
                "{kernel} {azimuth},{elevation} {parallel}: error {error:e} estimate {estimate:e}"
            );
            assert!(
                truth.error.rel_rmse_estimate < 0.5 * estimate,
                "the truth is better: {kernel} {azimuth},{elevation}"
            );
            if r.error.depth_limited == 0 {
                assert!(estimate <= 1e-2);
            }
        }
    }
}

fn scene() -> (Density, Camera) {
    let grid = plain_grid([24, 24, 24]);
    let d = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 30.0, 20.0, false, 32);
    (d, camera)
}

#[test]
fn the_march_converges_to_the_reference_with_the_step() {
    // Same centre rays at a vanishing step, so that the step's error stands alone: second order for tent.
    let (d, camera) = scene();
    let at = |step| march(&d, &camera, &MarchOptions { step, ..MarchOptions::default() }, &Watch::default()).unwrap();
    let limit = at(0.01).image;
    let errors: Vec<f64> = [0.4, 0.2, 0.1].map(|s| rmse(&at(s).image, &limit)).to_vec();
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((1.6..2.6).contains(&order), "order {order} from {errors:?}");
    }
}

#[test]
fn the_march_converges_to_the_reference_with_rays_and_step() {
    let (d, camera) = scene();
    for (estimand, kernel) in
        [(Estimand::Line, Kernel::Tent), (Estimand::Count, Kernel::Tent), (Estimand::Line, Kernel::Bspline3)]
    {
        let truth = run(&d, &camera, &options(estimand, kernel, 3e-4)).image;
        let error = |rays, step, jitter| {
            let rays = RayOptions { rays_per_pixel: rays, jitter, estimand, kernel, seed: 1, average: false, block: 1 };
            let o = MarchOptions { step, random_phase: false, rays };
            rmse(&march(&d, &camera, &o, &Watch::default()).unwrap().image, &truth)
        };
        let centre = error(1, 0.1, false);
        let (few, many) = (error(4, 0.1, true), error(64, 0.1, true));
        // Stratified jitter: R^-1 for a smooth integrand, so 16 times the rays give 1/16 of the error.
        let order = (few / many).ln() / 16f64.ln();
        assert!((0.8..1.3).contains(&order), "{estimand} {kernel}: order {order} ({few} to {many})");
        let grid = error(64, 0.1, false);
        assert!(grid < 0.05 * centre && grid < 3e-3, "{estimand} {kernel}: centre {centre}, 8x8 grid {grid}");
    }
}

#[test]
fn counters_add_up() {
    let (d, camera) = scene();
    let r = run(&d, &camera, &options(Estimand::Line, Kernel::Tent, 1e-3));
    assert_eq!(r.counters.evaluations, 2 * r.counters.cells);
    assert!(r.counters.voxel_reads <= 8 * r.counters.cells && r.counters.voxel_reads > 6 * r.counters.cells);
    let m = march(&d, &camera, &MarchOptions::default(), &Watch::default()).unwrap();
    assert!(m.counters.rays <= 32 * 32 && m.counters.cells == 0);
    assert!(m.counters.voxel_reads <= 8 * m.counters.evaluations);
}

/// A smooth bump: at 32 pixels across, an image without edges.
fn bump() -> Density {
    let grid = plain_grid([24, 24, 24]);
    let weight = |i: usize| {
        let d = |n: usize| (n as f64 - 11.5) / 5.0;
        let square = d(i % 24).powi(2) + d(i / 24 % 24).powi(2) + d(i / 576).powi(2);
        (4e4 * (-0.5 * square).exp()) as u16
    };
    density(grid.clone(), (0..grid.len()).map(weight).collect::<Vec<u16>>())
}

#[test]
fn a_margin_moves_no_ray() {
    let d = bump();
    for parallel in [false, true] {
        let camera = look(d.volume().grid(), 30.0, 20.0, parallel, 32);
        let wide = camera.in_blocks(1, 3).unwrap();
        let rays = RayOptions { kernel: Kernel::Bspline3, ..RayOptions::default() };
        let [plain, wide] = [&camera, &wide].map(|c| cast_rays(&d, c, &rays, &Watch::default()).unwrap().image);
        assert_eq!((wide.extent().width, wide.extent().height), (38, 38));
        for (at, v) in plain.values().iter().enumerate() {
            let w = wide.values()[(at / 32 + 3) * 38 + at % 32 + 3];
            assert!((v - w).abs() <= 1e-9 * plain.max(), "parallel {parallel}, pixel {at}: {v} and {w}");
        }
    }
}

#[test]
fn averaging_over_pixels_lowers_the_error_and_steepens_its_fall() {
    let d = bump();
    for (parallel, estimand) in [(false, Estimand::Line), (true, Estimand::Line), (false, Estimand::Count)] {
        let error = |pixels, side: u32, average| {
            let camera = look(d.volume().grid(), 30.0, 20.0, parallel, pixels);
            let truth = run(&d, &camera, &options(estimand, Kernel::Tent, 1e-6)).image;
            let rays = RayOptions { rays_per_pixel: side * side, average, estimand, ..RayOptions::default() };
            rmse(&cast_rays(&d, &camera, &rays, &Watch::default()).unwrap().image, &truth)
        };
        let order = |e: [f64; 3]| (e[0] / e[2]).log2() / 2.0;
        // In the rays at the same pixels, both fall by the square: what is left is a share of the curvature.
        let [plain, averaged] = [false, true].map(|average| [1, 2, 4].map(|n| error(32, n, average)));
        assert!((1.9..2.1).contains(&order(plain)), "{estimand}: {plain:?}");
        assert!((1.9..2.5).contains(&order(averaged)), "{estimand}: {averaged:?}");
        // In the pixels' size, what is left falls by the square and by a higher power.
        let [plain, averaged] = [false, true].map(|average| [16, 32, 64].map(|pixels| error(pixels, 1, average)));
        assert!((1.9..2.1).contains(&order(plain)), "{estimand}: {plain:?}");
        assert!(order(averaged) > 3.0, "{estimand}: {averaged:?}");
        assert!(plain.iter().zip(averaged).all(|(p, a)| a < 0.06 * p), "{estimand}: {averaged:?} after {plain:?}");
    }
}

#[test]
fn blocks_are_refused_where_they_have_no_meaning() {
    let d = bump();
    let camera = look(d.volume().grid(), 30.0, 20.0, false, 32);
    let good = RayOptions { average: true, block: 2, ..RayOptions::default() };
    let of = |o: RayOptions| cast_rays(&d, &camera, &o, &Watch::default()).err();
    assert_eq!(of(good), None);
    for bad in [
        RayOptions { block: 0, ..good },
        RayOptions { block: 9, ..good },
        RayOptions { average: false, ..good },
        RayOptions { rays_per_pixel: 4, ..good },
    ] {
        assert_eq!(of(bad), Some(RaycastError::Block { given: bad.block, limit: 8 }));
    }
}

#[test]
fn one_ray_may_serve_a_block_of_pixels_where_the_image_is_smooth() {
    let d = bump();
    // Of 65 and 66 pixels, the last blocks reach beyond the image.
    for (parallel, estimand, pixels) in [
        (false, Estimand::Line, 64),
        (true, Estimand::Count, 64),
        (false, Estimand::Count, 66),
        (true, Estimand::Line, 65),
    ] {
        let camera = look(d.volume().grid(), 30.0, 20.0, parallel, pixels);
        let truth = run(&d, &camera, &options(estimand, Kernel::Tent, 1e-6)).image;
        let cast = |block, average| {
            let rays = RayOptions { average, block, estimand, ..RayOptions::default() };
            cast_rays(&d, &camera, &rays, &Watch::default()).unwrap()
        };
        let plain = rmse(&cast(1, false).image, &truth);
        let mut last = rmse(&cast(1, true).image, &truth);
        for block in 2..=4u32 {
            let made = cast(block, true);
            let error = rmse(&made.image, &truth);
            assert!(error > last, "{estimand}, block {block}: {error:e} after {last:e}");
            if block == 2 {
                assert!(
                    error < 0.5 * plain,
                    "{estimand}, parallel {parallel}: {error:e}, a plain ray a pixel {plain:e}"
                );
            }
            last = error;
        }
        // A quarter of the rays; whole tiles of 8 by 8 are cast, which counts for little in a large image.
        let camera = look(d.volume().grid(), 30.0, 20.0, parallel, 4 * pixels);
        let rays = |block| {
            let rays = RayOptions { average: true, block, estimand, ..RayOptions::default() };
            cast_rays(&d, &camera, &rays, &Watch::default()).unwrap().counters.rays
        };
        let [one, four] = [1, 2].map(rays);
        assert!(3 * four < one, "{four} rays, and {one} of one a pixel");
    }
}
