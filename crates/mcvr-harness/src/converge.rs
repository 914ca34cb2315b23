//! The measurement itself: every method at every sample count, replicated, interleaved, recorded, resumable.

use std::collections::{BTreeSet, HashSet};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use mcvr_scene::{Estimand, Image, Kernel};
use serde::Serialize;

use crate::images::Pictures;
use crate::record::{RecordLog, Setting, write_csv};
use crate::{
    Claim, Comparison, HarnessError, Method, Record, RecordKey, Rendered, RunSummary, TruthSummary, folder, summary,
};

/// Sample counts of the report's Figures a to f.
pub const SERIES: [u64; 6] = [31_250, 62_500, 125_000, 250_000, 500_000, 1_000_000];

/// What to measure and where to put it.
#[derive(Clone, Debug)]
pub struct ConvergeOptions {
    /// Sample counts M of curves, fits and tables; order and repetitions do not matter.
    pub samples: Vec<u64>,
    /// Independent replicates at each M; 8 or more for honest intervals (METHOD section 6), at least 1.
    pub replicates: u32,
    /// Seed of the run; see [`replicate_seed`].
    pub seed: u64,
    /// Sample counts of which images are kept ([`SERIES`] are the report's). They are measured like the others;
    /// those not in `samples` take no part in curves and fits, but stand in the tables.
    pub series: Vec<u64>,
    /// Folder of all results; made if absent, resumed if it holds the same run.
    pub out: PathBuf,
    /// What is measured, and where.
    pub meta: RunMeta,
}

/// What is measured, and where. All of it is printed beside the results.
#[derive(Clone, Debug, Serialize)]
pub struct RunMeta {
    /// Name of the volume.
    pub dataset: String,
    /// The camera in words.
    pub view: String,
    /// Reconstruction kernel.
    pub kernel: Kernel,
    /// What a pixel means.
    pub estimand: Estimand,
    /// The density map in words, with the mass that it clamped, if any.
    pub density: String,
    /// Threads that the methods may use.
    pub threads: usize,
    /// Processor, cores and memory; see [`machine`](crate::machine).
    pub machine: String,
    /// Source revision of the program; see [`git_commit`](crate::git_commit).
    pub commit: Option<String>,
    /// The command that repeats this run.
    pub command: String,
}

/// The image that all methods converge to.
#[derive(Clone, Debug)]
pub struct Truth {
    /// The reference image.
    pub image: Image,
    /// Its own RMSE over its mean pixel, as its integrator estimates it.
    pub rel_error_estimate: f64,
    /// Wall-clock time it took, s.
    pub seconds: f64,
}

/// How a caller follows and stops a run.
#[derive(Clone, Copy)]
pub struct RunWatch<'a> {
    /// Set to stop after the image that is being made; a method that watches it too may fail early and is forgiven.
    pub cancel: &'a AtomicBool,
    /// Called before the first and after every image with (work done, total work, what comes next). Work is the sum of
    /// the sample counts, so that equal steps take about equal time.
    pub progress: &'a dyn Fn(u64, u64, &str),
}

impl std::fmt::Debug for RunWatch<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RunWatch").field("cancel", self.cancel).finish_non_exhaustive()
    }
}

/// Seed of replicate r at M samples: 53 bits of a SplitMix64 chain (Steele, Lea and Flood, OOPSLA 2014) over the run's
/// seed, r and M. All methods get the same one; different M get different ones, so that the points of a curve are
/// independent.
pub fn replicate_seed(seed: u64, replicate: u32, samples: u64) -> u64 {
    let mix = |mut z: u64| {
        z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    mix(mix(mix(seed) ^ u64::from(replicate)) ^ samples) >> 11
}

/// Measures every method at every M and replicate, and writes records, tables, images, plots and reports into
/// `options.out`. Within one M and replicate all methods run in turn, starting with another one each time, so that a
/// drift of the machine hits all alike. Before the first measurement each method makes one small image that is thrown away.
///
/// Measurements that the folder already holds are not repeated. When `watch.cancel` is set the run ends after the
/// current image, and plots and reports show what is finished; so they do when a method fails, before its error is
/// returned.
///
/// # Errors
/// [`HarnessError::Options`] and [`HarnessError::Comparison`] for input that cannot be measured,
/// [`HarnessError::OtherRun`] when the folder belongs to something else, [`HarnessError::Method`] when a method fails,
/// and [`HarnessError::File`] when results cannot be written.
pub fn converge(
    methods: &[&dyn Method],
    truth: &Truth,
    options: &ConvergeOptions,
    watch: RunWatch<'_>,
) -> Result<RunSummary, HarnessError> {
    let own = Comparison::of(&truth.image, &truth.image)?;
    options.check(methods)?;
    check_truth(truth, &own)?;
    let claim = Claim::lay(options, truth.image.extent())?;
    claim.confirm(options, truth)?;
    claim.converge(methods, truth, options, watch)
}

impl Claim {
    /// [`converge`] in this folder, after [`Claim::confirm`].
    ///
    /// # Errors
    /// As [`converge`].
    pub fn converge(
        self,
        methods: &[&dyn Method],
        truth: &Truth,
        options: &ConvergeOptions,
        watch: RunWatch<'_>,
    ) -> Result<RunSummary, HarnessError> {
        let own = Comparison::of(&truth.image, &truth.image)?;
        options.check(methods)?;
        check_truth(truth, &own)?;
        let Self { log, records } = self;
        let out = &options.out;
        let hash = folder::sha256(&truth.image);
        let pictures = Pictures::new(out, &truth.image);
        pictures.write_truth()?;
        let mut run = Run { methods, truth, own, hash, options, watch, pictures, log, records };
        let outcome = match run.measure() {
            // A method that watches the same flag may give up in the middle of an image.
            Err(HarnessError::Method { .. }) if watch.cancel.load(Ordering::Relaxed) => Ok(()),
            outcome => outcome,
        };
        let summary = run.summary();
        let written = run.write_tables().and_then(|()| crate::output::write_all(&summary));
        // The first thing that went wrong is the one to report.
        outcome.and(written).map(|()| summary)
    }
}

impl ConvergeOptions {
    /// Most images of one run.
    pub const IMAGES_LIMIT: u64 = 1 << 20;

    /// Refuses what cannot be measured, before anything is written or a truth is made.
    ///
    /// # Errors
    /// [`HarnessError::Options`] with what is wrong.
    pub fn check(&self, methods: &[&dyn Method]) -> Result<(), HarnessError> {
        let options = |problem: String| Err(HarnessError::Options(problem));
        if methods.is_empty() {
            return options("no method to measure".into());
        }
        let mut names = HashSet::new();
        for name in methods.iter().map(|m| m.name()) {
            if name.is_empty() || !name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_') {
                return options(format!("method name '{name}' may hold only ASCII letters, digits, '-' and '_'"));
            }
            if !names.insert(name) {
                return options(format!("two methods are named '{name}'"));
            }
        }
        if self.replicates == 0 || self.samples.iter().chain(&self.series).any(|&m| m == 0) {
            return options("replicates and sample counts must be at least 1".into());
        }
        let counts = (self.samples.len() + self.series.len()) as u64;
        if counts == 0 {
            return options("no sample counts to measure".into());
        }
        let images = (methods.len() as u64).saturating_mul(counts).saturating_mul(u64::from(self.replicates));
        if images > Self::IMAGES_LIMIT {
            return options(format!(
                "{} methods, {counts} sample counts and {} replicates are {images} images; at most {}",
                methods.len(),
                self.replicates,
                Self::IMAGES_LIMIT
            ));
        }
        let work: u128 = self.samples.iter().chain(&self.series).map(|&m| u128::from(m)).sum();
        if work * (methods.len() as u128) * u128::from(self.replicates) >= 1 << 63 {
            return options(format!(
                "{work} samples for each of {} replicates and {} methods: 2^63 or more in all",
                self.replicates,
                methods.len()
            ));
        }
        Ok(())
    }
}

/// Refuses a truth that nothing can be measured against.
fn check_truth(truth: &Truth, own: &Comparison) -> Result<(), HarnessError> {
    if !(truth.rel_error_estimate.is_finite() && truth.rel_error_estimate >= 0.0) {
        return Err(HarnessError::Options(format!("the truth's own error is {}", truth.rel_error_estimate)));
    }
    if own.rel_rmse.is_none() {
        return Err(HarnessError::Comparison("the truth's mean pixel is 0: the volume is not in view".into()));
    }
    Ok(())
}

/// One image to make.
struct Job {
    method: usize,
    samples: u64,
    replicate: u32,
    picture: bool,
}

struct Run<'a> {
    methods: &'a [&'a dyn Method],
    truth: &'a Truth,
    own: Comparison,
    hash: String,
    options: &'a ConvergeOptions,
    watch: RunWatch<'a>,
    pictures: Pictures<'a>,
    log: RecordLog,
    records: Vec<Record>,
}

impl Run<'_> {
    /// All jobs in groups of one M and replicate, sample counts ascending.
    fn groups(&self) -> Vec<Vec<Job>> {
        let o = self.options;
        let counts: BTreeSet<u64> = o.samples.iter().chain(&o.series).copied().collect();
        let mut groups = Vec::new();
        for &samples in &counts {
            for replicate in 0..o.replicates {
                let picture = replicate == 0 && o.series.contains(&samples);
                let n = self.methods.len();
                let jobs = (0..n)
                    .map(|i| (i + replicate as usize) % n)
                    .filter(|&method| self.methods[method].accepts(samples))
                    .map(|method| Job { method, samples, replicate, picture })
                    .collect();
                groups.push(jobs);
            }
        }
        groups
    }

    /// Runs all jobs that are not recorded yet.
    fn measure(&mut self) -> Result<(), HarnessError> {
        let groups = self.groups();
        let total = groups.iter().flatten().map(|j| j.samples).sum();
        let mut known: HashSet<RecordKey> = self.records.iter().map(Record::key).collect();
        let (mut done, mut warm) = (0, HashSet::new());
        for group in &groups {
            let mut measured = false;
            for job in group {
                if self.watch.cancel.load(Ordering::Relaxed) {
                    return Ok(());
                }
                let method = self.methods[job.method];
                let recorded = known.contains(&self.key(job));
                let pictured = !job.picture || self.pictures.present(method.name(), job.samples);
                if !(recorded && pictured) {
                    let message = format!(
                        "{}, M = {}, replicate {} of {}",
                        method.label(),
                        job.samples,
                        job.replicate + 1,
                        self.options.replicates
                    );
                    (self.watch.progress)(done, total, &message);
                    if !recorded && warm.insert(job.method) {
                        self.warm_up(job.method, &groups)?;
                    }
                    let rendered = self.render(job)?;
                    if job.picture {
                        self.pictures.write_pair(method.name(), job.samples, &rendered.image)?;
                    }
                    if !recorded {
                        let record = self.record(job, rendered)?;
                        self.log.append(&record)?;
                        known.insert(record.key());
                        self.records.push(record);
                        measured = true;
                    }
                }
                done += job.samples;
            }
            if measured {
                self.write_tables()?;
                if group.iter().any(|job| job.replicate + 1 == self.options.replicates) {
                    crate::output::write_all(&self.summary())?;
                }
            }
        }
        (self.watch.progress)(done, total, "writing plots and reports");
        Ok(())
    }

    /// Makes and drops one image at the smallest M of the method: page faults and thread starts are nobody's error cost.
    fn warm_up(&self, method: usize, groups: &[Vec<Job>]) -> Result<(), HarnessError> {
        let smallest = groups.iter().flatten().find(|j| j.method == method);
        smallest.map_or(Ok(()), |job| self.render(job).map(drop))
    }

    fn seed(&self, job: &Job) -> u64 {
        replicate_seed(self.options.seed, job.replicate, job.samples)
    }

    fn key(&self, job: &Job) -> RecordKey {
        let meta = &self.options.meta;
        RecordKey {
            dataset: meta.dataset.clone(),
            view: meta.view.clone(),
            size: self.truth.image.extent().to_string(),
            kernel: meta.kernel.name().to_owned(),
            estimand: meta.estimand.name().to_owned(),
            method: self.methods[job.method].name().to_owned(),
            samples: job.samples,
            seed: self.seed(job),
        }
    }

    fn render(&self, job: &Job) -> Result<Rendered, HarnessError> {
        let (method, seed) = (self.methods[job.method], self.seed(job));
        method.render(job.samples, seed).map_err(|e| HarnessError::Method {
            method: method.name().to_owned(),
            samples: job.samples,
            seed,
            problem: e.to_string(),
        })
    }

    fn record(&self, job: &Job, rendered: Rendered) -> Result<Record, HarnessError> {
        let comparison = Comparison::of(&rendered.image, &self.truth.image)?;
        let meta = &self.options.meta;
        let setting = Setting {
            threads: meta.threads,
            commit: meta.commit.as_deref(),
            machine: &meta.machine,
            reference_error: self.truth.rel_error_estimate,
        };
        let unit = self.methods[job.method].budget_unit();
        let took = (rendered.seconds, rendered.counters);
        Ok(Record::of(self.key(job), job.replicate, unit, took, Some(&comparison), setting))
    }

    /// Rewrites the tables, which together with the log is all that a crash may interrupt.
    fn write_tables(&self) -> Result<(), HarnessError> {
        write_csv(&self.records, &self.options.out.join("records.csv"))?;
        summary::write(&self.summary(), &self.options.out)
    }

    fn summary(&self) -> RunSummary {
        let o = self.options;
        let series_only = |m: u64| !o.samples.is_empty() && o.series.contains(&m) && !o.samples.contains(&m);
        let reference = self.truth.rel_error_estimate;
        let commits: BTreeSet<String> = self.records.iter().filter_map(|r| r.commit.clone()).collect();
        let planned: HashSet<RecordKey> = self.groups().iter().flatten().map(|j| self.key(j)).collect();
        RunSummary {
            meta: o.meta.clone(),
            size: self.truth.image.extent().to_string(),
            truth: TruthSummary {
                rel_error_estimate: reference,
                seconds: self.truth.seconds,
                mean: self.own.reference_mean,
                peak: self.own.reference_peak,
                sha256: self.hash.clone(),
            },
            replicates: o.replicates,
            seed: o.seed,
            commits: commits.into_iter().collect(),
            methods: summary::methods(&self.records, self.methods, reference, &series_only),
            rows: summary::rows(&self.records, self.methods, &series_only),
            series: self.series(),
            difference_scale: self.pictures.scale,
            measured: self.records.iter().filter(|r| planned.contains(&r.key())).count(),
            planned: planned.len(),
            folder: o.out.clone(),
        }
    }

    /// Series entries that have both a record and pictures.
    fn series(&self) -> Vec<crate::SeriesImage> {
        let counts: BTreeSet<u64> = self.options.series.iter().copied().collect();
        let mut entries = Vec::new();
        for samples in counts {
            for method in self.methods.iter().filter(|m| self.pictures.present(m.name(), samples)) {
                let of_this = |r: &&Record| r.method == method.name() && r.samples == samples && r.replicate == 0;
                let Some(record) = self.records.iter().find(of_this) else { continue };
                let [image, difference] = Pictures::names(method.name(), samples);
                entries.push(crate::SeriesImage {
                    method: record.method.clone(),
                    samples,
                    rel_rmse: record.rel_rmse,
                    complete: record.seconds.complete,
                    image,
                    difference,
                });
            }
        }
        entries
    }
}
