//! Disks that are full, too small, or may not be written.

use std::path::Path;
use std::process::Command;

use super::program::{Ended, Place, finish};
use super::{Case, CaseError, Context, Finding, Tally, picture, quick};

pub(super) const CASES: &[Case] = &[
    quick(
        "disk-full",
        "a half-written file replaces the good one, a temporary file fills what is left, the status is 0",
        "exit 1, the path and the reason named, the earlier file untouched, nothing beside it",
        disk_full,
    ),
    quick(
        "disk-full-in-converge",
        "a torn record spoils the log, and hours of finished ones with it",
        "exit 1; with space again, a rerun completes to the records of a run that was never stopped",
        disk_full_in_converge,
    ),
    quick(
        "file-size-limit",
        "a write that is cut short is taken for a whole one",
        "exit 1, the path and the reason named, the earlier file untouched, nothing beside it",
        file_size_limit,
    ),
    quick(
        "read-only-disk",
        "the error comes after hours of work, or never",
        "exit 1, the path and the reason named, the earlier file untouched",
        read_only_disk,
    ),
];

/// A way to write an output: its name, the arguments, and whether it is larger than a few kilobytes.
struct Kind {
    name: &'static str,
    arguments: Vec<&'static str>,
    large: bool,
}

/// Every kind of file that the program writes. Images of 400 × 400 noisy pixels and three frames of 200 × 200 take
/// more than 8 KiB in any format, points 12 bytes each; records and tables are smaller.
fn kinds() -> Vec<Kind> {
    let kind = |name, arguments, large| Kind { name, arguments, large };
    let sample = |name| vec!["sample", "phantom:lobster@24", "--samples", "2^14", "--quiet", "-o", name];
    let orbit = |name| {
        let fixed = ["orbit", "phantom:lobster@24", "--samples", "2^14", "--frames", "3", "--size", "200x200"];
        fixed.into_iter().chain(["--quiet", "-o", name]).collect()
    };
    vec![
        kind("a.png", picture(&["-o", "a.png"]), true),
        kind("deep.png", picture(&["--deep", "-o", "deep.png"]), true),
        kind("a.npy", picture(&["-o", "a.npy"]), true),
        kind("a.exr", picture(&["-o", "a.exr"]), true),
        kind("a.tiff", picture(&["-o", "a.tiff"]), true),
        kind("a.mcvr", sample("a.mcvr"), true),
        kind("a.ply", sample("a.ply"), true),
        kind("turn.png", orbit("turn.png"), true),
        kind("turn.gif", orbit("turn.gif"), true),
        kind("plan.json", vec!["plan", "phantom:lobster@24", "--quiet", "--json", "plan.json"], false),
        kind("info.json", vec!["info", "phantom:lobster@24", "--json", "info.json"], false),
        kind("list.txt", vec!["hardcases", "--list", "-o", "list.txt"], false),
    ]
}

/// What lies in the output's place before.
const EARLIER: &[u8] = b"earlier";

/// Four checks of a run that could not write: that it said so, that the earlier file is as it was, and that it is alone.
fn check_refusal(tally: &mut Tally, kind: &Kind, ended: &Ended, folder: &Path, reason: &str) -> Result<(), CaseError> {
    let name = kind.name;
    tally.check(ended.code() == Some(1), || format!("{name}: {}", ended.last_words()));
    tally.check(ended.failed_with(1, &[name, reason]), || format!("{name} said: {}", ended.last_words()));
    let kept = std::fs::read(folder.join(name)).is_ok_and(|b| b == EARLIER);
    tally.check(kept, || format!("{name}: the earlier file is gone"));
    let beside = super::program::names(folder)?;
    tally.check(beside == [name], || format!("{name}: {} lie there", beside.join(", ")));
    Ok(())
}

/// A shell in a namespace of its own, where it may mount a small file system at `disk`; what lies there in the end is copied to
/// `kept`. `fill` prepares it, in the file system.
fn mounted(place: &Place<'_>, kibibytes: u32, fill: &str, arguments: &[&str]) -> Result<Ended, CaseError> {
    for name in ["disk", "kept"] {
        let folder = place.path(name);
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir(&folder)?;
    }
    let script = format!(
        "mount -t tmpfs -o size={kibibytes}k none disk || exit 77; cp -a earlier/. disk 2>/dev/null; cd disk; {fill}\n\
         \"$@\"; code=$?; rm -f .fill; cp -a . ../kept; exit $code"
    );
    let shell = place.shell(&script, arguments);
    let mut command = Command::new("unshare");
    command.arg("-rm").arg(shell.get_program()).args(shell.get_args());
    command.current_dir(place.path("")).stdin(std::process::Stdio::null());
    let ended = match finish(command) {
        Err(CaseError::Failed(e)) if e.to_string().contains("os error 2") => {
            return Err(CaseError::Impossible("no unshare to mount a small disk with".into()));
        }
        other => other?,
    };
    if ended.code() == Some(77) || ended.err.contains("unshare:") {
        return Err(CaseError::Impossible("this user may not mount a small disk".into()));
    }
    Ok(ended)
}

/// Puts a folder `earlier` in place with one file.
fn earlier(place: &Place<'_>, name: &str) -> Result<(), CaseError> {
    let folder = place.path("earlier");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir(&folder)?;
    Ok(std::fs::write(folder.join(name), EARLIER)?)
}

/// Exact: every kind of output, four checks each. The disk is a file system of 16 KiB, four pages: one for the earlier file, one
/// taken, two free, of which a large output takes all; for small ones none is free.
fn disk_full(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let mut tally = Tally::default();
    for kind in kinds() {
        earlier(&place, kind.name)?;
        let pages = if kind.large { "count=1" } else { "" };
        let fill = format!("dd if=/dev/zero of=.fill bs=4096 {pages} 2>/dev/null");
        let ended = mounted(&place, 16, &fill, &kind.arguments)?;
        check_refusal(&mut tally, &kind, &ended, &place.path("kept"), "No space left")?;
    }
    Ok(tally.finding("checks of 12 kinds of output", "a file system of 16 KiB, filled"))
}

/// Exact: the records that survive and those of the rerun must be the bits of a run with space, times apart. The disk holds a
/// few records and not the run: its images alone take more.
fn disk_full_in_converge(context: &Context) -> Result<Finding, CaseError> {
    use super::interrupts::{converge, differences, records};
    let place = Place::new(context)?;
    place.must(converge("whole"))?;
    let whole = records(&place.path("whole"))?;
    let _ = std::fs::create_dir(place.path("earlier"));
    let ended = mounted(&place, 72, "", &converge("run"))?;
    let mut tally = Tally::default();
    tally.check(ended.failed_with(1, &["run/", "No space left"]), || ended.last_words());
    let torn = place.path("kept/run");
    let temporary = super::program::names(&torn)?.into_iter().filter(|n| n.ends_with(".tmp")).count();
    tally.check(temporary == 0, || format!("{temporary} temporary files left"));
    let survived = records(&torn)?.len();
    tally.check(survived < whole.len(), || format!("all {survived} records fitted"));
    place.must(converge("kept/run"))?;
    tally.check(differences(&whole, &records(&torn)?) == 0, || "the rerun's records differ".into());
    Ok(tally.finding("checks", &format!("{survived} of {} records had fitted", whole.len())))
}

/// Exact: every large kind of output, four checks each, under a limit of 8 blocks (4 or 8 KiB) to a file's size whose signal is
/// ignored, so that the write itself fails. With the signal's default action the system ends the program at once; the earlier
/// file is then whole as well, but a hidden temporary file stays.
fn file_size_limit(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let mut tally = Tally::default();
    for kind in kinds().into_iter().filter(|k| k.large) {
        let folder = place.path("out");
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir(&folder)?;
        std::fs::write(folder.join(kind.name), EARLIER)?;
        // Messages go through a pipe, which has no size.
        let script =
            "trap '' XFSZ; cd out; said=$( (ulimit -f 8; exec \"$@\") 2>&1 ); code=$?; echo \"$said\"; exit $code";
        let mut said = finish(place.shell(script, &kind.arguments))?;
        said.err = String::from_utf8_lossy(&said.out).into_owned();
        check_refusal(&mut tally, &kind, &said, &folder, "too large")?;
    }
    Ok(tally.finding("checks of 9 kinds of output", "a limit of 8 blocks to a file's size"))
}

/// Exact: every kind of output, four checks each, on a file system that was made read-only. The error must come before the work:
/// a budget that would take hours is asked for, and the run must still end.
fn read_only_disk(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let mut tally = Tally::default();
    for mut kind in kinds() {
        earlier(&place, kind.name)?;
        for argument in &mut kind.arguments {
            if *argument == "2^16" && kind.name != "a.mcvr" && kind.name != "a.ply" {
                *argument = "2^40";
            }
        }
        let ended = mounted(&place, 64, "mount -o remount,ro . || exit 77", &kind.arguments)?;
        check_refusal(&mut tally, &kind, &ended, &place.path("kept"), "Read-only")?;
    }
    Ok(tally.finding("checks of 12 kinds of output", "a file system mounted read-only"))
}
