//! A cost model: seconds as a sum of non-negative multiples of what the work grows with.

use serde::Serialize;

/// One timing: what the work grows with, and the seconds it took.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Timing {
    /// One value for each term of the model, in its unit.
    pub(crate) terms: Vec<f64>,
    pub(crate) seconds: f64,
}

/// `seconds = Σ coefficient · term`, with how well it describes the timings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CostModel {
    /// Method it is of.
    pub method: String,
    /// `prepare` or `view`.
    pub clock: String,
    /// Threads.
    pub threads: usize,
    /// Name of each term and its coefficient, s per unit; terms that did not vary, or that the fit left at 0, are absent.
    pub terms: Vec<(String, f64)>,
    /// Timings used.
    pub timings: usize,
    /// Root mean square of the relative residuals.
    pub rms_residual: f64,
    /// Largest relative residual by absolute value, with its sign.
    pub worst_residual: f64,
}

/// What came out of [`fit`]: a coefficient for each term, 0 for those left out, and the relative residuals.
pub(crate) struct Fitted {
    pub(crate) coefficients: Vec<f64>,
    pub(crate) residuals: Vec<f64>,
}

/// Least squares on relative residuals with coefficients that are not negative (time is not given back). All subsets of
/// the terms are tried, so the optimum is exact (Lawson and Hanson 1995, chapter 23, has the conditions); with four
/// terms there are fifteen. Terms that hardly vary relative to the constant are the caller's to leave out. `None` when no
/// subset fits, or when there are not more timings than terms in it.
pub(crate) fn fit(timings: &[Timing]) -> Option<Fitted> {
    let used: Vec<&Timing> = timings.iter().filter(|t| t.seconds > 0.0 && t.seconds.is_finite()).collect();
    let width = used.first()?.terms.len();
    let mut best: Option<(f64, Fitted)> = None;
    for subset in 1u32..1 << width {
        let columns: Vec<usize> = (0..width).filter(|i| subset >> i & 1 == 1).collect();
        if used.len() <= columns.len() {
            continue;
        }
        let Some(found) = least_squares(&used, &columns) else { continue };
        if found.iter().any(|&c| c < 0.0) {
            continue;
        }
        let mut coefficients = vec![0.0; width];
        columns.iter().zip(&found).for_each(|(&i, &c)| coefficients[i] = c);
        let residuals: Vec<f64> = used
            .iter()
            .map(|t| t.terms.iter().zip(&coefficients).map(|(x, c)| x * c).sum::<f64>() / t.seconds - 1.0)
            .collect();
        let sum: f64 = residuals.iter().map(|r| r * r).sum();
        // A subset that explains as much with fewer terms is the better model: ties go to the earlier, smaller one.
        if best.as_ref().is_none_or(|(least, _)| sum < least * (1.0 - 1e-9)) {
            best = Some((sum, Fitted { coefficients, residuals }));
        }
    }
    best.map(|(_, fitted)| fitted)
}

/// Solves the normal equations of the columns, rows divided by their seconds, columns scaled to unit length.
fn least_squares(timings: &[&Timing], columns: &[usize]) -> Option<Vec<f64>> {
    let n = columns.len();
    let row = |t: &Timing| -> Vec<f64> { columns.iter().map(|&i| t.terms[i] / t.seconds).collect() };
    let rows: Vec<Vec<f64>> = timings.iter().map(|t| row(t)).collect();
    let lengths: Vec<f64> = (0..n).map(|i| rows.iter().map(|r| r[i] * r[i]).sum::<f64>().sqrt()).collect();
    if lengths.iter().any(|&l| !(l > 0.0 && l.is_finite())) {
        return None;
    }
    let mut matrix = vec![vec![0.0; n + 1]; n];
    for r in &rows {
        for i in 0..n {
            for j in 0..n {
                matrix[i][j] += r[i] / lengths[i] * r[j] / lengths[j];
            }
            matrix[i][n] += r[i] / lengths[i];
        }
    }
    for i in 0..n {
        let pivot = (i..n).max_by(|&a, &b| matrix[a][i].abs().total_cmp(&matrix[b][i].abs()))?;
        matrix.swap(i, pivot);
        // Columns that are multiples of each other cannot be told apart.
        if matrix[i][i].abs() < 1e-9 {
            return None;
        }
        for k in 0..n {
            if k != i {
                let factor = matrix[k][i] / matrix[i][i];
                let source = matrix[i].clone();
                matrix[k].iter_mut().zip(&source).skip(i).for_each(|(x, y)| *x -= factor * y);
            }
        }
    }
    Some((0..n).map(|i| matrix[i][n] / matrix[i][i] / lengths[i]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timings(seconds: impl Fn(f64, f64) -> f64) -> Vec<Timing> {
        let mut all = Vec::new();
        for m in [1e3, 1e4, 1e5, 1e6] {
            for pixels in [1e4, 4e4, 16e4] {
                all.push(Timing { terms: vec![1.0, m, pixels], seconds: seconds(m, pixels) });
            }
        }
        all
    }

    #[test]
    fn a_law_of_this_form_comes_back() {
        let fitted = fit(&timings(|m, p| 2e-4 + 5e-9 * m + 1e-9 * p)).unwrap();
        for (got, want) in fitted.coefficients.iter().zip([2e-4, 5e-9, 1e-9]) {
            assert!((got / want - 1.0).abs() < 1e-6, "{got} {want}");
        }
        assert!(fitted.residuals.iter().all(|r| r.abs() < 1e-6));
    }

    #[test]
    fn time_is_not_given_back() {
        let fitted = fit(&timings(|m, p| 1e-3 + 5e-9 * m - 2e-9 * p)).unwrap();
        assert!(fitted.coefficients.iter().all(|&c| c >= 0.0), "{:?}", fitted.coefficients);
        assert_eq!(fitted.coefficients[2], 0.0);
    }

    #[test]
    fn too_few_timings_and_equal_columns_are_no_model() {
        assert!(fit(&[Timing { terms: vec![1.0], seconds: 1.0 }]).is_none());
        assert!(fit(&[]).is_none());
        let twice: Vec<Timing> =
            (1..5).map(|i| Timing { terms: vec![f64::from(i), 2.0 * f64::from(i)], seconds: f64::from(i) }).collect();
        // One of the two explains all; both together are not tried.
        let fitted = fit(&twice).unwrap();
        assert_eq!(fitted.coefficients.iter().filter(|&&c| c > 0.0).count(), 1);
    }
}
