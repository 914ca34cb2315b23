//! Errors of a point stream over many numbers of samples, and what must be true of them.

use mcvr::Scenery;
use mcvr::raycast::Reference;
use mcvr::sampling::{Distribution, PointStream, RenderOptions, VoxelOrder, render};
use mcvr::scene::{Camera, DensityMap, Estimand, Extent, Kernel, View, Watch};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::{density, exact};

/// Replicates of each error.
pub const REPLICATES: u64 = 64;
/// Probability of a false alarm of each one-sided Student's t test.
pub const LEVEL: f64 = 1e-4;

pub type Streams<'a> = &'a dyn Fn(u64, u64) -> Box<dyn PointStream>;

/// A phantom of 37,156 voxels that can be drawn, close enough that a few of them miss the image, and its exact
/// `count` image of 12×12 pixels.
pub fn lobster() -> &'static (Scenery, Reference) {
    static SCENE: std::sync::OnceLock<(Scenery, Reference)> = std::sync::OnceLock::new();
    SCENE.get_or_init(|| {
        let loaded = mcvr::volume::load("phantom:lobster@64", None).unwrap();
        let view = View { fov: Some(14.0), ..View::default() };
        let camera = Camera::look(&view, loaded.volume.grid(), Extent::new(12, 12).unwrap()).unwrap();
        let scenery = Scenery::new(loaded.volume, DensityMap::default(), camera);
        let reference = exact(&scenery, Kernel::Tent, Estimand::Count, 2e-5, 8);
        (scenery, reference)
    })
}

/// Mean square error over the pixels by level and replicate: `errors[level][replicate]`, `M = 2^level`.
pub fn square_errors(
    scenery: &Scenery,
    truth: &Reference,
    levels: std::ops::RangeInclusive<u32>,
    streams: Streams,
) -> Vec<Vec<f64>> {
    let density = density(scenery);
    let order = VoxelOrder::default().resolve(&scenery.camera, scenery.volume.grid());
    let distribution = Distribution::new(&density, order).unwrap();
    let options = RenderOptions { estimand: Estimand::Count, kernel: Kernel::Tent, ..RenderOptions::default() };
    let errors: Vec<Vec<f64>> = levels
        .map(|level| {
            let one = |r: u64| {
                let stream = streams(1 << level, 1000 * u64::from(level) + r);
                let made = render(&distribution, &*stream, &scenery.camera, &options, &Watch::default()).unwrap();
                let difference = made.image.difference(&truth.image).unwrap();
                difference.values().iter().map(|d| d * d).sum::<f64>() / difference.values().len() as f64
            };
            (0..REPLICATES).map(one).collect()
        })
        .collect();
    let least = errors.iter().flatten().fold(f64::INFINITY, |a, &b| a.min(b)).sqrt() / truth.image.mean();
    let own = truth.error.rel_rmse_estimate;
    assert!(least >= 10.0 * own, "errors of {least:e} cannot be told from the reference's {own:e}");
    errors
}

/// Least-squares slope of `y` over consecutive levels.
pub fn slope(y: &[f64]) -> f64 {
    let n = y.len() as f64;
    let (middle, spread) = ((n - 1.0) / 2.0, n * (n * n - 1.0) / 12.0);
    y.iter().enumerate().map(|(i, y)| (i as f64 - middle) * y).sum::<f64>() / spread
}

/// Mean and standard error.
pub fn mean(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt())
}

/// log2 of each replicate's RMSE by level, as one row per replicate.
pub fn log_errors(errors: &[Vec<f64>]) -> Vec<Vec<f64>> {
    (0..REPLICATES as usize).map(|r| errors.iter().map(|level| 0.5 * level[r].log2()).collect()).collect()
}

/// One-sided Student's critical value over the replicates.
pub fn critical(level: f64) -> f64 {
    StudentsT::new(0.0, 1.0, REPLICATES as f64 - 1.0).unwrap().inverse_cdf(1.0 - level)
}

/// The doubling, if any, at which errors do not fall beyond noise: replicates are independent, so are the logarithms
/// of the ratio of their errors at successive levels, and Student's t test must find their mean below 0 at each
/// doubling, at [`LEVEL`] over the number of doublings.
pub fn plateau(name: &str, errors: &[Vec<f64>]) -> Option<String> {
    let logs = log_errors(errors);
    let doublings = errors.len() - 1;
    let falls: Vec<_> =
        (0..doublings).map(|d| mean(&logs.iter().map(|row| row[d + 1] - row[d]).collect::<Vec<_>>())).collect();
    println!("{name}: log2 of the ratio of errors at each doubling {falls:.3?}");
    let stuck = falls.iter().position(|(fall, se)| fall + critical(LEVEL / doublings as f64) * se >= 0.0)?;
    Some(format!("{name}: no fall at doubling {stuck}: log2 of the ratio {:.3?}", falls[stuck]))
}

/// What is wrong with the claim that errors fall faster than `M^(-1/2)`, if anything: Student's t test over the
/// replicates' slopes at [`LEVEL`].
pub fn not_steep(name: &str, errors: &[Vec<f64>]) -> Option<String> {
    let (b, se) = mean(&log_errors(errors).iter().map(|row| slope(row)).collect::<Vec<_>>());
    println!("{name}: slope {b:.4} ± {se:.4}");
    (b + critical(LEVEL) * se >= -0.5).then(|| format!("{name}: slope {b:.4} ± {se:.4} is not below -1/2"))
}
