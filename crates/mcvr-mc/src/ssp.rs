//! Each voxel as often as it must be, give or take one.

use mcvr_sampling::rng::{Purpose, keyed};
use mcvr_sampling::{BLOCK, Distribution, PointBlock, PointStream};
use rand::Rng;

/// SSP sampling: of M samples voxel `i` gets `⌊M w_i⌋` or `⌈M w_i⌉`, with expectation `M w_i` (`w` of sum 1), by
/// Srinivasan's process in the order of the voxels (Srinivasan 2001; Gerber, Chopin and Whiteley 2019, *Negative association,
/// ordering and convergence of resampling methods*). Unlike systematic sampling's, the counts are negatively associated, so
/// that no image can have more variance than from independent samples. Kernel offsets are independent and uniform.
///
/// Takes one look at every voxel, on one thread, and 16 bytes for each that is drawn.
#[derive(Clone, Debug)]
pub struct Ssp {
    samples: u64,
    seed: u64,
    total: u64,
    /// First target of a drawn voxel, and the number of its first sample; some voxels that were not drawn in between, with
    /// the number of the next.
    drawn: Vec<[u64; 2]>,
}

/// Adds up what has been decided: (first target, count) by voxel, and the voxel still open.
struct Process {
    total: u64,
    counts: Vec<[u64; 2]>,
    /// Place in `counts` of the voxel whose last sample is still open, and its probability times the total.
    open: Option<(usize, u64)>,
}

impl Process {
    /// Takes a voxel up: its whole part, its fraction in units of 1 over the total, and a random word.
    fn take(&mut self, target: u64, whole: u64, fraction: u64, word: impl FnOnce() -> u64) {
        let total = self.total;
        let Some((at, open)) = self.open.filter(|_| fraction > 0) else {
            if fraction > 0 {
                self.open = Some((self.counts.len(), fraction));
            }
            if whole > 0 || fraction > 0 {
                self.counts.push([target, whole]);
            }
            return;
        };
        // One of the two gives to the other until one of them is certain; either way with the probability that leaves
        // both expectations as they were.
        let (rise, fall) = ((total - open).min(fraction), open.min(total - fraction));
        let random = ((u128::from(word()) * u128::from(rise + fall)) >> 64) as u64;
        let [open, fraction] = match random < fall {
            true => [open + rise, fraction - rise],
            false => [open - fall, fraction + fall],
        };
        let settled = |p: u64| p == 0 || p == total;
        if open == total {
            self.counts[at][1] += 1;
        }
        let count = whole + u64::from(fraction == total);
        self.open = match (settled(open), settled(fraction)) {
            (true, false) => Some((self.counts.len(), fraction)),
            (true, true) => None,
            (false, _) => Some((at, open)),
        };
        if count > 0 || !settled(fraction) {
            self.counts.push([target, count]);
        }
    }
}

impl Ssp {
    /// A stream of `samples` points for this distribution and no other.
    pub fn new(samples: u64, seed: u64, distribution: &Distribution<'_>) -> Self {
        let total = distribution.total();
        let mut rng = keyed(seed, Purpose::Targets, 0);
        let mut process = Process { total, counts: vec![], open: None };
        distribution.for_each_weight(|target, weight| {
            let (whole, fraction) = match weight.checked_mul(samples) {
                Some(share) => (share / total, share % total),
                None => {
                    let (share, total) = (u128::from(weight) * u128::from(samples), u128::from(total));
                    ((share / total) as u64, (share % total) as u64)
                }
            };
            process.take(target, whole, fraction, || rng.next_u64());
        });
        // The fractions sum to a whole number of totals, so nothing is left open.
        debug_assert!(process.open.is_none());
        let mut drawn = process.counts;
        let mut first = 0;
        for entry in &mut drawn {
            first += std::mem::replace(&mut entry[1], first);
        }
        debug_assert_eq!(first, if total == 0 { 0 } else { samples });
        Self { samples, seed, total, drawn }
    }
}

impl PointStream for Ssp {
    fn samples(&self) -> u64 {
        self.samples
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        debug_assert_eq!(total, self.total, "the stream was made for another distribution");
        let first = block * BLOCK as u64;
        // The last voxel whose first sample is not beyond.
        let mut at = self.drawn.partition_point(|d| d[1] <= first).saturating_sub(1);
        for (sample, target) in (first..).zip(&mut out.targets) {
            while self.drawn.get(at + 1).is_some_and(|next| next[1] <= sample) {
                at += 1;
            }
            *target = self.drawn.get(at).map_or(0, |d| d[0]);
        }
        crate::unsorted::fill_offsets(self.seed, block, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_sampling::{VoxelOrder, block_count, block_len};
    use mcvr_scene::{Density, DensityMap};
    use mcvr_volume::{Grid, Volume};

    fn density(weights: &[u8]) -> Density {
        let grid = Grid::with_spacing([weights.len(), 1, 1], [1.0; 3]).unwrap();
        Density::new(&Volume::from_vec(grid, weights.to_vec(), "test").unwrap(), DensityMap::default()).unwrap()
    }

    /// How often each voxel is drawn.
    fn counts(distribution: &Distribution<'_>, voxels: usize, samples: u64, seed: u64) -> Vec<u64> {
        let stream = Ssp::new(samples, seed, distribution);
        let mut counts = vec![0; voxels];
        let (mut out, mut last) = (PointBlock::default(), 0);
        for block in 0..block_count(samples) {
            out.resize(block_len(samples, block));
            stream.fill(block, distribution.total(), &mut out);
            for &t in &out.targets {
                assert!(t >= last, "targets rise");
                last = t;
                counts[distribution.voxel_of(t)] += 1;
            }
        }
        counts
    }

    /// From few samples for many voxels to many for few: floor or ceiling, for every voxel and for the first n together.
    #[test]
    fn every_voxel_and_every_first_few_get_their_share_give_or_take_one() {
        let weights: Vec<u8> = (0..700usize).map(|i| (i * i % 11) as u8).collect();
        let density = density(&weights);
        let distribution = Distribution::new(&density, VoxelOrder::Raster).unwrap();
        let total = distribution.total();
        for (samples, seeds) in [(1, 50), (17, 50), (total, 2), (3000, 5), (20_011, 5)] {
            for seed in 0..seeds {
                let (mut drawn, mut expected) = (0, 0);
                for (count, &weight) in counts(&distribution, weights.len(), samples, seed).iter().zip(&weights) {
                    let share = u64::from(weight) * samples;
                    assert!(*count == share / total || *count == share.div_ceil(total), "{count} of {share}/{total}");
                    (drawn, expected) = (drawn + count, expected + share);
                    assert!((drawn * total).abs_diff(expected) < total, "{drawn} of {expected}/{total}");
                }
                assert_eq!(drawn, samples);
            }
        }
    }

    /// A count is a coin of bias p on top of its floor: its mean over n seeds within 5 √(p (1 - p) / n), at 12 voxels. And two
    /// of them are never positively correlated: E[x y] at most p q, within 5 / √n.
    #[test]
    fn expectations_are_exact_and_correlations_not_positive() {
        let weights = [3u8, 1, 4, 1, 5, 9, 2, 6, 5, 3, 5, 8];
        let density = density(&weights);
        let distribution = Distribution::new(&density, VoxelOrder::Raster).unwrap();
        for samples in [5, 23] {
            let n = 20_000;
            let draws: Vec<Vec<u64>> = (0..n).map(|seed| counts(&distribution, 12, samples, seed)).collect();
            let share = weights.map(|w| f64::from(w) * samples as f64 / distribution.total() as f64);
            let extra = |d: &[u64], i: usize| d[i] as f64 - share[i].floor();
            for i in 0..12 {
                let p = share[i].fract();
                let mean = draws.iter().map(|d| extra(d, i)).sum::<f64>() / n as f64;
                assert!((mean - p).abs() <= 5.0 * (p * (1.0 - p) / n as f64).sqrt(), "voxel {i}: {mean} for {p}");
                for (j, other) in share[..i].iter().enumerate() {
                    let both = draws.iter().map(|d| extra(d, i) * extra(d, j)).sum::<f64>() / n as f64;
                    assert!(both <= p * other.fract() + 5.0 * 0.5 / (n as f64).sqrt(), "{i} {j}: {both}");
                }
            }
        }
    }
}
