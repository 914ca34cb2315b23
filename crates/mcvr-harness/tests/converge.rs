//! A run against methods whose error is known: the truth plus normal noise of a given law.

#![allow(clippy::unwrap_used, reason = "a test may panic, and its helpers with it")]

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use mcvr_harness::record::read_log;
use mcvr_harness::{
    ConvergeOptions, HarnessError, Method, MethodError, PhaseSeconds, Record, Rendered, RunMeta, RunSummary, RunWatch,
    Truth, converge, key_lines,
};
use mcvr_scene::{Estimand, Extent, Image, Kernel};
use rand_distr::{Distribution, Normal};

struct Noisy {
    name: &'static str,
    truth: Image,
    /// Standard deviation of the noise over the mean pixel at M = 1, and its exponent.
    law: (f64, f64),
    /// Added to every pixel, over the mean pixel.
    shift: f64,
    most: u64,
    calls: AtomicU64,
    fail_after: u64,
    cancel_after: Option<(u64, &'static AtomicBool)>,
}

impl Noisy {
    fn new(name: &'static str, law: (f64, f64)) -> Self {
        let (truth, calls) = (truth().image, AtomicU64::new(0));
        Self { name, truth, law, shift: 0.0, most: u64::MAX, calls, fail_after: u64::MAX, cancel_after: None }
    }
}

impl Method for Noisy {
    fn name(&self) -> &str {
        self.name
    }

    fn label(&self) -> &str {
        self.name
    }

    fn expected_slope(&self) -> Option<f64> {
        Some(self.law.1)
    }

    fn accepts(&self, samples: u64) -> bool {
        samples <= self.most
    }

    fn render(&self, samples: u64, seed: u64) -> Result<Rendered, MethodError> {
        let call = self.calls.fetch_add(1, Ordering::Relaxed);
        if call >= self.fail_after {
            return Err("out of <memory>".into());
        }
        if let Some((after, cancel)) = self.cancel_after {
            cancel.store(call >= after, Ordering::Relaxed);
        }
        let sigma = self.law.0 * (samples as f64).powf(self.law.1) * self.truth.mean();
        let noise = Normal::new(self.shift * self.truth.mean(), sigma)?;
        let mut rng = rand_pcg::Pcg64::new(u128::from(seed), self.name.len() as u128);
        let values = self.truth.values().iter().map(|v| v + noise.sample(&mut rng)).collect();
        let complete = samples as f64 * 1e-7;
        Ok(Rendered {
            image: Image::from_values(self.truth.extent(), values)?,
            seconds: PhaseSeconds { distribution: 0.0, sampling: complete / 4.0, projection: complete / 2.0, complete },
            counters: serde_json::json!({ "samples": samples }),
        })
    }
}

fn truth() -> Truth {
    let extent = Extent::new(48, 40).unwrap();
    let value = |i: usize| 1.0 + ((i % 48) as f64 / 7.0).sin().abs() * (i / 48) as f64;
    let image = Image::from_values(extent, (0..extent.pixels()).map(value).collect()).unwrap();
    Truth { image, rel_error_estimate: 1e-6, seconds: 3.25 }
}

fn options(out: &Path) -> ConvergeOptions {
    ConvergeOptions {
        samples: (10..=16).map(|m| 1 << m).collect(),
        replicates: 5,
        seed: 42,
        series: vec![2000, 4096],
        out: out.join("run"),
        meta: RunMeta {
            dataset: "blob & <co>".into(),
            view: "azimuth 30".into(),
            kernel: Kernel::Tent,
            estimand: Estimand::Line,
            density: "identity".into(),
            threads: 1,
            machine: "a test".into(),
            commit: Some("abc1234".into()),
            command: "mcvr converge \"blob\"".into(),
        },
    }
}

fn go(methods: &[&dyn Method], options: &ConvergeOptions) -> Result<RunSummary, HarnessError> {
    let cancel = AtomicBool::new(false);
    converge(methods, &truth(), options, RunWatch { cancel: &cancel, progress: &|_, _, _| {} })
}

fn log(options: &ConvergeOptions) -> Vec<Record> {
    read_log(&options.out.join("records.jsonl")).unwrap()
}

fn sorted(mut records: Vec<Record>) -> Vec<Record> {
    records.sort_by_key(Record::key);
    records
}

#[test]
fn known_errors_slopes_and_efficiencies_come_out() {
    let folder = tempfile::tempdir().unwrap();
    let (mc, qmc) = (Noisy::new("mc", (30.0, -0.5)), Noisy::new("qmc", (30.0, -2.0 / 3.0)));
    let run = go(&[&mc, &qmc], &options(folder.path())).unwrap();
    assert_eq!((run.measured, run.planned), (80, 80));
    for (method, law) in run.methods.iter().zip([mc.law, qmc.law]) {
        let fit = method.fit.unwrap();
        // The noise of an RMSE over 1920 pixels and 5 replicates is 0.7 %, that of a slope over six octaves 0.0016.
        assert!((fit.slope - law.1).abs() < 0.01, "{fit:?}");
        assert_eq!((fit.points, fit.from, fit.to), (7, 1 << 10, 1 << 16), "2000 is for the series alone");
        assert!(method.tail_fit.unwrap().from > fit.from);
    }
    for row in &run.rows {
        let law = if row.method == "mc" { mc.law } else { qmc.law };
        let expected = law.0 * (row.samples as f64).powf(law.1);
        assert!((row.error / expected - 1.0).abs() < 0.04, "{row:?}");
        assert_eq!(row.replicates, 5);
        assert!((row.ns_per_sample - 100.0).abs() < 1e-9);
        assert_eq!(row.series_only, row.samples == 2000);
        assert!(row.error_spread.min < row.error && row.error < row.error_spread.max);
    }
    // One false alarm in a hundred runs is what the test allows itself; two in one run would be a fault.
    assert!(run.rows.iter().filter(|r| r.biased).count() <= 1);
    let last = run.rows.last().unwrap();
    let (gain, expected) = (last.efficiency.unwrap(), 65536f64.powf(1.0 / 3.0));
    assert!((gain.value - expected).abs() < 5.0 * gain.sd.unwrap(), "{gain:?} {expected}");
}

#[test]
fn replicates_share_seeds_across_methods_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    go(&[&Noisy::new("a", (9.0, -0.5)), &Noisy::new("b", (9.0, -0.5))], &options).unwrap();
    let mut seeds: Vec<_> = log(&options).iter().map(|r| (r.seed, r.samples, r.replicate)).collect();
    assert!(seeds.iter().all(|s| s.0 < 1 << 53));
    seeds.sort_unstable();
    seeds.dedup();
    assert_eq!(seeds.len(), 40, "one for each M and replicate");
    seeds.dedup_by_key(|s| s.0);
    assert_eq!(seeds.len(), 40, "all different");
}

#[test]
fn a_resumed_run_repeats_nothing_and_ends_with_the_same_records() {
    let folder = tempfile::tempdir().unwrap();
    let whole = options(&folder.path().join("whole"));
    let parts = options(&folder.path().join("parts"));
    let fresh = || (Noisy::new("mc", (9.0, -0.5)), Noisy::new("qmc", (9.0, -0.6)));
    let (a, b) = fresh();
    go(&[&a, &b], &whole).unwrap();
    // Stopped by a failure, then torn in the middle of its last line as by a kill, then resumed.
    let (mut a, b) = fresh();
    a.fail_after = 20;
    let error = go(&[&a, &b], &parts).unwrap_err();
    assert!(matches!(&error, HarnessError::Method { problem, .. } if problem == "out of <memory>"), "{error}");
    assert!(parts.out.join("report.html").is_file(), "what was finished is shown");
    let path = parts.out.join("records.jsonl");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 30]).unwrap();
    let kept = log(&parts).len() as u64;
    let (a, b) = fresh();
    go(&[&a, &b], &parts).unwrap();
    let calls = a.calls.load(Ordering::Relaxed) + b.calls.load(Ordering::Relaxed);
    assert_eq!(calls, 80 - kept + 2, "the missing ones and a warm-up each");
    assert_eq!(sorted(log(&parts)), sorted(log(&whole)));
    // Complete: nothing is left to do.
    let (a, b) = fresh();
    go(&[&a, &b], &parts).unwrap();
    assert_eq!(a.calls.load(Ordering::Relaxed) + b.calls.load(Ordering::Relaxed), 0);
}

#[test]
fn more_replicates_and_counts_extend_a_run_and_lost_images_are_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(folder.path());
    go(&[&Noisy::new("mc", (9.0, -0.5))], &options).unwrap();
    let before = log(&options);
    std::fs::remove_file(options.out.join("images/mc-0000002000.png")).unwrap();
    options.replicates = 6;
    options.samples.push(1 << 17);
    let method = Noisy::new("mc", (9.0, -0.5));
    let run = go(&[&method], &options).unwrap();
    assert_eq!(log(&options)[..before.len()], before[..]);
    assert_eq!(method.calls.load(Ordering::Relaxed), 8 + 6 + 1 + 1, "new ones, a warm-up, the lost image");
    assert_eq!((run.measured, run.series.len()), (54, 2));
}

#[test]
fn a_cancelled_run_returns_what_is_finished() {
    static CANCEL: AtomicBool = AtomicBool::new(false);
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    let mut method = Noisy::new("mc", (9.0, -0.5));
    method.cancel_after = Some((17, &CANCEL));
    let progress = std::sync::Mutex::new(Vec::new());
    let note = |done: u64, total: u64, _: &str| progress.lock().unwrap().push((done, total));
    let run = converge(&[&method], &truth(), &options, RunWatch { cancel: &CANCEL, progress: &note }).unwrap();
    assert_eq!((run.measured, run.planned, log(&options).len()), (17, 40, 17));
    let report = std::fs::read_to_string(options.out.join("report.md")).unwrap();
    assert!(report.contains("17 of 40 images"), "{report}");
    let seen = progress.lock().unwrap().clone();
    assert!(seen.is_sorted() && seen.iter().all(|(done, total)| done < total), "{seen:?}");
    // Cancelled before the first image: still a report, no plots.
    let empty = tempfile::tempdir().unwrap();
    let options = self::options(empty.path());
    let run = converge(&[&method], &truth(), &options, RunWatch { cancel: &CANCEL, progress: &note }).unwrap();
    assert_eq!(run.measured, 0);
    assert!(options.out.join("report.html").is_file() && !options.out.join("error_vs_time.svg").exists());
    assert_eq!(key_lines(&run)[0], "Nothing was measured yet.");
}

#[test]
fn a_folder_of_another_run_is_refused_and_the_difference_named() {
    let folder = tempfile::tempdir().unwrap();
    let first = options(folder.path());
    go(&[&Noisy::new("mc", (9.0, -0.5))], &first).unwrap();
    let before = std::fs::read(first.out.join("records.jsonl")).unwrap();
    let mut other = first.clone();
    other.seed = 43;
    other.meta.view = "azimuth 31".into();
    let message = go(&[&Noisy::new("mc", (9.0, -0.5))], &other).unwrap_err().to_string();
    for part in ["another output folder", "seed: '42' there, '43' now", "view: 'azimuth 30' there"] {
        assert!(message.contains(part), "{message}");
    }
    let mut moved = truth();
    moved.image.values_mut()[7] += 1e-9;
    let cancel = AtomicBool::new(false);
    let watch = RunWatch { cancel: &cancel, progress: &|_, _, _| {} };
    let message = converge(&[&Noisy::new("mc", (9.0, -0.5))], &moved, &first, watch).unwrap_err().to_string();
    assert!(message.contains("truth:"), "{message}");
    assert_eq!(std::fs::read(first.out.join("records.jsonl")).unwrap(), before);
}

#[test]
fn a_biased_method_is_found_and_an_honest_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let mut skewed = Noisy::new("skewed", (9.0, -0.5));
    skewed.shift = 0.02;
    let run = go(&[&Noisy::new("mc", (9.0, -0.5)), &skewed], &options(folder.path())).unwrap();
    assert!(run.rows.iter().all(|r| r.method == "skewed" || !r.biased));
    assert!(run.rows.iter().any(|r| r.method == "skewed" && r.biased));
    let report = std::fs::read_to_string(folder.path().join("run/report.md")).unwrap();
    assert!(report.contains("Bias: beyond chance") && report.contains("skewed at M = "), "{report}");
}

#[test]
fn a_method_that_refuses_large_counts_is_left_out_there() {
    let folder = tempfile::tempdir().unwrap();
    let mut small = Noisy::new("linear", (9.0, -0.5));
    small.most = 4096;
    let options = options(folder.path());
    let run = go(&[&Noisy::new("mc", (9.0, -0.5)), &small], &options).unwrap();
    assert_eq!(run.rows.iter().filter(|r| r.method == "linear").map(|r| r.samples).max(), Some(4096));
    assert_eq!((run.measured, run.planned), (60, 60));
}

#[test]
fn the_page_stands_alone_and_holds_tables_plots_and_images() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path());
    let run = go(&[&Noisy::new("mc", (9.0, -0.5)), &Noisy::new("qmc", (9.0, -0.6))], &options).unwrap();
    let page = std::fs::read_to_string(options.out.join("report.html")).unwrap();
    assert!(!page.contains("http://") && !page.contains("https://"), "nothing from outside");
    assert!(!page.contains("<script ") && !page.contains("@import") && !page.contains("url("));
    assert_eq!(page.matches("<script>").count(), 1);
    assert_eq!(page.matches("<table").count(), 5);
    assert_eq!(page.matches("<svg").count(), 6, "three plots, each for a desk and for a phone");
    assert_eq!(page.matches(" download=").count(), 2);
    assert_eq!(page.matches("src=\"data:image/png;base64,").count(), 1 + 2 * 2 * 2);
    assert_eq!(page.matches("src=").count(), 9);
    for part in ["blob &amp; &lt;co&gt;", "1.192 s", "prefers-color-scheme: dark", "abc1234", "a test", "Rendering"] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("<co>") && !page.contains("NaN") && !page.contains("inf "));
    let table = std::fs::read_to_string(options.out.join("summary.csv")).unwrap();
    let columns = table.lines().map(|l| l.split(',').count()).collect::<std::collections::HashSet<_>>();
    assert_eq!((columns.len(), table.lines().count()), (1, 1 + run.rows.len()));
    let text = std::fs::read_to_string(options.out.join("report.md")).unwrap();
    for line in text.lines() {
        for link in line.split("](").skip(1) {
            let name = link.split(')').next().unwrap();
            assert!(options.out.join(name).is_file(), "{name}");
        }
    }
    for svg in ["error_vs_samples.svg", "error_vs_time.svg", "time_vs_samples.svg"] {
        let text = std::fs::read_to_string(options.out.join(svg)).unwrap();
        assert!(text.contains("10⁴") || text.contains("10 ms"), "{svg} has labelled axes");
        assert!(text.contains("abc1234") && text.contains("5 replicates"), "{svg} says where it is from");
    }
    let lines = key_lines(&run);
    assert!(lines[0].starts_with("At 65,536 (2¹⁶) samples, mc differs") && lines[2].contains("; qmc −0."), "{lines:?}");
}

#[test]
fn input_that_cannot_be_measured_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let good = options(folder.path());
    let mc = Noisy::new("mc", (9.0, -0.5));
    let slash = Noisy::new("../mc", (9.0, -0.5));
    assert!(go(&[], &good).is_err() && go(&[&mc, &mc], &good).is_err() && go(&[&slash], &good).is_err());
    for change in [
        (|o: &mut ConvergeOptions| o.replicates = 0) as fn(&mut _),
        |o| o.samples.push(0),
        |o| (o.samples, o.series) = (vec![], vec![]),
    ] {
        let mut bad = good.clone();
        change(&mut bad);
        assert!(matches!(go(&[&mc], &bad), Err(HarnessError::Options(_))));
    }
    let cancel = AtomicBool::new(false);
    let watch = RunWatch { cancel: &cancel, progress: &|_, _, _| {} };
    let dark = Truth { image: Image::zeros(Extent::new(4, 4).unwrap()), ..truth() };
    let message = converge(&[&mc], &dark, &good, watch).unwrap_err().to_string();
    assert!(message.contains("not in view"), "{message}");
    assert!(!good.out.exists());
}
