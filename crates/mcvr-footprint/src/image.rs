//! An image of footprints.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use mcvr_scene::{Camera, Density, Estimand, Extent, Image, Look, Watch};
use mcvr_volume::{SimdLevel, Voxel, with_voxels};
use rayon::prelude::*;

use crate::amount::Scale;
use crate::frame::{Batch, Frame};
use crate::gather::{Bricks, STREAMS, Source, Waiting};
use crate::large::{self, Room};
use crate::profiles::{Profiles, Row, widest};
use crate::projection::Projection;
use crate::refine::{Tap, parts, taps};
use crate::shape::Shape;
use crate::splat::interleaved;
use crate::{Counters, FootprintError, FootprintOptions};

/// An image made by footprints.
#[derive(Clone, Debug, PartialEq)]
pub struct FootprintImage {
    /// The estimand's value for every pixel.
    pub image: Image,
    /// Work done.
    pub counters: Counters,
    /// Wall time in seconds, preparation included.
    pub seconds: f64,
}

/// An image made by footprints in a look's colour.
#[derive(Clone, Debug, PartialEq)]
pub struct LookFootprints {
    /// One channel, or red, green and blue.
    pub channels: Vec<Image>,
    /// Work done.
    pub counters: Counters,
    /// Wall time in seconds, preparation included.
    pub seconds: f64,
}

/// Largest margin.
pub(crate) const MARGIN: usize = 24;

/// Bytes that the threads' own images may take in all, where one does not take more.
const PRIVATE: usize = 1 << 30;

/// Footprints worth an image of sums of one's own.
const WORTH_A_THREAD: u64 = 1 << 14;

/// Bytes of an image of sums.
pub(crate) fn image_bytes(width: usize, height: usize) -> usize {
    8 * width * height
}

/// Most images of sums at a time.
pub(crate) fn workers(width: usize, height: usize) -> usize {
    rayon::current_num_threads().min(PRIVATE / image_bytes(width, height)).max(1)
}

/// Makes the image by footprints. The same image, bit for bit, for any number of threads and any vector instructions: amounts are added
/// as whole numbers. Every thread at work holds an image of sums of 8 bytes a pixel; there are fewer of them where those would take
/// more than 1 GiB. `watch` hears of as many units as the image has rows.
///
/// # Errors
/// [`FootprintError::Kernel`], [`FootprintError::Refine`] or [`FootprintError::Extent`] for unusable options,
/// [`FootprintError::Memory`] when there is none for the sums, [`FootprintError::Cancelled`] when `watch` said so.
pub fn footprints(
    density: &Density,
    camera: &Camera,
    options: &FootprintOptions,
    watch: &Watch,
) -> Result<FootprintImage, FootprintError> {
    let start = Instant::now();
    let grid = density.volume().grid();
    options.check(grid)?;
    let finished = |image, counters| FootprintImage { image, counters, seconds: start.elapsed().as_secs_f64() };
    let parts = parts(grid, options);
    let Some(projection) = Projection::new(grid, parts, camera, MARGIN) else {
        watch.advance(camera.extent().height as u64);
        return Ok(finished(Image::zeros(camera.extent()), Counters::default()));
    };
    let scene = Scene { density, camera, options, parts, watch };
    let largest = projection.spans[0][1].max(projection.spans[1][1]);
    let (image, counters) = match largest {
        w if w <= widest(4) => scene.image::<[f32; 4]>(projection),
        w if w <= widest(6) => scene.image::<[f32; 6]>(projection),
        w if w <= widest(8) => scene.image::<[f32; 8]>(projection),
        w if w <= widest(12) => scene.image::<[f32; 12]>(projection),
        w if w <= widest(16) => scene.image::<[f32; 16]>(projection),
        _ => scene.image::<[f32; MARGIN]>(projection),
    }?;
    Ok(finished(image, counters))
}

/// Makes the image by [`footprints()`] for a look without effects along the ray; its tint counts.
///
/// # Errors
/// As [`footprints()`], and [`FootprintError::Effects`] for a look that is not plain.
pub fn footprints_with_look(
    density: &Density,
    camera: &Camera,
    look: &Look,
    options: &FootprintOptions,
    watch: &Watch,
) -> Result<LookFootprints, FootprintError> {
    if !look.is_plain() {
        return Err(FootprintError::Effects);
    }
    let FootprintImage { image, counters, seconds } = footprints(density, camera, options, watch)?;
    let channel = |t: &f64| {
        let mut channel = image.clone();
        channel.values_mut().iter_mut().for_each(|v| *v *= t);
        channel
    };
    let channels = look.tint[..if look.is_coloured() { 3 } else { 1 }].iter().map(channel).collect();
    Ok(LookFootprints { channels, counters, seconds })
}

struct Scene<'a> {
    density: &'a Density,
    camera: &'a Camera,
    options: &'a FootprintOptions,
    parts: [u32; 3],
    watch: &'a Watch<'a>,
}

/// What all threads share.
struct Job<'a, R, T> {
    frame: &'a Frame,
    shapes: &'a [Shape; 2],
    rows: &'a [R],
    taps: &'a [Tap],
    bricks: &'a Bricks,
    source: &'a Source<'a, T>,
    level: SimdLevel,
    watch: &'a Watch<'a>,
    done: &'a AtomicU64,
    image_rows: u64,
}

/// Zeros.
fn sums(pixels: usize) -> Result<Vec<i64>, FootprintError> {
    let mut image = Vec::new();
    image.try_reserve_exact(pixels).map_err(|_| FootprintError::Memory { bytes: 8 * pixels as u64 })?;
    image.resize(pixels, 0);
    Ok(image)
}

impl Scene<'_> {
    fn image<R: Row>(&self, projection: Projection) -> Result<(Image, Counters), FootprintError> {
        let Self { density, camera, options, .. } = *self;
        let extent = camera.extent();
        let (width, height) = (extent.width + 2 * R::SIDE, extent.height + 2 * R::SIDE);
        let shapes = projection.steps.map(Shape::new);
        let profiles = Profiles::<R>::new(&projection, &shapes);
        let scale = Scale::new(density, camera, &projection, options.estimand);
        let frame = Frame {
            projection,
            widths: profiles.widths,
            offsets: profiles.offsets as u32,
            widest: widest(R::SIDE),
            width: width as f32,
            height: height as f32,
            side: R::SIDE as f32,
            nearest: if camera.is_parallel() { f32::INFINITY } else { 1.0 },
            line: options.estimand == Estimand::Line,
        };
        let taps = taps(self.parts);
        let bricks = Bricks::new(density.occupancy());
        let work = density.report().positive.saturating_mul(taps.len() as u64);
        let workers = workers(width, height).min((work / WORTH_A_THREAD) as usize + 1);
        let done = AtomicU64::new(0);
        let made: Vec<(Vec<i64>, Counters)> = with_voxels!(density.volume().voxels(), v => {
            let source = Source::new(density, &v[..], scale.units);
            let job = Job {
                frame: &frame, shapes: &shapes, rows: &profiles.rows, taps: &taps, bricks: &bricks, source: &source,
                level: SimdLevel::choose(options.level), watch: self.watch, done: &done, image_rows: extent.height as u64,
            };
            (0..workers).into_par_iter().with_max_len(1).map(|_| job.run(width * height)).collect::<Result<_, _>>()
        })?;
        if self.watch.cancelled() {
            return Err(FootprintError::Cancelled);
        }
        let voxels_visited = bricks.voxels(density.volume().grid().dims());
        let mut counters = Counters { voxels_visited, ..Counters::default() };
        made.iter().for_each(|(_, c)| counters += *c);
        let images: Vec<&[i64]> = made.iter().map(|(image, _)| &image[..]).filter(|i| !i.is_empty()).collect();
        Ok((reduce(extent, &images, width, R::SIDE, scale.value)?, counters))
    }
}

/// The image that the sums are, without its margin.
fn reduce(extent: Extent, sums: &[&[i64]], width: usize, margin: usize, value: f64) -> Result<Image, FootprintError> {
    let mut image = Image::zeros(extent);
    image.values_mut().par_chunks_mut(extent.width).enumerate().with_min_len(16).for_each(|(y, row)| {
        let from = (y + margin) * width + margin;
        for (x, pixel) in row.iter_mut().enumerate() {
            let mut sum = 0i64;
            for image in sums {
                sum = sum.wrapping_add(image[from + x]);
            }
            *pixel = sum as f64 * value;
        }
    });
    Ok(image)
}

/// A part of the volume whose voxels take turns with those of others.
struct Stream<'a> {
    bricks: &'a [[u32; 3]],
    waiting: Waiting,
    batch: Box<Batch>,
    tap: usize,
    many: usize,
    added: usize,
}

impl<R: Row, T: Voxel> Job<'_, R, T> {
    /// Adds voxels to an image of sums until there are none left. No image where there was nothing to add.
    fn run(&self, pixels: usize) -> Result<(Vec<i64>, Counters), FootprintError> {
        let (mut image, mut counters, mut room) = (vec![], Counters::default(), Room::default());
        let stream = || Stream { bricks: &[], waiting: Waiting::new(), batch: Batch::new(), tap: 0, many: 0, added: 0 };
        let mut streams: Vec<Stream<'_>> = (0..STREAMS).map(|_| stream()).collect();
        while !self.watch.cancelled() {
            for (n, stream) in streams.iter_mut().enumerate().filter(|(_, s)| s.added == s.many) {
                if !self.advance(n, stream) {
                    continue;
                }
                if image.is_empty() {
                    image = sums(pixels)?;
                }
                self.project(stream, &mut image, &mut counters, &mut room);
            }
            let active: Vec<(&Batch, usize)> =
                streams.iter().filter(|s| s.added < s.many).map(|s| (&*s.batch, s.added)).collect();
            let Some(many) = streams.iter().map(|s| s.many - s.added).filter(|n| *n > 0).min() else { break };
            interleaved(self.level, &mut image, self.frame.width as usize, self.rows, &active, many);
            streams.iter_mut().filter(|s| s.added < s.many).for_each(|s| s.added += many);
        }
        Ok((image, counters))
    }

    /// Moves on to the next tap, or the next voxels; false where there are none.
    fn advance<'b>(&'b self, number: usize, stream: &mut Stream<'b>) -> bool {
        if stream.many > 0 && stream.tap + 1 < self.taps.len() {
            stream.tap += 1;
            return true;
        }
        stream.tap = 0;
        stream.waiting.drop_batch();
        let looked_at = stream.waiting.refill(self.level, self.source, self.bricks, (number, &mut stream.bricks));
        if looked_at > 0 {
            let before = self.done.fetch_add(looked_at as u64, Ordering::Relaxed);
            let rows = |done: u64| (u128::from(done) * u128::from(self.image_rows) / self.bricks.len() as u128) as u64;
            self.watch.advance(rows(before + looked_at as u64) - rows(before));
        }
        stream.many = 0;
        stream.added = 0;
        !stream.waiting.batch().1.is_empty()
    }

    /// Projects the batch; footprints too large for profiles are added at once.
    fn project(&self, stream: &mut Stream<'_>, image: &mut [i64], counters: &mut Counters, room: &mut Room) {
        let (at, weight) = stream.waiting.batch();
        let tap = &self.taps[stream.tap];
        let [seen, large] = crate::frame::projected(self.level, self.frame, at, weight, tap, &mut stream.batch);
        (stream.many, stream.added) = (weight.len(), 0);
        counters.footprints += u64::from(seen);
        counters.pixels_touched += u64::from(seen) * (R::SIDE * R::SIDE) as u64;
        if large == 0 {
            return;
        }
        for n in (0..weight.len()).filter(|n| stream.batch.large[*n] != 0) {
            let at = [0, 1, 2].map(|a| at[a][n] + tap.at[a]);
            let touched = large::add(self.frame, self.shapes, at, weight[n] * tap.share, image, room);
            counters.footprints += u64::from(touched > 0);
            counters.pixels_touched += touched;
        }
    }
}
