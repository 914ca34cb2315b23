//! Independent targets drawn in rising order.
//!
//! The order statistics of M uniforms are the partial sums of M + 1 exponentials over their total (Rényi 1953;
//! Devroye, *Non-Uniform Random Variate Generation*, ch. V.3). The sum of a block's exponentials is a Gamma
//! variate independent of how it is divided within the block, so blocks are drawn first, one Gamma each, and a
//! block's inside can be drawn at any time on any thread.

use mcvr_sampling::rng::{Purpose, exponentials, fill_u32, keyed, spread};
use mcvr_sampling::{PointBlock, PointStream, block_count, block_len};
use rand::RngExt;
use rand_distr::{Exp1, Gamma};

/// Independent samples in rising order of their targets, which are placed with 53 bits: the probability of a voxel is wrong by
/// about 2^-53, far below what 2^40 samples could show.
#[derive(Clone, Debug)]
pub struct OrderStatistics {
    samples: u64,
    seed: u64,
    /// Sum of the spacings up to and including each block, over the sum of all: the block's last target.
    ends: Vec<f64>,
}

impl OrderStatistics {
    /// A stream of `samples` points.
    pub fn new(samples: u64, seed: u64) -> Self {
        let blocks = block_count(samples);
        let mut sum = 0.0;
        let mut ends: Vec<f64> = (0..blocks)
            .map(|block| {
                let mut rng = keyed(seed, Purpose::Blocks, block);
                let len = block_len(samples, block) as f64;
                // A Gamma's shape and scale here are positive, which is all that can go wrong.
                let spacing: f64 = Gamma::new(len, 1.0).map_or(len, |gamma| rng.sample(gamma));
                sum += spacing;
                sum
            })
            .collect();
        let last: f64 = keyed(seed, Purpose::Blocks, blocks).sample(Exp1);
        let whole = sum + last;
        ends.iter_mut().for_each(|e| *e /= whole);
        Self { samples, seed, ends }
    }
}

impl PointStream for OrderStatistics {
    fn samples(&self) -> u64 {
        self.samples
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        // Spacings from the words of the first axis, which gets its own values afterwards.
        let [words, ..] = &mut out.uniforms;
        fill_u32(self.seed, Purpose::Targets, block, words);
        exponentials(words, &mut out.targets);
        // A block of spacings below 2^5, with 32 fraction bits, sums below 2^48.
        let mut sum = 0u64;
        for t in &mut out.targets {
            sum += *t;
            *t = sum;
        }
        // Spacings below 2^-33 round to 0; a block of nothing else (one in 2^33, of a single sample) ends where it must.
        if let Some(last) = out.targets.last_mut().filter(|_| sum == 0) {
            (*last, sum) = (1, 1);
        }
        let low = if block == 0 { 0.0 } else { self.ends[block as usize - 1] };
        let high = self.ends[block as usize];
        let total = total as f64;
        let (offset, scale) = (low * total, (high - low) * total / sum as f64);
        // The next float below is at most the exact total less one, whichever way the total was rounded.
        spread(&mut out.targets, offset, scale, total.next_down().floor());
        crate::unsorted::fill_offsets(self.seed, block, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn targets(samples: u64, seed: u64, total: u64) -> Vec<u64> {
        let stream = OrderStatistics::new(samples, seed);
        let mut out = PointBlock::default();
        (0..block_count(samples))
            .flat_map(|b| {
                out.resize(block_len(samples, b));
                stream.fill(b, total, &mut out);
                out.targets.clone()
            })
            .collect()
    }

    #[test]
    fn targets_rise_and_stay_below_the_total() {
        for (samples, total) in [(1, 1), (1, 255), (4096, 10), (4097, 1 << 40), (20_000, (1 << 62) + 12345)] {
            let t = targets(samples, 11, total);
            assert_eq!(t.len() as u64, samples);
            assert!(t.windows(2).all(|w| w[0] <= w[1]) && t.iter().all(|&t| t < total), "{samples} {total}");
        }
    }

    /// Kolmogorov–Smirnov: √n D exceeds 1.95 with probability 1e-3; over 40 seeds, Šidák's 2.38 with about 2e-3.
    #[test]
    fn targets_are_uniform() {
        let (n, total) = (50_000u64, 1u64 << 50);
        for seed in 0..40 {
            let t = targets(n, seed, total);
            let d = t.iter().enumerate().fold(0.0f64, |d, (i, &t)| {
                let x = t as f64 / total as f64;
                d.max((x - i as f64 / n as f64).abs()).max((x - (i + 1) as f64 / n as f64).abs())
            });
            assert!(d * (n as f64).sqrt() < 2.38, "seed {seed}: {}", d * (n as f64).sqrt());
        }
    }

    /// Counts of independent samples in equal bins are multinomial: their chi-square is neither too large
    /// (biased) nor too small (stratified).
    #[test]
    fn counts_vary_as_independent_samples_do() {
        let (n, bins, total) = (1u64 << 16, 64u64, 1u64 << 50);
        let chi: f64 = (0..50)
            .map(|seed| {
                let mut counts = vec![0f64; bins as usize];
                targets(n, seed, total).iter().for_each(|t| counts[(t >> 44) as usize] += 1.0);
                let expected = n as f64 / bins as f64;
                counts.iter().map(|c| (c - expected).powi(2) / expected).sum::<f64>()
            })
            .sum();
        // Sum of 50 chi-squares with 63 degrees of freedom each: mean 3150, deviation √6300; five of those.
        assert!((chi - 3150.0).abs() < 5.0 * 6300f64.sqrt(), "{chi}");
    }

    #[test]
    fn the_minimum_and_maximum_have_their_exact_means() {
        // E(min) = 1/(n+1), deviation about the same; over 2000 seeds within 5 standard errors.
        let (n, total, seeds) = (100u64, 1u64 << 50, 2000u64);
        let (mut low, mut high) = (0.0, 0.0);
        for seed in 0..seeds {
            let t = targets(n, seed, total);
            low += t[0] as f64 / total as f64;
            high += 1.0 - t[n as usize - 1] as f64 / total as f64;
        }
        let bound = 5.0 / (n as f64 + 1.0) / (seeds as f64).sqrt();
        for mean in [low / seeds as f64, high / seeds as f64] {
            assert!((mean - 1.0 / (n as f64 + 1.0)).abs() < bound, "{mean}");
        }
    }
}
