//! The words of a run's report: notes on errors and bias, and how it was measured.

use crate::fit::FLOOR_FACTOR;
use crate::format::{percent, samples, seconds};
use crate::{RunSummary, plot};

use super::Block;

pub(super) fn error_notes(run: &RunSummary) -> String {
    let first = run.methods.first().map_or("the first method", |m| m.label.as_str());
    format!(
        "RMSE over the truth's mean pixel: the root mean square over the replicates ± its standard error, and in brackets \
         the ratio to {first} at the same M. † marks errors below {FLOOR_FACTOR} times the truth's own ({}), where the \
         truth itself starts to matter; they are in no plot or fit. Efficiency is 1 / (error² · time), relative to {first}.",
        percent(run.truth.rel_error_estimate)
    )
}

pub(super) fn bias_text(run: &RunSummary) -> String {
    let label = |name: &str| run.methods.iter().find(|m| m.name == name).map_or(name, |m| m.label.as_str()).to_owned();
    let tested = run.rows.iter().filter(|r| r.bias_p.is_some()).count();
    let found: Vec<String> = run
        .rows
        .iter()
        .filter(|r| r.biased)
        .map(|r| {
            let half = r.bias_half.filter(|h| *h > 1e-9 * r.bias.abs());
            let half = half.map_or(String::new(), |h| format!(" ± {}", percent(h)));
            format!("{} at M = {}: {}{half}", label(&r.method), samples(r.samples), percent(r.bias))
        })
        .collect();
    match (tested, found.is_empty()) {
        (0, _) => "Bias: not tested; it takes at least two replicates.".into(),
        (n, true) => format!(
            "Bias: in none of {n} tests does the mean of the images over the replicates differ from the truth's mean by more \
             than chance and the truth's own error allow (1 % over all tests, Šidák)."
        ),
        (_, false) => format!("Bias: beyond chance (1 % over all tests, Šidák) differ {}.", found.join("; ")),
    }
}

pub(super) fn method_blocks(run: &RunSummary, has_series: bool, blocks: &mut Vec<Block>) {
    let m = &run.meta;
    let commits = if run.commits.is_empty() { "unknown".to_owned() } else { run.commits.join(", ") };
    blocks.push(Block::Heading("How it was measured".into()));
    let parts = [
        (
            "What is compared",
            format!(
                "Every method makes the same X-ray image. The truth is that image by ray casting, integrated \
             until its own error estimate is {} of the mean pixel; it took {}. An error is the difference from the truth, \
             pixel by pixel, on linear values, before any tone.",
                percent(run.truth.rel_error_estimate),
                seconds(run.truth.seconds)
            ),
        ),
        (
            "How often",
            format!(
                "Each figure rests on independent repetitions: {} Each has a seed of its own, the same for all \
             methods (run seed {}). The methods take turns within each sample count and repetition, so that a change of \
             the machine's pace hits all alike. Each makes one image that is not counted before the first that is.",
                plot::repetitions(run),
                run.seed
            ),
        ),
        (
            "What time means",
            "Wall-clock time of one complete image, from the volume in memory to linear pixel values; \
         reading the file and writing the image are not in it. The times by phase stand in the table."
                .to_owned(),
        ),
        (
            "What was measured, and where",
            format!(
                "Data: {}; density: {}; view: {}; image: {}; kernel: {}; a pixel is: {} ({}). \
             Machine: {}; threads: {}; program {} at commit {commits}.{}",
                m.dataset,
                m.density,
                m.view,
                run.size,
                m.kernel.name(),
                m.estimand,
                m.estimand.unit(),
                m.machine,
                m.threads,
                env!("CARGO_PKG_VERSION"),
                if has_series {
                    " Sample counts that are measured only for the image series stand in the tables, not in plots and fits."
                } else {
                    ""
                }
            ),
        ),
    ];
    for (heading, text) in parts {
        blocks.extend([Block::Subheading(heading.into()), Block::Text(text)]);
    }
    blocks.push(Block::Text("The command that repeats it:".into()));
    blocks.push(Block::Code(m.command.clone()));
    blocks.push(Block::Heading("Data".into()));
    let present = |files: &[(&str, &str)]| -> Vec<(String, String)> {
        let there = files.iter().filter(|(name, _)| run.folder.join(name).exists());
        there.map(|(n, w)| ((*n).to_owned(), (*w).to_owned())).collect()
    };
    blocks.push(Block::Downloads(present(&[
        ("records.csv", "every measured image, one row each; units in the column names"),
        ("summary.json", "what the tables of this page show"),
    ])));
    blocks.push(Block::Text("Beside this page, while it lies in the folder of the run:".into()));
    blocks.push(Block::Files(present(&[
        ("records.jsonl", "every measured image with all counters, appended while measuring"),
        ("summary.csv", "errors, biases, times and ratios by method and sample count"),
        ("run.json", "what this folder measures"),
        ("truth.npy", "the truth's linear pixel values, NumPy"),
        ("truth.png", "the truth under its tone"),
        (plot::ERROR_VS_TIME, "error against time"),
        (plot::ERROR_VS_SAMPLES, "error against samples"),
        (plot::TIME_VS_SAMPLES, "time against samples"),
    ])));
}
