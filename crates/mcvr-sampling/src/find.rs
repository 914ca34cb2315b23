//! The voxels of a block of targets, by the search that the stream asks for.

use mcvr_volume::{Voxel, with_voxels};

#[cfg(target_arch = "x86_64")]
use crate::dense::{self, MANY};
use crate::engine::Counters;
use crate::locate::{BrickSums, find_all};
use crate::order::{Layout, with_layout};
use crate::running_totals::RunningTotals;
use crate::units::{Units, with_units};
use crate::unpack::Turned;
use crate::word::Word;
use crate::{Distribution, Search, SimdLevel};

/// Voxel coordinates of a block's targets.
pub(crate) trait Locate: Sync {
    /// Writes them; `turned` is kept from block to block of one thread.
    fn locate(
        &self,
        search: Search,
        targets: &[u64],
        places: &mut [Vec<u32>; 3],
        turned: &mut Turned,
        counters: &mut Counters,
    );
}

/// The locator of a distribution, for its voxel type and order.
pub(crate) fn locator<'a>(distribution: &'a Distribution<'_>, level: SimdLevel) -> Box<dyn Locate + 'a> {
    let density = distribution.density();
    let culled = distribution.counters().bricks_beside + distribution.counters().bricks_near > 0;
    with_layout!(&distribution.layout, layout =>
        with_voxels!(density.volume().voxels(), voxels =>
            with_units!(&distribution.weights, density, units =>
                Box::new(Locator { layout, voxels: &voxels[..], units, totals: &distribution.totals, culled, level })
                    as Box<dyn Locate + 'a>)))
}

struct Locator<'a, L, T, U> {
    layout: &'a L,
    voxels: &'a [T],
    units: U,
    totals: &'a RunningTotals,
    culled: bool,
    level: SimdLevel,
}

impl<L: Layout, T: Voxel, U: Units<T>> Locate for Locator<'_, L, T, U> {
    fn locate(
        &self,
        search: Search,
        targets: &[u64],
        places: &mut [Vec<u32>; 3],
        turned: &mut Turned,
        counters: &mut Counters,
    ) {
        turned.off();
        let resolved = match search {
            Search::Walk => self.walk(targets, places, turned, counters),
            Search::Binary => self.binary(targets, places, turned, counters),
            Search::Linear => self.linear(targets, places, turned, counters),
        };
        if resolved { self.layout.turn(places) } else { self.layout.resolve(self.level, places) }
    }
}

impl<L: Layout, T: Voxel, U: Units<T>> Locator<'_, L, T, U> {
    #[inline(always)]
    fn decode(&self, brick: usize, turned: &mut Turned, sums: &mut BrickSums<U::Word>, counters: &mut Counters) {
        counters.voxels_read += self.layout.unpack(brick, self.voxels, self.units, turned, &mut sums.sums) as u64;
        counters.bricks_decoded += 1;
        sums.index();
    }

    /// Places targets from number `first` on, all in one brick whose sums are given.
    #[inline(always)]
    fn place(
        &self,
        (brick, before): (usize, u64),
        sums: &BrickSums<U::Word>,
        targets: &[u64],
        first: usize,
        positions: &mut [u32],
        places: &mut [Vec<u32>; 3],
    ) {
        find_all(self.level, sums, targets, before, positions);
        let start = self.layout.start(brick);
        let [px, py, pz] = places;
        let run = first..first + targets.len();
        let out = px[run.clone()].iter_mut().zip(&mut py[run.clone()]).zip(&mut pz[run]);
        for (((x, y), z), &position) in out.zip(positions.iter()) {
            [*x, *y, *z] = self.layout.place(brick, start, position);
        }
    }

    /// As [`Self::place`], with coordinates along the layout's own axes where the targets are many and rise, and the processor
    /// can; says whether it did.
    #[inline(always)]
    fn place_many(
        &self,
        (brick, before): (usize, u64),
        sums: &BrickSums<U::Word>,
        targets: &[u64],
        first: usize,
        places: &mut [Vec<u32>; 3],
    ) -> bool {
        #[cfg(target_arch = "x86_64")]
        if targets.len() >= MANY
            && self.level == SimdLevel::Avx512
            && let Some(lines) = self.layout.lines()
            && let Some(sums) = (sums as &dyn std::any::Any).downcast_ref::<BrickSums<u32>>()
        {
            let [x, y, z] = places.each_mut().map(|p| &mut p[first..first + targets.len()]);
            let start = self.layout.start(brick);
            // SAFETY: the level is only ever chosen on processors with AVX-512 F, BW, DQ and VL.
            unsafe { dense::place(sums, targets, before, start, lines, [x, y, z]) };
            return true;
        }
        let _ = (brick, before, sums, targets, first, places);
        false
    }

    /// Rising targets: every brick that holds some is decoded once. Says whether all places are coordinates already.
    fn walk(&self, targets: &[u64], places: &mut [Vec<u32>; 3], turned: &mut Turned, counters: &mut Counters) -> bool {
        let mut sums = BrickSums::new();
        let mut positions = [0u32; crate::BLOCK];
        let mut resolved = true;
        let [Some(least), Some(most)] = [targets.first(), targets.last()] else { return resolved };
        let (mut totals, mut brick) = self.totals.cursor_at(*least);
        turned.expect(targets.len(), brick, totals.peek(*most) - brick + 1);
        // Bricks are looked for early, so that their voxels are on their way.
        let mut runs = [Run::default(); AHEAD];
        let (mut found, mut done, mut first, mut next) = (0, 0, 0, 0);
        while first < targets.len() {
            while next < targets.len() && found < done + AHEAD {
                brick = totals.seek(brick, targets[next]);
                let [before, limit] = totals.ends(brick);
                self.layout.prefetch(brick, self.voxels);
                next = end_of(targets, next, limit);
                runs[found % AHEAD] = Run { brick, before, end: next };
                found += 1;
            }
            let Run { brick, before, end } = runs[done % AHEAD];
            self.decode(brick, turned, &mut sums, counters);
            let run = &targets[first..end];
            if !self.place_many((brick, before), &sums, run, first, places) {
                self.place((brick, before), &sums, run, first, &mut positions[first..end], places);
                resolved = false;
            }
            first = end;
            done += 1;
        }
        resolved
    }

    /// Targets in any order: each searches the brick totals and decodes its own brick.
    fn binary(
        &self,
        targets: &[u64],
        places: &mut [Vec<u32>; 3],
        turned: &mut Turned,
        counters: &mut Counters,
    ) -> bool {
        let mut sums = BrickSums::new();
        for (i, target) in targets.iter().enumerate() {
            let (brick, before) = self.totals.find(*target);
            self.decode(brick, turned, &mut sums, counters);
            self.place((brick, before), &sums, std::slice::from_ref(target), i, &mut [0], places);
        }
        false
    }

    /// Targets in any order: each adds up the voxels' weights from the first voxel on.
    fn linear(
        &self,
        targets: &[u64],
        places: &mut [Vec<u32>; 3],
        turned: &mut Turned,
        counters: &mut Counters,
    ) -> bool {
        let mut sums = BrickSums::new();
        for (i, target) in targets.iter().enumerate() {
            let mut totals = self.totals.cursor(0);
            let (mut brick, mut before) = (0, 0);
            loop {
                // Bricks that were left out are passed over unread, and with them those of weight 0, which look the same;
                // where nothing was left out, every voxel before the target is read, as the simplest program does.
                while self.culled && totals.ends(brick)[0] == totals.ends(brick)[1] {
                    brick += 1;
                }
                self.decode(brick, turned, &mut sums, counters);
                let after = before + sums.sums[sums.sums.len() - 1].to_u64();
                if *target < after {
                    break;
                }
                before = after;
                brick += 1;
            }
            self.place((brick, before), &sums, std::slice::from_ref(target), i, &mut [0], places);
        }
        false
    }
}

/// Bricks that are looked for before the first of them is decoded.
const AHEAD: usize = 4;

/// Targets of one brick: up to which one, and the sum before the brick.
#[derive(Clone, Copy, Default)]
struct Run {
    brick: usize,
    before: u64,
    end: usize,
}

/// The end of the rising targets from `first` on that are below a limit, which the first one is: by steps that double, then
/// halve, as runs are short where samples are few.
#[inline(always)]
fn end_of(targets: &[u64], first: usize, limit: u64) -> usize {
    let mut low = first + 1;
    let mut step = 8;
    while low + step <= targets.len() && targets[low + step - 1] < limit {
        low += step;
        step *= 2;
    }
    let high = (low + step - 1).min(targets.len());
    low + targets[low..high].partition_point(|t| *t < limit)
}
