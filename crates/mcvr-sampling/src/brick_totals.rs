//! Building the totals of all bricks that can be drawn, in parallel.

use mcvr_volume::Voxel;

use crate::SamplingError;
use crate::frustum::{Frustum, Sight};
use crate::order::{BRICK, Layout};
use crate::running_totals::{RunningTotals, TotalType};
use crate::units::Units;
use crate::word::Word;

/// What making the totals took, and what was left out.
#[derive(Clone, Copy, Default)]
pub(crate) struct BrickTally {
    pub(crate) read: u64,
    /// Bricks whose total is 0, left out or not.
    pub(crate) without: u64,
    pub(crate) beside: u64,
    pub(crate) near: u64,
    pub(crate) near_units: u64,
}

impl std::ops::Add for BrickTally {
    type Output = Self;

    fn add(self, o: Self) -> Self {
        Self {
            read: self.read + o.read,
            without: self.without + o.without,
            beside: self.beside + o.beside,
            near: self.near + o.near,
            near_units: self.near_units + o.near_units,
        }
    }
}

/// Total of each brick that can be seen, 0 of the others.
pub(crate) fn brick_totals<T: Voxel, U: Units<T>>(
    layout: &impl Layout,
    voxels: &[T],
    units: U,
    kind: TotalType,
    frustum: Option<&Frustum>,
) -> Result<(RunningTotals, BrickTally), SamplingError> {
    // Fewer at once where there would not be work for every thread.
    let share = layout.bricks().div_ceil(4 * rayon::current_num_threads());
    let at_once = layout.bricks_at_once().min(share.next_multiple_of(256));
    RunningTotals::build(kind, layout.bricks(), at_once, |first, totals| {
        let sights = frustum.map(|f| sights(layout, f, first, totals.len()));
        let tally = match sights.filter(|s| s.iter().any(|sight| *sight != Sight::Seen)) {
            None => BrickTally { read: layout.totals(first, voxels, units, totals) as u64, ..BrickTally::default() },
            Some(sights) => seen_totals(layout, voxels, units, first, &sights, totals),
        };
        let without = totals.iter().filter(|t| **t == 0).count() as u64;
        BrickTally { without, ..tally }
    })
}

/// What the camera sees of the bricks from `first` on.
fn sights(layout: &impl Layout, frustum: &Frustum, first: usize, count: usize) -> Vec<Sight> {
    let of = |brick| {
        let (low, high) = layout.bounds(brick);
        frustum.see(low, high)
    };
    (first..first + count).map(of).collect()
}

/// Totals of the bricks from `first` on where not all are seen.
fn seen_totals<T: Voxel, U: Units<T>>(
    layout: &impl Layout,
    voxels: &[T],
    units: U,
    first: usize,
    sights: &[Sight],
    totals: &mut [u64],
) -> BrickTally {
    let mut sums = [U::Word::default(); BRICK];
    let mut tally = BrickTally::default();
    for ((i, total), sight) in totals.iter_mut().enumerate().zip(sights) {
        *total = 0;
        if *sight == Sight::Beside {
            tally.beside += 1;
            continue;
        }
        tally.read += layout.sums(first + i, voxels, units, &mut sums) as u64;
        let sum = sums[BRICK - 1].to_u64();
        if *sight == Sight::Near {
            tally.near += 1;
            tally.near_units += sum;
        } else {
            *total = sum;
        }
    }
    tally
}
