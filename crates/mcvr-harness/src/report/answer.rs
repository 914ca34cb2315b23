//! The answer that a report opens with: its sentence and its table.

use crate::format::{percent, samples, seconds, slope};
use crate::{Ratio, Row, RunSummary};

use super::Block;
use super::tables::{REPORT_COMPLETE, dash, ratio, strings, with_error_of};

/// The sample count of the headline: the report's million if the first method has it, else the largest that most
/// methods share.
pub(super) fn headline(run: &RunSummary) -> Option<u64> {
    let first = &run.methods.first()?.name;
    let sharing = |m: u64| run.rows.iter().filter(|r| r.samples == m).count();
    let mine = || run.rows.iter().filter(|r| r.method == *first).map(|r| r.samples);
    let most = mine().map(sharing).max()?;
    mine().find(|&m| m == REPORT_COMPLETE.0 && sharing(m) == most).or(mine().filter(|&m| sharing(m) == most).max())
}

/// What the answer speaks of: the first method at the headline's M, the most efficient of the others there, and the
/// quickest image of a method with another budget, which shares no M with the first.
struct Found<'a> {
    first: &'a Row,
    best: Option<(&'a Row, Ratio)>,
    other: Option<&'a Row>,
}

impl<'a> Found<'a> {
    fn of(run: &'a RunSummary) -> Option<Self> {
        let m = headline(run)?;
        let name = &run.methods.first()?.name;
        let rows = || run.rows.iter().filter(|r| r.samples == m);
        let first = rows().find(|r| r.method == *name)?;
        let same_unit = |r: &Row| unit(run, r) == unit(run, first);
        let gains = rows().filter(|r| r.method != *name && same_unit(r)).filter_map(|r| Some((r, r.efficiency?)));
        let others = run.rows.iter().filter(|r| !same_unit(r));
        Some(Self {
            first,
            best: gains.max_by(|a, b| a.1.value.total_cmp(&b.1.value)),
            other: others.min_by(|a, b| a.complete.median.total_cmp(&b.complete.median)),
        })
    }
}

fn label(run: &RunSummary, row: &Row) -> String {
    run.methods.iter().find(|m| m.name == row.method).map_or(row.method.clone(), |m| m.label.clone())
}

fn unit<'a>(run: &'a RunSummary, row: &Row) -> &'a str {
    run.methods.iter().find(|m| m.name == row.method).map_or("samples", |m| m.budget_unit.as_str())
}

/// The answer in one sentence.
pub(super) fn sentence(run: &RunSummary) -> String {
    let Some(found) = Found::of(run) else {
        return "Nothing was measured yet.".into();
    };
    let first = found.first;
    let figures = |row: &Row| format!("{} after {}", percent(row.error), seconds(row.complete.median));
    let others = found.best.map(|(row, _)| row).into_iter().chain(found.other);
    let others: String = others.map(|row| format!("; {}: {}", label(run, row), figures(row))).collect();
    format!(
        "At {} {}, {} is {} of the mean pixel away from the ray-cast truth (RMSE) after {}{others}.",
        samples(first.samples),
        unit(run, first),
        label(run, first),
        percent(first.error),
        seconds(first.complete.median),
    )
}

/// The answer in two sentences: where the first method stands, and what the best of the others gains.
pub(super) fn answer(run: &RunSummary) -> (String, String) {
    let Some(Found { first, best, other }) = Found::of(run) else {
        return ("Nothing was measured yet.".into(), "There is nothing to compare.".into());
    };
    let opening = format!(
        "At {} {}, {} differs from the ray-cast truth by {} of the mean pixel (RMSE) and takes {}.",
        samples(first.samples),
        unit(run, first),
        label(run, first),
        percent(first.error),
        seconds(first.complete.median)
    );
    let figures =
        |row: &Row| format!("{}: {} in {}", label(run, row), percent(row.error), seconds(row.complete.median));
    let gain = match best {
        None => "No other method was measured there.".to_owned(),
        Some((row, gain)) => {
            format!("{}, {} times the efficiency (1 / (error² · time)).", figures(row), ratio(Some(gain)))
        }
    };
    let gain = other.map_or(gain.clone(), |row| format!("{gain} {} at its quickest.", figures(row)));
    (opening, gain)
}

pub(super) fn headline_table(run: &RunSummary, m: u64) -> Block {
    let rows = run.rows.iter().filter(|r| r.samples == m);
    Block::Table {
        head: strings(&[&format!("At M = {}", samples(m)), "Error", "Time", "Efficiency", "Slope"]),
        names: 1,
        rows: rows
            .map(|r| {
                let method = run.methods.iter().find(|m| m.name == r.method);
                let unit = unit(run, r);
                let unit = if unit == "samples" { String::new() } else { format!(" ({unit})") };
                vec![
                    label(run, r) + &unit,
                    with_error_of(r),
                    seconds(r.complete.median),
                    ratio(r.efficiency),
                    method.and_then(|m| m.fit).map_or(dash(), |f| slope(f.slope)),
                ]
            })
            .collect(),
    }
}
