//! Metrics over runs as SVG: a panel for each metric, in it a line for each class of machines.

use std::collections::BTreeSet;

use plotters::prelude::*;

use crate::HarnessError;
use crate::format::significant;
use crate::history::{Course, Entry, unit};

/// Width and height of a panel in pixels.
const PANEL: (u32, u32) = (760, 300);
/// Most panels of one plot.
pub const PANELS: usize = 12;
const PALETTE: [RGBColor; 5] =
    [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115), RGBColor(204, 121, 167), RGBColor(31, 35, 40)];

/// Draws courses over the runs that have any of them, labelled by date and commit.
///
/// # Errors
/// [`HarnessError::Plot`] for nothing to draw, more than [`PANELS`] metrics, or when the drawing library refuses.
pub fn svg(entries: &[Entry], courses: &[Course<'_>]) -> Result<String, HarnessError> {
    let fail = |problem: String| HarnessError::Plot { name: "history".into(), problem };
    let metrics: BTreeSet<&str> = courses.iter().map(|c| c.metric).collect();
    if metrics.is_empty() || metrics.len() > PANELS {
        return Err(fail(format!("{} metrics match; choose 1 to {PANELS} with --metric", metrics.len())));
    }
    // One place for each day and commit, in the order of the runs, whatever the machine.
    let drawn: BTreeSet<usize> = courses.iter().flat_map(|c| c.points.iter().map(|p| p.0)).collect();
    let mut runs: Vec<String> = drawn.into_iter().map(|i| place_name(&entries[i])).collect();
    let mut seen = BTreeSet::new();
    runs.retain(|run| seen.insert(run.clone()));
    let machines: BTreeSet<&str> = courses.iter().map(|c| c.machine).collect();
    let machines: Vec<&str> = machines.into_iter().collect();
    let mut text = String::new();
    let size = (PANEL.0, PANEL.1 * metrics.len() as u32);
    {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        root.fill(&WHITE).map_err(|e| fail(e.to_string()))?;
        for (area, metric) in root.split_evenly((metrics.len(), 1)).iter().zip(&metrics) {
            let own: Vec<&Course<'_>> = courses.iter().filter(|c| c.metric == *metric).collect();
            panel(area, metric, &own, entries, &runs, &machines).map_err(|e| fail(e.to_string()))?;
        }
        root.present().map_err(|e| fail(e.to_string()))?;
    }
    // Scales to the page's width; the title is what a screen reader says.
    let title = format!("{} over {} runs", metrics.iter().copied().collect::<Vec<_>>().join(", "), runs.len());
    let head = text.find('>').map_or(text.len(), |i| i + 1);
    text.insert_str(head, &format!("\n<title>{}</title>", crate::html::escape(&title)));
    Ok(text)
}

/// Day and commit.
fn place_name(entry: &Entry) -> String {
    format!("{} {}", entry.day(), entry.commit)
}

fn panel<DB: DrawingBackend>(
    area: &DrawingArea<DB, plotters::coord::Shift>,
    metric: &str,
    courses: &[&Course<'_>],
    entries: &[Entry],
    runs: &[String],
    machines: &[&str],
) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
    let values = || courses.iter().flat_map(|c| c.points.iter().map(|p| p.1)).filter(|v| v.is_finite());
    let (low, high) = values().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
    // A metric that never moved still gets a range, and one that hardly did is not blown up to fill the panel.
    let pad = (0.08 * (high - low)).max(0.05 * high.abs()).max(f64::MIN_POSITIVE);
    let place = |entry: usize| runs.iter().position(|r| *r == place_name(&entries[entry])).unwrap_or(0) as i32;
    // Room for the legend above the curves.
    let head = 0.12 * (courses.len() + 1) as f64 * (high - low + 2.0 * pad);
    let last = (runs.len() as i32).max(2) - 1;
    let title = format!("{metric} ({})", unit(metric)).replace(" ()", "");
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 17))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(86)
        .build_cartesian_2d((-1..last + 1).step(1), low - pad..high + pad + head)?;
    let label = |i: &i32| usize::try_from(*i).ok().and_then(|i| runs.get(i)).cloned().unwrap_or_default();
    let shown = runs.len().min(3) + 2;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(RGBColor(222, 225, 229))
        .x_labels(shown)
        .y_labels(5)
        .x_label_formatter(&label)
        .y_label_formatter(&|v| significant(*v, 4))
        .draw()?;
    for course in courses {
        let colour = PALETTE[machines.iter().position(|m| *m == course.machine).unwrap_or(0) % PALETTE.len()];
        let points: Vec<(i32, f64)> =
            course.points.iter().filter(|p| p.1.is_finite()).map(|(i, v)| (place(*i), *v)).collect();
        chart
            .draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?
            .label(course.machine)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
        chart.draw_series(points.iter().map(|p| Circle::new(*p, 4, colour.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(RGBColor(222, 225, 229))
        .draw()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::courses;

    fn entries() -> Vec<Entry> {
        let of = |i: usize| Entry {
            date: format!("2026-01-{:02}", i + 1),
            machine: if i.is_multiple_of(3) { "other & 4 cores".into() } else { "this, 2 cores".into() },
            commit: format!("c{i}"),
            metrics: [("time/a".to_owned(), 1.0 + i as f64), ("time/b".to_owned(), 2.0)].into(),
            file: Default::default(),
        };
        (0..7).map(of).collect()
    }

    #[test]
    fn a_plot_names_metrics_machines_dates_and_commits() {
        let entries = entries();
        let svg = svg(&entries, &courses(&entries, "time")).unwrap();
        for text in ["time/a (ns)", "time/b", "this, 2 cores", "other &amp; 4 cores", "2026-01-", "<title>"] {
            assert!(svg.contains(text), "{text}");
        }
        // A point for each run of each metric.
        assert_eq!(svg.matches("<circle").count(), 14);
    }

    #[test]
    fn one_run_is_enough_and_none_is_refused() {
        let entries = &entries()[..1];
        assert!(svg(entries, &courses(entries, "time/a")).is_ok());
        let error = svg(entries, &courses(entries, "nothing")).unwrap_err().to_string();
        assert!(error.contains("--metric"), "{error}");
    }
}
