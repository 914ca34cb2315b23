//! What a run found: per method and sample count, and per method.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::fit::{ErrorsAt, SlopeFit, student_p, student_t};
use crate::record::write_file;
use crate::{HarnessError, Method, Record, RunMeta, SeriesImage};

/// Everything that plots and reports show. It is rebuilt from the records, never updated.
#[derive(Clone, Debug, Serialize)]
pub struct RunSummary {
    /// What was measured, and where.
    pub meta: RunMeta,
    /// Width x height in pixels.
    pub size: String,
    /// The truth in figures.
    pub truth: TruthSummary,
    /// Replicates asked for at each sample count.
    pub replicates: u32,
    /// The run's seed.
    pub seed: u64,
    /// Source revisions that the records name; more than one when a run was resumed by another build.
    pub commits: Vec<String>,
    /// The methods in the order given; ratios refer to the first.
    pub methods: Vec<MethodSummary>,
    /// One row for each method and sample count, sample counts ascending, methods in their order.
    pub rows: Vec<Row>,
    /// The image series, sample counts ascending.
    pub series: Vec<SeriesImage>,
    /// Value that is full red in the difference maps (and its negative full blue), in the images' unit.
    pub difference_scale: f64,
    /// Images measured.
    pub measured: usize,
    /// Images asked for.
    pub planned: usize,
    /// The folder of the files.
    #[serde(skip)]
    pub folder: PathBuf,
}

/// The truth in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TruthSummary {
    /// Its own RMSE over its mean pixel, as its integrator estimates it.
    pub rel_error_estimate: f64,
    /// Wall-clock time to compute it, s.
    pub seconds: f64,
    /// Its mean pixel, in the images' unit.
    pub mean: f64,
    /// Its largest absolute pixel, in the images' unit.
    pub peak: f64,
    /// SHA-256 of its size and values.
    pub sha256: String,
}

/// A method and the exponent of its error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MethodSummary {
    /// Stable identifier.
    pub name: String,
    /// Name for people.
    pub label: String,
    /// What one unit of its budget is.
    pub budget_unit: String,
    /// Exponent that theory predicts.
    pub expected_slope: Option<f64>,
    /// Exponent over all sample counts above the floor.
    pub fit: Option<SlopeFit>,
    /// Exponent over the upper half of them (at least four), nearer to where theory speaks.
    pub tail_fit: Option<SlopeFit>,
}

/// A middle and its ends.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Median.
    pub median: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

/// A ratio and its standard deviation by first-order propagation, `σ² = q² Σ (σ_i / x_i)²` over the factors
/// (JCGM 100:2008, section 5.1.6). `sd` is `None` with fewer than two replicates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Ratio {
    /// The ratio.
    pub value: f64,
    /// Its standard deviation.
    pub sd: Option<f64>,
}

/// All replicates of one method at one sample count.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The method's identifier.
    pub method: String,
    /// M, in the method's budget unit.
    pub samples: u64,
    /// Replicates measured.
    pub replicates: usize,
    /// True when M is only in the image series, so that it takes no part in curves and fits.
    pub series_only: bool,
    /// `√(mean(e²))` over the replicates' relative RMSE e: the mean of an RMSE is taken over its squares, whose
    /// expectation is the estimator's variance; a plain mean would be too small (Jensen).
    pub error: f64,
    /// Median and ends of the replicates' relative RMSE.
    pub error_spread: Spread,
    /// Standard error of `error` over the replicates (delta method: that of `mean(e²)` over `2 error`).
    pub error_se: Option<f64>,
    /// Mean over the replicates of the image's mean signed error, over the truth's mean pixel.
    pub bias: f64,
    /// Half-width of the 95 % Student t interval of `bias` over the replicates.
    pub bias_half: Option<f64>,
    /// Probability of a bias this large by chance, the truth's own error granted; see [`bias_p`].
    pub bias_p: Option<f64>,
    /// True when `bias_p` is below 1 % after Šidák's correction for the number of rows tested.
    pub biased: bool,
    /// Time for the distribution, s.
    pub distribution: Spread,
    /// Time for sampling, s.
    pub sampling: Spread,
    /// Time for projection, s.
    pub projection: Spread,
    /// Time for the complete image, s.
    pub complete: Spread,
    /// Median complete time per unit of the budget, ns.
    pub ns_per_sample: f64,
    /// Error over the first method's at this M.
    pub error_ratio: Option<Ratio>,
    /// `1 / (error² · median complete time)` over the first method's at this M: how many times less time the same
    /// error takes if the error falls as `M^(-1/2)`; for a steeper method that is a cautious figure.
    pub efficiency: Option<Ratio>,
}

impl Row {
    /// Summarises the records of one method at one M; `None` without any that has a relative error.
    fn of(records: &[&Record], series_only: bool) -> Option<Self> {
        let (records, errors): (Vec<&Record>, Vec<f64>) =
            records.iter().filter_map(|r| Some((*r, r.rel_rmse?))).unzip();
        let first = *records.first()?;
        let squares: Vec<f64> = errors.iter().map(|e| e * e).collect();
        let error = mean(&squares).sqrt();
        let biases: Vec<f64> = records.iter().filter_map(|r| r.bias).collect();
        let bias = mean(&biases);
        let bias_se = standard_error(&biases);
        let spread = |of: fn(&Record) -> f64| Spread::of(records.iter().map(|r| of(r)).collect());
        let complete = spread(|r| r.seconds.complete);
        Some(Self {
            method: first.method.clone(),
            samples: first.samples,
            replicates: records.len(),
            series_only,
            error,
            error_se: standard_error(&squares).map(|se| if error > 0.0 { se / (2.0 * error) } else { 0.0 }),
            error_spread: Spread::of(errors),
            bias,
            bias_half: bias_se.map(|se| se * student_t(biases.len() as f64 - 1.0)),
            bias_p: bias_se.and_then(|se| bias_p(bias, se, biases.len(), first.reference_error)),
            biased: false,
            distribution: spread(|r| r.seconds.distribution),
            sampling: spread(|r| r.seconds.sampling),
            projection: spread(|r| r.seconds.projection),
            ns_per_sample: complete.median * 1e9 / first.samples as f64,
            complete,
            error_ratio: None,
            efficiency: None,
        })
    }

    /// Fills the ratios to the first method's row at the same M.
    fn relate(&mut self, first: &Row, time_se: [Option<f64>; 2]) {
        let relative = |se: Option<f64>, value: f64| se.map(|se| (se / value).powi(2));
        let errors = relative(self.error_se, self.error).zip(relative(first.error_se, first.error));
        let times = relative(time_se[0], self.complete.median).zip(relative(time_se[1], first.complete.median));
        let same = self.method == first.method;
        let ratio = |value: f64, variance: Option<f64>| {
            let sd = if same { Some(0.0) } else { variance.map(|v| value * v.sqrt()) };
            value.is_finite().then_some(Ratio { value, sd })
        };
        self.error_ratio = ratio(self.error / first.error, errors.map(|(a, b)| a + b));
        self.efficiency = ratio(
            (first.error / self.error).powi(2) * first.complete.median / self.complete.median,
            errors.zip(times).map(|((a, b), (c, d))| 4.0 * (a + b) + c + d),
        );
    }
}

impl Spread {
    /// Of some values; not numbers where there are none.
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_unstable_by(f64::total_cmp);
        let n = values.len();
        let at = |i: usize| values.get(i).copied().unwrap_or(f64::NAN);
        Self { median: (at(n.saturating_sub(1) / 2) + at(n / 2)) / 2.0, min: at(0), max: at(n.saturating_sub(1)) }
    }
}

/// Rows of all methods with their ratios and bias flags; `series_only` tells which M take no part in curves.
pub(crate) fn rows(records: &[Record], methods: &[&dyn Method], series_only: &dyn Fn(u64) -> bool) -> Vec<Row> {
    let mut counts: Vec<u64> = records.iter().map(|r| r.samples).collect();
    counts.sort_unstable();
    counts.dedup();
    let of = |method: &str, samples: u64| -> Vec<&Record> {
        records.iter().filter(|r| r.method == method && r.samples == samples).collect()
    };
    let mut rows = Vec::new();
    for samples in counts {
        let mut first: Option<(Row, Option<f64>)> = None;
        for (index, method) in methods.iter().enumerate() {
            let group = of(method.name(), samples);
            let Some(mut row) = Row::of(&group, series_only(samples)) else { continue };
            let time_se = median_se(&group.iter().map(|r| r.seconds.complete).collect::<Vec<_>>());
            if index == 0 {
                first = Some((row.clone(), time_se));
            }
            if let Some((first, first_se)) = &first {
                row.relate(first, [time_se, *first_se]);
            }
            rows.push(row);
        }
    }
    let tested = rows.iter().filter(|r| r.bias_p.is_some()).count();
    let level = 1.0 - 0.99f64.powf(1.0 / tested.max(1) as f64);
    rows.iter_mut().for_each(|r| r.biased = r.bias_p.is_some_and(|p| p < level));
    rows
}

/// The methods with their fitted exponents.
pub(crate) fn methods(
    records: &[Record],
    methods: &[&dyn Method],
    reference_error: f64,
    series_only: &dyn Fn(u64) -> bool,
) -> Vec<MethodSummary> {
    let one = |method: &&dyn Method| {
        let mut data: Vec<ErrorsAt> = Vec::new();
        let mine = records.iter().filter(|r| r.method == method.name() && !series_only(r.samples));
        for (samples, error) in mine.filter_map(|r| Some((r.samples, r.rel_rmse?))) {
            match data.iter_mut().find(|at| at.samples == samples) {
                Some(at) => at.errors.push(error),
                None => data.push(ErrorsAt { samples, errors: vec![error] }),
            }
        }
        data.sort_unstable_by_key(|at| at.samples);
        let fit = SlopeFit::of(&data, reference_error);
        let tail_fit = fit.and_then(|fit| {
            let used: Vec<ErrorsAt> = data.into_iter().filter(|at| (fit.from..=fit.to).contains(&at.samples)).collect();
            let keep = used.len().div_ceil(2).max(4);
            (used.len() > keep).then(|| SlopeFit::of(&used[used.len() - keep..], reference_error)).flatten()
        });
        MethodSummary {
            name: method.name().to_owned(),
            label: method.label().to_owned(),
            budget_unit: method.budget_unit().to_owned(),
            expected_slope: method.expected_slope(),
            fit,
            tail_fit,
        }
    };
    methods.iter().map(one).collect()
}

/// Two-sided p-value of the mean bias of n replicates. The mean of the truth may itself be off by as much as its
/// relative RMSE (a mean never exceeds the root mean square), and rounding by 1e-12; only what is left is tested.
pub fn bias_p(bias: f64, standard_error: f64, n: usize, reference_error: f64) -> Option<f64> {
    let left = bias.abs() - reference_error - 1e-12;
    if left <= 0.0 {
        return Some(1.0);
    }
    (standard_error > 0.0).then(|| student_p(left / standard_error, n as f64 - 1.0)).flatten().or(Some(0.0))
}

pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard error of the mean; `None` for fewer than two values.
pub(crate) fn standard_error(values: &[f64]) -> Option<f64> {
    let (n, m) = (values.len() as f64, mean(values));
    (values.len() > 1).then(|| (values.iter().map(|v| (v - m).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt())
}

/// Standard error of a median, taken as `√(π/2)` times that of the mean, as it is for normal values and many of them.
fn median_se(values: &[f64]) -> Option<f64> {
    standard_error(values).map(|se| se * std::f64::consts::FRAC_PI_2.sqrt())
}

/// Writes `summary.json`, which holds everything, and `summary.csv`, which holds the rows.
pub(crate) fn write(summary: &RunSummary, folder: &Path) -> Result<(), HarnessError> {
    let path = folder.join("summary.json");
    let text = serde_json::to_vec_pretty(summary).map_err(|e| HarnessError::file(&path, e))?;
    write_file(&path, &text)?;
    let path = folder.join("summary.csv");
    let mut table = csv::Writer::from_writer(Vec::new());
    let fail = |e: csv::Error| HarnessError::file(&path, e);
    let columns = "method samples replicates series_only error error_se error_median error_min error_max bias \
                   bias_half_95 bias_p distribution_s sampling_s projection_s complete_s complete_min_s complete_max_s \
                   ns_per_sample error_ratio error_ratio_sd efficiency efficiency_sd";
    table.write_record(columns.split(' ').filter(|c| !c.is_empty())).map_err(fail)?;
    for r in &summary.rows {
        let figures = [
            Some(r.error),
            r.error_se,
            Some(r.error_spread.median),
            Some(r.error_spread.min),
            Some(r.error_spread.max),
            Some(r.bias),
            r.bias_half,
            r.bias_p,
            Some(r.distribution.median),
            Some(r.sampling.median),
            Some(r.projection.median),
            Some(r.complete.median),
            Some(r.complete.min),
            Some(r.complete.max),
            Some(r.ns_per_sample),
            r.error_ratio.map(|q| q.value),
            r.error_ratio.and_then(|q| q.sd),
            r.efficiency.map(|q| q.value),
            r.efficiency.and_then(|q| q.sd),
        ];
        let names = [r.method.clone(), r.samples.to_string(), r.replicates.to_string(), r.series_only.to_string()];
        let figures = figures.into_iter().map(|v| v.map(|v| v.to_string()).unwrap_or_default());
        table.write_record(names.into_iter().chain(figures)).map_err(fail)?;
    }
    let bytes = table.into_inner().map_err(|e| HarnessError::file(&path, e.error()))?;
    write_file(&path, &bytes)
}
