//! The tables of a cost report.

use super::peers;
use super::plots::threads;
use super::points::Point;
use super::reach::{By, Ladder, Reach, Step};
use super::summary::{ANY, CostSummary, MethodInfo, ReachRow, SubjectInfo, floor};
use super::{TARGETS, VIEWS};
use crate::format::{grouped, percent, samples, seconds, short_samples, significant, with_error};
use crate::report::Block;
use crate::{MethodSummary, RunSummary};

/// Marks the quickest of a column.
pub(crate) const FASTEST: &str = "★";

fn dash() -> String {
    "–".to_owned()
}

fn head(first: &[&str], rest: impl Iterator<Item = String>) -> Vec<String> {
    first.iter().map(|s| (*s).to_owned()).chain(rest).collect()
}

/// A method's name for people.
pub(crate) fn label(run: &CostSummary, name: &str) -> String {
    run.methods.iter().find(|m| m.name == name).map_or(name.to_owned(), |m| m.label.clone())
}

/// Name of a family of ray casters for people.
pub(crate) fn family(run: &CostSummary, name: &str) -> String {
    match name {
        ANY => "any ray caster".to_owned(),
        "march" => "ray march".to_owned(),
        name => label(run, name),
    }
}

/// An error to reach as it was asked for: `0.3 %`.
pub(crate) fn target_words(target: f64) -> String {
    format!("{} %", (target * 1e8).round() / 1e6)
}

fn rows_of<'a>(
    run: &'a CostSummary,
    subject: &'a SubjectInfo,
    lane: usize,
    method: &'a str,
) -> impl Iterator<Item = &'a ReachRow> {
    run.reaches.iter().filter(move |r| r.dataset == subject.dataset && r.threads == lane && r.method == method)
}

/// Time of one image to each error.
pub(crate) fn time_to_error(run: &CostSummary, subject: &SubjectInfo, lane: usize) -> Block {
    let points = run.peers_of(subject, lane);
    let floor = subject.truth.as_ref().map_or(0.0, |t| floor(t.rel_error_estimate));
    let least = |target| peers::quickest(&points, target, floor).map(|p| p.seconds.median);
    let row = |m: &MethodInfo| {
        let cells = rows_of(run, subject, lane, &m.name).map(|row| {
            let before = |r: Reach| least(row.target).is_none_or(|peer| r.total(1, 1) <= peer);
            cell(row.reach, row.fastest[0] && row.reach.is_some_and(before))
        });
        std::iter::once(m.label.clone()).chain(cells).collect()
    };
    let mut rows: Vec<Vec<String>> = run.methods.iter().map(row).collect();
    let mine = |target: f64| {
        let here =
            |r: &&ReachRow| r.dataset == subject.dataset && r.threads == lane && r.target == target && r.fastest[0];
        run.reaches.iter().find(here).and_then(|r| r.totals).map_or(f64::INFINITY, |t| t[0])
    };
    for (_, points) in peers::systems(&points) {
        let cells = run.targets.iter().map(|&target| {
            let Some(point) = peers::quickest(&points, target, floor) else { return dash() };
            let time = point.seconds.median;
            let first = time < mine(target) && least(target) == Some(time);
            if first { format!("{} {FASTEST}", seconds(time)) } else { seconds(time) }
        });
        rows.push(points.first().map(|p| peers::name(p)).into_iter().chain(cells).collect());
    }
    times(&run.targets, rows)
}

/// The same for the methods of a convergence run.
pub(crate) fn time_to_error_of(run: &RunSummary) -> Option<Block> {
    let floor = floor(run.truth.rel_error_estimate);
    let ladder = |m: &MethodSummary| {
        let rows = run.rows.iter().filter(|r| r.method == m.name && !r.series_only && r.error > 0.0);
        let steps = rows.map(|r| Step {
            budget: r.samples as f64,
            error: r.error,
            prepare: r.distribution.median,
            view: r.complete.median - r.distribution.median,
        });
        Ladder { steps: steps.collect(), continuous: m.expected_slope.is_some(), preparations: 1 }
    };
    let ladders: Vec<Ladder> = run.methods.iter().map(ladder).collect();
    let reaches = |target: f64| ladders.iter().map(move |l| l.reach(target, floor)).collect::<Vec<_>>();
    let columns: Vec<Vec<(Option<Reach>, bool)>> = TARGETS
        .iter()
        .map(|&target| {
            let column = reaches(target);
            let measured = |r: &Option<Reach>| r.filter(|r| r.by != By::Extrapolated).map(|r| r.total(1, 1));
            let least = column.iter().filter_map(measured).min_by(f64::total_cmp);
            column.into_iter().map(|r| (r, least.is_some() && measured(&r) == least)).collect()
        })
        .collect();
    let row = |(i, m): (usize, &MethodSummary)| {
        std::iter::once(m.label.clone()).chain(columns.iter().map(|c| cell(c[i].0, c[i].1))).collect()
    };
    let rows: Vec<Vec<String>> = run.methods.iter().enumerate().map(row).collect();
    columns.iter().flatten().any(|(reach, _)| reach.is_some()).then(|| times(&TARGETS, rows))
}

/// Time of one image to one error, volume by volume.
pub(crate) fn time_by_volume(run: &CostSummary, lane: usize, target: f64) -> Block {
    let row = |m: &MethodInfo| {
        let cells = run.judged().map(|(subject, _)| {
            let row = rows_of(run, subject, lane, &m.name).find(|r| r.target == target);
            row.map_or(dash(), |row| cell(row.reach, row.fastest[0]))
        });
        std::iter::once(m.label.clone()).chain(cells).collect()
    };
    Block::Table {
        head: head(
            &[&format!("Time of one image to {} error", target_words(target))],
            run.judged().map(|(s, _)| s.dataset.clone()),
        ),
        names: 1,
        rows: run.methods.iter().map(row).collect(),
    }
}

fn times(targets: &[f64], rows: Vec<Vec<String>>) -> Block {
    let head = head(&["Time of one image to an error of"], targets.iter().map(|&t| target_words(t)));
    Block::Table { head, names: 1, rows }
}

fn cell(reach: Option<Reach>, fastest: bool) -> String {
    let Some(reach) = reach else { return dash() };
    let time = seconds(reach.total(1, 1));
    match (reach.by, fastest) {
        (By::Extrapolated, _) => format!("≈ {time}"),
        (_, true) => format!("{time} {FASTEST}"),
        _ => time,
    }
}

/// Preparation, each view, and the total for many views, at one error.
pub(crate) fn many_views(run: &CostSummary, subject: &SubjectInfo, lane: usize, target: f64) -> Option<Block> {
    let rows: Vec<Vec<String>> = run
        .methods
        .iter()
        .filter_map(|m| {
            let row = rows_of(run, subject, lane, &m.name).find(|r| r.target == target)?;
            let (reach, totals) = (row.reach?, row.totals?);
            let about = if reach.by == By::Extrapolated { "≈ " } else { "" };
            let mut cells = vec![
                m.label.clone(),
                budget(m, &reach),
                seconds(reach.prepare),
                format!("{about}{}", seconds(reach.view)),
            ];
            cells.extend(totals.iter().zip(row.fastest).map(|(&t, first)| {
                format!("{about}{}{}", seconds(t), if first { format!(" {FASTEST}") } else { String::new() })
            }));
            Some(cells)
        })
        .collect();
    let views = VIEWS.iter().map(|v| if *v == 1 { "1 view".to_owned() } else { format!("{} views", grouped(*v)) });
    (!rows.is_empty()).then(|| Block::Table {
        head: head(&[&format!("At {} error", target_words(target)), "Budget", "Once", "Each view"], views),
        names: 1,
        rows,
    })
}

fn budget(method: &MethodInfo, reach: &Reach) -> String {
    match method.budget_unit.as_str() {
        "samples" => short_count(reach.budget),
        _ => budget_words(method, reach.budget),
    }
}

/// A budget with its unit; that of exact ray casting is one over its tolerance.
pub(crate) fn budget_words(method: &MethodInfo, budget: f64) -> String {
    match method.budget_unit.as_str() {
        "1/tolerance" => format!("tolerance {}", significant(1.0 / budget, 1)),
        unit => format!("{} {unit}", short_count(budget)),
    }
}

fn short_count(value: f64) -> String {
    let rounded = value.round();
    if rounded >= 1024.0 && rounded < 2f64.powi(53) && (rounded as u64).is_power_of_two() {
        return short_samples(rounded as u64);
    }
    match value {
        v if v >= 1e9 => format!("{} G", significant(v / 1e9, 3)),
        v if v >= 1e6 => format!("{} M", significant(v / 1e6, 3)),
        v if v >= 1e4 => format!("{} k", significant(v / 1e3, 3)),
        v => significant(v, 3),
    }
}

/// Where samplers and ray casters take the same time for one image.
pub(crate) fn meetings(run: &CostSummary, subject: &SubjectInfo, lane: usize) -> Option<Block> {
    let mut rows = Vec::new();
    for meeting in run.meetings.iter().filter(|m| m.dataset == subject.dataset && m.threads == lane) {
        let c = &meeting.crossing;
        let names = [label(run, &meeting.sampler), family(run, &meeting.rays)];
        let (cruder, finer) = if c.first_for_larger { (&names[0], &names[1]) } else { (&names[1], &names[0]) };
        rows.push(vec![
            names[0].clone(),
            names[1].clone(),
            percent(c.error),
            short_count(c.budget),
            seconds(c.seconds),
            cruder.clone(),
            finer.clone(),
        ]);
    }
    let names = ["Sampler", "Ray caster", "Equal at error", "Samples", "Time", "Quicker above", "Quicker below"];
    (!rows.is_empty()).then(|| Block::Table { head: head(&names, std::iter::empty()), names: 2, rows })
}

/// From how many views samplers are the cheaper way.
pub(crate) fn break_evens(run: &CostSummary, subject: &SubjectInfo, lane: usize) -> Option<Block> {
    let mine = || run.break_evens.iter().filter(|b| b.dataset == subject.dataset && b.threads == lane);
    let mut pairs: Vec<(&str, &str)> = mine().map(|b| (b.sampler.as_str(), b.rays.as_str())).collect();
    pairs.sort_unstable();
    pairs.dedup();
    let cell = |sampler: &str, rays: &str, target: f64| {
        let found = mine().find(|b| b.sampler == sampler && b.rays == rays && b.target == target);
        found.map_or(dash(), |b| b.views.map_or("never".to_owned(), |v| format!("from {}", grouped(v))))
    };
    let rows: Vec<Vec<String>> = pairs
        .into_iter()
        .map(|(sampler, rays)| {
            let names = [label(run, sampler), family(run, rays)];
            names.into_iter().chain(run.targets.iter().map(|&t| cell(sampler, rays, t))).collect()
        })
        .collect();
    (!rows.is_empty()).then(|| Block::Table {
        head: head(&["Cheaper in total", "than"], run.targets.iter().map(|&t| format!("at {}", target_words(t)))),
        names: 2,
        rows,
    })
}

/// Volume sizes at which samplers and ray casters are equal.
pub(crate) fn size_crossings(run: &CostSummary) -> Option<Block> {
    let rows: Vec<Vec<String>> = run
        .size_crossings
        .iter()
        .map(|c| {
            let side = c.voxels.cbrt();
            vec![
                threads(c.threads),
                target_words(c.target),
                if c.clock == "view" { "each further view".into() } else { "one image, everything included".into() },
                label(run, &c.sampler),
                family(run, &c.rays),
                format!("{} ({}³)", short_count(c.voxels), significant(side, 3)),
                if c.sampler_for_larger { label(run, &c.sampler) } else { family(run, &c.rays) },
            ]
        })
        .collect();
    let names = ["Threads", "Error", "Clock", "Sampler", "Ray caster", "Equal at voxels", "Quicker for larger volumes"];
    (!rows.is_empty()).then(|| Block::Table { head: head(&names, std::iter::empty()), names: 5, rows })
}

/// The fitted models.
pub(crate) fn models(run: &CostSummary) -> Option<Block> {
    let per = |name: &str, seconds_each: f64| match name {
        "image" | "volume" => format!("{} ", seconds(seconds_each)).trim().to_owned(),
        name => {
            let (scale, unit) = if seconds_each < 1e-9 { (1e12, "ps") } else { (1e9, "ns") };
            format!("{} {unit} · {name}s", significant(seconds_each * scale, 3)).replace("edges", "edge")
        }
    };
    let rows: Vec<Vec<String>> = run
        .models
        .iter()
        .map(|m| {
            let terms: Vec<String> = m.terms.iter().map(|(name, c)| per(name, *c)).collect();
            vec![
                label(run, &m.method),
                threads(m.threads),
                if m.clock == "view" { "each view".into() } else { "once".into() },
                terms.join(" + "),
                m.timings.to_string(),
                percent(m.rms_residual),
                percent(m.worst_residual),
            ]
        })
        .collect();
    let names = ["Method", "Threads", "Clock", "Seconds", "Timings", "RMS residual", "Worst"];
    (!rows.is_empty()).then(|| Block::Table { head: head(&names, std::iter::empty()), names: 4, rows })
}

/// Every measured budget: phases, complete time, time per sample, error, efficiency.
pub(crate) fn timing(run: &CostSummary, subject: &SubjectInfo, lane: usize) -> Block {
    let reference = run.methods.iter().find(|m| m.continuous);
    let baseline =
        |budget: u64| run.points_of(subject, lane, &reference?.name).find(|p| p.budget == budget).and_then(work);
    let mut rows = Vec::new();
    for method in &run.methods {
        for p in run.points_of(subject, lane, &method.name) {
            let phase = |v: f64| if v > 0.0 { seconds(v) } else { dash() };
            let error = match (p.error, p.error_se) {
                (Some(e), Some(se)) => format!("{} %", with_error(100.0 * e, 100.0 * se)),
                (Some(e), None) => percent(e),
                _ => dash(),
            };
            let efficiency = baseline(p.budget).filter(|_| method.continuous).zip(work(p)).map(|(a, b)| a / b);
            let size = match method.budget_unit.as_str() {
                "1/tolerance" => budget_words(method, p.budget as f64),
                _ => samples(p.budget),
            };
            rows.push(vec![
                method.label.clone(),
                size,
                phase(p.prepare.median),
                phase(p.sampling.median),
                phase(p.rendering.median),
                crate::report::with_ends(p.complete),
                if method.budget_unit == "1/tolerance" {
                    dash()
                } else {
                    format!("{} ns", significant(p.view.median * 1e9 / p.budget as f64, 3))
                },
                if p.below_floor { format!("{error} †") } else { error },
                efficiency.map_or(dash(), |e| significant(e, 3)),
            ]);
        }
    }
    let names =
        ["Method", "Budget", "Once", "Sampling", "Rendering", "Complete", "Per sample or ray", "Error", "Efficiency"];
    Block::Table { head: head(&names, std::iter::empty()), names: 1, rows }
}

/// Error² times time: the inverse of the efficiency.
fn work(p: &Point) -> Option<f64> {
    Some(p.error?.powi(2) * p.complete.median)
}
