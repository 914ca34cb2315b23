//! Other systems beside the methods: points of a record that `scripts/peers` measured on the same scan, view and size.

use std::path::Path;

use mcvr_volume::read_text;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::plots::threads;
use super::summary::{CostSummary, SubjectInfo};
use super::tables::target_words;
use crate::format::{percent, seconds};
use crate::report::Block;
use crate::{HarnessError, Spread};

/// The form of the record's lines that this program reads.
pub const PEERS_RECORD: &str = "mcvr peers 1";

/// Longest record that is read, bytes.
const LIMIT: u64 = 1 << 26;

/// Numbers of a subject may differ by so much relative to the larger one: they went through decimal text and back.
const SAME: f64 = 1e-9;

/// One setting of another system, measured in turn with others.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PeerPoint {
    /// Name of the volume.
    pub dataset: String,
    /// The system and its algorithm, for example `RTK Joseph`.
    pub system: String,
    /// Its version.
    pub version: String,
    /// Its setting in words.
    pub setting: String,
    /// Threads.
    pub threads: usize,
    /// Views measured.
    pub views: u64,
    /// Seconds of a view: the volume in memory, the image too.
    pub seconds: Spread,
    /// RMSE over the mean pixel, against the same truth as the methods': the mean over each pixel's area.
    pub error: f64,
    /// RMSE over the mean pixel against the exact integral of the system's own field along the rays that it casts; `None` where
    /// that is not known (several rays a pixel).
    pub own_error: Option<f64>,
    /// Where it was measured.
    pub machine: String,
}

/// A line of the record, as far as it is used here.
#[derive(Deserialize)]
struct Line {
    record: String,
    subject: Value,
    system: String,
    version: String,
    setting: String,
    threads: usize,
    seconds: Seconds,
    views: u64,
    in_rounds: bool,
    error: f64,
    own_error: Option<f64>,
    own_field: Option<String>,
    machine: String,
}

#[derive(Deserialize)]
struct Seconds {
    median: f64,
    min: f64,
    max: f64,
}

/// Reads the other systems' points of a subject from a record of `scripts/peers` (JSON lines). `subject` is what
/// `mcvr export` writes under that name: dataset, volume, camera, mass, kernel, estimand. Settings that were only tried, and
/// this program's own lines, are left out.
///
/// # Errors
/// [`HarnessError::File`] when the file cannot be read, a line is malformed, no line is of this scan, or a line of it was
/// measured of another volume, camera, size, density map, kernel or estimand.
pub fn read_peers(path: &Path, subject: &Value) -> Result<Vec<PeerPoint>, HarnessError> {
    let fail = |problem: String| HarnessError::file(path, problem);
    let text = read_text(path, LIMIT).map_err(|e| fail(e.to_string()))?;
    let dataset = subject["dataset"].as_str().unwrap_or_default();
    let (mut points, mut others) = (Vec::new(), Vec::new());
    for (number, text) in text.lines().enumerate().filter(|(_, text)| !text.trim().is_empty()) {
        let place = format!("line {}", number + 1);
        let value: Value = serde_json::from_str(text).map_err(|e| fail(format!("{place}: {e}")))?;
        if value["record"] != PEERS_RECORD {
            let found = &value["record"];
            return Err(fail(format!(
                "{place}: record is {found}, and \"{PEERS_RECORD}\" is needed; measure again with scripts/peers"
            )));
        }
        let line: Line = serde_json::from_value(value).map_err(|e| fail(format!("{place}: {e}")))?;
        debug_assert_eq!(line.record, PEERS_RECORD);
        let name = line.subject["dataset"].as_str().unwrap_or_default().to_owned();
        if name != dataset {
            others.push(name);
            continue;
        }
        if let Some((field, there, here)) = difference(&line.subject, subject, "") {
            return Err(fail(format!(
                "{place}: measured of another subject: {field} is {there} there and {here} here; measure again with \
                 scripts/peers, or give this command the same view and size"
            )));
        }
        points.extend(point(line, &place).map_err(fail)?);
    }
    if points.is_empty() {
        others.sort_unstable();
        others.dedup();
        let of = if others.is_empty() { "nothing".to_owned() } else { others.join(", ") };
        return Err(fail(format!("holds no other system's views of {dataset}; it is of {of}")));
    }
    Ok(points)
}

/// The point of a line; `None` for this program's own lines and for settings that were only tried.
fn point(line: Line, place: &str) -> Result<Option<PeerPoint>, String> {
    if line.own_field.is_none() || !line.in_rounds {
        return Ok(None);
    }
    let Seconds { median, min, max } = line.seconds;
    for (field, value) in
        [("seconds.median", median), ("seconds.min", min), ("seconds.max", max), ("error", line.error)]
    {
        if !(value > 0.0 && value.is_finite()) {
            return Err(format!("{place}: {field} is {value}; a positive number is needed"));
        }
    }
    if !(min <= median && median <= max) {
        return Err(format!(
            "{place}: seconds.median {median} does not lie between seconds.min {min} and seconds.max {max}"
        ));
    }
    Ok(Some(PeerPoint {
        dataset: line.subject["dataset"].as_str().unwrap_or_default().to_owned(),
        system: line.system,
        version: line.version,
        setting: line.setting,
        threads: line.threads,
        views: line.views,
        seconds: Spread { median, min, max },
        error: line.error,
        own_error: line.own_error,
        machine: line.machine,
    }))
}

/// The first field in which two subjects differ, with both values.
fn difference(there: &Value, here: &Value, path: &str) -> Option<(String, String, String)> {
    let differs = || Some((path.to_owned(), there.to_string(), here.to_string()));
    match (there, here) {
        (Value::Object(a), Value::Object(b)) => {
            let mut keys: Vec<&String> = a.keys().chain(b.keys()).collect();
            keys.sort_unstable();
            keys.dedup();
            let inner = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
            keys.into_iter().find_map(|key| difference(&there[key], &here[key], &inner(key)))
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            let pairs = a.iter().zip(b).enumerate();
            pairs.into_iter().find_map(|(i, (a, b))| difference(a, b, &format!("{path}[{i}]")))
        }
        (Value::Number(_), Value::Number(_)) => {
            let (a, b) = (there.as_f64()?, here.as_f64()?);
            // Entries that ought to be 0 come out as rounding.
            if (a - b).abs() <= SAME * a.abs().max(b.abs()).max(1e-3) { None } else { differs() }
        }
        _ if there == here => None,
        _ => differs(),
    }
}

impl CostSummary {
    /// The other systems' points of a subject on so many threads, quickest first.
    pub(crate) fn peers_of(&self, subject: &SubjectInfo, lane: usize) -> Vec<&PeerPoint> {
        let mine = self.peers.iter().filter(|p| p.dataset == subject.dataset && p.threads == lane);
        let mut mine: Vec<&PeerPoint> = mine.collect();
        mine.sort_by(|a, b| a.seconds.median.total_cmp(&b.seconds.median));
        mine
    }
}

/// The systems among points, in the order in which they come, each with its points.
pub(crate) fn systems<'a>(points: &[&'a PeerPoint]) -> Vec<(&'a str, Vec<&'a PeerPoint>)> {
    let mut names: Vec<&str> = points.iter().map(|p| p.system.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    names.into_iter().map(|n| (n, points.iter().copied().filter(|p| p.system == n).collect())).collect()
}

/// A system with its version and threads.
pub(crate) fn name(point: &PeerPoint) -> String {
    format!("{} {}, {}", point.system, point.version, threads(point.threads))
}

/// The quickest of some points that reach an error which the truth can judge.
pub(crate) fn quickest<'a>(points: &[&'a PeerPoint], target: f64, floor: f64) -> Option<&'a PeerPoint> {
    let good = points.iter().copied().filter(|p| p.error <= target && target >= floor);
    good.min_by(|a, b| a.seconds.median.total_cmp(&b.seconds.median))
}

/// At which errors another system is quicker than every method here; `None` without other systems.
pub(crate) fn line(run: &CostSummary, subject: &SubjectInfo, lane: usize) -> Option<String> {
    let points = run.peers_of(subject, lane);
    let floor = super::summary::floor(subject.truth.as_ref()?.rel_error_estimate);
    if points.is_empty() {
        return None;
    }
    let ahead = run.targets.iter().filter_map(|&target| {
        let peer = quickest(&points, target, floor)?;
        let mine = run
            .reaches
            .iter()
            .find(|r| r.dataset == subject.dataset && r.threads == lane && r.target == target && r.fastest[0]);
        let mine = mine.and_then(|r| r.totals).map_or(f64::INFINITY, |t| t[0]);
        let time = peer.seconds.median;
        (time < mine).then(|| format!("{}: {}, {}", target_words(target), peer.system, seconds(time)))
    });
    let ahead: Vec<String> = ahead.collect();
    Some(match &ahead[..] {
        [] => "No other system measured is quicker at any of these errors.".to_owned(),
        ahead => format!("Quicker among other systems, measured apart, to {}.", ahead.join("; to ")),
    })
}

/// What was measured of other systems, as blocks; none without any.
pub(crate) fn blocks(run: &CostSummary, subject: &SubjectInfo, blocks: &mut Vec<Block>) {
    let lanes = || run.meta.threads.iter().rev().map(|&lane| run.peers_of(subject, lane));
    let machines: Vec<&str> = lanes().flatten().map(|p| p.machine.as_str()).collect();
    let Some(machine) = machines.first() else { return };
    blocks.push(Block::Subheading("Other systems".into()));
    blocks.push(Block::Text(format!(
        "Measured by scripts/peers on this scan, view and size, in turn with each other and apart from this run, on {machine}. Times are \
         those of a view, from the weights as 32-bit floats in memory to the image in memory; what a system prepares once for a \
         volume is not in them. “Error” is against the same truth as above, the mean over each pixel's area; “own error” against the \
         exact integral of the system's own field (trilinear or nearest neighbour) along the one ray of each pixel."
    )));
    let rows = lanes().flatten().map(|p| {
        vec![
            name(p),
            p.setting.clone(),
            crate::report::with_ends(p.seconds),
            percent(p.error),
            p.own_error.map_or("–".to_owned(), percent),
            p.views.to_string(),
        ]
    });
    let head = ["System", "Setting", "A view", "Error", "Own error", "Views"];
    blocks.push(Block::Table { head: head.map(str::to_owned).to_vec(), names: 2, rows: rows.collect() });
}
