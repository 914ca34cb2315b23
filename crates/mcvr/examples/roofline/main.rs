//! How near the hot loops of sampling and projection come to what this machine's memory allows, measured in the same run.
//!
//! `cargo run --release -p mcvr --example roofline -- [--data DIR] [--json FILE] [--markdown FILE] [--threads 1,2] [--samples 24]
//! [--rounds 7] [--only WORD]` prints a table. DIR holds the scans of README's "Real scans" and the lobster is taken from there;
//! without it the loops run on the phantom of it. `--samples` is a power of two; `--only` takes the rows whose name has the word.
//!
//! Rows are run in turn, round after round, every other round backwards, so that whatever else the machine does falls on all
//! alike. Given are the median and the range of processor time (all threads together) per unit of work, and the median of wall
//! time. On a busy machine wall time says nothing; processor time says what one core does while its caches are shared.
#![allow(missing_docs, reason = "a program, not a library")]

mod clock;
mod limits;
mod loops;
mod options;
mod table;

use std::io::Write;
use std::path::Path;

use options::Options;

/// Any failure.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// Work that is timed as a whole: says how many units it has done.
pub type Work<'a> = Box<dyn FnMut() -> Outcome<u64> + Send + 'a>;

/// What stands in one line of the table.
pub struct Entry<'a> {
    pub name: String,
    /// What a unit of work is: `point`, `byte`, `increment`, `voxel`.
    pub unit: &'static str,
    pub threads: usize,
    /// The name of the limit that this loop is held to: a row of the same table with as many threads, and how many of its units
    /// one unit of this loop needs.
    pub limit: Option<(&'static str, f64)>,
    pub work: Work<'a>,
}

fn main() -> Outcome<()> {
    run(&Options::read(std::env::args().skip(1))?)
}

fn run(options: &Options) -> Outcome<()> {
    let scene = loops::Scene::load(options)?;
    let parts = scene.parts(options.samples)?;
    let mut entries = vec![];
    for &threads in &options.threads {
        entries.extend(limits::entries(threads));
        entries.extend(loops::entries(&scene, &parts, options, threads)?);
    }
    if let Some(word) = &options.only {
        entries.retain(|e| e.name.contains(word.as_str()));
    }
    let rows = clock::measure(entries, options.rounds)?;
    let table = table::Table { scene: scene.described(), samples: options.samples, rounds: options.rounds, rows };
    println!("{}", table.markdown());
    if let Some(path) = &options.markdown {
        write(path, table.markdown().as_bytes())?;
    }
    if let Some(path) = &options.json {
        write(path, &serde_json::to_vec_pretty(&table)?)?;
    }
    Ok(())
}

/// Whole or not at all.
fn write(path: &Path, bytes: &[u8]) -> Outcome<()> {
    mcvr::volume::write_whole(path, |out| out.write_all(bytes)).map_err(|e| format!("{}: {e}", path.display()).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All of it, small.
    #[test]
    fn every_row_is_measured_and_every_limit_is_a_row() {
        let folder = tempfile::tempdir().expect("a folder");
        let (json, page) = (folder.path().join("a.json"), folder.path().join("a.md"));
        let words = ["--samples", "12", "--rounds", "1", "--phantom", "24", "--json"].map(str::to_owned);
        let words =
            words.into_iter().chain([json.display().to_string(), "--markdown".into(), page.display().to_string()]);
        run(&Options::read(words).expect("options")).expect("a table");
        let record: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).expect("a file")).expect("JSON");
        let rows = record["rows"].as_array().expect("rows");
        assert!(rows.len() > 20);
        for row in rows {
            assert!(row["cpu_ns"][1].as_f64().expect("a number") > 0.0, "{row}");
            if let Some(name) = row["limit"].as_str() {
                let same = |r: &&serde_json::Value| r["name"] == name && r["threads"] == row["threads"];
                assert_eq!(rows.iter().filter(same).count(), 1, "{row}");
            }
        }
        assert!(std::fs::read_to_string(&page).expect("a page").contains("| random increments, 400×400 |"));
    }
}
