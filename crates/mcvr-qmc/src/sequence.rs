//! The Sobol sequence as point streams that refine each other, each sorted without sorting.
//!
//! A net of M points is `(k/M, ...)`: another M is another net, and nothing of the first can be kept. The points of the
//! four-dimensional sequence stay where they are when more follow. Its first coordinate is van der Corput's, which
//! visits the strata of width 2^-m once in every aligned run of 2^m points, in the order of the reversed bits. As the
//! generator matrices are linear over the bits of the index, a run can be enumerated by the stratum instead: the
//! columns change places and nothing is sorted or stored.
//!
//! A scramble has few random digits, and nets repeat themselves: with one shift for all points, the error of a pixel is
//! repeated, in kind and sign, along a whole row of pixels, and an image's total error varies from seed to seed by 3 to 9 %.
//! Here all coordinates have a digital shift of their own in each of 2^10 regions of the first coordinate (of the first, the
//! digits below the region's). Measured on three views of two scans at 2^18 to 2^24 points, the error stays within 2 % of
//! what it was, and varies by about 1 %: it can be known from few replicates.

use std::sync::Arc;

use mcvr_sampling::rng::{Purpose, fill_u32, hash};
use mcvr_sampling::{BLOCK, PointBlock, PointStream};

use crate::Scramble;
use crate::axis::Axis;
use crate::scramble::Scrambled;
use crate::sobol::{columns, point};

/// Digits of the first coordinate that choose the region, and so the shift of the others.
const REGION_BITS: u32 = 10;

/// A scrambled four-dimensional Sobol sequence: the first coordinate chooses voxels, the others kernel offsets.
#[derive(Clone, Debug)]
pub struct SobolSequence {
    /// Digital shift of the first coordinate.
    shift: u64,
    axes: [Scrambled; 3],
    regions: Arc<Regions>,
}

/// Digital shifts in each region.
#[derive(Clone, Debug)]
struct Regions {
    /// Of the first coordinate, below the digits of the region.
    place: Vec<u64>,
    /// Of the others.
    offsets: [Vec<u32>; 3],
}

impl Regions {
    fn new(seed: u64, scramble: Scramble) -> Self {
        let words = |number: u64| {
            let mut shifts = vec![0; 1 << REGION_BITS];
            if scramble != Scramble::None {
                fill_u32(seed, Purpose::Regions, number, &mut shifts);
            }
            shifts
        };
        let place = |(high, low): (&u32, &u32)| (u64::from(*high) << 32 | u64::from(*low)) >> REGION_BITS;
        Self { place: words(3).iter().zip(&words(4)).map(place).collect(), offsets: [0, 1, 2].map(words) }
    }
}

impl SobolSequence {
    /// The sequence of a seed.
    pub fn new(seed: u64, scramble: Scramble) -> Self {
        let axes = std::array::from_fn(|axis| Scrambled::new(columns(axis + 1), scramble, seed, axis + 1));
        let shift = if scramble == Scramble::None { 0 } else { hash(&[seed, Purpose::Shift as u64]) };
        Self { shift, axes, regions: Arc::new(Regions::new(seed, scramble)) }
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
        SobolRun { bits, below, axes, regions: Arc::clone(&self.regions) }
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
    regions: Arc<Regions>,
}

impl SobolRun {
    /// Region of point `k`.
    fn region(&self, k: u64) -> usize {
        (self.unshifted(k) >> (64 - REGION_BITS)) as usize
    }

    /// First coordinate of point `k` before its region's shift.
    fn unshifted(&self, k: u64) -> u64 {
        if self.bits == 0 { self.below } else { k << (64 - self.bits) | self.below }
    }

    /// What a region's shift leaves of the first coordinate: a change of its place in the stratum, and of the strata's order
    /// within the region, as bits of `k`, which keeps the points sorted.
    fn shifts(&self, region: usize) -> (u64, u64) {
        let shift = self.regions.place[region];
        match self.bits {
            0 => (shift, 0),
            bits => (shift & (!0 >> bits), shift >> (64 - bits)),
        }
    }

    /// Point `k`: the 64 digits of its first coordinate, and the first 32 of the others. The plain definition that
    /// [`PointStream::fill`] must agree with.
    pub fn point(&self, k: u64) -> (u64, [u32; 3]) {
        let region = self.region(k);
        let (place, flip) = self.shifts(region);
        let offset = |a: usize| self.axes[a].digits(k ^ flip) ^ self.regions.offsets[a][region];
        (self.unshifted(k) ^ place, [0, 1, 2].map(offset))
    }
}

impl PointStream for SobolRun {
    fn samples(&self) -> u64 {
        1 << self.bits
    }

    /// A target is `floor(x total / 2^64)` and so belongs to its point, whatever run brings it.
    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        let first = block * BLOCK as u64;
        // Neighbours that share their region.
        let piece = 1usize << self.bits.saturating_sub(REGION_BITS).min(BLOCK.ilog2());
        for (i, targets) in out.targets.chunks_mut(piece).enumerate() {
            let begin = first + (i * piece) as u64;
            let region = self.region(begin);
            let (place, flip) = self.shifts(region);
            for (k, target) in (begin..).zip(targets.iter_mut()) {
                *target = ((u128::from(self.unshifted(k) ^ place) * u128::from(total)) >> 64) as u64;
            }
            let words = i * piece..i * piece + targets.len();
            for ((axis, shifts), uniforms) in self.axes.iter().zip(&self.regions.offsets).zip(&mut out.uniforms) {
                let uniforms = &mut uniforms[words.clone()];
                axis.fill(begin, flip, uniforms);
                let shift = shifts[region];
                uniforms.iter_mut().for_each(|w| *w ^= shift);
            }
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
        let (region, r) = ((x >> (64 - REGION_BITS)) as usize, &sequence.regions);
        let offset = |a: usize| Axis::new(sequence.axes[a].clone(), 1).digits(index) ^ r.offsets[a][region];
        (x ^ r.place[region], [0, 1, 2].map(offset))
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
            for (first, samples) in [(0, 8192), (16384, 8192), (7, 1), (512, 256), (0, 1 << 14)] {
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

    /// The four-dimensional sequence has t = 3: of an aligned run of 2^m points, every elementary interval of volume 2^(3-m) that
    /// lies in one region holds 8.
    #[test]
    fn every_elementary_interval_of_a_region_holds_its_eight_points() {
        let (m, t) = (REGION_BITS + 7, 3u32);
        for (_, scramble) in Scramble::ALL {
            for first in [0, 5u64 << m] {
                let run = SobolSequence::new(3, scramble).run(first, 1 << m);
                for region in [0u64, 1, 517, 1023] {
                    let points: Vec<Point> = (region << 7..(region + 1) << 7).map(|k| run.point(k)).collect();
                    let k = 7 - t;
                    for a in 0..=k {
                        for b in 0..=k - a {
                            for c in 0..=k - a - b {
                                let bits = [a, b, c, k - a - b - c];
                                let mut counts = vec![0u32; 1 << k];
                                for (x, [u, v, w]) in &points {
                                    let words = [(x << REGION_BITS >> 32) as u32, *u, *v, *w];
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
