use mcvr::raycast::{Counters, Integrator, MarchOptions, RayOptions};
use mcvr::scene::{Density, Estimand, Image, Kernel};

use crate::clock::error;
use crate::control_variate::{Base, Nets, combed_difference};
use crate::footprint::{FINE, Splats};
use crate::nested::{Chain, coarsen, density_of, residual, whole};
use crate::scenes::Scene;

fn scene(source: &str) -> Scene {
    Scene::load(source, 48, [30.0, 20.0]).unwrap()
}

/// Along every ray, coarse and residual make the fine field, whatever the rule and whether axes are odd or even.
#[test]
fn coarse_and_residual_are_the_volume() {
    for source in ["phantom:vessels@20x21x17", "phantom:lobster@33x16x22"] {
        let scene = scene(source);
        let fine = whole(&scene.density, 1.0).unwrap();
        for fitted in [false, true] {
            let coarse = coarsen(&fine, fitted).unwrap();
            let rest = residual(&fine, &coarse).unwrap();
            let coarse = density_of(coarse.grid, coarse.weights).unwrap().unwrap();
            let [plus, minus] = rest.parts.map(Option::unwrap);
            let value = |density: &Density, px: f64, py: f64| {
                let integrator = Integrator::new(density, Kernel::Tent).unwrap();
                integrator.view(&scene.camera, Estimand::Line).integrate(px, py, &mut Counters::default())
            };
            let mut largest = 0.0f64;
            for n in 0..150 {
                let (px, py) = (f64::from(n % 15) * 3.2 + 0.3, f64::from(n / 15) * 4.7 + 0.9);
                let whole = value(&scene.density, px, py);
                let parts = value(&coarse, px, py) + (value(&plus, px, py) - value(&minus, px, py)) / 8.0;
                largest = largest.max(whole);
                assert!((whole - parts).abs() <= 1e-9 * scene.truth.max(), "{source} {fitted}: {whole} {parts}");
            }
            assert!(largest > 0.0, "no ray has met the volume");
        }
    }
}

/// Square of what the mean over the seeds is off, over what noise alone makes of it, both summed over the pixels: 1 without bias,
/// whatever the noise's distribution.
fn off(images: &[Image], truth: &Image) -> f64 {
    let n = images.len() as f64;
    let (mut squares, mut noise) = (0.0, 0.0);
    for (i, truth) in truth.values().iter().enumerate() {
        let values = || images.iter().map(|image| image.values()[i]);
        let mean = values().sum::<f64>() / n;
        squares += (mean - truth).powi(2);
        noise += values().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0) / n;
    }
    squares / noise
}

/// Three standard deviations for some 150 independent pixels.
const NO_BIAS: std::ops::Range<f64> = 0.65..1.35;

/// Holds the mean over 16 seeds to the truth, and checks that a truth brighter by a twentieth would be told from it.
fn hold(images: &[Image], truth: &Image, what: &str) {
    assert_eq!(images.len(), 16);
    let ratio = off(images, truth);
    assert!(NO_BIAS.contains(&ratio), "{what}: {ratio}");
    let mut wrong = truth.clone();
    wrong.values_mut().iter_mut().for_each(|v| *v *= 1.05);
    let ratio = off(images, &wrong);
    assert!(!NO_BIAS.contains(&ratio), "{what}: the check is blind, {ratio}");
}

#[test]
fn control_variates_are_unbiased() {
    let scene = scene("phantom:lobster@40");
    let chain = Chain::new(&scene.density, 1.0, 2).unwrap();
    let nets = Nets::new(&chain).unwrap();
    let base = Base::Rays(RayOptions { jitter: true, rays_per_pixel: 4, ..RayOptions::default() });
    for samples in [&[1 << 16][..], &[1 << 16, 1 << 15]] {
        let image = |seed| nets.image(base, samples, seed, &scene.camera).unwrap().image;
        let images: Vec<Image> = (1..=16).map(image).collect();
        hold(&images, &scene.truth, &format!("{samples:?}"));
    }
}

/// With jitter, where every pixel has a phase of its own. Over a grid all pixels share one random shift, so that their errors have the
/// same sign for a seed, and 16 seeds say little.
#[test]
fn the_difference_of_combs_is_unbiased() {
    let scene = scene("phantom:lobster@40");
    let chain = Chain::new(&scene.density, 1.0, 1).unwrap();
    let image = |seed| {
        let rays = RayOptions { jitter: true, rays_per_pixel: 4, seed, ..RayOptions::default() };
        let teeth = MarchOptions { step: 3.0, random_phase: true, rays };
        combed_difference(&scene, &chain, teeth).unwrap().image
    };
    let images: Vec<Image> = (1..=16).map(image).collect();
    hold(&images, &scene.truth, "comb difference");
}

/// The bias of footprints, of thin structures at about a voxel a pixel, and that no mass is lost.
#[test]
fn footprints_err_by_less_than_a_percent() {
    let mut scene = Scene::load("phantom:vessels@64", 100, [30.0, 20.0]).unwrap();
    let list = Splats::new(&scene.density);
    for (image, side) in [
        (list.image::<4>(&scene.camera, FINE).unwrap().image, 4),
        (list.image::<6>(&scene.camera, FINE).unwrap().image, 6),
    ] {
        let off = error(&image, &scene.truth);
        assert!(off < 0.01, "{side}: {off}");
        assert!((image.mean() / scene.truth.mean() - 1.0).abs() < 1e-3, "{side}: {}", image.mean());
    }
    scene.truth.values_mut().rotate_right(1);
    assert!(error(&list.image::<4>(&scene.camera, FINE).unwrap().image, &scene.truth) > 0.1, "the check is blind");
}

/// It lacks what the tent smooths across the slices: 1 % here, on structures of some eight voxels.
#[test]
fn joseph_is_near_the_truth_where_the_field_is_smooth() {
    let mut scene = scene("phantom:gaussian@40x32x36");
    let image = crate::joseph::image(&scene.density, &scene.camera, true).unwrap().image;
    let off = error(&image, &scene.truth);
    assert!(off < 0.02, "{off}");
    scene.truth.values_mut().rotate_right(1);
    assert!(error(&image, &scene.truth) > 0.02, "the check is blind");
}

#[test]
fn all_estimators_run() {
    let scene = scene("phantom:vessels@24");
    let measured = crate::measure(&scene, 1, None).unwrap();
    assert!(measured.times.rows.iter().all(|r| r.error.is_finite() && r.seconds > 0.0));
    let page = crate::page::markdown(&[measured]);
    assert!(page.contains("| footprint |") && page.contains("| multilevel |"), "{page}");
}
