//! The exponent of an error curve, with its confidence interval.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Confidence level of every interval in this crate.
pub const CONFIDENCE: f64 = 0.95;

/// Points whose error is below this multiple of the truth's own error are not used (METHOD section 7): there the
/// truth's error starts to be seen instead of the method's.
pub const FLOOR_FACTOR: f64 = 10.0;

/// `log10 error = intercept + slope · log10 M`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SlopeFit {
    /// Exponent of M.
    pub slope: f64,
    /// Lower end of its 95 % confidence interval; `None` with two points, which leave nothing to judge by.
    pub low: Option<f64>,
    /// Upper end of its 95 % confidence interval.
    pub high: Option<f64>,
    /// `log10` of the error at M = 1.
    pub intercept: f64,
    /// Sample counts used.
    pub points: usize,
    /// Smallest M used.
    pub from: u64,
    /// Largest M used.
    pub to: u64,
}

/// Errors of all replicates at one sample count.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorsAt {
    /// M.
    pub samples: u64,
    /// Relative errors, one a replicate.
    pub errors: Vec<f64>,
}

impl SlopeFit {
    /// Weighted least squares of the mean of `log10 error` over the replicates against `log10 M`, one point for
    /// each M, weighted by its number of replicates; the interval is Student's t with (points − 2) degrees of
    /// freedom on the residual scatter (Draper and Smith, *Applied Regression Analysis*, 3rd ed., sections 1.4 and 9.2).
    ///
    /// The means are fitted, and not every replicate as a point of its own, because a curve that is not quite a
    /// power law departs from the line for all replicates of an M alike: the replicates would be counted as
    /// independent witnesses of that departure, and the interval would come out too narrow.
    ///
    /// Sample counts whose mean error is below [`FLOOR_FACTOR`] × `reference_error`, or where an error is not positive,
    /// are left out. `None` when fewer than two different M remain.
    pub fn of(data: &[ErrorsAt], reference_error: f64) -> Option<Self> {
        let floor = (FLOOR_FACTOR * reference_error).log10();
        let mut used: Vec<(u64, f64, f64)> = data
            .iter()
            .filter(|at| at.samples > 0 && !at.errors.is_empty() && at.errors.iter().all(|&e| e > 0.0))
            .map(|at| {
                let n = at.errors.len() as f64;
                (at.samples, at.errors.iter().map(|e| e.log10()).sum::<f64>() / n, n)
            })
            .filter(|&(_, log_error, _)| log_error.is_finite() && log_error > floor)
            .collect();
        used.sort_unstable_by_key(|&(samples, ..)| samples);
        let (from, to) = (used.first()?.0, used.last()?.0);
        let points: Vec<[f64; 3]> = used.iter().map(|&(m, y, w)| [(m as f64).log10(), y, w]).collect();
        let total: f64 = points.iter().map(|[.., w]| w).sum();
        let x_mean = points.iter().map(|[x, _, w]| w * x).sum::<f64>() / total;
        let y_mean = points.iter().map(|[_, y, w]| w * y).sum::<f64>() / total;
        let sxx: f64 = points.iter().map(|[x, _, w]| w * (x - x_mean).powi(2)).sum();
        let sxy: f64 = points.iter().map(|[x, y, w]| w * (x - x_mean) * (y - y_mean)).sum();
        if sxx <= 0.0 {
            return None;
        }
        let slope = sxy / sxx;
        let intercept = y_mean - slope * x_mean;
        let half = (points.len() > 2).then(|| {
            let freedom = (points.len() - 2) as f64;
            let scatter: f64 = points.iter().map(|[x, y, w]| w * (y - intercept - slope * x).powi(2)).sum();
            student_t(freedom) * (scatter / freedom / sxx).sqrt()
        });
        Some(Self {
            slope,
            low: half.map(|h| slope - h),
            high: half.map(|h| slope + h),
            intercept,
            points: points.len(),
            from,
            to,
        })
    }

    /// The error that the fitted line gives at M.
    pub fn at(&self, samples: f64) -> f64 {
        10f64.powf(self.intercept + self.slope * samples.log10())
    }
}

/// Half-width of the two-sided [`CONFIDENCE`] interval in standard errors.
pub(crate) fn student_t(freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, freedom).map_or(f64::INFINITY, |t| t.inverse_cdf(0.5 + CONFIDENCE / 2.0))
}

/// Two-sided p-value of a Student t statistic.
pub(crate) fn student_p(t: f64, freedom: f64) -> Option<f64> {
    let law = StudentsT::new(0.0, 1.0, freedom).ok()?;
    Some(2.0 * law.sf(t.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, Normal};

    fn curve(error: impl Fn(f64) -> f64) -> Vec<ErrorsAt> {
        (10..20).map(|m| ErrorsAt { samples: 1 << m, errors: vec![error(f64::from(1 << m))] }).collect()
    }

    #[test]
    fn an_exact_power_law_comes_out_exactly() {
        let fit = SlopeFit::of(&curve(|m| 3.0 * m.powf(-2.0 / 3.0)), 0.0).unwrap();
        assert!((fit.slope + 2.0 / 3.0).abs() < 1e-12 && (fit.intercept - 3f64.log10()).abs() < 1e-12);
        assert!((fit.high.unwrap() - fit.low.unwrap()).abs() < 1e-9);
        assert_eq!((fit.points, fit.from, fit.to), (10, 1 << 10, 1 << 19));
        assert!((fit.at(4096.0) - 3.0 / 256.0).abs() < 1e-12);
    }

    #[test]
    fn points_near_the_error_of_the_truth_are_left_out() {
        let reference = 1e-3;
        let errors = |m: f64| (1.0 / m + reference * reference).sqrt();
        let fit = SlopeFit::of(&curve(errors), reference).unwrap();
        assert_eq!(fit.to, 1 << 13, "10 times the truth's error is reached at M = 10,000");
        assert!((fit.slope + 0.5).abs() < 5e-3);
        assert_eq!(SlopeFit::of(&curve(errors), 1.0), None);
    }

    #[test]
    fn two_points_give_a_slope_without_an_interval_and_one_gives_none() {
        let data = curve(|m| m.powf(-0.5));
        let fit = SlopeFit::of(&data[..2], 0.0).unwrap();
        assert!((fit.slope + 0.5).abs() < 1e-12 && fit.low.is_none() && fit.high.is_none());
        assert_eq!(SlopeFit::of(&data[..1], 0.0), None);
        assert_eq!(SlopeFit::of(&[], 0.0), None);
    }

    #[test]
    fn the_interval_covers_the_true_slope_as_often_as_it_says() {
        let mut rng = rand_pcg::Pcg64::new(1, 2);
        let noise = Normal::new(0.0, 0.05).unwrap();
        let trials = 4000;
        let covered = (0..trials)
            .filter(|_| {
                let data: Vec<_> = (10..18)
                    .map(|m| ErrorsAt {
                        samples: 1 << m,
                        // Unequal replicate counts: the weights have to be right for the coverage to be.
                        errors: (0..1 + 3 * (m % 3))
                            .map(|_| f64::from(1 << m).powf(-0.5) * 10f64.powf(noise.sample(&mut rng)))
                            .collect(),
                    })
                    .collect();
                let fit = SlopeFit::of(&data, 0.0).unwrap();
                fit.low.unwrap() <= -0.5 && -0.5 <= fit.high.unwrap()
            })
            .count();
        // Binomial standard deviation of the count: sqrt(4000 · 0.95 · 0.05) = 14; four of them.
        assert!((covered as f64 - 3800.0).abs() < 56.0, "{covered} of {trials}");
    }

    #[test]
    fn student_quantiles_match_the_tables() {
        for (freedom, t) in [(1.0, 12.706), (4.0, 2.776), (30.0, 2.042)] {
            assert!((student_t(freedom) - t).abs() < 1e-3);
            assert!((student_p(t, freedom).unwrap() - 0.05).abs() < 1e-4);
        }
    }
}
