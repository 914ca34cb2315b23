//! Rank-1 lattices as a point stream.

use mcvr_sampling::rng::{Purpose, hash, keyed};
use mcvr_sampling::{BLOCK, PointBlock, PointStream, Strata};
use rand::Rng;

use crate::spectral::{korobov, search};

/// `({(k + ξ)/M}, {k a/M}, {k a²/M}, {k a³/M})`, each coordinate shifted by a random number modulo 1 (Cranley and Patterson
/// 1976). The shift of the first need only be `ξ/M` with `ξ` in [0, 1): the rest of it renumbers the points.
#[derive(Clone, Copy, Debug)]
pub struct Lattice {
    samples: u64,
    generator: [u64; 3],
    place: u32,
    shift: [u64; 3],
}

/// Multipliers of 2^10, 2^11, ... points that [`search`] finds.
const MULTIPLIERS: [u64; 21] = [
    497,
    325,
    1495,
    4317,
    4459,
    12045,
    34969,
    100_697,
    142_827,
    59341,
    85477,
    369_917,
    153_499,
    148_531,
    14_482_279,
    15_221_659,
    5_074_063,
    34_375_943,
    73_776_589,
    491_438_385,
    480_060_993,
];
/// log2 of the first number of points of [`MULTIPLIERS`].
const FIRST: u32 = 10;

impl Lattice {
    /// The lattice of `samples` points whose [`merit`](crate::merit) is the largest of 4096 multipliers, shifted by a seed. For a power of
    /// two from 2^10 to 2^30 the multiplier is known, for other numbers it is searched for, which takes milliseconds.
    pub fn new(samples: u64, seed: u64) -> Self {
        let known = samples.is_power_of_two().then(|| samples.trailing_zeros().wrapping_sub(FIRST) as usize);
        let multiplier = known.and_then(|m| MULTIPLIERS.get(m).copied()).unwrap_or_else(|| search(samples).0);
        let [_, generator @ ..] = korobov(multiplier, samples);
        let mut words = keyed(seed, Purpose::Scramble, 0);
        let shift = std::array::from_fn(|_| words.next_u64());
        Self { samples, generator, place: hash(&[seed, Purpose::Shift as u64]) as u32, shift }
    }

    /// First 32 binary digits of the offset coordinates of point `k`: the definition that [`PointStream::fill`] must agree
    /// with, up to `2^-53`.
    pub fn digits(&self, k: u64) -> [u32; 3] {
        std::array::from_fn(|a| (fraction(k, self.generator[a], self.samples).wrapping_add(self.shift[a]) >> 32) as u32)
    }
}

impl PointStream for Lattice {
    fn samples(&self) -> u64 {
        self.samples
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        let first = block * BLOCK as u64;
        Strata::new(first, total, self.samples).fill(self.place, &mut out.targets);
        for (axis, words) in out.uniforms.iter_mut().enumerate() {
            let z = self.generator[axis];
            // Exact at the start of a block; each step is short of the exact one by less than 2^-64.
            let mut position = fraction(first, z, self.samples).wrapping_add(self.shift[axis]);
            let step = fraction(1, z, self.samples);
            for word in words {
                *word = (position >> 32) as u32;
                position = position.wrapping_add(step);
            }
        }
    }
}

/// `{k z/M}` in 2^-64, rounded down.
fn fraction(k: u64, z: u64, samples: u64) -> u64 {
    let m = u128::from(samples);
    (((u128::from(k) * u128::from(z) % m) << 64) / m) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_sampling::{block_count, block_len};

    #[test]
    fn the_table_is_what_the_search_finds() {
        for (m, multiplier) in (FIRST..).zip(MULTIPLIERS) {
            let (found, merit) = search(1 << m);
            assert_eq!(found, multiplier, "2^{m}");
            assert!(merit >= 0.59 && merit == crate::merit(found, 1 << m), "2^{m}: {merit}");
        }
    }

    fn all(lattice: &Lattice, total: u64) -> Vec<(u64, [u32; 3])> {
        let mut out = PointBlock::default();
        let mut points = vec![];
        for block in 0..block_count(lattice.samples) {
            out.resize(block_len(lattice.samples, block));
            lattice.fill(block, total, &mut out);
            points.extend((0..out.targets.len()).map(|i| (out.targets[i], [0, 1, 2].map(|a| out.uniforms[a][i]))));
        }
        points
    }

    #[test]
    fn blocks_agree_with_the_definition_and_rise() {
        for samples in [1, 2, 3, 100, 5000, 1 << 13, 10_007] {
            let lattice = Lattice::new(samples, 9);
            let points = all(&lattice, samples << 20);
            assert!(points.windows(2).all(|w| w[0].0 < w[1].0));
            for (k, (target, words)) in points.into_iter().enumerate() {
                assert_eq!(target >> 20, k as u64);
                for (word, exact) in words.into_iter().zip(lattice.digits(k as u64)) {
                    // Rounding at 2^-53 moves a 32-bit word by one, or not.
                    assert!(word.wrapping_sub(exact).wrapping_add(1) <= 2, "{samples} {k}");
                }
            }
        }
    }

    /// Every coordinate alone takes M different values, equally far apart: each of M intervals holds one point.
    #[test]
    fn every_projection_has_as_many_points_as_the_lattice() {
        for samples in [1u64 << 10, 1 << 14, 1001] {
            let points = all(&Lattice::new(samples, 4), 1 << 50);
            for axis in 0..3 {
                let origin = points[0].1[axis];
                let mut seen = vec![false; samples as usize];
                for (_, words) in &points {
                    // Half an interval aside, so that rounding crosses no border.
                    let x = ((u64::from(words[axis].wrapping_sub(origin)) * samples + (1 << 31)) >> 32) % samples;
                    assert!(!std::mem::replace(&mut seen[x as usize], true), "{samples}, axis {axis}");
                }
            }
        }
    }

    #[test]
    fn points_are_uniform_over_seeds() {
        let n = 4000;
        for k in [0, 77, 70_000] {
            let mut mean = [0.0; 3];
            for seed in 0..n {
                let digits = Lattice::new(1 << 17, seed).digits(k);
                (0..3).for_each(|a| mean[a] += f64::from(digits[a]) / 2f64.powi(32) / n as f64);
            }
            // Within 5 deviations of a mean of n uniforms.
            assert!(mean.iter().all(|m| (m - 0.5).abs() < 5.0 / (12.0 * n as f64).sqrt()), "{mean:?}");
        }
    }
}
