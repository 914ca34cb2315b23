//! Sums over the voxels, before the negative policy.

use mcvr_volume::Voxel;
use rayon::prelude::*;

/// Voxels summed as one unit: sums do not depend on the number of threads.
const CHUNK: usize = 1 << 16;

/// Sums over the voxels, before the negative policy.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    pub(super) positive: u64,
    pub(super) negative: u64,
    pub(super) dropped: f64,
    pub(super) sum: f64,
    pub(super) max: f64,
    /// Smallest positive weight, 0 when there is none.
    pub(super) min: f64,
    pub(super) bad: u64,
    pub(super) first_bad: usize,
    pub(super) first_negative: usize,
}

impl Tally {
    /// Adds `count` voxels of weight `w`, the first of them at linear index `at`.
    fn add(&mut self, w: f64, count: u64, at: usize) {
        if w > 0.0 && w.is_finite() {
            self.positive += count;
            self.sum += w * count as f64;
            self.max = self.max.max(w);
            self.min = smaller(self.min, w);
        } else if !w.is_finite() {
            self.first_bad = if self.bad == 0 { at } else { self.first_bad.min(at) };
            self.bad += count;
        } else if w < 0.0 {
            self.first_negative = if self.negative == 0 { at } else { self.first_negative.min(at) };
            self.negative += count;
            self.dropped -= w * count as f64;
        }
    }

    fn join(mut self, o: Tally) -> Tally {
        self.first_bad = if self.bad == 0 { o.first_bad } else { self.first_bad };
        self.first_negative = if self.negative == 0 { o.first_negative } else { self.first_negative };
        self.positive += o.positive;
        self.negative += o.negative;
        self.dropped += o.dropped;
        self.sum += o.sum;
        self.max = self.max.max(o.max);
        self.min = smaller(self.min, o.min);
        self.bad += o.bad;
        self
    }
}

/// The smaller of two minima of which 0 stands for none.
fn smaller(a: f64, b: f64) -> f64 {
    if a == 0.0 || (b > 0.0 && b < a) { b } else { a }
}

/// Weights per ordinal (8- and 16-bit voxels: via a histogram) or none, and the sums. Chunks are fixed and
/// joined pairwise in order, so the error of the sum grows with the logarithm of the number of chunks.
pub(super) fn scan<T: Voxel>(voxels: &[T], weight: impl Fn(f64) -> f64 + Sync) -> (Vec<f64>, Tally) {
    let Some(cardinality) = T::TYPE.cardinality() else {
        let chunks: Vec<Tally> = voxels
            .par_chunks(CHUNK)
            .enumerate()
            .map(|(c, chunk)| {
                let mut tally = Tally::default();
                for (i, v) in chunk.iter().enumerate() {
                    tally.add(weight(v.to_f64()), 1, c * CHUNK + i);
                }
                tally
            })
            .collect();
        return (Vec::new(), pairwise(&chunks));
    };
    let counts = histogram(voxels, cardinality);
    let mut table = vec![0.0; cardinality];
    let offset = if T::TYPE.name().starts_with('i') { cardinality as f64 / 2.0 } else { 0.0 };
    let mut tally = Tally::default();
    for (i, w) in table.iter_mut().enumerate() {
        *w = weight(i as f64 - offset);
        if counts[i] > 0 {
            // Positions are wanted only for the messages: look them up when there is something to report.
            let find = || voxels.iter().position(|v| v.ordinal() == Some(i)).unwrap_or(0);
            let at = if w.is_finite() && *w >= 0.0 { 0 } else { find() };
            tally.add(*w, counts[i], at);
        }
    }
    (table, tally)
}

fn pairwise(tallies: &[Tally]) -> Tally {
    match tallies {
        [] => Tally::default(),
        [one] => *one,
        _ => {
            let (a, b) = tallies.split_at(tallies.len() / 2);
            pairwise(a).join(pairwise(b))
        }
    }
}

/// How often each ordinal occurs.
fn histogram<T: Voxel>(voxels: &[T], cardinality: usize) -> Vec<u64> {
    let parts = rayon::current_num_threads().max(1);
    let chunk = voxels.len().div_ceil(parts).max(CHUNK);
    voxels
        .par_chunks(chunk)
        .map(|chunk| {
            // Four tables so that runs of equal values do not wait for one counter.
            let mut counts = vec![0u64; 4 * cardinality];
            for (i, v) in chunk.iter().enumerate() {
                if let Some(o) = v.ordinal() {
                    counts[(i & 3) * cardinality + o] += 1;
                }
            }
            (0..cardinality).map(|o| (0..4).map(|t| counts[t * cardinality + o]).sum()).collect()
        })
        .reduce(
            || vec![0u64; cardinality],
            |mut a: Vec<u64>, b| {
                a.iter_mut().zip(&b).for_each(|(a, b)| *a += b);
                a
            },
        )
}
