//! A cost run against methods whose error and time are known laws.

#![allow(clippy::unwrap_used, reason = "a test may panic, and its helpers with it")]

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use mcvr_harness::cost::{
    By, CostMeta, CostOptions, CostRun, CostSummary, Entrant, PEERS_RECORD, Subject, TARGETS, cost_lines, read_peers,
};
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

/// A record's line of a peer on this view.
fn peer(system: &str, seconds: f64, error: f64, in_rounds: bool) -> serde_json::Value {
    serde_json::json!({
        "record": PEERS_RECORD, "subject": subject_of("blob", 1.0), "system": system, "version": "1.2", "setting": "plain",
        "threads": 2, "seconds": { "median": seconds, "min": seconds * 0.9, "max": seconds * 1.2 }, "views": 5,
        "in_rounds": in_rounds, "error": error, "own_error": 0.5 * error, "own_field": "centre-tent", "machine": "a machine",
    })
}

fn subject_of(dataset: &str, corner: f64) -> serde_json::Value {
    serde_json::json!({ "dataset": dataset, "camera": { "world_to_pixel": [[corner, 0.0], [0.0, 1.0]], "width": 48 }, "mass": 3.5 })
}

fn record(folder: &Path, lines: &[serde_json::Value]) -> std::path::PathBuf {
    let path = folder.join("peers.jsonl");
    std::fs::write(&path, lines.iter().map(|l| format!("{l}\n")).collect::<String>()).unwrap();
    path
}

#[test]
fn other_systems_stand_in_plot_and_table_and_take_the_mark_where_they_are_quicker() {
    let folder = tempfile::tempdir().unwrap();
    // The sampler takes 11.6 ms to 1 % and 10.2 ms to 3 %.
    let mut own = peer("mcvr auto", 1e-5, 0.001, true);
    own["own_field"] = serde_json::Value::Null;
    let lines = [
        peer("RTK Joseph", 0.005, 0.02, true),
        peer("RTK Joseph", 0.1, 0.009, true),
        peer("VTK", 0.05, 0.008, true),
        peer("VTK", 1e-4, 0.002, false),
        own,
    ];
    let peers = read_peers(&record(folder.path(), &lines), &subject_of("blob", 1.0)).unwrap();
    assert_eq!(peers.len(), 3, "settings that were only tried, and the program itself, are left out");
    let (truth, mc) = (truth(), sampler("mc"));
    let (out, list) = (folder.path().join("cost"), [&mc]);
    let entrants = entrants(&list);
    let mut run = CostRun::open(options(&out)).unwrap();
    run.show_peers(peers);
    let watch = RunWatch { cancel: &NEVER, progress: &|_, _, _| {} };
    let size = truth.image.extent();
    let subject =
        Subject { dataset: "blob", voxels: 1000, truth: Some(&truth), size, entrants: &entrants, pictures: false };
    assert!(run.measure(&subject, watch).unwrap());
    let summary = run.finish().unwrap();
    let report = std::fs::read_to_string(out.join("report.md")).unwrap();
    let row = |start: &str| {
        let line = report
            .lines()
            .find(|l| l.starts_with(&format!("| {start}")))
            .unwrap_or_else(|| panic!("{start}: {report}"));
        line.split('|').map(|c| c.trim().to_owned()).collect::<Vec<_>>()
    };
    // Errors 30, 10, 3, 1 and 0.3 %: RTK is quicker down to 3 %, and 0.3 % is below what the truth can judge.
    let (rtk, mc) = (row("RTK Joseph 1.2, 2 threads"), row("mc"));
    assert!(rtk[2].contains('★') && rtk[4].contains('★') && !rtk[5].contains('★') && rtk[6] == "–", "{rtk:?}");
    assert!(rtk[5].contains("100 ms"), "{rtk:?}");
    assert!(!mc[2].contains('★') && !mc[4].contains('★') && mc[5].contains('★'), "{mc:?}");
    assert_eq!(row("VTK 1.2, 2 threads")[5], "50.0 ms");
    let lines = cost_lines(&summary).join(" ");
    assert!(lines.contains("to 3 %: RTK Joseph, 5.00 ms") && !lines.contains("1 %: RTK"), "{lines}");
    let plots =
        ["error_vs_time.svg", "error_vs_time-1-thread.svg"].map(|p| std::fs::read_to_string(out.join(p)).unwrap());
    assert!(plots[0].contains("RTK Joseph 1.2, 2 threads") && plots[0].contains("VTK 1.2"));
    assert!(!plots[1].contains("RTK"), "measured on two threads only");
}

#[test]
fn a_record_of_something_else_is_refused_with_the_field_that_differs() {
    let folder = tempfile::tempdir().unwrap();
    let good = peer("RTK", 0.1, 0.01, true);
    let read = |line: &serde_json::Value, subject: &serde_json::Value| {
        read_peers(&record(folder.path(), std::slice::from_ref(line)), subject)
    };
    // Rounding on the way through text is not another camera.
    assert_eq!(read(&good, &subject_of("blob", 1.0 + 1e-12)).unwrap().len(), 1);
    let with = |field: &str, value: serde_json::Value| {
        let mut line = good.clone();
        line[field] = value;
        line
    };
    let json = |v: f64| serde_json::json!(v);
    for (line, subject, words) in [
        (good.clone(), subject_of("blob", 1.01), "camera.world_to_pixel[0][0] is 1.0 there and 1.01 here"),
        (good.clone(), subject_of("lobster", 1.0), "no other system's views of lobster; it is of blob"),
        (with("record", "mcvr peers 2".into()), subject_of("blob", 1.0), "line 1: record is \"mcvr peers 2\""),
        (with("error", json(-0.1)), subject_of("blob", 1.0), "error is -0.1"),
        (with("error", serde_json::Value::Null), subject_of("blob", 1.0), "line 1"),
        (
            with("seconds", serde_json::json!({ "median": 1.0, "min": 2.0, "max": 3.0 })),
            subject_of("blob", 1.0),
            "seconds.median 1",
        ),
        (with("in_rounds", false.into()), subject_of("blob", 1.0), "no other system's views"),
    ] {
        let message = read(&line, &subject).unwrap_err().to_string();
        assert!(message.contains(words) && message.contains("peers.jsonl"), "{words}: {message}");
    }
    let mut wider = subject_of("blob", 1.0);
    wider["camera"]["height"] = 40.into();
    assert!(read(&good, &wider).unwrap_err().to_string().contains("camera.height is null there and 40 here"));
    std::fs::write(folder.path().join("peers.jsonl"), "{\"record\":").unwrap();
    assert!(read_peers(&folder.path().join("peers.jsonl"), &wider).unwrap_err().to_string().contains("line 1"));
    assert!(read_peers(&folder.path().join("absent.jsonl"), &wider).is_err());
}
