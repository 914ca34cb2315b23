//! A cost run against methods whose error and time are known laws.

#![allow(clippy::unwrap_used, reason = "a test may panic, and its helpers with it")]

mod peers;

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use mcvr_harness::cost::{By, CostMeta, CostOptions, CostRun, CostSummary, Entrant, Subject, TARGETS, cost_lines};
use mcvr_harness::record::read_log;
use mcvr_harness::{HarnessError, Method, MethodError, PhaseSeconds, Rendered, RunWatch, Truth};
use mcvr_scene::{Estimand, Extent, Image, Kernel};
use rand_distr::{Distribution, Normal};

/// The truth plus noise; error and seconds follow laws of the budget. Nothing is timed.
struct Law {
    name: &'static str,
    unit: &'static str,
    slope: Option<f64>,
    error: fn(f64) -> f64,
    prepare: f64,
    view: fn(f64) -> f64,
    calls: AtomicU64,
    cancel_at: Option<(u64, &'static AtomicBool)>,
}

/// `4 M^(-1/2)`, 10 ms once, 10 ns a sample.
fn sampler(name: &'static str) -> Law {
    Law {
        name,
        unit: "samples",
        slope: Some(-0.5),
        error: |m| 4.0 * m.powf(-0.5),
        prepare: 0.01,
        view: |m| m * 1e-8,
        calls: AtomicU64::new(0),
        cancel_at: None,
    }
}

/// 2 % error in 50 ms at one ray a pixel, 1 % in 200 ms at four.
fn march() -> Law {
    Law {
        name: "march",
        unit: "rays",
        slope: None,
        error: |rays| if rays < 4000.0 { 0.02 } else { 0.01 },
        prepare: 0.0,
        view: |rays| rays * 5e-5 / 1.92,
        calls: AtomicU64::new(0),
        cancel_at: None,
    }
}

impl Method for Law {
    fn name(&self) -> &str {
        self.name
    }

    fn label(&self) -> &str {
        self.name
    }

    fn expected_slope(&self) -> Option<f64> {
        self.slope
    }

    fn budget_unit(&self) -> &'static str {
        self.unit
    }

    fn render(&self, samples: u64, seed: u64) -> Result<Rendered, MethodError> {
        let call = self.calls.fetch_add(1, Ordering::Relaxed);
        if let Some((_, cancel)) = self.cancel_at.filter(|(at, _)| call >= *at) {
            cancel.store(true, Ordering::Relaxed);
            return Err("stopped".into());
        }
        let truth = truth().image;
        let sigma = (self.error)(samples as f64) * truth.mean();
        // The same root mean square in every image: noise scaled to its own.
        let normal = Normal::new(0.0, 1.0)?;
        let mut rng = rand_pcg::Pcg64::new(u128::from(seed), u128::from(samples));
        let noise: Vec<f64> = truth.values().iter().map(|_| normal.sample(&mut rng)).collect();
        let rms = (noise.iter().map(|v| v * v).sum::<f64>() / noise.len() as f64).sqrt();
        let values = truth.values().iter().zip(&noise).map(|(v, n)| v + sigma * n / rms).collect();
        let view = (self.view)(samples as f64);
        let seconds = PhaseSeconds {
            distribution: self.prepare,
            sampling: view / 2.0,
            projection: view / 2.0,
            complete: self.prepare + view,
        };
        Ok(Rendered { image: Image::from_values(truth.extent(), values)?, seconds, counters: serde_json::Value::Null })
    }
}

fn truth() -> Truth {
    let extent = Extent::new(48, 40).unwrap();
    let value = |i: usize| 1.0 + ((i % 48) as f64 / 7.0).sin().abs() * (i / 48) as f64;
    let image = Image::from_values(extent, (0..extent.pixels()).map(value).collect()).unwrap();
    Truth { image, rel_error_estimate: 5e-4, seconds: 3.25 }
}

fn options(out: &Path) -> CostOptions {
    CostOptions {
        repeats: 3,
        seed: 7,
        longest: 0.2,
        targets: TARGETS.to_vec(),
        out: out.to_owned(),
        meta: CostMeta {
            title: "blob & <co>".into(),
            view: "azimuth 30".into(),
            size: "48x40".into(),
            kernel: Kernel::Tent,
            estimand: Estimand::Line,
            scene: "as stored".into(),
            threads: vec![1, 2],
            machine: "a machine".into(),
            commit: Some("abc1234".into()),
            command: "mcvr cost blob".into(),
        },
    }
}

fn ladder(method: &Law) -> Vec<u64> {
    if method.unit == "rays" { vec![1920, 7680] } else { (10..=30).step_by(2).map(|m| 1 << m).collect() }
}

fn entrants<'a>(methods: &'a [&'a Law]) -> Vec<Entrant<'a>> {
    let entrant = |threads| {
        methods.iter().map(move |&method| Entrant {
            method,
            threads,
            ladder: ladder(method),
            preparations: 1,
            plotted: true,
        })
    };
    [1, 2].into_iter().flat_map(entrant).collect()
}

static NEVER: AtomicBool = AtomicBool::new(false);

fn run(out: &Path, volumes: &[(&str, u64)], methods: &[&Law], cancel: &AtomicBool) -> (bool, CostSummary) {
    let (truth, entrants) = (truth(), entrants(methods));
    let mut run = CostRun::open(options(out)).unwrap();
    let watch = RunWatch { cancel, progress: &|done, total, _| assert!(done <= total) };
    let mut complete = true;
    for &(dataset, voxels) in volumes {
        let size = truth.image.extent();
        let pictures = volumes.len() == 1;
        let subject = Subject { dataset, voxels, truth: Some(&truth), size, entrants: &entrants, pictures };
        complete = complete && run.measure(&subject, watch).unwrap();
    }
    (complete, run.finish().unwrap())
}

#[test]
fn the_time_to_an_error_is_what_the_laws_say() {
    let folder = tempfile::tempdir().unwrap();
    let (mc, rays) = (sampler("mc"), march());
    let (complete, summary) = run(folder.path(), &[("blob", 1000)], &[&mc, &rays], &NEVER);
    assert!(complete);
    let reach = |method: &str, target: f64| {
        let row = summary.reaches.iter().find(|r| r.method == method && r.target == target && r.threads == 2);
        row.unwrap().clone()
    };
    // 4 M^-1/2 = 10 % at M = 1600: 10 ms + 16 µs; the march takes 50 ms.
    let row = reach("mc", 0.1);
    let found = row.reach.unwrap();
    assert!((found.budget / 1600.0 - 1.0).abs() < 1e-6 && (found.view / 16e-6 - 1.0).abs() < 1e-6, "{found:?}");
    assert!(row.fastest[0] && found.by == By::Measured);
    let totals = row.totals.unwrap();
    assert!((totals[3] / (0.01 + 1000.0 * 16e-6) - 1.0).abs() < 1e-6);
    // 1 %: 160,000 samples, 11.6 ms against 200 ms.
    assert!(reach("mc", 0.01).fastest[0] && !reach("march", 0.01).fastest[0]);
    assert!((reach("march", 0.01).totals.unwrap()[0] / 0.2 - 1.0).abs() < 1e-9);
    // Below ten times the truth's own error, 0.5 %, nobody is judged.
    assert!(reach("mc", 0.003).reach.is_none() && reach("march", 0.003).reach.is_none());
    // The ladder ends where the error falls below that: 4 M^-1/2 < 0.5 % from 2^20 on.
    let last = summary.points.iter().filter(|p| p.method == "mc").map(|p| p.budget).max();
    assert_eq!(last, Some(1 << 20));
    assert!(summary.points.iter().filter(|p| p.method == "mc").all(|p| p.below_floor == (p.budget == 1 << 20)));
    // The sampler is always the quicker one: nothing crosses.
    assert!(summary.meetings.is_empty(), "{:?}", summary.meetings);
    // Both numbers of threads made the same images.
    assert_eq!(summary.compared, [(6 + 2) * 3, 0]);
    let model = summary.models.iter().find(|m| m.method == "mc" && m.clock == "view" && m.threads == 1).unwrap();
    let sample = model.terms.iter().find(|(name, _)| name == "sample").unwrap().1;
    assert!((sample / 1e-8 - 1.0).abs() < 1e-6 && model.rms_residual < 1e-6, "{model:?}");
    assert!(cost_lines(&summary)[0].contains("of 30 %: mc, 10"), "{:?}", cost_lines(&summary));
    let files =
        ["report.html", "report.md", "summary.json", "records.csv", "error_vs_time.svg", "error_vs_time-1-thread.svg"];
    for name in files {
        assert!(folder.path().join(name).is_file(), "{name}");
    }
    let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(page.contains("blob &amp; &lt;co&gt;") && !page.contains("<co>"));
}

#[test]
fn budgets_are_not_raised_beyond_the_longest_time() {
    let folder = tempfile::tempdir().unwrap();
    // 0.2 s is 2^24.25 samples: 2^24 is below it, 2^26 the first above, and the last that is made.
    let slow = Law { error: |m| 400.0 * m.powf(-0.5), ..sampler("mc") };
    let (_, summary) = run(folder.path(), &[("blob", 1000)], &[&slow], &NEVER);
    assert_eq!(summary.points.iter().map(|p| p.budget).max(), Some(1 << 26));
    // What lies beyond is continued along the slope and never marked as the quickest.
    let row = summary.reaches.iter().find(|r| r.target == 0.01 && r.threads == 1).unwrap();
    let reach = row.reach.unwrap();
    assert_eq!((reach.by, row.fastest[0]), (By::Extrapolated, false));
    assert!((reach.budget / 1.6e9 - 1.0).abs() < 1e-6);
}

#[test]
fn what_was_measured_is_kept_and_not_measured_again() {
    static STOP: AtomicBool = AtomicBool::new(false);
    let folder = tempfile::tempdir().unwrap();
    let stopping = Law { cancel_at: Some((9, &STOP)), ..sampler("mc") };
    let (complete, _) = run(folder.path(), &[("blob", 1000)], &[&stopping], &STOP);
    assert!(!complete);
    let kept = read_log(&folder.path().join("records.jsonl")).unwrap();
    assert!(!kept.is_empty());
    let (mc, again) = (sampler("mc"), sampler("mc"));
    let (complete, summary) = run(folder.path(), &[("blob", 1000)], &[&mc], &NEVER);
    assert!(complete);
    let all = read_log(&folder.path().join("records.jsonl")).unwrap();
    assert_eq!(all[..kept.len()], kept[..]);
    let mut keys: Vec<_> = all.iter().map(|r| (r.key(), r.threads, r.replicate)).collect();
    keys.sort();
    keys.dedup();
    assert_eq!(keys.len(), all.len());
    let (_, same) = run(folder.path(), &[("blob", 1000)], &[&again], &NEVER);
    assert_eq!((again.calls.load(Ordering::Relaxed), same.points), (0, summary.points));
}

#[test]
fn a_stop_before_the_first_measurement_is_no_failure() {
    static STOP: AtomicBool = AtomicBool::new(false);
    let folder = tempfile::tempdir().unwrap();
    let stopping = Law { cancel_at: Some((0, &STOP)), ..sampler("mc") };
    let (complete, summary) = run(folder.path(), &[("blob", 1000)], &[&stopping], &STOP);
    assert!(!complete && summary.points.is_empty() && folder.path().join("report.html").is_file());
}

#[test]
fn another_run_in_the_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    drop(CostRun::open(options(folder.path())).unwrap());
    let mut other = options(folder.path());
    other.meta.view = "azimuth 31".into();
    let Err(HarnessError::OtherRun { differences, .. }) = CostRun::open(other) else { panic!("accepted") };
    assert!(differences.contains("azimuth 31"), "{differences}");
    for bad in [
        CostOptions { repeats: 0, ..options(folder.path()) },
        CostOptions { longest: f64::NAN, ..options(folder.path()) },
        CostOptions { targets: vec![], ..options(folder.path()) },
        CostOptions { targets: vec![0.0], ..options(folder.path()) },
    ] {
        assert!(matches!(CostRun::open(bad), Err(HarnessError::Options(_))));
    }
}

#[test]
fn several_volumes_give_a_map_and_the_size_where_they_cross() {
    let folder = tempfile::tempdir().unwrap();
    // At 10 % the sampler takes 10 ms and a few µs whatever the volume; the march is quicker on the small one.
    let mut truths = (sampler("mc"), march());
    truths.1.error = |_| 0.05;
    let (mc, mut rays) = truths;
    let (truth, size) = (truth(), truth().image.extent());
    let mut run = CostRun::open(options(folder.path())).unwrap();
    let watch = RunWatch { cancel: &NEVER, progress: &|_, _, _| {} };
    for (dataset, voxels, view) in
        [("small", 1_000u64, (|_| 1e-3) as fn(f64) -> f64), ("large", 1_000_000, |_| 0.1 + 1.6e-6)]
    {
        rays.view = view;
        let list = [&mc, &rays];
        let entrants = entrants(&list);
        let subject = Subject { dataset, voxels, truth: Some(&truth), size, entrants: &entrants, pictures: false };
        assert!(run.measure(&subject, watch).unwrap());
    }
    let summary = run.finish().unwrap();
    let found =
        summary.size_crossings.iter().find(|c| c.target == 0.1 && c.threads == 1 && c.clock == "complete").unwrap();
    // Times 10 and about 10 ms meet half way between 1 and 100 ms on the log scale: at √(10³ · 10⁶) voxels.
    assert!((found.voxels.log10() - 4.5).abs() < 0.01 && found.sampler_for_larger, "{found:?}");
    let map = std::fs::read_to_string(folder.path().join("crossover_map-image-2.svg")).unwrap();
    assert!(map.contains("mc") && map.contains("march") && map.contains("small") && map.contains("large"));
    assert!(folder.path().join("time_vs_voxels-10.svg").is_file());
    let report = std::fs::read_to_string(folder.path().join("report.md")).unwrap();
    assert!(report.contains("march for small, mc for large"), "{report}");
}
