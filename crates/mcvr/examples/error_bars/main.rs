//! How far error bars and the stopping rule can be believed, measured over whole repeats against exact ray casting.
//!
//! `cargo run --release -p mcvr --example error_bars -- --out DIR [--data DIR] [--only coverage|stopping|seeds|page] [--repeats N]
//! [--resume] [--quick]` writes `coverage.json`, `stopping.json`, `seeds.json` and `README.md`, anew after every row: what is
//! finished outlives Ctrl-C, and `--resume` goes on from there. The data folder holds the lobster of the main README's "Real scans";
//! without it the phantom alone is measured. Truths are kept in `OUT/truths` and cast again only where the scene changed.
//! `--quick` runs everything small and once, on the phantom, to see whether it runs: its figures mean nothing.
#![allow(missing_docs, reason = "a program, not a library")]

mod coverage;
mod curve;
mod page;
mod records;
mod scenes;
mod seeds;
mod statistics;
mod stopping;
mod strata;
mod tally;
mod truths;

use std::path::PathBuf;

/// Any failure.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

const PARTS: [&str; 4] = ["coverage", "stopping", "seeds", "page"];

const USAGE: &str =
    "give --out DIR [--data DIR] [--only coverage|stopping|seeds|page] [--repeats N] [--resume] [--quick]";

/// What was asked for on the command line.
pub struct Options {
    /// Folder of the scans.
    pub data: Option<PathBuf>,
    pub out: PathBuf,
    pub only: Option<String>,
    /// Whole repeats of every row; of `seeds` a tenth.
    pub repeats: u64,
    /// Keep the rows that there are.
    pub resume: bool,
    /// Small and few.
    pub quick: bool,
}

impl Options {
    fn read(arguments: impl IntoIterator<Item = String>) -> Outcome<Self> {
        let (mut data, mut out, mut only, mut repeats, mut resume, mut quick) = (None, None, None, None, false, false);
        let mut arguments = arguments.into_iter();
        while let Some(name) = arguments.next() {
            match name.as_str() {
                "--resume" => resume = true,
                "--quick" => quick = true,
                "--data" | "--out" | "--only" | "--repeats" => {
                    let value = arguments.next().ok_or_else(|| format!("{name} needs a value"))?;
                    match name.as_str() {
                        "--data" => data = Some(PathBuf::from(value)),
                        "--out" => out = Some(PathBuf::from(value)),
                        "--only" if PARTS.contains(&value.as_str()) => only = Some(value),
                        "--only" => return Err(format!("--only takes one of {}", PARTS.join(", ")).into()),
                        _ => repeats = Some(whole(&value)?),
                    }
                }
                _ => return Err(format!("unknown option '{name}'; {USAGE}").into()),
            }
        }
        let out = out.ok_or_else(|| format!("--out DIR is missing; {USAGE}"))?;
        let repeats = repeats.unwrap_or(if quick { 40 } else { 1000 });
        Ok(Self { data: data.filter(|_| !quick), out, only, repeats, resume, quick })
    }

    fn wants(&self, part: &str) -> bool {
        self.only.as_ref().is_none_or(|o| o == part)
    }
}

/// A number of repeats that has a spread.
fn whole(value: &str) -> Outcome<u64> {
    let number = value.parse().ok().filter(|n| (10..=1_000_000).contains(n));
    Ok(number.ok_or_else(|| format!("--repeats is '{value}': expected a whole number from 10 to 1000000"))?)
}

fn main() -> Outcome<()> {
    let options = Options::read(std::env::args().skip(1))?;
    std::fs::create_dir_all(&options.out)?;
    if options.wants("coverage") {
        coverage::measure(&options)?;
    }
    if options.wants("stopping") {
        stopping::measure(&options)?;
    }
    if options.wants("seeds") {
        seeds::measure(&options)?;
    }
    page::write(&options.out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(words: &str) -> Result<Options, String> {
        Options::read(words.split_whitespace().map(String::from)).map_err(|e| e.to_string())
    }

    #[test]
    fn the_command_line_is_understood_or_refused_by_name() {
        let o = read("--out o --data d --only seeds --repeats 50 --resume").unwrap();
        assert!(o.resume && !o.quick && o.repeats == 50 && o.wants("seeds") && !o.wants("coverage"));
        assert!(read("--out o --quick --data d").unwrap().data.is_none());
        for (words, named) in [
            ("--only table", "--only"),
            ("--repeats 3", "'3'"),
            ("--out", "--out"),
            ("", "--out"),
            ("--outt o", "--outt"),
        ] {
            let said = read(words).err().unwrap();
            assert!(said.contains(named), "{words}: {said}");
        }
    }

    /// All of it on the phantom, with the fewest repeats.
    #[test]
    fn every_part_runs_resumes_and_leaves_a_page() {
        let out = tempfile::tempdir().unwrap();
        let mut options = read(&format!("--out {} --quick --repeats 10", out.path().display())).unwrap();
        coverage::measure(&options).unwrap();
        stopping::measure(&options).unwrap();
        seeds::measure(&options).unwrap();
        page::write(&options.out).unwrap();
        let page = std::fs::read_to_string(out.path().join("README.md")).unwrap();
        for part in ["## Coverage", "## Stopping", "## Seeds", "not for quoting"] {
            assert!(page.contains(part), "{part}");
        }
        options.resume = true;
        let before = std::fs::read(out.path().join("coverage.json")).unwrap();
        coverage::measure(&options).unwrap();
        assert_eq!(std::fs::read(out.path().join("coverage.json")).unwrap(), before);
    }
}
