//! Errors fall as fast as theory says, and go on falling (METHOD section 4).
//!
//! A biased or stuck sampler can pass a test at one number of samples; the slope over many finds it out. All errors
//! are against the exact image of a lobster phantom, whose own error is at most a tenth of the least error measured.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::convergence::*;
use common::{density, stream};
use mcvr::Method;
use mcvr::sampling::{PointBlock, PointStream};
use mcvr::scene::Estimand;

/// Independent samples: the mean square error is `Σ p (1 - p) / (M P)`. Its relative variance over one image is
/// `(2 + 1/λ) / P_eff`: the excess of a Poisson count of mean λ, and `P_eff = (Σ p)² / Σ p²` pixels that
/// matter. A replicate's log2 RMSE then has the standard deviation `√((2 + 1/λ) / P_eff) / (2 ln 2)` at most
/// (λ taken at the least M and the mean pixel), a mean of R of them 1/√R of that, and the slope over n
/// levels that divided by `√(n (n² - 1) / 12)`. Five such deviations are allowed; they must be below 0.03.
#[test]
fn independent_samples_err_as_the_inverse_root_of_their_number() {
    let (scenery, truth) = lobster();
    let (low, high) = (10u32, 18u32);
    let p = truth.image.values();
    let effective = truth.image.sum().powi(2) / p.iter().map(|p| p * p).sum::<f64>();
    let lambda = truth.image.mean() * f64::from(1 << low);
    let levels = f64::from(high - low + 1);
    let deviation = ((2.0 + 1.0 / lambda) / effective).sqrt()
        / (2.0 * std::f64::consts::LN_2)
        / (REPLICATES as f64).sqrt()
        / (levels * (levels * levels - 1.0) / 12.0).sqrt();
    let bound = 5.0 * deviation;
    assert!(bound < 0.03, "{bound}");
    for method in [Method::Mc, Method::McQuicksort, Method::McBinary] {
        let total = density(scenery).report().weight_sum as u64;
        let streams = |samples, seed| stream(method, samples, seed, total);
        let logs = log_errors(&square_errors(scenery, truth, low..=high, &streams));
        let (b, _) = mean(&logs.iter().map(|row| slope(row)).collect::<Vec<_>>());
        println!("{method}: slope {b:.4}, expected -0.5 ± {bound:.4}");
        assert!((b + 0.5).abs() < bound, "{method}: slope {b:.4} is not -0.5 ± {bound:.4}");
    }
}

/// While there are fewer strata than voxels that can be drawn (2^15.2 of them), stratification reaches into space;
/// beyond, the kernel offsets' own independence is left and the slope returns to -1/2 (METHOD section 3).
#[test]
fn stratified_samples_err_less_with_every_doubling_and_at_first_faster_than_independent_ones() {
    let (scenery, truth) = lobster();
    let streams = |m, seed| stream(Method::Stratified, m, seed, 0);
    let few = square_errors(scenery, truth, 10..=15, &streams);
    assert_eq!(not_steep("stratified, 2^10 to 2^15", &few), None);
    let many = square_errors(scenery, truth, 14..=20, &streams);
    assert_eq!(plateau("stratified", &many), None);
    not_steep("stratified, 2^14 to 2^20", &many);
}

/// One sample from each of M strata of equal probability never has a larger variance than M independent ones:
/// Σ of the strata's `p_k (1 - p_k) / M²` is at most `p (1 - p) / M` by Jensen's inequality. Tested one-sided with
/// Student's t over the replicates' mean square errors.
#[test]
fn stratified_samples_never_err_more_than_independent_ones() {
    let (scenery, truth) = lobster();
    let errors = square_errors(scenery, truth, 8..=20, &|m, seed| stream(Method::Stratified, m, seed, 0));
    let pixels = truth.image.values().len() as f64;
    let independent = truth.image.values().iter().map(|p| p * (1.0 - p)).sum::<f64>() / pixels;
    for (i, level) in errors.iter().enumerate() {
        let m = f64::from(1u32 << (8 + i));
        let (square, se) = mean(level);
        let ratio = square * m / independent;
        println!("stratified at 2^{}: variance {ratio:.3} of independent samples'", 8 + i);
        assert!(square - critical(LEVEL) * se <= independent / m, "2^{}: {ratio}", 8 + i);
    }
}

#[test]
fn the_net_errs_less_with_every_doubling_across_65536_and_faster_than_independent_samples() {
    let (scenery, truth) = lobster();
    let errors = square_errors(scenery, truth, 14..=20, &|m, seed| stream(Method::Qmc, m, seed, 0));
    assert_eq!(plateau("qmc", &errors), None);
    assert_eq!(not_steep("qmc", &errors), None);
}

/// A sampler stuck on its first points: point k is point k mod 2^12 of a net of 2^12, as of a Sobol sequence that
/// runs out of direction numbers.
struct Stuck(Box<dyn PointStream>, u64);

impl PointStream for Stuck {
    fn samples(&self) -> u64 {
        self.1
    }
    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        self.0.fill(block % mcvr::sampling::block_count(self.0.samples()), total, out);
    }
}

#[test]
fn a_sampler_stuck_on_its_first_points_is_found_out() {
    let (scenery, truth) = lobster();
    let stuck =
        |m: u64, seed| -> Box<dyn PointStream> { Box::new(Stuck(stream(Method::Qmc, m.min(1 << 12), seed, 0), m)) };
    let errors = square_errors(scenery, truth, 10..=16, &stuck);
    let found = plateau("stuck", &errors).expect("the plateau from 2^12 on");
    assert!(found.contains("no fall at doubling 2:"), "{found}");
    assert!(not_steep("stuck", &errors).is_some());
}

/// Pearson's statistic over K cells (every pixel that expects at least one sample, and the rest as one) of a
/// multinomial sample of size M has mean `K - 1` and variance `2 (K - 1) + (Σ 1/p - K² - 2K + 2) / M` exactly. Its
/// mean over R replicates is allowed five standard deviations.
#[test]
fn independent_samples_err_as_much_as_the_multinomial_law_says() {
    let (scenery, truth) = lobster();
    for (method, level) in [(Method::Mc, 12u32), (Method::Mc, 17), (Method::McQuicksort, 14), (Method::McBinary, 14)] {
        let samples = 1u64 << level;
        let m = samples as f64;
        let cells: Vec<usize> =
            (0..truth.image.values().len()).filter(|&p| truth.image.values()[p] * m >= 1.0).collect();
        let mut share: Vec<f64> = cells.iter().map(|&p| truth.image.values()[p]).collect();
        let rest = 1.0 - share.iter().sum::<f64>();
        share.push(rest);
        assert!(rest * m >= 1.0, "the rest expects {} samples", rest * m);
        let k = share.len() as f64;
        let variance = 2.0 * (k - 1.0) + (share.iter().map(|p| 1.0 / p).sum::<f64>() - k * k - 2.0 * k + 2.0) / m;
        let total = density(scenery).report().weight_sum as u64;
        let statistics: Vec<f64> = (0..REPLICATES)
            .map(|seed| {
                let request = mcvr::Request {
                    method,
                    samples,
                    seed: seed + total,
                    estimand: Estimand::Count,
                    ..mcvr::Request::default()
                };
                let image = common::made(scenery, &request).image;
                let mut counts: Vec<f64> = cells.iter().map(|&p| image.values()[p]).collect();
                counts.push(1.0 - counts.iter().sum::<f64>());
                counts.iter().zip(&share).map(|(x, p)| m * (x - p).powi(2) / p).sum()
            })
            .collect();
        let (ratio, bound) =
            (mean(&statistics).0 / (k - 1.0), 5.0 * (variance / statistics.len() as f64).sqrt() / (k - 1.0));
        println!("{method} at 2^{level}: variance over prediction {ratio:.4}, expected 1 ± {bound:.4}");
        assert!((ratio - 1.0).abs() < bound, "{method} at 2^{level}: {ratio:.4} is not 1 ± {bound:.4}");
    }
}
