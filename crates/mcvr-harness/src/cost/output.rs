//! Everything that is drawn from a summary.

use super::plots::{self, Drawing, Plot};
use super::{CostSummary, map, report};
use crate::output::write_plot;
use crate::record::write_file;
use crate::{HarnessError, html, markdown};

/// Writes `summary.json`, all plots, `report.html` and `report.md` into the run's folder.
pub(crate) fn write_all(summary: &CostSummary) -> Result<(), HarnessError> {
    let path = summary.folder.join("summary.json");
    let text = serde_json::to_vec_pretty(summary).map_err(|e| HarnessError::file(&path, e))?;
    write_file(&path, &text)?;
    let plots = draw(summary)?;
    for plot in &plots {
        match &plot.drawing {
            Drawing::Chart(chart) => write_plot(&summary.folder, &plot.name, Some(chart))?,
            Drawing::Svg(svg) => write_file(&summary.folder.join(&plot.name), svg.as_bytes())?,
        }
    }
    let blocks = report::blocks(summary, &plots);
    let title = report::title(summary);
    let page = html::page(&title, &blocks, &summary.folder)?;
    write_file(&summary.folder.join("report.html"), page.as_bytes())?;
    write_file(&summary.folder.join("report.md"), markdown::page(&title, &blocks, &summary.folder).as_bytes())
}

fn draw(summary: &CostSummary) -> Result<Vec<Plot>, HarnessError> {
    let mut plots = Vec::new();
    let lanes: Vec<usize> = summary.meta.threads.iter().rev().copied().collect();
    for &lane in &lanes {
        for clock in [map::Clock::Complete, map::Clock::View] {
            plots.extend(map::crossover_map(summary, lane, clock)?);
        }
    }
    for (subject, _) in summary.judged() {
        for &lane in &lanes {
            plots.extend(plots::error_vs_time(summary, subject, lane));
        }
    }
    if let Some(&lane) = lanes.first() {
        for &target in &summary.targets {
            plots.extend(plots::time_vs_voxels(summary, lane, target));
        }
    }
    Ok(plots)
}
