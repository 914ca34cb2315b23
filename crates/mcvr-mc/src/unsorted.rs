//! Independent targets in the order in which they are drawn, and the same sorted afterwards.

use mcvr_sampling::rng::{Purpose, fill_u32, keyed};
use mcvr_sampling::{BLOCK, PointBlock, PointStream, Search, block_count, block_len};
use rand::Rng;
use rayon::prelude::*;

/// Independent uniforms for the kernel offsets of a block.
pub(crate) fn fill_offsets(seed: u64, block: u64, out: &mut PointBlock) {
    for (axis, uniforms) in out.uniforms.iter_mut().enumerate() {
        fill_u32(seed, Purpose::Offsets, block * 3 + axis as u64, uniforms);
    }
}

/// Independent uniform targets below `total` for a block: `floor(total * n / 2^64)` with 64 random bits, wrong
/// in probability by less than `total / 2^64` relative to a unit of weight.
fn fill_targets(seed: u64, block: u64, total: u64, targets: &mut [u64]) {
    let mut rng = keyed(seed, Purpose::Targets, block);
    for t in targets {
        *t = ((u128::from(rng.next_u64()) * u128::from(total)) >> 64) as u64;
    }
}

/// Independent samples, found one by one.
#[derive(Clone, Copy, Debug)]
pub struct Unsorted {
    samples: u64,
    seed: u64,
    search: Search,
}

impl Unsorted {
    /// Found by binary search over the brick totals, then inside a brick.
    pub fn binary(samples: u64, seed: u64) -> Self {
        Self { samples, seed, search: Search::Binary }
    }

    /// Found by adding up weights from the first voxel: for small M only, the time is M times half the volume.
    pub fn linear(samples: u64, seed: u64) -> Self {
        Self { samples, seed, search: Search::Linear }
    }
}

impl PointStream for Unsorted {
    fn samples(&self) -> u64 {
        self.samples
    }

    fn search(&self) -> Search {
        self.search
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        fill_targets(self.seed, block, total, &mut out.targets);
        fill_offsets(self.seed, block, out);
    }
}

/// Independent samples whose targets were all drawn and sorted before the first is used: the report's
/// improvement 1. Holds 8 bytes per sample; [`crate::OrderStatistics`] gives the same without.
#[derive(Clone, Debug)]
pub struct Quicksorted {
    samples: u64,
    seed: u64,
    total: u64,
    targets: Vec<u64>,
}

impl Quicksorted {
    /// Draws the targets of a distribution with the given total and sorts them (the standard library's
    /// unstable sort, a quicksort). Single-threaded sort, as the report's.
    pub fn new(samples: u64, seed: u64, total: u64) -> Self {
        let mut targets = vec![0u64; samples as usize];
        targets.par_chunks_mut(BLOCK).enumerate().for_each(|(b, t)| fill_targets(seed, b as u64, total, t));
        targets.sort_unstable();
        Self { samples, seed, total, targets }
    }
}

impl PointStream for Quicksorted {
    fn samples(&self) -> u64 {
        self.samples
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        debug_assert_eq!(total, self.total, "the stream was made for another distribution");
        let first = block as usize * BLOCK;
        out.targets.copy_from_slice(&self.targets[first..first + block_len(self.samples, block)]);
        debug_assert!(block < block_count(self.samples));
        fill_offsets(self.seed, block, out);
    }
}
