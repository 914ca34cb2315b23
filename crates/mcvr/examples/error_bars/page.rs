//! The page, from the records alone.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use mcvr::volume::write_whole;

use crate::curve::Curve;
use crate::records::{Keyed, Records};
use crate::statistics::{Figure, sidak, two_sided};
use crate::strata::STRATA;
use crate::tally::{Coverage, ENOUGH};
use crate::{Outcome, coverage, seeds, stopping};

/// Range that the coverage of 95 % intervals is to lie in.
const ASKED: [f64; 2] = [0.936, 0.964];
/// Probability of a false alarm in a table of tests.
const FAMILY: f64 = 0.01;

pub fn write(out: &Path) -> Outcome<()> {
    let mut page = String::from(INTRODUCTION);
    if let Some(records) = Records::read(out, coverage::PART)? {
        coverage_part(&mut page, &records)?;
    }
    if let Some(records) = Records::read(out, stopping::PART)? {
        stopping_part(&mut page, &records)?;
    }
    if let Some(records) = Records::read(out, seeds::PART)? {
        seeds_part(&mut page, &records)?;
    }
    // What people read from the tables; no program writes it.
    if let Ok(notes) = std::fs::read_to_string(out.join("notes.md")) {
        page += &notes;
    }
    Ok(write_whole(&out.join("README.md"), |f| f.write_all(page.as_bytes()))?)
}

fn circumstances<R>(page: &mut String, records: &Records<R>) -> Outcome<()> {
    let quick = if records.quick { ", **quick run: not for quoting**" } else { "" };
    let commit = records.commit.as_deref().unwrap_or("unknown");
    Ok(writeln!(page, "Measured on {}, {} threads, source {commit}{quick}.\n", records.machine, records.threads)?)
}

fn percent(f: Figure) -> String {
    format!("{:.2} ± {:.2}", 100.0 * f.value, 100.0 * f.error)
}

fn share(f: Figure) -> String {
    let good = (ASKED[0]..=ASKED[1]).contains(&f.value);
    if good { percent(f) } else { format!("**{}**", percent(f)) }
}

fn maybe(f: Option<Figure>) -> String {
    f.map_or("-".into(), percent)
}

/// Four digits, or a whole number.
fn count(v: f64) -> String {
    match v {
        v if v < 100.0 => format!("{v:.1}"),
        v if v < 1e5 => format!("{v:.0}"),
        v => format!("{:.3} million", v / 1e6),
    }
}

fn head(page: &mut String, cells: &[&str]) -> Outcome<()> {
    Ok(writeln!(page, "| {} |\n|{}", cells.join(" | "), "---|".repeat(cells.len()))?)
}

fn coverage_part(page: &mut String, records: &Records<coverage::Row>) -> Outcome<()> {
    writeln!(page, "{COVERAGE}")?;
    circumstances(page, records)?;
    head(page, &["setting", "samples a pixel of dark: least, median", "dark %", "bright %", "edge %", "all %"])?;
    for Keyed { row, .. } in &records.rows {
        let of = |stratum: &str| coverage::of(row, stratum).map_or("-".into(), |c| share(c.share));
        let least = coverage::of(row, "dark").map_or([f64::NAN; 2], |c| c.expected);
        let cells = STRATA.map(of).join(" | ");
        writeln!(page, "| {} | {}, {} | {cells} |", setting(row), count(least[0]), count(least[1]))?;
    }
    let outside: Vec<&Coverage> = records.rows.iter().flat_map(|r| &r.row.strata).filter(|c| !inside(c)).collect();
    let strata: usize = records.rows.iter().map(|r| r.row.strata.len()).sum();
    writeln!(page, "\n{} of {strata} strata lie outside of 93.6 to 96.4 % (bold).\n", outside.len())?;
    writeln!(page, "{WIDTHS}")?;
    let names = ["setting", "dark", "bright", "edge", "all", "estimated over actual squared error", "RMSE"];
    head(page, &names)?;
    for Keyed { row, .. } in &records.rows {
        let of = |s: &str| {
            coverage::of(row, s).map_or("-".into(), |c| {
                let cell = |v: Option<f64>, digits: usize| v.map_or("-".into(), |v| format!("{v:.digits$}"));
                format!("{}; {}", cell(c.width, 2), cell(c.variance, 3))
            })
        };
        let squares = row.squares.map_or("-".into(), |f| format!("{:.4} ± {:.4}", f.value, f.error));
        let cells = STRATA.map(of).join(" | ");
        writeln!(page, "| {} | {cells} | {squares} | {:.2} % |", setting(row), 100.0 * row.error)?;
    }
    unbiased(page, records)?;
    by_samples(page, records)?;
    writeln!(
        page,
        "### Slope\n\nRelative RMSE over samples, least squares of the logarithms, at every doubling from the first look.\n"
    )?;
    head(page, &["setting", "slope", "samples: relative RMSE in %"])?;
    for Keyed { row, .. } in &records.rows {
        let Some(Curve { levels, slope: Some(slope), seeds }) = &row.curve else { continue };
        let cells: Vec<String> =
            levels.iter().map(|l| format!("2^{:.0}: {:.2}", (l.samples as f64).log2(), 100.0 * l.error)).collect();
        let named = setting(row);
        writeln!(page, "| {named}, {seeds} seeds | {:.4} ± {:.4} | {} |", slope.value, slope.error, cells.join(", "))?;
    }
    Ok(writeln!(page)?)
}

fn inside(c: &Coverage) -> bool {
    (ASKED[0]..=ASKED[1]).contains(&c.share.value)
}

fn setting(row: &coverage::Row) -> String {
    let samples = (row.samples as f64).log2();
    format!("{}, {}, {}, R {}, 2^{samples}, {}°", row.scene, row.method, row.estimand, row.replicates, row.fov)
}

fn unbiased(page: &mut String, records: &Records<coverage::Row>) -> Outcome<()> {
    let tests = records.rows.len() * STRATA.len();
    let level = sidak(FAMILY, tests.max(1));
    writeln!(
        page,
        "\n### Unbiased\n\nMean of (image - truth) over the mean truth of each stratum, in parts per million, over the repeats, and its z (the truth's own error included). With {tests} tests a \
         |z| beyond p = {level:.1e} (Šidák, {FAMILY} for the whole table) would be a bias; those are bold. Last column: the largest |z| of any single \
         pixel with at least {} samples in all repeats, and its p times the number of such pixels.\n",
        ENOUGH
    )?;
    head(page, &["setting", "dark", "bright", "edge", "all", "worst pixel", "truth's own error / RMSE of an image"])?;
    for Keyed { row, .. } in &records.rows {
        let cell = |stratum: &str| {
            let Some(bias) = coverage::of(row, stratum).map(|c| c.bias) else { return "-".into() };
            let z = bias.value / bias.error;
            let text = format!("{:.0} ± {:.0}, z {z:.1}", 1e6 * bias.value, 1e6 * bias.error);
            if two_sided(z) < level { format!("**{text}**") } else { text }
        };
        let (z, pixels) = row.worst;
        let p = (two_sided(z) * pixels as f64).min(1.0);
        let cells = STRATA.map(cell).join(" | ");
        writeln!(page, "| {} | {cells} | z {z:.2}, {p:.2} | {:.1e} |", setting(row), row.truth_error / row.error)?;
    }
    Ok(writeln!(page)?)
}

fn by_samples(page: &mut String, records: &Records<coverage::Row>) -> Outcome<()> {
    writeln!(page, "{BY_SAMPLES}")?;
    head(
        page,
        &["setting", "samples", "pixels", "no sample %", "bound holds %", "interval holds %", "both together %"],
    )?;
    let sparse = |row: &coverage::Row| row.by_samples.iter().any(|c| c.expected[0] < 1.0);
    for Keyed { row, .. } in records.rows.iter().filter(|r| sparse(&r.row)) {
        for c in &row.by_samples {
            writeln!(
                page,
                "| {} | {} | {} | {:.2} | {} | {} | {} |",
                setting(row),
                c.name,
                c.pixels,
                100.0 * c.unresolved,
                maybe(c.bound),
                maybe(c.interval),
                share(c.share)
            )?;
        }
    }
    Ok(writeln!(page)?)
}

fn asked(row: &stopping::Row) -> String {
    let of = row.share.map_or(String::new(), |s| format!(" of {:.0} % of the pixels", 100.0 * s));
    format!("{}, {}, {2}×{2}: {3} %{of}", row.scene, row.method, row.side, 100.0 * row.target)
}

fn met(rule: &stopping::Rule, confidence: f64) -> String {
    let [low, high] = rule.met.interval.map(|v| 100.0 * v);
    let text = format!("{:.1} ({low:.1} to {high:.1})", 100.0 * rule.met.value);
    if rule.met.value < confidence { format!("**{text}**") } else { text }
}

fn stopping_part(page: &mut String, records: &Records<stopping::Row>) -> Outcome<()> {
    writeln!(page, "{STOPPING}")?;
    circumstances(page, records)?;
    let columns = [
        "asked",
        "confidence",
        "met % (95 % interval)",
        "mean samples",
        "just enough",
        "overshoot",
        "looks",
        "bound / actual",
        "actual / target: mean, worst",
        "naive: met %",
        "naive: overshoot",
    ];
    head(page, &columns)?;
    for Keyed { row, .. } in &records.rows {
        let overshoot = |rule: &stopping::Rule| rule.overshoot.map_or("-".into(), |o| format!("{o:.2}"));
        let [mean, worst] = row.rule.achieved;
        writeln!(
            page,
            "| {} | {:.0} % | {} | {} | {} | {} | {:.2} | {:.3} ± {:.3} | {mean:.3}, {worst:.3} | {} | {} |",
            asked(row),
            100.0 * row.confidence,
            met(&row.rule, row.confidence),
            count(row.rule.samples.value),
            row.enough.map_or("-".into(), count),
            overshoot(&row.rule),
            row.rule.looks,
            row.bound.value,
            row.bound.error,
            met(&row.naive, row.confidence),
            overshoot(&row.naive),
        )?;
    }
    Ok(writeln!(page)?)
}

fn seeds_part(page: &mut String, records: &Records<seeds::Row>) -> Outcome<()> {
    writeln!(page, "{SEEDS}")?;
    circumstances(page, records)?;
    let columns = [
        "asked",
        "seeds that met it",
        "mean samples",
        "seconds: median, least, most",
        "actual %: mean, worst",
        "bound / actual",
        "looks",
        "truth's own error %",
    ];
    head(page, &columns)?;
    for Keyed { row, .. } in &records.rows {
        let [median, least, most] = row.seconds;
        let [mean, worst] = row.achieved.map(|e| 100.0 * e);
        writeln!(
            page,
            "| {}, {}, {2}×{2}: {3} % | {4:.0} of {5} | {6} | {median:.3}, {least:.3}, {most:.3} | {mean:.3}, {worst:.3} | {7:.3} | {8:.1} | {9:.4} |",
            row.scene,
            row.method,
            row.side,
            100.0 * row.target,
            row.met.value * row.seeds as f64,
            row.seeds,
            count(row.samples.value),
            row.bound.value,
            row.looks,
            100.0 * row.truth_error,
        )?;
    }
    Ok(writeln!(page)?)
}

const INTRODUCTION: &str = "# Error bars and the stopping rule, measured

Whole repeats - another seed, another image, nothing shared - against exact ray casting of the same image. Made by

    cargo run --release -p mcvr --example error_bars -- --out DIR --data DATA_DIR

(`--only coverage`, `stopping` or `seeds` for one part, `--resume` to go on; all records are in the `.json` files beside.)
Scenes: `phantom` is `phantom:lobster@64`, which anyone can make; `lobster` is the CT scan, voxels of 1 × 1 × 1.4 mm. View 30,60,
18 degrees wide unless stated, estimand `line` unless stated, kernel `tent`. ± is one standard error over the repeats: the pixels of one image are correlated, repeats are not.
Errors are over the mean pixel of the truth.

";

const COVERAGE: &str = "## Coverage of the 95 % intervals

The share of pixels' intervals that hold the truth, in %. Strata, of the pixels whose truth is not 0: **dark** the lowest third, **bright** the highest third,
**edge** the tenth with the steepest gradient (central differences), **all**. A pixel without a sample has a bound, which counts as its interval. Images of 48×48 pixels;
8 degrees and 2^18 samples are the setting where every pixel gets enough, 18 degrees and 2^15 the sparse one with slivers at the border of the
volume, reported as found. R is the number of replicates.
The truth is asked for 1e-4 of the mean pixel; how far its own error lies below that of an image is in the table *Unbiased*.
";

const WIDTHS: &str = "Mean width of the intervals in units of the true standard error (the standard deviation of the pixel over the repeats), and mean squared
standard error over the true variance, averaged over the pixels that got at least 1000 samples in all repeats. With R - 1 = 7 degrees of freedom Student's interval is 4.56 wide on average, with 15 it is 4.19. The last columns: mean of the images' own
estimates of their squared relative RMSE over the mean of what it really is, which should be 1, and that RMSE.
";

const BY_SAMPLES: &str = "### By the number of samples that a pixel expects

The sparse settings; the others are in `coverage.json`. Expected numbers are from the exact `count` image. Pixels without a sample: their share, and how often their bound (Clopper and Pearson) holds. Where few samples
are expected, the intervals of the others hold less often than these columns together: a pixel is only resolved if it got more than it expects.
";

const STOPPING: &str = "## Stopping at an error

Each repeat stops by itself. **Met**: share of the repeats whose actual error is at most the target; bold where it is below the confidence that was asked for.
**Just enough**: the number of samples at which the error (root mean square over other seeds, at every doubling of the samples) equals the target, by a power law through the two
doublings around it; half of the images miss the target there. **Overshoot**: mean samples over those. **Naive**: stopping at the first of the same
looks whose estimate, instead of its bound, is at most the target.
";

const SEEDS: &str = "## Seeds: one image to an error

100 seeds, one after the other on all threads, the whole lobster in view; seconds of a whole image with its distribution, without loading the scan.
";
