//! One image from one request, whatever the method.

use std::borrow::Cow;
use std::time::{Duration, Instant};

use mcvr_footprint::{FootprintError, FootprintOptions, LookFootprints, Refine, footprints_with_look};
use mcvr_harness::PhaseSeconds;
use mcvr_mc::{OrderStatistics, Quicksorted, Stratified, Unsorted};
use mcvr_qmc::{Scramble, SobolNet};
use mcvr_raycast::{
    AdaptiveImage, AdaptiveOptions, Comb, MarchImage, MarchOptions, RayOptions, RaycastError, ReferenceOptions,
    cast_adaptive_rays, cast_rays_with_look, march_with_look, reference_with_look,
};
use mcvr_refine::{Goal, RefineError};
use mcvr_sampling::{
    Distribution, PointStream, RenderOptions, Rendered, SamplingError, VoxelOrder, check_samples, render_look,
};
use mcvr_scene::{Camera, Density, DensityMap, Effects, Estimand, Extent, Image, Kernel, SceneError, Watch};
use mcvr_volume::Volume;
use serde::Serialize;
use serde_json::{Value, json};

use crate::Method;
use crate::auto::{Already, Choice, choose_and_cast};

/// What is looked at, and from where.
#[derive(Clone, Debug)]
pub struct Scenery {
    /// The scan.
    pub volume: Volume,
    /// Isovalue to weight.
    pub map: DensityMap,
    /// The view.
    pub camera: Camera,
    /// What there is on top of the plain X-ray.
    pub effects: Effects,
}

impl Scenery {
    /// A plain X-ray of the three.
    pub fn new(volume: Volume, map: DensityMap, camera: Camera) -> Self {
        Self { volume, map, camera, effects: Effects::default() }
    }

    /// The same with effects; their materials' weights go into the density map.
    pub fn with_effects(mut self, effects: Effects) -> Self {
        self.map.gains = effects.gains();
        self.effects = effects;
        self
    }
}

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

/// An image and what it took.
#[derive(Clone, Debug)]
pub struct Made {
    /// Linear values; of a coloured scene the mean of the three channels.
    pub image: Image,
    /// Red, green and blue, of a coloured scene.
    pub colour: Option<[Image; 3]>,
    /// Wall time by phase.
    pub seconds: PhaseSeconds,
    /// Total mass `F`, and what the density map dropped.
    pub mass: mcvr_scene::MassReport,
    /// Share of the mass that the camera's near plane cut, as the samples have it; 0 for ray casting.
    pub clipped: f64,
    /// Samples drawn, rays cast or footprints added.
    pub samples: u64,
    /// Exact work counters, by method.
    pub counters: Value,
    /// The image's own estimate of its RMSE over the mean: of [`Method::Exact`] and of refined images.
    pub error: Option<f64>,
    /// What was chosen for [`Method::Auto`].
    pub choice: Option<Box<Choice>>,
}

impl Made {
    /// The values that measurements compare: the image, or the three channels of a coloured one, one below the other.
    ///
    /// # Errors
    /// [`SceneError::Image`] when three channels have more pixels than an image can have.
    pub fn measurable(&self) -> Result<Cow<'_, Image>, SceneError> {
        match &self.colour {
            Some(channels) => Image::stacked(channels).map(Cow::Owned),
            None => Ok(Cow::Borrowed(&self.image)),
        }
    }
}

/// Why an image could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MakeError {
    /// The scene is unusable.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Sampling failed.
    #[error(transparent)]
    Sampling(#[from] SamplingError),
    /// Ray casting failed.
    #[error(transparent)]
    Raycast(#[from] RaycastError),
    /// Footprints failed.
    #[error(transparent)]
    Footprint(#[from] FootprintError),
    /// Refinement failed.
    #[error(transparent)]
    Refine(#[from] RefineError),
}

impl MakeError {
    /// True when the work was stopped from outside rather than failed.
    pub fn is_cancelled(&self) -> bool {
        matches!(
            self,
            Self::Sampling(SamplingError::Cancelled)
                | Self::Raycast(RaycastError::Cancelled)
                | Self::Footprint(FootprintError::Cancelled)
                | Self::Refine(RefineError::Sampling(SamplingError::Cancelled))
        )
    }
}

/// Makes an image. The distribution is built anew each time: its cost belongs to a first image.
///
/// # Errors
/// [`MakeError`] when the scene is unusable, a limit is exceeded, or `watch` cancels.
pub fn make(scenery: &Scenery, request: &Request, watch: &Watch<'_>) -> Result<Made, MakeError> {
    Ok(make_first(scenery, request, watch)?.0)
}

/// As [`make()`]; keeps the weights for more images by [`make_of()`].
///
/// # Errors
/// As [`make()`].
pub fn make_first(scenery: &Scenery, request: &Request, watch: &Watch<'_>) -> Result<(Made, Density), MakeError> {
    let start = Instant::now();
    check_request(request)?;
    in_pool(|| {
        let density = Density::new(&scenery.volume, scenery.map.clone())?;
        let made = complete(&density, scenery, request, watch, start)?;
        Ok((made, density))
    })
}

/// As [`make()`], of weights that are at hand: more images of one volume, whose weights are then summed once, and whose empty bricks
/// are looked for once. `density` must be that of the scenery's volume and map.
///
/// # Errors
/// As [`make()`].
pub fn make_of(density: &Density, scenery: &Scenery, request: &Request, watch: &Watch<'_>) -> Result<Made, MakeError> {
    let start = Instant::now();
    check_request(request)?;
    in_pool(|| complete(density, scenery, request, watch, start))
}

/// Runs code on a thread of the pool, where every parallel step begins at once: from another thread each takes a wake-up of the pool and a
/// wait for it, together some 80 microseconds on one thread.
fn in_pool<T: Send>(code: impl FnOnce() -> T + Send) -> T {
    rayon::scope(|_| code())
}

/// What can be refused before the volume is read.
fn check_request(request: &Request) -> Result<(), MakeError> {
    if request.method.samples_volume() {
        check(request)?;
    }
    if request.method == Method::Auto {
        Goal { error: Some(request.error), ..Goal::default() }.check()?;
    }
    Ok(())
}

fn complete(
    density: &Density,
    scenery: &Scenery,
    request: &Request,
    watch: &Watch<'_>,
    start: Instant,
) -> Result<Made, MakeError> {
    let looking = Instant::now();
    let (choice, already) = match request.method {
        Method::Auto => {
            let (choice, image) = choose_and_cast(density, scenery, request, true, watch)?;
            (Some(Box::new(choice)), image)
        }
        _ => (None, None),
    };
    // A look is at one view: it is no part of what is done once for a volume. Of adaptive rays it is the beginning.
    let looked = match &already {
        Some(Already::Rays(_)) => Duration::ZERO,
        Some(Already::Footprints(made)) => looking.elapsed().saturating_sub(Duration::from_secs_f64(made.seconds)),
        None => looking.elapsed(),
    };
    let chosen = choice.as_ref().map_or(*request, |c| c.request(request));
    let (mass, before) = (*density.report(), looking.duration_since(start).as_secs_f64());
    let mut made = if let Some(already) = already {
        match already {
            Already::Rays(image) => of_adaptive(image, mass, before),
            Already::Footprints(made) => of_footprints(made, mass, before),
        }
    } else if chosen.method.samples_volume() {
        check(&chosen)?;
        sampled(density, scenery, &chosen, watch, start + looked)?
    } else {
        cast(density, scenery, &chosen, watch, start + looked)?
    };
    made.choice = choice;
    made.seconds.sampling += looked.as_secs_f64();
    for image in made.colour.iter().flatten().chain([&made.image]) {
        check_finite(image)?;
    }
    made.seconds.complete = start.elapsed().as_secs_f64();
    Ok(made)
}

/// Refuses an image with a pixel that is no number.
#[allow(clippy::needless_range_loop, reason = "vector code wants plain loops")]
pub(crate) fn check_finite(image: &Image) -> Result<(), MakeError> {
    // What is no number times 0 is none either.
    let (rows, rest) = image.values().as_chunks::<8>();
    let mut sums = [0.0; 8];
    for row in rows {
        for n in 0..8 {
            sums[n] += row[n] * 0.0;
        }
    }
    if sums.iter().sum::<f64>() == 0.0 && rest.iter().all(|v| v.is_finite()) {
        return Ok(());
    }
    match image.values().iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(at) => Err(MakeError::Scene(SceneError::Image(format!(
            "pixel {},{} came out as {}: weights times mm, or the light's intensity times that, exceed the range of numbers; \
             scale them down",
            at % image.extent().width,
            at / image.extent().width,
            image.values()[at]
        )))),
    }
}

fn sampled(
    density: &Density,
    scenery: &Scenery,
    request: &Request,
    watch: &Watch<'_>,
    start: Instant,
) -> Result<Made, MakeError> {
    let camera = &scenery.camera;
    let look = scenery.effects.look(density.volume().grid(), camera)?;
    let order = request.order.resolve(camera, density.volume().grid());
    let distribution = if request.cull {
        Distribution::in_view(density, order, camera, request.kernel)?
    } else {
        Distribution::new(density, order)?
    };
    let distribution_seconds = start.elapsed().as_secs_f64();
    let drawing = Instant::now();
    let stream = point_stream(request, distribution.total().max(1));
    let drawn = drawing.elapsed().as_secs_f64();
    let options = RenderOptions { estimand: request.estimand, kernel: request.kernel, ..RenderOptions::default() };
    let Rendered { image, colour, counters, seconds, precision } =
        render_look(&distribution, &*stream, camera, &look, &options, watch)?;
    Ok(Made {
        image,
        colour,
        seconds: PhaseSeconds {
            distribution: distribution_seconds,
            sampling: drawn + seconds.sampling,
            projection: seconds.projection,
            complete: 0.0,
        },
        mass: *density.report(),
        clipped: (distribution.near_mass()
            + distribution.mass() * counters.clipped as f64 / counters.samples.max(1) as f64)
            / density.mass(),
        samples: counters.samples,
        counters: json!({
            "distribution": distribution.counters(),
            "render": counters,
            "order": order,
            "precision": precision,
        }),
        error: None,
        choice: None,
    })
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

fn cast(
    density: &Density,
    scenery: &Scenery,
    request: &Request,
    watch: &Watch<'_>,
    start: Instant,
) -> Result<Made, MakeError> {
    let Request { kernel, estimand, seed, .. } = *request;
    let camera = &scenery.camera;
    let look = scenery.effects.look(density.volume().grid(), camera)?;
    let mass = *density.report();
    let distribution = start.elapsed().as_secs_f64();
    let phases = |projection| PhaseSeconds { distribution, sampling: 0.0, projection, complete: 0.0 };
    if request.method == Method::Footprint {
        let options = footprint_options(request);
        let made = footprints_with_look(density, camera, &look, &options, watch)?;
        return Ok(of_footprints(made, mass, distribution));
    }
    if let Some(adaptive) = request.adaptive {
        let served = matches!(request.method, Method::Comb | Method::Rays)
            && kernel == Kernel::Tent
            && look.is_plain()
            && !request.jitter;
        if !served {
            return Err(MakeError::Raycast(RaycastError::Adaptive));
        }
        let made = cast_adaptive_rays(density, camera, &adaptive.options(request), watch)?;
        return Ok(of_adaptive(made, mass, distribution));
    }
    if request.method != Method::Exact {
        let rays_per_pixel = rays_per_pixel(request.samples, camera, request.jitter);
        let average = request.method != Method::March && !request.jitter && look.is_plain();
        let block = if average { block(request.samples, camera) } else { 1 };
        let rays = RayOptions { rays_per_pixel, jitter: request.jitter, average, block, kernel, estimand, seed };
        let made = if request.method == Method::Rays {
            cast_rays_with_look(density, camera, &look, &rays, watch)?
        } else {
            let random_phase = request.method == Method::Comb;
            march_with_look(density, camera, &look, &MarchOptions { step: request.step, random_phase, rays }, watch)?
        };
        let mut counters = json!({ "rays_per_pixel": rays_per_pixel, "march": made.counters });
        if block > 1 {
            counters["pixels_per_ray"] = json!(block * block);
        }
        let (image, colour) = channels(made.channels);
        return Ok(Made {
            image,
            colour,
            seconds: phases(made.seconds),
            mass,
            clipped: 0.0,
            samples: rays_in_all(rays_per_pixel, block, camera),
            counters,
            error: None,
            choice: None,
        });
    }
    let options = ReferenceOptions { kernel, estimand, tolerance: request.tolerance, ..ReferenceOptions::default() };
    let made = reference_with_look(density, camera, &look, &options, watch)?;
    // All channels share their rays, and so the pixels that were subdivided to the limit.
    let limited = made.errors.iter().map(|e| e.depth_limited).max();
    let counters = json!({ "reference": made.counters, "depth_limited": limited });
    let (image, colour) = channels(made.channels);
    Ok(Made {
        image,
        colour,
        seconds: phases(made.seconds),
        mass,
        clipped: 0.0,
        samples: made.counters.rays,
        counters,
        error: Some(made.rel_rmse_estimate),
        choice: None,
    })
}

/// What footprints made.
fn of_footprints(made: LookFootprints, mass: mcvr_scene::MassReport, distribution: f64) -> Made {
    let (image, colour) = channels(made.channels);
    Made {
        image,
        colour,
        seconds: PhaseSeconds { distribution, sampling: 0.0, projection: made.seconds, complete: 0.0 },
        mass,
        clipped: 0.0,
        samples: made.counters.footprints,
        counters: json!({ "footprint": made.counters }),
        error: None,
        choice: None,
    }
}

/// What adaptive rays made.
fn of_adaptive(made: AdaptiveImage, mass: mcvr_scene::MassReport, distribution: f64) -> Made {
    let AdaptiveImage { made: MarchImage { image, counters, seconds }, left, rays, .. } = made;
    let levels: Vec<Value> = rays.iter().map(|(pitch, rays)| json!({ "pitch": pitch, "rays": rays })).collect();
    Made {
        image,
        colour: None,
        seconds: PhaseSeconds { distribution, sampling: 0.0, projection: seconds, complete: 0.0 },
        mass,
        clipped: 0.0,
        samples: counters.rays,
        counters: json!({ "march": counters, "adaptive": { "left": left, "levels": levels } }),
        error: None,
        choice: None,
    }
}

/// One channel, or the mean of three and the three.
fn channels(mut channels: Vec<Image>) -> (Image, Option<[Image; 3]>) {
    match <[Image; 3]>::try_from(std::mem::take(&mut channels)) {
        Ok(colour) => (Image::mean_of(&colour), Some(colour)),
        // Ray casters and footprints give one channel or three.
        Err(mut one) => (one.swap_remove(0), None),
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
