//! Rows of one part, on disk after each.

use std::io::Write as _;
use std::path::Path;

use mcvr::volume::write_whole;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::{Options, Outcome, page};

/// The rows of a part and where they were measured.
#[derive(Debug, Serialize, Deserialize)]
pub struct Records<R> {
    pub machine: String,
    pub commit: Option<String>,
    pub threads: usize,
    pub quick: bool,
    pub rows: Vec<Keyed<R>>,
}

/// A row under the words that say all of its settings.
#[derive(Debug, Serialize, Deserialize)]
pub struct Keyed<R> {
    pub key: String,
    #[serde(flatten)]
    pub row: R,
}

impl<R: Serialize + DeserializeOwned> Records<R> {
    /// The rows so far, if there are any.
    pub fn read(out: &Path, part: &str) -> Outcome<Option<Self>> {
        let path = out.join(format!("{part}.json"));
        match std::fs::read_to_string(&path) {
            Ok(text) => match serde_json::from_str(&text) {
                Ok(records) => Ok(Some(records)),
                Err(e) => Err(format!("{}: {e}; remove the file to measure anew", path.display()).into()),
            },
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(e) => Err(format!("{}: {e}", path.display()).into()),
        }
    }

    /// Rows to add to: those that there are, with `--resume`.
    pub fn open(options: &Options, part: &str) -> Outcome<Self> {
        let before = if options.resume { Self::read(&options.out, part)? } else { None };
        let rows = before.filter(|b| b.quick == options.quick).map_or(vec![], |b| b.rows);
        let machine = mcvr::harness::machine().to_string();
        let (commit, threads) = (mcvr::harness::git_commit(), rayon::current_num_threads());
        Ok(Self { machine, commit, threads, quick: options.quick, rows })
    }

    /// Measures a row unless it is there, and writes all rows and the page.
    pub fn row(
        &mut self,
        options: &Options,
        part: &str,
        key: &str,
        measure: impl FnOnce() -> Outcome<R>,
    ) -> Outcome<()> {
        if self.rows.iter().any(|r| r.key == key) {
            eprintln!("{part}: {key}: kept");
            return Ok(());
        }
        let start = std::time::Instant::now();
        let row = measure()?;
        self.rows.push(Keyed { key: key.to_owned(), row });
        let text = serde_json::to_string_pretty(self)? + "\n";
        write_whole(&options.out.join(format!("{part}.json")), |f| f.write_all(text.as_bytes()))?;
        eprintln!("{part}: {key}: {:.1} s", start.elapsed().as_secs_f64());
        page::write(&options.out)
    }
}
