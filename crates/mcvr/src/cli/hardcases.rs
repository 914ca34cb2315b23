//! `mcvr hardcases`

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context as _, bail};
use mcvr::hardcases::{self, Case, Context, Cost, Group, Outcome, Verdict, figure};
use mcvr::scene::film;
use serde_json::{Value, json};

use super::{Interrupted, outputs, progress};

/// Poses the hard cases and prints what was measured beside its bound.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr hardcases                        the default set, under a minute\n  \
    mcvr hardcases --all                  large cases too: two minutes, sparse files of up to 8 GiB\n  \
    mcvr hardcases --group geometry       one group\n  \
    mcvr hardcases eye tiny-weights       cases whose names contain a word\n  \
    mcvr hardcases --markdown -o hardcases.md\n\n\
    Exit status: 0 all passed (or skipped, with a reason), 1 a case failed.")]
pub struct Args {
    /// Only cases whose names contain one of these words
    #[arg(value_name = "WORD")]
    words: Vec<String>,
    /// Only these groups: distributions, sequences, geometry, effects, scale, measures, files, running
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    group: Vec<Group>,
    /// Large cases too
    #[arg(long)]
    all: bool,
    /// Name the cases without running them
    #[arg(long)]
    list: bool,
    /// Print the table as Markdown
    #[arg(long, conflicts_with_all = ["json", "list"])]
    markdown: bool,
    /// Print the table as JSON
    #[arg(long, conflicts_with = "list")]
    json: bool,
    /// Write the table to a file instead
    #[arg(long = "output", short, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    outputs::check(&args.out, &[])?;
    let chosen = |c: &&Case| {
        (args.group.is_empty() || args.group.contains(&c.group))
            && (args.words.is_empty() || args.words.iter().any(|w| c.name.contains(w.as_str())))
    };
    let cases: Vec<&Case> = hardcases::catalogue().filter(chosen).collect();
    let wanted = |c: &&&Case| args.all || args.list || c.cost == Cost::Quick;
    let run: Vec<&Case> = cases.iter().filter(wanted).copied().collect();
    if run.is_empty() {
        bail!(
            "no case matches{}; `mcvr hardcases --list` names all",
            if cases.is_empty() { "" } else { " in the default set (--all adds the large ones)" }
        );
    }
    if args.list {
        return put(args, &list(&run));
    }
    let outcomes = pose(&run, quiet || args.out.is_none() && !args.markdown && !args.json)?;
    let left_out = cases.len() - run.len();
    let text = if args.json {
        let mut text = serde_json::to_string_pretty(&record(&outcomes, left_out))?;
        text.push('\n');
        text
    } else if args.markdown {
        markdown(&outcomes, left_out)
    } else {
        plain(&outcomes, left_out)
    };
    put(args, &text)?;
    match outcomes.iter().filter(|(_, o)| o.verdict == Verdict::Fail).count() {
        0 => Ok(()),
        n => bail!("{n} of {} cases failed", outcomes.len()),
    }
}

type Posed<'a> = (&'a Case, Outcome);

/// Runs the cases one after another; Ctrl-C ends after the case in progress, and the rest counts as not asked for.
fn pose<'a>(cases: &[&'a Case], quiet: bool) -> anyhow::Result<Vec<Posed<'a>>> {
    let cancel = progress::interrupt_flag();
    let context = Context::new(std::env::current_exe().ok()).context("a temporary folder")?;
    // A case that panics is reported in the table, by its message.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let bar = progress::bar(cases.len() as u64, quiet);
    let mut outcomes = Vec::with_capacity(cases.len());
    for case in cases {
        if cancel.load(std::sync::atomic::Ordering::Relaxed) {
            break;
        }
        bar.set_message(case.name);
        outcomes.push((*case, case.run(&context)));
        bar.inc(1);
    }
    bar.finish_and_clear();
    std::panic::set_hook(hook);
    if outcomes.len() < cases.len() {
        write!(outputs::stdout(), "{}", plain(&outcomes, 0))?;
        return Err(anyhow::Error::new(Interrupted));
    }
    Ok(outcomes)
}

fn put(args: &Args, text: &str) -> anyhow::Result<()> {
    match &args.out {
        None => Ok(outputs::stdout().write_all(text.as_bytes())?),
        Some(path) => Ok(film::write_whole(path, |out| out.write_all(text.as_bytes()))?),
    }
}

fn list(cases: &[&Case]) -> String {
    let line = |c: &&Case| {
        let large = if c.cost == Cost::Large { " (--all)" } else { "" };
        format!("{:14} {}{large}\n", c.group.name(), c.name)
    };
    cases.iter().map(line).collect()
}

/// What there is in place of a figure, or the figure with its bound.
fn measured(outcome: &Outcome) -> [String; 2] {
    match (&outcome.finding, &outcome.error) {
        (Some(f), _) => [format!("{} {}", figure(f.measured), f.unit), f.bound.to_string()],
        (None, Some(e)) => [e.clone(), String::new()],
        (None, None) => Default::default(),
    }
}

fn word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Pass => "pass",
        Verdict::Fail => "FAIL",
        Verdict::Skip => "skip",
    }
}

fn counts(outcomes: &[Posed<'_>], left_out: usize) -> String {
    let count = |v| outcomes.iter().filter(|(_, o)| o.verdict == v).count();
    let seconds: f64 = outcomes.iter().map(|(_, o)| o.seconds).sum();
    let mut text = format!("{} cases, {} passed", outcomes.len(), count(Verdict::Pass));
    for (verdict, name) in [(Verdict::Fail, "failed"), (Verdict::Skip, "skipped")] {
        match count(verdict) {
            0 => {}
            n => text += &format!(", {n} {name}"),
        }
    }
    text += &format!(", {seconds:.0} s");
    if left_out > 0 {
        text += &format!(" ({left_out} large cases left out; --all runs them)");
    }
    text
}

fn plain(outcomes: &[Posed<'_>], left_out: usize) -> String {
    let mut text = String::new();
    for group in Group::ALL {
        let mut cases = outcomes.iter().filter(|(c, _)| c.group == group).peekable();
        if cases.peek().is_some() {
            text += &format!("\n{}\n", title(group));
        }
        for (case, outcome) in cases {
            let [figure, bound] = measured(outcome);
            let bound = if bound.is_empty() { bound } else { format!(" [{bound}]") };
            text += &format!("  {} {}: {figure}{bound}, {:.2} s\n", word(outcome.verdict), case.name, outcome.seconds);
            text += &format!("       breaks:  {}\n       asserts: {}\n", case.breaks, case.asserts);
            if let Some(f) = outcome.finding.as_ref().filter(|f| !f.detail.is_empty()) {
                text += &format!("       {}\n", f.detail);
            }
        }
    }
    text + &format!("\n{}\n", counts(outcomes, left_out))
}

fn title(group: Group) -> String {
    let name = group.name();
    name[..1].to_uppercase() + &name[1..]
}

fn markdown(outcomes: &[Posed<'_>], left_out: usize) -> String {
    let cell = |s: &str| s.replace('|', "\\|").replace(['\n', '\r'], " ");
    let mut text = format!(
        "# Hard cases\n\nMade by `mcvr hardcases --markdown`, version {}, commit {}, {}.\n\n{}.\n",
        env!("CARGO_PKG_VERSION"),
        mcvr::harness::git_commit().unwrap_or_else(|| "unknown".to_owned()),
        mcvr::harness::machine(),
        counts(outcomes, left_out)
    );
    for group in Group::ALL {
        let mut cases = outcomes.iter().filter(|(c, _)| c.group == group).peekable();
        if cases.peek().is_some() {
            text += &format!(
                "\n## {}\n\n| case | what usually breaks | what is asserted | measured | bound | verdict |\n",
                title(group)
            );
            text += "|---|---|---|---|---|---|\n";
        }
        for (case, outcome) in cases {
            let [figure, bound] = measured(outcome);
            let detail = outcome.finding.as_ref().map_or("", |f| f.detail.as_str());
            let figure = if detail.is_empty() { figure } else { format!("{figure} ({detail})") };
            let cells = [case.name, case.breaks, case.asserts, &figure, &bound, word(outcome.verdict)].map(cell);
            text += &format!("| {} |\n", cells.join(" | "));
        }
    }
    text
}

fn record(outcomes: &[Posed<'_>], left_out: usize) -> Value {
    let cases: Vec<Value> =
        outcomes.iter().map(|(case, outcome)| json!({ "case": case, "outcome": outcome })).collect();
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "commit": mcvr::harness::git_commit(),
        "machine": mcvr::harness::machine(),
        "threads": rayon::current_num_threads(),
        "left_out": left_out,
        "cases": cases,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr::hardcases::{Bound, Finding};

    fn posed(finding: Result<Finding, &str>, verdict: Verdict) -> Posed<'static> {
        let case = hardcases::catalogue().next().expect("a case");
        let error = finding.as_ref().err().map(ToString::to_string);
        (case, Outcome { finding: finding.ok(), verdict, error, seconds: 0.5 })
    }

    fn three() -> [Posed<'static>; 3] {
        [
            posed(Ok(Finding::new(0.25, "mm", Bound::AtMost(0.5)).with("a | b")), Verdict::Pass),
            posed(Ok(Finding::wrong(3, 10, "draws")), Verdict::Fail),
            posed(Err("no disk"), Verdict::Skip),
        ]
    }

    #[test]
    fn a_table_for_people_says_what_was_measured_and_what_failed() {
        let text = plain(&three(), 2);
        assert!(text.contains("pass all-zero: 0.250 mm [≤ 0.500], 0.50 s"), "{text}");
        assert!(text.contains("FAIL all-zero: 3 wrong of 10 draws [≤ 0]"), "{text}");
        assert!(text.contains("skip all-zero: no disk, 0.50 s"), "{text}");
        assert!(
            text.ends_with("3 cases, 1 passed, 1 failed, 1 skipped, 2 s (2 large cases left out; --all runs them)\n")
        );
    }

    #[test]
    fn a_table_in_markdown_keeps_its_columns() {
        let text = markdown(&three(), 0);
        let rows: Vec<&str> = text.lines().filter(|l| l.starts_with("| all-zero")).collect();
        assert_eq!(rows.len(), 3);
        for row in rows {
            assert_eq!(row.replace("\\|", "").matches('|').count(), 7, "{row}");
        }
    }

    #[test]
    fn a_record_holds_every_figure() {
        let record = record(&three(), 0);
        assert_eq!(record["cases"][0]["outcome"]["finding"]["measured"], 0.25);
        assert_eq!(record["cases"][1]["outcome"]["verdict"], "fail");
        assert_eq!(record["cases"][2]["outcome"]["error"], "no disk");
    }
}
