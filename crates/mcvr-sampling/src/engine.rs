//! The loop that every sampling method shares: fill a block, find its voxels, project, accumulate.

use std::time::Instant;

use mcvr_scene::{Camera, Estimand, Image, Kernel, Look, Watch};
use serde::Serialize;

use crate::effects::EffectPasses;
use crate::expose::{Channels, Exposure, Scratch};
use crate::find::{Locate, locator};
use crate::projection::Projection;
use crate::stream::check_samples;
use crate::{Distribution, PointStream, Precision, SamplingError, SimdLevel, block_len};

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
pub(crate) fn draw(
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
    let Scratch { points, places, turned, .. } = scratch;
    locator.locate(stream.search(), &points.targets, places, turned, counters);
    Instant::now()
}
