//! The Sobol sequence as point streams that refine each other, each sorted without sorting.
//!
//! A net of M points is `(k/M, ...)`: another M is another net, and nothing of the first can be kept. The points of the
//! four-dimensional sequence stay where they are when more follow. Its first coordinate is van der Corput's, which
//! visits the strata of width 2^-m once in every aligned run of 2^m points, in the order of the reversed bits. As the
//! generator matrices are linear over the bits of the index, a run can be enumerated by the stratum instead: the
//! columns change places and nothing is sorted or stored.

use mcvr_sampling::rng::{Purpose, hash};
use mcvr_sampling::{BLOCK, PointBlock, PointStream};

use crate::Scramble;
use crate::axis::Axis;
use crate::scramble::Scrambled;
use crate::sobol::{columns, point};

/// A scrambled four-dimensional Sobol sequence: the first coordinate chooses voxels, the others kernel offsets.
#[derive(Clone, Debug)]
pub struct SobolSequence {
    /// Digital shift of the first coordinate.
    shift: u64,
    axes: [Scrambled; 3],
}

impl SobolSequence {
    /// The sequence of a seed.
    pub fn new(seed: u64, scramble: Scramble) -> Self {
        let axes = std::array::from_fn(|axis| Scrambled::new(columns(axis + 1), scramble, seed, axis + 1));
        let shift = if scramble == Scramble::None { 0 } else { hash(&[seed, Purpose::Shift as u64]) };
        Self { shift, axes }
    }

    /// The points `first .. first + samples`, in rising order of their first coordinate.
    ///
    /// # Panics
    /// Unless `samples` is a power of two and `first` a multiple of it.
    pub fn run(&self, first: u64, samples: u64) -> SobolRun {
        assert!(samples.is_power_of_two() && first.is_multiple_of(samples), "no run: {samples} points from {first}");
        let bits = samples.trailing_zeros();
        // Bits of the index that all points share come below the stratum's, reversed; the shift moves both.
        let position = first.reverse_bits() ^ self.shift;
        let below = if bits == 0 { position } else { position & (!0 >> bits) };
        let top = if bits == 0 { 0 } else { self.shift >> (64 - bits) };
        let start = first | reversed(top, bits);
        let axes = std::array::from_fn(|a| {
            let s = &self.axes[a];
            let mut columns = [0; 64];
            for (b, column) in columns.iter_mut().enumerate().take(bits as usize) {
                *column = s.columns[bits as usize - 1 - b];
            }
            Axis::new(Scrambled { columns, shift: s.shift ^ point(&s.columns, start), owen: s.owen }, samples)
        });
        SobolRun { bits, below, axes }
    }
}

/// The lowest `bits` bits in reverse.
fn reversed(word: u64, bits: u32) -> u64 {
    if bits == 0 { 0 } else { word.reverse_bits() >> (64 - bits) }
}

/// A run of consecutive points of a [`SobolSequence`], sorted by their first coordinate: point `k` of the stream lies in
/// stratum `k` of `M`, all at the same place of their strata.
#[derive(Clone, Debug)]
pub struct SobolRun {
    bits: u32,
    /// Place within the strata: the digits of the first coordinate below the stratum's.
    below: u64,
    axes: [Axis; 3],
}

impl SobolRun {
    /// First coordinate of point `k`, in 2^-64.
    fn coordinate(&self, k: u64) -> u64 {
        if self.bits == 0 { self.below } else { k << (64 - self.bits) | self.below }
    }

    /// Point `k`: the 64 digits of its first coordinate, and the first 32 of the others. The plain definition that
    /// [`PointStream::fill`] must agree with.
    pub fn point(&self, k: u64) -> (u64, [u32; 3]) {
        (self.coordinate(k), std::array::from_fn(|a| self.axes[a].digits(k)))
    }
}

impl PointStream for SobolRun {
    fn samples(&self) -> u64 {
        1 << self.bits
    }

    /// A target is `floor(x total / 2^64)` and so belongs to its point, whatever run brings it.
    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        let first = block * BLOCK as u64;
        for (k, target) in (first..).zip(&mut out.targets) {
            *target = ((u128::from(self.coordinate(k)) * u128::from(total)) >> 64) as u64;
        }
        for (axis, uniforms) in self.axes.iter().zip(&mut out.uniforms) {
            axis.fill(first, uniforms);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_sampling::{block_count, block_len};

    type Point = (u64, [u32; 3]);

    /// The definition, point by point, in the sequence's own order.
    fn plain(sequence: &SobolSequence, index: u64) -> Point {
        let x = point(&columns(0), index) ^ sequence.shift;
        (x, std::array::from_fn(|a| Axis::new(sequence.axes[a].clone(), 1).digits(index)))
    }

    fn points(run: &SobolRun) -> Vec<Point> {
        (0..run.samples()).map(|k| run.point(k)).collect()
    }

    #[test]
    fn a_run_holds_the_points_of_the_sequence_in_rising_order() {
        for (_, scramble) in Scramble::ALL {
            let sequence = SobolSequence::new(77, scramble);
            for (first, samples) in [(0, 1), (3, 1), (0, 64), (64, 64), (192, 64), (1 << 40, 32), (4096, 4096)] {
                let run = points(&sequence.run(first, samples));
                assert!(run.windows(2).all(|w| w[0].0 < w[1].0), "{scramble:?} {first}");
                let mut expected: Vec<Point> = (first..first + samples).map(|i| plain(&sequence, i)).collect();
                expected.sort_unstable();
                assert_eq!(run, expected, "{scramble:?} {first} {samples}");
            }
        }
    }

    /// Whatever is drawn in passes is what one run of the same length draws.
    #[test]
    fn passes_that_refine_each_other_are_one_run() {
        let sequence = SobolSequence::new(5, Scramble::Linear);
        let parts = [(0, 1024), (1024, 1024), (2048, 2048), (4096, 1024), (5120, 1024), (6144, 2048)];
        let mut joined: Vec<Point> = parts.iter().flat_map(|&(f, n)| points(&sequence.run(f, n))).collect();
        joined.sort_unstable();
        assert_eq!(joined, points(&sequence.run(0, 8192)));
    }

    #[test]
    fn blocks_agree_with_the_definition_and_targets_belong_to_their_points() {
        let total = 0x7654_3210_fedc_ba98u64 >> 3;
        for (_, scramble) in Scramble::ALL {
            for (first, samples) in [(0, 8192), (16384, 8192), (7, 1), (512, 256)] {
                let run = SobolSequence::new(9, scramble).run(first, samples);
                let mut out = PointBlock::default();
                let mut k = 0;
                for block in 0..block_count(samples) {
                    out.resize(block_len(samples, block));
                    run.fill(block, total, &mut out);
                    for i in 0..out.targets.len() {
                        let (x, digits) = run.point(k);
                        assert_eq!(u128::from(out.targets[i]), (u128::from(x) * u128::from(total)) >> 64);
                        assert_eq!([0, 1, 2].map(|a| out.uniforms[a][i]), digits);
                        k += 1;
                    }
                }
                assert_eq!(k, samples);
            }
        }
    }

    /// The four-dimensional sequence has t = 3: every elementary interval of volume 2^(3-m) holds 8 of an aligned run of 2^m.
    #[test]
    fn every_elementary_interval_holds_its_eight_points() {
        let (m, t) = (11u32, 3u32);
        for (_, scramble) in Scramble::ALL {
            for first in [0, 5u64 << m] {
                let points = points(&SobolSequence::new(3, scramble).run(first, 1 << m));
                let k = m - t;
                for a in 0..=k {
                    for b in 0..=k - a {
                        for c in 0..=k - a - b {
                            let bits = [a, b, c, k - a - b - c];
                            let mut counts = vec![0u32; 1 << k];
                            for (x, [u, v, w]) in &points {
                                let words = [(x >> 32) as u32, *u, *v, *w];
                                let cell = words.iter().zip(bits).fold(0, |cell, (&x, bits)| {
                                    cell << bits | if bits == 0 { 0 } else { (x >> (32 - bits)) as usize }
                                });
                                counts[cell] += 1;
                            }
                            assert!(counts.iter().all(|&n| n == 1 << t), "{scramble:?} {first} {bits:?}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn points_are_uniform_over_seeds_and_seeds_differ() {
        let n = 4000;
        let mut mean = [0.0; 4];
        for seed in 0..n {
            let (x, u) = SobolSequence::new(seed, Scramble::Linear).run(70_000, 1).point(0);
            mean[0] += x as f64 / 2f64.powi(64) / n as f64;
            (0..3).for_each(|a| mean[a + 1] += f64::from(u[a]) / 2f64.powi(32) / n as f64);
        }
        // Within 5 deviations of a mean of n uniforms.
        assert!(mean.iter().all(|m| (m - 0.5).abs() < 5.0 / (12.0 * n as f64).sqrt()), "{mean:?}");
    }
}
