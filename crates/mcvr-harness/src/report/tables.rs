//! The tables of a run's report, and how their cells are written.

use crate::fit::{FLOOR_FACTOR, SlopeFit};
use crate::format::{percent, samples, seconds, short_samples, significant, slope, with_error};
use crate::{MethodSummary, Ratio, Row, RunSummary, Spread};

use super::Block;

/// Sample count and time of a complete X-ray image in the report by Law and Blythe, as printed there.
pub(super) const REPORT_COMPLETE: (u64, f64) = (1_000_000, 1.192);

pub(super) fn error_table(run: &RunSummary) -> Block {
    let mut head = vec!["M".to_owned()];
    head.extend(run.methods.iter().map(|m| m.label.clone()));
    let floor = FLOOR_FACTOR * run.truth.rel_error_estimate;
    let cell = |m: u64, method: &MethodSummary| {
        let row = run.rows.iter().find(|r| r.samples == m && r.method == method.name);
        row.map_or(dash(), |r| {
            let mark = if r.error < floor { " †" } else { "" };
            let of_first = r.error_ratio.filter(|_| run.methods.first() != Some(method));
            let of_first = of_first.map_or(String::new(), |q| format!(" ({}×)", significant(q.value, 3)));
            format!("{}{mark}{of_first}", with_error_of(r))
        })
    };
    let rows = counts(run).into_iter().map(|m| {
        let mut row = vec![samples(m)];
        row.extend(run.methods.iter().map(|method| cell(m, method)));
        row
    });
    Block::Table { head, names: 0, rows: rows.collect() }
}

pub(super) fn slope_table(run: &RunSummary) -> Block {
    let row = |m: &MethodSummary| {
        let fit = m.fit.as_ref();
        vec![
            m.label.clone(),
            m.expected_slope.map_or(dash(), slope),
            fit.map_or(dash(), interval),
            fit.map_or(dash(), |f| format!("{} to {}", short_samples(f.from), short_samples(f.to))),
            fit.map_or(dash(), |f| f.points.to_string()),
            m.tail_fit.as_ref().map_or(dash(), interval),
        ]
    };
    Block::Table {
        head: strings(&["Method", "Theory, large M", "Measured", "From M to M", "Points", "Upper half"]),
        names: 1,
        rows: run.methods.iter().map(row).collect(),
    }
}

pub(super) fn time_table(run: &RunSummary) -> Block {
    let mut rows = Vec::new();
    let report = |rows: &mut Vec<Vec<String>>| {
        let (m, time) = REPORT_COMPLETE;
        let ns = significant(time * 1e9 / m as f64, 3);
        let row = [
            samples(m),
            "the report (Law, Blythe)".into(),
            dash(),
            dash(),
            dash(),
            format!("{time} s"),
            format!("{ns} ns"),
        ];
        rows.push(row.to_vec());
    };
    let mut pending = true;
    for m in counts(run) {
        if pending && m > REPORT_COMPLETE.0 {
            report(&mut rows);
            pending = false;
        }
        for r in run.rows.iter().filter(|r| r.samples == m) {
            let label = run.methods.iter().find(|m| m.name == r.method).map_or(&r.method, |m| &m.label);
            let phase = |s: Spread| if s.max > 0.0 { seconds(s.median) } else { dash() };
            rows.push(vec![
                samples(m),
                label.clone(),
                phase(r.distribution),
                phase(r.sampling),
                phase(r.projection),
                with_ends(r.complete),
                format!("{} ns", significant(r.ns_per_sample, 3)),
            ]);
        }
    }
    if pending {
        report(&mut rows);
    }
    let head = strings(&["M", "Method", "Distribution", "Sampling", "Rendering", "Complete", "Per sample"]);
    Block::Table { head, names: 2, rows }
}

pub(super) fn counts(run: &RunSummary) -> Vec<u64> {
    let mut counts: Vec<u64> = run.rows.iter().map(|r| r.samples).collect();
    counts.dedup();
    counts
}

pub(crate) fn with_error_of(row: &Row) -> String {
    match row.error_se {
        Some(se) => format!("{} %", with_error(100.0 * row.error, 100.0 * se)),
        None => percent(row.error),
    }
}

/// Median and, in brackets, the ends; the first end without its unit where both have the same.
pub(crate) fn with_ends(s: Spread) -> String {
    let (median, min, max) = (seconds(s.median), seconds(s.min), seconds(s.max));
    let unit = |text: &str| text.split_once(' ').map(|(_, unit)| unit.to_owned());
    let short = if unit(&min) == unit(&max) { min.split(' ').next().unwrap_or(&min) } else { &min };
    if min == max { median } else { format!("{median} ({short}–{max})") }
}

pub(super) fn ratio(value: Option<Ratio>) -> String {
    value.map_or(dash(), |r| with_error(r.value, r.sd.unwrap_or(0.0)))
}

pub(super) fn interval(fit: &SlopeFit) -> String {
    match fit.low.zip(fit.high) {
        Some((low, high)) => format!("{} [{}, {}]", slope(fit.slope), slope(low), slope(high)),
        None => slope(fit.slope),
    }
}

pub(super) fn dash() -> String {
    "–".to_owned()
}

pub(super) fn strings(list: &[&str]) -> Vec<String> {
    list.iter().map(|s| (*s).to_owned()).collect()
}
