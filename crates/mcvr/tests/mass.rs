//! Mass is neither made nor lost, and images follow the units and the place of the volume.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::*;
use glam::{DMat3, DVec3};
use mcvr::scene::{Camera, DensityMap, Estimand, Extent, Image, Kernel, Transfer, View};
use mcvr::volume::{Grid, Volume};
use mcvr::{Method, Request, Scenery};

const SAMPLES: u64 = 50_021;

fn samples(method: Method) -> u64 {
    if method == Method::McLinear { 5_003 } else { SAMPLES }
}

/// Every sampling request worth telling apart here.
fn requests(estimand: Estimand) -> impl Iterator<Item = Request> {
    SAMPLERS.into_iter().flat_map(move |method| {
        let base = Request { method, estimand, samples: samples(method), ..Request::default() };
        Kernel::ALL.map(|kernel| Request { kernel, ..base })
    })
}

fn lobster(view: &View, side: usize) -> Scenery {
    let loaded = mcvr::volume::load("phantom:lobster@64", None).unwrap();
    let camera = Camera::look(view, loaded.volume.grid(), Extent::new(side, side).unwrap()).unwrap();
    Scenery::new(loaded.volume, DensityMap::default(), camera)
}

#[test]
fn count_images_of_samplers_sum_to_exactly_the_share_of_samples_inside() {
    let cut = speckled_scene(&View { fov: Some(30.0), near: Some(skewed_grid().diameter()), ..pinhole() });
    for scenery in [speckled_scene(&pinhole()), cut] {
        for request in requests(Estimand::Count) {
            let made = made(&scenery, &request);
            let m = request.samples as f64;
            let inside: u64 = made
                .image
                .values()
                .iter()
                .map(|v| {
                    // Whole counts over M, each rounded once: good to 2^-52 of at most M.
                    assert!((v * m - (v * m).round()).abs() <= m * f64::EPSILON, "{v} is no count of {m}");
                    (v * m).round() as u64
                })
                .sum();
            assert_eq!(made.counters["render"]["inside"], inside, "{} {}", request.method, request.kernel);
        }
    }
}

#[test]
fn an_image_that_holds_the_volume_loses_no_sample() {
    for parallel in [false, true] {
        let scenery = speckled_scene(&View { parallel, ..View::default() });
        for request in requests(Estimand::Count) {
            assert_eq!(made(&scenery, &request).counters["render"]["inside"], request.samples);
        }
    }
}

#[test]
fn the_exact_count_image_sums_to_one() {
    for (azimuth, elevation) in [(30.0, 20.0), (-125.0, -61.0)] {
        for parallel in [false, true] {
            let scenery = lobster(&View { azimuth, elevation, parallel, ..View::default() }, 24);
            let made = exact(&scenery, Kernel::Tent, Estimand::Count, 5e-5, 8);
            let (off, claim) = ((made.image.sum() - 1.0).abs(), made.error.image.sum());
            assert!(off <= claim, "{azimuth},{elevation} parallel {parallel}: off by {off:e}, not {claim:e}");
            println!("{azimuth},{elevation} parallel {parallel}: off by {off:.1e}");
            assert!(off < 1e-6, "{azimuth},{elevation} parallel {parallel}: off by {off:e}");
        }
    }
}

/// A parallel `line` image integrates to the mass: `Σ line · pixel area = F`, a pixel's area being `1 / det` mm². For
/// the samplers up to the fixed-point weight (2^-30), 32-bit arithmetic (2^-22) and summing.
#[test]
fn a_parallel_line_image_integrates_to_the_mass() {
    let scenery = speckled_scene(&View { parallel: true, azimuth: -119.0, elevation: -48.0, ..View::default() });
    let mass = density(&scenery).mass();
    let integral = |image: &Image| image.sum() / scenery.camera.det() / mass;
    for request in requests(Estimand::Line) {
        let off = (integral(&made(&scenery, &request).image) - 1.0).abs();
        assert!(off < 2f64.powi(-22), "{} {}: off by {off:e}", request.method, request.kernel);
    }
    for (kernel, tolerance) in [(Kernel::Box, 1e-3), (Kernel::Tent, 1e-5), (Kernel::Bspline3, 1e-4)] {
        let reference = exact(&scenery, kernel, Estimand::Line, tolerance, 8);
        let off = (integral(&reference.image) - 1.0).abs();
        assert!(off < tolerance, "{kernel}: off by {off:e}");
    }
}

fn scaled(scenery: &Scenery, slope: f64) -> Scenery {
    let transfer = Transfer::Linear { slope, intercept: 0.0 };
    Scenery { map: DensityMap { transfer, ..DensityMap::default() }, ..scenery.clone() }
}

/// Scaling by a power of two is exact in every number on the way.
#[test]
fn weights_times_a_power_of_two_leave_count_images_as_they_are_and_scale_line_images() {
    let bytes = speckled_scene(&pinhole());
    let floats: Vec<f32> = speckle().iter().map(|&v| f32::from(v).sqrt()).collect();
    let floats = scene_of(skewed(floats), DensityMap::default(), &pinhole());
    for scenery in [&bytes, &floats] {
        for request in requests(Estimand::Count).filter(|r| r.kernel == Kernel::Tent) {
            let one = made(scenery, &request).image;
            let line = Request { estimand: Estimand::Line, ..request };
            let line_one = made(scenery, &line).image;
            for k in [-40, -1, 1, 3, 15, 16, 60] {
                let factor = 2f64.powi(k);
                let scenery = scaled(scenery, factor);
                assert_eq!(one, made(&scenery, &request).image, "{} 2^{k}", request.method);
                let scaled = made(&scenery, &line).image;
                for (a, b) in line_one.values().iter().zip(scaled.values()) {
                    assert!((a * factor - b).abs() <= 1e-12 * b.abs(), "{} 2^{k}: {a} {b}", request.method);
                }
            }
        }
    }
}

/// A volume and a camera whose every number is a small dyadic fraction, both moved by `by` mm.
fn dyadic(by: DVec3) -> Scenery {
    let grid = Grid::new(DIMS, DVec3::new(0.75, 1.0, 1.5), by, DMat3::IDENTITY).unwrap();
    // Looks along +y from (3, -16, 4) mm, 24 pixels per unit of tangent.
    let eye = DVec3::new(3.0, -16.0, 4.0) + by;
    let rows = [DVec3::new(24.0, 10.0, 0.0), DVec3::new(0.0, 8.0, -24.0), DVec3::Y];
    let matrix = rows.map(|r| [r.x, r.y, r.z, -r.dot(eye)]);
    let camera = Camera::from_matrix(matrix, Extent::new(20, 16).unwrap(), &grid, Some(1.0)).unwrap();
    Scenery::new(Volume::from_vec(grid, speckle(), "dyadic").unwrap(), DensityMap::default(), camera)
}

/// With dyadic numbers every sum is exact, so not a bit may change.
#[test]
fn a_volume_moved_with_its_camera_gives_the_same_image_bit_for_bit_where_sums_are_exact() {
    let still = dyadic(DVec3::ZERO);
    for by in [DVec3::new(1.0, 2.0, -3.0), DVec3::new(-1000.0, 4096.0, 77.0)] {
        let moved = dyadic(by);
        for estimand in Estimand::ALL {
            for request in requests(estimand) {
                let name = format!("{} {} {estimand} by {by}", request.method, request.kernel);
                assert_eq!(made(&still, &request).image, made(&moved, &request).image, "{name}");
            }
        }
    }
}

/// In general the camera's last column rounds to 2^-53 of the distance to the world's origin, and the 32-bit shift
/// it becomes to 2^-24 of the image's extent: positions move by at most some 1e-5 pixel. A sample changes pixel when it
/// lies that close to one of four borders: of 50,000 samples fewer than two are expected to, and by Poisson's law
/// more than twelve do with a probability below 1e-6. Each changes two pixels.
#[test]
fn a_volume_moved_with_its_camera_gives_the_same_image_up_to_rounding() {
    let grid = skewed_grid();
    let by = DVec3::new(123.0, -77.0, 1009.0);
    let moved_grid = Grid::new(DIMS, grid.spacing(), grid.origin() + by, grid.direction()).unwrap();
    let still = speckled_scene(&pinhole());
    let moved = scene_of(
        Volume::from_vec(moved_grid, speckle(), "moved").unwrap(),
        DensityMap::default(),
        &View { near: Some(still.camera.near()), ..pinhole() },
    );
    for request in requests(Estimand::Count) {
        let difference = made(&still, &request).image.difference(&made(&moved, &request).image).unwrap();
        let changed = difference.values().iter().map(|d| d.abs()).sum::<f64>() * request.samples as f64;
        assert!(changed < 24.5, "{} {}: {changed}", request.method, request.kernel);
    }
    for estimand in Estimand::ALL {
        let [a, b] = [&still, &moved].map(|s| exact(s, Kernel::Tent, estimand, 1e-4, 8).image);
        // Rounding may change where cubature refines, so images agree within the tolerance only.
        let most = a.difference(&b).unwrap().values().iter().fold(0f64, |m, d| m.max(d.abs()));
        assert!(most <= 2e-4 * a.mean(), "{estimand}: {most:e}");
    }
}
