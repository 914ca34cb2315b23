//! The three plots of a run: error against samples, error against time, time against samples.

use crate::chart::{Axis, Bar, Chart, Curve, Guide};
use crate::fit::FLOOR_FACTOR;
use crate::format::{percent, percent_tick, power_tick, samples, seconds, seconds_tick};
use crate::report::{with_ends, with_error_of};
use crate::{HarnessError, Row, RunSummary, Spread};

/// A plot is drawn down to the floor if that is at most so many decades below the lowest point.
const FLOOR_REACH: f64 = 1.0;

/// File name of the plot of [`error_vs_samples`].
pub const ERROR_VS_SAMPLES: &str = "error_vs_samples.svg";
/// File name of the plot of [`error_vs_time`].
pub const ERROR_VS_TIME: &str = "error_vs_time.svg";
/// File name of the plot of [`time_vs_samples`].
pub const TIME_VS_SAMPLES: &str = "time_vs_samples.svg";

/// Relative RMSE against the sample count, with slopes to compare by. `None` when there is nothing to draw.
///
/// # Errors
/// [`HarnessError::Plot`].
pub fn error_vs_samples(run: &RunSummary) -> Result<Option<String>, HarnessError> {
    error_vs_samples_chart(run).map(|c| c.svg()).transpose()
}

pub(crate) fn error_vs_samples_chart(run: &RunSummary) -> Option<Chart> {
    let curves = error_curves(run, |row| exact(row.samples as f64));
    let guides = error_guides(&curves);
    let x = "Samples M".to_owned();
    error_chart(run, ERROR_VS_SAMPLES, "Error against samples", x, power_tick, curves, guides)
}

/// Relative RMSE against the time of a complete image. `None` when there is nothing to draw.
///
/// # Errors
/// [`HarnessError::Plot`].
pub fn error_vs_time(run: &RunSummary) -> Result<Option<String>, HarnessError> {
    error_vs_time_chart(run).map(|c| c.svg()).transpose()
}

pub(crate) fn error_vs_time_chart(run: &RunSummary) -> Option<Chart> {
    let curves = error_curves(run, |row| ends(row.complete));
    let x = format!("Wall-clock time of a complete image, {}", threads(run));
    error_chart(run, ERROR_VS_TIME, "What accuracy costs in time", x, seconds_tick, curves, Vec::new())
}

/// Time of a complete image against the sample count. `None` when there is nothing to draw.
///
/// # Errors
/// [`HarnessError::Plot`].
pub fn time_vs_samples(run: &RunSummary) -> Result<Option<String>, HarnessError> {
    time_vs_samples_chart(run).map(|c| c.svg()).transpose()
}

pub(crate) fn time_vs_samples_chart(run: &RunSummary) -> Option<Chart> {
    let curves = curves(run, |row| Some((exact(row.samples as f64), ends(row.complete))));
    let points = || curves.iter().flat_map(|c| &c.points);
    let x = Axis::holding(points().map(|(x, _)| x.mid), "Samples M", power_tick);
    let y_name = format!("Wall-clock time of a complete image, {}", threads(run));
    let y = Axis::holding(points().flat_map(|(_, y)| [y.low, y.high]), &y_name, seconds_tick);
    let (x, y) = x.zip(y)?;
    // Through the costliest of the last points, so that the guide runs above what it compares.
    let last = points().filter(|p| points().all(|q| q.0.mid <= p.0.mid)).max_by(|a, b| a.1.mid.total_cmp(&b.1.mid));
    let first = points().map(|p| p.0.mid).fold(f64::INFINITY, f64::min);
    let guides = last
        .map(|(x, y)| Guide { label: "time ∝ M".into(), slope: 1.0, through: (first, y.mid * 1.6 * first / x.mid) })
        .into_iter()
        .collect();
    let mut caption = about(run);
    caption.push(format!("Points: medians; bars: fastest to slowest. {}", repetitions(run)));
    let title = format!("Time against samples: {}", run.meta.dataset);
    Some(Chart { name: TIME_VS_SAMPLES, title, caption, x, y, curves, guides, floor: None })
}

fn error_chart(
    run: &RunSummary,
    name: &'static str,
    what: &str,
    x_name: String,
    x_label: fn(f64) -> String,
    curves: Vec<Curve>,
    guides: Vec<Guide>,
) -> Option<Chart> {
    let floor = FLOOR_FACTOR * run.truth.rel_error_estimate;
    let points = || curves.iter().flat_map(|c| &c.points);
    let lowest = points().map(|(_, y)| y.low).fold(f64::INFINITY, f64::min);
    let shown = floor > 0.0 && (lowest / floor).log10() <= FLOOR_REACH;
    let y_values = points().flat_map(|(_, y)| [y.low, y.high]).chain(shown.then_some(floor));
    let x = Axis::holding(points().flat_map(|(x, _)| [x.low, x.high]), &x_name, x_label);
    let y = Axis::holding(y_values, "RMSE over the mean pixel", percent_tick);
    let (x, y) = x.zip(y)?;
    let mut caption = about(run);
    let truth = &run.truth;
    caption.push(format!(
        "Points: root mean square over replicates; bars: smallest to largest. {} Truth: ray casting, {}, own error {}; \
         nothing is drawn below {FLOOR_FACTOR} times that{}.",
        repetitions(run),
        seconds(truth.seconds),
        percent(truth.rel_error_estimate),
        if shown || floor == 0.0 { "" } else { ", which lies below the axis" },
    ));
    let floor = shown.then(|| (floor, format!("{FLOOR_FACTOR} × the truth's own error")));
    let title = format!("{what}: {}", run.meta.dataset);
    Some(Chart { name, title, caption, x, y, curves, guides, floor })
}

/// One curve for each method that has points, in the methods' colours.
fn curves(run: &RunSummary, point: impl Fn(&Row) -> Option<(Bar, Bar)>) -> Vec<Curve> {
    let of = |(style, method): (usize, &crate::MethodSummary)| {
        let rows = run.rows.iter().filter(|r| r.method == method.name && !r.series_only);
        let unit = if method.budget_unit == "samples" { String::new() } else { format!(" ({})", method.budget_unit) };
        let label = format!("{}{unit}", method.label);
        let (points, hover) = rows.filter_map(|row| Some((point(row)?, words(&label, row)))).unzip();
        Curve { label, style, points, hover }
    };
    run.methods.iter().enumerate().map(of).filter(|c| !c.points.is_empty()).collect()
}

/// What a reader sees at a point: the figures of the tables.
fn words(label: &str, row: &Row) -> String {
    let replicates = if row.replicates == 1 { "1 replicate".into() } else { format!("{} replicates", row.replicates) };
    format!(
        "{label}\nM = {}\nError {}\nTime {}\n{replicates}",
        samples(row.samples),
        with_error_of(row),
        with_ends(row.complete)
    )
}

/// Error curves without the points that the truth's own error may touch.
fn error_curves(run: &RunSummary, x: impl Fn(&Row) -> Bar) -> Vec<Curve> {
    let floor = FLOOR_FACTOR * run.truth.rel_error_estimate;
    curves(run, |row| {
        let low = row.error_spread.min;
        (row.error > floor && low > 0.0)
            .then(|| (x(row), Bar { low: low.max(floor), mid: row.error, high: row.error_spread.max }))
    })
}

/// Lines of slope −1/2 and −2/3 from a point just above the upper left end of the curves.
fn error_guides(curves: &[Curve]) -> Vec<Guide> {
    let points = || curves.iter().flat_map(|c| &c.points);
    let x = points().map(|(x, _)| x.mid).fold(f64::INFINITY, f64::min);
    let y = points().filter(|p| p.0.mid == x).map(|(_, y)| y.high).fold(0.0, f64::max);
    [("slope −1/2", -0.5), ("slope −2/3", -2.0 / 3.0)]
        .map(|(label, slope)| Guide { label: label.into(), slope, through: (x, 1.5 * y) })
        .into()
}

fn exact(value: f64) -> Bar {
    Bar { low: value, mid: value, high: value }
}

fn ends(spread: Spread) -> Bar {
    Bar { low: spread.min, mid: spread.median, high: spread.max }
}

fn threads(run: &RunSummary) -> String {
    if run.meta.threads == 1 { "1 thread".into() } else { format!("{} threads", run.meta.threads) }
}

/// Replicates as measured: fewer than asked for when the run was stopped.
pub(crate) fn repetitions(run: &RunSummary) -> String {
    let counts = || run.rows.iter().map(|r| r.replicates);
    let (least, most) = (counts().min().unwrap_or(0), counts().max().unwrap_or(0));
    match (least, most) {
        (1, 1) => "1 replicate.".into(),
        (a, b) if a == b => format!("{a} replicates."),
        (a, b) => format!("{a} to {b} replicates."),
    }
}

/// What was measured, where: the first lines of every caption.
fn about(run: &RunSummary) -> Vec<String> {
    let m = &run.meta;
    let commits = match run.commits.as_slice() {
        [] => "commit unknown".to_owned(),
        list => format!("commit {}", list.join(", ")),
    };
    vec![
        format!("{}, {}, {}, kernel {}, estimand {}.", m.dataset, m.view, run.size, m.kernel.name(), m.estimand),
        format!("{}; {}; {commits}.", m.machine, threads(run)),
    ]
}
