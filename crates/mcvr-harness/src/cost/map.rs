//! The crossover map: which method is the quickest, by volume size and error.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::plots::{Plot, about, threads};
use super::reach::By;
use super::summary::{CostSummary, MethodInfo, SubjectInfo};
use super::tables::target_words;
use crate::HarnessError;
use crate::chart::{Drawn, FINE, INK, MUTED, PALETTE, Pen, finish_svg, px, wrap};
use crate::format::seconds;

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
    let svg = finish_svg(&svg, (WIDTH as i32, height as i32), &title, "crossover map")?;
    let name = format!("crossover_map-{}-{lane}.svg", clock.slug());
    Ok(Some(Plot { name, svg, what: format!("{title}.") }))
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
            let left = LEFT + column * c as f64;
            let corners = [px((left + 1.0, top + 1.0)), px((left + column - 1.0, top + ROW - 1.0))];
            let Some((method, time)) = quickest(run, lane, clock, subject, target) else {
                pen.area.draw(&Rectangle::new(corners, RGBColor(241, 243, 245).filled()))?;
                continue;
            };
            let style = run.methods.iter().position(|m| m.name == method.name).unwrap_or(0);
            pen.area.draw(&Rectangle::new(corners, PALETTE[style % PALETTE.len()].mix(0.3).filled()))?;
            let middle = left + column / 2.0;
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

/// A label up to its first comma or bracket.
fn short(label: &str) -> &str {
    label.split([',', '(']).next().unwrap_or(label).trim()
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
