//! One image from one request, whatever the method.

use std::borrow::Cow;
use std::time::{Duration, Instant};

use mcvr_footprint::{FootprintError, LookFootprints, footprints_with_look};
use mcvr_harness::PhaseSeconds;
use mcvr_raycast::{
    AdaptiveImage, MarchImage, MarchOptions, RayOptions, RaycastError, ReferenceOptions, cast_adaptive_rays,
    cast_rays_with_look, march_with_look, reference_with_look,
};
use mcvr_refine::{Goal, RefineError};
use mcvr_sampling::{Distribution, RenderOptions, Rendered, SamplingError, render_look};
use mcvr_scene::{Camera, Density, DensityMap, Effects, Image, Kernel, SceneError, Watch};
use mcvr_volume::Volume;
use serde_json::{Value, json};

use crate::Method;
use crate::auto::{Already, Choice, choose_and_cast};
use crate::request::{Request, block, check, footprint_options, point_stream, rays_in_all, rays_per_pixel};

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
