//! The crossover map: which method is the quickest, by volume size and error.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::plots::{Drawing, Plot, about, threads};
use super::reach::By;
use super::summary::{CostSummary, MethodInfo, SubjectInfo};
use super::tables::target_words;
use crate::HarnessError;
use crate::chart::pen::{Drawn, FINE, Pen, px};
use crate::chart::{FAINT, INK, MUTED, PALETTE, finish_svg, wrap};
use crate::format::seconds;
use crate::html::escape;

/// Which time the map shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Clock {
    /// One image with everything.
    Complete,
    /// Each further view of the same volume.
    View,
}

impl Clock {
    fn words(self) -> &'static str {
        match self {
            Clock::Complete => "one image, everything included",
            Clock::View => "each further view, the preparation done",
        }
    }

    fn slug(self) -> &'static str {
        match self {
            Clock::Complete => "image",
            Clock::View => "view",
        }
    }
}

/// A cell: the quickest method and its time.
type Cell<'a> = Option<(&'a MethodInfo, f64)>;

const WIDTH: f64 = 760.0;
const LEFT: f64 = 96.0;
const TOP: f64 = 78.0;
const ROW: f64 = 58.0;

/// The map of the quickest measured method; `None` with fewer than two volumes.
pub(crate) fn crossover_map(run: &CostSummary, lane: usize, clock: Clock) -> Result<Option<Plot>, HarnessError> {
    let mut subjects: Vec<&SubjectInfo> = run.judged().map(|(s, _)| s).collect();
    if subjects.len() < 2 {
        return Ok(None);
    }
    subjects.sort_by_key(|s| s.voxels);
    let caption: Vec<String> = about(run, &run.meta.title, lane)
        .into_iter()
        .chain([format!(
            "Quickest measured method and its median time of {} repeats, {}. Empty: no method was measured there, or the truth \
             cannot judge it.",
            run.repeats,
            clock.words()
        )])
        .flat_map(|line| wrap(&line, 112))
        .collect();
    let height = TOP + ROW * run.targets.len() as f64 + 84.0 + 16.0 * caption.len() as f64;
    let title = format!("Quickest method by volume size and error, {}: {}", threads(lane), clock.words());
    let mut svg = String::new();
    let size = ((WIDTH as i32 * FINE) as u32, (height as i32 * FINE) as u32);
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        let fail = |e: String| HarnessError::Plot { name: "crossover map".into(), problem: e };
        let pen = Pen { area: &area };
        draw(&pen, run, lane, clock, &subjects, &title, &caption).map_err(|e| fail(e.to_string()))?;
        area.present().map_err(|e| fail(e.to_string()))?;
    }
    let hits = targets(run, lane, clock, &subjects);
    let svg = finish_svg(&svg, [WIDTH as i32, height as i32], &title, &hits).ok_or_else(|| HarnessError::Plot {
        name: "crossover map".into(),
        problem: "unexpected SVG document".into(),
    })?;
    let name = format!("crossover_map-{}-{lane}.svg", clock.slug());
    Ok(Some(Plot { name, drawing: Drawing::Svg(svg), what: format!("{title}.") }))
}

/// Invisible targets over the cells, whose titles a browser shows and a screen reader says.
fn targets(run: &CostSummary, lane: usize, clock: Clock, subjects: &[&SubjectInfo]) -> String {
    let mut text = String::new();
    for (r, &target) in run.targets.iter().enumerate() {
        text.push_str(&format!("<g class=\"hits\" aria-label=\"{}\">\n", target_words(target)));
        for (c, subject) in subjects.iter().enumerate() {
            let Some((method, time)) = quickest(run, lane, clock, subject, target) else { continue };
            let [[left, top], [right, bottom]] = cell_corners(r, c, subjects.len());
            let ((x, y), (x2, y2)) = (px((left, top)), px((right, bottom)));
            text.push_str(&format!(
                "<rect class=\"hit\" x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{}\" fill=\"none\" pointer-events=\"all\"><title>{}\n\
                 {} error\n{}: {}</title></rect>\n",
                x2 - x,
                y2 - y,
                escape(&subject.dataset),
                target_words(target),
                escape(&method.label),
                seconds(time)
            ));
        }
        text.push_str("</g>\n");
    }
    text
}

/// Top left and bottom right of a cell, a pixel within its share.
fn cell_corners(row: usize, column: usize, columns: usize) -> [[f64; 2]; 2] {
    let width = (WIDTH - LEFT - 22.0) / columns as f64;
    let (left, top) = (LEFT + width * column as f64, TOP + ROW * row as f64);
    [[left + 1.0, top + 1.0], [left + width - 1.0, top + ROW - 1.0]]
}

fn draw<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    run: &CostSummary,
    lane: usize,
    clock: Clock,
    subjects: &[&SubjectInfo],
    title: &str,
    caption: &[String],
) -> Drawn<DB> {
    pen.area.fill(&WHITE)?;
    pen.text(
        (16.0, 28.0),
        title,
        (728.0 / 0.62 / title.chars().count() as f64).clamp(10.0, 18.0),
        INK,
        HPos::Left,
        true,
    )?;
    pen.text((16.0, 58.0), "Error to reach (RMSE over the mean pixel)", 13.5, MUTED, HPos::Left, false)?;
    let column = (WIDTH - LEFT - 22.0) / subjects.len() as f64;
    for (r, &target) in run.targets.iter().enumerate() {
        let top = TOP + ROW * r as f64;
        pen.text((LEFT - 10.0, top + ROW / 2.0 + 4.5), &target_words(target), 13.0, INK, HPos::Right, false)?;
        for (c, subject) in subjects.iter().enumerate() {
            let corners = cell_corners(r, c, subjects.len()).map(|[x, y]| px((x, y)));
            let Some((method, time)) = quickest(run, lane, clock, subject, target) else {
                pen.area.draw(&Rectangle::new(corners, FAINT.filled()))?;
                continue;
            };
            let style = run.methods.iter().position(|m| m.name == method.name).unwrap_or(0);
            pen.area.draw(&Rectangle::new(corners, PALETTE[style % PALETTE.len()].mix(0.3).filled()))?;
            let middle = LEFT + column * (c as f64 + 0.5);
            let label = short(&method.label);
            let font = (column * 0.92 / 0.55 / label.chars().count() as f64).clamp(7.0, 13.0);
            pen.text((middle, top + 25.0), label, font, INK, HPos::Center, true)?;
            pen.text((middle, top + 43.0), &seconds(time), 12.5, INK, HPos::Center, false)?;
        }
    }
    let bottom = TOP + ROW * run.targets.len() as f64;
    for (c, subject) in subjects.iter().enumerate() {
        let middle = LEFT + column * (c as f64 + 0.5);
        let font = (column * 0.95 / 0.55 / subject.dataset.chars().count() as f64).clamp(7.0, 13.0);
        pen.text((middle, bottom + 20.0), &subject.dataset, font, INK, HPos::Center, false)?;
    }
    pen.text((LEFT + (WIDTH - LEFT) / 2.0, bottom + 42.0), "Volume", 13.5, MUTED, HPos::Center, false)?;
    for (i, line) in caption.iter().enumerate() {
        pen.text((16.0, bottom + 68.0 + 16.0 * i as f64), line, 12.0, MUTED, HPos::Left, false)?;
    }
    Ok(())
}

/// A label up to its bracket; what follows a comma tells settings apart.
fn short(label: &str) -> &str {
    label.split('(').next().unwrap_or(label).trim()
}

fn quickest<'a>(run: &'a CostSummary, lane: usize, clock: Clock, subject: &SubjectInfo, target: f64) -> Cell<'a> {
    run.reaches
        .iter()
        .filter(|r| r.dataset == subject.dataset && r.threads == lane && r.target == target)
        .filter_map(|r| {
            let reach = r.reach.filter(|r| r.by != By::Extrapolated)?;
            let time = if clock == Clock::View { reach.view } else { reach.total(1, 1) };
            Some((run.methods.iter().find(|m| m.name == r.method)?, time))
        })
        .min_by(|a, b| a.1.total_cmp(&b.1))
}
