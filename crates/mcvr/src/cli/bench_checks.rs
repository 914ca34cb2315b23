//! The checks of `mcvr bench`: read the baseline, measure, judge; and accept.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use anyhow::Context;
use indicatif::ProgressBar;
use mcvr::bench::{
    self, ANCHOR, AccuracyBaseline, AccuracyRun, Baseline, BenchError, Check, Counted, InstructionBaseline, PASSES,
    Pass, Prepared, ROUNDS, Section, Stage, StageInstructions, TimeBaseline, accuracy,
};
use mcvr::harness::history::machine_class;
use mcvr::sampling::SimdLevel;
use mcvr::scene::Watch;

use super::bench::{merged, stopped};
use super::progress;

/// What the checks have in common.
pub(super) struct Checks<'a> {
    pub baseline: Baseline,
    /// Everything is measured, so that what is not there is gone.
    pub whole: bool,
    /// A new baseline is being made.
    pub accept: bool,
    pub cancel: &'a AtomicBool,
    pub quiet: bool,
}

/// What was measured.
#[derive(Default)]
pub(super) struct Measured {
    pub accuracy: Option<AccuracyRun>,
    pub instructions: BTreeMap<String, Counted>,
    pub valgrind: String,
    pub passes: Vec<BTreeMap<String, f64>>,
    pub elements: BTreeMap<String, u64>,
}

impl Measured {
    /// Seconds of one run of each stage, the middle of the passes.
    pub fn seconds(&self) -> BTreeMap<String, f64> {
        bench::middle(&self.passes)
    }
}

fn class() -> String {
    machine_class(&mcvr::harness::machine())
}

/// Vector instructions as they run here, and as callgrind runs them: it knows no AVX-512.
fn simd(callgrind: bool) -> String {
    let level = SimdLevel::detect();
    format!("{:?}", if callgrind { level.min(SimdLevel::Avx2) } else { level })
}

impl Checks<'_> {
    fn bar(&self, total: usize, message: &'static str) -> ProgressBar {
        let bar = progress::bar(total as u64, self.quiet);
        bar.set_message(message);
        bar
    }

    /// A failure where there is no baseline, unless one is being made.
    fn absent(&self, section: &mut Section, file: &Path) {
        if self.accept {
            section.judged = false;
        } else {
            section.problem(format!("{}: there is no baseline; `mcvr bench --accept` makes one", file.display()));
        }
    }

    /// Images and counters.
    pub fn accuracy(&self, cases: Vec<accuracy::Case>, measured: &mut Measured) -> anyhow::Result<Vec<Section>> {
        let file = self.baseline.accuracy_file();
        let before: Option<AccuracyBaseline> = self.read(&file)?;
        let bar = self.bar(cases.len(), "accuracy");
        let advance = |n: u64| bar.inc(n);
        let watch = Watch { progress: Some(&advance), cancel: Some(self.cancel) };
        let known = before.as_ref().map(|b| b.cases.clone()).unwrap_or_default();
        let run = AccuracyRun::new(cases, &known, &watch);
        bar.finish_and_clear();
        let run = run?;
        let machine = before.as_ref().map_or_else(class, |b| b.machine.clone());
        let mut sections = vec![
            bench::judge_accuracy(&known, [&machine, &class()], &run, self.whole),
            bench::judge_work(&known, &run),
        ];
        if before.is_none() {
            sections.iter_mut().for_each(|s| self.absent(s, &file));
        }
        measured.accuracy = Some(run);
        Ok(sections)
    }

    /// Ratios of times; up to three passes where a stage looks slower.
    pub fn time(&self, stages: &[Stage], measured: &mut Measured) -> anyhow::Result<Section> {
        let mut section = Section::new(Check::Time);
        if !bench::is_optimised() {
            section.judged = false;
            section.notice(
                "this program was built without optimisation: no times; scripts/bench-regress builds it".into(),
            );
            return Ok(section);
        }
        let file = self.baseline.time_file();
        let before: Option<TimeBaseline> = self.read(&file)?;
        let mut prepared = self.prepare(stages)?;
        measured.elements = prepared.iter().map(|(name, p)| (name.clone(), p.elements)).collect();
        let comparable = before.as_ref().filter(|b| b.machine == class() && b.simd == simd(false));
        let bar = self.bar(prepared.len() * ROUNDS, "time");
        for pass in 0..PASSES {
            bar.set_length((prepared.len() * ROUNDS * (pass + 1)) as u64);
            let advance = |n: u64| bar.inc(n);
            let watch = Watch { progress: Some(&advance), cancel: Some(self.cancel) };
            let now = bench::measure(&mut prepared, ROUNDS, &watch)?;
            let doubt = comparable.and_then(|b| Pass::of(&b.seconds, &now)).is_some_and(|p| p.is_doubtful());
            measured.passes.push(now);
            if !doubt && !self.accept {
                break;
            }
        }
        bar.finish_and_clear();
        let Some(before) = comparable else {
            let known = self.baseline.classes();
            let known = if known.is_empty() { "none".into() } else { known.join(", ") };
            section = bench::judge_times(&BTreeMap::new(), &measured.passes);
            section.judged = false;
            section.problems.clear();
            section.notices = vec![format!(
                "times are not judged: there is no baseline of this class of machines ({}, {}; there are: {known}); \
                 `mcvr bench --accept --skip accuracy,instructions` makes one",
                class(),
                simd(false)
            )];
            return Ok(section);
        };
        Ok(bench::judge_times(&before.seconds, &measured.passes))
    }

    /// Stages that are ready, the anchors always among them.
    fn prepare(&self, stages: &[Stage]) -> anyhow::Result<Vec<(String, Prepared)>> {
        let anchors: Vec<Stage> = match stages.iter().any(|s| s.name.starts_with(ANCHOR)) {
            true => vec![],
            false => bench::stages()?.into_iter().filter(|s| s.name.starts_with(ANCHOR)).collect(),
        };
        let bar = self.bar(stages.len(), "preparing");
        let ready = |stage: &Stage| {
            if stopped(self.cancel) {
                return Err(BenchError::Cancelled);
            }
            let prepared = bench::on_one_thread(|| stage.prepare())??;
            bar.inc(1);
            Ok((stage.name.clone(), prepared))
        };
        let all: Result<Vec<_>, BenchError> = anchors.iter().chain(stages).map(ready).collect();
        bar.finish_and_clear();
        Ok(all?)
    }

    /// Instructions by callgrind, as many stages at a time as there are processors: a count does not mind company.
    pub fn instructions(&self, stages: &[Stage], measured: &mut Measured) -> anyhow::Result<Section> {
        let mut section = Section::new(Check::Instructions);
        section.judged = false;
        if !bench::is_optimised() {
            section.notice(
                "this program was built without optimisation: no instruction counts; scripts/bench-regress builds it"
                    .into(),
            );
            return Ok(section);
        }
        let Some(valgrind) = bench::valgrind_version() else {
            section
                .notice("valgrind is not installed: no instruction counts (Debian: apt-get install valgrind)".into());
            return Ok(section);
        };
        let file = self.baseline.instructions_file();
        let before: Option<InstructionBaseline> = self.read(&file)?;
        measured.valgrind = valgrind;
        measured.instructions = self.count(stages)?;
        let (compiler, level) = (bench::COMPILER, simd(true));
        let known = before.as_ref().map(|b| b.stages.clone()).unwrap_or_default();
        let comparable = before.as_ref().is_some_and(|b| b.compiler == compiler && b.simd == level);
        let mut section = bench::judge_instructions(&known, &measured.instructions, comparable, self.whole);
        match &before {
            None => self.absent(&mut section, &file),
            Some(b) if !comparable => section.notice(format!(
                "instructions are reported and not judged: the baseline is of {} ({}), this program of {compiler} ({level})",
                b.compiler, b.simd
            )),
            Some(_) => {}
        }
        Ok(section)
    }

    fn count(&self, stages: &[Stage]) -> anyhow::Result<BTreeMap<String, Counted>> {
        let program = std::env::current_exe().context("the program's own path")?;
        let folder = tempfile::tempdir().context("a temporary folder")?;
        let names: Vec<&str> = stages.iter().map(|s| s.name.as_str()).filter(|n| !n.starts_with(ANCHOR)).collect();
        let bar = self.bar(names.len(), "instructions");
        let (next, counted) = (AtomicUsize::new(0), Mutex::new(Ok(BTreeMap::new())));
        let work = || {
            while !stopped(self.cancel) {
                let Some(name) = names.get(next.fetch_add(1, Ordering::Relaxed)) else { break };
                let result = bench::count(&program, name, folder.path());
                let mut all = counted.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                match (&mut *all, result) {
                    (Ok(map), Ok(counted)) => {
                        map.insert((*name).to_owned(), counted);
                    }
                    (Ok(_), Err(e)) => *all = Err(e),
                    (Err(_), _) => break,
                }
                bar.inc(1);
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
                scope.spawn(work);
            }
        });
        bar.finish_and_clear();
        if stopped(self.cancel) {
            return Err(BenchError::Cancelled.into());
        }
        Ok(counted.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner)?)
    }

    /// Reads a file of the baseline. While one is being made, what cannot be read is as good as absent.
    fn read<T: serde::de::DeserializeOwned>(&self, file: &Path) -> Result<Option<T>, BenchError> {
        match Baseline::read(file) {
            Err(_) if self.accept && self.whole => Ok(None),
            other => other,
        }
    }

    /// Makes what was measured the baseline; what was not measured stays.
    pub fn accept(&self, measured: &Measured) -> anyhow::Result<()> {
        if let Some(run) = &measured.accuracy {
            let file = self.baseline.accuracy_file();
            let before: AccuracyBaseline = self.read(&file)?.unwrap_or_default();
            let cases = merged(before.cases, &run.by_name(), self.whole);
            Baseline::write(&file, &AccuracyBaseline { machine: class(), cases })?;
        }
        if !measured.instructions.is_empty() {
            let file = self.baseline.instructions_file();
            let before: InstructionBaseline = self.read(&file)?.unwrap_or_default();
            let (compiler, level) = (bench::COMPILER.to_owned(), simd(true));
            // Counts of two compilers do not mix.
            let fresh = self.whole || before.compiler != compiler || before.simd != level;
            let of = |c: &Counted| StageInstructions { instructions: c.instructions, functions: c.functions.clone() };
            let now = measured.instructions.iter().map(|(name, c)| (name.clone(), of(c))).collect();
            let stages = merged(before.stages, &now, fresh);
            let valgrind = measured.valgrind.clone();
            Baseline::write(&file, &InstructionBaseline { compiler, simd: level, valgrind, stages })?;
        }
        if !measured.passes.is_empty() {
            let file = self.baseline.time_file();
            let before: TimeBaseline = self.read(&file)?.unwrap_or_default();
            let fresh = self.whole || before.machine != class() || before.simd != simd(false);
            let seconds = merged(before.seconds, &measured.seconds(), fresh);
            Baseline::write(&file, &TimeBaseline { machine: class(), simd: simd(false), seconds })?;
        }
        Ok(())
    }
}
