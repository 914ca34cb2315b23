//! Running sums over bricks in little memory: the exact total of each brick in as few bytes as hold it, and the sum before each
//! group of bricks in 64 bits.
//!
//! A sum of 64 bits per brick of 256 voxels would take 3.1 % of a volume of bytes. Totals of such bricks under the identity map
//! fit 16 bits, which takes 0.8 %. A search adds up the totals of one group.

use std::ops::Add;

use rayon::prelude::*;

use crate::SamplingError;

/// Runs an expression with `$totals` bound to the totals in their own type.
macro_rules! with_totals {
    ($any:expr, $totals:ident => $body:expr) => {
        match $any {
            Totals::U16($totals) => $body,
            Totals::U32($totals) => $body,
            Totals::U64($totals) => $body,
        }
    };
}

mod cursor;

pub(crate) use cursor::Cursor;

/// Bricks of a group.
const GROUP: usize = 32;

/// The type that totals of bricks are kept in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TotalType {
    U16,
    U32,
    U64,
}

impl TotalType {
    /// The narrowest for totals up to a number.
    pub(crate) fn holding(most: u64) -> Self {
        if most <= u64::from(u16::MAX) {
            Self::U16
        } else if most <= u64::from(u32::MAX) {
            Self::U32
        } else {
            Self::U64
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::U16 => 2,
            Self::U32 => 4,
            Self::U64 => 8,
        }
    }

    /// Bytes of the running sums of so many bricks.
    pub(crate) fn bytes_of(self, bricks: usize) -> usize {
        bricks * self.bytes() + (bricks.div_ceil(GROUP) + 1) * size_of::<u64>()
    }
}

/// Totals of bricks, each within the type's range.
#[derive(Clone, Debug)]
enum Totals {
    U16(Vec<u16>),
    U32(Vec<u32>),
    U64(Vec<u64>),
}

/// A type of totals.
trait Total: Copy + Default + Send + Sync {
    fn narrow(total: u64) -> Self;
    fn wide(self) -> u64;
}

macro_rules! total {
    ($($t:ty),*) => {$(
        impl Total for $t {
            #[inline(always)]
            fn narrow(total: u64) -> Self {
                debug_assert!(total <= u64::from(Self::MAX), "{total} is beyond the type of totals");
                total as Self
            }
            #[inline(always)]
            fn wide(self) -> u64 {
                u64::from(self)
            }
        }
    )*};
}

total!(u16, u32, u64);

/// Totals of bricks and the sum of all bricks before each.
#[derive(Clone, Debug)]
pub(crate) struct RunningTotals {
    totals: Totals,
    /// Sum of all groups before, one entry per group and the grand total at the end.
    before: Vec<u64>,
}

/// Room for so many zeros, or the reason why not.
fn zeros<N: Copy + Default>(len: usize) -> Result<Vec<N>, SamplingError> {
    let mut out = Vec::new();
    out.try_reserve_exact(len).map_err(|_| SamplingError::Limit {
        method: "distribution",
        problem: format!("{len} sums of bricks take {} bytes each, which are not to be had", size_of::<N>()),
    })?;
    out.resize(len, N::default());
    Ok(out)
}

impl RunningTotals {
    /// Of so many bricks, about `at_once` of which are made in one call of `make`, on all threads: it is given the first brick's
    /// number and writes the totals from there on, each within the type's range. Its results are added.
    ///
    /// # Errors
    /// [`SamplingError::Limit`] without memory, [`SamplingError::Empty`] when the sum is 2^63 or more.
    pub(crate) fn build<R: Add<Output = R> + Default + Send>(
        kind: TotalType,
        bricks: usize,
        at_once: usize,
        make: impl Fn(usize, &mut [u64]) -> R + Sync,
    ) -> Result<(Self, R), SamplingError> {
        let mut before = zeros(bricks.div_ceil(GROUP) + 1)?;
        let mut totals = match kind {
            TotalType::U16 => Totals::U16(zeros(bricks)?),
            TotalType::U32 => Totals::U32(zeros(bricks)?),
            TotalType::U64 => Totals::U64(zeros(bricks)?),
        };
        let made =
            with_totals!(&mut totals, totals => fill(totals, &mut before, at_once.next_multiple_of(GROUP), make));
        let mut sum = 0u64;
        for b in &mut before {
            let next = sum.checked_add(*b).filter(|s| *s < 1 << 63);
            *b = std::mem::replace(
                &mut sum,
                next.ok_or_else(|| SamplingError::Empty("the integer weights sum to 2^63 or more".into()))?,
            );
        }
        Ok((Self { totals, before }, made))
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        with_totals!(&self.totals, t => size_of_val(&t[..])) + size_of_val(&self.before[..])
    }

    /// Sum of all bricks.
    pub(crate) fn total(&self) -> u64 {
        self.before.last().copied().unwrap_or(0)
    }

    /// The brick that holds a target below the total, and the sum before that brick.
    pub(crate) fn find(&self, target: u64) -> (usize, u64) {
        let group = self.before.partition_point(|b| *b <= target).max(1) - 1;
        let (at, before) = with_totals!(&self.totals, t => find_in(&t[group * GROUP..], self.before[group], target));
        (group * GROUP + at, before)
    }

    /// For many bricks in rising order, from one on.
    pub(crate) fn cursor(&self, brick: usize) -> Cursor<'_> {
        Cursor::new(self, brick / GROUP)
    }

    /// For many bricks in rising order, from the one on that holds a target below the total; and that brick.
    #[inline]
    pub(crate) fn cursor_at(&self, target: u64) -> (Cursor<'_>, usize) {
        let cursor = Cursor::new(self, self.before.partition_point(|b| *b <= target).max(1) - 1);
        let brick = cursor.peek(target);
        (cursor, brick)
    }
}

/// Writes all totals, and the sum of each group.
fn fill<N: Total, R: Add<Output = R> + Default + Send>(
    totals: &mut [N],
    groups: &mut [u64],
    at_once: usize,
    make: impl Fn(usize, &mut [u64]) -> R + Sync,
) -> R {
    let jobs = totals.par_chunks_mut(at_once).zip(groups.par_chunks_mut(at_once / GROUP)).enumerate();
    let made = jobs.map_init(Vec::new, |wide, (job, (totals, groups))| {
        wide.resize(totals.len(), 0);
        let made = make(job * at_once, wide);
        for (narrow, total) in totals.iter_mut().zip(&wide[..]) {
            *narrow = N::narrow(*total);
        }
        for (sum, group) in groups.iter_mut().zip(wide.chunks(GROUP)) {
            // A sum that does not fit is refused later, not wrapped.
            *sum = group.iter().fold(0, |a: u64, b| a.saturating_add(*b));
        }
        made
    });
    made.reduce(R::default, R::add)
}

/// The first brick whose end lies beyond a target, and the sum before it.
#[inline(always)]
fn find_in<N: Total>(totals: &[N], before: u64, target: u64) -> (usize, u64) {
    let mut sum = before;
    for (at, total) in totals.iter().enumerate() {
        let end = sum + total.wide();
        if target < end {
            return (at, sum);
        }
        sum = end;
    }
    (totals.len().saturating_sub(1), sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::mix;

    fn of(totals: &[u64], kind: TotalType, at_once: usize) -> RunningTotals {
        let make = |first: usize, out: &mut [u64]| {
            out.copy_from_slice(&totals[first..first + out.len()]);
            out.len()
        };
        let (running, made) = RunningTotals::build(kind, totals.len(), at_once, make).unwrap();
        assert_eq!(made, totals.len());
        running
    }

    /// Against plain prefix sums: both ends of every brick's range of targets, found at once and walking from any brick before.
    fn check(totals: &[u64]) {
        let mut before = vec![0];
        totals.iter().for_each(|t| before.push(before[before.len() - 1] + t));
        let least = TotalType::holding(totals.iter().copied().max().unwrap_or(0));
        let kinds = [TotalType::U16, TotalType::U32, TotalType::U64];
        for kind in kinds.into_iter().filter(|k| k.bytes() >= least.bytes()) {
            let running = of(totals, kind, 100);
            assert_eq!(running.bytes(), kind.bytes_of(totals.len()));
            assert_eq!(running.total(), before[totals.len()]);
            let (mut walking, mut reading) = (running.cursor(0), running.cursor(0));
            let mut last = 0;
            for (brick, total) in totals.iter().enumerate() {
                assert_eq!(reading.ends(brick), [before[brick], before[brick + 1]], "{kind:?} {brick}");
                if *total == 0 {
                    continue;
                }
                for target in [before[brick], before[brick] + total / 2, before[brick + 1] - 1] {
                    assert_eq!(running.find(target), (brick, before[brick]), "{kind:?} {brick}");
                    // From the brick itself, the last one that was found, and those about the ends of groups.
                    for from in [last, brick, brick / GROUP * GROUP, (brick / GROUP * GROUP).saturating_sub(1), 0] {
                        assert_eq!(running.cursor(last).seek(from, target), brick, "{kind:?} from {from}");
                    }
                    assert_eq!(walking.peek(target), brick, "{kind:?} from {last}");
                    assert_eq!(walking.seek(last, target), brick, "{kind:?} from {last}");
                    let (mut there, at) = running.cursor_at(target);
                    assert_eq!((at, there.ends(at)[0]), (brick, before[brick]), "{kind:?}");
                    last = brick;
                }
            }
        }
    }

    #[test]
    fn bricks_are_found_as_by_plain_prefix_sums() {
        for bricks in [1, 2, 63, 64, 65, 127, 128, 129, 700] {
            check(&vec![1; bricks]);
            check(&vec![65_535; bricks]);
            check(&(0..bricks as u64).map(|i| mix(i) >> 48).collect::<Vec<_>>());
            check(&(0..bricks as u64).map(|i| mix(i) >> 33).collect::<Vec<_>>());
            check(&(0..bricks as u64).map(|i| mix(i) >> 12).collect::<Vec<_>>());
            // Bricks that are empty or out of sight, runs of them longer than a group, and whole volumes but for one brick.
            check(
                &(0..bricks as u64)
                    .map(|i| if mix(i).is_multiple_of(9) { 1 + mix(i) % 70_000 } else { 0 })
                    .collect::<Vec<_>>(),
            );
            check(&(0..bricks).map(|i| u64::from(i % 200 == 63) * 9).collect::<Vec<_>>());
            check(&(0..bricks).map(|i| u64::from(i + 1 == bricks) * (1 << 61)).collect::<Vec<_>>());
            check(&(0..bricks).map(|i| u64::from(i == 0) * u64::from(u32::MAX)).collect::<Vec<_>>());
        }
        assert_eq!(of(&[0; 70], TotalType::U16, 64).total(), 0);
    }

    #[test]
    fn the_narrowest_type_holds_the_greatest_total() {
        let of = TotalType::holding;
        assert_eq!([of(0), of(65_535), of(65_536)], [TotalType::U16, TotalType::U16, TotalType::U32]);
        assert_eq!([of(u32::MAX.into()), of(1 << 32), of(u64::MAX)], [TotalType::U32, TotalType::U64, TotalType::U64]);
    }

    #[test]
    fn sums_beyond_63_bits_are_refused() {
        for totals in [vec![1 << 62; 2], vec![u64::MAX; 64], vec![1 << 63]] {
            let make = |first: usize, out: &mut [u64]| {
                out.copy_from_slice(&totals[first..first + out.len()]);
                0
            };
            assert!(RunningTotals::build(TotalType::U64, totals.len(), 64, make).is_err(), "{}", totals.len());
        }
    }
}
