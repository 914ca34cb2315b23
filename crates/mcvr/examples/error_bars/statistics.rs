//! Shares, ratios and slopes with their standard errors.

use serde::{Deserialize, Serialize};
use statrs::distribution::{Beta, ContinuousCDF, Normal};

use crate::Outcome;

/// A figure and its standard error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    pub value: f64,
    pub error: f64,
}

/// Mean of the tops over the mean of the bottoms, one of each for every repeat; standard error by linearisation (Cochran 1977,
/// section 6.3). Repeats are independent, whatever is correlated within one. `None` where there is nothing below.
pub fn ratio(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> Option<Figure> {
    let sum = |f: fn((f64, f64)) -> f64| pairs.clone().map(f).sum::<f64>();
    let (n, top, bottom) = (pairs.clone().count() as f64, sum(|p| p.0), sum(|p| p.1));
    if bottom == 0.0 {
        return None;
    }
    let value = top / bottom;
    let squares = pairs.map(|(t, b)| (t - value * b).powi(2)).sum::<f64>();
    Some(Figure { value, error: (squares / (n - 1.0) / n).sqrt() * n / bottom })
}

/// Mean over repeats.
pub fn mean(values: impl Iterator<Item = f64> + Clone) -> Figure {
    ratio(values.map(|v| (v, 1.0))).unwrap_or(Figure { value: f64::NAN, error: f64::NAN })
}

/// Exact interval of a share (Clopper and Pearson 1934).
pub fn clopper_pearson(hits: u64, trials: u64, confidence: f64) -> Outcome<[f64; 2]> {
    let (half, k, n) = (0.5 * (1.0 - confidence), hits as f64, trials as f64);
    let low = if hits == 0 { 0.0 } else { Beta::new(k, n - k + 1.0)?.inverse_cdf(half) };
    let high = if hits == trials { 1.0 } else { Beta::new(k + 1.0, n - k)?.inverse_cdf(1.0 - half) };
    Ok([low, high])
}

/// Level of one of `tests` tests for a level of all (Šidák 1967).
pub fn sidak(family: f64, tests: usize) -> f64 {
    -((-family).ln_1p() / tests as f64).exp_m1()
}

/// Two-sided probability of a normal deviate of this size or more.
pub fn two_sided(z: f64) -> f64 {
    2.0 * Normal::standard().sf(z.abs())
}

/// Samples at which the error falls to the target, on the power law between the two neighbours (samples, error) around it: the first
/// pair that crosses. `None` where none does.
pub fn enough(curve: &[(f64, f64)], target: f64) -> Option<f64> {
    let pair = curve.windows(2).find(|w| w[0].1 > target && w[1].1 <= target)?;
    let [(m0, e0), (m1, e1)] = [pair[0], pair[1]];
    Some(m0 * (m1 / m0).powf((e0 / target).ln() / (e0 / e1).ln()))
}

/// Slope of log error over log samples by least squares, with its standard error by leaving out one repeat at a time. Errors by
/// repeat, then level; levels are combined as root mean squares.
pub fn slope(samples: &[f64], errors: &[Vec<f64>]) -> Option<Figure> {
    let (levels, repeats) = (samples.len() as f64, errors.len() as f64);
    if samples.len() < 2 || errors.len() < 2 {
        return None;
    }
    let squares: Vec<f64> = (0..samples.len()).map(|l| errors.iter().map(|e| e[l].powi(2)).sum()).collect();
    let x: Vec<f64> = samples.iter().map(|m| m.ln()).collect();
    let middle = x.iter().sum::<f64>() / levels;
    let width: f64 = x.iter().map(|x| (x - middle).powi(2)).sum();
    let fit = |without: Option<&Vec<f64>>| {
        let y = |l: usize| 0.5 * (squares[l] - without.map_or(0.0, |e| e[l].powi(2))).ln();
        x.iter().enumerate().map(|(l, x)| (x - middle) * y(l)).sum::<f64>() / width
    };
    let leave: Vec<f64> = errors.iter().map(|e| fit(Some(e))).collect();
    let mean = leave.iter().sum::<f64>() / repeats;
    let spread: f64 = leave.iter().map(|s| (s - mean).powi(2)).sum();
    Some(Figure { value: fit(None), error: (spread * (repeats - 1.0) / repeats).sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_have_clopper_and_pearsons_interval() {
        // From tables: 95 of 100 at 95 %.
        let [low, high] = clopper_pearson(95, 100, 0.95).unwrap();
        assert!((low - 0.8872).abs() < 1e-4 && (high - 0.9836).abs() < 1e-4);
        // The rule of three, two-sided: 1 - 0.025^(1/n).
        let [low, high] = clopper_pearson(0, 50, 0.95).unwrap();
        assert!(low == 0.0 && (high - (1.0 - 0.025f64.powf(0.02))).abs() < 1e-9);
        assert_eq!(clopper_pearson(50, 50, 0.95).unwrap()[1], 1.0);
    }

    #[test]
    fn a_mean_and_a_ratio_have_the_errors_of_textbooks() {
        let values = [1.0, 2.0, 3.0, 4.0];
        let m = mean(values.into_iter());
        assert!((m.value - 2.5).abs() < 1e-12 && (m.error - (5.0f64 / 3.0 / 4.0).sqrt()).abs() < 1e-12);
        let proportional = ratio(values.iter().map(|v| (3.0 * v, *v))).unwrap();
        assert!((proportional.value - 3.0).abs() < 1e-12 && proportional.error < 1e-12);
        assert!(ratio([(0.0, 0.0)].into_iter()).is_none());
    }

    #[test]
    fn power_laws_are_found_again() {
        let samples = [1024.0, 2048.0, 4096.0, 8192.0];
        let law = |m: f64| 7.0 * m.powf(-0.6);
        let curve = samples.map(|m| (m, law(m)));
        assert!((enough(&curve, law(3000.0)).unwrap() / 3000.0 - 1.0).abs() < 1e-9);
        assert!(enough(&curve, law(500.0)).is_none() && enough(&curve, law(9000.0)).is_none());
        let errors = vec![samples.map(law).to_vec(); 3];
        let s = slope(&samples, &errors).unwrap();
        assert!((s.value + 0.6).abs() < 1e-9 && s.error < 1e-9);
    }

    #[test]
    fn sidaks_levels_join_to_the_familys() {
        assert!((1.0 - (1.0 - sidak(0.01, 12)).powi(12) - 0.01).abs() < 1e-12);
        assert!((two_sided(1.959_964) - 0.05).abs() < 1e-6);
    }
}
