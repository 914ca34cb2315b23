//! Walking forward through running totals.

use super::{GROUP, RunningTotals, Total, Totals};

/// The running sums of one group at a time.
pub(crate) struct Cursor<'a> {
    of: &'a RunningTotals,
    group: usize,
    /// The sum before each brick of the group, and behind the last.
    sums: [u64; GROUP + 1],
}

impl<'a> Cursor<'a> {
    /// At a group.
    pub(super) fn new(of: &'a RunningTotals, group: usize) -> Self {
        let mut cursor = Self { of, group, sums: [0; GROUP + 1] };
        cursor.load(group);
        cursor
    }

    /// The sum before a brick, and behind it.
    #[inline(always)]
    pub(crate) fn ends(&mut self, brick: usize) -> [u64; 2] {
        if brick / GROUP != self.group {
            self.load(brick / GROUP);
        }
        [self.sums[brick % GROUP], self.sums[brick % GROUP + 1]]
    }

    /// The brick that holds a target below the total, searched forward from a brick at or before it.
    #[inline(always)]
    pub(crate) fn seek(&mut self, from: usize, target: u64) -> usize {
        if from / GROUP != self.group {
            self.load(from / GROUP);
        }
        let mut at = from % GROUP;
        if target >= self.sums[GROUP] {
            self.load(forward(&self.of.before, self.group, target));
            at = 0;
        }
        self.group * GROUP + forward(&self.sums, at, target)
    }

    /// The brick that holds a target below the total and not before the group; stays where it is.
    #[inline]
    pub(crate) fn peek(&self, target: u64) -> usize {
        if target < self.sums[GROUP] {
            return self.group * GROUP + self.sums.partition_point(|s| *s <= target).max(1) - 1;
        }
        self.of.find(target).0
    }

    #[inline(never)]
    fn load(&mut self, group: usize) {
        self.group = group;
        let mut sum = self.of.before[group];
        self.sums[0] = sum;
        with_totals!(&self.of.totals, totals => {
            let totals = &totals[group * GROUP..];
            let totals = &totals[..totals.len().min(GROUP)];
            let (used, rest) = self.sums[1..].split_at_mut(totals.len());
            for (s, total) in used.iter_mut().zip(totals) {
                sum += total.wide();
                *s = sum;
            }
            // Where the last group has fewer bricks.
            rest.fill(sum);
        });
    }
}

/// The last entry of rising sums that is not greater than a target, but for the last of all; searched forward from one that is
/// not greater: a few steps one by one, then doubling.
#[inline(always)]
fn forward(sums: &[u64], from: usize, target: u64) -> usize {
    let mut at = from;
    for _ in 0..4 {
        if target < sums[at + 1] {
            return at;
        }
        at += 1;
    }
    let mut step = 8;
    let mut low = at;
    while low + step + 1 < sums.len() && sums[low + step] <= target {
        low += step;
        step *= 2;
    }
    let high = (low + step + 1).min(sums.len());
    low + sums[low..high].partition_point(|s| *s <= target) - 1
}
