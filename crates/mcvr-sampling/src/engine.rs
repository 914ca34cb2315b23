//! The loop that every sampling method shares: fill a block, find its voxels, project, accumulate.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use mcvr_scene::{Camera, Estimand, Image, Kernel, Watch};
use mcvr_volume::{Voxel, with_voxels};
use rayon::prelude::*;
use serde::Serialize;

use crate::accumulate::Totals;
use crate::locate::{BrickSums, find_all};
use crate::order::{Layout, with_layout};
use crate::project::Projection;
use crate::real::Weights;
use crate::stream::check_samples;
use crate::units::{Units, Word, with_units};
use crate::{
    Distribution, PointBlock, PointStream, Precision, SamplingError, Search, SimdLevel, block_count, block_len,
};

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
}

impl Counters {
    fn add(&mut self, o: &Counters) {
        self.samples += o.samples;
        self.inside += o.inside;
        self.outside += o.outside;
        self.clipped += o.clipped;
        self.bricks_decoded += o.bricks_decoded;
        self.voxels_read += o.voxels_read;
        self.line_weights += o.line_weights;
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
    /// Linear values of the estimand.
    pub image: Image,
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
    let level = options.simd.unwrap_or_else(SimdLevel::detect);
    let density = distribution.density();
    let line = options.estimand == Estimand::Line;
    let projection = Projection::new(density, camera, options.kernel, samples, options.precision)?;
    let projector = projection.projector(options.kernel, options.estimand, level);
    let locator: Box<dyn Locate + '_> = with_layout!(&distribution.layout, layout =>
        with_voxels!(density.volume().voxels(), voxels =>
            with_units!(&distribution.weights, density, units =>
                Box::new(Locator { layout, voxels: &voxels[..], units, before: &distribution.before, level })
                    as Box<dyn Locate + '_>)));

    let blocks = block_count(samples);
    let workers = (rayon::current_num_threads() as u64).min(blocks.div_ceil(TAKE)) as usize;
    let totals = Totals::new(camera.extent().pixels(), workers);
    let next = AtomicU64::new(0);
    let sum = Mutex::new((Counters::default(), [0.0f64; 2]));
    (0..workers).into_par_iter().with_max_len(1).for_each(|_| {
        let mut film = totals.worker(line);
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
                scratch.resize(len);
                stream.fill(block, distribution.total(), &mut scratch.points);
                locator.locate(stream.search(), &scratch.points.targets, &mut scratch.places, &mut counters);
                let t1 = Instant::now();
                let lost = projector.project(
                    &scratch.places,
                    &scratch.points.uniforms,
                    &mut scratch.pixels,
                    &mut scratch.weights,
                );
                film.add(&scratch.pixels, &scratch.weights);
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
    let unit = match options.estimand {
        Estimand::Count => 1.0 / samples as f64,
        Estimand::Line => density.mass() / samples as f64 * camera.det() * projection.weight_unit(),
    };
    let image = Image::from_values(camera.extent(), totals.into_values(unit))
        .map_err(|e| SamplingError::Camera(e.to_string()))?;
    let (counters, thread_seconds) = sum.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    let total = start.elapsed().as_secs_f64();
    let share = total / (thread_seconds[0] + thread_seconds[1]).max(1e-12);
    let seconds = PhaseSeconds { sampling: thread_seconds[0] * share, projection: thread_seconds[1] * share, total };
    Ok(Rendered { image, counters, seconds, precision: projection.precision() })
}

/// Arrays of one worker, reused from block to block.
#[derive(Default)]
struct Scratch {
    points: PointBlock,
    places: [Vec<u32>; 3],
    pixels: Vec<u32>,
    weights: Weights,
}

impl Scratch {
    fn resize(&mut self, len: usize) {
        self.points.resize(len);
        self.places.iter_mut().for_each(|p| p.resize(len, 0));
        self.pixels.resize(len, 0);
    }
}

/// Voxel coordinates of a block's targets.
trait Locate: Sync {
    fn locate(&self, search: Search, targets: &[u64], places: &mut [Vec<u32>; 3], counters: &mut Counters);
}

struct Locator<'a, L, T, U> {
    layout: &'a L,
    voxels: &'a [T],
    units: U,
    before: &'a [u64],
    level: SimdLevel,
}

impl<L: Layout, T: Voxel, U: Units<T>> Locate for Locator<'_, L, T, U> {
    fn locate(&self, search: Search, targets: &[u64], places: &mut [Vec<u32>; 3], counters: &mut Counters) {
        match search {
            Search::Walk => self.walk(targets, places, counters),
            Search::Binary => self.binary(targets, places, counters),
            Search::Linear => self.linear(targets, places, counters),
        }
        self.layout.resolve(self.level, places);
    }
}

impl<L: Layout, T: Voxel, U: Units<T>> Locator<'_, L, T, U> {
    #[inline(always)]
    fn decode(&self, brick: usize, sums: &mut BrickSums<U::Word>, counters: &mut Counters) {
        counters.voxels_read += self.layout.sums(brick, self.voxels, self.units, &mut sums.sums) as u64;
        counters.bricks_decoded += 1;
        sums.index();
    }

    /// Places the targets `targets[run]`, all in one brick whose sums are given.
    #[inline(always)]
    fn place(
        &self,
        brick: usize,
        sums: &BrickSums<U::Word>,
        targets: &[u64],
        first: usize,
        positions: &mut [u32],
        places: &mut [Vec<u32>; 3],
    ) {
        find_all(self.level, sums, targets, self.before[brick], positions);
        let start = self.layout.start(brick);
        let [px, py, pz] = places;
        let run = first..first + targets.len();
        let out = px[run.clone()].iter_mut().zip(&mut py[run.clone()]).zip(&mut pz[run]);
        for (((x, y), z), &position) in out.zip(positions.iter()) {
            [*x, *y, *z] = self.layout.place(brick, start, position);
        }
    }

    /// Rising targets: every brick that holds some is decoded once.
    fn walk(&self, targets: &[u64], places: &mut [Vec<u32>; 3], counters: &mut Counters) {
        let mut sums = BrickSums::new();
        let mut positions = [0u32; crate::BLOCK];
        let mut brick = 0;
        let mut first = 0;
        while first < targets.len() {
            brick = brick_of(self.before, brick, targets[first]);
            let limit = self.before[brick + 1];
            let mut end = first + 1;
            while end < targets.len() && targets[end] < limit {
                end += 1;
            }
            self.decode(brick, &mut sums, counters);
            self.place(brick, &sums, &targets[first..end], first, &mut positions[first..end], places);
            first = end;
        }
    }

    /// Targets in any order: each searches the brick totals and decodes its own brick.
    fn binary(&self, targets: &[u64], places: &mut [Vec<u32>; 3], counters: &mut Counters) {
        let mut sums = BrickSums::new();
        for (i, target) in targets.iter().enumerate() {
            let brick = self.before.partition_point(|b| b <= target) - 1;
            self.decode(brick, &mut sums, counters);
            self.place(brick, &sums, std::slice::from_ref(target), i, &mut [0], places);
        }
    }

    /// Targets in any order: each adds up the voxels' weights from the first voxel on.
    fn linear(&self, targets: &[u64], places: &mut [Vec<u32>; 3], counters: &mut Counters) {
        let mut sums = BrickSums::new();
        for (i, target) in targets.iter().enumerate() {
            let (mut brick, mut sum) = (0, 0);
            loop {
                self.decode(brick, &mut sums, counters);
                sum += sums.sums[sums.sums.len() - 1].to_u64();
                if *target < sum {
                    break;
                }
                brick += 1;
            }
            self.place(brick, &sums, std::slice::from_ref(target), i, &mut [0], places);
        }
    }
}

/// The brick that holds a target, searched forward from a brick at or before it: a few steps one by one,
/// then doubling.
#[inline(always)]
fn brick_of(before: &[u64], from: usize, target: u64) -> usize {
    let mut brick = from;
    for _ in 0..4 {
        if target < before[brick + 1] {
            return brick;
        }
        brick += 1;
    }
    let mut step = 8;
    let mut low = brick;
    while low + step + 1 < before.len() && before[low + step] <= target {
        low += step;
        step *= 2;
    }
    let high = (low + step + 1).min(before.len());
    low + before[low..high].partition_point(|b| *b <= target) - 1
}
