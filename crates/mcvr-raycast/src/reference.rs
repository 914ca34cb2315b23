//! The reference image: exact along rays, adaptive over pixels, with its own error.

use std::time::Instant;

use mcvr_scene::{Camera, Density, Estimand, Image, Kernel};
use rayon::prelude::*;
use serde::Serialize;

use crate::cubature::{Limits, PixelMean, Rule, Scratch};
use crate::{Counters, Integrator, RaycastError, Rays, Watch};

/// What to compute and how well.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReferenceOptions {
    /// What a pixel means (METHOD section 2).
    pub estimand: Estimand,
    /// How weights are spread; not `shell`.
    pub kernel: Kernel,
    /// Largest error estimate of a pixel, as a share of the image's mean pixel.
    pub tolerance: f64,
    /// How often a pixel's side may be halved, at most [`ReferenceOptions::DEPTH_LIMIT`].
    pub max_depth: u32,
}

impl ReferenceOptions {
    /// Largest `max_depth`.
    pub const DEPTH_LIMIT: u32 = 16;
}

impl Default for ReferenceOptions {
    /// `line`, `tent`, 1e-4 of the mean pixel, sides down to 1/64 pixel.
    fn default() -> Self {
        Self { estimand: Estimand::default(), kernel: Kernel::default(), tolerance: 1e-4, max_depth: 6 }
    }
}

/// How wrong a reference may be, by its own estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorEstimate {
    /// Estimate of each pixel's absolute error, in the image's unit.
    pub image: Image,
    /// Root mean square of that image over the mean of the reference. No measured error below ten times this
    /// means anything (METHOD section 7).
    pub rel_rmse_estimate: f64,
    /// The tolerance in the image's unit that the pixels were held to.
    pub tolerance: f64,
    /// Pixels at which the subdivision limit left an estimate above the tolerance.
    pub depth_limited: u64,
}

/// A reference image.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// The estimand's value for every pixel.
    pub image: Image,
    /// Its error.
    pub error: ErrorEstimate,
    /// Work done.
    pub counters: Counters,
    /// Wall time in seconds, preparation included.
    pub seconds: f64,
}

/// Computes the reference image. Rows are computed in parallel, each pixel in a fixed order: the image is the
/// same, bit for bit, for any number of threads. Takes memory for two images besides the volume.
///
/// A first pass with one ray per pixel finds the mean pixel that the tolerance refers to. `watch` hears of every
/// finished row of the second pass.
///
/// # Errors
/// [`RaycastError::Shell`], [`RaycastError::Tolerance`] or [`RaycastError::Depth`] for unusable options,
/// [`RaycastError::Cancelled`] when `watch` said so.
pub fn reference(
    density: &Density,
    camera: &Camera,
    options: &ReferenceOptions,
    watch: &Watch,
) -> Result<Reference, RaycastError> {
    let start = Instant::now();
    if !options.tolerance.is_finite() || options.tolerance <= 0.0 {
        return Err(RaycastError::Tolerance(options.tolerance));
    }
    if options.max_depth > ReferenceOptions::DEPTH_LIMIT {
        return Err(RaycastError::Depth { given: options.max_depth, limit: ReferenceOptions::DEPTH_LIMIT });
    }
    let integrator = Integrator::new(density, options.kernel)?;
    let rays = integrator.view(camera, options.estimand);
    let [x0, x1, y0, y1] = integrator.outline(camera);
    let mut image = Image::zeros(camera.extent());
    let mut error = image.clone();
    let width = camera.extent().width;

    let mut counters = Counters::default();
    let centres: Vec<(f64, Counters)> = (y0..y1)
        .into_par_iter()
        .map(|y| {
            let mut counters = Counters::default();
            let stop = watch.cancelled();
            let columns = if stop { x0..x0 } else { x0..x1 };
            let sum = columns.map(|x| rays.integrate(x as f64 + 0.5, y as f64 + 0.5, &mut counters)).sum();
            (sum, counters)
        })
        .collect();
    let mut sum = 0.0;
    for (row, c) in &centres {
        sum += row;
        counters += *c;
    }
    let pixels = camera.extent().pixels() as f64;
    // Centre rays can all miss a small volume; then the mean is that of an image that holds all of the mass.
    let mean = if sum > 0.0 { sum / pixels } else { whole_mean(density, camera, options.estimand) / pixels };
    let rule = if options.kernel == Kernel::Box { Rule::Jumps } else { Rule::Continuous };
    let base = base_depth(&integrator, camera, &rays, options.tolerance).min(options.max_depth);
    let limits = Limits { tolerance: options.tolerance * mean, base, depth: options.max_depth };

    let rows: Vec<(u64, Counters)> = image
        .values_mut()
        .par_chunks_mut(width)
        .zip(error.values_mut().par_chunks_mut(width))
        .enumerate()
        .with_max_len(1)
        .map_init(Scratch::default, |scratch, (y, (row, row_error))| {
            let mut counters = Counters::default();
            let mut limited = 0;
            let columns = if (y0..y1).contains(&y) { x0..x1 } else { 0..0 };
            for x in columns {
                if watch.cancelled() {
                    break;
                }
                let ray = |px: f64, py: f64| rays.integrate(px, py, &mut counters);
                let mean: PixelMean = rule.pixel_mean(ray, (x as f64, y as f64), limits, scratch);
                (row[x], row_error[x]) = (mean.value, mean.error);
                limited += u64::from(mean.limited);
            }
            watch.advance(1);
            (limited, counters)
        })
        .collect();
    if watch.cancelled() {
        return Err(RaycastError::Cancelled);
    }
    let mut depth_limited = 0;
    for (limited, c) in rows {
        depth_limited += limited;
        counters += c;
    }
    let rms = (error.values().iter().map(|e| e * e).sum::<f64>() / pixels).sqrt();
    let rel_rmse_estimate = if rms == 0.0 { 0.0 } else { rms / image.mean() };
    let error = ErrorEstimate { image: error, rel_rmse_estimate, tolerance: limits.tolerance, depth_limited };
    Ok(Reference { image, error, counters, seconds: start.elapsed().as_secs_f64() })
}

/// Sum of all pixels when the image holds the whole volume: 1 for `count`; for `line` as if all mass were at the
/// grid's centre.
fn whole_mean(density: &Density, camera: &Camera, estimand: Estimand) -> f64 {
    let (px, py, z) = camera.project(density.volume().grid().centre());
    match estimand {
        Estimand::Count => 1.0,
        Estimand::Line => density.mass() * camera.line_factor(px, py, z.max(camera.near())),
    }
}

/// Halvings before the first estimate, so that nothing that the grid can hold slips between the points unseen.
///
/// No square is wider than two voxels: 5×5 points lie half a voxel apart. `box` needs more: its image is full of kinks
/// that meet at voxel corners, and a corner of size δ between the points hides an error of the order of δ³. So there
/// squares shrink from one voxel at a tolerance of 1e-3 with the cube root of the tolerance.
fn base_depth(integrator: &Integrator, camera: &Camera, rays: &Rays, tolerance: f64) -> u32 {
    let widest = if integrator.kernel() == Kernel::Box { (tolerance * 1e3).cbrt().min(1.0) } else { 2.0 };
    let ratio = integrator.coarsest_pixel(camera, rays) / widest;
    if ratio > 1.0 { ratio.log2().ceil().min(16.0) as u32 } else { 0 }
}
