//! Everything that is drawn from a summary: plots and reports.

use std::path::Path;

use crate::chart::Chart;
use crate::record::write_file;
use crate::{HarnessError, RunSummary, html, markdown, plot, report};

/// Writes all plots and reports into the run's folder; a plot without points is removed, not left over.
pub(crate) fn write_all(summary: &RunSummary) -> Result<(), HarnessError> {
    write_plot(&summary.folder, plot::ERROR_VS_TIME, plot::error_vs_time_chart(summary).as_ref())?;
    write_plot(&summary.folder, plot::ERROR_VS_SAMPLES, plot::error_vs_samples_chart(summary).as_ref())?;
    write_plot(&summary.folder, plot::TIME_VS_SAMPLES, plot::time_vs_samples_chart(summary).as_ref())?;
    let blocks = report::blocks(summary);
    let page = html::page(&report::title(summary), &blocks, &summary.folder)?;
    write_file(&summary.folder.join("report.html"), page.as_bytes())?;
    let text = markdown::page(&report::title(summary), &blocks, &summary.folder);
    write_file(&summary.folder.join("report.md"), text.as_bytes())
}

/// Writes a plot `NAME.svg` and its narrow form for phones, which the page shows there; without a chart both are
/// removed.
pub(crate) fn write_plot(folder: &Path, name: &str, chart: Option<&Chart>) -> Result<(), HarnessError> {
    let forms = match chart {
        Some(chart) => [Some(chart.svg()?), Some(chart.narrow_svg()?)],
        None => [None, None],
    };
    for (name, svg) in [name.to_owned(), narrow_name(name)].iter().zip(forms) {
        let path = folder.join(name);
        match svg {
            Some(svg) => write_file(&path, svg.as_bytes())?,
            None => match std::fs::remove_file(&path) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(HarnessError::file(&path, e)),
                _ => {}
            },
        }
    }
    Ok(())
}

/// `plot.svg` as `plot-narrow.svg`.
pub(crate) fn narrow_name(name: &str) -> String {
    format!("{}-narrow.svg", name.strip_suffix(".svg").unwrap_or(name))
}
