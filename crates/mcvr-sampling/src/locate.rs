//! Finding the voxel of a target inside a brick.

use crate::SimdLevel;
use crate::order::BRICK;
use crate::word::Word;
use mcvr_volume::vectorised;

/// Entries per row: one vector of 32-bit words.
pub(crate) const ROW: usize = 16;

/// A brick's inclusive running sums, with the last sum of each row of 16 beside them, so that a target is
/// found by two vector comparisons.
pub(crate) struct BrickSums<W> {
    pub(crate) sums: [W; BRICK],
    rows: [W; ROW],
}

impl<W: Word> BrickSums<W> {
    pub(crate) fn new() -> Self {
        Self { sums: [W::default(); BRICK], rows: [W::default(); ROW] }
    }

    /// The last sum of each row.
    #[cfg(target_arch = "x86_64")]
    pub(crate) fn rows(&self) -> &[W; ROW] {
        &self.rows
    }

    /// To be called whenever the sums have changed.
    #[inline(always)]
    pub(crate) fn index(&mut self) {
        self.rows = std::array::from_fn(|r| self.sums[r * ROW + ROW - 1]);
    }

    /// Position of the voxel that holds a target below the brick's total: the number of running sums that do
    /// not exceed it. A voxel of weight 0 has the sum of its predecessor and is never returned.
    #[inline(always)]
    pub(crate) fn find(&self, target: W) -> u32 {
        let row = count(&self.rows, target).min(ROW as u32 - 1);
        let start = row as usize * ROW;
        let entries: &[W; ROW] = self.sums[start..start + ROW].first_chunk().unwrap_or(&self.rows);
        row * ROW as u32 + count(entries, target)
    }
}

/// Positions of many targets of one brick, given the sum before it.
pub(crate) fn find_all<W: Word>(
    level: SimdLevel,
    brick: &BrickSums<W>,
    targets: &[u64],
    before: u64,
    positions: &mut [u32],
) {
    #[cfg(target_arch = "x86_64")]
    if level == SimdLevel::Avx512
        && let Some(brick) = (brick as &dyn std::any::Any).downcast_ref::<BrickSums<u32>>()
    {
        // SAFETY: the level is only ever chosen on processors with AVX-512 F, BW, DQ and VL.
        unsafe { find_avx512(brick, targets, before, positions) };
        return;
    }
    find_generic::<W>(level, brick, targets, before, positions);
}

vectorised! {
    fn find_generic<W: Word>(brick: &BrickSums<W>, targets: &[u64], before: u64, positions: &mut [u32]) = find_body::<W>
}

#[inline(always)]
fn find_body<W: Word>(brick: &BrickSums<W>, targets: &[u64], before: u64, positions: &mut [u32]) {
    for (p, t) in positions.iter_mut().zip(targets) {
        *p = brick.find(W::from_u64(t - before));
    }
}

/// [`find_body`] with each row as one comparison into a mask; a test holds it to the same positions.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn find_avx512(brick: &BrickSums<u32>, targets: &[u64], before: u64, positions: &mut [u32]) {
    use std::arch::x86_64::{_mm512_cmple_epu32_mask, _mm512_loadu_si512, _mm512_set1_epi32};
    // SAFETY: 16 words of 32 bits are read from an array of 16.
    let rows = unsafe { _mm512_loadu_si512(brick.rows.as_ptr().cast()) };
    for (p, t) in positions.iter_mut().zip(targets) {
        let target = _mm512_set1_epi32((t - before) as i32);
        let row = _mm512_cmple_epu32_mask(rows, target).count_ones().min(ROW as u32 - 1);
        // SAFETY: the row is below 16, so its 16 words lie within the 256.
        let entries = unsafe { _mm512_loadu_si512(brick.sums.as_ptr().add(row as usize * ROW).cast()) };
        *p = row * ROW as u32 + _mm512_cmple_epu32_mask(entries, target).count_ones();
    }
}

/// How many of the entries are not greater than the target.
#[inline(always)]
fn count<W: Word>(entries: &[W; ROW], target: W) -> u32 {
    let mut n = 0;
    for e in entries {
        n += u32::from(*e <= target);
    }
    n
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check<W: Word + std::fmt::Debug>(weights: &[u64]) {
        let mut brick = BrickSums::<W>::new();
        let mut sum = 0;
        for (i, s) in brick.sums.iter_mut().enumerate() {
            sum += weights.get(i).copied().unwrap_or(0);
            *s = W::from_u64(sum);
        }
        brick.index();
        let mut target = 0;
        for (i, &w) in weights.iter().enumerate() {
            // Both ends of the voxel's range of targets.
            for t in [target, target + w.saturating_sub(1)] {
                if w > 0 {
                    assert_eq!(brick.find(W::from_u64(t)) as usize, i, "weights {weights:?}");
                    for level in SimdLevel::available() {
                        let mut found = [0];
                        find_all(level, &brick, &[t + 1000], 1000, &mut found);
                        assert_eq!(found[0] as usize, i, "{level:?}");
                    }
                }
            }
            target += w;
        }
    }

    #[test]
    fn each_target_finds_the_voxel_whose_range_holds_it() {
        let patterns: [fn(u64) -> u64; 5] =
            [|_| 1, |i| i % 3, |i| u64::from(i == 255), |i| u64::from(i % 17 == 0) * 9, |i| i * i];
        for f in patterns {
            let weights: Vec<u64> = (0..256).map(f).collect();
            check::<u32>(&weights);
            check::<u64>(&weights.iter().map(|w| w << 30).collect::<Vec<_>>());
        }
        check::<u32>(&[0, 0, 5]);
        check::<u32>(&[7]);
    }
}
