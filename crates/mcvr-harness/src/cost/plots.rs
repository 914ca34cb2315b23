//! Error against time of each volume, and the time to an error against the volume's size.

use super::peers::{self, PeerPoint};
use super::points::Point;
use super::reach::By;
use super::summary::{CostSummary, MethodInfo, SubjectInfo, floor};
use super::tables::{budget_words, target_words};
use crate::Spread;
use crate::chart::{Axis, Bar, Chart, Curve, OTHERS};
use crate::fit::FLOOR_FACTOR;
use crate::format::{grouped, percent, percent_tick, power_tick, seconds, seconds_tick, with_error};

/// A plot is drawn down to the floor if that is at most so many decades below the lowest point.
const FLOOR_REACH: f64 = 1.0;

/// A plot's file name, the drawing and what it shows.
pub(crate) struct Plot {
    pub(crate) name: String,
    pub(crate) drawing: Drawing,
    pub(crate) what: String,
}

/// What is drawn: a chart, which has a narrow form for phones, or a finished document.
pub(crate) enum Drawing {
    Chart(Box<Chart>),
    Svg(String),
}

/// A number of threads in words.
pub(crate) fn threads(n: usize) -> String {
    if n == 1 { "1 thread".into() } else { format!("{n} threads") }
}

/// Letters, digits and dashes of a name, for a file.
pub(crate) fn slug(name: &str) -> String {
    let kept = name.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' });
    let text: String = kept.collect();
    text.split('-').filter(|part| !part.is_empty()).collect::<Vec<_>>().join("-")
}

/// An error as part of a file name: `0p3`.
pub(crate) fn target_slug(target: f64) -> String {
    slug(&target_words(target).replace('.', "p"))
}

/// Name of the plot of [`error_vs_time`].
pub(crate) fn error_vs_time_name(run: &CostSummary, subject: &SubjectInfo, lane: usize) -> String {
    let of = if run.judged().count() > 1 { format!("-{}", slug(&subject.dataset)) } else { String::new() };
    let on = if Some(&lane) == run.meta.threads.last() { String::new() } else { format!("-{lane}-thread") };
    format!("error_vs_time{of}{on}.svg")
}

/// Relative RMSE against the time of a complete image. `None` when there is nothing to draw.
pub(crate) fn error_vs_time(run: &CostSummary, subject: &SubjectInfo, lane: usize) -> Option<Plot> {
    let truth = subject.truth.as_ref()?;
    let floor = floor(truth.rel_error_estimate);
    let plotted = run.methods.iter().filter(|m| m.plotted).enumerate();
    let curves: Vec<Curve> = plotted
        .map(|(style, method)| {
            let point = |p: &Point| {
                let error = p.error.filter(|e| *e > floor)?;
                let spread = p.error_se.unwrap_or(0.0);
                let y = Bar { low: (error - spread).max(floor), mid: error, high: error + spread };
                Some((ends(p.complete), y))
            };
            let shown = || run.points_of(subject, lane, &method.name).filter(|p| point(p).is_some());
            Curve {
                label: method.label.clone(),
                style,
                points: shown().filter_map(point).collect(),
                hover: shown().map(|p| words(method, p)).collect(),
            }
        })
        .chain(others(run, subject, lane, floor))
        .filter(|c| !c.points.is_empty())
        .collect();
    let all = || curves.iter().flat_map(|c| &c.points);
    let lowest = all().map(|(_, y)| y.low).fold(f64::INFINITY, f64::min);
    let shown = floor > 0.0 && (lowest / floor).log10() <= FLOOR_REACH;
    let x_name = format!("Wall-clock time of a complete image, {}", threads(lane));
    let x = Axis::holding(all().flat_map(|(x, _)| [x.low, x.high]), &x_name, seconds_tick);
    let y_values = all().flat_map(|(_, y)| [y.low, y.high]).chain(shown.then_some(floor));
    let y = Axis::holding(y_values, "RMSE over the mean pixel", percent_tick);
    let (x, y) = x.zip(y)?;
    let mut caption = about(run, &subject.dataset, lane);
    caption.push(format!(
        "Points: root mean square error and median time of {} repeats; bars: standard error, fastest to slowest. Truth: ray \
         casting, {}, own error {}; nothing is drawn below {FLOOR_FACTOR} times that{}.",
        run.repeats,
        seconds(truth.seconds),
        percent(truth.rel_error_estimate),
        if shown { "" } else { ", which lies below the axis" },
    ));
    if curves.iter().any(|c| c.style >= OTHERS) {
        caption.push(
            "Grey: other systems, measured apart by scripts/peers on this scan, view and size; median time of a view, error against \
             the same truth."
                .into(),
        );
    }
    let chart = Chart {
        name: "error against time",
        title: format!("What accuracy costs in time: {}", subject.dataset),
        caption,
        x,
        y,
        curves,
        guides: Vec::new(),
        floor: shown.then(|| (floor, format!("{FLOOR_FACTOR} × the truth's own error"))),
    };
    let what = format!("Error against time, {}, {}. Lower left is better.", subject.dataset, threads(lane));
    Some(Plot { name: error_vs_time_name(run, subject, lane), drawing: Drawing::Chart(Box::new(chart)), what })
}

/// Other systems' points, a curve of single points for each.
fn others(run: &CostSummary, subject: &SubjectInfo, lane: usize, floor: f64) -> Vec<Curve> {
    let points = run.peers_of(subject, lane);
    let curve = |(i, (_, points)): (usize, (&str, Vec<&PeerPoint>))| {
        let shown = || points.iter().filter(|p| p.error > floor);
        let hover = |p: &&PeerPoint| {
            let time = crate::report::with_ends(p.seconds);
            format!("{}\n{}\nerror {}\ntime {time}", peers::name(p), p.setting, percent(p.error))
        };
        Curve {
            label: points.first().map_or(String::new(), |p| peers::name(p)),
            style: OTHERS + i,
            points: shown().map(|p| (ends(p.seconds), exact(p.error))).collect(),
            hover: shown().map(hover).collect(),
        }
    };
    peers::systems(&points).into_iter().enumerate().map(curve).collect()
}

/// What a reader sees at a point: the words of the tables.
fn words(method: &MethodInfo, p: &Point) -> String {
    let error = match (p.error, p.error_se) {
        (Some(e), Some(se)) => format!("{} %", with_error(100.0 * e, 100.0 * se)),
        (Some(e), None) => percent(e),
        _ => "not judged".to_owned(),
    };
    let time = crate::report::with_ends(p.complete);
    format!("{}\n{}\nerror {error}\ntime {time}", method.label, budget_words(method, p.budget as f64))
}

/// Time of one image to an error against the number of voxels; `None` with fewer than two volumes.
pub(crate) fn time_vs_voxels(run: &CostSummary, lane: usize, target: f64) -> Option<Plot> {
    if run.judged().count() < 2 {
        return None;
    }
    let plotted = run.methods.iter().filter(|m| m.plotted).enumerate();
    let curves: Vec<Curve> = plotted
        .map(|(style, method)| {
            let mut points: Vec<(Bar, Bar)> = run
                .judged()
                .filter_map(|(subject, _)| {
                    let row = run.reaches.iter().find(|r| {
                        r.dataset == subject.dataset
                            && r.threads == lane
                            && r.method == method.name
                            && r.target == target
                    })?;
                    let reach = row.reach.filter(|r| r.by != By::Extrapolated)?;
                    Some((exact(subject.voxels as f64), exact(reach.total(1, 1))))
                })
                .collect();
            points.sort_by(|a, b| a.0.mid.total_cmp(&b.0.mid));
            let hover = points
                .iter()
                .map(|(x, y)| format!("{}\n{} voxels\n{}", method.label, grouped(x.mid as u64), seconds(y.mid)));
            Curve { label: method.label.clone(), style, hover: hover.collect(), points }
        })
        .filter(|c| !c.points.is_empty())
        .collect();
    let all = || curves.iter().flat_map(|c| &c.points);
    let x = Axis::holding(all().map(|(x, _)| x.mid), "Voxels", power_tick);
    let y_name = format!("Wall-clock time of a complete image at {} error, {}", target_words(target), threads(lane));
    let y = Axis::holding(all().map(|(_, y)| y.mid), &y_name, seconds_tick);
    let (x, y) = x.zip(y)?;
    let sizes: Vec<String> = run.judged().map(|(s, _)| grouped(s.voxels)).collect();
    let mut caption = about(run, &run.meta.title, lane);
    caption.push(format!("Medians of {} repeats; {} voxels.", run.repeats, sizes.join(", ")));
    let chart = Chart {
        name: "time against voxels",
        title: format!("Time to {} error against the volume's size: {}", target_words(target), run.meta.title),
        caption,
        x,
        y,
        curves,
        guides: Vec::new(),
        floor: None,
    };
    let name = format!("time_vs_voxels-{}.svg", target_slug(target));
    let what = format!("Time of a complete image at {} error against the number of voxels.", target_words(target));
    Some(Plot { name, drawing: Drawing::Chart(Box::new(chart)), what })
}

/// The source revisions that measured.
pub(crate) fn commits(run: &CostSummary) -> String {
    if run.commits.is_empty() { "unknown".to_owned() } else { run.commits.join(", ") }
}

/// What was measured, where: the first lines of every caption.
pub(crate) fn about(run: &CostSummary, dataset: &str, lane: usize) -> Vec<String> {
    let m = &run.meta;
    vec![
        format!("{dataset}, {}, {}, kernel {}, estimand {}.", m.view, m.size, m.kernel.name(), m.estimand),
        format!("{}; {}; commit {}.", m.machine, threads(lane), commits(run)),
    ]
}

fn exact(value: f64) -> Bar {
    Bar { low: value, mid: value, high: value }
}

fn ends(spread: Spread) -> Bar {
    Bar { low: spread.min, mid: spread.median, high: spread.max }
}
