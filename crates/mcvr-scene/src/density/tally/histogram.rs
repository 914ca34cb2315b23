//! Sums over voxels of few different values: each value is counted, then weighed once.

use mcvr_volume::Voxel;
use rayon::prelude::*;

use super::Tally;

/// Voxels that a thread takes at least.
const CHUNK: usize = 1 << 16;
/// Voxels that are looked at together: where all are the same, as in air, they are counted at once.
const RUN: usize = 64;

/// The sums over voxels whose weights stand in a table by ordinal.
pub(super) fn tally<T: Voxel>(voxels: &[T], table: &[f64]) -> Tally {
    let mut tally = Tally::default();
    for (count, w) in counts(voxels, table.len()).into_iter().zip(table) {
        if count > 0 {
            tally.add(*w, count);
        }
    }
    tally
}

/// How often each ordinal occurs.
fn counts<T: Voxel>(voxels: &[T], cardinality: usize) -> Vec<u64> {
    let parts = rayon::current_num_threads().max(1);
    let chunk = voxels.len().div_ceil(parts).max(CHUNK);
    voxels
        .par_chunks(chunk)
        .map(|chunk| {
            // Two tables so that runs of equal values do not wait for one counter.
            let mut counts = vec![0u64; 2 * cardinality];
            for run in chunk.chunks(RUN) {
                let first = run[0];
                let mut same = true;
                for v in run {
                    same &= *v == first;
                }
                if same {
                    counts[first.ordinal().unwrap_or(0)] += run.len() as u64;
                    continue;
                }
                for (i, v) in run.iter().enumerate() {
                    counts[(i & 1) * cardinality + v.ordinal().unwrap_or(0)] += 1;
                }
            }
            let (even, odd) = counts.split_at_mut(cardinality);
            even.iter_mut().zip(odd).for_each(|(a, b)| *a += *b);
            counts.truncate(cardinality);
            counts
        })
        .reduce(
            || vec![0u64; cardinality],
            |mut a: Vec<u64>, b| {
                a.iter_mut().zip(&b).for_each(|(a, b)| *a += b);
                a
            },
        )
}
