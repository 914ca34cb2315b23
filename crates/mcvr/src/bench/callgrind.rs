//! Instructions of a stage, counted by callgrind: the one measure of work that a neighbour on the machine cannot move.
//!
//! The program runs itself under valgrind with one stage; callgrind counts inside the run alone (`counted_stage_run`), so that start-up, phantoms and preparation play no part. Callgrind knows no AVX-512: the AVX2 code is counted.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};

use super::BenchError;

/// Functions that are kept by name, the costliest first.
const KEPT: usize = 8;

/// Instructions of one run of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Counted {
    /// All of them.
    pub instructions: u64,
    /// Those of the costliest functions, without what they call.
    pub functions: BTreeMap<String, u64>,
}

/// The valgrind that is there, by version; `None` where there is none.
pub fn valgrind_version() -> Option<String> {
    let out = Command::new("valgrind").arg("--version").stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    out.status.success().then(|| String::from_utf8_lossy(&out.stdout).trim().to_owned())
}

/// Counts one run of a stage by running `program bench --once STAGE` under callgrind; `folder` takes its output.
///
/// # Errors
/// [`BenchError::Callgrind`] when valgrind cannot be run, the stage fails in it, or it counted nothing.
pub fn count(program: &Path, stage: &str, folder: &Path) -> Result<Counted, BenchError> {
    let fail = |problem: String| BenchError::Callgrind { stage: stage.to_owned(), problem };
    let file = folder.join(format!("{}.callgrind", stage.replace('/', "-")));
    let mut command = Command::new("valgrind");
    command.args(["--tool=callgrind", "--toggle-collect=*counted_stage_run*", "--read-inline-info=no"]);
    command.arg(format!("--callgrind-out-file={}", file.display()));
    command.arg(program).args(["--threads", "1", "bench", "--once", stage]);
    let output = command.stdin(Stdio::null()).output().map_err(|e| fail(format!("cannot run valgrind: {e}")))?;
    if !output.status.success() {
        let text = String::from_utf8_lossy(&output.stderr);
        let last = text.lines().rev().find(|l| !l.starts_with("==")).or(text.lines().next_back()).unwrap_or_default();
        return Err(fail(format!("{}: {last}", output.status)));
    }
    let text = std::fs::read_to_string(&file).map_err(|e| fail(format!("its output: {e}")))?;
    let counted = parse(&text).filter(|c| c.instructions > 0);
    counted.ok_or_else(|| {
        fail("it counted no instruction inside the stage; was the program stripped of its symbols?".into())
    })
}

/// The total and the costliest functions of a callgrind output file (format version 1).
fn parse(text: &str) -> Option<Counted> {
    let mut names: BTreeMap<&str, String> = BTreeMap::new();
    let mut own: BTreeMap<String, u64> = BTreeMap::new();
    let (mut current, mut called, mut total) = (String::new(), false, None);
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("fn=") {
            current = named(&mut names, rest);
        } else if let Some(rest) = line.strip_prefix("cfn=") {
            named(&mut names, rest);
        } else if line.starts_with("calls=") {
            called = true;
        } else if let Some(rest) = line.strip_prefix("totals:").or_else(|| line.strip_prefix("summary:")) {
            total = rest.trim().parse().ok().or(total);
        } else if line.starts_with(|c: char| c.is_ascii_digit() || "+-*".contains(c)) {
            // After `calls=` stands what the called function cost.
            if !std::mem::take(&mut called) {
                let cost: u64 = line.split_whitespace().nth(1).and_then(|n| n.parse().ok())?;
                *own.entry(current.clone()).or_default() += cost;
            }
        }
    }
    let mut functions: Vec<(String, u64)> = own.into_iter().filter(|(name, _)| !name.is_empty()).collect();
    functions.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
    functions.truncate(KEPT);
    Some(Counted { instructions: total?, functions: functions.into_iter().collect() })
}

/// The name of `(id) name`, or of `(id)` when it was named before.
fn named<'a>(names: &mut BTreeMap<&'a str, String>, text: &'a str) -> String {
    let (id, name) = text.split_once(' ').unwrap_or((text, ""));
    if !name.is_empty() {
        names.insert(id, plain(name));
    }
    names.get(id).cloned().unwrap_or_default()
}

/// A function's name without the compiler's hash and valgrind's recursion mark, which differ from build to build.
fn plain(name: &str) -> String {
    let name = name.split('\'').next().unwrap_or(name);
    match name.rsplit_once("::h") {
        Some((head, hash)) if hash.len() == 16 && hash.bytes().all(|b| b.is_ascii_hexdigit()) => head.to_owned(),
        _ => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn costs_are_summed_by_function_without_what_they_call() {
        let text = "version: 1\nevents: Ir\nfn=(1) a::b::h0123456789abcdef\n10 5\n+1 7\ncfn=(2) c\ncalls=1 20\n11 100\n* 3\n\
                    fn=(2)\n20 100\n\ntotals: 115\n";
        let counted = parse(text).unwrap();
        assert_eq!(counted.instructions, 115);
        assert_eq!(counted.functions, BTreeMap::from([("a::b".to_owned(), 15), ("c".to_owned(), 100)]));
        assert!(parse("events: Ir\n").is_none());
    }

    #[test]
    fn names_lose_what_differs_from_build_to_build() {
        assert_eq!(plain("mcvr::x::h0123456789abcdef"), "mcvr::x");
        assert_eq!(plain("mcvr::hat"), "mcvr::hat");
        assert_eq!(plain("f'2"), "f");
    }

    #[test]
    fn a_program_that_fails_is_reported_by_its_stage() {
        let folder = tempfile::tempdir().unwrap();
        let error =
            count(Path::new("/nonexistent/program"), "render/tent-line", folder.path()).unwrap_err().to_string();
        assert!(error.starts_with("callgrind, stage render/tent-line: "), "{error}");
    }
}
