//! Which points, scramble, order and coordinates make the best image in a given time: `bench-results/*/qmc-study`.
//!
//! `cargo run --release -p mcvr --example qmc_study -- --data DIR --out DIR [--resume]` measures errors (about a quarter of an
//! hour on two cores) and times (ten minutes; on a quiet machine), and writes `records.jsonl`, `README.md` and plots. DIR holds
//! the scans of README's "Real scans"; those that are missing are left out and named. `--only` takes parts (`errors`, `timing`,
//! `page`) and scans, for example `--only timing,lobster`; what is measured anew replaces the records of the same part and scan,
//! or with `--resume` only what is missing is measured. `--samples 18,22` says which powers of two, `--replicates` how many
//! images an error takes. `--quick` runs everything on a small phantom.
#![allow(missing_docs, reason = "a program, not a library")]

mod bias;
mod entrants;
mod errors;
mod figures;
mod page;
mod plots;
mod records;
mod scans;
mod sections;
mod timing;

use std::path::PathBuf;

use records::{Log, Record};

/// Any failure.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

const PARTS: [&str; 3] = ["errors", "timing", "page"];
const USAGE: &str =
    "give --data DIR --out DIR [--only PART|SCAN,...] [--samples 18,22] [--replicates N] [--resume] [--quick]";

/// What was asked for on the command line.
pub struct Options {
    pub data: PathBuf,
    pub out: PathBuf,
    only: Vec<String>,
    /// Powers of two, instead of each method's own.
    pub levels: Option<Vec<u32>>,
    pub replicates: Option<usize>,
    pub resume: bool,
    pub quick: bool,
}

impl Options {
    fn read(mut arguments: impl Iterator<Item = String>) -> Outcome<Self> {
        let (mut data, mut out) = (None, None);
        let mut options = Self {
            data: PathBuf::new(),
            out: PathBuf::new(),
            only: vec![],
            levels: None,
            replicates: None,
            resume: false,
            quick: false,
        };
        while let Some(name) = arguments.next() {
            match name.as_str() {
                "--resume" => options.resume = true,
                "--quick" => options.quick = true,
                "--data" | "--out" | "--only" | "--samples" | "--replicates" => {
                    let value = arguments.next().ok_or_else(|| format!("{name} needs a value; {USAGE}"))?;
                    match name.as_str() {
                        "--data" => data = Some(PathBuf::from(value)),
                        "--out" => out = Some(PathBuf::from(value)),
                        "--only" => options.only = value.split(',').map(str::to_owned).collect(),
                        "--samples" => options.levels = Some(levels(&value)?),
                        _ => options.replicates = Some(replicates(&value)?),
                    }
                }
                _ => return Err(format!("unknown option '{name}'; {USAGE}").into()),
            }
        }
        let scans = scans::all(options.quick);
        let known = |word: &String| PARTS.contains(&word.as_str()) || scans.iter().any(|s| s.name == word);
        if let Some(word) = options.only.iter().find(|w| !known(w)) {
            let names: Vec<&str> = scans.iter().map(|s| s.name).collect();
            return Err(
                format!("--only takes {} or a scan ({}), not '{word}'", PARTS.join(", "), names.join(", ")).into()
            );
        }
        options.data =
            data.or_else(|| options.quick.then(PathBuf::new)).ok_or(format!("--data DIR is missing; {USAGE}"))?;
        options.out = out.ok_or(format!("--out DIR is missing; {USAGE}"))?;
        Ok(options)
    }

    /// Whether a part, or a scan, is wanted: with no word of its kind all are.
    fn wants(&self, word: &str) -> bool {
        let part = PARTS.contains(&word);
        let mut same = self.only.iter().filter(|o| PARTS.contains(&o.as_str()) == part).peekable();
        same.peek().is_none() || same.any(|o| o == word)
    }
}

fn levels(text: &str) -> Outcome<Vec<u32>> {
    let bad = || format!("--samples takes powers of two from 10 to 30, for example 18,22, not '{text}'");
    let levels: Option<Vec<u32>> =
        text.split(',').map(|l| l.trim_start_matches("2^").parse().ok().filter(|l| (10..=30).contains(l))).collect();
    levels.ok_or_else(|| bad().into())
}

fn replicates(text: &str) -> Outcome<usize> {
    let bad = || format!("--replicates takes a number from 3 to 1000, not '{text}'");
    text.parse().ok().filter(|n| (3..=1000).contains(n)).ok_or_else(|| bad().into())
}

fn main() -> Outcome<()> {
    run(&Options::read(std::env::args().skip(1))?)
}

fn run(options: &Options) -> Outcome<()> {
    std::fs::create_dir_all(&options.out)?;
    let mut log = Log::open(&options.out.join("records.jsonl"))?;
    let scans: Vec<_> = scans::all(options.quick).into_iter().filter(|s| options.wants(s.name)).collect();
    let (errors, timing) = (options.wants("errors"), options.wants("timing"));
    if !options.resume {
        let again = |r: &Record| options.wants(r.scan()) && (timing && r.is_time() || errors && !r.is_time());
        log.forget(again)?;
    }
    for scan in scans.iter().filter(|_| errors || timing) {
        let Some(density) = scan.load(&options.data)? else {
            println!("{}: {} is not in the data folder, left out", scan.name, scan.file);
            continue;
        };
        for view in &scan.views {
            let scene = scans::Scene::new(scan, view, &density, options.quick)?;
            if errors {
                errors::measure(options, &scene, &mut log)?;
            }
            if timing {
                timing::measure(options, &scene, &mut log)?;
            }
        }
        page::write(&options.out, log.records())?;
    }
    page::write(&options.out, log.records())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(words: &str) -> Outcome<Options> {
        Options::read(words.split_whitespace().map(str::to_owned))
    }

    #[test]
    fn words_of_the_command_line_are_checked() {
        for bad in [
            "",
            "--out x",
            "--data x --out",
            "--data x --out y --only lobsters",
            "--data x --out y --samples 5",
            "--data x --out y --samples many",
            "--data x --out y --replicates 1",
            "--data x --out y z",
        ] {
            assert!(options(bad).is_err(), "{bad}");
        }
        let all = options("--data x --out y").unwrap();
        assert!(all.wants("timing") && all.wants("errors") && all.wants("lobster") && !all.resume);
        let some = options("--data x --out y --only timing,lobster --samples 2^18,20 --resume").unwrap();
        assert!(some.wants("timing") && !some.wants("errors") && some.wants("lobster") && !some.wants("stent"));
        assert_eq!(some.levels, Some(vec![18, 20]));
    }

    /// Everything runs, resumes without measuring twice, and says so on a page.
    #[test]
    fn a_quick_run_writes_a_page_and_resumes() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let study = |words: &str| {
            let options = options(&format!("--quick --out {} {words}", out.display())).unwrap();
            run(&options).unwrap();
            std::fs::read_to_string(out.join("records.jsonl")).unwrap()
        };
        let first = study("--samples 10,12 --replicates 3");
        assert!(first.lines().count() > 50);
        assert_eq!(study("--samples 10,12 --replicates 3 --resume"), first);
        let page = std::fs::read_to_string(out.join("README.md")).unwrap();
        for text in ["## Error × √time", "## Samples for 2 % error", "lattice", "ssp", "quick run"] {
            assert!(page.contains(text), "{text}");
        }
        assert!(out.join("oblique.svg").exists());
    }
}
