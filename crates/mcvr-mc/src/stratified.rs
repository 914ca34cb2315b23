//! One target in each of M strata of equal mass.

use mcvr_sampling::rng::{Purpose, fill_u32};
use mcvr_sampling::{BLOCK, PointBlock, PointStream, Strata};

/// Targets `(k + ξ_k) / M` with independent uniforms `ξ_k`; kernel offsets independent and uniform.
#[derive(Clone, Copy, Debug)]
pub struct Stratified {
    samples: u64,
    seed: u64,
}

impl Stratified {
    /// A stream of `samples` points.
    pub fn new(samples: u64, seed: u64) -> Self {
        Self { samples, seed }
    }
}

impl PointStream for Stratified {
    fn samples(&self) -> u64 {
        self.samples
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        // The uniforms of the first axis serve as the targets' jitter before they get their own values.
        let [first, ..] = &mut out.uniforms;
        fill_u32(self.seed, Purpose::Targets, block, first);
        let mut strata = Strata::new(block * BLOCK as u64, total, self.samples);
        for (target, &jitter) in out.targets.iter_mut().zip(first.iter()) {
            *target = strata.next(jitter);
        }
        crate::unsorted::fill_offsets(self.seed, block, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_sampling::{block_count, block_len, target_of};

    #[test]
    fn each_stratum_holds_one_target() {
        let (samples, total) = (10_000, 1_234_567_891_011);
        let stream = Stratified::new(samples, 3);
        let mut out = PointBlock::default();
        for block in 0..block_count(samples) {
            out.resize(block_len(samples, block));
            stream.fill(block, total, &mut out);
            for (i, &t) in out.targets.iter().enumerate() {
                let k = block * BLOCK as u64 + i as u64;
                assert!(t + 1 >= target_of(k, 0, total, samples) && t <= target_of(k, u32::MAX, total, samples));
            }
        }
    }
}
