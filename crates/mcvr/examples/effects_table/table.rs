//! Agreement, slope and error of every effect, method and kernel.

use std::time::Instant;

use mcvr::raycast::ReferenceOptions;
use mcvr::scene::{Estimand, Image, Kernel, Watch};
use mcvr::{Method, Request, Scenery, make};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::{Value, json};

use crate::agreement::{Agreement, agreement};
use crate::scenes::{self, Effect, KERNELS, LOBSTER, METHODS};
use crate::truths::{Truth, truth};
use crate::{Options, Outcome};

/// Pixels of a side of the table's images.
pub const SIDE: usize = 32;
/// Error of the truth's pixels over their mean that is asked for, and how often a pixel may be halved. Images of shaded
/// surfaces have kinks everywhere: a truth good to 1e-2 takes half a minute on two cores.
pub const TOLERANCE: f64 = 2e-2;
pub const DEPTH: u32 = 6;
/// Under other kernels than `tent` a shaded truth as good as that takes minutes: they ask for less, and say what they got.
const COARSER: f64 = 5.0;
/// Replicates and samples of the test.
const REPLICATES: u64 = 32;
const SAMPLES: u64 = 1 << 16;
/// Replicates of each level of the slope.
const SLOPE_REPLICATES: u64 = 8;
/// Replicates of the finest images.
const LAST_REPLICATES: u64 = 4;

#[derive(Serialize)]
struct Slope {
    slope: f64,
    /// By leaving out one replicate at a time.
    standard_error: f64,
    /// Base-2 logarithms of the samples of the first and last level.
    levels: [u32; 2],
    /// Relative RMSE by level.
    errors: Vec<f64>,
    /// Whether they are against the truth; from the spread of the replicates where the truth is not good enough.
    against_truth: bool,
}

fn images(scenery: &Scenery, request: Request, number: u64) -> Outcome<Vec<Image>> {
    let key = (request.method as u64) << 8 | (request.kernel as u64) << 4 | request.samples.ilog2() as u64;
    let one = |r| -> Outcome<Image> {
        let seed = (key + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(r);
        Ok(make(scenery, &Request { seed, ..request }, &Watch::default())?.measurable()?.into_owned())
    };
    (0..number).into_par_iter().map(one).collect()
}

/// Least squares of log2 RMSE over log2 samples; errors by level, then replicate.
fn slope(errors: &[Vec<f64>], levels: &[u32], against_truth: bool) -> Slope {
    let fit = |without: Option<usize>| {
        let y = |row: &Vec<f64>| {
            let kept = row.iter().enumerate().filter(|(r, _)| Some(*r) != without).map(|(_, e)| e * e);
            0.5 * (kept.sum::<f64>() / (row.len() - usize::from(without.is_some())) as f64).log2()
        };
        let n = levels.len() as f64;
        let middle = levels.iter().map(|l| f64::from(*l)).sum::<f64>() / n;
        let top: f64 = levels.iter().zip(errors).map(|(l, row)| (f64::from(*l) - middle) * y(row)).sum();
        top / levels.iter().map(|l| (f64::from(*l) - middle).powi(2)).sum::<f64>()
    };
    let r = errors.first().map_or(0, Vec::len);
    let leave: Vec<f64> = (0..r).map(|k| fit(Some(k))).collect();
    let mean = leave.iter().sum::<f64>() / r as f64;
    let spread = leave.iter().map(|s| (s - mean).powi(2)).sum::<f64>();
    Slope {
        slope: fit(None),
        standard_error: (spread * (r as f64 - 1.0) / r as f64).sqrt(),
        levels: [levels.first().copied().unwrap_or(0), levels.last().copied().unwrap_or(0)],
        errors: errors.iter().map(|row| root_mean_square(row)).collect(),
        against_truth,
    }
}

fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|e| e * e).sum::<f64>() / values.len() as f64).sqrt()
}

/// Relative RMSE of each image, and whether against the truth: where that is not ten times as good, against the mean of the images, with the
/// factor that makes the mean square unbiased.
fn distances(truth: &Truth, images: &[Image]) -> Outcome<([Vec<f64>; 2], bool)> {
    let n = images.len() as f64;
    let Some(mut mean) = images.first().cloned() else { return Err("no images".into()) };
    for (p, value) in mean.values_mut().iter_mut().enumerate() {
        *value = images.iter().map(|i| i.values()[p]).sum::<f64>() / n;
    }
    let mean = Truth { error: truth.error.clone(), image: mean };
    let to_truth = images.iter().map(|i| truth.distance(i)).collect::<Outcome<Vec<f64>>>()?;
    let to_mean =
        images.iter().map(|i| Ok(mean.distance(i)? * (n / (n - 1.0)).sqrt())).collect::<Outcome<Vec<f64>>>()?;
    let good = root_mean_square(&to_truth) >= 10.0 * truth.own_error();
    Ok(([to_mean, to_truth], good))
}

#[derive(Serialize)]
struct Row<'a> {
    effect: &'a str,
    kernel: Kernel,
    method: Method,
    truth_error: f64,
    agreement: Agreement,
    slope: Slope,
    last: u32,
    last_replicates: u64,
    /// Relative RMSE at 2^last samples, against the truth or from the spread of the replicates.
    error: f64,
    error_against_truth: bool,
    counters: Value,
}

/// The share of samples by value: the `count` image over the largest factor.
fn share(scenery: &Scenery, kernel: Kernel) -> Outcome<Image> {
    let request = Request { kernel, estimand: Estimand::Count, samples: 1 << 22, seed: 77, ..Request::default() };
    let mut share = make(scenery, &request, &Watch::default())?.measurable()?.into_owned();
    let largest = scenes::largest_factor(scenery, kernel)?;
    share.values_mut().iter_mut().for_each(|v| *v /= largest);
    Ok(share)
}

fn rows<'a>(options: &Options, scenery: &Scenery, effect: &'a Effect, kernel: Kernel) -> Outcome<Vec<Row<'a>>> {
    let (levels, last) = if options.quick { (12..=16, 18) } else { (12..=20, 22) };
    let start = Instant::now();
    let tolerance = if kernel == Kernel::Tent { options.tolerance } else { COARSER * options.tolerance };
    let reference = ReferenceOptions { estimand: Estimand::Line, kernel, tolerance, max_depth: options.depth };
    let truth = truth(&options.out.join("truths"), &format!("{} {kernel}", effect.name), scenery, &reference)?;
    let own = truth.own_error();
    println!("{}, {kernel}: truth good to {own:.1e}, {:.1} s", effect.name, start.elapsed().as_secs_f64());
    let share = share(scenery, kernel)?;
    METHODS
        .iter()
        .map(|&method| {
            let start = Instant::now();
            let request = Request { method, kernel, samples: SAMPLES, ..Request::default() };
            let agreement = agreement(&truth, &share, &images(scenery, request, REPLICATES)?, SAMPLES)?;
            let levels: Vec<u32> = levels.clone().step_by(2).collect();
            let measured: Vec<_> = levels
                .iter()
                .map(|level| {
                    let request = Request { samples: 1 << level, ..request };
                    distances(&truth, &images(scenery, request, SLOPE_REPLICATES)?)
                })
                .collect::<Outcome<_>>()?;
            let good = measured.iter().all(|(_, good)| *good);
            let errors: Vec<Vec<f64>> = measured.into_iter().map(|(rows, _)| rows[usize::from(good)].clone()).collect();
            let slope = slope(&errors, &levels, good);
            let finest = Request { samples: 1 << last, ..request };
            let (finals, error_against_truth) = distances(&truth, &images(scenery, finest, LAST_REPLICATES)?)?;
            let error = root_mean_square(&finals[usize::from(error_against_truth)]);
            let counters = make(scenery, &finest, &Watch::default())?.counters["render"].clone();
            println!(
                "  {method}: p/level {:.1e}, slope {:.3} ± {:.3}, {error:.4}, {:.1} s",
                agreement.p / agreement.level,
                slope.slope,
                slope.standard_error,
                start.elapsed().as_secs_f64()
            );
            Ok(Row {
                effect: effect.name,
                kernel,
                method,
                truth_error: own,
                agreement,
                slope,
                last,
                last_replicates: LAST_REPLICATES,
                error,
                error_against_truth,
                counters,
            })
        })
        .collect()
}

/// Measures all rows, or those that `before` lacks; hands the rows so far to `keep` after every effect.
pub fn measure(options: &Options, before: &Value, mut keep: impl FnMut(Value) -> Outcome<()>) -> Outcome<()> {
    let volume = LOBSTER.load(&options.data)?;
    let effects = scenes::effects()?;
    let settings = json!({ "side": options.side, "tolerance": options.tolerance, "depth": options.depth });
    let same = |key: &str| before[key] == settings[key];
    let resumable = options.resume && ["side", "tolerance", "depth"].into_iter().all(same);
    let mut all: Vec<Value> = match before["rows"].as_array() {
        Some(rows) if resumable => rows.clone(),
        _ => vec![],
    };
    for kernel in KERNELS {
        for effect in &effects {
            let (name, kernel_name) = (json!(effect.name), json!(kernel));
            if all.iter().any(|r| r["effect"] == name && r["kernel"] == kernel_name) {
                continue;
            }
            let scenery = scenes::scenery(&volume, effect, options.side)?;
            for row in rows(options, &scenery, effect, kernel)? {
                all.push(serde_json::to_value(row)?);
            }
            let mut records = settings.clone();
            records["rows"] = json!(all);
            keep(records)?;
        }
    }
    Ok(())
}
