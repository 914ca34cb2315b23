//! One target in each of M strata of equal mass, at the same place in all of them.

use mcvr_sampling::rng::{Purpose, hash};
use mcvr_sampling::{BLOCK, PointBlock, PointStream, Strata};

/// Systematic sampling: targets `(k + ξ) / M` with one uniform `ξ` for all (Madow and Madow 1944); kernel offsets independent
/// and uniform. These are the voxels of the sorted net with random offsets: a hybrid of the 2003 paper.
#[derive(Clone, Copy, Debug)]
pub struct Systematic {
    samples: u64,
    seed: u64,
}

impl Systematic {
    /// A stream of `samples` points.
    pub fn new(samples: u64, seed: u64) -> Self {
        Self { samples, seed }
    }
}

impl PointStream for Systematic {
    fn samples(&self) -> u64 {
        self.samples
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        let shift = hash(&[self.seed, Purpose::Shift as u64]) as u32;
        Strata::new(block * BLOCK as u64, total, self.samples).fill(shift, &mut out.targets);
        crate::unsorted::fill_offsets(self.seed, block, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_sampling::{block_count, block_len};

    #[test]
    fn targets_are_equally_far_apart_and_their_place_is_uniform_over_seeds() {
        let (samples, total) = (5000, 5000 << 32);
        let mut mean = 0.0;
        let seeds = 2000;
        for seed in 0..seeds {
            let stream = Systematic::new(samples, seed);
            let mut out = PointBlock::default();
            let mut first = None;
            for block in 0..if seed < 10 { block_count(samples) } else { 1 } {
                out.resize(block_len(samples, block));
                stream.fill(block, total, &mut out);
                for (k, t) in (block * BLOCK as u64..).zip(&out.targets) {
                    assert_eq!(t - (k << 32), *first.get_or_insert(*t), "seed {seed}");
                }
            }
            mean += first.map_or(0.0, |t| t as f64 / 2f64.powi(32)) / seeds as f64;
        }
        assert!((mean - 0.5).abs() < 5.0 / (12.0 * seeds as f64).sqrt(), "{mean}");
    }
}
