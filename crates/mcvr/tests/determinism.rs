//! The same request gives the same image and the same counts of work on any number of threads and at any width of
//! vectors, now and after later changes.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::*;
use mcvr::sampling::{BLOCK, Distribution, Precision, RenderOptions, Rendered, SimdLevel, render};
use mcvr::scene::{Density, DensityMap, Emphasis, Estimand, Kernel, View, Watch};
use mcvr::{Method, Request, Scenery};

/// Several blocks and a short one at the end; more blocks than sixteen threads.
const SAMPLES: u64 = 40 * BLOCK as u64 + 77;

fn samples(method: Method) -> u64 {
    if method == Method::McLinear { 5 * BLOCK as u64 + 77 } else { SAMPLES }
}

/// A view that cuts the volume by the image's border and by the near plane.
fn scenery() -> Scenery {
    let diameter = skewed_grid().diameter();
    speckled_scene(&View { fov: Some(38.0), near: Some(0.9 * diameter), ..pinhole() })
}

fn rendered(density: &Density, scenery: &Scenery, method: Method, seed: u64, options: &RenderOptions) -> Rendered {
    let order = Request::default().order.resolve(&scenery.camera, scenery.volume.grid());
    let distribution = Distribution::new(density, order).unwrap();
    let stream = stream(method, samples(method), seed, distribution.total());
    render(&distribution, &*stream, &scenery.camera, options, &Watch::default()).unwrap()
}

fn on_threads<R: Send>(threads: usize, work: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

fn requests() -> impl Iterator<Item = Request> {
    SAMPLERS.into_iter().flat_map(|method| {
        Estimand::ALL.map(|estimand| Request { method, estimand, samples: samples(method), ..Request::default() })
    })
}

#[test]
fn one_two_and_sixteen_threads_give_the_same_image_and_counters() {
    let scenery = scenery();
    for request in requests() {
        let [one, two, many] = [1, 2, 16].map(|threads| on_threads(threads, || made(&scenery, &request)));
        for other in [two, many] {
            assert_eq!(one.image, other.image, "{} {}", request.method, request.estimand);
            assert_eq!(one.counters, other.counters, "{} {}", request.method, request.estimand);
        }
    }
}

#[test]
fn ray_casting_gives_the_same_image_on_any_number_of_threads() {
    let scenery = scenery();
    for (method, estimand) in [(Method::March, Estimand::Line), (Method::Exact, Estimand::Count)] {
        let request = Request { method, estimand, samples: 5000, tolerance: 1e-3, ..Request::default() };
        let [one, two, many] = [1, 2, 16].map(|threads| on_threads(threads, || made(&scenery, &request)));
        for other in [two, many] {
            assert_eq!(one.image, other.image, "{method}");
            assert_eq!(one.counters, other.counters, "{method}");
        }
    }
}

#[test]
fn every_vector_width_gives_the_same_image() {
    let scenery = scenery();
    let density = density(&scenery);
    for precision in [Precision::F32, Precision::F64] {
        for kernel in Kernel::ALL {
            for request in requests() {
                let Request { method, estimand, .. } = request;
                let at = |simd| {
                    let options = RenderOptions {
                        estimand,
                        kernel,
                        simd: Some(simd),
                        precision: Some(precision),
                        ..RenderOptions::default()
                    };
                    rendered(&density, &scenery, method, 3, &options)
                };
                let portable = at(SimdLevel::Portable);
                for level in SimdLevel::available() {
                    let other = at(level);
                    assert_eq!(portable.image, other.image, "{method} {kernel} {estimand} {precision:?} {level:?}");
                    assert_eq!(portable.counters, other.counters);
                }
            }
        }
    }
}

#[test]
fn another_seed_gives_another_image() {
    let scenery = scenery();
    for request in requests() {
        let [a, b, again] = [1, 2, 1].map(|seed| made(&scenery, &Request { seed, ..request }).image);
        assert_eq!(a, again);
        let differing = a.values().iter().zip(b.values()).filter(|(a, b)| a != b).count();
        // Counts of two independent images are equal in a pixel of some hundred samples about one time in forty.
        assert!(differing > a.values().len() / 4, "{} {}: {differing} pixels", request.method, request.estimand);
    }
}

#[test]
fn counters_add_up_exactly() {
    let scenery = scenery();
    let density = density(&scenery);
    let voxels = scenery.volume.grid().len() as u64;
    for order in orders() {
        let distribution = Distribution::new(&density, order).unwrap();
        assert_eq!(distribution.counters().voxels_read, voxels);
        for request in requests() {
            let Request { method, estimand, samples, .. } = request;
            let stream = stream(method, samples, 9, distribution.total());
            let options = RenderOptions { estimand, ..RenderOptions::default() };
            let Rendered { counters: c, image, .. } =
                render(&distribution, &*stream, &scenery.camera, &options, &Watch::default()).unwrap();
            let name = format!("{method} {estimand} {}", order.name());
            assert_eq!(c.samples, samples, "{name}");
            assert_eq!(c.samples, c.inside + c.outside + c.clipped, "{name}");
            assert!(c.inside > 0 && c.outside > 0 && c.clipped > 0, "{name}: the view cuts on every side");
            assert!(c.voxels_read <= c.bricks_decoded * 256, "{name}");
            assert_eq!(c.line_weights, if estimand == Estimand::Line { samples } else { 0 }, "{name}");
            // Three bricks hold the volume: a walk decodes each at most once a block, a search one a sample.
            let bricks = distribution.counters().bricks;
            match method {
                Method::McBinary => assert_eq!(c.bricks_decoded, samples, "{name}"),
                Method::McLinear => {
                    assert!(c.bricks_decoded > samples && c.bricks_decoded < bricks * samples, "{name}")
                }
                _ => {
                    let blocks = samples.div_ceil(BLOCK as u64);
                    assert!(c.bricks_decoded >= blocks && c.bricks_decoded <= bricks * blocks, "{name}");
                }
            }
            if estimand == Estimand::Count {
                assert_eq!(counts(&image, samples).iter().sum::<u64>(), c.inside, "{name}");
            }
        }
    }
}

/// The whole numbers of samples in a `count` image's pixels.
fn counts(image: &mcvr::scene::Image, samples: u64) -> Vec<u64> {
    let whole = |v: &f64| {
        let n = v * samples as f64;
        assert!((n - n.round()).abs() < 1e-6, "{n} samples");
        n.round() as u64
    };
    image.values().iter().map(whole).collect()
}

/// FNV-1a over the counts' little-endian bytes.
fn hash(counts: &[u64]) -> u64 {
    counts
        .iter()
        .flat_map(|c| c.to_le_bytes())
        .fold(0xcbf2_9ce4_8422_2325, |h, byte| (h ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// Whoever changes a point stream, the voxels' order, a kernel's map or the projection changes every user's images
/// for a given seed: these constants are to be changed knowingly, with a line in the change log.
/// (`mc` takes logarithms of the platform's library; a platform whose logarithm rounds differently may differ.)
#[test]
fn seeded_images_are_those_of_earlier_versions() {
    let scenery = speckled_scene(&pinhole());
    let density = density(&scenery);
    let golden = [
        (Method::Mc, 0x3b88_8955_69a8_de73u64),
        (Method::McQuicksort, 0x6ccc_b130_bf09_4352),
        (Method::McBinary, 0x3d2e_54a3_38f2_1ffd),
        (Method::Stratified, 0x931a_bb26_ec0c_571a),
        (Method::Qmc, 0xd680_4bf2_bc81_f456),
    ];
    let found = golden.map(|(method, _)| {
        let options = RenderOptions { estimand: Estimand::Count, ..RenderOptions::default() };
        (method, hash(&counts(&rendered(&density, &scenery, method, 2026, &options).image, SAMPLES)))
    });
    assert_eq!(found, golden, "\n{found:#x?}");
}

/// Weights of every kind that the distribution stores: small integers, table entries scaled, and calculated.
#[test]
fn every_kind_of_weight_is_deterministic() {
    let view = pinhole();
    let emphasis = DensityMap { emphasis: Some(Emphasis { threshold: 200.0, gain: 2.7 }), ..DensityMap::default() };
    let floats: Vec<f32> = speckle().iter().map(|&v| f32::from(v).sqrt()).collect();
    let scenes = [
        scene_of(skewed(speckle()), DensityMap::default(), &view),
        scene_of(skewed(speckle()), emphasis, &view),
        scene_of(skewed(floats), DensityMap::default(), &view),
    ];
    for scenery in &scenes {
        for request in requests() {
            let [one, many] = [1, 16].map(|threads| on_threads(threads, || made(scenery, &request)));
            assert_eq!(one.image, many.image);
            assert_eq!(one.counters, many.counters);
        }
    }
}
