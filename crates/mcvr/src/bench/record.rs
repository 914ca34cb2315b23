//! What a run leaves in the history.

use std::collections::BTreeMap;

use mcvr_harness::history::{self, machine_class};
use serde::{Deserialize, Serialize};

use super::AccuracyRun;
use super::Counted;

/// Where, when and from what a run came.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// When, `2026-11-22T11:05:10Z`.
    pub date: String,
    /// Processor and cores.
    pub machine: String,
    /// Source revision; `unknown` where nothing tells.
    pub commit: String,
    /// Version of the program.
    pub version: String,
    /// What compiled it.
    pub compiler: String,
}

impl Provenance {
    /// Of this program, here and now.
    pub fn now() -> Self {
        Self {
            date: history::now(),
            machine: machine_class(&mcvr_harness::machine()),
            commit: mcvr_harness::git_commit().unwrap_or_else(|| "unknown".into()),
            version: env!("CARGO_PKG_VERSION").into(),
            compiler: super::COMPILER.into(),
        }
    }
}

/// The figures of a run by metric: `error/CASE` (relative RMSE), `instructions/STAGE`, `time/STAGE` (ns per element).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HistoryRecord {
    /// Where it comes from.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Figures by metric.
    pub metrics: BTreeMap<String, f64>,
}

impl HistoryRecord {
    /// What was measured; `elements` are those of one run of each stage.
    pub fn new(
        accuracy: Option<&AccuracyRun>,
        instructions: &BTreeMap<String, Counted>,
        seconds: &BTreeMap<String, f64>,
        elements: &BTreeMap<String, u64>,
    ) -> Self {
        let mut metrics = BTreeMap::new();
        for (case, figure) in accuracy.iter().flat_map(|a| &a.figures) {
            if let Some(error) = figure.error {
                metrics.insert(format!("error/{}", case.name), error);
            }
        }
        for (stage, counted) in instructions {
            metrics.insert(format!("instructions/{stage}"), counted.instructions as f64);
        }
        for (stage, seconds) in seconds {
            let elements = elements.get(stage).copied().unwrap_or(1).max(1) as f64;
            metrics.insert(format!("time/{stage}"), 1e9 * seconds / elements);
        }
        Self { provenance: Provenance::now(), metrics }
    }

    /// `<date>-<machine class>-<commit>.json`.
    pub fn file_name(&self) -> String {
        let p = &self.provenance;
        format!("{}-{}-{}.json", &p.date[..p.date.len().min(10)], history::slug(&p.machine), history::slug(&p.commit))
    }
}
