//! How far one image is from another.

use mcvr_scene::Image;
use serde::{Deserialize, Serialize};

use crate::HarnessError;

/// Differences `d_p = test_p − reference_p` over the N pixels, summarised. `mean` and `peak` are those of the
/// reference: its mean pixel and its largest absolute pixel. Figures relative to either are `None` when it is 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// N, pixels compared.
    pub pixels: u64,
    /// Mean pixel of the reference, in the images' unit.
    pub reference_mean: f64,
    /// Largest absolute pixel of the reference, in the images' unit.
    pub reference_peak: f64,
    /// `√(Σ d² / N)`, in the images' unit.
    pub rmse: f64,
    /// `rmse / |mean|`, dimensionless: the error of every plot and table.
    pub rel_rmse: Option<f64>,
    /// `rmse / peak`, dimensionless.
    pub rel_rmse_peak: Option<f64>,
    /// `(Σ |d| / N) / |mean|`, dimensionless.
    pub mae: Option<f64>,
    /// `max |d| / |mean|`, dimensionless.
    pub max: Option<f64>,
    /// `20 log10(peak / rmse)`, dB; `None` also for equal images, where it is infinite.
    pub psnr: Option<f64>,
    /// `(Σ d / N) / |mean|`, dimensionless and signed.
    pub bias: Option<f64>,
    /// Standard error of `bias`, `√(Σ (d − d̄)² / (N (N − 1))) / |mean|`. It assumes that the errors of different
    /// pixels are uncorrelated; samples that are shared out among pixels correlate them slightly negatively, which
    /// makes this a little too large. Where replicates exist, their spread is the better measure. `None` for one pixel.
    pub bias_se: Option<f64>,
}

impl Comparison {
    /// Compares two images of the same size. All sums are compensated (Neumaier 1974), and squares are taken
    /// of differences, in a second pass where a mean is subtracted, so nothing cancels; terms are first scaled by a power
    /// of two, so that no square overflows or vanishes: images times 2^k have the same relative figures, bit for bit, as
    /// long as no pixel leaves the range of normal numbers.
    ///
    /// # Errors
    /// [`HarnessError::Comparison`] when the sizes differ, a pixel is not finite, or two pixels are further apart than
    /// any number.
    pub fn of(test: &Image, reference: &Image) -> Result<Self, HarnessError> {
        if test.extent() != reference.extent() {
            return Err(HarnessError::Comparison(format!(
                "the sizes differ: {} and {}",
                test.extent(),
                reference.extent()
            )));
        }
        for (what, image) in [("image", test), ("reference", reference)] {
            if let Some(at) = image.values().iter().position(|v| !v.is_finite()) {
                let width = image.extent().width;
                return Err(HarnessError::Comparison(format!(
                    "pixel ({}, {}) of the {what} is {}",
                    at % width,
                    at / width,
                    image.values()[at]
                )));
            }
        }
        let n = test.values().len() as f64;
        let d = || test.values().iter().zip(reference.values()).map(|(t, r)| t - r);
        let largest = d().fold(0.0, |m: f64, d| m.max(d.abs()));
        if !largest.is_finite() {
            return Err(HarnessError::Comparison("two pixels differ by more than any 64-bit number".to_owned()));
        }
        let reference_mean = mean(|| reference.values().iter().copied());
        let reference_peak = reference.values().iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let down = down(largest);
        let rmse = (sum(d().map(|d| (d * down).powi(2))) / n).sqrt() / down;
        let shift = mean(d);
        let spread = || sum(d().map(|d| (d * down - shift * down).powi(2)));
        let shift_se = (n > 1.0).then(|| (spread() / (n * (n - 1.0))).sqrt() / down);
        let over = |value: f64, scale: f64| Some(value / scale.abs()).filter(|v| v.is_finite());
        Ok(Self {
            pixels: n as u64,
            reference_mean,
            reference_peak,
            rmse,
            rel_rmse: over(rmse, reference_mean),
            rel_rmse_peak: over(rmse, reference_peak),
            mae: over(mean(|| d().map(f64::abs)), reference_mean),
            max: over(largest, reference_mean),
            psnr: Some(20.0 * (reference_peak / rmse).log10()).filter(|v| v.is_finite()),
            bias: over(shift, reference_mean),
            bias_se: shift_se.and_then(|se| over(se, reference_mean)),
        })
    }
}

/// The power of two that brings a magnitude into [1, 4), or as near as a normal number can.
fn down(magnitude: f64) -> f64 {
    let exponent = (magnitude.to_bits() >> 52) as i32 & 0x7ff;
    2f64.powi((1023 - exponent).clamp(-1022, 1022))
}

/// Mean of finite values, whatever their size: never larger than the largest of them.
pub(crate) fn mean<I: Iterator<Item = f64>>(values: impl Fn() -> I) -> f64 {
    let (n, largest) = values().fold((0u64, 0.0f64), |(n, m), v| (n + 1, m.max(v.abs())));
    let down = down(largest);
    sum(values().map(|v| v * down)) / n as f64 / down
}

/// Compensated sum (A. Neumaier, Z. angew. Math. Mech. 54, 1974): error independent of the number of terms.
pub(crate) fn sum(values: impl Iterator<Item = f64>) -> f64 {
    let (mut total, mut lost) = (0.0f64, 0.0f64);
    for v in values {
        let next = total + v;
        lost += if total.abs() >= v.abs() { (total - next) + v } else { (v - next) + total };
        total = next;
    }
    total + lost
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_scene::Extent;

    fn image(values: &[f64]) -> Image {
        Image::from_values(Extent::new(values.len(), 1).unwrap(), values.to_vec()).unwrap()
    }

    #[test]
    fn every_figure_matches_its_formula_on_a_small_example() {
        let c = Comparison::of(&image(&[2.0, 2.0, 5.0, 3.0]), &image(&[1.0, 2.0, 4.0, 1.0])).unwrap();
        let close = |a: Option<f64>, b: f64| assert!((a.unwrap() - b).abs() < 1e-15, "{a:?} {b}");
        assert_eq!((c.pixels, c.reference_mean, c.reference_peak), (4, 2.0, 4.0));
        close(Some(c.rmse), 1.5f64.sqrt());
        close(c.rel_rmse, 1.5f64.sqrt() / 2.0);
        close(c.rel_rmse_peak, 1.5f64.sqrt() / 4.0);
        close(c.mae, 0.5);
        close(c.max, 1.0);
        close(c.bias, 0.5);
        close(c.bias_se, (2.0f64 / 12.0).sqrt() / 2.0);
        close(c.psnr, 20.0 * (4.0 / 1.5f64.sqrt()).log10());
    }

    #[test]
    fn undefined_figures_are_none_and_bad_images_are_refused() {
        let same = Comparison::of(&image(&[1.0, 2.0]), &image(&[1.0, 2.0])).unwrap();
        assert_eq!((same.rel_rmse, same.psnr), (Some(0.0), None));
        let dark = Comparison::of(&image(&[1.0, 2.0]), &image(&[0.0, 0.0])).unwrap();
        assert_eq!((dark.rel_rmse, dark.rel_rmse_peak, dark.psnr, dark.bias), (None, None, None, None));
        assert_eq!(Comparison::of(&image(&[1.0]), &image(&[2.0])).unwrap().bias_se, None);
        assert!(Comparison::of(&image(&[1.0]), &image(&[2.0, 1.0])).is_err());
        let message = Comparison::of(&image(&[1.0, f64::NAN]), &image(&[2.0, 1.0])).unwrap_err().to_string();
        assert!(message.contains("(1, 0)") && message.contains("NaN"), "{message}");
    }

    #[test]
    fn images_of_any_magnitude_have_the_same_relative_figures() {
        let (test, reference) = ([2.0, 2.0, 5.0, 3.1], [1.0, 2.0, 4.0, 1.0]);
        let times = |k: i32, v: &[f64]| image(&v.iter().map(|v| v * 2f64.powi(k)).collect::<Vec<_>>());
        let plain = Comparison::of(&image(&test), &image(&reference)).unwrap();
        for k in [-1020, -600, -300, 300, 600, 1020] {
            let scaled = Comparison::of(&times(k, &test), &times(k, &reference)).unwrap();
            let unit = 2f64.powi(k);
            let expected = Comparison {
                reference_mean: plain.reference_mean * unit,
                reference_peak: plain.reference_peak * unit,
                rmse: plain.rmse * unit,
                ..plain
            };
            assert_eq!(scaled, expected, "2^{k}");
        }
        // The smallest numbers lose digits, not their size.
        let tiny = Comparison::of(&image(&[3e-323, 0.0]), &image(&[1e-323, 1e-323])).unwrap();
        assert!((tiny.rel_rmse.unwrap() - 2.5f64.sqrt()).abs() < 0.5, "{tiny:?}");
        assert!(Comparison::of(&image(&[1.7e308]), &image(&[-1.7e308])).is_err());
    }

    #[test]
    fn a_large_offset_does_not_swallow_small_differences() {
        let n = 100_000;
        let reference = image(&vec![1e9; n]);
        let test = image(&(0..n).map(|i| 1e9 + if i % 2 == 0 { 1e-3 } else { -1e-3 }).collect::<Vec<_>>());
        let c = Comparison::of(&test, &reference).unwrap();
        assert!((c.rmse - 1e-3).abs() < 1e-7 && c.bias.unwrap().abs() < 1e-18, "{c:?}");
        assert_eq!(sum([1e16, 1.0, -1e16, 1.0].into_iter()), 2.0);
    }
}
