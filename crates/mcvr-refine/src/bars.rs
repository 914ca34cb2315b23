//! Error bars of pixels.

use mcvr_scene::Image;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// What is known of every pixel of one channel; images in the estimand's unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Bars {
    /// Standard error of the pixel. Never 0 where samples could fall.
    pub error: Image,
    /// Lower end of the confidence interval.
    pub low: Image,
    /// Upper end.
    pub high: Image,
    /// 1 where no replicate has a sample, 0 elsewhere: nothing is known there but a bound, which is `high`.
    pub unresolved: Image,
    /// Number of such pixels.
    pub unresolved_pixels: u64,
}

/// How a pixel's interval is made, the same for all pixels of a channel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Interval {
    /// Student's quantile with R - 1 degrees of freedom.
    t: f64,
    /// Value that one sample adds to a replicate's pixel, on average.
    sample: f64,
    /// Upper end of an unresolved pixel.
    unresolved: f64,
}

/// The interval of one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelInterval {
    /// Standard error of the mean.
    pub error: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    /// For `replicates` replicates of `samples` samples, each of which adds `sample` to its pixel on average.
    pub(crate) fn new(replicates: usize, samples: u64, sample: f64, confidence: f64) -> Self {
        let half = 0.5 * (1.0 - confidence);
        let t = StudentsT::new(0.0, 1.0, replicates as f64 - 1.0).map_or(f64::INFINITY, |t| t.inverse_cdf(1.0 - half));
        // Clopper and Pearson 1934 for no hit in M trials: 1 - (α/2)^(1/M), as a share of the samples.
        let trials = replicates as f64 * samples as f64;
        let share = -(half.ln() / trials).exp_m1();
        Self { t, sample, unresolved: share * samples as f64 * sample }
    }

    /// From the replicates' values of a pixel. `None` where all are 0.
    pub(crate) fn of(&self, values: &[f64]) -> Option<PixelInterval> {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        if mean == 0.0 {
            return None;
        }
        let squares = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        // Samples are whole: replicates may agree by chance, and then show no spread where there is some. They are taken to
        // disagree by half a squared sample, which is less than the (R - 1)/R of one that is too many in one replicate.
        let variance = squares.max(0.5 * self.sample * self.sample) / (n - 1.0) / n;
        // A faint pixel's spread grows with its value: the interval holds the means μ that lie within t standard errors of
        // this one when their variance is this one's times μ / mean (Wilson 1927, with the dispersion that is observed).
        let a = self.t * self.t * variance / mean;
        let half = (a * mean + 0.25 * a * a).sqrt();
        Some(PixelInterval { error: variance.sqrt(), low: mean + 0.5 * a - half, high: mean + 0.5 * a + half })
    }

    /// Of a pixel without samples.
    pub(crate) fn unresolved(&self) -> PixelInterval {
        PixelInterval { error: self.unresolved / self.t, low: 0.0, high: self.unresolved }
    }
}

/// The interval of one pixel from its replicates' values, each of `samples` samples that add `sample` to their pixel on average:
/// Student's t on the replicates, in Wilson's form; of a pixel without samples, Clopper and Pearson's bound.
pub fn interval(values: &[f64], samples: u64, sample: f64, confidence: f64) -> PixelInterval {
    let interval = Interval::new(values.len(), samples, sample, confidence);
    interval.of(values).unwrap_or_else(|| interval.unresolved())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, Poisson};
    use rand_pcg::Pcg64;

    #[test]
    fn a_bright_pixel_has_students_interval() {
        let x = [100.0, 103.0, 98.0, 101.0, 99.0, 102.0, 97.0, 100.0].map(|v| v * 1e6);
        let i = interval(&x, 1 << 30, 1.0, 0.95);
        let (mean, se) = (1e8, (28.0f64 / 7.0 / 8.0).sqrt() * 1e6);
        assert!((i.error / se - 1.0).abs() < 1e-9);
        // t_{0.975} with 7 degrees of freedom, from tables.
        assert!(((i.high - i.low) / (2.0 * 2.364_624 * se) - 1.0).abs() < 1e-3 && i.low < mean && mean < i.high);
    }

    #[test]
    fn an_unresolved_pixel_has_clopper_and_pearsons_bound_and_agreeing_replicates_are_not_exact() {
        let none = interval(&[0.0; 8], 1000, 1.0, 0.95);
        // -ln(0.025) = 3.689 hits in all eight replicates.
        assert!((none.high * 8.0 - 3.689).abs() < 0.01 && none.low == 0.0 && none.error > 0.0);
        let equal = interval(&[3.0; 8], 1000, 1.0, 0.95);
        assert!(equal.error > 0.0 && equal.low < 2.9 && equal.high > 3.1);
    }

    /// Coverage over faint to bright pixels of Poisson counts: between 93 and 98 % from four samples on. (Fewer come as all
    /// zeros too often, and get the bound.)
    #[test]
    fn intervals_hold_the_truth_about_as_often_as_they_say() {
        let mut rng = Pcg64::new(3, 4);
        for expected in [4.0, 8.0, 16.0, 64.0, 256.0] {
            let poisson = Poisson::new(expected / 8.0).unwrap();
            let tries = 4000;
            let held = (0..tries)
                .filter(|_| {
                    let x: [f64; 8] = std::array::from_fn(|_| poisson.sample(&mut rng));
                    let i = interval(&x, 1 << 20, 1.0, 0.95);
                    (i.low..=i.high).contains(&(expected / 8.0))
                })
                .count() as f64
                / f64::from(tries);
            assert!((0.93..0.98).contains(&held), "{expected} samples: {held}");
        }
    }
}
