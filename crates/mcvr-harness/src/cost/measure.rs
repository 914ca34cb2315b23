//! The measurement: budgets from small to large, all methods and numbers of threads in turn at each.

use std::collections::HashSet;
use std::sync::atomic::Ordering;

use super::peers::PeerPoint;
use super::plots::threads;
use super::points::{Point, points};
use super::summary::{self, CostSummary, MethodInfo, SubjectInfo};
use super::{CostOptions, Entrant, Subject};
use crate::converge::replicate_seed;
use crate::images::Pictures;
use crate::record::{RecordLog, Setting, write_csv};
use crate::{Comparison, HarnessError, Record, RecordKey, Rendered, RunWatch, Truth, TruthSummary, folder};

/// Images of fewer samples are noise to the eye.
const FEWEST_PICTURED: u64 = 1 << 14;

/// A run in its folder: what was measured so far.
#[derive(Debug)]
pub struct CostRun {
    options: CostOptions,
    log: RecordLog,
    /// What the folder held and what was added; only records of the present subjects go into the summary.
    records: Vec<Record>,
    subjects: Vec<SubjectInfo>,
    methods: Vec<MethodInfo>,
    pictures: Vec<crate::SeriesImage>,
    scale: f64,
    peers: Vec<PeerPoint>,
}

impl CostRun {
    /// Claims the folder and reads what an earlier part of the same run left there.
    ///
    /// # Errors
    /// [`HarnessError::Options`] for options that cannot be measured, [`HarnessError::OtherRun`] when the folder belongs
    /// to something else, [`HarnessError::File`] when it cannot be used.
    pub fn open(options: CostOptions) -> Result<Self, HarnessError> {
        let refuse = |problem: &str| Err(HarnessError::Options(problem.to_owned()));
        if options.repeats == 0 {
            return refuse("repeats must be at least 1");
        }
        if !(options.longest > 0.0 && options.longest.is_finite()) {
            return refuse("the longest time of an image must be positive");
        }
        if options.targets.is_empty() || options.targets.iter().any(|t| !(*t > 0.0 && t.is_finite())) {
            return refuse("errors to reach must be positive, and at least one");
        }
        let out = &options.out;
        std::fs::create_dir_all(out).map_err(|e| HarnessError::file(out, e))?;
        let settings = summary::fingerprint(&options);
        folder::check(out, &settings)?;
        let (log, records) = RecordLog::open(&out.join("records.jsonl"))?;
        folder::tidy(out)?;
        folder::claim(out, &options.meta, settings)?;
        Ok(Self {
            options,
            log,
            records,
            subjects: Vec::new(),
            methods: Vec::new(),
            pictures: Vec::new(),
            scale: 0.0,
            peers: Vec::new(),
        })
    }

    /// Shows other systems' points beside the methods, on the numbers of threads that are measured here.
    pub fn show_peers(&mut self, peers: Vec<PeerPoint>) {
        self.peers = peers;
    }

    /// Measures all entrants of one subject: at each rung of the ladders every entrant in turn, repeat by repeat, starting
    /// with another one each time, so that a drift of the machine hits all alike. An entrant whose views take longer than
    /// `longest` (what is done once for a volume apart), or whose error falls below ten times the truth's own, climbs no
    /// further. Before its first measurement each makes one image that is not counted.
    ///
    /// Returns whether it was finished: `false` after `watch.cancel`; what was measured is on disk in any case.
    ///
    /// # Errors
    /// [`HarnessError::Method`] when a method fails, [`HarnessError::Comparison`] when the truth shows nothing,
    /// [`HarnessError::File`] when results cannot be written.
    pub fn measure(&mut self, subject: &Subject<'_>, watch: RunWatch<'_>) -> Result<bool, HarnessError> {
        self.introduce(subject)?;
        let cancelled = || watch.cancel.load(Ordering::Relaxed);
        let rungs = subject.entrants.iter().map(|e| e.ladder.len()).max().unwrap_or(0);
        let mut climbing = vec![true; subject.entrants.len()];
        let mut warm = HashSet::new();
        let known: HashSet<_> = self.records.iter().map(|r| (r.key(), r.threads, r.replicate)).collect();
        let total: u64 =
            subject.entrants.iter().map(|e| e.ladder.len() as u64).sum::<u64>() * u64::from(self.options.repeats);
        let mut done = 0;
        for rung in 0..rungs {
            for repeat in 0..self.options.repeats {
                let n = subject.entrants.len();
                for index in (0..n).map(|i| (i + repeat as usize) % n) {
                    let entrant = &subject.entrants[index];
                    let Some(&budget) = entrant.ladder.get(rung).filter(|_| climbing[index]) else { continue };
                    if cancelled() {
                        return Ok(false);
                    }
                    done += 1;
                    let key = self.key(subject, entrant, budget, repeat);
                    let pictured = repeat == 0 && self.pictured(subject, entrant, budget);
                    let there = !pictured
                        || self.pictures_of(subject).is_some_and(|p| p.present(entrant.method.name(), budget));
                    if known.contains(&(key.clone(), entrant.threads, repeat)) && there {
                        continue;
                    }
                    (watch.progress)(done, total, &message(subject, entrant, budget));
                    let warmed = match warm.insert(index) {
                        true => self.render(entrant, entrant.ladder[0], key.seed).map(drop),
                        false => Ok(()),
                    };
                    let rendered = match warmed.and_then(|()| self.render(entrant, budget, key.seed)) {
                        // A method that watches the same flag may give up in the middle of an image.
                        Err(_) if cancelled() => return Ok(false),
                        other => other?,
                    };
                    if pictured && let Some(pictures) = self.pictures_of(subject) {
                        pictures.write_pair(entrant.method.name(), budget, &rendered.image)?;
                    }
                    if !known.contains(&(key.clone(), entrant.threads, repeat)) {
                        self.keep(subject, entrant, key, repeat, &rendered)?;
                    }
                }
            }
            for (entrant, climbs) in subject.entrants.iter().zip(&mut climbing).filter(|(_, climbs)| **climbs) {
                *climbs = entrant.ladder.get(rung).is_some_and(|&budget| self.climbs(subject, entrant, budget));
            }
        }
        self.show_pictures(subject);
        Ok(true)
    }

    /// Joins what was measured and writes tables, plots and reports.
    ///
    /// # Errors
    /// [`HarnessError::File`] and [`HarnessError::Plot`] when they cannot be written.
    pub fn finish(&self) -> Result<CostSummary, HarnessError> {
        let subject = |r: &Record| self.subjects.iter().any(|s| s.dataset == r.dataset && s.size == r.size);
        let method = |r: &Record| self.methods.iter().any(|m| m.name == r.method);
        let records: Vec<Record> = self.records.iter().filter(|r| subject(r) && method(r)).cloned().collect();
        let mut summary = CostSummary::of(
            &self.options,
            &records,
            self.subjects.clone(),
            self.methods.clone(),
            (self.pictures.clone(), self.scale),
        );
        summary.peers.clone_from(&self.peers);
        write_csv(&records, &self.options.out.join("records.csv"))?;
        super::output::write_all(&summary)?;
        Ok(summary)
    }

    /// Notes who is measured, and refuses a truth that shows nothing.
    fn introduce(&mut self, subject: &Subject<'_>) -> Result<(), HarnessError> {
        let truth = subject.truth.map(|truth| self.truth_summary(subject, truth)).transpose()?;
        self.subjects.push(SubjectInfo {
            dataset: subject.dataset.to_owned(),
            size: subject.size.to_string(),
            voxels: subject.voxels,
            pixels: subject.size.pixels() as u64,
            truth,
        });
        for entrant in subject.entrants {
            let info = MethodInfo::of(entrant);
            if !self.methods.iter().any(|m| m.name == info.name) {
                self.methods.push(info);
            }
        }
        if let Some(pictures) = self.pictures_of(subject) {
            pictures.write_truth()?;
            self.scale = pictures.scale;
        }
        Ok(())
    }

    fn truth_summary(&self, subject: &Subject<'_>, truth: &Truth) -> Result<TruthSummary, HarnessError> {
        let own = Comparison::of(&truth.image, &truth.image)?;
        if own.rel_rmse.is_none() {
            let problem = format!("{}: the truth's mean pixel is 0: the volume is not in view", subject.dataset);
            return Err(HarnessError::Comparison(problem));
        }
        Ok(TruthSummary {
            rel_error_estimate: truth.rel_error_estimate,
            seconds: truth.seconds,
            mean: own.reference_mean,
            peak: own.reference_peak,
            sha256: folder::sha256(&truth.image),
        })
    }

    /// Whether a larger budget is worth measuring.
    fn climbs(&self, subject: &Subject<'_>, entrant: &Entrant<'_>, budget: u64) -> bool {
        let mine: Vec<Record> = self
            .records
            .iter()
            .filter(|r| r.dataset == subject.dataset && r.size == subject.size.to_string())
            .filter(|r| r.method == entrant.method.name() && r.threads == entrant.threads && r.samples == budget)
            .cloned()
            .collect();
        points(&mine).first().is_none_or(|p: &Point| p.view.median <= self.options.longest && !p.below_floor)
    }

    fn key(&self, subject: &Subject<'_>, entrant: &Entrant<'_>, budget: u64, repeat: u32) -> RecordKey {
        let meta = &self.options.meta;
        RecordKey {
            dataset: subject.dataset.to_owned(),
            view: meta.view.clone(),
            size: subject.size.to_string(),
            kernel: meta.kernel.name().to_owned(),
            estimand: meta.estimand.name().to_owned(),
            method: entrant.method.name().to_owned(),
            samples: budget,
            seed: replicate_seed(self.options.seed, repeat, budget),
        }
    }

    fn render(&self, entrant: &Entrant<'_>, budget: u64, seed: u64) -> Result<Rendered, HarnessError> {
        entrant.method.render(budget, seed).map_err(|e| HarnessError::Method {
            method: entrant.method.name().to_owned(),
            samples: budget,
            seed,
            problem: e.to_string(),
        })
    }

    /// Records one image. In place of its counters, which other commands show, stands a hash of its values: the same
    /// for any number of threads.
    fn keep(
        &mut self,
        subject: &Subject<'_>,
        entrant: &Entrant<'_>,
        key: RecordKey,
        repeat: u32,
        rendered: &Rendered,
    ) -> Result<(), HarnessError> {
        let comparison = subject.truth.map(|t| Comparison::of(&rendered.image, &t.image)).transpose()?;
        let meta = &self.options.meta;
        let setting = Setting {
            threads: entrant.threads,
            commit: meta.commit.as_deref(),
            machine: &meta.machine,
            reference_error: subject.truth.map_or(0.0, |t| t.rel_error_estimate),
        };
        let took = (rendered.seconds, serde_json::json!({ "image": folder::sha256(&rendered.image) }));
        let unit = entrant.method.budget_unit();
        let record = Record::of(key, repeat, unit, took, comparison.as_ref(), setting);
        self.log.append(&record)?;
        self.records.push(record);
        Ok(())
    }

    fn pictures_of<'t>(&'t self, subject: &Subject<'t>) -> Option<Pictures<'t>> {
        let truth = subject.truth.filter(|_| subject.pictures)?;
        Some(Pictures::new(&self.options.out, &truth.image))
    }

    /// Pictures are kept of what is plotted, once and not for every number of threads, and not of a handful of samples.
    fn pictured(&self, subject: &Subject<'_>, entrant: &Entrant<'_>, budget: u64) -> bool {
        let last = Some(&entrant.threads) == self.options.meta.threads.last();
        let sampler = entrant.method.expected_slope().is_some();
        subject.pictures && entrant.plotted && last && (!sampler || budget >= FEWEST_PICTURED)
    }

    fn show_pictures(&mut self, subject: &Subject<'_>) {
        let Some(pictures) = self.pictures_of(subject) else { return };
        let mut shown = Vec::new();
        for entrant in subject.entrants {
            let kept = |m: u64| self.pictured(subject, entrant, m) && pictures.present(entrant.method.name(), m);
            for &budget in entrant.ladder.iter().filter(|&&m| kept(m)) {
                let key = self.key(subject, entrant, budget, 0);
                let Some(record) = self.records.iter().find(|r| r.threads == entrant.threads && r.key() == key) else {
                    continue;
                };
                let [image, difference] = Pictures::names(entrant.method.name(), budget);
                shown.push(crate::SeriesImage {
                    method: record.method.clone(),
                    samples: budget,
                    rel_rmse: record.rel_rmse,
                    complete: record.seconds.complete,
                    image,
                    difference,
                });
            }
        }
        self.pictures = shown;
    }
}

fn message(subject: &Subject<'_>, entrant: &Entrant<'_>, budget: u64) -> String {
    let (method, threads) = (entrant.method, threads(entrant.threads));
    let [label, unit] = [method.label(), method.budget_unit()];
    format!("{}, {}, {label}: {budget} {unit}, {threads}", subject.dataset, subject.size)
}
