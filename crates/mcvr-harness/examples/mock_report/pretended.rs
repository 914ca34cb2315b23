//! Methods that only pretend: the truth plus noise of a known law. A whole run of them takes a second and needs no
//! renderer.

use std::error::Error;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use mcvr_harness::{
    ConvergeOptions, Method, MethodError, PhaseSeconds, Rendered, RunMeta, RunSummary, RunWatch, Truth, converge,
    git_commit, machine,
};
use mcvr_scene::{Estimand, Extent, Image, Kernel};
use rand_distr::{Distribution, Normal};

/// The truth with independent normal noise; `error` gives its standard deviation over the mean pixel at M.
struct Noisy<'a> {
    name: &'static str,
    label: &'static str,
    slope: f64,
    truth: &'a Image,
    error: fn(f64) -> f64,
    ns_per_sample: f64,
}

impl Method for Noisy<'_> {
    fn name(&self) -> &str {
        self.name
    }

    fn label(&self) -> &str {
        self.label
    }

    fn expected_slope(&self) -> Option<f64> {
        Some(self.slope)
    }

    fn render(&self, samples: u64, seed: u64) -> Result<Rendered, MethodError> {
        let start = Instant::now();
        let tag = self.name.bytes().fold(0u128, |h, b| h * 31 + u128::from(b));
        let mut rng = rand_pcg::Pcg64::new(u128::from(seed), tag);
        let noise = Normal::new(0.0, (self.error)(samples as f64) * self.truth.mean())?;
        let values = self.truth.values().iter().map(|v| v + noise.sample(&mut rng)).collect();
        let image = Image::from_values(self.truth.extent(), values)?;
        let complete = start.elapsed().as_secs_f64() + samples as f64 * self.ns_per_sample * 1e-9;
        let seconds =
            PhaseSeconds { distribution: 0.0, sampling: 0.4 * complete, projection: 0.5 * complete, complete };
        Ok(Rendered { image, seconds, counters: serde_json::json!({ "pretended": true }) })
    }
}

/// How much to pretend.
pub struct Size {
    pub extent: Extent,
    pub samples: Vec<u64>,
    pub series: Vec<u64>,
    pub replicates: u32,
}

/// Measures four pretended methods into the folder `out`.
pub fn run(size: Size, out: PathBuf, progress: &dyn Fn(u64, u64, &str)) -> Result<RunSummary, Box<dyn Error>> {
    let extent = size.extent;
    let (width, height) = (extent.width, extent.height);
    let blob = |x: f64, y: f64| (-8.0 * ((x - 0.5).powi(2) + (y - 0.45).powi(2))).exp();
    let at = |i: usize| blob((i % width) as f64 / width as f64, (i / width) as f64 / height as f64);
    let truth = Image::from_values(extent, (0..extent.pixels()).map(at).collect())?;
    let noisy =
        |name, label, slope, error, ns_per_sample| Noisy { name, label, slope, truth: &truth, error, ns_per_sample };
    let all = [
        noisy("mc", "Monte Carlo", -0.5, |m| 390.0 * m.powf(-0.5), 55.0),
        noisy(
            "stratified",
            "Stratified",
            -2.0 / 3.0,
            |m| 370.0 * m.powf(-0.5) * (1.0 + m / 4e6).powf(-1.0 / 6.0),
            50.0,
        ),
        noisy(
            "qmc",
            "Quasi-Monte Carlo net",
            -2.0 / 3.0,
            |m| 340.0 * m.powf(-0.5) * (1.0 + m / 5e5).powf(-1.0 / 6.0),
            62.0,
        ),
        noisy("control", "Control variate", -0.5, |m| 40.0 * m.powf(-0.5), 90.0),
    ];
    let methods: Vec<&dyn Method> = all.iter().map(|m| m as &dyn Method).collect();
    let options = ConvergeOptions {
        samples: size.samples,
        replicates: size.replicates,
        seed: 1,
        series: size.series,
        out,
        meta: RunMeta {
            dataset: "made-up blob".into(),
            view: "azimuth 30°, elevation 20°".into(),
            kernel: Kernel::Tent,
            estimand: Estimand::Line,
            density: "identity".into(),
            threads: 1,
            machine: machine(),
            commit: git_commit(),
            command: "cargo run --release -p mcvr-harness --example mock_report -- FOLDER".into(),
        },
    };
    let truth = Truth { image: truth.clone(), rel_error_estimate: 5e-4, seconds: 12.3 };
    let cancel = AtomicBool::new(false);
    Ok(converge(&methods, &truth, &options, RunWatch { cancel: &cancel, progress })?)
}
