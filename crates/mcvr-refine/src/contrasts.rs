//! The error of an image from the contrasts of its replicates.
//!
//! Of R replicates X_1..X_R, R a power of two, the mean differs from the truth by an unknown E. The R - 1 contrasts
//! `D_j = (1/R) Σ_r ±X_r`, with the signs of the Walsh functions, half of them negative, contain no truth. Each has the covariance
//! of E, pixel by pixel, and is uncorrelated with it and with the others; replicates that are sums of many samples make all of
//! them normal, and so E and the D_j independent copies of one another. Whatever is asked of E (its RMS, a quantile of its
//! pixels) can be read from R - 1 twins, with all correlations between pixels in it.

use mcvr_sampling::Replicates;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Most replicates.
pub const MOST: usize = 64;

/// Pixels of a parallel piece of work; sums are taken piece by piece, so they do not depend on threads.
const PIECE: usize = 1 << 13;

/// What the contrasts of an image's replicates say.
#[derive(Clone, Debug, PartialEq)]
pub struct Contrasts {
    /// Mean pixel of all replicates.
    pub mean: f64,
    /// Root mean square over the pixels of each contrast, over the mean pixel.
    pub rms: Vec<f64>,
    /// Quantile over the pixels of each contrast's absolute value, over the mean pixel; empty when not asked for.
    pub quantiles: Vec<f64>,
}

impl Contrasts {
    /// Measures replicates of `samples` samples each. With a share, also the absolute value that this share of the pixels keeps.
    pub fn of(replicates: &Replicates<'_>, samples: u64, share: Option<f64>) -> Self {
        let number = replicates.number();
        let develop = replicates.developer(samples);
        let (channels, pixels) = (replicates.channels(), replicates.camera().extent().pixels());
        let slots = channels * pixels;
        let pieces: Vec<(f64, [f64; MOST])> = (0..slots.div_ceil(PIECE))
            .into_par_iter()
            .map(|piece| {
                let (mut mean, mut squares, mut values) = (0.0, [0.0; MOST], [0.0; MOST]);
                for slot in piece * PIECE..slots.min((piece + 1) * PIECE) {
                    for (r, v) in values[..number].iter_mut().enumerate() {
                        *v = develop.value(replicates.sum(r, slot / channels, slot % channels), slot % channels);
                    }
                    walsh(&mut values[..number]);
                    mean += values[0];
                    squares[..number].iter_mut().zip(&values).for_each(|(s, v)| *s += v * v);
                }
                (mean, squares)
            })
            .collect();
        let scale = (number * slots) as f64;
        let mean = pieces.iter().map(|p| p.0).sum::<f64>() / scale;
        let rms = (1..number)
            .map(|j| {
                let square = pieces.iter().map(|p| p.1[j]).sum::<f64>();
                (square / slots as f64).sqrt() / number as f64 / mean
            })
            .collect();
        let quantiles = share.map_or(vec![], |share| {
            let rank = ((share * slots as f64).ceil() as usize).clamp(1, slots) - 1;
            let mut sizes = vec![0.0; slots];
            (1..number)
                .map(|j| {
                    sizes.par_chunks_mut(PIECE).enumerate().for_each(|(piece, sizes)| {
                        for (i, size) in sizes.iter_mut().enumerate() {
                            let slot = piece * PIECE + i;
                            let (pixel, channel) = (slot / channels, slot % channels);
                            let signed = |r: usize| {
                                let value = develop.value(replicates.sum(r, pixel, channel), channel);
                                if (r & j).count_ones() & 1 == 0 { value } else { -value }
                            };
                            *size = (0..number).map(signed).sum::<f64>().abs();
                        }
                    });
                    *sizes.select_nth_unstable_by(rank, f64::total_cmp).1 / number as f64 / mean
                })
                .collect()
        });
        Self { mean, rms, quantiles }
    }
}

/// Walsh–Hadamard transform: entry j becomes the sum with the signs of the j-th Walsh function; entry 0 is the plain sum.
fn walsh(values: &mut [f64]) {
    let mut half = 1;
    while half < values.len() {
        for block in values.chunks_exact_mut(2 * half) {
            let (low, high) = block.split_at_mut(half);
            for (a, b) in low.iter_mut().zip(high) {
                (*a, *b) = (*a + *b, *a - *b);
            }
        }
        half *= 2;
    }
}

/// Root of the mean square: of the contrasts' RMS, the estimate of the image's own.
pub(crate) fn quadratic_mean(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// A bound that one more figure like these exceeds with probability `risk` at most, were their logarithms normal: Student's
/// prediction interval, one-sided. 0 where all are 0; infinite where only some are, or there are fewer than two.
pub fn bound(figures: &[f64], risk: f64) -> f64 {
    if figures.iter().all(|f| *f == 0.0) {
        return 0.0;
    }
    let n = figures.len() as f64;
    if figures.len() < 2 || !figures.iter().all(|f| *f > 0.0 && f.is_finite()) {
        return f64::INFINITY;
    }
    let mean = figures.iter().map(|f| f.ln()).sum::<f64>() / n;
    let variance = figures.iter().map(|f| (f.ln() - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let t = StudentsT::new(0.0, 1.0, n - 1.0).map_or(f64::INFINITY, |t| t.inverse_cdf(1.0 - risk));
    (mean + t * (variance * (1.0 + 1.0 / n)).sqrt()).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64;

    #[test]
    fn contrasts_are_orthogonal_and_keep_the_sum_of_squares() {
        let x = [3.0, -1.0, 4.0, 1.5, -5.0, 9.0, 2.0, 6.0];
        let mut w = x;
        walsh(&mut w);
        assert_eq!(w[0], x.iter().sum::<f64>());
        // Parseval: (1/R) Σ_j W_j² = Σ x², so the contrasts' mean square is the replicates' variance over R.
        let mean = w[0] / 8.0;
        let variance = x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 7.0;
        let contrasts: Vec<f64> = w[1..].iter().map(|v| v / 8.0).collect();
        assert!((quadratic_mean(&contrasts).powi(2) - variance / 8.0).abs() < 1e-12);
        for (j, &wj) in w.iter().enumerate() {
            let direct: f64 = (0..8usize).map(|r| if (r & j).count_ones() % 2 == 0 { x[r] } else { -x[r] }).sum();
            assert_eq!(direct, wj);
        }
    }

    /// Over many images of normal pixels, the RMS of one more exceeds the bound of seven about as often as it may.
    #[test]
    fn one_more_figure_exceeds_the_bound_about_as_often_as_it_may() {
        let normal = Normal::new(0.0, 1.0).unwrap();
        let mut rng = Pcg64::new(1, 2);
        for pixels in [30, 1000] {
            let mut rms = || {
                let sum: f64 = (0..pixels).map(|_| f64::powi(normal.sample(&mut rng), 2)).sum();
                (sum / f64::from(pixels)).sqrt()
            };
            let (tries, risk) = (4000, 0.05);
            let over = (0..tries)
                .filter(|_| {
                    let seen: Vec<f64> = (0..7).map(|_| rms()).collect();
                    rms() > bound(&seen, risk)
                })
                .count() as f64
                / f64::from(tries);
            // Four standard errors of a share of 0.05 in 4000 tries.
            assert!((over - risk).abs() < 4.0 * (risk * 0.95 / f64::from(tries)).sqrt(), "{pixels}: {over}");
        }
    }

    #[test]
    fn nothing_varies_or_nothing_is_known() {
        assert_eq!(bound(&[0.0, 0.0, 0.0], 0.05), 0.0);
        assert_eq!(bound(&[0.0, 1.0, 1.0], 0.05), f64::INFINITY);
        assert_eq!(bound(&[1.0], 0.05), f64::INFINITY);
    }
}
