//! What an image is asked to be, and what follows from that alone.

use mcvr_footprint::{FootprintOptions, Refine};
use mcvr_mc::{OrderStatistics, Quicksorted, Stratified, Unsorted};
use mcvr_qmc::{Scramble, SobolNet};
use mcvr_raycast::{AdaptiveOptions, Comb, RayOptions};
use mcvr_sampling::{PointStream, SamplingError, VoxelOrder, check_samples};
use mcvr_scene::{Camera, Estimand, Extent, Kernel};
use serde::Serialize;

use crate::{MakeError, Method};

/// How rays are to be cast where an image needs them; see [`AdaptiveOptions`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Adaptive {
    /// Error that may be left between the rays: RMSE over the mean pixel.
    pub left: f64,
    /// Comb: the noise that is taken for no error ([`Comb::noise`]).
    pub noise: f64,
    /// Pixels along the side of the blocks that share a ray at first.
    pub coarsest: u32,
    /// Comb: samples of the first rays, where they differ from those of the others.
    pub first: Option<Comb>,
}

impl Adaptive {
    /// For an error that may be left, from blocks of 4 by 4 pixels down.
    pub fn leaving(left: f64) -> Self {
        Self { left, noise: Comb::NOISE, coarsest: 4, first: None }
    }

    /// With what a request says besides.
    pub(crate) fn options(self, request: &Request) -> AdaptiveOptions {
        let Self { left, noise, coarsest, first } = self;
        let comb = (request.method == Method::Comb).then_some(Comb { step: request.step, noise });
        AdaptiveOptions { comb, first, left, coarsest, estimand: request.estimand, seed: request.seed }
    }
}

/// How an image is to be made.
#[derive(Clone, Copy, Debug)]
pub struct Request {
    /// By which method.
    pub method: Method,
    /// Samples `M`; for [`Method::March`] rays in all: the largest square number a pixel that they pay for is
    /// cast, at least one. [`Method::Footprint`] and [`Method::Exact`] do not look at it.
    pub samples: u64,
    /// Key of all randomness.
    pub seed: u64,
    /// Reconstruction kernel.
    pub kernel: Kernel,
    /// What a pixel means.
    pub estimand: Estimand,
    /// Order of the voxels (matters to `qmc` and, less, to `stratified`).
    pub order: VoxelOrder,
    /// Randomisation of the net.
    pub scramble: Scramble,
    /// Step of a ray march, in units of the smallest spacing; of footprints the side of a voxel's parts, 1/2 to 1/8 (above 1 as 1).
    pub step: f64,
    /// March, comb and rays: rays at random places in their pixels, which makes the image unbiased.
    pub jitter: bool,
    /// Comb and rays: rays where the image needs them, however many those are, instead of `samples`.
    pub adaptive: Option<Adaptive>,
    /// Tolerance of exact ray casting, relative to the mean pixel.
    pub tolerance: f64,
    /// Error that [`Method::Auto`] is to reach: RMSE over the mean pixel.
    pub error: f64,
    /// Whether bricks of the volume that the camera cannot see are left out. Without it the points are those of
    /// [`draw_cloud`](crate::draw_cloud), whatever the view.
    pub cull: bool,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            method: Method::default(),
            samples: 1 << 20,
            seed: 1,
            kernel: Kernel::default(),
            estimand: Estimand::default(),
            order: VoxelOrder::default(),
            scramble: Scramble::default(),
            step: 1.0,
            jitter: false,
            adaptive: None,
            tolerance: 1e-4,
            error: 0.01,
            cull: true,
        }
    }
}

/// Refuses budgets that a method's own limit forbids.
pub(crate) fn check(request: &Request) -> Result<(), MakeError> {
    let Request { method, samples, .. } = *request;
    check_samples(samples)?;
    if method == Method::McQuicksort && samples > Method::QUICKSORT_LIMIT {
        return Err(MakeError::Sampling(SamplingError::Limit {
            method: "mc-quicksort",
            problem: format!(
                "{samples} samples to sort would take {} GiB; at most {}, or use mc, which draws them sorted",
                samples >> 27,
                Method::QUICKSORT_LIMIT
            ),
        }));
    }
    if method == Method::McLinear && samples > Method::LINEAR_LIMIT {
        return Err(MakeError::Sampling(SamplingError::Limit {
            method: "mc-linear",
            problem: format!(
                "{samples} samples at half the volume each would take hours; at most {}, or use mc",
                Method::LINEAR_LIMIT
            ),
        }));
    }
    Ok(())
}

/// The points of a sampling method; the others have none and stand for `mc`.
pub(crate) fn point_stream(request: &Request, total: u64) -> Box<dyn PointStream> {
    let Request { method, samples, seed, .. } = *request;
    match method {
        Method::McQuicksort => Box::new(Quicksorted::new(samples, seed, total)),
        Method::McBinary => Box::new(Unsorted::binary(samples, seed)),
        Method::McLinear => Box::new(Unsorted::linear(samples, seed)),
        Method::Stratified => Box::new(Stratified::new(samples, seed)),
        Method::Qmc => Box::new(SobolNet::new(samples, seed, request.scramble)),
        Method::Mc | Method::March | Method::Rays | Method::Comb | Method::Footprint | Method::Exact | Method::Auto => {
            Box::new(OrderStatistics::new(samples, seed))
        }
    }
}

/// Rays a pixel for a budget of rays: the largest square that it pays for, at least one; with jitter any number. Squares are
/// cast as regular grids of sub-pixels, which beat the same number of jittered rays.
pub(crate) fn rays_per_pixel(rays: u64, camera: &Camera, jitter: bool) -> u32 {
    if jitter {
        return (rays / camera.extent().pixels() as u64).clamp(1, 1 << 20) as u32;
    }
    let side = (rays / camera.extent().pixels() as u64).isqrt().clamp(1, 1024);
    (side * side) as u32
}

/// Voxels in as many parts as the step asks for.
pub(crate) fn footprint_options(request: &Request) -> FootprintOptions {
    let Request { kernel, estimand, step, .. } = *request;
    // `as` saturates, and what is no number becomes 0, which is refused.
    let refine = Refine::Cubic((1.0 / step - 1e-9).ceil().max(f64::from(u8::from(step >= 1.0))) as u32);
    FootprintOptions { kernel, estimand, refine, ..FootprintOptions::default() }
}

/// Rays through the pixels of an image, or its blocks.
pub(crate) fn rays_in_all(rays_per_pixel: u32, block: u32, camera: &Camera) -> u64 {
    let Extent { width, height } = camera.extent();
    u64::from(rays_per_pixel) * (width.div_ceil(block as usize) * height.div_ceil(block as usize)) as u64
}

/// Pixels along the side of the blocks that share a ray, for a budget of rays that does not pay for one a pixel: the smallest that it
/// pays for.
pub(crate) fn block(rays: u64, camera: &Camera) -> u32 {
    let fits = |side: &u32| u64::from(side * side) * rays >= camera.extent().pixels() as u64;
    (1..RayOptions::BLOCK_LIMIT).find(fits).unwrap_or(RayOptions::BLOCK_LIMIT)
}
