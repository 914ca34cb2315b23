//! What a report says: blocks of content, which [`html`](crate::html) and [`markdown`](crate::markdown) lay out.

use crate::fit::{CONFIDENCE, FLOOR_FACTOR, SlopeFit};
use crate::format::{self, percent, samples, seconds, short_samples, significant, slope};
use crate::{MethodSummary, Ratio, Row, RunSummary, Spread, cost, plot};

/// Sample count and time of a complete X-ray image in the report by Law and Blythe, as printed there.
const REPORT_COMPLETE: (u64, f64) = (1_000_000, 1.192);

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
    Pictures(Vec<(String, String)>),
    /// (file name, what is in it).
    Files(Vec<(String, String)>),
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
    let (first, gain) = answer(run);
    let mut blocks = vec![Block::Lead(format!("{first} {gain}"))];
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

/// The sample count of the headline: the report's million if the first method has it, else the largest that most
/// methods share.
fn headline(run: &RunSummary) -> Option<u64> {
    let first = &run.methods.first()?.name;
    let sharing = |m: u64| run.rows.iter().filter(|r| r.samples == m).count();
    let mine = || run.rows.iter().filter(|r| r.method == *first).map(|r| r.samples);
    let most = mine().map(sharing).max()?;
    mine().find(|&m| m == REPORT_COMPLETE.0 && sharing(m) == most).or(mine().filter(|&m| sharing(m) == most).max())
}

/// The answer in two sentences: where the first method stands, and what the best of the others gains.
fn answer(run: &RunSummary) -> (String, String) {
    let found = headline(run).and_then(|m| {
        let rows: Vec<&Row> = run.rows.iter().filter(|r| r.samples == m).collect();
        let first = rows.iter().find(|r| Some(&r.method) == run.methods.first().map(|m| &m.name)).copied()?;
        Some((rows, first))
    });
    let Some((rows, first)) = found else {
        return ("Nothing was measured yet.".into(), "There is nothing to compare.".into());
    };
    let method = |row: &Row| run.methods.iter().find(|m| m.name == row.method);
    let label = |row: &Row| method(row).map_or(row.method.clone(), |m| m.label.clone());
    let unit = method(first).map_or("samples", |m| m.budget_unit.as_str());
    let opening = format!(
        "At {} {unit}, {} differs from the ray-cast truth by {} of the mean pixel (RMSE) and takes {}.",
        samples(first.samples),
        label(first),
        percent(first.error),
        seconds(first.complete.median)
    );
    let same_unit = |r: &Row| method(r).map(|m| &m.budget_unit) == method(first).map(|m| &m.budget_unit);
    let gains =
        rows.iter().filter(|r| r.method != first.method && same_unit(r)).filter_map(|r| Some((*r, r.efficiency?)));
    let best = gains.max_by(|a, b| a.1.value.total_cmp(&b.1.value));
    let gain = match best {
        None => "No other method was measured there.".to_owned(),
        Some((row, gain)) => format!(
            "{}: {} in {}, {} times the efficiency (1 / (error² · time)).",
            label(row),
            percent(row.error),
            seconds(row.complete.median),
            ratio(Some(gain))
        ),
    };
    // Methods with another budget share no M with the first: the quickest image of theirs stands for them.
    let other =
        run.rows.iter().filter(|r| !same_unit(r)).min_by(|a, b| a.complete.median.total_cmp(&b.complete.median));
    let gain = match other {
        None => gain,
        Some(row) => format!(
            "{gain} {}: {} in {} at its quickest.",
            label(row),
            percent(row.error),
            seconds(row.complete.median)
        ),
    };
    (opening, gain)
}

fn headline_table(run: &RunSummary, m: u64) -> Block {
    let rows = run.rows.iter().filter(|r| r.samples == m);
    Block::Table {
        head: strings(&[&format!("At M = {}", samples(m)), "Error", "Time", "Efficiency", "Slope"]),
        names: 1,
        rows: rows
            .map(|r| {
                let method = run.methods.iter().find(|m| m.name == r.method);
                vec![
                    method.map_or(r.method.clone(), |m| m.label.clone()),
                    with_error(r),
                    seconds(r.complete.median),
                    ratio(r.efficiency),
                    method.and_then(|m| m.fit).map_or(dash(), |f| slope(f.slope)),
                ]
            })
            .collect(),
    }
}

fn error_notes(run: &RunSummary) -> String {
    let first = run.methods.first().map_or("the first method", |m| m.label.as_str());
    format!(
        "RMSE over the truth's mean pixel: the root mean square over the replicates ± its standard error, and in brackets \
         the ratio to {first} at the same M. † marks errors below {FLOOR_FACTOR} times the truth's own ({}), where the \
         truth itself starts to matter; they are in no plot or fit. Efficiency is 1 / (error² · time), relative to {first}.",
        percent(run.truth.rel_error_estimate)
    )
}

fn error_table(run: &RunSummary) -> Block {
    let mut head = vec!["M".to_owned()];
    head.extend(run.methods.iter().map(|m| m.label.clone()));
    let floor = FLOOR_FACTOR * run.truth.rel_error_estimate;
    let cell = |m: u64, method: &MethodSummary| {
        let row = run.rows.iter().find(|r| r.samples == m && r.method == method.name);
        row.map_or(dash(), |r| {
            let mark = if r.error < floor { " †" } else { "" };
            let of_first = r.error_ratio.filter(|_| run.methods.first() != Some(method));
            let of_first = of_first.map_or(String::new(), |q| format!(" ({}×)", significant(q.value, 3)));
            format!("{}{mark}{of_first}", with_error(r))
        })
    };
    let rows = counts(run).into_iter().map(|m| {
        let mut row = vec![samples(m)];
        row.extend(run.methods.iter().map(|method| cell(m, method)));
        row
    });
    Block::Table { head, names: 0, rows: rows.collect() }
}

fn bias_text(run: &RunSummary) -> String {
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

fn slope_table(run: &RunSummary) -> Block {
    let row = |m: &MethodSummary| {
        let fit = m.fit.as_ref();
        vec![
            m.label.clone(),
            m.expected_slope.map_or(dash(), slope),
            fit.map_or(dash(), interval),
            fit.map_or(dash(), |f| format!("{} to {}", short_samples(f.from), short_samples(f.to))),
            fit.map_or(dash(), |f| f.points.to_string()),
            m.tail_fit.as_ref().map_or(dash(), interval),
        ]
    };
    Block::Table {
        head: strings(&["Method", "Theory, large M", "Measured", "From M to M", "Points", "Upper half"]),
        names: 1,
        rows: run.methods.iter().map(row).collect(),
    }
}

fn time_table(run: &RunSummary) -> Block {
    let mut rows = Vec::new();
    let report = |rows: &mut Vec<Vec<String>>| {
        let (m, time) = REPORT_COMPLETE;
        let ns = significant(time * 1e9 / m as f64, 3);
        let row = [
            samples(m),
            "the report (Law, Blythe)".into(),
            dash(),
            dash(),
            dash(),
            format!("{time} s"),
            format!("{ns} ns"),
        ];
        rows.push(row.to_vec());
    };
    let mut pending = true;
    for m in counts(run) {
        if pending && m > REPORT_COMPLETE.0 {
            report(&mut rows);
            pending = false;
        }
        for r in run.rows.iter().filter(|r| r.samples == m) {
            let label = run.methods.iter().find(|m| m.name == r.method).map_or(&r.method, |m| &m.label);
            let phase = |s: Spread| if s.max > 0.0 { seconds(s.median) } else { dash() };
            rows.push(vec![
                samples(m),
                label.clone(),
                phase(r.distribution),
                phase(r.sampling),
                phase(r.projection),
                with_ends(r.complete),
                format!("{} ns", significant(r.ns_per_sample, 3)),
            ]);
        }
    }
    if pending {
        report(&mut rows);
    }
    let head = strings(&["M", "Method", "Distribution", "Sampling", "Rendering", "Complete", "Per sample"]);
    Block::Table { head, names: 2, rows }
}

fn picture_blocks(run: &RunSummary, blocks: &mut Vec<Block>) {
    blocks.push(Block::Heading("Images".into()));
    blocks.push(Block::Text(format!(
        "All images under the truth's tones (0th to 99.9th percentile). Differences are image minus truth: red too bright, \
         blue too dark, full colour at ±{}, twice the truth's mean pixel.",
        significant(run.difference_scale, 3)
    )));
    blocks.push(Block::Pictures(vec![("truth.png".into(), "Truth, ray cast".into())]));
    for method in &run.methods {
        let series: Vec<_> = run.series.iter().filter(|s| s.method == method.name).collect();
        if series.is_empty() {
            continue;
        }
        blocks.push(Block::Subheading(method.label.clone()));
        let caption = |s: &&crate::SeriesImage| {
            let error = s.rel_rmse.map_or(String::new(), |e| format!(", error {}", percent(e)));
            (s.image.clone(), format!("M = {}{error}", samples(s.samples)))
        };
        blocks.push(Block::Pictures(series.iter().map(caption).collect()));
        let caption =
            |s: &&crate::SeriesImage| (s.difference.clone(), format!("M = {}, difference", samples(s.samples)));
        blocks.push(Block::Pictures(series.iter().map(caption).collect()));
    }
}

fn method_blocks(run: &RunSummary, has_series: bool, blocks: &mut Vec<Block>) {
    let m = &run.meta;
    let commits = if run.commits.is_empty() { "unknown".to_owned() } else { run.commits.join(", ") };
    blocks.push(Block::Heading("How it was measured".into()));
    for text in [
        format!(
            "The truth is the same image by ray casting, integrated until its own error estimate is {} of the mean pixel; it \
             took {}. Errors are differences from it, pixel by pixel, before any tone.",
            percent(run.truth.rel_error_estimate),
            seconds(run.truth.seconds)
        ),
        format!(
            "Each figure rests on independent repetitions: {} Each replicate has a seed of its own, the same for all \
             methods (run seed {}). Methods take turns within each sample count and replicate, so that a change of the \
             machine's pace hits all alike; each makes one image that is not counted before the first that is.",
            plot::repetitions(run),
            run.seed
        ),
        format!(
            "Data: {}; density: {}; view: {}; image: {}; kernel: {}; a pixel is: {} ({}). Machine: {}; threads: {}; \
             program {} at commit {commits}.{}",
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
        "The command:".to_owned(),
    ] {
        blocks.push(Block::Text(text));
    }
    blocks.push(Block::Code(m.command.clone()));
    blocks.push(Block::Heading("Files".into()));
    let files = [
        ("records.csv", "every measured image, one row each; units in the column names"),
        ("records.jsonl", "the same with all counters, appended while measuring"),
        ("summary.csv", "errors, biases, times and ratios by method and sample count"),
        ("summary.json", "what the tables of this page show"),
        ("run.json", "what this folder measures"),
        ("truth.npy", "the truth's linear pixel values, NumPy"),
        ("truth.png", "the truth under its tone"),
        (plot::ERROR_VS_TIME, "error against time"),
        (plot::ERROR_VS_SAMPLES, "error against samples"),
        (plot::TIME_VS_SAMPLES, "time against samples"),
    ];
    let present = files.into_iter().filter(|(name, _)| run.folder.join(name).exists());
    blocks.push(Block::Files(present.map(|(n, w)| (n.to_owned(), w.to_owned())).collect()));
}

fn counts(run: &RunSummary) -> Vec<u64> {
    let mut counts: Vec<u64> = run.rows.iter().map(|r| r.samples).collect();
    counts.dedup();
    counts
}

fn with_error(row: &Row) -> String {
    match row.error_se {
        Some(se) => format!("{} %", format::with_error(100.0 * row.error, 100.0 * se)),
        None => percent(row.error),
    }
}

/// Median and, in brackets, the ends; the first end without its unit where both have the same.
pub(crate) fn with_ends(s: Spread) -> String {
    let (median, min, max) = (seconds(s.median), seconds(s.min), seconds(s.max));
    let unit = |text: &str| text.split_once(' ').map(|(_, unit)| unit.to_owned());
    let short = if unit(&min) == unit(&max) { min.split(' ').next().unwrap_or(&min) } else { &min };
    if min == max { median } else { format!("{median} ({short}–{max})") }
}

fn ratio(value: Option<Ratio>) -> String {
    value.map_or(dash(), |r| format::with_error(r.value, r.sd.unwrap_or(0.0)))
}

fn interval(fit: &SlopeFit) -> String {
    match fit.low.zip(fit.high) {
        Some((low, high)) => format!("{} [{}, {}]", slope(fit.slope), slope(low), slope(high)),
        None => slope(fit.slope),
    }
}

fn dash() -> String {
    "–".to_owned()
}

fn strings(list: &[&str]) -> Vec<String> {
    list.iter().map(|s| (*s).to_owned()).collect()
}
