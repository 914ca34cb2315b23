//! What a report says: blocks of content, which [`html`](crate::html) and [`markdown`](crate::markdown) lay out.

use crate::fit::CONFIDENCE;
use crate::format::{percent, samples, significant};
use crate::{Row, RunSummary, SeriesImage, cost, plot};
use answer::{answer, headline, headline_table, sentence};
use notes::{bias_text, error_notes, method_blocks};
use tables::{error_table, interval, slope_table, time_table};

pub(crate) use tables::{with_ends, with_error_of};

mod answer;
mod notes;
mod tables;

/// A piece of a report.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Block {
    /// The answer, set larger.
    Lead(String),
    Heading(String),
    Subheading(String),
    Text(String),
    Code(String),
    /// Header and rows; the first `names` columns are text, the others figures.
    Table {
        head: Vec<String>,
        names: usize,
        rows: Vec<Vec<String>>,
    },
    /// File name of an SVG in the run's folder, and what it shows.
    Plot(String, String),
    /// (file name, caption) of pictures in the run's folder, side by side.
    #[allow(dead_code, reason = "layouts know it; which reports use it changes")]
    Pictures(Vec<(String, String)>),
    /// Pictures of several methods beside the truth, with controls where a script runs.
    Viewer(Viewer),
    /// (file name, what is in it) of data in the run's folder that the page carries with it.
    Downloads(Vec<(String, String)>),
    /// (file name, what is in it) of files beside the page.
    Files(Vec<(String, String)>),
}

/// Pictures of several methods beside the truth. File names are of pictures in the run's folder.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Viewer {
    /// File name and caption.
    pub(crate) truth: (String, String),
    /// What `Shot::setting` counts, for example `M`.
    pub(crate) setting: String,
    pub(crate) series: Vec<Series>,
}

/// The pictures of one method.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Series {
    pub(crate) label: String,
    pub(crate) shots: Vec<Shot>,
}

/// One image and its signed difference from the truth.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Shot {
    /// Value of the slider; ascending within a series.
    pub(crate) setting: u64,
    pub(crate) caption: String,
    pub(crate) image: String,
    pub(crate) difference: String,
}

/// Title of the report.
pub(crate) fn title(run: &RunSummary) -> String {
    format!("What accuracy costs in time: {}", run.meta.dataset)
}

/// The three most important lines of a run, for a terminal: what the first method reaches, what the best one
/// gains, and how the errors fall.
pub fn key_lines(run: &RunSummary) -> [String; 3] {
    let (first, gain) = answer(run);
    let slopes: Vec<String> = run
        .methods
        .iter()
        .filter(|m| m.expected_slope.is_some())
        .filter_map(|m| m.fit.map(|f| format!("{} {}", m.label, interval(&f))))
        .collect();
    let slopes = if slopes.is_empty() {
        "Slopes: too few sample counts above the truth's own error.".to_owned()
    } else {
        format!("Slope of log error against log M, {:.0} % interval: {}.", 100.0 * CONFIDENCE, slopes.join("; "))
    };
    [first, gain, slopes]
}

/// The whole report.
pub(crate) fn blocks(run: &RunSummary) -> Vec<Block> {
    let mut blocks = vec![Block::Lead(sentence(run))];
    if run.measured < run.planned {
        let text = format!("This run is not complete: {} of {} images are measured.", run.measured, run.planned);
        blocks.push(Block::Text(text));
    }
    let (curves, series): (Vec<&Row>, Vec<&Row>) = run.rows.iter().partition(|r| !r.series_only);
    let plotted = !curves.is_empty();
    if plotted {
        blocks.push(Block::Plot(plot::ERROR_VS_TIME.into(), "Error against time. Lower left is better.".into()));
    }
    blocks.extend(headline(run).map(|m| headline_table(run, m)));
    if let Some(table) = cost::time_to_error_of(run) {
        blocks.push(Block::Heading("Time to an error".into()));
        blocks.push(table);
        blocks.push(Block::Text(cost::READING.into()));
    }
    blocks.push(Block::Heading("Error by sample count".into()));
    blocks.push(Block::Text(error_notes(run)));
    blocks.push(error_table(run));
    if plotted {
        blocks.push(Block::Plot(plot::ERROR_VS_SAMPLES.into(), "Error against samples.".into()));
    }
    blocks.push(Block::Text(bias_text(run)));
    blocks.push(Block::Heading("Slopes".into()));
    blocks.push(Block::Text(format!(
        "The exponent of M in the error, by weighted least squares on the replicates' mean log error, with its {:.0} % \
         Student t interval. “Upper half” uses only the larger sample counts, where the theory's exponents apply.",
        100.0 * CONFIDENCE
    )));
    blocks.push(slope_table(run));
    blocks.push(Block::Heading("Time by sample count".into()));
    blocks.push(Block::Text(
        "Medians of single images over the replicates, fastest to slowest in brackets. “Rendering” is the projection of \
         the samples onto the film; “complete” is the whole image from the volume in memory. The last column is the time \
         per sample. The line of the report is A. Law and E. Blythe's, “Monte Carlo Volume \
         Rendering”, as printed there: another machine, its lobster and view."
            .into(),
    ));
    blocks.push(time_table(run));
    if plotted {
        blocks.push(Block::Plot(plot::TIME_VS_SAMPLES.into(), "Time against samples.".into()));
    }
    picture_blocks(run, &mut blocks);
    method_blocks(run, !series.is_empty(), &mut blocks);
    blocks
}

fn picture_blocks(run: &RunSummary, blocks: &mut Vec<Block>) {
    blocks.push(Block::Heading("Images".into()));
    blocks.push(Block::Text(format!(
        "All images under the truth's tones (0th to 99.9th percentile). Differences are image minus truth: red too bright, \
         blue too dark, white the same; full colour at ±{}, twice the truth's mean pixel, in steps of 1/127 of that.",
        significant(run.difference_scale, 3)
    )));
    let shot = |s: &SeriesImage| {
        let error = s.rel_rmse.map_or(String::new(), |e| format!(", error {}", percent(e)));
        Shot {
            setting: s.samples,
            caption: format!("M = {}{error}", samples(s.samples)),
            image: s.image.clone(),
            difference: s.difference.clone(),
        }
    };
    let series = run.methods.iter().map(|method| Series {
        label: method.label.clone(),
        shots: run.series.iter().filter(|s| s.method == method.name).map(shot).collect(),
    });
    blocks.push(Block::Viewer(Viewer {
        truth: ("truth.png".into(), "Truth, ray cast".into()),
        setting: "M".into(),
        series: series.filter(|s| !s.shots.is_empty()).collect(),
    }));
}
