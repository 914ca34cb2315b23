//! The sorted Sobol net as a point stream.

use mcvr_sampling::rng::{Purpose, hash};
use mcvr_sampling::{BLOCK, PointBlock, PointStream, Strata};

use crate::Scramble;
use crate::axis::Axis;
use crate::scramble::Scrambled;
use crate::sobol::columns;

/// `(k/M, Sobol_1(k), Sobol_2(k), Sobol_3(k))`, k = 0..M, scrambled by a seed.
///
/// The voxel of point k is at `(k + ξ) / M` of the running sum, exactly, with one random ξ for the net.
#[derive(Clone, Debug)]
pub struct SobolNet {
    samples: u64,
    shift: u32,
    axes: [Axis; 3],
}

impl SobolNet {
    /// A net of `samples` points; a power of two is evenest.
    pub fn new(samples: u64, seed: u64, scramble: Scramble) -> Self {
        let axes = std::array::from_fn(|axis| Axis::new(Scrambled::new(columns(axis), scramble, seed, axis), samples));
        let shift = if scramble == Scramble::None { 0 } else { hash(&[seed, Purpose::Shift as u64]) as u32 };
        Self { samples, shift, axes }
    }

    /// First 32 digits of the three kernel coordinates of point `index`, one by one: the plain definition
    /// that [`PointStream::fill`] must agree with.
    pub fn digits(&self, index: u64) -> [u32; 3] {
        std::array::from_fn(|a| self.axes[a].digits(index))
    }
}

impl PointStream for SobolNet {
    fn samples(&self) -> u64 {
        self.samples
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        let first = block * BLOCK as u64;
        Strata::new(first, total, self.samples).fill(self.shift, &mut out.targets);
        for (axis, uniforms) in self.axes.iter().zip(&mut out.uniforms) {
            axis.fill(first, 0, uniforms);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_sampling::{block_count, block_len};

    /// All points of a net as (position in 2^-32 of the whole, three words).
    fn points(net: &SobolNet) -> Vec<[u32; 4]> {
        let mut out = PointBlock::default();
        (0..block_count(net.samples()))
            .flat_map(|b| {
                out.resize(block_len(net.samples(), b));
                net.fill(b, 1 << 32, &mut out);
                (0..out.targets.len())
                    .map(|i| [out.targets[i] as u32, out.uniforms[0][i], out.uniforms[1][i], out.uniforms[2][i]])
                    .collect::<Vec<_>>()
            })
            .collect()
    }

    #[test]
    fn blocks_agree_with_the_definition_point_by_point() {
        for (_, scramble) in Scramble::ALL {
            let net = SobolNet::new(10_000, 99, scramble);
            for (k, p) in points(&net).into_iter().enumerate() {
                assert_eq!(p[1..], net.digits(k as u64), "{scramble:?} {k}");
            }
        }
    }

    /// A (t, m, 4)-net in base 2: every elementary interval of volume 2^(t-m) holds exactly 2^t points.
    #[test]
    fn every_elementary_interval_holds_its_two_points() {
        let (m, t) = (12u32, 1u32);
        for (_, scramble) in Scramble::ALL {
            for seed in [0, 1, u64::MAX] {
                let points = points(&SobolNet::new(1 << m, seed, scramble));
                let k = m - t;
                for a in 0..=k {
                    for b in 0..=k - a {
                        for c in 0..=k - a - b {
                            let bits = [a, b, c, k - a - b - c];
                            let mut counts = vec![0u32; 1 << k];
                            for p in &points {
                                let cell = p.iter().zip(bits).fold(0, |cell, (&x, bits)| {
                                    cell << bits | if bits == 0 { 0 } else { (x >> (32 - bits)) as usize }
                                });
                                counts[cell] += 1;
                            }
                            assert!(counts.iter().all(|&n| n == 1 << t), "{scramble:?} seed {seed} bits {bits:?}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn scrambled_points_are_uniform_over_seeds() {
        // Mean of each coordinate of one point over independent scrambles: 1/2 within 5 deviations of 1/√(12n).
        let n = 4000;
        for scramble in [Scramble::Linear, Scramble::Owen, Scramble::Shift] {
            for index in [0, 5, 70_000] {
                let mut mean = [0.0; 3];
                for seed in 0..n {
                    let digits = SobolNet::new(1 << 17, seed, scramble).digits(index);
                    (0..3).for_each(|a| mean[a] += f64::from(digits[a]) / 4_294_967_296.0 / n as f64);
                }
                for m in mean {
                    assert!((m - 0.5).abs() < 5.0 / (12.0 * n as f64).sqrt(), "{scramble:?} point {index}: {mean:?}");
                }
            }
        }
    }

    #[test]
    fn different_seeds_give_different_nets_and_the_same_seed_the_same() {
        let net = |seed| points(&SobolNet::new(4096, seed, Scramble::default()));
        assert_eq!(net(5), net(5));
        assert!(net(5).iter().zip(net(6)).filter(|(a, b)| a[1] == b[1]).count() < 10);
    }

    #[test]
    fn no_point_returns_after_the_first_65536() {
        let net = SobolNet::new(1 << 18, 1, Scramble::default());
        let distinct: std::collections::HashSet<[u32; 3]> = (0..1u64 << 18).map(|k| net.digits(k)).collect();
        assert_eq!(distinct.len(), 1 << 18);
    }
}
