//! Everything that is drawn from a summary: plots and reports.

use crate::record::write_file;
use crate::{HarnessError, RunSummary, html, markdown, plot, report};

/// Writes all plots and reports into the run's folder; a plot without points is removed, not left over.
pub(crate) fn write_all(summary: &RunSummary) -> Result<(), HarnessError> {
    let plots = [
        (plot::ERROR_VS_TIME, plot::error_vs_time(summary)?),
        (plot::ERROR_VS_SAMPLES, plot::error_vs_samples(summary)?),
        (plot::TIME_VS_SAMPLES, plot::time_vs_samples(summary)?),
    ];
    for (name, svg) in &plots {
        let path = summary.folder.join(name);
        match svg {
            Some(svg) => write_file(&path, svg.as_bytes())?,
            None => match std::fs::remove_file(&path) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(HarnessError::file(&path, e)),
                _ => {}
            },
        }
    }
    let blocks = report::blocks(summary);
    let page = html::page(&report::title(summary), &blocks, &summary.folder)?;
    write_file(&summary.folder.join("report.html"), page.as_bytes())?;
    let text = markdown::page(&report::title(summary), &blocks, &summary.folder);
    write_file(&summary.folder.join("report.md"), text.as_bytes())
}
