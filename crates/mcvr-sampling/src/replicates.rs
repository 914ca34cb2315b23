//! Independent images of one scene in the making: each can be given more samples at any time.
//!
//! The spread of replicates is the one honest measure of a quasi-Monte Carlo image's error (METHOD section 6). Sums stay integers
//! with one unit whatever the number of samples, so an image refined in passes equals, bit for bit, the image of all its
//! samples at once.

use std::time::Instant;

use mcvr_scene::{Camera, Estimand, Look, Watch};

use crate::accumulate::Totals;
use crate::effects::EffectPasses;
use crate::engine::{Counters, PhaseSeconds, RenderOptions, draw};
use crate::expose::{Channels, Exposure, Job, Scale, Scratch, expose};
use crate::find::{Locate, locator};
use crate::project::Project;
use crate::projection::Projection;
use crate::{Distribution, PointStream, Precision, SamplingError, SimdLevel};

/// Most samples of one replicate; fixed-point weights have the bits that such a sum leaves them.
pub const MAX_REPLICATE_SAMPLES: u64 = 1 << 37;

/// Samples of one replicate, still to be drawn.
pub struct ReplicatePoints {
    /// Number of the replicate.
    pub replicate: usize,
    /// Its next points.
    pub stream: Box<dyn PointStream>,
}

/// Replicate images of a scene, as sums. Drop it after an error: some of the samples may be in.
pub struct Replicates<'a> {
    distribution: &'a Distribution<'a>,
    camera: &'a Camera,
    estimand: Estimand,
    projection: Projection,
    /// `None` when the camera sees nothing: no sample is drawn then.
    view: Option<ViewPasses<'a>>,
    channels: Channels,
    films: Vec<Totals>,
    samples: Vec<u64>,
    counters: Counters,
    discarded: Counters,
    gradient_field: u64,
}

/// What turns points into pixels.
struct ViewPasses<'a> {
    projector: Box<dyn Project>,
    locator: Box<dyn Locate + 'a>,
    effects: Option<EffectPasses<'a>>,
}

impl<'a> Replicates<'a> {
    /// `number` images without samples.
    ///
    /// # Errors
    /// As [`render_look`](crate::render_look); [`SamplingError::Limit`] when there is no memory for the sums: 8 bytes a pixel,
    /// channel and replicate.
    pub fn new(
        distribution: &'a Distribution<'a>,
        camera: &'a Camera,
        look: &'a Look,
        options: &RenderOptions,
        number: usize,
    ) -> Result<Self, SamplingError> {
        let level = SimdLevel::choose(options.simd);
        let density = distribution.density();
        let grid = density.volume().grid();
        let projection = Projection::new(grid, camera, options.kernel, MAX_REPLICATE_SAMPLES, options.precision)?;
        let mut channels = Channels::plain(options.estimand);
        let mut view = None;
        if distribution.total() > 0 {
            projection.check(options.estimand)?;
            let effects = match look.is_plain() {
                true => None,
                false => Some(EffectPasses::new(density, camera, look, &projection, options, level)?),
            };
            if let Some(effects) = &effects {
                let unit = effects.unit(options.estimand);
                channels = Channels { number: look.channels(), weighed: true, unit, tint: look.tint };
            }
            let projector = projection.projector(options.kernel, options.estimand, level);
            view = Some(ViewPasses { projector, locator: locator(distribution, level), effects });
        } else if !look.is_plain() {
            channels = Channels { number: look.channels(), weighed: true, unit: 1.0, tint: look.tint };
        }
        let workers = rayon::current_num_threads();
        let slots = channels.number * camera.extent().pixels();
        let films = (0..number).map(|_| Totals::new(slots, workers)).collect::<Result<_, _>>()?;
        let samples = vec![0; number];
        let gradient_field = view.as_ref().and_then(|v| v.effects.as_ref()).map_or(0, EffectPasses::field_voxels);
        let (counters, discarded) = (Counters::default(), Counters::default());
        let estimand = options.estimand;
        Ok(Self {
            distribution,
            camera,
            estimand,
            projection,
            view,
            channels,
            films,
            samples,
            counters,
            discarded,
            gradient_field,
        })
    }

    /// Adds samples on the current pool.
    ///
    /// # Errors
    /// [`SamplingError::Samples`] when a replicate would have more than [`MAX_REPLICATE_SAMPLES`], before any is drawn;
    /// [`SamplingError::Cancelled`] when stopped.
    ///
    /// # Panics
    /// When there is no such replicate.
    pub fn add(&mut self, points: &[ReplicatePoints], watch: &Watch<'_>) -> Result<PhaseSeconds, SamplingError> {
        let start = Instant::now();
        for p in points {
            let samples = &mut self.samples[p.replicate];
            *samples += p.stream.samples();
            if *samples > MAX_REPLICATE_SAMPLES {
                return Err(SamplingError::Samples(*samples));
            }
        }
        let Some(ViewPasses { projector, locator, effects }) = &self.view else {
            return Ok(PhaseSeconds { total: start.elapsed().as_secs_f64(), ..PhaseSeconds::default() });
        };
        let jobs: Vec<Job<'_>> =
            points.iter().map(|p| Job { samples: p.stream.samples(), totals: &self.films[p.replicate] }).collect();
        let (number, miss) = (self.channels.number, self.camera.extent().pixels() as u32);
        let line = self.estimand == Estimand::Line;
        let exposed = expose(&jobs, self.channels.weighed, line, watch, |job, block, scratch, film, counters| {
            let stream = &*points[job].stream;
            let located = draw(self.distribution, stream, &**locator, block, scratch, counters);
            let Scratch { points, places, pixels, weights, .. } = scratch;
            let lost = projector.project(places, &points.uniforms, pixels, weights);
            match effects {
                None => film.add(pixels, weights),
                Some(effects) => {
                    effects.apply(scratch, miss, counters);
                    film.add_channels(number, &scratch.layers.pixels, &scratch.layers.amounts);
                }
            }
            (lost, located)
        })?;
        self.counters.add(&exposed.counters);
        Ok(exposed.seconds(start))
    }

    /// Takes all samples out again. Their work stays counted, in [`Replicates::work`].
    pub fn clear(&mut self) {
        self.films.iter_mut().for_each(Totals::clear);
        self.samples.fill(0);
        self.discarded.add(&std::mem::take(&mut self.counters));
    }

    /// Number of replicates.
    pub fn number(&self) -> usize {
        self.films.len()
    }

    /// The work behind the samples that are in.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// All work so far, also that on samples which were taken out.
    pub fn work(&self) -> Counters {
        let mut all = self.counters;
        all.add(&self.discarded);
        all.gradient_field = self.gradient_field;
        all
    }

    /// Arithmetic of the projection.
    pub fn precision(&self) -> Precision {
        self.projection.precision()
    }

    /// True when no voxel that weighs anything is in view: the image is black, without a sample.
    pub fn sees_nothing(&self) -> bool {
        self.view.is_none()
    }

    /// The most that one sample adds to a sum.
    pub fn heaviest(&self) -> u64 {
        if self.channels.weighed { 1 << self.projection.weight_bits() } else { 1 }
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        self.camera
    }

    /// Channels of the image: 1 or 3.
    pub fn channels(&self) -> usize {
        self.channels.planes()
    }

    /// From a sum of one replicate to its value there (METHOD section 2, unit of the estimand), if it has `samples` samples.
    pub fn developer(&self, samples: u64) -> Developer {
        let density = self.distribution.density();
        let exposure = Exposure {
            camera: self.camera,
            estimand: self.estimand,
            samples: samples.max(1),
            mass: self.distribution.mass(),
            share: self.distribution.mass() / density.mass(),
        };
        Developer { scale: exposure.scale(&self.projection, &self.channels), tint: self.channels.tint }
    }

    /// Integer sum of one replicate in one pixel and channel.
    #[inline]
    pub fn sum(&self, replicate: usize, pixel: usize, channel: usize) -> u64 {
        // A tinted grey image has three channels of one sum.
        let number = self.channels.number;
        self.films[replicate].sum(pixel * number + if number == 1 { 0 } else { channel })
    }
}

/// From integer sums to values.
#[derive(Clone, Copy)]
pub struct Developer {
    scale: Scale,
    tint: [f64; 3],
}

impl Developer {
    /// The value of a sum in a channel.
    #[inline]
    pub fn value(&self, sum: u64, channel: usize) -> f64 {
        let (value, tint) = (self.scale.value(sum), self.tint[channel]);
        if tint == 1.0 { value } else { value * tint }
    }
}
