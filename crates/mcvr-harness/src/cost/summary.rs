//! What a run found: points, times to an error, meeting points, models.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::PathBuf;

use serde::Serialize;

use super::model::CostModel;
use super::peers::PeerPoint;
use super::points::{Point, points};
use super::reach::{By, Crossing, Ladder, Reach, break_even, crossings};
use super::{CostMeta, CostOptions, Entrant, VIEWS};
use crate::fit::FLOOR_FACTOR;
use crate::{Record, SeriesImage, TruthSummary};

/// Everything that plots and reports show. It is rebuilt from the records, never updated.
#[derive(Clone, Debug, Serialize)]
pub struct CostSummary {
    /// What was measured, and where.
    pub meta: CostMeta,
    /// Source revisions that the records name; more than one when a run was resumed by another build.
    pub commits: Vec<String>,
    /// Repeats asked for.
    pub repeats: u32,
    /// The run's seed.
    pub seed: u64,
    /// Seconds of a view beyond which budgets were not raised.
    pub longest: f64,
    /// Relative errors that were asked for, as given.
    pub targets: Vec<f64>,
    /// Volumes and image sizes, in the order measured.
    pub subjects: Vec<SubjectInfo>,
    /// Methods in the order given.
    pub methods: Vec<MethodInfo>,
    /// Every measured budget.
    pub points: Vec<Point>,
    /// Time to each error, by volume, threads and method.
    pub reaches: Vec<ReachRow>,
    /// Errors at which samplers and ray casters take the same time for one image.
    pub meetings: Vec<Meeting>,
    /// Numbers of views from which samplers are cheaper than ray casters.
    pub break_evens: Vec<BreakEven>,
    /// Volume sizes at which samplers and ray casters take the same time; with several volumes only.
    pub size_crossings: Vec<SizeCrossing>,
    /// Models of the time.
    pub models: Vec<CostModel>,
    /// Images that were made on several numbers of threads, and how many of those differed: 0 by design.
    pub compared: [usize; 2],
    /// Pictures that are kept, with the value that is full red in the difference maps.
    pub pictures: (Vec<SeriesImage>, f64),
    /// Other systems' points, see [`read_peers`](super::read_peers).
    pub peers: Vec<PeerPoint>,
    /// The folder of the files.
    #[serde(skip)]
    pub folder: PathBuf,
}

/// A volume at an image size.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SubjectInfo {
    /// Name of the volume.
    pub dataset: String,
    /// Width x height.
    pub size: String,
    /// Voxels.
    pub voxels: u64,
    /// Pixels.
    pub pixels: u64,
    /// The truth in figures; absent where only the time was measured.
    pub truth: Option<TruthSummary>,
}

/// A method that took part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MethodInfo {
    /// Stable identifier.
    pub name: String,
    /// Name for people.
    pub label: String,
    /// What one unit of its budget is.
    pub budget_unit: String,
    /// Whether its error falls with a budget of any value (samplers); ray casters have settings.
    pub continuous: bool,
    /// How often many views of one volume pay the preparation at most.
    pub preparations: u64,
    /// Whether its curve is drawn.
    pub plotted: bool,
}

/// How long a method takes to an error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReachRow {
    /// Name of the volume.
    pub dataset: String,
    /// Threads.
    pub threads: usize,
    /// The method.
    pub method: String,
    /// The relative error that was asked for.
    pub target: f64,
    /// What it takes; `None` where the method does not get there.
    pub reach: Option<Reach>,
    /// Seconds in total for 1, 10, 100 and 1000 views.
    pub totals: Option<[f64; 4]>,
    /// For each of these, whether no other measured way is quicker: the frontier.
    pub fastest: [bool; 4],
}

/// Where a sampler and a ray caster take the same time for one image.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Meeting {
    /// Name of the volume.
    pub dataset: String,
    /// Threads.
    pub threads: usize,
    /// The sampler.
    pub sampler: String,
    /// The ray caster, `march` for the best of all its settings, or `any` for the best of all ray casters.
    pub rays: String,
    /// Error, samples and time there.
    pub crossing: Crossing,
}

/// From how many views a sampler is cheaper than a ray caster.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BreakEven {
    /// Name of the volume.
    pub dataset: String,
    /// Threads.
    pub threads: usize,
    /// The relative error of every view.
    pub target: f64,
    /// The sampler.
    pub sampler: String,
    /// The ray caster.
    pub rays: String,
    /// Views; `None` where it never is.
    pub views: Option<u64>,
}

/// The size of a volume at which a sampler and a ray caster take the same time to an error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SizeCrossing {
    /// Threads.
    pub threads: usize,
    /// The relative error.
    pub target: f64,
    /// `complete` (one image with everything) or `view` (the preparation done).
    pub clock: String,
    /// The sampler.
    pub sampler: String,
    /// The ray caster.
    pub rays: String,
    /// Voxels, between measured sizes on a log scale.
    pub voxels: f64,
    /// True when the sampler is the quicker one for larger volumes.
    pub sampler_for_larger: bool,
}

/// All ray casters together, where the quickest of any is meant.
pub(crate) const ANY: &str = "any";

/// The error below which nothing is shown, for a truth's own error.
pub(crate) fn floor(reference_error: f64) -> f64 {
    FLOOR_FACTOR * reference_error
}

/// Settings that must be the same for records to belong together.
pub(crate) fn fingerprint(options: &CostOptions) -> BTreeMap<String, String> {
    let m = &options.meta;
    let threads: Vec<String> = m.threads.iter().map(usize::to_string).collect();
    [
        ("kind", "cost".to_owned()),
        ("title", m.title.clone()),
        ("view", m.view.clone()),
        ("size", m.size.clone()),
        ("kernel", m.kernel.name().to_owned()),
        ("estimand", m.estimand.name().to_owned()),
        ("scene", m.scene.clone()),
        ("seed", options.seed.to_string()),
        ("threads", threads.join(",")),
        ("machine", m.machine.clone()),
    ]
    .into_iter()
    .map(|(k, v)| (k.to_owned(), v))
    .collect()
}

impl MethodInfo {
    pub(crate) fn of(entrant: &Entrant<'_>) -> Self {
        Self {
            name: entrant.method.name().to_owned(),
            label: entrant.method.label().to_owned(),
            budget_unit: entrant.method.budget_unit().to_owned(),
            continuous: entrant.method.expected_slope().is_some(),
            preparations: entrant.preparations,
            plotted: entrant.plotted,
        }
    }
}

impl CostSummary {
    pub(crate) fn of(
        options: &CostOptions,
        records: &[Record],
        subjects: Vec<SubjectInfo>,
        methods: Vec<MethodInfo>,
        pictures: (Vec<SeriesImage>, f64),
    ) -> Self {
        let mut summary = Self {
            meta: options.meta.clone(),
            commits: records.iter().filter_map(|r| r.commit.clone()).collect::<BTreeSet<_>>().into_iter().collect(),
            repeats: options.repeats,
            seed: options.seed,
            longest: options.longest,
            targets: options.targets.clone(),
            subjects,
            methods,
            points: points(records),
            reaches: Vec::new(),
            meetings: Vec::new(),
            break_evens: Vec::new(),
            size_crossings: Vec::new(),
            models: Vec::new(),
            compared: compared(records),
            pictures,
            peers: Vec::new(),
            folder: options.out.clone(),
        };
        summary.reaches = summary.reach_rows();
        summary.meetings = summary.find_meetings();
        summary.break_evens = summary.find_break_evens();
        summary.size_crossings = summary.find_size_crossings();
        summary.models = summary.find_models();
        summary
    }

    /// Subjects whose error is known.
    pub(crate) fn judged(&self) -> impl Iterator<Item = (&SubjectInfo, f64)> {
        self.subjects.iter().filter_map(|s| Some((s, floor(s.truth.as_ref()?.rel_error_estimate))))
    }

    /// Measured points of a method.
    pub(crate) fn points_of<'a>(
        &'a self,
        subject: &'a SubjectInfo,
        threads: usize,
        method: &'a str,
    ) -> impl Iterator<Item = &'a Point> {
        self.points.iter().filter(move |p| {
            p.dataset == subject.dataset && p.size == subject.size && p.threads == threads && p.method == method
        })
    }

    fn ladder(&self, subject: &SubjectInfo, threads: usize, method: &MethodInfo) -> Ladder {
        let steps = self.points_of(subject, threads, &method.name).filter_map(Point::step).collect();
        Ladder { steps, continuous: method.continuous, preparations: method.preparations }
    }

    /// Samplers by themselves, ray casters by themselves.
    fn sides(&self) -> (Vec<&MethodInfo>, Vec<&MethodInfo>) {
        self.methods.iter().partition(|m| m.continuous)
    }

    fn reach_rows(&self) -> Vec<ReachRow> {
        let mut rows = Vec::new();
        for (subject, floor) in self.judged() {
            for &threads in &self.meta.threads {
                for &target in &self.targets {
                    let from = rows.len();
                    for method in &self.methods {
                        let reach = self.ladder(subject, threads, method).reach(target, floor);
                        rows.push(ReachRow {
                            dataset: subject.dataset.clone(),
                            threads,
                            method: method.name.clone(),
                            target,
                            reach,
                            totals: reach.map(|r| VIEWS.map(|v| r.total(v, method.preparations))),
                            fastest: [false; 4],
                        });
                    }
                    mark_fastest(&mut rows[from..]);
                }
            }
        }
        rows
    }

    fn find_meetings(&self) -> Vec<Meeting> {
        let (samplers, casters) = self.sides();
        let mut found = Vec::new();
        for (subject, floor) in self.judged() {
            for &threads in &self.meta.threads {
                for sampler in samplers.iter().filter(|m| m.plotted) {
                    let mine = self.ladder(subject, threads, sampler);
                    for (rays, members) in families(&casters) {
                        let theirs = self.family(subject, threads, &members);
                        found.extend(crossings(&mine, &theirs, floor).into_iter().map(|crossing| Meeting {
                            dataset: subject.dataset.clone(),
                            threads,
                            sampler: sampler.name.clone(),
                            rays: rays.clone(),
                            crossing,
                        }));
                    }
                }
            }
        }
        found
    }

    /// The settings of several ray casters as those of one.
    fn family(&self, subject: &SubjectInfo, threads: usize, members: &[&MethodInfo]) -> Ladder {
        let steps = members.iter().flat_map(|m| self.ladder(subject, threads, m).steps).collect();
        Ladder { steps, continuous: false, preparations: members.iter().map(|m| m.preparations).max().unwrap_or(1) }
    }

    fn find_break_evens(&self) -> Vec<BreakEven> {
        let (samplers, casters) = self.sides();
        let mut found = Vec::new();
        for (subject, floor) in self.judged() {
            for &threads in &self.meta.threads {
                for &target in &self.targets {
                    for (rays, members) in families(&casters) {
                        let theirs = self.family(subject, threads, &members);
                        let Some(caster) = theirs.reach(target, floor) else { continue };
                        for sampler in &samplers {
                            let mine = self.ladder(subject, threads, sampler).reach(target, floor);
                            let Some(mine) = mine.filter(|r| r.by != By::Extrapolated) else { continue };
                            let views = break_even((&mine, sampler.preparations), (&caster, theirs.preparations));
                            found.push(BreakEven {
                                dataset: subject.dataset.clone(),
                                threads,
                                target,
                                sampler: sampler.name.clone(),
                                rays: rays.clone(),
                                views,
                            });
                        }
                    }
                }
            }
        }
        found
    }

    fn find_size_crossings(&self) -> Vec<SizeCrossing> {
        let (samplers, casters) = self.sides();
        let mut subjects: Vec<(&SubjectInfo, f64)> = self.judged().collect();
        subjects.sort_by_key(|(s, _)| s.voxels);
        let mut found = Vec::new();
        for &threads in &self.meta.threads {
            for &target in &self.targets {
                for sampler in samplers.iter().filter(|m| m.plotted) {
                    for (rays, members) in families(&casters) {
                        for clock in ["complete", "view"] {
                            let seconds = |r: Reach| if clock == "view" { r.view } else { r.total(1, 1) };
                            let ratios = subjects.iter().filter_map(|&(subject, floor)| {
                                let a = self.ladder(subject, threads, sampler).reach(target, floor)?;
                                let b = self.family(subject, threads, &members).reach(target, floor)?;
                                (a.by != By::Extrapolated)
                                    .then(|| ((subject.voxels as f64).ln(), (seconds(a) / seconds(b)).ln()))
                            });
                            let ratios: Vec<(f64, f64)> = ratios.collect();
                            found.extend(ratios.windows(2).filter(|w| w[0].1 * w[1].1 < 0.0).map(|w| {
                                let t = w[0].1 / (w[0].1 - w[1].1);
                                SizeCrossing {
                                    threads,
                                    target,
                                    clock: clock.to_owned(),
                                    sampler: sampler.name.clone(),
                                    rays: rays.clone(),
                                    voxels: (w[0].0 + t * (w[1].0 - w[0].0)).exp(),
                                    sampler_for_larger: w[1].1 < 0.0,
                                }
                            }));
                        }
                    }
                }
            }
        }
        found
    }
}

/// Ray casters by family: all settings of the march are one, and all ray casters together are another.
fn families<'a>(casters: &[&'a MethodInfo]) -> Vec<(String, Vec<&'a MethodInfo>)> {
    let mut families: Vec<(String, Vec<&'a MethodInfo>)> = Vec::new();
    for &caster in casters {
        let name = caster.name.split('-').next().unwrap_or(&caster.name);
        match families.iter_mut().find(|(family, _)| family == name) {
            Some((_, members)) => members.push(caster),
            None => families.push((name.to_owned(), vec![caster])),
        }
    }
    if families.len() > 1 {
        families.push((ANY.to_owned(), casters.to_vec()));
    }
    families
}

/// Marks the quickest measured rows for each number of views.
fn mark_fastest(rows: &mut [ReachRow]) {
    for (i, _) in VIEWS.iter().enumerate() {
        let measured = |r: &ReachRow| r.reach.filter(|r| r.by != By::Extrapolated).and(r.totals).map(|t| t[i]);
        let Some(least) = rows.iter().filter_map(measured).min_by(f64::total_cmp) else { continue };
        rows.iter_mut().for_each(|r| r.fastest[i] = measured(r) == Some(least));
    }
}

/// Images made on several numbers of threads, and how many of them were not the same.
fn compared(records: &[Record]) -> [usize; 2] {
    let mut images: HashMap<_, Vec<&serde_json::Value>> = HashMap::new();
    for r in records {
        images.entry((r.key(), r.replicate)).or_default().push(&r.counters["image"]);
    }
    let several = || images.values().filter(|same| same.len() > 1);
    [several().count(), several().filter(|same| same.iter().any(|h| *h != same[0])).count()]
}
