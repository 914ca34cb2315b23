//! The committed baseline: a folder with `accuracy.json` and `instructions.json`, and `time-<machine class>.json` for every
//! class of machines that has been measured.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use mcvr_harness::history::{machine_class, slug};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::BenchError;
use super::accuracy::Figure;

/// Images and counters: the same on every machine.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccuracyBaseline {
    /// Class of the machine that measured it; not compared.
    pub machine: String,
    /// Cases by name.
    pub cases: BTreeMap<String, Figure>,
}

/// Instructions: the same wherever the same compiler made the program and the same vector instructions run.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InstructionBaseline {
    /// What compiled the program.
    pub compiler: String,
    /// Vector instructions that ran under callgrind.
    pub simd: String,
    /// Valgrind's version; not compared.
    pub valgrind: String,
    /// Stages by name.
    pub stages: BTreeMap<String, StageInstructions>,
}

/// Instructions of a stage.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageInstructions {
    /// All of one run.
    pub instructions: u64,
    /// The costliest functions' own.
    pub functions: BTreeMap<String, u64>,
}

/// Seconds of one run of each stage on one class of machines.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeBaseline {
    /// The class: processor and cores.
    pub machine: String,
    /// Vector instructions that ran.
    pub simd: String,
    /// Seconds by stage.
    pub seconds: BTreeMap<String, f64>,
}

/// The folder.
#[derive(Clone, Debug)]
pub struct Baseline {
    folder: PathBuf,
}

impl Baseline {
    /// A folder, there or not.
    pub fn at(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    /// The file of the accuracy cases.
    pub fn accuracy_file(&self) -> PathBuf {
        self.folder.join("accuracy.json")
    }

    /// The file of the instruction counts.
    pub fn instructions_file(&self) -> PathBuf {
        self.folder.join("instructions.json")
    }

    /// The file of this machine class's times.
    pub fn time_file(&self) -> PathBuf {
        self.folder.join(format!("time-{}.json", slug(&machine_class(&mcvr_harness::machine()))))
    }

    /// The classes of machines that have times, by the files' names.
    pub fn classes(&self) -> Vec<String> {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let names = entries.map(|e| e.file_name().to_string_lossy().into_owned());
        let class = |name: String| Some(name.strip_prefix("time-")?.strip_suffix(".json")?.to_owned());
        let mut classes: Vec<String> = names.filter_map(class).collect();
        classes.sort();
        classes
    }

    /// Reads one of its files; `None` where it is not there.
    ///
    /// # Errors
    /// [`BenchError::File`] when it cannot be read or is no such baseline.
    pub fn read<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, BenchError> {
        if !path.try_exists().map_err(|e| BenchError::file(path, e))? {
            return Ok(None);
        }
        let text = mcvr_volume::read_text(path, LARGEST).map_err(|e| BenchError::file(path, e))?;
        let parsed = serde_json::from_str(&text);
        parsed.map(Some).map_err(|e| {
            BenchError::file(
                path,
                format!("this is no baseline of this version ({e}); `mcvr bench --accept` makes it anew"),
            )
        })
    }

    /// Writes one of its files, whole or not at all; makes the folder.
    ///
    /// # Errors
    /// [`BenchError::File`].
    pub fn write<T: Serialize>(path: &Path, value: &T) -> Result<(), BenchError> {
        let mut text = serde_json::to_string_pretty(value).map_err(|e| BenchError::file(path, e))?;
        text.push('\n');
        let folder = path.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).map_err(|e| BenchError::file(folder, e))?;
        mcvr_volume::write_whole(path, |out| out.write_all(text.as_bytes())).map_err(|e| BenchError::file(path, e))
    }
}

/// Most bytes of a baseline file.
const LARGEST: u64 = 64 << 20;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_baseline_comes_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sub/accuracy.json");
        assert!(Baseline::read::<AccuracyBaseline>(&path).unwrap().is_none());
        let figure = Figure {
            sha256: "ab".into(),
            mean: 0.1 + 0.2,
            error: Some(f64::from_bits(0x3fb9_9999_9999_999b)),
            bias: Some(-5e-324),
            counters: BTreeMap::from([("render.samples".into(), serde_json::json!(u64::MAX))]),
        };
        let written = AccuracyBaseline { machine: "m".into(), cases: BTreeMap::from([("a".to_owned(), figure)]) };
        Baseline::write(&path, &written).unwrap();
        let read: AccuracyBaseline = Baseline::read(&path).unwrap().unwrap();
        assert_eq!(read.cases, written.cases);
    }

    #[test]
    fn a_file_of_something_else_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("accuracy.json");
        for text in ["", "{", "[1]", "{\"machine\": 3}", "{\"machine\": \"m\", \"cases\": {}, \"more\": 1}"] {
            std::fs::write(&path, text).unwrap();
            let error = Baseline::read::<AccuracyBaseline>(&path).unwrap_err().to_string();
            assert!(error.contains("accuracy.json") && error.contains("--accept"), "{error}");
        }
    }
}
