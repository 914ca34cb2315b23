//! Standard input, output and error: closed, full, nobody there, no terminal.

use std::process::Stdio;

use super::program::{PATIENCE, Place, finish, start_as_is};
use super::{Bound, Case, CaseError, Context, Finding, SMALL_RUN, Tally, picture, quick};

pub(super) const CASES: &[Case] = &[
    quick(
        "closed-pipe",
        "a reader that has seen enough (| head) makes the program panic",
        "no panic, exit 0: on standard output as on standard error",
        closed_pipe,
    ),
    quick(
        "closed-descriptors",
        "with standard error closed, the image file gets its number, and messages are written into the image",
        "the image has the bits of an ordinary run",
        closed_descriptors,
    ),
    quick(
        "full-standard-output",
        "JSON that was not written is reported as a success",
        "exit 1, standard output and the reason named",
        full_standard_output,
    ),
    quick(
        "no-terminal",
        "log files fill with progress bars and colour codes",
        "no control character but the line end in what is said",
        no_terminal,
    ),
    quick(
        "bare-environment",
        "without HOME or TERM a program stops; with a decimal comma it writes numbers that nobody reads",
        "image and numbers have the bits of an ordinary run",
        bare_environment,
    ),
];

/// Commands that write to standard output.
fn talkers() -> Vec<(&'static str, Vec<&'static str>)> {
    vec![
        ("info", vec!["info", "phantom:lobster@24"]),
        ("info --json -", vec!["info", "phantom:lobster@24", "--json", "-"]),
        ("info --phantoms", vec!["info", "--phantoms"]),
        ("render --json -", picture(&["-o", "a.png", "--json", "-"])),
        ("plan", vec!["plan", "phantom:lobster@24"]),
        ("plan --json -", vec!["plan", "phantom:lobster@24", "--json", "-"]),
        ("schema", vec!["schema"]),
        ("hardcases --list", vec!["hardcases", "--list"]),
        ("compare", vec!["compare", "one.npy", "one.npy"]),
        ("converge", [&SMALL_RUN[..], &["run"]].concat()),
    ]
}

/// Exact: each command that writes to standard output, with a pipe whose reader is gone before it starts, and a rendering whose
/// standard error is such a pipe.
fn closed_pipe(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    place.must(picture(&["-o", "one.npy"]))?;
    let mut tally = Tally::default();
    let widowed = || -> Result<Stdio, CaseError> {
        let (reader, writer) = std::io::pipe()?;
        drop(reader);
        Ok(writer.into())
    };
    for (name, arguments) in talkers() {
        let mut command = place.command(arguments);
        let said = tempfile::NamedTempFile::new_in(place.path(""))?;
        command.stdout(widowed()?).stderr(said.reopen()?);
        let ended = start_as_is(command)?.wait(PATIENCE)?;
        let words = std::fs::read_to_string(said.path())?;
        tally.check(ended.status.success() && !words.contains("panicked"), || format!("{name}: {}", ended.status));
    }
    let loud = ["render", "phantom:lobster@24", "--samples", "10000", "--size", "20x20", "-o", "loud.png"];
    let mut command = place.command(loud);
    command.stdout(widowed()?).stderr(widowed()?);
    let ended = start_as_is(command)?.wait(PATIENCE)?;
    let made = ended.status.success() && place.path("loud.png").exists();
    tally.check(made, || format!("standard error: {}", ended.status));
    Ok(tally.finding("commands", "the reader was gone before the first byte"))
}

/// Exact: the bytes of an image made with standard input, output and error closed, alone and together.
fn closed_descriptors(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    // Without --quiet, so that there is something to say.
    let loud = |name| ["render", "phantom:lobster@24", "--samples", "10000", "--size", "20x20", "-o", name];
    place.must(loud("ordinary.npy"))?;
    let ordinary = std::fs::read(place.path("ordinary.npy"))?;
    let mut tally = Tally::default();
    for closed in ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"] {
        let ended = finish(place.shell(&format!("exec \"$@\" {closed}"), loud("closed.npy")))?;
        let same = ended.status.success() && std::fs::read(place.path("closed.npy"))? == ordinary;
        tally.check(same, || format!("{closed}: {}", ended.last_words()));
    }
    Ok(tally.finding("images", "descriptors 0, 1, 2, and all three"))
}

/// Exact: each command that writes to standard output, into a device that is full.
fn full_standard_output(context: &Context) -> Result<Finding, CaseError> {
    let Ok(full) = std::fs::OpenOptions::new().write(true).open("/dev/full") else {
        return Err(CaseError::Impossible("no /dev/full".into()));
    };
    let place = Place::new(context)?;
    place.must(picture(&["-o", "one.npy"]))?;
    let mut tally = Tally::default();
    for (name, arguments) in talkers() {
        let mut command = place.command(arguments);
        let said = tempfile::NamedTempFile::new_in(place.path(""))?;
        command.stdout(full.try_clone()?).stderr(said.reopen()?);
        let ended = start_as_is(command)?.wait(PATIENCE)?;
        let words = std::fs::read_to_string(said.path())?;
        let clear = ended.code() == Some(1) && words.contains("standard output") && words.contains("No space left");
        tally.check(clear, || format!("{name}: {}: {}", ended.status, words.trim_end()));
    }
    Ok(tally.finding("commands", "standard output was /dev/full"))
}

/// Exact: control characters in what commands say into files, with a terminal type set and without one.
fn no_terminal(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let (mut controls, mut bytes) = (0, 0);
    let loud = ["render", "phantom:lobster@24", "--samples", "2^20", "--size", "20x20", "-o", "loud.png"];
    let wrong = ["render", "phantom:nothing", "-o", "a.png"];
    let usage = ["render", "--no-such-flag"];
    for arguments in [&loud[..], &wrong, &usage, &["--help"]] {
        for term in [None, Some("xterm-256color")] {
            let mut command = place.command(arguments);
            command.env_remove("TERM");
            term.map(|t| command.env("TERM", t));
            let ended = finish(command)?;
            let said: Vec<u8> = ended.out.iter().copied().chain(ended.err.bytes()).collect();
            controls += said.iter().filter(|b| b.is_ascii_control() && **b != b'\n').count();
            bytes += said.len();
        }
    }
    let finding = Finding::new(controls as f64, "control characters", Bound::Exactly(0.0));
    Ok(finding.with(format!("in {bytes} bytes")))
}

/// Exact: the image's bytes and the JSON record without times, memory and names, in an empty environment and in one that asks for
/// decimal commas.
fn bare_environment(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let arguments = picture(&["-o", "a.npy", "--json", "a.json"]);
    let result = || -> Result<(Vec<u8>, serde_json::Value), CaseError> {
        let mut record: serde_json::Value = serde_json::from_slice(&std::fs::read(place.path("a.json"))?)?;
        record["seconds"] = serde_json::Value::Null;
        record["peak_memory_bytes"] = serde_json::Value::Null;
        Ok((std::fs::read(place.path("a.npy"))?, record))
    };
    place.must(&arguments)?;
    let ordinary = result()?;
    let mut tally = Tally::default();
    let environments: [&[(&str, &str)]; 3] = [
        &[],
        &[("LANG", "de_DE.UTF-8"), ("LC_ALL", "de_DE.UTF-8"), ("LC_NUMERIC", "de_DE.UTF-8")],
        &[("HOME", "/nonexistent"), ("TMPDIR", "/nonexistent"), ("TERM", "dumb"), ("LC_ALL", "C")],
    ];
    for environment in environments {
        let mut command = place.command(&arguments);
        command.env_clear().envs(environment.iter().copied());
        let ended = finish(command)?;
        let same = ended.status.success() && result()? == ordinary;
        tally.check(same, || format!("{environment:?}: {}", ended.last_words()));
    }
    Ok(tally.finding("environments", "empty; decimal commas; folders that are not there"))
}
