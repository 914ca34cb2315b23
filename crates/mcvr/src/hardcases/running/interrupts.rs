//! Ctrl-C, `kill`, `kill -9`, and two runs in one folder.

use std::path::Path;

use serde_json::Value;

use super::program::{PATIENCE, Place, start};
use super::{Bound, Case, CaseError, Context, Finding, Tally, quick};

pub(super) const CASES: &[Case] = &[
    quick(
        "interrupted-converge",
        "Ctrl-C throws finished measurements away, or a rerun mixes its own with them",
        "exit 130; the rerun's records are the bits of a run that was never stopped",
        |context| stopped(context, &["INT", "TERM"]),
    ),
    quick(
        "killed-converge",
        "kill -9 leaves a torn line, a half-written truth or a lock that nobody lifts",
        "whole records survive; the rerun's records are the bits of a run that was never stopped",
        |context| stopped(context, &["KILL", "KILL", "KILL"]),
    ),
    quick(
        "interrupt-leaves-nothing",
        "a signal in the middle of an image leaves half a file under its name",
        "exit 130, the earlier file untouched, nothing beside it",
        interrupt_leaves_nothing,
    ),
    quick(
        "two-runs-in-one-folder",
        "two runs mix their records, or the second replaces the first one's truth before it notices",
        "the second run and a run of something else are refused; the first goes on undisturbed",
        two_runs,
    ),
    quick(
        "truth-of-another-run",
        "a kill between a truth and its description leaves them of different scenes, and the next run believes the wrong one",
        "a truth that is not the described one is cast again",
        truth_of_another_run,
    ),
];

/// A measurement of 48 images by two methods: many more than are made before the last signal, however busy the machine is.
pub(super) fn converge(out: &str) -> Vec<&str> {
    vec![
        "converge",
        "phantom:lobster@24",
        "--methods",
        "mc,qmc",
        "--samples",
        "2^16..2^18",
        "--replicates",
        "8",
        "--series",
        "none",
        "--size",
        "24x24",
        "--tolerance",
        "1e-2",
        "--quiet",
        "-o",
        out,
    ]
}

/// The records of a folder in the order of their identity, without what differs between equal runs: times.
pub(super) fn records(folder: &Path) -> Result<Vec<String>, CaseError> {
    let read = mcvr_harness::record::read_log(&folder.join("records.jsonl"))?;
    let mut all: Vec<_> = read
        .into_iter()
        .map(|record| {
            let key = record.key();
            let mut value = serde_json::to_value(record)?;
            value["seconds"] = Value::Null;
            Ok((key, value.to_string()))
        })
        .collect::<Result<_, serde_json::Error>>()?;
    all.sort();
    Ok(all.into_iter().map(|(_, text)| text).collect())
}

/// Records of which two runs have different bits, missing and surplus ones included.
pub(super) fn differences(a: &[String], b: &[String]) -> u64 {
    let unequal = a.iter().zip(b).filter(|(a, b)| a != b).count();
    (unequal + a.len().abs_diff(b.len())) as u64
}

fn lines(path: &Path) -> usize {
    std::fs::read(path).map_or(0, |bytes| bytes.iter().filter(|b| **b == b'\n').count())
}

/// Exact: records of 48 images, compared as text (a float's shortest text gives back its bits) with those of a run that was never
/// stopped. The run is stopped by each signal in turn, a few records further each time, and then runs to its end. A signal that
/// comes too late, after the last record, would prove nothing, and is an error of the case.
fn stopped(context: &Context, signals: &[&str]) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    place.must(converge("whole"))?;
    let whole = records(&place.path("whole"))?;
    let log = place.path("run/records.jsonl");
    let mut survived = vec![];
    for (n, signal) in signals.iter().enumerate() {
        let mut running = start(place.command(converge("run")))?;
        running.until(|| lines(&log) > 1 + 4 * n)?;
        running.signal(signal)?;
        let ended = running.wait(PATIENCE)?;
        if *signal != "KILL" && ended.code() != Some(130) {
            return Err(format!("SIG{signal}: {}", ended.last_words()).into());
        }
        survived.push(records(&place.path("run"))?.len());
    }
    if survived.last().is_some_and(|n| *n >= whole.len()) {
        return Err("the signals came too late".into());
    }
    place.must(converge("run"))?;
    let run = records(&place.path("run"))?;
    let left = super::program::names(&place.path("run"))?.into_iter().filter(|n| n.ends_with(".tmp")).count();
    if left > 0 {
        return Err(format!("{left} temporary files are left after the rerun").into());
    }
    let counts: Vec<String> = survived.iter().map(ToString::to_string).collect();
    let detail = format!("stopped after {} records", counts.join(", "));
    Ok(Finding::wrong(differences(&whole, &run), whole.len() as u64, "records").with(detail))
}

/// Exact: five commands that would take hours, each stopped as soon as it is at work; status, earlier file and folder are checked.
fn interrupt_leaves_nothing(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let mut tally = Tally::default();
    let render = |name: &'static str| {
        vec!["render", "phantom:lobster@24", "--samples", "2^40", "--size", "200x200", "--quiet", "-o", name]
    };
    let commands: [(&str, &str, Vec<&str>); 5] = [
        ("INT", "a.png", render("a.png")),
        ("TERM", "a.npy", render("a.npy")),
        ("HUP", "a.exr", render("a.exr")),
        ("INT", "a.mcvr", vec!["sample", "phantom:lobster@24", "--samples", "2^27", "--quiet", "-o", "a.mcvr"]),
        (
            "INT",
            "turn.png",
            vec![
                "orbit",
                "phantom:lobster@24",
                "--samples",
                "2^18",
                "--frames",
                "100000",
                "--size",
                "8x8",
                "--quiet",
                "--distance",
                "500",
                "-o",
                "turn.png",
            ],
        ),
    ];
    for (signal, name, arguments) in commands {
        // An animation of the frames that are finished is written, as the manual says; nothing else is.
        let kept = name == "turn.png";
        std::fs::write(place.path(name), "earlier")?;
        let mut running = start(place.command(arguments))?;
        running.until_at_work()?;
        running.signal(signal)?;
        let ended = running.wait(PATIENCE)?;
        tally.check(ended.failed_with(130, &["interrupted"]), || format!("{name}: {}", ended.last_words()));
        let bytes = std::fs::read(place.path(name))?;
        let whole =
            bytes == b"earlier" || kept && bytes.starts_with(b"\x89PNG") && bytes.ends_with(b"IEND\xaeB\x60\x82");
        tally.check(whole, || format!("{name}: {} bytes", bytes.len()));
        let beside = place.names()?;
        tally.check(beside == [name], || format!("{name}: {} lie there", beside.join(", ")));
        std::fs::remove_file(place.path(name))?;
    }
    Ok(tally.finding("checks of 5 commands", "2^40 samples stopped at once"))
}

/// Exact: two refusals with their words, the bytes of the truth, and the records of the first run, which is then stopped and
/// completed, against those of an undisturbed one.
fn two_runs(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    place.must(converge("whole"))?;
    let mut tally = Tally::default();
    let mut first = start(place.command(converge("run")))?;
    first.until(|| lines(&place.path("run/records.jsonl")) > 0)?;
    let truth = || {
        Ok::<_, CaseError>((std::fs::read(place.path("run/truth.npy"))?, std::fs::read(place.path("run/truth.json"))?))
    };
    let before = truth()?;
    // The first run holds its breath, so that it cannot be over before the second is there.
    first.signal("STOP")?;
    let second = place.run(converge("run"))?;
    first.signal("CONT")?;
    tally.check(second.failed_with(1, &["run", "another run"]), || format!("the same: {}", second.last_words()));
    for more in [["--view", "10,20"], ["--seed", "7"]] {
        let other = place.run(converge("run").into_iter().chain(more))?;
        tally.check(other.failed_with(1, &["run", "something else"]), || format!("{more:?}: {}", other.last_words()));
    }
    let ended = first.wait(PATIENCE)?;
    tally.check(ended.status.success(), || format!("the first: {}", ended.last_words()));
    // A finer truth is another one: it is refused too, and the one there stays.
    let finer = place.run(converge("run").into_iter().map(|a| if a == "1e-2" { "1e-4" } else { a }))?;
    tally.check(finer.failed_with(1, &["run", "something else"]), || format!("finer: {}", finer.last_words()));
    tally.check(truth()? == before, || "the first run's truth was replaced".into());
    let apart = differences(&records(&place.path("whole"))?, &records(&place.path("run"))?);
    tally.check(apart == 0, || format!("{apart} records differ"));
    Ok(tally.finding("checks", "a second run, another view, another seed, a finer truth"))
}

/// Exact: one record's error against the one before. The truth of another view is put in the place of the right one, as a kill
/// between the two files of a truth would leave it.
fn truth_of_another_run(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let run = |out: &'static str, view: &'static str| {
        let short = converge(out).into_iter().map(|a| if a == "2^16..2^18" { "2^10" } else { a });
        place.must(short.chain(["--view", view]))
    };
    run("run", "30,20")?;
    run("other", "80,10")?;
    let before = records(&place.path("run"))?;
    std::fs::copy(place.path("other/truth.npy"), place.path("run/truth.npy"))?;
    std::fs::remove_file(place.path("run/records.jsonl"))?;
    run("run", "30,20")?;
    let wrong = differences(&before, &records(&place.path("run"))?);
    Ok(Finding::new(wrong as f64, "records with another error", Bound::Exactly(0.0)))
}
