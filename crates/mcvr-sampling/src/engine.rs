//! The loop that every sampling method shares: fill a block, find its voxels, project, accumulate.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use mcvr_scene::{Camera, Estimand, Image, Kernel, Look, Watch, power_of_two};
use rayon::prelude::*;
use serde::Serialize;

use crate::accumulate::{Totals, Worker};
use crate::effects::{EffectPasses, Layers};
use crate::find::{Locate, locator};
use crate::project::{Lost, Projection};
use crate::real::Weights;
use crate::stream::check_samples;
use crate::{Distribution, PointBlock, PointStream, Precision, SamplingError, SimdLevel, block_count, block_len};

/// Blocks that a worker takes at a time.
const TAKE: u64 = 4;

/// How to render; the default is what users want.
#[derive(Clone, Copy, Debug, Default)]
pub struct RenderOptions {
    /// What a pixel means.
    pub estimand: Estimand,
    /// How a voxel's weight is spread.
    pub kernel: Kernel,
    /// Vector instructions; `None` for the best there are. All give the same image.
    pub simd: Option<SimdLevel>,
    /// Arithmetic of the projection; `None` for the cheapest that is exact to 1/64 pixel.
    pub precision: Option<Precision>,
    /// Where shading takes its gradients from.
    pub gradients: GradientSource,
}

/// Where shading takes its gradients from. Both give the same numbers up to rounding to 24 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum GradientSource {
    /// The voxels around each sample, read when the sample is shaded: no memory.
    #[default]
    Lazy,
    /// A field of the gradients of all voxels, computed first: 12 bytes a voxel.
    Stored,
}

/// Exact counts of the work done for one image. They depend on the request only, not on threads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counters {
    /// Samples drawn.
    pub samples: u64,
    /// Samples inside the image.
    pub inside: u64,
    /// Samples beside the image.
    pub outside: u64,
    /// Samples in front of the near plane.
    pub clipped: u64,
    /// Bricks whose running sums were made.
    pub bricks_decoded: u64,
    /// Voxels read to make them.
    pub voxels_read: u64,
    /// `line` weights computed.
    pub line_weights: u64,
    /// Gradients interpolated at samples, for shading.
    pub gradients: u64,
    /// Voxels (or stored gradients) read for them.
    pub gradient_reads: u64,
    /// Voxels of a stored gradient field; 0 when there is none.
    pub gradient_field: u64,
    /// Distances to the light computed for the depth cue.
    pub depth_cues: u64,
    /// Colours of drawn voxels looked up, for materials.
    pub voxel_colours: u64,
    /// Colours of depths looked up.
    pub depth_colours: u64,
}

impl Counters {
    pub(crate) fn add(&mut self, o: &Counters) {
        self.samples += o.samples;
        self.inside += o.inside;
        self.outside += o.outside;
        self.clipped += o.clipped;
        self.bricks_decoded += o.bricks_decoded;
        self.voxels_read += o.voxels_read;
        self.line_weights += o.line_weights;
        self.gradients += o.gradients;
        self.gradient_reads += o.gradient_reads;
        self.gradient_field += o.gradient_field;
        self.depth_cues += o.depth_cues;
        self.voxel_colours += o.voxel_colours;
        self.depth_colours += o.depth_colours;
    }
}

/// Where the time of one image went, in seconds of wall time; the phases of overlapping threads are given
/// their share of the wall time in proportion to the thread time they took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PhaseSeconds {
    /// Drawing points and finding their voxels.
    pub sampling: f64,
    /// Kernel offset, projection and accumulation.
    pub projection: f64,
    /// The whole call.
    pub total: f64,
}

/// An image made of samples.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// Linear values of the estimand; of a coloured image the mean of its channels.
    pub image: Image,
    /// Red, green and blue, where the look has colours.
    pub colour: Option<[Image; 3]>,
    /// What was done.
    pub counters: Counters,
    /// How long it took.
    pub seconds: PhaseSeconds,
    /// Arithmetic that was used.
    pub precision: Precision,
}

/// Renders an image from a point stream on the current rayon pool.
///
/// For `count` a pixel is the share of samples in it; for `line` it is `F/M Σ line_factor` over them, in
/// weight units × mm (METHOD section 2).
///
/// # Errors
/// [`SamplingError::Samples`] for no samples or too many, [`SamplingError::Cancelled`] when stopped.
pub fn render(
    distribution: &Distribution<'_>,
    stream: &dyn PointStream,
    camera: &Camera,
    options: &RenderOptions,
    watch: &Watch<'_>,
) -> Result<Rendered, SamplingError> {
    let start = Instant::now();
    let samples = stream.samples();
    check_samples(samples)?;
    if distribution.total() == 0 {
        return unseen(camera, &Channels::plain(options.estimand), start);
    }
    let level = SimdLevel::choose(options.simd);
    let density = distribution.density();
    let projection = Projection::new(density.volume().grid(), camera, options.kernel, samples, options.precision)?;
    projection.check(options.estimand)?;
    let projector = projection.projector(options.kernel, options.estimand, level);
    let locator = locator(distribution, level);
    let exposure = Exposure {
        camera,
        estimand: options.estimand,
        samples,
        mass: distribution.mass(),
        share: distribution.mass() / density.mass(),
    };
    exposure.run(&projection, start, watch, |block, scratch, film, counters| {
        let located = draw(distribution, stream, &*locator, block, scratch, counters);
        let Scratch { points, places, pixels, weights, .. } = scratch;
        let lost = projector.project(places, &points.uniforms, pixels, weights);
        film.add(pixels, weights);
        (lost, located)
    })
}

/// As [`render`], with the effects of a look (METHOD section 5): a pixel is the same sum with each sample's term times the
/// look's factor there, one image per channel. A plain look is rendered by [`render`] itself.
///
/// # Errors
/// As [`render`]; also [`SamplingError::Limit`] when there is no memory for a gradient field.
pub fn render_look(
    distribution: &Distribution<'_>,
    stream: &dyn PointStream,
    camera: &Camera,
    look: &Look,
    options: &RenderOptions,
    watch: &Watch<'_>,
) -> Result<Rendered, SamplingError> {
    if look.is_plain() {
        return render(distribution, stream, camera, options, watch);
    }
    let start = Instant::now();
    let samples = stream.samples();
    check_samples(samples)?;
    let number = look.channels();
    if distribution.total() == 0 {
        let channels = Channels { number, weighed: true, unit: 1.0, tint: look.tint };
        return unseen(camera, &channels, start);
    }
    let level = SimdLevel::choose(options.simd);
    let density = distribution.density();
    let projection = Projection::new(density.volume().grid(), camera, options.kernel, samples, options.precision)?;
    projection.check(options.estimand)?;
    let projector = projection.projector(options.kernel, options.estimand, level);
    let locator = locator(distribution, level);
    let effects = EffectPasses::new(density, camera, look, &projection, options, level)?;
    let miss = camera.extent().pixels() as u32;
    let exposure = Exposure {
        camera,
        estimand: options.estimand,
        samples,
        mass: distribution.mass(),
        share: distribution.mass() / density.mass(),
    };
    let channels = Channels { number, weighed: true, unit: effects.unit(options.estimand), tint: look.tint };
    let finished = exposure.run_channels(&projection, &channels, start, watch, |block, scratch, film, counters| {
        let located = draw(distribution, stream, &*locator, block, scratch, counters);
        let Scratch { points, places, pixels, weights, .. } = scratch;
        let lost = projector.project(places, &points.uniforms, pixels, weights);
        effects.apply(scratch, miss, counters);
        film.add_channels(number, &scratch.layers.pixels, &scratch.layers.amounts);
        (lost, located)
    });
    let mut rendered = finished?;
    rendered.counters.gradient_field = effects.field_voxels();
    Ok(rendered)
}

/// The image of a camera that sees nothing of the volume: black, without drawing a sample.
fn unseen(camera: &Camera, channels: &Channels, start: Instant) -> Result<Rendered, SamplingError> {
    let (image, colour) = channels.develop(camera, vec![0.0; channels.number * camera.extent().pixels()])?;
    let seconds = PhaseSeconds { total: start.elapsed().as_secs_f64(), ..PhaseSeconds::default() };
    Ok(Rendered { image, colour, counters: Counters::default(), seconds, precision: Precision::F32 })
}

/// Draws a block's points and finds their voxels.
fn draw(
    distribution: &Distribution<'_>,
    stream: &dyn PointStream,
    locator: &dyn Locate,
    block: u64,
    scratch: &mut Scratch,
    counters: &mut Counters,
) -> Instant {
    let len = block_len(stream.samples(), block);
    scratch.points.resize(len);
    scratch.places.iter_mut().for_each(|p| p.resize(len, 0));
    stream.fill(block, distribution.total(), &mut scratch.points);
    locator.locate(stream.search(), &scratch.points.targets, &mut scratch.places, counters);
    Instant::now()
}

/// Exposes an image to batches of samples, whatever they come from.
pub(crate) struct Exposure<'a> {
    pub camera: &'a Camera,
    pub estimand: Estimand,
    pub samples: u64,
    /// Mass that the samples stand for, weight units × mm³.
    pub mass: f64,
    /// That mass as a share of the whole mass `F`.
    pub share: f64,
}

impl Exposure<'_> {
    /// One channel of plain samples; see [`Self::run_channels`].
    pub(crate) fn run(
        &self,
        projection: &Projection,
        start: Instant,
        watch: &Watch<'_>,
        batch: impl Fn(u64, &mut Scratch, &mut Worker<'_>, &mut Counters) -> (Lost, Instant) + Sync,
    ) -> Result<Rendered, SamplingError> {
        self.run_channels(projection, &Channels::plain(self.estimand), start, watch, batch)
    }

    /// Runs over all blocks on the current pool. `batch` fills the pixels of a block, adds it to the worker's film, and says
    /// how many samples were in no pixel and when its points were drawn.
    pub(crate) fn run_channels(
        &self,
        projection: &Projection,
        channels: &Channels,
        start: Instant,
        watch: &Watch<'_>,
        batch: impl Fn(u64, &mut Scratch, &mut Worker<'_>, &mut Counters) -> (Lost, Instant) + Sync,
    ) -> Result<Rendered, SamplingError> {
        let Self { camera, estimand, samples, mass, share } = *self;
        let line = estimand == Estimand::Line;
        let blocks = block_count(samples);
        let workers = (rayon::current_num_threads() as u64).min(blocks.div_ceil(TAKE)) as usize;
        let totals = Totals::new(channels.number * camera.extent().pixels(), workers);
        let next = AtomicU64::new(0);
        let sum = Mutex::new((Counters::default(), [0.0f64; 2]));
        (0..workers).into_par_iter().with_max_len(1).for_each(|_| {
            let mut film = totals.worker(channels.weighed);
            let mut scratch = Scratch::default();
            let mut counters = Counters::default();
            let mut thread_seconds = [0.0; 2];
            while !watch.cancelled() {
                let first = next.fetch_add(TAKE, Ordering::Relaxed);
                if first >= blocks {
                    break;
                }
                for block in first..blocks.min(first + TAKE) {
                    let len = block_len(samples, block);
                    let t0 = Instant::now();
                    scratch.pixels.resize(len, 0);
                    let (lost, t1) = batch(block, &mut scratch, &mut film, &mut counters);
                    let t2 = Instant::now();
                    counters.samples += len as u64;
                    counters.outside += u64::from(lost.beside);
                    counters.clipped += u64::from(lost.near);
                    counters.inside += len as u64 - u64::from(lost.beside) - u64::from(lost.near);
                    counters.line_weights += if line { len as u64 } else { 0 };
                    thread_seconds[0] += (t1 - t0).as_secs_f64();
                    thread_seconds[1] += (t2 - t1).as_secs_f64();
                    watch.advance(len as u64);
                }
            }
            film.finish();
            let mut sum = sum.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            sum.0.add(&counters);
            sum.1[0] += thread_seconds[0];
            sum.1[1] += thread_seconds[1];
        });
        if watch.cancelled() {
            return Err(SamplingError::Cancelled);
        }
        // What one unit of the sums stands for may be too small a number where the sums' own values are not.
        let lift = if line && mass < power_of_two(-600) { power_of_two(400) } else { 1.0 };
        let unit = match estimand {
            Estimand::Count => share / samples as f64,
            Estimand::Line => mass * lift / samples as f64 * camera.det() * projection.weight_unit(),
        };
        let mut values = totals.into_values(unit * channels.unit);
        if lift != 1.0 {
            values.iter_mut().for_each(|v| *v /= lift);
        }
        let (image, colour) = channels.develop(camera, values)?;
        let (counters, thread_seconds) = sum.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        let total = start.elapsed().as_secs_f64();
        let per_thread = total / (thread_seconds[0] + thread_seconds[1]).max(1e-12);
        let seconds = PhaseSeconds {
            sampling: thread_seconds[0] * per_thread,
            projection: thread_seconds[1] * per_thread,
            total,
        };
        Ok(Rendered { image, colour, counters, seconds, precision: projection.precision() })
    }
}

/// What a film's sums mean.
pub(crate) struct Channels {
    /// Sums a pixel.
    pub number: usize,
    /// False when every sample adds 1.
    pub weighed: bool,
    /// What an amount of 1 stands for.
    pub unit: f64,
    /// Factor on the finished channels.
    pub tint: [f64; 3],
}

impl Channels {
    fn plain(estimand: Estimand) -> Self {
        Self { number: 1, weighed: estimand == Estimand::Line, unit: 1.0, tint: [1.0; 3] }
    }

    /// Separates channels that lie side by side, and tints them.
    fn develop(&self, camera: &Camera, values: Vec<f64>) -> Result<(Image, Option<[Image; 3]>), SamplingError> {
        let Self { number, tint, .. } = *self;
        let wrap = |values: Vec<f64>| {
            Image::from_values(camera.extent(), values).map_err(|e| SamplingError::Camera(e.to_string()))
        };
        if number == 1 && tint.iter().all(|t| *t == tint[0]) {
            let mut image = wrap(values)?;
            if tint[0] != 1.0 {
                image.values_mut().iter_mut().for_each(|v| *v *= tint[0]);
            }
            return Ok((image, None));
        }
        let plane = |c: usize| wrap(values.iter().skip(c % number).step_by(number).map(|v| v * tint[c]).collect());
        let colour = [plane(0)?, plane(1)?, plane(2)?];
        Ok((Image::mean_of(&colour), Some(colour)))
    }
}

/// Arrays of one worker, reused from block to block.
#[derive(Default)]
pub(crate) struct Scratch {
    pub points: PointBlock,
    pub places: [Vec<u32>; 3],
    pub pixels: Vec<u32>,
    pub weights: Weights,
    pub layers: Layers,
}
