//! The measurements, one JSON object a line, on disk as soon as they are made.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::Outcome;

/// Which method at how many samples of which scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Key {
    pub scan: String,
    pub view: String,
    pub method: String,
    /// `M = 2^level`.
    pub level: u32,
}

/// Where and from what something was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Circumstances {
    pub machine: String,
    pub commit: Option<String>,
    pub threads: usize,
    pub quick: bool,
}

impl Circumstances {
    pub fn now(quick: bool) -> Self {
        Self {
            machine: mcvr::harness::machine(),
            commit: mcvr::harness::git_commit(),
            threads: rayon::current_num_threads(),
            quick,
        }
    }
}

/// A line of the log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "part", rename_all = "lowercase")]
pub enum Record {
    /// What was looked at, and from where.
    Scene {
        scan: String,
        view: String,
        described: String,
        angles: [f64; 2],
        depth_axis: String,
        drawable: u64,
        mean: f64,
    },
    /// RMSE over the mean pixel by the spread of replicates, and its standard error.
    Error {
        #[serde(flatten)]
        key: Key,
        replicates: usize,
        rel_rmse: f64,
        standard_error: f64,
        #[serde(flatten)]
        circumstances: Circumstances,
    },
    /// Square of the bias against the truth, over the variance of one image.
    Bias {
        #[serde(flatten)]
        key: Key,
        ratio: f64,
        standard_error: f64,
        /// The truth's own squared error over that variance, and its RMSE over the mean pixel.
        truth_ratio: f64,
        truth_error: f64,
    },
    /// Seconds of images, in the order in which they were made; seconds of the distribution.
    Time {
        #[serde(flatten)]
        key: Key,
        seconds: Vec<f64>,
        distribution: f64,
        #[serde(flatten)]
        circumstances: Circumstances,
    },
}

impl Record {
    pub fn scan(&self) -> &str {
        match self {
            Self::Scene { scan, .. } => scan,
            Self::Error { key, .. } | Self::Bias { key, .. } | Self::Time { key, .. } => &key.scan,
        }
    }

    pub fn is_time(&self) -> bool {
        matches!(self, Self::Time { .. })
    }
}

/// The file and what it holds.
pub struct Log {
    path: PathBuf,
    records: Vec<Record>,
}

impl Log {
    /// Reads what there is; a last line that a kill tore is cut off.
    pub fn open(path: &Path) -> Outcome<Self> {
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(e) => return Err(format!("{}: {e}", path.display()).into()),
        };
        let mut records = vec![];
        for (n, line) in text.split_inclusive('\n').enumerate() {
            if line.ends_with('\n') {
                records
                    .push(serde_json::from_str(line).map_err(|e| format!("{}, line {}: {e}", path.display(), n + 1))?);
            }
        }
        let log = Self { path: path.to_owned(), records };
        if !text.is_empty() && !text.ends_with('\n') {
            log.rewrite()?;
        }
        Ok(log)
    }

    pub fn records(&self) -> &[Record] {
        &self.records
    }

    pub fn append(&mut self, record: Record) -> Outcome<()> {
        let mut file = std::fs::File::options().append(true).create(true).open(&self.path)?;
        file.write_all((serde_json::to_string(&record)? + "\n").as_bytes())?;
        self.records.push(record);
        Ok(())
    }

    /// Drops the records that are to be measured again.
    pub fn forget(&mut self, again: impl Fn(&Record) -> bool) -> Outcome<()> {
        let before = self.records.len();
        self.records.retain(|r| !again(r));
        if self.records.len() < before { self.rewrite() } else { Ok(()) }
    }

    fn rewrite(&self) -> Outcome<()> {
        let mut text = String::new();
        for record in &self.records {
            text += &(serde_json::to_string(record)? + "\n");
        }
        Ok(mcvr::volume::write_whole(&self.path, |out| out.write_all(text.as_bytes()))?)
    }
}
