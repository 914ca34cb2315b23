//! The point sets that the net was compared with are unbiased, and their errors fall as they should.
//!
//! [`common::agreement`] and [`common::convergence`] state the tests, their null distributions and their levels. All seeds are
//! fixed, so the outcome never changes.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::agreement::{Truth, agreement, nothing_strays};
use common::convergence::*;
use common::*;
use mcvr::mc::{OrderStatistics, Ssp, Systematic};
use mcvr::qmc::{Lattice, Paired, Permuted, Scramble, SobolNet, SobolSequence};
use mcvr::sampling::{Distribution, PointStream, RenderOptions, VoxelOrder, render};
use mcvr::scene::{Estimand, Image, Kernel, View, Watch};

const NAMES: [&str; 7] = ["systematic", "ssp", "random voxels", "lattice", "nested", "permuted", "sequence"];

fn point_set(name: &str, samples: u64, seed: u64, distribution: &Distribution<'_>) -> Box<dyn PointStream> {
    let net = |scramble| SobolNet::new(samples, seed, scramble);
    match name {
        "systematic" => Box::new(Systematic::new(samples, seed)),
        "ssp" => Box::new(Ssp::new(samples, seed, distribution)),
        "random voxels" => {
            Box::new(Paired::new(OrderStatistics::new(samples, seed), net(Scramble::default())).unwrap())
        }
        "lattice" => Box::new(Lattice::new(samples, seed)),
        "nested" => Box::new(net(Scramble::Nested)),
        "permuted" => Box::new(Permuted::new(net(Scramble::default()), [2, 0, 1]).unwrap()),
        "sequence" => Box::new(SobolSequence::new(seed, Scramble::default()).run(0, samples)),
        _ => panic!("no point set is called '{name}'"),
    }
}

/// All agree with ray casting, with fewer samples than voxels and with more, and with a number that is no power of two.
#[test]
fn every_point_set_agrees_with_ray_casting() {
    let scenery = speckled_scene(&View { fov: Some(38.0), ..pinhole() });
    let density = density(&scenery);
    let order = VoxelOrder::default().resolve(&scenery.camera, scenery.volume.grid());
    let distribution = Distribution::in_view(&density, order, &scenery.camera, Kernel::Tent).unwrap();
    let share = exact(&scenery, Kernel::Tent, Estimand::Count, 1e-3, 4).image;
    let mut seed = 0;
    for estimand in Estimand::ALL {
        let wanted = exact(&scenery, Kernel::Tent, estimand, 1e-6, 8);
        let truth = Truth { image: wanted.image, error: wanted.error.image, share: share.clone() };
        let options = RenderOptions { estimand, kernel: Kernel::Tent, ..RenderOptions::default() };
        for name in NAMES {
            for samples in [256, 1 << 15, 40_007] {
                if name == "sequence" && samples == 40_007 {
                    continue; // runs are powers of two
                }
                let images: Vec<Image> = (0..REPLICATES)
                    .map(|_| {
                        seed += 1;
                        let stream = point_set(name, samples, seed, &distribution);
                        render(&distribution, &*stream, &scenery.camera, &options, &Watch::default()).unwrap().image
                    })
                    .collect();
                let label = format!("{name}, {samples} samples, {estimand}");
                nothing_strays(&label, &truth, &images);
                let least = agreement(label.clone(), &truth, &images, samples).hold();
                println!("{label}: smallest p is {least:.1} times its level");
            }
        }
    }
}

fn errors(name: &str, levels: std::ops::RangeInclusive<u32>) -> Vec<Vec<f64>> {
    let (scenery, truth) = lobster();
    let density = density(scenery);
    let order = VoxelOrder::default().resolve(&scenery.camera, scenery.volume.grid());
    let distribution = Distribution::new(&density, order).unwrap();
    let streams = |samples, seed| point_set(name, samples, seed, &distribution);
    square_errors(scenery, truth, levels, &streams)
}

#[test]
fn low_discrepancy_in_all_coordinates_errs_less_with_every_doubling_and_faster_than_independent_samples() {
    for name in ["lattice", "nested", "permuted", "sequence"] {
        let errors = errors(name, 14..=19);
        assert_eq!(plateau(name, &errors), None);
        assert_eq!(not_steep(name, &errors), None);
    }
}

/// With more samples than the 2^15.2 voxels, the independent half is left. Its error falls as `M^(-1/2)`: neither slower,
/// which the plateau would show, nor faster. A two-sided test of the slope at five standard errors over the replicates.
#[test]
fn half_a_point_set_falls_back_to_independent_samples() {
    for name in ["systematic", "ssp", "random voxels"] {
        let errors = errors(name, 17..=20);
        assert_eq!(plateau(name, &errors), None);
        let (slope, se) = mean(&log_errors(&errors).iter().map(|row| slope(row)).collect::<Vec<_>>());
        println!("{name}: slope {slope:.4} ± {se:.4}");
        assert!((slope + 0.5).abs() < 5.0 * se, "{name}: {slope:.4} ± {se:.4}");
    }
}

/// SSP sampling has at most the variance of independent samples, by negative association. Systematic sampling has no such
/// law, but here it is so too. One-sided Student's t over the replicates, the other way round: they must err less.
#[test]
fn even_shares_of_voxels_err_less_than_independent_ones() {
    let (_, truth) = lobster();
    let pixels = truth.image.values().len() as f64;
    let independent = truth.image.values().iter().map(|p| p * (1.0 - p)).sum::<f64>() / pixels;
    for name in ["systematic", "ssp"] {
        for (level, errors) in (10..).zip(errors(name, 10..=17)) {
            let m = f64::from(1u32 << level);
            let (square, se) = mean(&errors);
            println!("{name} at 2^{level}: variance {:.3} of independent samples'", square * m / independent);
            assert!(square + critical(LEVEL) * se < independent / m, "{name} at 2^{level}");
        }
    }
}
