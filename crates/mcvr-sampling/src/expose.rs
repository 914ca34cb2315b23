//! From batches of samples to sums of pixels: the loop over blocks that all images of samples share.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use mcvr_scene::{Camera, Estimand, Image, Watch, power_of_two};
use rayon::prelude::*;

use crate::accumulate::{Totals, Worker};
use crate::effects::Layers;
use crate::engine::{Counters, PhaseSeconds, Rendered};
use crate::project::Lost;
use crate::projection::Projection;
use crate::real::Weights;
use crate::unpack::Turned;
use crate::{PointBlock, SamplingError, block_count, block_len};

/// Blocks that a worker takes at a time.
const TAKE: u64 = 4;

/// Samples of one film: how many, and where their sums go.
pub(crate) struct Job<'a> {
    pub samples: u64,
    pub totals: &'a Totals,
}

/// What exposing took.
#[derive(Default)]
pub(crate) struct Exposed {
    pub counters: Counters,
    /// Seconds of all threads together: drawing, and what follows it.
    pub thread_seconds: [f64; 2],
}

/// Exposes films to their samples on the current pool. `batch` fills the pixels of one block of a job (their numbers come with
/// it), adds it to the worker's film, and says how many samples were in no pixel and when its points were drawn.
///
/// # Errors
/// [`SamplingError::Cancelled`] when stopped; the films then hold some of the samples.
pub(crate) fn expose(
    jobs: &[Job<'_>],
    weighed: bool,
    line: bool,
    watch: &Watch<'_>,
    batch: impl Fn(usize, u64, &mut Scratch, &mut Worker<'_>, &mut Counters) -> (Lost, Instant) + Sync,
) -> Result<Exposed, SamplingError> {
    // Takes of all jobs, one job after the other.
    let ends: Vec<u64> = jobs
        .iter()
        .scan(0, |sum, job| {
            *sum += block_count(job.samples).div_ceil(TAKE);
            Some(*sum)
        })
        .collect();
    let Some(&takes) = ends.last() else { return Ok(Exposed::default()) };
    let workers = (rayon::current_num_threads() as u64).min(takes) as usize;
    let next = AtomicU64::new(0);
    let sum = Mutex::new(Exposed::default());
    (0..workers).into_par_iter().with_max_len(1).for_each(|_| {
        let mut film: Option<(usize, Worker<'_>)> = None;
        let mut scratch = Scratch::default();
        let mut counters = Counters::default();
        let mut thread_seconds = [0.0; 2];
        while !watch.cancelled() {
            let take = next.fetch_add(1, Ordering::Relaxed);
            if take >= takes {
                break;
            }
            let job = ends.partition_point(|end| *end <= take);
            let Job { samples, totals } = jobs[job];
            let mut worker = match film.take() {
                Some((of, worker)) if of == job => worker,
                Some((_, worker)) => worker.turn_to(totals, weighed, samples),
                None => totals.worker(weighed, samples),
            };
            let first = (take - if job == 0 { 0 } else { ends[job - 1] }) * TAKE;
            for block in first..block_count(samples).min(first + TAKE) {
                let len = block_len(samples, block);
                let t0 = Instant::now();
                scratch.pixels.resize(len, 0);
                let (lost, t1) = batch(job, block, &mut scratch, &mut worker, &mut counters);
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
            film = Some((job, worker));
        }
        if let Some((_, worker)) = film {
            worker.finish();
        }
        let mut sum = sum.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        sum.counters.add(&counters);
        sum.thread_seconds[0] += thread_seconds[0];
        sum.thread_seconds[1] += thread_seconds[1];
    });
    if watch.cancelled() {
        return Err(SamplingError::Cancelled);
    }
    Ok(sum.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner))
}

impl Exposed {
    /// The wall time since `start`, shared out as the threads spent theirs.
    pub(crate) fn seconds(&self, start: Instant) -> PhaseSeconds {
        let total = start.elapsed().as_secs_f64();
        let per_thread = total / (self.thread_seconds[0] + self.thread_seconds[1]).max(1e-12);
        PhaseSeconds {
            sampling: self.thread_seconds[0] * per_thread,
            projection: self.thread_seconds[1] * per_thread,
            total,
        }
    }
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

    /// Exposes one film and develops it; see [`expose`].
    pub(crate) fn run_channels(
        &self,
        projection: &Projection,
        channels: &Channels,
        start: Instant,
        watch: &Watch<'_>,
        batch: impl Fn(u64, &mut Scratch, &mut Worker<'_>, &mut Counters) -> (Lost, Instant) + Sync,
    ) -> Result<Rendered, SamplingError> {
        let Self { camera, estimand, samples, .. } = *self;
        let line = estimand == Estimand::Line;
        let workers = rayon::current_num_threads();
        let totals = Totals::new(channels.number * camera.extent().pixels(), workers)?;
        let job = Job { samples, totals: &totals };
        let exposed = expose(&[job], channels.weighed, line, watch, |_, block, scratch, film, counters| {
            batch(block, scratch, film, counters)
        })?;
        let scale = self.scale(projection, channels);
        let values = scale.values(totals);
        let (image, colour) = channels.develop(camera, values)?;
        let seconds = exposed.seconds(start);
        Ok(Rendered { image, colour, counters: exposed.counters, seconds, precision: projection.precision() })
    }

    /// What the sums of this exposure's films stand for, before the tint.
    pub(crate) fn scale(&self, projection: &Projection, channels: &Channels) -> Scale {
        let Self { camera, estimand, samples, mass, share } = *self;
        // What one unit of the sums stands for may be too small a number where the sums' own values are not.
        let lifted = estimand == Estimand::Line && mass < power_of_two(-600);
        let lift = if lifted { power_of_two(400) } else { 1.0 };
        let unit = match estimand {
            Estimand::Count => share / samples as f64,
            Estimand::Line => mass * lift / samples as f64 * camera.det() * projection.weight_unit(),
        };
        Scale { unit: unit * channels.unit, lift }
    }
}

/// From a sum to a value.
#[derive(Clone, Copy)]
pub(crate) struct Scale {
    unit: f64,
    lift: f64,
}

impl Scale {
    /// The values of all pixels.
    fn values(self, totals: Totals) -> Vec<f64> {
        let mut values: Vec<f64> = totals.into_sums().map(|sum| sum as f64 * self.unit).collect();
        if self.lift != 1.0 {
            values.iter_mut().for_each(|v| *v /= self.lift);
        }
        values
    }

    /// The value of one sum.
    #[inline]
    pub(crate) fn value(self, sum: u64) -> f64 {
        let value = sum as f64 * self.unit;
        if self.lift == 1.0 { value } else { value / self.lift }
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
    pub(crate) fn plain(estimand: Estimand) -> Self {
        Self { number: 1, weighed: estimand == Estimand::Line, unit: 1.0, tint: [1.0; 3] }
    }

    /// Channels of the developed image: 1 or 3.
    pub(crate) fn planes(&self) -> usize {
        if self.number == 1 && self.tint.iter().all(|t| *t == self.tint[0]) { 1 } else { 3 }
    }

    /// Separates channels that lie side by side, and tints them.
    pub(crate) fn develop(
        &self,
        camera: &Camera,
        values: Vec<f64>,
    ) -> Result<(Image, Option<[Image; 3]>), SamplingError> {
        let Self { number, tint, .. } = *self;
        let wrap = |values: Vec<f64>| {
            Image::from_values(camera.extent(), values).map_err(|e| SamplingError::Camera(e.to_string()))
        };
        if self.planes() == 1 {
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
    pub turned: Turned,
    pub pixels: Vec<u32>,
    pub weights: Weights,
    pub layers: Layers,
}
