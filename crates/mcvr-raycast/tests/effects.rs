//! Effects in the reference and in the march: against their definitions, closed forms, and their own error estimates.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use std::sync::atomic::AtomicBool;

use common::*;
use glam::DVec3;
use mcvr_raycast::{
    LookMarch, LookReference, MarchOptions, RayOptions, RaycastError, ReferenceOptions, Watch, march, march_with_look,
    reference_with_look,
};
use mcvr_scene::effects::{
    Colour, DepthColour, DepthCue, Effects, Light, LightPosition, Look, Material, Shading, Sides, Unlisted, gradient,
};
use mcvr_scene::{Camera, Density, Estimand, Image, Kernel};

const CASES: [&str; 7] = ["one-sided", "two-sided", "cue", "shading and cue", "palette", "ramp", "all"];

fn material(from: f64, to: f64, colour: &str) -> Material {
    Material { name: None, from: Some(from), to: Some(to), colour: colour.parse().unwrap(), weight: 1.0 }
}

fn effects(case: &str) -> Effects {
    let shading = |sides| Some(Shading { sides });
    let cue = Some(DepthCue { minimum: Some(2.0) });
    let ramp = Some(DepthColour::default());
    let materials = vec![material(90.0, 150.0, "#ff8000"), material(200.0, 256.0, "#2040c0")];
    let base = Effects {
        light: Light {
            position: LightPosition::Around { azimuth: 70.0, elevation: 40.0, distance: Some(30.0) },
            ..Light::default()
        },
        ..Effects::default()
    };
    let unlisted = Some(Unlisted { colour: Colour::WHITE, weight: 1.0 });
    match case {
        "one-sided" => Effects { shading: shading(Sides::One), ..base },
        "two-sided" => Effects { shading: shading(Sides::Two), ..base },
        "cue" => Effects { depth_cue: cue, ..base },
        "shading and cue" => Effects { shading: shading(Sides::One), depth_cue: cue, ..base },
        "palette" => Effects { materials, unlisted, ..base },
        "ramp" => Effects { depth_colour: ramp, ..base },
        _ => Effects { shading: shading(Sides::One), depth_cue: cue, depth_colour: ramp, materials, unlisted, ..base },
    }
}

fn look_of(effects: &Effects, d: &Density, camera: &Camera) -> Look {
    effects.look(d.volume().grid(), camera).unwrap()
}

fn reference_of(d: &Density, camera: &Camera, look: &Look, options: &ReferenceOptions) -> LookReference {
    reference_with_look(d, camera, look, options, &Watch::default()).unwrap()
}

fn march_of(d: &Density, camera: &Camera, look: &Look, options: &MarchOptions) -> LookMarch {
    march_with_look(d, camera, look, options, &Watch::default()).unwrap()
}

fn rms_of(a: &[Image], b: &[Image]) -> f64 {
    assert_eq!(a.len(), b.len());
    let square: f64 =
        a.iter().zip(b).flat_map(|(a, b)| a.difference(b).unwrap().values().to_vec()).map(|v| v * v).sum();
    (square / (a.len() * a[0].values().len()) as f64).sqrt()
}

fn mean_of(images: &[Image]) -> f64 {
    images.iter().map(Image::mean).sum::<f64>() / images.len() as f64
}

/// `ρ_c factor_c` at a world point, by the definitions of density, gradient and look.
fn integrand(d: &Density, kernel: Kernel, look: &Look, x: DVec3, depth: f64) -> [f64; 3] {
    let grid = d.volume().grid();
    let index = grid.world_to_index().transform_point3(x);
    let mut density = [0.0; 3];
    for n in 0..grid.len() {
        let c = grid.unravel(n);
        let k: f64 = (0..3).map(|a| kernel.density(index[a] - c[a] as f64).unwrap()).product();
        let colour = look.palette.as_ref().map_or([1.0; 3], |p| p.colour(d.volume().isovalue(n)));
        (0..3).for_each(|c| density[c] += d.weight(n) * k * colour[c]);
    }
    let factor = look.factor(x, depth, || gradient(d, index));
    [0, 1, 2].map(|c| density[c] * factor[c] * look.tint[c])
}

/// The march through the centre of a pixel by the definitions.
fn slow_march(d: &Density, camera: &Camera, look: &Look, options: &MarchOptions, (px, py): (f64, f64)) -> [f64; 3] {
    let grid = d.volume().grid();
    let ray = camera.ray(px, py);
    let to_index = grid.world_to_index();
    let (o, v) = (to_index.transform_point3(ray.origin), to_index.transform_vector3(ray.direction));
    let s = options.rays.kernel.support();
    let (mut from, mut to) = (ray.start, f64::INFINITY);
    for a in 0..3 {
        let (p, q) = ((-s - o[a]) / v[a], (grid.dims()[a] as f64 - 1.0 + s - o[a]) / v[a]);
        (from, to) = (from.max(p.min(q)), to.min(p.max(q)));
    }
    if from >= to {
        return [0.0; 3];
    }
    let dl = options.step * grid.spacing().min_element();
    // Samples lie half a step beyond whole numbers of steps from the eye; without one, from the plane through the grid's centre.
    let zero = if camera.is_parallel() { (grid.centre() - ray.origin).dot(ray.direction) } else { 0.0 };
    let sample = |t: f64| ((t - zero) / dl - 0.5).ceil();
    let mut sum = [0.0; 3];
    for n in sample(from) as i64..sample(to) as i64 {
        let x = ray.origin + ray.direction * (zero + (n as f64 + 0.5) * dl);
        let depth = camera.project(x).2;
        let weight = match options.rays.estimand {
            Estimand::Line => dl,
            Estimand::Count => dl / camera.line_factor(px, py, depth) / d.mass(),
        };
        let value = integrand(d, options.rays.kernel, look, x, depth);
        (0..3).for_each(|c| sum[c] += weight * value[c]);
    }
    sum
}

#[test]
fn the_march_takes_its_steps_by_the_definitions() {
    let grid = skewed_grid([5, 4, 6]);
    let d = density(grid.clone(), noise(grid.len()));
    for case in CASES {
        for kernel in KERNELS {
            for estimand in Estimand::ALL {
                for parallel in [false, true] {
                    let camera = look(&grid, 25.0, 15.0, parallel, 5);
                    let look = look_of(&effects(case), &d, &camera);
                    let options = MarchOptions {
                        step: 0.37,
                        ..(RayOptions { kernel, estimand, ..RayOptions::default() }).into()
                    };
                    let m = march_of(&d, &camera, &look, &options);
                    let scale = m.channels[0].max();
                    assert!(scale > 0.0);
                    for (x, y) in [(2, 2), (1, 3), (3, 2), (0, 0)] {
                        let slow = slow_march(&d, &camera, &look, &options, (x as f64 + 0.5, y as f64 + 0.5));
                        for (c, channel) in m.channels.iter().enumerate() {
                            let v = channel.get(x, y);
                            assert!(
                                (v - slow[c]).abs() < 1e-10 * scale,
                                "{case} {kernel} {estimand} parallel {parallel} at {x},{y} channel {c}: {v} {slow:?}"
                            );
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn the_reference_is_what_the_march_converges_to() {
    let grid = skewed_grid([5, 4, 6]);
    let d = density(grid.clone(), noise(grid.len()));
    for case in CASES {
        for kernel in KERNELS {
            // Rays are tested alone in every combination.
            for (estimand, parallel) in [(Estimand::Count, false), (Estimand::Line, true)] {
                let camera = look(&grid, 25.0, 15.0, parallel, 5);
                let look = look_of(&effects(case), &d, &camera);
                let r = reference_of(&d, &camera, &look, &options(estimand, kernel, 3e-3));
                let at = |step, rays_per_pixel| {
                    let o = MarchOptions {
                        step,
                        ..(RayOptions { rays_per_pixel, kernel, estimand, ..RayOptions::default() }).into()
                    };
                    march_of(&d, &camera, &look, &o).channels
                };
                let (coarse, fine) = (at(0.1, 64), at(0.05, 256));
                let mean = mean_of(&r.channels);
                let off = rms_of(&r.channels, &fine) / mean;
                // The march at half the step and half the distance of rays is at least half as wrong, so it is
                // no further from its limit than from the coarser march.
                let limit = rms_of(&coarse, &fine) / mean + r.rel_rmse_estimate;
                assert!(off <= limit, "{case} {kernel} {estimand} parallel {parallel}: {off:e} above {limit:e}");
            }
        }
    }
}

#[test]
fn the_true_error_is_below_the_estimate() {
    let grid = skewed_grid([7, 8, 6]);
    let d = density(grid.clone(), noise(grid.len()));
    for case in CASES {
        for kernel in KERNELS {
            let camera = look(&grid, 25.0, 15.0, false, 7);
            let look = look_of(&effects(case), &d, &camera);
            let at = |tolerance| reference_of(&d, &camera, &look, &options(Estimand::Line, kernel, tolerance));
            let (r, truth) = (at(5e-2), at(3e-3));
            let error = rms_of(&r.channels, &truth.channels) / mean_of(&truth.channels);
            assert!(error <= r.rel_rmse_estimate, "{case} {kernel}: {error:e} {:e}", r.rel_rmse_estimate);
            assert!(truth.rel_rmse_estimate < r.rel_rmse_estimate, "{case} {kernel}: the truth is better");
            for e in r.errors.iter().filter(|_| r.errors[0].depth_limited == 0) {
                assert!(e.image.max() <= e.tolerance * (1.0 + 1e-9), "{case} {kernel}");
            }
        }
    }
}

#[test]
fn flat_blocks_seen_edge_on_do_not_fool_the_estimate() {
    // Inside a block the gradient is exactly 0, beside it not: shading jumps at the faces of cells, and where those are
    // seen edge-on, errors of neighbouring squares have the same sign.
    let grid = plain_grid([9, 9, 9]);
    let block = |n: usize| if grid.unravel(n).iter().all(|i| (2..7).contains(i)) { 100u8 } else { 0 };
    let d = density(grid.clone(), (0..grid.len()).map(block).collect::<Vec<u8>>());
    for (azimuth, elevation, parallel) in [(0.0, 0.0, true), (0.0, 0.0, false), (30.0, 0.0, true), (1.0, 0.5, false)] {
        let camera = look(&grid, azimuth, elevation, parallel, 11);
        for case in ["one-sided", "two-sided", "shading and cue"] {
            let look = look_of(&effects(case), &d, &camera);
            for kernel in [Kernel::Tent, Kernel::Bspline3] {
                let at = |tolerance, max_depth| {
                    let o = ReferenceOptions { max_depth, ..options(Estimand::Line, kernel, tolerance) };
                    reference_of(&d, &camera, &look, &o)
                };
                let (r, truth) = (at(2e-2, 4), at(1e-3, 6));
                let error = rms_of(&r.channels, &truth.channels) / mean_of(&truth.channels);
                let estimate = r.rel_rmse_estimate;
                assert!(error <= estimate, "{case} {kernel} {azimuth} {parallel}: {error:e} {estimate:e}");
            }
        }
    }
}

/// A volume whose weights depend on z alone, a parallel camera along z that sees only its middle, and a light so far
/// away at the given angle from z that its rays are parallel.
fn layers(weights: &[f64], angle: f64) -> (Density, Camera, Light) {
    let side = 24;
    let grid = plain_grid([side, side, weights.len()]);
    let voxels = (0..grid.len()).map(|n| weights[grid.unravel(n)[2]]).collect::<Vec<f64>>();
    let d = density(grid.clone(), voxels);
    let c = grid.centre();
    // Two pixels per voxel around the centre, so that no border across is seen.
    let rows = [[2.0, 0.0, 0.0, 2.0 - 2.0 * c.x], [0.0, 2.0, 0.0, 2.0 - 2.0 * c.y], [0.0, 0.0, 0.0, 1.0]];
    let camera = Camera::from_matrix(rows, mcvr_scene::Extent::new(4, 4).unwrap(), &grid, None).unwrap();
    let away = c + 1e9 * DVec3::new(angle.sin(), 0.0, angle.cos());
    (d, camera, Light { position: LightPosition::World(away.to_array()), ..Light::default() })
}

#[test]
fn layers_are_shaded_by_the_cosine() {
    let rising = [0.0, 1.0, 2.5, 3.0, 5.0, 7.0, 7.5, 0.0];
    let angle = 0.6f64;
    let (d, camera, light) = layers(&rising, angle);
    let shaded = |light: Light, sides| {
        let effects = Effects { light, shading: Some(Shading { sides }), ..Effects::default() };
        reference_of(&d, &camera, &look_of(&effects, &d, &camera), &ReferenceOptions::default()).channels[0].get(1, 2)
    };
    let plain = run(&d, &camera, &ReferenceOptions::default()).image.get(1, 2);
    assert!((plain - rising.iter().sum::<f64>()).abs() < 1e-9);
    let two = shaded(light, Sides::Two);
    assert!((two - plain * angle.cos()).abs() < 1e-4 * plain, "{two} {plain}");
    let other = layers(&rising, std::f64::consts::PI - angle).2;
    let (one, back) = (shaded(light, Sides::One), shaded(other, Sides::One));
    assert!((one + back - two).abs() < 1e-4 * plain, "{one} {back} {two}");
    // Differences at the voxels: 0.5, 1.25, 1, 1.25, 2, 1.25, -3.5, -3.75; the gradient's only zero between voxels 5 and
    // 6 lies at 5 + 1.25/4.75, and the weights beyond it face the light.
    let f = 1.25 / 4.75;
    let at = 7.0 + f * 0.5;
    let beyond = 0.5 * (at + 7.5) * (1.0 - f) + 0.5 * 7.5;
    assert!((one - beyond * angle.cos()).abs() < 1e-4 * plain, "{one} {}", beyond * angle.cos());
}

#[test]
fn a_far_light_makes_the_cue_a_constant_and_a_white_palette_changes_nothing() {
    let grid = skewed_grid([6, 7, 5]);
    let d = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 25.0, 15.0, false, 8);
    for kernel in KERNELS {
        let o = options(Estimand::Line, kernel, 1e-3);
        let plain = run(&d, &camera, &o);
        let light = Light { position: LightPosition::World([0.0, 0.0, 1e9]), ..Light::default() };
        let cue = Effects { light, depth_cue: Some(DepthCue::default()), ..Effects::default() };
        let r = reference_of(&d, &camera, &look_of(&cue, &d, &camera), &o);
        let scaled = r.channels[0].values().iter().map(|v| v * 1e9).collect();
        let scaled = Image::from_values(camera.extent(), scaled).unwrap();
        let off = rms_of(&[scaled], std::slice::from_ref(&plain.image)) / plain.image.mean();
        assert!(off <= r.rel_rmse_estimate + plain.error.rel_rmse_estimate, "{kernel}: {off:e}");

        let white = Effects { materials: vec![material(-1.0, 300.0, "#ffffff")], ..Effects::default() };
        let r = reference_of(&d, &camera, &look_of(&white, &d, &camera), &o);
        assert_eq!(r.channels.len(), 3);
        for channel in &r.channels {
            let off = rms_of(std::slice::from_ref(channel), std::slice::from_ref(&plain.image)) / plain.image.mean();
            // The same exact rays but for rounding; squares are refined alike.
            assert!(off < 1e-9, "{kernel}: {off:e}");
        }
    }
}

#[test]
fn a_ball_under_a_headlight_is_symmetric() {
    let n = 11;
    let grid = plain_grid([n; 3]);
    let c = grid.centre();
    let voxels = (0..grid.len()).map(|i| {
        let x = DVec3::from_array(grid.unravel(i).map(|v| v as f64)) - c;
        (100.0 * (-x.length_squared() / 6.0).exp()).round()
    });
    let d = density(grid.clone(), voxels.collect::<Vec<f64>>());
    let camera = look(&grid, 0.0, 0.0, false, 16);
    let headlight = Effects { shading: Some(Shading::default()), ..Effects::default() };
    let r = reference_of(&d, &camera, &look_of(&headlight, &d, &camera), &options(Estimand::Line, Kernel::Tent, 1e-3));
    let (image, error) = (&r.channels[0], &r.errors[0].image);
    for y in 0..16 {
        for x in 0..16 {
            for (a, b) in [(15 - x, y), (x, 15 - y), (y, x)] {
                let off = (image.get(x, y) - image.get(a, b)).abs();
                assert!(off <= error.get(x, y) + error.get(a, b) + 1e-9 * image.max(), "{x},{y}: {off}");
            }
        }
    }
    assert!(image.get(7, 7) > 5.0 * image.get(4, 4));
}

#[test]
fn flat_regions_and_lights_inside_are_finite_and_right() {
    let grid = plain_grid([6, 6, 6]);
    let flat = density(grid.clone(), vec![7u8; grid.len()]);
    let noisy = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 20.0, 30.0, false, 6);
    let places = [[2.5, 2.5, 2.5], [3.0, 2.0, 3.0], [2.2, 3.1, 2.7], [0.0, 0.0, 0.0]];
    for (name, d) in [("flat", &flat), ("noise", &noisy)] {
        for place in places {
            for sides in [Sides::One, Sides::Two] {
                let light = Light { position: LightPosition::World(place), ..Light::default() };
                let depth_cue = Some(DepthCue { minimum: Some(0.1) });
                let e = Effects { light, shading: Some(Shading { sides }), depth_cue, ..Effects::default() };
                let look = look_of(&e, d, &camera);
                for kernel in KERNELS {
                    let r = reference_of(d, &camera, &look, &options(Estimand::Line, kernel, 1e-2));
                    let all = r.channels[0].values().iter().chain(r.errors[0].image.values());
                    assert!(all.clone().all(|v| v.is_finite()), "{name} {place:?} {kernel}");
                    let at = |step, rays_per_pixel| {
                        let o = MarchOptions {
                            step,
                            ..(RayOptions { rays_per_pixel, kernel, ..RayOptions::default() }).into()
                        };
                        march_of(d, &camera, &look, &o).channels
                    };
                    let (coarse, fine) = (at(0.1, 64), at(0.05, 256));
                    let off = rms_of(&r.channels, &fine);
                    let limit = rms_of(&coarse, &fine) + r.rel_rmse_estimate * mean_of(&r.channels);
                    assert!(off <= limit, "{name} {place:?} {kernel}: {off:e} {limit:e}");
                }
            }
        }
    }
}

#[test]
fn a_scene_pays_only_for_the_effects_it_names() {
    let grid = skewed_grid([7, 8, 6]);
    let d = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 25.0, 15.0, false, 7);
    for case in CASES {
        let e = effects(case);
        let look = look_of(&e, &d, &camera);
        for kernel in KERNELS {
            let r = reference_of(&d, &camera, &look, &options(Estimand::Line, kernel, 1e-1)).counters;
            let m = march_of(&d, &camera, &look, &MarchOptions::from(RayOptions { kernel, ..RayOptions::default() }))
                .counters;
            for c in [r, m] {
                assert_eq!(c.gradients > 0, e.shading.is_some(), "{case} {kernel}: {c:?}");
                assert_eq!(c.colours > 0, !e.materials.is_empty(), "{case} {kernel}: {c:?}");
            }
            assert_eq!(if e.shading.is_some() { r.evaluations } else { 0 }, r.gradients, "{case} {kernel}");
            let taps = if kernel == Kernel::Bspline3 { 64 } else { 8 };
            if e.shading.is_none() {
                assert!(m.voxel_reads <= taps * m.evaluations, "{case} {kernel}: {m:?}");
            }
        }
    }
}

#[test]
fn a_plain_look_takes_the_plain_way() {
    let grid = skewed_grid([7, 8, 6]);
    let d = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 25.0, 15.0, false, 9);
    for kernel in KERNELS {
        let o = options(Estimand::Count, kernel, 1e-2);
        let (r, plain) = (reference_of(&d, &camera, &Look::plain(), &o), run(&d, &camera, &o));
        assert_eq!((&r.channels, r.counters), (&vec![plain.image], plain.counters));
        assert_eq!(r.errors, [plain.error]);
        let o = MarchOptions::from(RayOptions { kernel, ..RayOptions::default() });
        let plain = march(&d, &camera, &o, &Watch::default()).unwrap();
        let m = march_of(&d, &camera, &Look::plain(), &o);
        assert_eq!((m.channels, m.counters), (vec![plain.image], plain.counters));
    }
}

#[test]
fn the_tint_makes_three_channels_of_one() {
    let grid = skewed_grid([5, 4, 6]);
    let d = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 25.0, 15.0, false, 6);
    let mut e = effects("one-sided");
    let o = options(Estimand::Line, Kernel::Tent, 1e-2);
    let white = reference_of(&d, &camera, &look_of(&e, &d, &camera), &o);
    (e.light.colour, e.light.intensity) = ("#ff0033".parse().unwrap(), 3.0);
    let look = look_of(&e, &d, &camera);
    let red = reference_of(&d, &camera, &look, &o);
    assert_eq!((white.channels.len(), red.channels.len()), (1, 3));
    for (c, tint) in [3.0, 0.0, 3.0 * 0.2].into_iter().enumerate() {
        for (a, b) in red.channels[c].values().iter().zip(white.channels[0].values()) {
            assert!((a - tint * b).abs() <= 1e-12 * b.abs());
        }
    }
    assert_eq!(march_of(&d, &camera, &look, &MarchOptions::default()).channels.len(), 3);
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let grid = skewed_grid([7, 8, 6]);
    let d = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 25.0, 15.0, false, 9);
    let look = look_of(&effects("all"), &d, &camera);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let r = reference_of(&d, &camera, &look, &options(Estimand::Line, Kernel::Tent, 1e-2));
            let m = march_of(
                &d,
                &camera,
                &look,
                &MarchOptions::from(RayOptions { rays_per_pixel: 5, ..RayOptions::default() }),
            );
            (r.channels, r.errors, r.counters, m.channels, m.counters)
        })
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn unusable_options_are_refused_and_a_stop_is_heard() {
    let grid = skewed_grid([5, 4, 6]);
    let d = density(grid.clone(), noise(grid.len()));
    let camera = look(&grid, 25.0, 15.0, false, 6);
    let look = look_of(&effects("all"), &d, &camera);
    let try_it = |o: ReferenceOptions, w: &Watch| reference_with_look(&d, &camera, &look, &o, w).unwrap_err();
    let o = ReferenceOptions::default();
    assert_eq!(try_it(ReferenceOptions { tolerance: 0.0, ..o }, &Watch::default()), RaycastError::Tolerance(0.0));
    assert_eq!(try_it(ReferenceOptions { kernel: Kernel::Shell, ..o }, &Watch::default()), RaycastError::Shell);
    assert!(matches!(try_it(ReferenceOptions { max_depth: 17, ..o }, &Watch::default()), RaycastError::Depth { .. }));
    let bad = MarchOptions { step: 0.0, ..MarchOptions::default() };
    assert_eq!(march_with_look(&d, &camera, &look, &bad, &Watch::default()), Err(RaycastError::Step(0.0)));
    let stop = AtomicBool::new(true);
    let stopped = Watch { progress: None, cancel: Some(&stop) };
    assert_eq!(try_it(o, &stopped), RaycastError::Cancelled);
    let marched = march_with_look(&d, &camera, &look, &MarchOptions::default(), &stopped);
    assert_eq!(marched, Err(RaycastError::Cancelled));
}
