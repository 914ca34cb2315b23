//! Every sampling method, under every kernel and estimand, converges to the image that exact ray casting gives.
//!
//! [`common::agreement`] states the test, its null distribution and its level: a false alarm anywhere in this
//! file has probability 1e-3. All seeds are fixed, so the outcome never changes; the level says how surprising
//! the bounds would find a correct program.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::agreement::{Truth, agreement, nothing_strays};
use common::*;
use glam::DVec3;
use mcvr::qmc::Scramble;
use mcvr::sampling::{Distribution, Precision, RenderOptions, VoxelOrder, render};
use mcvr::scene::{Camera, DensityMap, Emphasis, Estimand, Image, Kernel, View, Watch};
use mcvr::{Method, Request, Scenery};

/// Independent replicates of each image.
const REPLICATES: u64 = 64;
/// Samples of a replicate.
const SAMPLES: u64 = 1 << 15;
/// Samples of a replicate that is no power of two and ends with a short block.
const ODD_SAMPLES: u64 = 40_007;

/// The exact image with its own error; that error is budgeted for by the test, so it need only be small.
fn truth(scenery: &Scenery, kernel: Kernel, estimand: Estimand) -> Truth {
    let tolerance = match kernel {
        Kernel::Box => 3e-4, // its image is full of kinks: smaller tolerances cost minutes
        Kernel::Tent => 1e-6,
        _ => 1e-5,
    };
    let of = |estimand| exact(scenery, kernel, estimand, tolerance, 8);
    let wanted = of(estimand);
    // Where samples are enough is decided by a rough share.
    let share = exact(scenery, kernel, Estimand::Count, 1e-3, 4).image;
    Truth { image: wanted.image, error: wanted.error.image, share }
}

fn replicates(scenery: &Scenery, request: Request) -> Vec<Image> {
    // Seeds differ from request to request, so that no comparison within a scene repeats another's points.
    let fields = [
        request.method as u64,
        request.scramble as u64,
        request.order as u64,
        request.kernel as u64,
        request.estimand as u64,
    ];
    let key = fields.into_iter().fold(request.samples, |key, field| key << 3 | field);
    let one = |r| made(scenery, &Request { seed: key.wrapping_mul(0x9e37_79b9) + r, ..request }).image;
    (0..REPLICATES).map(one).collect()
}

/// Holds one request to the truth; gives the smallest p-value over its level.
fn hold(name: &str, scenery: &Scenery, truth: &Truth, request: Request) -> f64 {
    let Request { method, kernel, estimand, order, scramble, samples, .. } = request;
    let images = replicates(scenery, request);
    let label = format!("{name}, {method} {kernel} {estimand} {} {}", order.name(), scramble.name());
    nothing_strays(&label, truth, &images);
    agreement(label, truth, &images, samples).hold()
}

/// Every method, and `qmc` in every order under every scramble.
fn every_sampler() -> Vec<Request> {
    let mut all: Vec<Request> = vec![];
    for method in SAMPLERS {
        // A linear search costs half a volume a sample.
        let samples = if method == Method::McLinear { SAMPLES / 4 } else { SAMPLES };
        let base = Request { method, samples, ..Request::default() };
        if method == Method::Qmc {
            for scramble in [Scramble::Linear, Scramble::Owen, Scramble::Shift] {
                all.extend(orders().map(|order| Request { scramble, order, ..base }));
            }
        } else {
            all.push(base);
        }
    }
    all
}

/// A pinhole so near that the image's borders cut the volume.
fn close_up() -> View {
    View { fov: Some(38.0), ..pinhole() }
}

fn every_sampler_agrees(kernel: Kernel) {
    let scenery = speckled_scene(&close_up());
    let mut worst = f64::INFINITY;
    for estimand in Estimand::ALL {
        let truth = truth(&scenery, kernel, estimand);
        for request in every_sampler() {
            worst = worst.min(hold("speckle", &scenery, &truth, Request { kernel, estimand, ..request }));
        }
    }
    println!("{kernel}: smallest p is {worst:.1} times its level");
}

#[test]
fn every_sampler_agrees_with_ray_casting_under_box() {
    every_sampler_agrees(Kernel::Box);
}

#[test]
fn every_sampler_agrees_with_ray_casting_under_tent() {
    every_sampler_agrees(Kernel::Tent);
}

#[test]
fn every_sampler_agrees_with_ray_casting_under_bspline3() {
    every_sampler_agrees(Kernel::Bspline3);
}

/// Rays at random places in their pixels, exact in depth or with samples far apart from a random start.
#[test]
fn jittered_rays_and_combs_agree_with_the_reference() {
    let scenery = speckled_scene(&close_up());
    let pixels = scenery.camera.extent().pixels() as u64;
    for kernel in [Kernel::Box, Kernel::Tent, Kernel::Bspline3] {
        for estimand in Estimand::ALL {
            let truth = truth(&scenery, kernel, estimand);
            for rays in [1, 3] {
                let base = Request { jitter: true, samples: rays * pixels, kernel, estimand, ..Request::default() };
                for request in [
                    Request { method: Method::Rays, ..base },
                    Request { method: Method::Comb, step: 0.7, ..base },
                    Request { method: Method::Comb, step: 5.0, ..base },
                ] {
                    let label =
                        format!("speckle, {} {kernel} {estimand}, {rays} rays, {}", request.method, request.step);
                    let images = replicates(&scenery, request);
                    nothing_strays(&label, &truth, &images);
                    agreement(label, &truth, &images, SAMPLES).hold();
                }
            }
        }
    }
}

/// The camera with its pixel coordinates mapped by `p -> a p + b` (rows of `[a | b]`), times a factor.
fn remapped(scenery: &Scenery, map: [[f64; 3]; 2], factor: f64) -> Camera {
    let m = scenery.camera.world_to_pixel();
    let row = |r: [f64; 3]| std::array::from_fn(|c| factor * (r[0] * m[0][c] + r[1] * m[1][c] + r[2] * m[2][c]));
    let rows = [row(map[0]), row(map[1]), row([0.0, 0.0, 1.0])];
    Camera::from_matrix(rows, scenery.camera.extent(), scenery.volume.grid(), Some(scenery.camera.near())).unwrap()
}

/// What a view, a map or a voxel type can make hard, one at a time.
fn hard_scenes() -> Vec<(&'static str, Kernel, Scenery)> {
    let diameter = skewed_grid().diameter();
    let bytes = speckle();
    let floats: Vec<f32> = bytes.iter().map(|&v| 1e-6 * f32::from(v).powi(3)).collect();
    let shorts: Vec<i16> =
        noise(bytes.len(), 77).iter().zip(&bytes).map(|(&a, &b)| i16::from(a) * 16 - 2000 + i16::from(b)).collect();
    let identity = DensityMap::default;
    let emphasis = DensityMap { emphasis: Some(Emphasis { threshold: 200.0, gain: 2.7 }), ..identity() };
    let parallel = View { parallel: true, azimuth: -119.0, elevation: -48.0, ..View::default() };
    // The eye is inside the volume: some of it lies behind the eye, more in front of the near plane.
    let inside = View { distance: Some(0.25 * diameter), near: Some(0.2 * diameter), fov: Some(110.0), ..pinhole() };
    let mut matrix = speckled_scene(&pinhole());
    matrix.camera = remapped(&matrix, [[1.5, 0.4, -7.0], [-0.1, 0.9, 2.3]], -2.5);
    vec![
        ("parallel", Kernel::Bspline3, speckled_scene(&parallel)),
        ("near plane inside the volume", Kernel::Tent, speckled_scene(&inside)),
        ("emphasis", Kernel::Tent, scene_of(skewed(bytes), emphasis, &close_up())),
        ("f32", Kernel::Tent, scene_of(skewed(floats), identity(), &close_up())),
        (
            "i16 rescaled",
            Kernel::Tent,
            scene_of(skewed(shorts).with_rescale(0.37, -5.0).unwrap(), identity(), &close_up()),
        ),
        ("skewed 3x4 matrix", Kernel::Tent, matrix),
    ]
}

#[test]
fn hard_views_maps_and_voxel_types_agree_with_ray_casting() {
    for (name, kernel, scenery) in hard_scenes() {
        let mut worst = f64::INFINITY;
        for estimand in Estimand::ALL {
            let truth = truth(&scenery, kernel, estimand);
            for method in [Method::Mc, Method::Stratified, Method::Qmc] {
                let request = Request { method, kernel, estimand, samples: ODD_SAMPLES, ..Request::default() };
                worst = worst.min(hold(name, &scenery, &truth, request));
            }
        }
        println!("{name}: smallest p is {worst:.1} times its level");
    }
}

/// The scenes above are rendered in 32 bits; this is the 64-bit arithmetic that larger or nearer views fall back on.
#[test]
fn sixty_four_bit_arithmetic_agrees_with_ray_casting() {
    let scenery = speckled_scene(&close_up());
    assert_eq!(made(&scenery, &Request { samples: SAMPLES, ..Request::default() }).counters["precision"], "f32");
    let density = density(&scenery);
    let distribution = Distribution::new(&density, VoxelOrder::Hilbert).unwrap();
    for kernel in [Kernel::Tent, Kernel::Bspline3] {
        for estimand in Estimand::ALL {
            let truth = truth(&scenery, kernel, estimand);
            let options =
                RenderOptions { estimand, kernel, precision: Some(Precision::F64), ..RenderOptions::default() };
            let one = |seed| {
                let stream = stream(Method::Qmc, ODD_SAMPLES, seed, distribution.total());
                render(&distribution, &*stream, &scenery.camera, &options, &Watch::default()).unwrap().image
            };
            let images: Vec<Image> = (0..REPLICATES).map(one).collect();
            agreement(format!("f64 {kernel} {estimand}"), &truth, &images, ODD_SAMPLES).hold();
        }
    }
}

/// The shell's image by brute force: each voxel's mass spread over `n` points of a Fibonacci lattice on the sphere of
/// radius half a voxel, turned by `turn` and projected by [`Camera::project`]. Gives (`count`, `line`).
fn shell_image(scenery: &Scenery, n: usize, turn: f64) -> [Image; 2] {
    let density = density(scenery);
    let grid = scenery.volume.grid();
    let camera = &scenery.camera;
    let extent = camera.extent();
    let mut images = [Image::zeros(extent), Image::zeros(extent)];
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let to_world = grid.index_to_world();
    let arms: Vec<DVec3> = (0..n)
        .map(|k| {
            let z = 1.0 - (2 * k + 1) as f64 / n as f64;
            let (sin, cos) = (golden * k as f64 + turn).sin_cos();
            let r = (1.0 - z * z).sqrt();
            to_world.matrix3 * (0.5 * DVec3::new(r * cos, r * sin, z))
        })
        .collect();
    for voxel in 0..grid.len() {
        let weight = density.weight(voxel);
        if weight == 0.0 {
            continue;
        }
        let [i, j, k] = grid.unravel(voxel);
        let centre = to_world.transform_point3(DVec3::new(i as f64, j as f64, k as f64));
        let mass = weight / density.report().weight_sum / n as f64;
        for &arm in &arms {
            let (px, py, z) = camera.project(centre + arm);
            let beside = !(px >= 0.0 && py >= 0.0 && px < extent.width as f64 && py < extent.height as f64);
            if beside || !camera.is_parallel() && z < camera.near() {
                continue;
            }
            let p = px as usize + extent.width * py as usize;
            images[0].values_mut()[p] += mass;
            images[1].values_mut()[p] += mass * density.mass() * camera.line_factor(px, py, z);
        }
    }
    images
}

/// The shell has no ray-cast reference; brute force stands in. Its error is that of two lattices that differ in
/// their turn: the truth is their mean, whose error has half their difference's standard deviation; three times
/// the root mean square of that half over the pixels is the budget of each.
#[test]
fn every_method_agrees_with_brute_force_under_shell() {
    let scenery = speckled_scene(&close_up());
    let [a, b] = [0.3, 1.7].map(|turn| shell_image(&scenery, 40_000, turn));
    let half = |e: usize| {
        let mut sum = a[e].clone();
        sum.values_mut().iter_mut().zip(b[e].values()).for_each(|(a, b)| *a = 0.5 * (*a + b));
        sum
    };
    for (e, estimand) in [Estimand::Count, Estimand::Line].into_iter().enumerate() {
        let image = half(e);
        let difference = a[e].difference(&b[e]).unwrap();
        let positive: Vec<f64> =
            image.values().iter().zip(difference.values()).filter(|(v, _)| **v > 0.0).map(|(_, d)| d * 0.5).collect();
        let rms = (positive.iter().map(|d| d * d).sum::<f64>() / positive.len() as f64).sqrt();
        println!("shell {estimand}: brute force is good to {:.1e} of the mean pixel", rms / image.mean());
        assert!(rms < 1e-3 * image.mean(), "the reference is too coarse");
        let mut error = image.clone();
        error.values_mut().iter_mut().for_each(|v| *v = if *v > 0.0 { 3.0 * rms } else { 0.0 });
        let truth = Truth { image, error, share: half(0) };
        for request in every_sampler().into_iter().filter(|r| r.order == VoxelOrder::Depth) {
            hold("speckle", &scenery, &truth, Request { kernel: Kernel::Shell, estimand, ..request });
        }
    }
}

/// The test has power: independent samples, the noisiest of the methods, against truths that are slightly wrong.
#[test]
fn a_wrong_kernel_estimand_scale_or_position_is_rejected() {
    let scenery = speckled_scene(&close_up());
    let rejects = |what: &str, scenery: &Scenery, truth: &Truth, estimand: Estimand| {
        let request = Request { method: Method::Mc, samples: SAMPLES, estimand, ..Request::default() };
        let agreement = agreement(what, truth, &replicates(scenery, request), SAMPLES);
        println!("{agreement}");
        assert!(agreement.rejected(), "not rejected: {agreement}");
    };
    let scaled = |truth: &Truth, factor: f64| {
        let mut truth = truth.clone();
        truth.image.values_mut().iter_mut().for_each(|v| *v *= factor);
        truth
    };
    let [count, line] = [Estimand::Count, Estimand::Line].map(|e| truth(&scenery, Kernel::Tent, e));
    for (estimand, right, other) in [(Estimand::Count, &count, &line), (Estimand::Line, &line, &count)] {
        rejects("1 % too bright", &scenery, &scaled(right, 1.01), estimand);
        rejects("1 % too dark", &scenery, &scaled(right, 0.99), estimand);
        rejects("box for tent", &scenery, &truth(&scenery, Kernel::Box, estimand), estimand);
        rejects("bspline3 for tent", &scenery, &truth(&scenery, Kernel::Bspline3, estimand), estimand);
        let match_mean = right.image.mean() / other.image.mean();
        rejects("the other estimand at equal mean", &scenery, &scaled(other, match_mean), estimand);
        for map in [[[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0], [0.0, 1.0, -0.5]]] {
            let mut moved = scenery.clone();
            moved.camera = remapped(&scenery, map, 1.0);
            rejects("half a pixel aside", &moved, right, estimand);
        }
    }
}

/// A defect of one voxel in hundreds is seen by the low-discrepancy net, whose own noise is small.
#[test]
fn one_missing_voxel_is_rejected() {
    let scenery = speckled_scene(&close_up());
    let mut voxels = speckle();
    *voxels.last_mut().unwrap() = 0;
    let short = Scenery { volume: skewed(voxels), ..scenery.clone() };
    let truth = truth(&short, Kernel::Tent, Estimand::Count);
    let request = Request { method: Method::Qmc, samples: SAMPLES, estimand: Estimand::Count, ..Request::default() };
    let agreement = agreement("last voxel missing", &truth, &replicates(&scenery, request), SAMPLES);
    println!("{agreement}");
    assert!(agreement.rejected(), "not rejected: {agreement}");
}
