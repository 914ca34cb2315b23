//! `mcvr bench`

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, bail};
use mcvr::bench::{self, Baseline, Check, HistoryRecord, Report, Stage, accuracy};
use mcvr::harness::history::machine_class;
use mcvr::scene::film;
use serde_json::json;

use super::bench_checks::{Checks, Measured};
use super::{Interrupted, outputs, progress};

/// Holds this program to the committed baseline: images, counters, instructions, ratios of times.
///
/// Accuracy and work counters must be identical bit for bit; instructions of each stage (by callgrind, where valgrind is
/// installed) may grow by 2 %; the times of a run's stages, relative to each other, by 25 %, all pairs agreeing in every
/// pass. Seconds are recorded, never judged.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr bench                             all checks, a minute or two\n  \
    mcvr bench --skip instructions         without callgrind: some seconds\n  \
    mcvr bench --only render/ qmc          stages and cases whose names contain a word\n  \
    mcvr bench --list                      what there is to measure\n  \
    mcvr bench --accept                    what is measured becomes the new baseline\n  \
    mcvr bench --record                    keep the figures under bench-results/history, for mcvr history\n  \
    mcvr bench --markdown -o bench.md      the tables for a pull request\n\n\
    scripts/bench-regress builds the release program first.\n\n\
    Exit status: 0 no regression, 1 a regression, or nothing could be judged.")]
pub struct Args {
    /// Only stages and accuracy cases whose names contain one of these words
    #[arg(long, value_name = "WORD", num_args = 1..)]
    only: Vec<String>,
    /// Leave checks out: accuracy, instructions, time
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = skippable)]
    skip: Vec<Check>,
    /// Folder of the baseline
    #[arg(long, value_name = "DIR", default_value = "bench-results/baseline")]
    baseline: PathBuf,
    /// Make what is measured the new baseline (of --only: of these stages)
    #[arg(long)]
    accept: bool,
    /// Keep the figures for `mcvr history`
    #[arg(long, value_name = "DIR", num_args = 0..=1, default_missing_value = "bench-results/history")]
    record: Option<PathBuf>,
    /// Name the stages and cases without running them
    #[arg(long)]
    list: bool,
    /// Show every line, not only what moved
    #[arg(long)]
    all: bool,
    /// Print the report as Markdown
    #[arg(long, conflicts_with_all = ["json", "list"])]
    markdown: bool,
    /// Print the report as JSON
    #[arg(long, conflicts_with = "list")]
    json: bool,
    /// Write the report to a file instead
    #[arg(long = "output", short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Run one stage once, for callgrind
    #[arg(long, value_name = "STAGE", hide = true)]
    once: Option<String>,
}

fn skippable(text: &str) -> Result<Check, String> {
    match text.parse() {
        Ok(check @ (Check::Accuracy | Check::Instructions | Check::Time)) => Ok(check),
        _ => Err(format!(
            "'{text}' is no check that can be skipped; accuracy (work counters with it), instructions or time"
        )),
    }
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    if let Some(stage) = &args.once {
        return once(stage);
    }
    outputs::check(&args.out, &[])?;
    let wanted = |name: &str| args.only.is_empty() || args.only.iter().any(|w| name.contains(w.as_str()));
    let stages: Vec<Stage> = bench::stages()?.into_iter().filter(|s| wanted(&s.name)).collect();
    let mut cases: Vec<accuracy::Case> = accuracy::cases()?.into_iter().filter(|c| wanted(&c.name)).collect();
    if args.skip.contains(&Check::Accuracy) {
        cases.clear();
    }
    if args.list {
        return list(args, &stages, &cases);
    }
    let stages =
        if args.skip.contains(&Check::Instructions) && args.skip.contains(&Check::Time) { vec![] } else { stages };
    if stages.is_empty() && cases.is_empty() {
        bail!("nothing left to measure; `mcvr bench --list` names all stages and cases");
    }
    let start = Instant::now();
    let cancel = progress::interrupt_flag();
    let checks = Checks {
        baseline: Baseline::at(&args.baseline),
        whole: args.only.is_empty(),
        accept: args.accept,
        cancel: &cancel,
        quiet,
    };
    let mut measured = Measured::default();
    let mut report = Report { sections: vec![], seconds: 0.0 };
    let outcome = measure(args, &checks, &stages, cases, &mut measured, &mut report);
    report.seconds = start.elapsed().as_secs_f64();
    if let Err(e) = outcome {
        let stopped = cancel.load(Ordering::Relaxed) || e.downcast_ref().is_some_and(bench::BenchError::is_cancelled);
        if !stopped {
            return Err(e);
        }
        put(args, &report)?;
        return Err(anyhow::Error::new(Interrupted));
    }
    if let Some(folder) = &args.record {
        let record = HistoryRecord::new(
            measured.accuracy.as_ref(),
            &measured.instructions,
            &measured.seconds(),
            &measured.elements,
        );
        let path = folder.join(record.file_name());
        Baseline::write(&path, &record)?;
        if !quiet {
            say!("recorded in {}", path.display());
        }
    }
    if args.accept {
        checks.accept(&measured)?;
        put(args, &report)?;
        if !quiet {
            say!("accepted as the baseline in {}; commit it with the change that moved it", args.baseline.display());
        }
        return Ok(());
    }
    put(args, &report)?;
    match report.failures() {
        0 if report.is_judged() => Ok(()),
        0 => bail!("nothing was judged: see the notes"),
        n => bail!(
            "{n} regressions; if the change is meant, `mcvr bench --accept` makes a new baseline: commit it, and say why in CHANGELOG.md"
        ),
    }
}

/// The checks from the cheapest to the longest; what is finished stays in the report when a later one is stopped.
fn measure(
    args: &Args,
    checks: &Checks<'_>,
    stages: &[Stage],
    cases: Vec<accuracy::Case>,
    measured: &mut Measured,
    report: &mut Report,
) -> anyhow::Result<()> {
    if !cases.is_empty() {
        report.sections.extend(checks.accuracy(cases, measured)?);
    }
    let skipped = |check: Check| stages.is_empty() || args.skip.contains(&check);
    if !skipped(Check::Time) {
        report.sections.push(checks.time(stages, measured)?);
    }
    if !skipped(Check::Instructions) {
        let section = checks.instructions(stages, measured)?;
        let at = report.sections.len() - usize::from(!skipped(Check::Time));
        report.sections.insert(at, section);
    }
    Ok(())
}

/// One run of a stage on this thread's pool, and which vector instructions there are.
fn once(name: &str) -> anyhow::Result<()> {
    let stages = bench::stages()?;
    let stage = stages.iter().find(|s| s.name == name).ok_or_else(|| bench::BenchError::Stage(name.to_owned()))?;
    let mut prepared = stage.prepare()?;
    let sum = bench::on_one_thread(|| prepared.run())??;
    let simd = mcvr::sampling::SimdLevel::detect();
    writeln!(
        outputs::stdout(),
        "{}",
        json!({ "sum": sum, "elements": prepared.elements, "simd": format!("{simd:?}") })
    )?;
    Ok(())
}

fn list(args: &Args, stages: &[Stage], cases: &[accuracy::Case]) -> anyhow::Result<()> {
    let mut text = String::new();
    for stage in stages {
        text += &format!("stage     {:28} per {}\n", stage.name, stage.unit);
    }
    for case in cases {
        text += &format!("accuracy  {}\n", case.name);
    }
    write(args, &text)
}

fn put(args: &Args, report: &Report) -> anyhow::Result<()> {
    let text = if args.json {
        let record = json!({
            "version": env!("CARGO_PKG_VERSION"), "commit": mcvr::harness::git_commit(), "compiler": bench::COMPILER,
            "machine": machine_class(&mcvr::harness::machine()), "verdict": report.verdict(),
            "failures": report.failures(), "report": report,
        });
        serde_json::to_string_pretty(&record)? + "\n"
    } else if args.markdown {
        let commit = mcvr::harness::git_commit().unwrap_or_else(|| "unknown".to_owned());
        let heading = format!("`mcvr bench`, commit {commit}, {}, {}.", mcvr::harness::machine(), bench::COMPILER);
        report.markdown(&heading, args.all)
    } else {
        report.text(args.all)
    };
    write(args, &text)
}

fn write(args: &Args, text: &str) -> anyhow::Result<()> {
    match &args.out {
        None => Ok(outputs::stdout().write_all(text.as_bytes())?),
        Some(path) => film::write_whole(path, |out| out.write_all(text.as_bytes()))
            .with_context(|| Path::new(path).display().to_string()),
    }
}

/// True once Ctrl-C was pressed.
pub(super) fn stopped(cancel: &AtomicBool) -> bool {
    cancel.load(Ordering::Relaxed)
}

/// Values by name, an older map's where the newer has none.
pub(super) fn merged<T: Clone>(
    older: BTreeMap<String, T>,
    newer: &BTreeMap<String, T>,
    whole: bool,
) -> BTreeMap<String, T> {
    let mut all = if whole { BTreeMap::new() } else { older };
    all.extend(newer.iter().map(|(name, value)| (name.clone(), value.clone())));
    all
}
