//! Sequences: points that repeat, and samplers that stop improving.

mod net;
mod plateau;
mod targets;
mod words;

use mcvr_qmc::{Scramble, SobolNet};

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group};

pub(super) const CASES: [&[Case]; 4] = [net::CASES, targets::CASES, words::CASES, plateau::CASES];

/// Seeds at the ends of their range, and some between.
const SEEDS: [u64; 5] = [0, 1, 0x8000_0000_0000_0000, 0x0123_4567_89ab_cdef, u64::MAX];

/// Numbers of samples around the ends of blocks and of 16, 20, 24, 32 and 40 bits.
const SAMPLES: [u64; 15] = [
    1,
    2,
    3,
    2047,
    2048,
    2049,
    (1 << 16) - 1,
    1 << 16,
    (1 << 16) + 1,
    (1 << 20) - 1,
    (1 << 20) + 1,
    (1 << 24) + 1,
    (1 << 32) + 1,
    (1 << 40) - 1,
    1 << 40,
];

/// Nets of every scramble.
fn nets(samples: u64, seed: u64) -> impl Iterator<Item = SobolNet> {
    Scramble::ALL.into_iter().map(move |(_, scramble)| SobolNet::new(samples, seed, scramble))
}

/// The first, the last and some blocks between, of as many.
fn probes(blocks: u64) -> Vec<u64> {
    let mut probes = vec![0, 1, blocks / 3, blocks / 2, blocks.saturating_sub(2), blocks - 1];
    probes.retain(|b| *b < blocks);
    probes.sort_unstable();
    probes.dedup();
    probes
}
