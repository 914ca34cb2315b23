//! Every effect under every kernel and estimand converges to the image that ray casting gives of it.
//!
//! The test is that of [`common::agreement`], on the channels of an image one below the other. A false alarm anywhere in this
//! file has probability 1e-3.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::agreement::{Agreement, Truth, agreement};
use common::*;
use mcvr::raycast::{ReferenceOptions, reference_with_look};
use mcvr::scene::effects::{Colour, DepthColour, DepthCue, Light, LightPosition, Material, Shading, Sides, Unlisted};
use mcvr::scene::{Effects, Estimand, Extent, Image, Kernel, View, Watch};
use mcvr::{Method, Request, Scenery};

/// Independent replicates of each image.
const REPLICATES: u64 = 64;
/// Samples of a replicate.
const SAMPLES: u64 = 1 << 15;
/// Error of the ray caster's pixels over their mean. All replicates together leave about 1 % a pixel.
const TOLERANCE: f64 = 2e-3;

fn stack(channels: &[Image]) -> Image {
    let extent = channels[0].extent();
    let values = channels.iter().flat_map(|c| c.values().iter().copied()).collect();
    Image::from_values(Extent::new(extent.width, extent.height * channels.len()).unwrap(), values).unwrap()
}

/// The channels of a scenery's image, one below the other.
fn picture(scenery: &Scenery, request: &Request) -> Image {
    made(scenery, request).measurable().unwrap().into_owned()
}

fn replicates(scenery: &Scenery, request: Request) -> Vec<Image> {
    let fields = [request.method as u64, request.kernel as u64, request.estimand as u64];
    let key = fields.into_iter().fold(request.samples + 17, |key, field| key << 3 | field);
    let one = |r| picture(scenery, &Request { seed: key.wrapping_mul(0x9e37_79b9) + r, ..request });
    (0..REPLICATES).map(one).collect()
}

/// The ray caster's image and its error.
fn cast(scenery: &Scenery, kernel: Kernel, estimand: Estimand, tolerance: f64) -> (Image, Image) {
    let look = scenery.effects.look(scenery.volume.grid(), &scenery.camera).unwrap();
    let options = ReferenceOptions { estimand, kernel, tolerance, max_depth: 8 };
    let made = reference_with_look(&density(scenery), &scenery.camera, &look, &options, &Watch::default()).unwrap();
    let errors: Vec<Image> = made.errors.iter().map(|e| e.image.clone()).collect();
    (stack(&made.channels), stack(&errors))
}

/// Largest factor that a sample of the scenery can carry.
fn largest_factor(scenery: &Scenery, kernel: Kernel) -> f64 {
    let grid = scenery.volume.grid();
    let look = scenery.effects.look(grid, &scenery.camera).unwrap();
    look.largest_cue(grid, kernel) * look.tint.into_iter().fold(0.0, f64::max)
}

/// The truth of a scenery. A sum of samples with factors of at most 1 is worth at least as many whole samples as the factors
/// sum to, so the share of samples that counts is the `count` image with the effects, over the largest factor.
fn truth(scenery: &Scenery, kernel: Kernel, estimand: Estimand) -> Truth {
    let (image, error) = cast(scenery, kernel, estimand, TOLERANCE);
    let (mut share, _) = cast(scenery, kernel, Estimand::Count, 5e-2);
    let largest = largest_factor(scenery, kernel);
    share.values_mut().iter_mut().for_each(|v| *v /= largest);
    Truth { image, error, share }
}

fn light() -> Light {
    let position = LightPosition::Around { azimuth: 100.0, elevation: 25.0, distance: Some(25.0) };
    Light { position, colour: Colour::WHITE, intensity: 1.5 }
}

fn shading(sides: Sides) -> Effects {
    Effects { light: light(), shading: Some(Shading { sides }), ..Effects::default() }
}

fn materials() -> Effects {
    let material = |from, to, colour: &str, weight| Material {
        name: None,
        from: Some(from),
        to: Some(to),
        colour: colour.parse().unwrap(),
        weight,
    };
    Effects {
        materials: vec![material(128.0, 180.0, "#ff8000", 1.0), material(180.0, 230.0, "#3060ff", 2.5)],
        unlisted: Some(Unlisted { colour: "#20ff40".parse().unwrap(), weight: 0.5 }),
        ..Effects::default()
    }
}

/// Every effect alone, the report's pair, and all together.
fn every_effect() -> Vec<(&'static str, Effects)> {
    let cue = Some(DepthCue { minimum: Some(22.0) });
    let depth_colour = Some(DepthColour::default());
    let pair = Effects { depth_cue: cue, ..shading(Sides::One) };
    let tinted = Light { colour: "#ff8040".parse().unwrap(), ..light() };
    vec![
        ("one-sided shading", shading(Sides::One)),
        ("two-sided shading", shading(Sides::Two)),
        ("depth cue", Effects { light: light(), depth_cue: cue, ..Effects::default() }),
        ("shading and depth cue", pair.clone()),
        ("coloured light", Effects { light: tinted, ..shading(Sides::One) }),
        ("materials", materials()),
        ("depth colour", Effects { depth_colour: depth_colour.clone(), ..Effects::default() }),
        ("all", Effects { light: tinted, shading: pair.shading, depth_cue: cue, depth_colour, ..materials() }),
    ]
}

/// A pinhole so near that the image's borders cut the volume.
fn close_up() -> View {
    View { fov: Some(38.0), ..pinhole() }
}

fn scenery(effects: &Effects) -> Scenery {
    speckled_scene(&close_up()).with_effects(effects.clone())
}

/// The strategies that draw the same samples in other ways, under all effects at once.
#[test]
fn every_sampler_agrees_with_ray_casting_under_all_effects() {
    let (name, effects) = every_effect().pop().unwrap();
    let scenery = scenery(&effects);
    for estimand in Estimand::ALL {
        let truth = truth(&scenery, Kernel::Tent, estimand);
        for method in [Method::McQuicksort, Method::McBinary, Method::McLinear] {
            let request = Request { method, estimand, samples: SAMPLES / 4, ..Request::default() };
            compare(format!("{name}, {method} {estimand}"), &scenery, &truth, request).hold();
        }
    }
}

fn compare(label: String, scenery: &Scenery, truth: &Truth, request: Request) -> Agreement {
    agreement(label, truth, &replicates(scenery, request), request.samples)
}

fn every_effect_agrees(kernel: Kernel) {
    for (name, effects) in every_effect() {
        let scenery = scenery(&effects);
        let mut worst = f64::INFINITY;
        for estimand in Estimand::ALL {
            let truth = truth(&scenery, kernel, estimand);
            for method in [Method::Mc, Method::Stratified, Method::Qmc] {
                let request = Request { method, kernel, estimand, samples: SAMPLES, ..Request::default() };
                let label = format!("{name}, {method} {kernel} {estimand}");
                worst = worst.min(compare(label, &scenery, &truth, request).hold());
            }
        }
        println!("{name}, {kernel}: smallest p is {worst:.1} times its level");
    }
}

#[test]
fn every_effect_agrees_with_ray_casting_under_box() {
    every_effect_agrees(Kernel::Box);
}

#[test]
fn every_effect_agrees_with_ray_casting_under_tent() {
    every_effect_agrees(Kernel::Tent);
}

#[test]
fn every_effect_agrees_with_ray_casting_under_bspline3() {
    every_effect_agrees(Kernel::Bspline3);
}

/// A parallel camera, voxels of other types, the near plane inside the volume, a light inside the volume.
#[test]
fn hard_scenes_agree_with_ray_casting() {
    let bytes = speckle();
    let floats: Vec<f32> = bytes.iter().map(|&v| 1e-6 * f32::from(v)).collect();
    let shorts: Vec<i16> = bytes.iter().map(|&v| i16::from(v) * 16 - 2000).collect();
    let diameter = skewed_grid().diameter();
    let parallel = View { parallel: true, azimuth: -119.0, elevation: -48.0, ..View::default() };
    let inside = View { distance: Some(0.25 * diameter), near: Some(0.2 * diameter), fov: Some(110.0), ..pinhole() };
    let centre = skewed_grid().centre().to_array();
    let within = Effects {
        light: Light { position: LightPosition::World(centre), ..light() },
        depth_cue: Some(DepthCue { minimum: Some(0.5) }),
        ..shading(Sides::Two)
    };
    let pair = Effects { depth_cue: Some(DepthCue::default()), ..shading(Sides::One) };
    let scenes = [
        ("parallel", scene_of(skewed(bytes.clone()), Default::default(), &parallel).with_effects(pair.clone())),
        ("near plane inside", scene_of(skewed(bytes.clone()), Default::default(), &inside).with_effects(pair.clone())),
        ("light inside", scene_of(skewed(bytes), Default::default(), &close_up()).with_effects(within)),
        ("f32", scene_of(skewed(floats), Default::default(), &close_up()).with_effects(pair.clone())),
        (
            "i16 rescaled",
            scene_of(skewed(shorts).with_rescale(0.37, -5.0).unwrap(), Default::default(), &close_up())
                .with_effects(Effects { depth_colour: Some(DepthColour::default()), ..pair }),
        ),
    ];
    for (name, scenery) in scenes {
        for estimand in Estimand::ALL {
            let truth = truth(&scenery, Kernel::Tent, estimand);
            for method in [Method::Mc, Method::Qmc] {
                let request = Request { method, estimand, samples: SAMPLES, ..Request::default() };
                let outcome = compare(format!("{name}, {method} {estimand}"), &scenery, &truth, request);
                println!("{name}, {method} {estimand}: p is {:.1} times its level", outcome.hold());
            }
        }
    }
}

/// The test has power: images of slightly different effects are told apart.
#[test]
fn wrong_effects_are_rejected() {
    let right = Effects { depth_cue: Some(DepthCue { minimum: Some(22.0) }), ..shading(Sides::One) };
    let moved = |azimuth| {
        let position = LightPosition::Around { azimuth, elevation: 25.0, distance: Some(25.0) };
        Effects { light: Light { position, ..light() }, ..right.clone() }
    };
    let dim = Effects { light: Light { intensity: 1.47, ..light() }, ..right.clone() };
    let faces = Effects { shading: Some(Shading { sides: Sides::Two }), ..right.clone() };
    let near = Effects { depth_cue: Some(DepthCue { minimum: Some(24.0) }), ..right.clone() };
    let truth = truth(&scenery(&right), Kernel::Tent, Estimand::Line);
    let wrong = [("light moved", moved(110.0)), ("2 % dimmer", dim), ("other faces", faces), ("other minimum", near)];
    for (name, effects) in wrong {
        let request = Request { method: Method::Qmc, samples: SAMPLES, ..Request::default() };
        let outcome = compare(name.to_owned(), &scenery(&effects), &truth, request);
        println!("{outcome}");
        assert!(outcome.rejected(), "not rejected: {outcome}");
    }
}

/// Slopes of the error over the number of samples: −1/2 for independent samples, steeper for the net, no plateau.
#[test]
fn errors_of_shaded_images_fall_as_fast_as_those_of_plain_ones() {
    let loaded = mcvr::volume::load("phantom:lobster@48", None).unwrap();
    let camera =
        mcvr::scene::Camera::look(&View::default(), loaded.volume.grid(), Extent::new(12, 12).unwrap()).unwrap();
    let light = Light { position: LightPosition::Around { azimuth: 80.0, elevation: 60.0, distance: None }, ..light() };
    let effects = Effects { light, depth_cue: Some(DepthCue::default()), ..shading(Sides::One) };
    let scenery = Scenery::new(loaded.volume, Default::default(), camera).with_effects(effects);
    let (truth, error) = cast(&scenery, Kernel::Tent, Estimand::Line, 1e-4);
    let rms = |image: &Image| (image.values().iter().map(|v| v * v).sum::<f64>() / image.values().len() as f64).sqrt();
    let own = rms(&error) / truth.mean();
    let levels = 10..=18u32;
    for (method, low, high) in [(Method::Mc, -0.53, -0.47), (Method::Qmc, -0.9, -0.55)] {
        // Errors below ten times the reference's own mean nothing (METHOD section 7): the slope ends there.
        let logs: Vec<f64> = levels
            .clone()
            .map(|level| {
                let errors: Vec<f64> = (0..REPLICATES)
                    .map(|seed| {
                        let request = Request { method, samples: 1 << level, seed, ..Request::default() };
                        let image = picture(&scenery, &request);
                        (rms(&image.difference(&truth).unwrap()) / truth.mean()).powi(2)
                    })
                    .collect();
                (errors.iter().sum::<f64>() / REPLICATES as f64).sqrt()
            })
            .take_while(|error| *error > 10.0 * own)
            .map(f64::log2)
            .collect();
        assert!(logs.len() >= 5, "{method}: only {} errors can be told from the reference's {own:e}", logs.len());
        let n = logs.len() as f64;
        let middle = (n - 1.0) / 2.0;
        let slope =
            logs.iter().enumerate().map(|(i, y)| (i as f64 - middle) * y).sum::<f64>() * 12.0 / (n * (n * n - 1.0));
        println!("{method}: slope {slope:.3}, errors {logs:.2?}");
        assert!((low..=high).contains(&slope), "{method}: slope {slope}");
        assert!(logs.windows(2).all(|w| w[1] < w[0] - 0.2), "{method}: a plateau in {logs:.2?}");
    }
}
