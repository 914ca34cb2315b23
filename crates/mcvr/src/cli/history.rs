//! `mcvr history`

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, bail};
use mcvr::harness::history::{self, Course, Entry};
use mcvr::harness::history_plot;
use mcvr::scene::film;
use serde_json::json;

use super::outputs;
use super::render::write_json;

/// Shows recorded results over time: one line for each metric and class of machines.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr history                                    the runs, and every metric of the last\n  \
    mcvr history --metric time/render               metrics whose names contain a word\n  \
    mcvr history --metric 'error qmc@2^20'          or several words\n  \
    mcvr history --metric time/render/tent -o render.svg\n\n\
    Records come from `mcvr bench --record`; summaries of `mcvr converge` in folders <date>-<class>/<run> count as well.")]
pub struct Args {
    /// Folder of the results
    #[arg(value_name = "DIR", default_value = "bench-results")]
    folder: PathBuf,
    /// Only metrics whose names contain all of these words
    #[arg(long, value_name = "PATTERN", default_value = "")]
    metric: String,
    /// Draw the metrics, at most twelve, as SVG
    #[arg(long = "output", short, value_name = "FILE.svg")]
    out: Option<PathBuf>,
    /// Write runs and courses as JSON; - for standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    outputs::check(args.out.iter().chain(&args.json), &[])?;
    if let Some(out) = args.out.as_ref().filter(|o| o.extension().is_none_or(|e| e != "svg")) {
        bail!("{}: the plot is an SVG; name a file that ends with .svg", out.display());
    }
    let entries = history::read(&args.folder)?;
    if entries.is_empty() {
        bail!("{}: no recorded runs; `mcvr bench --record` makes one", args.folder.display());
    }
    let courses = history::courses(&entries, &args.metric);
    if courses.is_empty() {
        bail!("--metric '{}': no metric of {} runs contains all of these words", args.metric, entries.len());
    }
    if let Some(path) = &args.out {
        let svg = history_plot::svg(&entries, &courses)?;
        film::write_whole(path, |out| out.write_all(svg.as_bytes())).with_context(|| path.display().to_string())?;
    }
    if let Some(path) = &args.json {
        write_json(path, &record(&entries, &courses))?;
    }
    if args.json.is_none() && args.out.is_none() {
        outputs::stdout().write_all(table(&entries, &courses).as_bytes())?;
    }
    Ok(())
}

fn record(entries: &[Entry], courses: &[Course<'_>]) -> serde_json::Value {
    let runs: Vec<_> = entries
        .iter()
        .map(|e| json!({ "date": e.date, "machine": e.machine, "commit": e.commit, "file": e.file }))
        .collect();
    let point = |(run, value): &(usize, f64)| json!({ "run": run, "value": value });
    let course = |c: &Course<'_>| {
        json!({
            "metric": c.metric, "unit": history::unit(c.metric), "machine": c.machine,
            "points": c.points.iter().map(point).collect::<Vec<_>>(),
        })
    };
    json!({ "runs": runs, "courses": courses.iter().map(course).collect::<Vec<_>>() })
}

/// Runs, then a line for each metric by class of machines: its course, first and last value, and the change.
fn table(entries: &[Entry], courses: &[Course<'_>]) -> String {
    let mut machines: Vec<&str> = courses.iter().map(|c| c.machine).collect();
    machines.sort_unstable();
    machines.dedup();
    let width = courses.iter().map(|c| c.metric.len()).max().unwrap_or(0);
    let mut text = String::new();
    for machine in machines {
        text += &format!("{machine}\n");
        let own: Vec<&Course<'_>> = courses.iter().filter(|c| c.machine == machine).collect();
        for (i, e) in entries.iter().enumerate() {
            if own.iter().any(|c| c.points.iter().any(|p| p.0 == i)) {
                text += &format!("  {} {}  {}\n", e.day(), e.commit, e.file.display());
            }
        }
        for course in own {
            let values: Vec<f64> = course.points.iter().map(|p| p.1).collect();
            let (Some(first), Some(last)) = (values.first(), values.last()) else { continue };
            let change = match values.len() {
                1 => String::new(),
                n => format!(" from {} ({:+.1} % over {n} runs)", figure(*first), 100.0 * (last / first - 1.0)),
            };
            let unit = history::unit(course.metric);
            text += &format!("  {:width$}  {}  {} {unit}{change}\n", course.metric, sparkline(&values), figure(*last));
        }
        text.push('\n');
    }
    text
}

/// Four digits, in a form that any program reads.
fn figure(value: f64) -> String {
    match value.abs() {
        v if v >= 1e4 => format!("{value:.0}"),
        v if v >= 1.0 || v == 0.0 => format!("{value:.3}"),
        _ => format!("{value:.3e}"),
    }
}

/// Values from the smallest to the largest as bars; equal ones in the middle. Changes below 1 % of the value count as none.
fn sparkline(values: &[f64]) -> String {
    const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let flat = high - low <= 0.01 * high.abs();
    let bar = |v: &f64| if flat { BARS[3] } else { BARS[((v - low) / (high - low) * 7.0).round() as usize % 8] };
    values.iter().map(bar).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sparklines_rise_and_stay_flat() {
        assert_eq!(sparkline(&[1.0, 2.0, 8.0]), "▁▂█");
        assert_eq!(sparkline(&[1.0, 1.001]), "▄▄");
        assert_eq!(sparkline(&[0.0]), "▄");
    }

    #[test]
    fn a_table_keeps_machines_apart() {
        let entry = |date: &str, machine: &str, v: f64| Entry {
            date: date.into(),
            machine: machine.into(),
            commit: "abc".into(),
            metrics: [("time/x".to_owned(), v)].into(),
            file: "f.json".into(),
        };
        let entries = [entry("2026-01-01", "a", 2.0), entry("2026-01-02", "b", 9.0), entry("2026-01-03", "a", 3.0)];
        let text = table(&entries, &history::courses(&entries, ""));
        assert!(text.contains("time/x  ▁█  3.000 ns from 2.000 (+50.0 % over 2 runs)"), "{text}");
        assert!(text.contains("time/x  ▄  9.000 ns\n"), "{text}");
        assert_eq!(text.matches("2026-01-02").count(), 1);
    }
}
