//! Point streams: where a method's samples come from.

use crate::{SamplingError, SimdLevel};
use mcvr_volume::vectorised;

/// Points per block: the unit of random keys and of parallel work.
pub const BLOCK: usize = 2048;

/// Most samples of one image; accumulators are proven to hold this many.
pub const MAX_SAMPLES: u64 = 1 << 40;

/// How the voxels of a block's targets are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Search {
    /// Targets rise within the block: one walk forward.
    Walk,
    /// Targets are in any order: a binary search each.
    Binary,
    /// Targets are in any order: a walk from the first voxel each, as the simplest program does it.
    Linear,
}

/// The points of one block: as many targets and uniforms as the block is long.
#[derive(Clone, Debug, Default)]
pub struct PointBlock {
    /// Positions in the running sum of integer weights, `0 ≤ target < total`.
    pub targets: Vec<u64>,
    /// Uniforms in 32 bits per kernel axis (x, y, z); word n stands for `(n + 1/2) / 2^32`.
    pub uniforms: [Vec<u32>; 3],
}

impl PointBlock {
    /// Sets the length; contents are unspecified afterwards.
    pub fn resize(&mut self, len: usize) {
        self.targets.resize(len, 0);
        for u in &mut self.uniforms {
            u.resize(len, 0);
        }
    }
}

/// A source of points. Implementations must give the same block for the same number whenever and on
/// whichever thread it is asked for.
pub trait PointStream: Sync {
    /// Number of points `M`.
    fn samples(&self) -> u64;

    /// How targets are ordered, and so how voxels are found.
    fn search(&self) -> Search {
        Search::Walk
    }

    /// Writes block `block` (points `block * BLOCK ..`) for a distribution whose weights sum to `total`.
    /// `out` has been resized to [`block_len`].
    fn fill(&self, block: u64, total: u64, out: &mut PointBlock);
}

/// Number of blocks of `samples` points.
pub fn block_count(samples: u64) -> u64 {
    samples.div_ceil(BLOCK as u64)
}

/// Number of points in block `block` of `samples` points.
pub fn block_len(samples: u64, block: u64) -> usize {
    (samples - block * BLOCK as u64).min(BLOCK as u64) as usize
}

/// `floor((k + fraction / 2^32) * total / samples)`: the target of stratum `k` at a fixed place in it. Exact;
/// [`Strata`] gives the same in a run of strata without a division each.
pub fn target_of(k: u64, fraction: u32, total: u64, samples: u64) -> u64 {
    let position = u128::from(k) << 32 | u128::from(fraction);
    // k < samples ≤ 2^40 and total < 2^63, so total * position < 2^135 could overflow: split off the quotient.
    let (q, r) = (total / samples, total % samples);
    ((u128::from(q) * position + u128::from(r) * position / u128::from(samples)) >> 32) as u64
}

/// Targets of consecutive strata of equal mass, in 64.64 fixed point. At most 2^-31 of a unit of weight below
/// the exact position (2^-32 by the fraction, 2^-64 a step), so a target is the exact one or, rarely, that less one, and
/// never at or beyond the total.
#[derive(Clone, Copy, Debug)]
pub struct Strata {
    position: u128,
    step: u128,
}

impl Strata {
    /// Starts at stratum `first` of `samples` strata of the total.
    pub fn new(first: u64, total: u64, samples: u64) -> Self {
        let (total, samples) = (u128::from(total), u128::from(samples));
        let product = u128::from(first) * total;
        let fraction = ((product % samples) << 64) / samples;
        Self { position: (product / samples) << 64 | fraction, step: (total << 64) / samples }
    }

    /// Writes the targets at `fraction / 2^32` of this stratum and the following ones; agrees with [`Self::next`].
    pub fn fill(self, fraction: u32, out: &mut [u64]) {
        let mut position = self.position + (self.step >> 32) * u128::from(fraction);
        let (mut high, mut low) = ([0; STEPS], [0; STEPS]);
        for (high, low) in high.iter_mut().zip(&mut low) {
            (*high, *low) = ((position >> 64) as u64, position as u64);
            // Positions beyond the last stratum may wrap; no target is made of them.
            position = position.wrapping_add(self.step);
        }
        let leap = self.step.wrapping_mul(STEPS as u128);
        steps(SimdLevel::detect(), &mut high, &mut low, [(leap >> 64) as u64, leap as u64], out);
    }

    /// Target at `fraction / 2^32` of this stratum; then moves on to the next.
    #[inline(always)]
    pub fn next(&mut self, fraction: u32) -> u64 {
        let target = ((self.position + (self.step >> 32) * u128::from(fraction)) >> 64) as u64;
        self.position += self.step;
        target
    }
}

/// Strata that are stepped through side by side.
const STEPS: usize = 16;

vectorised! {
    fn steps(high: &mut [u64; STEPS], low: &mut [u64; STEPS], leap: [u64; 2], out: &mut [u64]) = steps_body
}

/// Writes the upper halves of positions that advance by `leap`, side by side.
#[inline(always)]
fn steps_body(high: &mut [u64; STEPS], low: &mut [u64; STEPS], leap: [u64; 2], out: &mut [u64]) {
    let [leap_high, leap_low] = leap;
    let mut chunks = out.chunks_exact_mut(STEPS);
    for chunk in &mut chunks {
        for i in 0..STEPS {
            chunk[i] = high[i];
            let next = low[i].wrapping_add(leap_low);
            high[i] = high[i].wrapping_add(leap_high).wrapping_add(u64::from(next < low[i]));
            low[i] = next;
        }
    }
    for (target, high) in chunks.into_remainder().iter_mut().zip(high) {
        *target = *high;
    }
}

/// Checks a number of samples: to be done before a stream is made, as some take memory for each block.
///
/// # Errors
/// [`SamplingError::Samples`] for none or more than 2^40.
pub fn check_samples(samples: u64) -> Result<(), SamplingError> {
    if (1..=MAX_SAMPLES).contains(&samples) { Ok(()) } else { Err(SamplingError::Samples(samples)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn targets_of_strata_stay_inside_and_rise(
            samples in 1u64..1 << 40, total in 1u64..1 << 62, k in any::<u64>(), f in any::<u32>(), g in any::<u32>()
        ) {
            let k = k % samples;
            let (a, b) = (target_of(k, f, total, samples), target_of(k, g, total, samples));
            prop_assert!(a < total && b < total);
            prop_assert!((f <= g) == (a <= b) || a == b);
            if k + 1 < samples {
                prop_assert!(target_of(k, u32::MAX, total, samples) <= target_of(k + 1, 0, total, samples));
            }
        }

        #[test]
        fn targets_are_the_exact_floor(samples in 1u64..1 << 20, total in 1u64..1 << 40, k in any::<u64>(), f in any::<u32>()) {
            let k = k % samples;
            let exact = (u128::from(k) << 32 | u128::from(f)) * u128::from(total) / (u128::from(samples) << 32);
            prop_assert_eq!(u128::from(target_of(k, f, total, samples)), exact);
        }

        #[test]
        fn strata_agree_with_the_exact_targets(
            samples in 1u64..1 << 40, total in 1u64..1 << 62, k in any::<u64>(), f in any::<[u32; 8]>()
        ) {
            let k = k % samples;
            let mut strata = Strata::new(k, total, samples);
            for (i, f) in f.into_iter().enumerate().take((samples - k) as usize) {
                let (fast, exact) = (strata.next(f), target_of(k + i as u64, f, total, samples));
                let mut filled = [0];
                Strata::new(k + i as u64, total, samples).fill(f, &mut filled);
                prop_assert!(filled[0].abs_diff(exact) <= 1);
                // Below by at most one, and only when the exact position is within rounding of an integer.
                prop_assert!(fast == exact || fast + 1 == exact, "{} {}", fast, exact);
            }
        }
    }
}
