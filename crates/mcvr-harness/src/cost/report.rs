//! What a cost report says, as blocks.

use super::plots::{Plot, commits, threads};
use super::summary::{ANY, CostSummary, MethodInfo, ReachRow, SubjectInfo};
use super::tables::{self, label, target_words};
use crate::SeriesImage;
use crate::fit::FLOOR_FACTOR;
use crate::format::{percent, seconds};
use crate::report::{Block, Series, Shot, Viewer};

/// Title of the report.
pub(crate) fn title(run: &CostSummary) -> String {
    format!("What accuracy costs in time: {}", run.meta.title)
}

/// The answer in a few lines, for a terminal.
pub fn cost_lines(run: &CostSummary) -> Vec<String> {
    let Some(lane) = run.meta.threads.last().copied() else { return Vec::new() };
    let mut lines = Vec::new();
    for (subject, _) in run.judged() {
        let quickest: Vec<String> = run
            .targets
            .iter()
            .filter_map(|&target| {
                let row = fastest(run, subject, lane, target)?;
                let time = row.totals?[0];
                Some(format!("{}: {}, {}", target_words(target), short(&label(run, &row.method)), seconds(time)))
            })
            .collect();
        if !quickest.is_empty() {
            let of = if run.judged().count() > 1 { format!("{}: q", subject.dataset) } else { "Q".to_owned() };
            lines.push(format!("{of}uickest on {} to an error of {}.", threads(lane), quickest.join("; of ")));
        }
        lines.extend(meeting_line(run, subject, lane));
        lines.extend(super::peers::line(run, subject, lane));
    }
    lines
}

fn fastest<'a>(run: &'a CostSummary, subject: &SubjectInfo, lane: usize, target: f64) -> Option<&'a ReachRow> {
    run.reaches.iter().find(|r| r.dataset == subject.dataset && r.threads == lane && r.target == target && r.fastest[0])
}

/// A label up to its first comma or bracket.
fn short(label: &str) -> &str {
    label.split([',', '(']).next().unwrap_or(label).trim()
}

/// The smallest error at which any sampler is still quicker than every ray caster.
fn meeting_line(run: &CostSummary, subject: &SubjectInfo, lane: usize) -> Option<String> {
    let here = || run.meetings.iter().filter(|m| m.dataset == subject.dataset && m.threads == lane);
    let rays = if here().any(|m| m.rays == ANY) { ANY } else { "march" };
    let last = here().filter(|m| m.rays == rays && m.crossing.first_for_larger);
    let best = last.min_by(|a, b| a.crossing.error.total_cmp(&b.crossing.error))?;
    // A sampler that meets no ray caster within what was measured may still be the quickest further down.
    let sampler = |row: &ReachRow| run.methods.iter().any(|m| m.name == row.method && m.continuous);
    let finer = run.targets.iter().filter(|&&t| t < best.crossing.error);
    if finer.filter_map(|&t| fastest(run, subject, lane, t)).any(sampler) {
        return None;
    }
    Some(format!(
        "Below {} error ({}) ray casting is quicker than all sampling; {} holds out longest.",
        percent(best.crossing.error),
        seconds(best.crossing.seconds),
        short(&label(run, &best.sampler))
    ))
}

/// The winners over the volumes, for each error.
fn sizes_line(run: &CostSummary, lane: usize) -> String {
    let mut subjects: Vec<&SubjectInfo> = run.judged().map(|(s, _)| s).collect();
    subjects.sort_by_key(|s| s.voxels);
    let parts: Vec<String> = run
        .targets
        .iter()
        .filter_map(|&target| {
            let winners: Vec<(String, &str)> = subjects
                .iter()
                .filter_map(|s| {
                    let row = fastest(run, s, lane, target)?;
                    Some((short(&label(run, &row.method)).to_owned(), s.dataset.as_str()))
                })
                .collect();
            let mut text = String::new();
            for group in winners.chunk_by(|a, b| a.0 == b.0) {
                let join = if text.is_empty() { "" } else { ", " };
                let (first, last) = (group.first()?, group.last()?);
                let range = match (group.len() == winners.len(), group.len()) {
                    (true, _) => "for all".to_owned(),
                    (false, 1) => format!("for {}", first.1),
                    (false, _) => format!("for {} to {}", first.1, last.1),
                };
                text.push_str(&format!("{join}{} {range}", first.0));
            }
            (!text.is_empty()).then(|| format!("{}: {text}", target_words(target)))
        })
        .collect();
    format!("Quickest to an error of … on {}: {}.", threads(lane), parts.join("; "))
}

/// The whole report.
pub(crate) fn blocks(run: &CostSummary, plots: &[Plot]) -> Vec<Block> {
    let Some(lane) = run.meta.threads.last().copied() else { return Vec::new() };
    let several = run.judged().count() > 1;
    let lead = if several { sizes_line(run, lane) } else { cost_lines(run).join(" ") };
    let mut blocks = vec![Block::Lead(lead)];
    let plot = |name: &str| plots.iter().find(|p| p.name == name).map(|p| Block::Plot(p.name.clone(), p.what.clone()));
    if several {
        blocks.extend(plot(&format!("crossover_map-image-{lane}.svg")));
        // The middle of the errors that were asked for stands for them all; the others follow volume by volume.
        let target = run.targets[run.targets.len() / 2];
        blocks.push(tables::time_by_volume(run, lane, target));
        blocks.push(Block::Text(how_to_read(run)));
        sizes(run, lane, &plot, &mut blocks);
    }
    for (subject, _) in run.judged() {
        if several {
            blocks.push(Block::Heading(subject.dataset.clone()));
        }
        for &lane in run.meta.threads.iter().rev() {
            if Some(&lane) != run.meta.threads.last() {
                blocks.push(Block::Subheading(format!("On {}", threads(lane))));
            }
            blocks.extend(plot(&super::plots::error_vs_time_name(run, subject, lane)));
            blocks.push(tables::time_to_error(run, subject, lane));
            if !several && Some(&lane) == run.meta.threads.last() {
                blocks.push(Block::Text(how_to_read(run)));
            }
        }
        if let Some(table) = tables::meetings(run, subject, lane) {
            blocks.push(Block::Subheading("Where samplers and ray casters take the same time".into()));
            blocks.push(Block::Text(
                format!(
                "For one image with everything included, {}, on measured parts of the curves only. “Ray march” is the best of its steps \
                 and numbers of rays. It has settings and nothing between, so that a pair can meet more than once.",
                threads(lane)
            ),
            ));
            blocks.push(table);
        }
        super::peers::blocks(run, subject, &mut blocks);
        views(run, subject, lane, &mut blocks);
        blocks.push(Block::Subheading("Every measured budget".into()));
        blocks.push(Block::Text(format!(
            "Medians over {} repeats, fastest to slowest in brackets, {}. “Once” is what a further view of the same volume need not pay \
             again. † marks errors below {FLOOR_FACTOR} times the truth's own; they are in no plot. Efficiency is 1 / (error² · time) \
             of a complete image, relative to {} at the same number of samples.",
            run.repeats,
            threads(lane),
            run.methods.iter().find(|m| m.continuous).map_or("the first sampler", |m| m.label.as_str())
        )));
        blocks.push(tables::timing(run, subject, lane));
    }
    if let Some(table) = tables::models(run) {
        blocks.push(Block::Heading("A model of the time".into()));
        blocks.push(Block::Text(
            "Seconds as a sum of non-negative multiples of what the work grows with, by least squares on relative residuals over all \
             measured budgets, image sizes and volumes. Residuals are relative to the measured time. A “brick” is 256 voxels, unpacked when the first sample falls into it; how many are is what equal weights would \
                 give. A term that did not vary here, or that the fit leaves at 0, is absent. Exact ray casting has no such law: its rays depend on the image."
                .into(),
        ));
        blocks.push(table);
    }
    pictures(run, &mut blocks);
    measured(run, &mut blocks);
    blocks
}

fn how_to_read(run: &CostSummary) -> String {
    format!("{READING} Budgets were not raised once a view took longer than {}.", seconds(run.longest))
}

/// What the marks of a table of times to an error mean.
pub(crate) const READING: &str = "★ marks the quickest measured way: the frontier. Between two measured budgets of a sampler error and \
    time follow power laws; ray casters have the settings that were measured and none between. ≈ continues a sampler's curve beyond \
    its last budget, and is never marked. – means that the method does not get there, or that the truth cannot judge it.";

fn sizes(run: &CostSummary, lane: usize, plot: &dyn Fn(&str) -> Option<Block>, blocks: &mut Vec<Block>) {
    blocks.push(Block::Heading("Volume size".into()));
    blocks.extend(plot(&format!("crossover_map-view-{lane}.svg")));
    for &other in run.meta.threads.iter().rev().filter(|&&t| t != lane) {
        blocks.extend(plot(&format!("crossover_map-image-{other}.svg")));
    }
    for &target in &run.targets {
        let name = format!("time_vs_voxels-{}.svg", super::plots::target_slug(target));
        blocks.extend(plot(&name));
    }
    match tables::size_crossings(run) {
        Some(table) => {
            blocks.push(Block::Text(
                "Volume sizes at which a sampler and a ray caster take the same time to an error, between measured sizes on a log scale:".into(),
            ));
            blocks.push(table);
        }
        None => blocks.push(Block::Text(
            "At none of the errors does a sampler overtake a ray caster, or the reverse, between the smallest and the largest volume.".into(),
        )),
    }
}

fn views(run: &CostSummary, subject: &SubjectInfo, lane: usize, blocks: &mut Vec<Block>) {
    blocks.push(Block::Subheading("Many views of one volume".into()));
    blocks.push(Block::Text(format!(
        "Three clocks, {}: what is done once for a volume (sums over its voxels; for a kept cloud also the drawing of its points), what each \
         view takes, and the total. Orders that follow the view need up to three distributions, which the totals contain. Totals are \
         computed from the two clocks at this view.",
        threads(lane)
    )));
    for &target in &run.targets {
        blocks.extend(tables::many_views(run, subject, lane, target));
    }
    if let Some(table) = tables::break_evens(run, subject, lane) {
        blocks.push(Block::Text("From how many views the first is the cheaper in total:".into()));
        blocks.push(table);
    }
}

fn pictures(run: &CostSummary, blocks: &mut Vec<Block>) {
    if run.pictures.0.is_empty() {
        return;
    }
    blocks.push(Block::Heading("Images".into()));
    blocks.push(Block::Text(format!(
        "All images under the truth's tones (0th to 99.9th percentile). Differences are image minus truth: red too bright, blue too dark, \
         white the same; full colour at ±{}, twice the truth's mean pixel, in steps of 1/127 of that.",
        crate::format::significant(run.pictures.1, 3)
    )));
    let shot = |method: &MethodInfo, s: &SeriesImage| {
        let error = s.rel_rmse.map_or(String::new(), |e| format!(", error {}", percent(e)));
        Shot {
            setting: s.samples,
            caption: format!("{}{error}, {}", tables::budget_words(method, s.samples as f64), seconds(s.complete)),
            image: s.image.clone(),
            difference: s.difference.clone(),
        }
    };
    let series = run.methods.iter().map(|method| {
        let mine = run.pictures.0.iter().filter(|s| s.method == method.name);
        Series { label: method.label.clone(), shots: mine.map(|s| shot(method, s)).collect() }
    });
    blocks.push(Block::Viewer(Viewer {
        truth: ("truth.png".into(), "Truth, ray cast".into()),
        setting: "Budget".into(),
        series: series.filter(|s| !s.shots.is_empty()).collect(),
    }));
}

fn measured(run: &CostSummary, blocks: &mut Vec<Block>) {
    let m = &run.meta;
    let lanes: Vec<String> = m.threads.iter().map(|&n| threads(n)).collect();
    let truths: Vec<String> = run
        .judged()
        .filter_map(|(s, _)| {
            let t = s.truth.as_ref()?;
            Some(format!("{} {} in {}", s.dataset, percent(t.rel_error_estimate), seconds(t.seconds)))
        })
        .collect();
    blocks.push(Block::Heading("How it was measured".into()));
    for text in [
        format!(
            "Every method makes images from small budgets to large ones, each {} times with its own seed, on {}. Within one rung all methods \
             and numbers of threads take turns, starting with another one each time, so that a change of the machine's pace hits all alike; \
             each makes one image that is not counted before its first. Volumes are measured one after the other. A budget is not raised \
             further once a view takes longer than {} or its error falls below {FLOOR_FACTOR} times the truth's own.",
            run.repeats,
            lanes.join(" and on "),
            seconds(run.longest)
        ),
        format!(
            "The truth is the same image by ray casting, integrated until its own error estimate is small: {}. Errors are root mean squares \
             over all pixels of the difference from it, over its mean pixel, before any tone.",
            truths.join("; ")
        ),
        format!(
            "Wall-clock times are complete images from a volume in memory to linear pixel values; loading, toning and writing are not in them. \
             Of {} images that were made on several numbers of threads, {} differed.",
            run.compared[0], run.compared[1]
        ),
        format!(
            "View: {}; image: {}; kernel: {}; a pixel is: {} ({}); {}. Machine: {}; program {} at commit {}.",
            m.view,
            m.size,
            m.kernel.name(),
            m.estimand,
            m.estimand.unit(),
            m.scene,
            m.machine,
            env!("CARGO_PKG_VERSION"),
            commits(run)
        ),
        "The command:".to_owned(),
    ] {
        blocks.push(Block::Text(text));
    }
    blocks.push(Block::Code(m.command.clone()));
    let present = |files: &[(&str, &str)]| -> Vec<(String, String)> {
        let there = files.iter().filter(|(name, _)| run.folder.join(name).exists());
        there.map(|&(n, w)| (n.to_owned(), w.to_owned())).collect()
    };
    blocks.push(Block::Heading("Data".into()));
    blocks.push(Block::Downloads(present(&[
        ("records.csv", "every measured image, one row each; units in the column names"),
        ("summary.json", "everything that this page shows"),
    ])));
    blocks.push(Block::Files(present(&[
        ("records.jsonl", "the records as they were appended while measuring, with a hash of each image"),
        ("run.json", "what this folder measures"),
    ])));
}
