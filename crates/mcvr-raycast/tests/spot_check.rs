//! What a few pixels tell of an image's error is, on average, that of all of them.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use std::sync::atomic::AtomicBool;

use common::*;
use mcvr_raycast::{RayOptions, RaycastError, SpotCheck, Watch, cast_rays, spot_check};
use mcvr_scene::{Camera, Density, Estimand, Extent, Image, View};

fn scene() -> (Density, Camera) {
    let n = 32;
    let grid = plain_grid([n; 3]);
    // Cubes of several brightnesses in the dark.
    let voxel = |i: usize| {
        let [x, y, z] = [i % n, i / n % n, i / n / n].map(|v| v / 6);
        if (x + 2 * y + 3 * z) % 4 == 1 { 40 + 30 * (x as u8) } else { 0 }
    };
    let d = density(grid.clone(), (0..n * n * n).map(voxel).collect());
    let camera = Camera::look(&View::default(), &grid, Extent::new(150, 110).unwrap()).unwrap();
    (d, camera)
}

fn cast(d: &Density, camera: &Camera, estimand: Estimand, rays: u32, block: u32) -> Image {
    let options = RayOptions { rays_per_pixel: rays, average: block > 1, block, estimand, ..RayOptions::default() };
    cast_rays(d, camera, &options, &Watch::default()).unwrap().image
}

fn check(d: &Density, camera: &Camera, estimand: Estimand, image: &Image, pixels: usize, seed: u64) -> SpotCheck {
    spot_check(d, camera, estimand, image, pixels, seed, &Watch::default()).unwrap().unwrap()
}

#[test]
fn the_expected_square_is_that_of_the_image() {
    let (d, camera) = scene();
    for estimand in Estimand::ALL {
        let truth = cast(&d, &camera, estimand, 64, 1);
        for block in [1, 3] {
            let image = cast(&d, &camera, estimand, 1, block);
            let off = image.difference(&truth).unwrap();
            let square = off.values().iter().map(|v| v * v).sum::<f64>() / off.values().len() as f64;
            let is = square / image.mean().powi(2);
            let seeds = 400;
            let told: Vec<f64> =
                (0..seeds).map(|seed| check(&d, &camera, estimand, &image, 64, seed).error.powi(2)).collect();
            let mean = told.iter().sum::<f64>() / seeds as f64;
            let spread = told.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (seeds - 1) as f64;
            let z = (mean - is) / (spread / seeds as f64).sqrt();
            assert!(z.abs() < 3.5, "{estimand}, blocks of {block}: {mean} for {is}, z {z}");
            // 64 pixels tell the error itself to a quarter.
            assert!(spread.sqrt() < 0.6 * is, "{estimand}, blocks of {block}: {} of {is}", spread.sqrt());
        }
    }
}

#[test]
fn the_truth_is_not_off() {
    let (d, camera) = scene();
    let truth = cast(&d, &camera, Estimand::Line, 64, 1);
    let told = check(&d, &camera, Estimand::Line, &truth, 50, 3);
    assert!(told.error < 1e-5, "{}", told.error);
    assert_eq!((told.pixels, told.counters.evaluations), (50, 2 * told.counters.cells));
    assert!(told.counters.rays <= 64 * 50 && told.counters.rays > 64 * 25);
    let dark = Image::zeros(camera.extent());
    assert_eq!(check(&d, &camera, Estimand::Line, &dark, 50, 3).error, 0.0);
}

#[test]
fn threads_change_nothing_and_what_cannot_be_is_refused() {
    let (d, camera) = scene();
    let image = cast(&d, &camera, Estimand::Line, 1, 1);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| check(&d, &camera, Estimand::Line, &image, 40, 9))
    };
    assert_eq!(with(1), with(3));
    assert_ne!(with(1), check(&d, &camera, Estimand::Line, &image, 40, 10));
    let grid = plain_grid([16; 3]);
    let wide = density(grid.clone(), vec![1u32; grid.len()]);
    let camera = Camera::look(&View::default(), &grid, camera.extent()).unwrap();
    assert_eq!(spot_check(&wide, &camera, Estimand::Line, &image, 40, 9, &Watch::default()), Ok(None));
    let small = Image::zeros(Extent::new(20, 10).unwrap());
    let refused = spot_check(&d, &camera, Estimand::Line, &small, 40, 9, &Watch::default()).unwrap_err();
    assert!(matches!(&refused, RaycastError::Checked(text) if text.contains("20x10") && text.contains("150x110")));
    let stop = AtomicBool::new(true);
    let cancelled = Watch { cancel: Some(&stop), ..Watch::default() };
    assert_eq!(spot_check(&d, &camera, Estimand::Line, &image, 40, 9, &cancelled), Err(RaycastError::Cancelled));
}
