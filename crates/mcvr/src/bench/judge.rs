//! Images, counters and instructions held to the baseline.

use std::collections::BTreeMap;

use mcvr_scene::Watch;
use serde_json::Value;

use super::accuracy::{Case, Figure, Studio};
use super::baseline::StageInstructions;
use super::report::{Check, Line, Section, Verdict};
use super::{BenchError, Counted, INSTRUCTION_TOLERANCE, diagnosis};

/// The accuracy cases as measured now.
#[derive(Debug)]
pub struct AccuracyRun {
    /// Cases with their figures.
    pub figures: Vec<(Case, Figure)>,
    /// What probably changed, by case.
    pub notes: BTreeMap<String, String>,
}

impl AccuracyRun {
    /// Makes the images; where one differs from the baseline, looks for what changed. `watch` hears of every case.
    ///
    /// # Errors
    /// What a case said, and [`BenchError::Cancelled`].
    pub fn new(cases: Vec<Case>, baseline: &BTreeMap<String, Figure>, watch: &Watch<'_>) -> Result<Self, BenchError> {
        let mut studio = Studio::new()?;
        let quiet = Watch { progress: None, cancel: watch.cancel };
        let (mut figures, mut notes) = (vec![], BTreeMap::new());
        for case in cases {
            let now = studio.figure(&case, &quiet)?;
            if let Some(before) = baseline.get(&case.name).filter(|b| !b.same_image(&now)) {
                notes.insert(case.name.clone(), diagnosis::diagnose(&mut studio, &case, before, &now, &quiet)?);
            }
            figures.push((case, now));
            watch.advance(1);
        }
        Ok(Self { figures, notes })
    }

    /// By name, for a new baseline.
    pub fn by_name(&self) -> BTreeMap<String, Figure> {
        self.figures.iter().map(|(case, figure)| (case.name.clone(), figure.clone())).collect()
    }

    /// Names that changed although only `mc` did, whose logarithms are the system's.
    fn only_mc_changed(&self) -> bool {
        !self.notes.is_empty() && self.notes.keys().all(|name| name.starts_with("mc/"))
    }
}

impl Figure {
    /// The same image with the same error, bit for bit.
    pub(super) fn same_image(&self, other: &Figure) -> bool {
        let bits = |v: Option<f64>| v.map(f64::to_bits);
        self.sha256 == other.sha256
            && self.mean.to_bits() == other.mean.to_bits()
            && bits(self.error) == bits(other.error)
            && bits(self.bias) == bits(other.bias)
    }

    fn words(&self) -> String {
        let error = self.error.map_or("no truth".into(), |e| format!("error {:.4} %", 100.0 * e));
        format!("{error}, {}", &self.sha256[..self.sha256.len().min(8)])
    }
}

/// Images and errors. `whole` says that all cases were made, so that one which only the baseline has is lost.
pub fn judge_accuracy(
    baseline: &BTreeMap<String, Figure>,
    machine: [&str; 2],
    run: &AccuracyRun,
    whole: bool,
) -> Section {
    let mut section = Section::new(Check::Accuracy);
    for (case, now) in &run.figures {
        let before = baseline.get(&case.name);
        let verdict = match before {
            None => Verdict::New,
            Some(before) if before.same_image(now) => Verdict::Same,
            Some(_) => Verdict::Worse,
        };
        let change = match before.and_then(|b| b.error).zip(now.error) {
            Some((a, b)) if a.to_bits() != b.to_bits() => format!("error ×{:.4}", b / a),
            _ => String::new(),
        };
        section.lines.push(Line {
            name: case.name.clone(),
            baseline: before.map_or(String::new(), Figure::words),
            now: now.words(),
            change,
            verdict,
            note: run.notes.get(&case.name).cloned().unwrap_or_default(),
        });
    }
    gone(&mut section, baseline.keys(), |name| run.figures.iter().any(|(c, _)| c.name == name), whole);
    if machine[0] != machine[1] && run.only_mc_changed() {
        section.notice(format!(
            "only mc differs, and the baseline is of another machine ({}): mc takes logarithms of the system's library, which may \
             round differently there; all other images are the same everywhere",
            machine[0]
        ));
    }
    section
}

/// Work counters of the same images.
pub fn judge_work(baseline: &BTreeMap<String, Figure>, run: &AccuracyRun) -> Section {
    let mut section = Section::new(Check::Work);
    for (case, now) in &run.figures {
        let line = |name: String, baseline: String, now: String, change: String, verdict| Line {
            name,
            baseline,
            now,
            change,
            verdict,
            note: String::new(),
        };
        let Some(before) = baseline.get(&case.name) else {
            let counters = format!("{} counters", now.counters.len());
            section.lines.push(line(case.name.clone(), String::new(), counters, String::new(), Verdict::New));
            continue;
        };
        let names: std::collections::BTreeSet<&String> = before.counters.keys().chain(now.counters.keys()).collect();
        let moved: Vec<&String> =
            names.into_iter().filter(|n| before.counters.get(*n) != now.counters.get(*n)).collect();
        if moved.is_empty() {
            let counters = format!("{} counters", now.counters.len());
            section.lines.push(line(case.name.clone(), counters.clone(), counters, String::new(), Verdict::Same));
        }
        for name in moved {
            let [a, b] = [before, now].map(|f| f.counters.get(name));
            let words = |v: Option<&Value>| v.map_or("absent".to_owned(), Value::to_string);
            let change = match a.and_then(Value::as_f64).zip(b.and_then(Value::as_f64)) {
                Some((a, b)) if a != 0.0 => format!("{:+.3} %", 100.0 * (b / a - 1.0)),
                _ => String::new(),
            };
            let verdict = if a.is_none() { Verdict::New } else { Verdict::Worse };
            section.lines.push(line(format!("{} {name}", case.name), words(a), words(b), change, verdict));
        }
    }
    section
}

/// Instructions by stage. `comparable` says that the same compiler made both programs and the same vector code ran.
pub fn judge_instructions(
    baseline: &BTreeMap<String, StageInstructions>,
    now: &BTreeMap<String, Counted>,
    comparable: bool,
    whole: bool,
) -> Section {
    let mut section = Section::new(Check::Instructions);
    section.judged = comparable;
    for (name, counted) in now {
        let before = baseline.get(name);
        // The difference of whole numbers first: their quotient less one would round at the edge.
        let share = before.map(|b| (counted.instructions as f64 - b.instructions as f64) / b.instructions as f64);
        let verdict = match share {
            None => Verdict::New,
            Some(_) if !comparable => Verdict::NotJudged,
            Some(s) if s > INSTRUCTION_TOLERANCE => Verdict::Worse,
            Some(s) if s < -INSTRUCTION_TOLERANCE => Verdict::Better,
            Some(_) => Verdict::Same,
        };
        let moved = matches!(verdict, Verdict::Worse | Verdict::Better);
        section.lines.push(Line {
            name: name.clone(),
            baseline: before.map_or(String::new(), |b| b.instructions.to_string()),
            now: counted.instructions.to_string(),
            change: share.map_or(String::new(), |s| format!("{:+.2} %", 100.0 * s)),
            verdict,
            note: before.filter(|_| moved).map_or(String::new(), |b| moved_most(&b.functions, &counted.functions)),
        });
    }
    gone(&mut section, baseline.keys(), |name| now.contains_key(name), whole);
    section
}

/// The functions whose own instructions moved most.
fn moved_most(before: &BTreeMap<String, u64>, now: &BTreeMap<String, u64>) -> String {
    let names: std::collections::BTreeSet<&String> = before.keys().chain(now.keys()).collect();
    let of = |map: &BTreeMap<String, u64>, name: &String| map.get(name).copied().unwrap_or(0);
    let mut moved: Vec<(i128, &String)> =
        names.into_iter().map(|n| (i128::from(of(now, n)) - i128::from(of(before, n)), n)).collect();
    moved.retain(|(by, _)| *by != 0);
    moved.sort_by_key(|(by, _)| -by.abs());
    let words: Vec<String> = moved.iter().take(3).map(|(by, name)| format!("{name} {by:+}")).collect();
    words.join("; ")
}

/// Names that only the baseline has: checks that are lost.
fn gone<'a>(
    section: &mut Section,
    before: impl Iterator<Item = &'a String>,
    there: impl Fn(&str) -> bool,
    whole: bool,
) {
    for name in before.filter(|name| whole && !there(name)) {
        section.lines.push(Line {
            name: name.clone(),
            baseline: "measured".into(),
            now: String::new(),
            change: String::new(),
            verdict: Verdict::Gone,
            note: "the baseline has it and this program does not; --accept drops it".into(),
        });
    }
}

#[cfg(test)]
#[path = "judge_tests.rs"]
mod tests;
