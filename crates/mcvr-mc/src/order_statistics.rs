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
    /// Sum of the spacings before every `stride`-th block.
    sums: Vec<f64>,
    /// Blocks from one kept sum to the next; those between are drawn again where they are needed.
    stride: u64,
    /// Sum of all spacings.
    whole: f64,
}

/// Most sums that are kept (4 MiB): all of them up to 2^30 samples.
const KEPT: u64 = 1 << 19;

impl OrderStatistics {
    /// A stream of `samples` points.
    pub fn new(samples: u64, seed: u64) -> Self {
        let blocks = block_count(samples);
        let stride = blocks.div_ceil(KEPT);
        let mut stream =
            Self { samples, seed, sums: Vec::with_capacity(blocks.div_ceil(stride) as usize), stride, whole: 0.0 };
        let mut sum = 0.0;
        for block in 0..blocks {
            if block.is_multiple_of(stride) {
                stream.sums.push(sum);
            }
            sum += stream.spacing(block);
        }
        let last: f64 = keyed(seed, Purpose::Blocks, blocks).sample(Exp1);
        stream.whole = sum + last;
        stream
    }

    /// Bytes that a stream of so many samples keeps.
    pub fn bytes(samples: u64) -> u64 {
        let blocks = block_count(samples);
        8 * blocks.div_ceil(blocks.div_ceil(KEPT).max(1))
    }

    /// Sum of a block's spacings.
    fn spacing(&self, block: u64) -> f64 {
        let len = block_len(self.samples, block) as f64;
        // A Gamma's shape and scale here are positive, which is all that can go wrong.
        Gamma::new(len, 1.0).map_or(len, |gamma| keyed(self.seed, Purpose::Blocks, block).sample(gamma))
    }

    /// Sums of the spacings before a block and up to its end, over the sum of all. Added in the one order, so that a sum has
    /// the same bits whether it was kept or is made again.
    fn ends(&self, block: u64) -> [f64; 2] {
        let mut sum = self.sums[(block / self.stride) as usize];
        for before in block - block % self.stride..block {
            sum += self.spacing(before);
        }
        let end = match (block + 1).is_multiple_of(self.stride) {
            true => self.sums.get(((block + 1) / self.stride) as usize).copied(),
            false => None,
        };
        [sum, end.unwrap_or_else(|| sum + self.spacing(block))].map(|s| s / self.whole)
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
        let [low, high] = self.ends(block);
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

    #[test]
    fn sums_made_again_have_the_bits_of_kept_ones() {
        let samples = 20_000;
        let all = OrderStatistics::new(samples, 5);
        assert_eq!(all.stride, 1);
        for stride in [2, 3, 7] {
            let sums = all.sums.iter().copied().step_by(stride).collect();
            let some = OrderStatistics { sums, stride: stride as u64, ..all.clone() };
            assert!((0..block_count(samples)).all(|b| some.ends(b) == all.ends(b)), "{stride}");
        }
        for samples in [1, 1 << 30, (1 << 30) + 1, 1 << 40] {
            assert!((8..=8 * KEPT).contains(&OrderStatistics::bytes(samples)), "{samples}");
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
