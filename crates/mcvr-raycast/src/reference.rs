//! The reference image: exact along rays, adaptive over pixels, with its own error.

use std::time::Instant;

use mcvr_scene::{Camera, Density, Estimand, Image, Kernel};
use serde::Serialize;

use crate::adaptive::{Integrand, Pixels, Task, whole_sum};
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
    /// Estimate of each pixel's absolute error, in the image's unit. No bound where `box` voxels are seen edge-on: one jump
    /// within a pixel may be off by twice the estimate.
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
    options.check()?;
    let integrator = Integrator::new(density, options.kernel)?;
    let rays = integrator.view(camera, options.estimand);
    let task = Task {
        camera,
        grid: density.volume().grid(),
        view: rays.view(),
        bounds: integrator.index_bounds(),
        options,
        fallback: whole_sum(density, camera, options.estimand),
        watch,
    };
    let Pixels { values, errors, tolerance, depth_limited, counters } = task.run(&rays)?;
    let one = |v: Vec<[f64; 1]>| image_of(camera, v.into_iter().map(|[v]| v));
    let (image, error) = (one(values), one(errors));
    let rms = rms(&error);
    let rel_rmse_estimate = if rms == 0.0 { 0.0 } else { rms / image.mean() };
    let error = ErrorEstimate { image: error, rel_rmse_estimate, tolerance, depth_limited };
    Ok(Reference { image, error, counters, seconds: start.elapsed().as_secs_f64() })
}

impl Integrand<1> for Rays<'_> {
    fn ray_share(&self) -> f64 {
        0.0
    }

    #[inline(always)]
    fn at(&self, px: f64, py: f64, _: f64, counters: &mut Counters) -> ([f64; 1], [f64; 1]) {
        ([self.integrate(px, py, counters)], [0.0])
    }
}

/// Root mean square of an image.
pub(crate) fn rms(image: &Image) -> f64 {
    (image.values().iter().map(|e| e * e).sum::<f64>() / image.extent().pixels() as f64).sqrt()
}

/// An image of the camera's extent from its pixels row by row.
pub(crate) fn image_of(camera: &Camera, values: impl Iterator<Item = f64>) -> Image {
    // The number of values is right, so the fallback is never used.
    Image::from_values(camera.extent(), values.collect()).unwrap_or_else(|_| Image::zeros(camera.extent()))
}
