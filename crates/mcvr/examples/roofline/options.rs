//! The command line.

use std::path::PathBuf;

use crate::Outcome;

const USAGE: &str = "options are --data DIR, --json FILE, --markdown FILE, --threads 1,2, --samples POWER (10 to 28), \
                     --rounds N, --only WORD, --phantom SIDE";

/// What was asked for.
pub struct Options {
    pub data: Option<PathBuf>,
    pub json: Option<PathBuf>,
    pub markdown: Option<PathBuf>,
    pub threads: Vec<usize>,
    pub samples: u64,
    pub rounds: usize,
    pub only: Option<String>,
    /// Side of the phantom that stands in for the scan.
    pub phantom: usize,
}

impl Options {
    pub fn read(mut words: impl Iterator<Item = String>) -> Outcome<Self> {
        let mut options = Self {
            data: None,
            json: None,
            markdown: None,
            threads: vec![1, 2],
            samples: 1 << 24,
            rounds: 7,
            only: None,
            phantom: 256,
        };
        while let Some(name) = words.next() {
            let value = words.next().ok_or_else(|| format!("{name} needs a value; {USAGE}"))?;
            let number = |low: usize, high: usize| {
                let n = value.parse().ok().filter(|n| (low..=high).contains(n));
                n.ok_or_else(|| format!("{name} takes a number from {low} to {high}, not '{value}'"))
            };
            match name.as_str() {
                "--data" => options.data = Some(value.into()),
                "--json" => options.json = Some(value.into()),
                "--markdown" => options.markdown = Some(value.into()),
                "--only" => options.only = Some(value),
                "--rounds" => options.rounds = number(1, 1000)?,
                "--phantom" => options.phantom = number(8, 1024)?,
                "--samples" => options.samples = 1 << number(10, 28)?,
                "--threads" => {
                    let threads: Option<Vec<usize>> =
                        value.split(',').map(|t| t.parse().ok().filter(|t| (1..=256).contains(t))).collect();
                    options.threads =
                        threads.ok_or_else(|| format!("--threads takes numbers from 1 to 256, not '{value}'"))?;
                }
                _ => return Err(format!("unknown option '{name}'; {USAGE}").into()),
            }
        }
        Ok(options)
    }
}
