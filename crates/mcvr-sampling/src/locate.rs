//! Finding the voxel of a target inside a brick.

use crate::order::BRICK;
use crate::units::Word;

/// Entries per row: one vector of 32-bit words.
const ROW: usize = 16;

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
