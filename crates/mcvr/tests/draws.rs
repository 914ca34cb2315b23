//! Voxels are drawn as often as they weigh.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use common::*;
use mcvr::Method;
use mcvr::qmc::{Scramble, SobolNet};
use mcvr::sampling::{Distribution, PointBlock, PointStream, VoxelOrder, block_count, block_len};
use mcvr::scene::{Density, DensityMap};
use statrs::distribution::{ChiSquared, ContinuousCDF};

const SAMPLES: u64 = 150_001;

fn small() -> Density {
    Density::new(&skewed(speckle()), DensityMap::default()).unwrap()
}

/// How often each voxel is drawn.
fn draws(distribution: &Distribution, stream: &dyn PointStream) -> Vec<u64> {
    let mut counts = vec![0u64; distribution.density().volume().grid().len()];
    let mut out = PointBlock::default();
    let samples = stream.samples();
    for block in 0..block_count(samples) {
        out.resize(block_len(samples, block));
        stream.fill(block, distribution.total(), &mut out);
        out.targets.iter().for_each(|&t| counts[distribution.voxel_of(t)] += 1);
    }
    counts
}

/// Pearson's statistic over the voxels of positive weight; each expects hundreds of draws, so that it has the
/// chi-square distribution. Both tails are looked at: too even is as wrong as too uneven.
#[test]
fn independent_draws_pass_the_chi_square_test_against_the_weights() {
    let density = small();
    let sum = density.report().weight_sum;
    for order in [VoxelOrder::Raster, VoxelOrder::Hilbert, VoxelOrder::ZInnermost] {
        let distribution = Distribution::new(&density, order).unwrap();
        for method in [Method::Mc, Method::McQuicksort, Method::McBinary, Method::McLinear] {
            let counts = draws(&distribution, &*stream(method, SAMPLES, 5, distribution.total()));
            let (mut statistic, mut cells) = (0.0, 0);
            for (voxel, &count) in counts.iter().enumerate() {
                let expected = density.weight(voxel) / sum * SAMPLES as f64;
                if expected == 0.0 {
                    assert_eq!(count, 0, "{method}: voxel {voxel} of weight 0 was drawn");
                    continue;
                }
                assert!(expected > 100.0);
                statistic += (count as f64 - expected).powi(2) / expected;
                cells += 1;
            }
            let p = ChiSquared::new(f64::from(cells) - 1.0).unwrap().sf(statistic);
            println!("{method} {}: chi-square {statistic:.1} over {cells} voxels, p = {p:.4}", order.name());
            assert!((1e-4..=1.0 - 1e-4).contains(&p), "{method} {}: p = {p:e}", order.name());
        }
    }
}

/// Targets `(k + φ_k) W / M` with `0 ≤ φ_k < 1`: of the strata that meet a voxel's stretch of length `w`, all but the
/// two at its ends lie in it whole, so its count lies within 2 of `M w / W`; where φ is one number for all k the targets
/// are equally spaced and the count lies within 1. One unit in 2^50 of rounding changes neither, save on a tie.
#[test]
fn even_draws_hit_every_voxel_as_often_as_it_weighs_but_for_its_ends() {
    let density = small();
    let sum = density.report().weight_sum;
    for samples in [1, 100, 4097, SAMPLES, 1 << 17] {
        for order in orders() {
            let distribution = Distribution::new(&density, order).unwrap();
            let nets = Scramble::ALL.map(|(name, scramble)| {
                (format!("qmc {name}"), 1.0, Box::new(SobolNet::new(samples, 5, scramble)) as Box<dyn PointStream>)
            });
            let stratified =
                ("stratified".to_owned(), 2.0, stream(Method::Stratified, samples, 5, distribution.total()));
            for (name, most, stream) in nets.into_iter().chain([stratified]) {
                let counts = draws(&distribution, &*stream);
                assert_eq!(counts.iter().sum::<u64>(), samples);
                for (voxel, &count) in counts.iter().enumerate() {
                    let off = count as f64 - density.weight(voxel) / sum * samples as f64;
                    assert!(off.abs() < most + 1e-9, "{name} {} {samples}: voxel {voxel} off by {off}", order.name());
                    assert!(count == 0 || density.weight(voxel) > 0.0, "{name}: voxel {voxel} of weight 0 was drawn");
                }
            }
        }
    }
}

/// Every stream that is to be unbiased, by name, of so many samples.
fn unbiased_streams(samples: u64, seed: u64, total: u64) -> Vec<(String, Box<dyn PointStream>)> {
    let nets = [Scramble::Linear, Scramble::Owen, Scramble::Shift].map(|scramble| {
        (format!("qmc {}", scramble.name()), Box::new(SobolNet::new(samples, seed, scramble)) as Box<dyn PointStream>)
    });
    SAMPLERS
        .into_iter()
        .filter(|m| *m != Method::Qmc)
        .map(|method| (method.name().to_owned(), stream(method, samples, seed, total)))
        .chain(nets)
        .collect()
}

/// A point taken at random from an unbiased stream is uniform in (target, x, y, z) over the seeds, however few points
/// the stream has. Biases of the order of 1/M, which no image of many samples shows, are large here. Chi-square over 4^4
/// equal cells, one point of each seed, hence independent; 24 tests at 1e-5 on each side.
#[test]
fn a_random_point_of_a_few_is_uniform_over_seeds_in_all_four_dimensions() {
    let (seeds, total) = (1u64 << 15, 1u64 << 40);
    for samples in [1u64, 3, 100] {
        let mut counts: Vec<(String, Vec<f64>)> =
            unbiased_streams(samples, 0, total).into_iter().map(|(name, _)| (name, vec![0.0; 256])).collect();
        let mut out = PointBlock::default();
        for seed in 0..seeds {
            // The finaliser of SplitMix64: independent of what the streams make of the seed.
            let mut h = (seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            h = (h ^ h >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            h = (h ^ h >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
            let k = ((h ^ h >> 31) % samples) as usize;
            for ((_, counts), (_, stream)) in counts.iter_mut().zip(unbiased_streams(samples, seed, total)) {
                out.resize(samples as usize);
                stream.fill(0, total, &mut out);
                let quarters = [0, 1, 2].map(|a: usize| (out.uniforms[a][k] >> 30) as usize);
                let target = (out.targets[k] >> 38) as usize;
                counts[quarters.into_iter().fold(target, |cell, q| cell << 2 | q)] += 1.0;
            }
        }
        let expected = seeds as f64 / 256.0;
        for (name, counts) in counts {
            let statistic: f64 = counts.iter().map(|c| (c - expected).powi(2) / expected).sum();
            let p = ChiSquared::new(255.0).unwrap().sf(statistic);
            println!("{name}, one of {samples}: chi-square {statistic:.1} over 256 cells, p = {p:.4}");
            assert!((1e-5..=1.0 - 1e-5).contains(&p), "{name}, one of {samples}: p = {p:e}");
        }
    }
}
