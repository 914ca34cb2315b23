//! Images by packets: tiles of pixels, the rays of their pixels, packets of rays.

use std::ops::Range;

use mcvr_scene::{Camera, Density, Estimand, Extent, Image, Watch};
use mcvr_volume::{SimdLevel, Voxel};
use rayon::prelude::*;

use super::beam::Optics;
use super::corners::{Corners, Weights};
use super::lanes::{LANES, Portable, Simd};
use super::tiles::{TILE, Tiles};
use super::trace::{Work, cells, comb};
use super::weigh::{Visit, with_corners};
#[cfg(target_arch = "x86_64")]
use super::x86::{Avx2, Avx512};
use crate::Counters;
use crate::points::Points;
use crate::view::View;

/// How a ray is integrated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Along {
    /// Exactly, cell by cell.
    Exact,
    /// By samples this many millimetres apart.
    Comb(f64),
}

/// What is to be integrated for an image.
pub(crate) struct Plan {
    pub along: Along,
    pub points: Points,
    pub estimand: Estimand,
}

/// A density's trilinear field, ready for packets.
#[derive(Clone, Copy)]
pub(crate) struct Packets<'a> {
    density: &'a Density,
    level: SimdLevel,
}

/// Gaps in depth that are not worth a new start, in samples of a comb or in voxels.
const GAP: f64 = 4.0;

impl<'a> Packets<'a> {
    pub fn new(density: &'a Density) -> Self {
        Self { density, level: SimdLevel::detect() }
    }

    /// The same on other instructions.
    #[cfg(test)]
    pub fn on(self, level: SimdLevel) -> Self {
        Self { level, ..self }
    }

    /// Casts an image; `None` where packets do not serve the density. The same bits for any number of threads and on any
    /// instructions.
    pub fn image(&self, camera: &Camera, plan: &Plan, watch: &Watch) -> Option<(Image, Counters)> {
        with_corners(self.density, Whole { packets: self, camera, plan, watch })
    }

    /// Runs `visit` on strips of an image; `None` where packets do not serve the density.
    pub fn look<V: Look>(&self, camera: &Camera, estimand: Estimand, watch: &Watch, visit: V) -> Option<V::Out> {
        with_corners(self.density, Parts { packets: self, camera, estimand, watch, visit })
    }
}

/// Two lines of pixels through the middle of a tile: a packet of rays.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Strip {
    /// Column and row of the tile.
    pub tile: (usize, usize),
    /// Whether the lines go down the image rather than across it.
    pub upright: bool,
}

/// The lines' values, 0 beyond the image's edge.
pub(crate) type Lines = [[f64; TILE]; 2];

/// One way to cast a strip.
pub(crate) struct Job {
    pub along: Along,
    /// Of strips across the image, and of upright ones.
    pub points: [Points; 2],
}

/// Casts strips in several ways: the lines of every job of every strip, and the work of every job. All jobs of a strip are done in turn, while
/// its voxels are at hand.
pub(crate) type Cast<'a> = dyn Fn(&[Job], &[Strip]) -> (Vec<Vec<Lines>>, Vec<Counters>) + 'a;

/// Code that looks at strips of an image.
pub(crate) trait Look {
    type Out;

    /// `full` are the columns and rows of the tiles whose rays can meet density.
    fn run(self, full: &[(usize, usize)], cast: &Cast<'_>) -> Self::Out;
}

/// What is the same for all rays of a view.
struct Ready<'a, 'w, T, W> {
    field: &'w Corners<'a, T, W>,
    tiles: Tiles,
    view: View,
    smallest: f64,
    level: SimdLevel,
    camera: &'w Camera,
    watch: &'w Watch<'w>,
}

impl<'a, 'w, T: Voxel, W: Weights<T>> Ready<'a, 'w, T, W> {
    fn new(
        packets: &Packets<'_>,
        field: &'w Corners<'a, T, W>,
        camera: &'w Camera,
        estimand: Estimand,
        watch: &'w Watch<'w>,
    ) -> Self {
        let Packets { density, level } = *packets;
        let grid = density.volume().grid();
        let view = View::new(camera, grid, estimand, density.mass(), 1.0);
        let tiles = Tiles::new(density.occupancy(), camera, grid, view.depth());
        Self { field, tiles, view, smallest: grid.spacing().min_element(), level, camera, watch }
    }

    fn optics(&self, along: Along) -> Optics {
        let spacing = match along {
            Along::Comb(spacing) => spacing,
            Along::Exact => self.smallest,
        };
        Optics::new(&self.view, &self.tiles, spacing)
    }

    /// Casts a part of the tiles of some columns of a row of tiles into rows of pixels, which begin at the first column's and are
    /// `stride` long.
    fn cast(
        &self,
        (along, optics, points): (Along, &Optics, &Points),
        part: Part,
        row: usize,
        columns: Range<usize>,
        (out, stride): (&mut [f64], usize),
    ) -> (Counters, Work) {
        let extent = self.camera.extent();
        let band =
            Band { field: self.field, optics, tiles: &self.tiles, points, extent, stride, part, watch: self.watch };
        let mut work = (Counters::default(), Work::default());
        match (along == Along::Exact, self.view.squared()) {
            (false, false) => band.run::<false, false>(self.level, row, columns, out, &mut work),
            (false, true) => band.run::<false, true>(self.level, row, columns, out, &mut work),
            (true, false) => band.run::<true, false>(self.level, row, columns, out, &mut work),
            (true, true) => band.run::<true, true>(self.level, row, columns, out, &mut work),
        }
        work
    }

    fn sum(&self, work: Vec<(Counters, Work)>) -> Counters {
        let points = if self.view.squared() { 3 } else { 2 };
        let mut counters = Counters::default();
        for (mut c, w) in work {
            c.cells = w.cells;
            c.evaluations = w.evaluations + points * w.cells;
            c.voxel_reads = 8 * (w.evaluations + w.cells - w.border.cells) + w.border.reads;
            counters += c;
        }
        counters
    }
}

struct Whole<'a, 'w> {
    packets: &'w Packets<'a>,
    camera: &'w Camera,
    plan: &'w Plan,
    watch: &'w Watch<'w>,
}

impl<'a> Visit<'a> for Whole<'_, '_> {
    type Out = (Image, Counters);

    fn run<T: Voxel, W: Weights<T> + Send + 'a>(self, field: Corners<'a, T, W>) -> Self::Out {
        let Self { packets, camera, plan, watch } = self;
        let ready = Ready::new(packets, &field, camera, plan.estimand, watch);
        let optics = ready.optics(plan.along);
        let width = camera.extent().width;
        let mut image = Image::zeros(camera.extent());
        let rows = image.values_mut().par_chunks_mut(TILE * width).enumerate().with_max_len(1);
        let work = rows.map(|(row, out)| {
            let how = (plan.along, &optics, &plan.points);
            let work = ready.cast(how, Part::All, row, 0..width.div_ceil(TILE), (&mut *out, width));
            watch.advance((out.len() / width) as u64);
            work
        });
        let work = work.collect();
        (image, ready.sum(work))
    }
}

struct Parts<'a, 'w, V> {
    packets: &'w Packets<'a>,
    camera: &'w Camera,
    estimand: Estimand,
    watch: &'w Watch<'w>,
    visit: V,
}

impl<'a, V: Look> Visit<'a> for Parts<'_, '_, V> {
    type Out = V::Out;

    fn run<T: Voxel, W: Weights<T> + Send + 'a>(self, field: Corners<'a, T, W>) -> Self::Out {
        let Self { packets, camera, estimand, watch, visit } = self;
        let ready = Ready::new(packets, &field, camera, estimand, watch);
        let extent = camera.extent();
        let one = |job: &Job, optics: &Optics, &Strip { tile: (column, row), upright }: &Strip| {
            let mut tile = [0.0; TILE * TILE];
            let part = if upright { Part::Columns } else { Part::Rows };
            let how = (job.along, optics, &job.points[usize::from(upright)]);
            let work = ready.cast(how, part, row, column..column + 1, (&mut tile[..], TILE));
            let [x, y] = part.first([extent.width - column * TILE, extent.height - row * TILE]);
            let lines: Lines = std::array::from_fn(|line| {
                std::array::from_fn(|n| {
                    let (x, y) = if upright { (x + line, n) } else { (n, y + line) };
                    if x < TILE && y < TILE { tile[y * TILE + x] } else { 0.0 }
                })
            });
            (lines, work)
        };
        let cast = |jobs: &[Job], strips: &[Strip]| {
            let optics: Vec<Optics> = jobs.iter().map(|j| ready.optics(j.along)).collect();
            let all = |strip: &Strip| -> Vec<(Lines, (Counters, Work))> {
                jobs.iter().zip(&optics).map(|(job, optics)| one(job, optics, strip)).collect()
            };
            let done: Vec<Vec<(Lines, (Counters, Work))>> = strips.par_iter().with_min_len(4).map(all).collect();
            let work = |job: usize| ready.sum(done.iter().map(|s| s[job].1).collect());
            let work = (0..jobs.len()).map(work).collect();
            (done.iter().map(|s| s.iter().map(|(lines, _)| *lines).collect()).collect(), work)
        };
        visit.run(&ready.tiles.occupied(), &cast)
    }
}

/// Which pixels of a tile are cast.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    All,
    /// The two rows, or columns, in the middle.
    Rows,
    Columns,
}

impl Part {
    /// Column and row of the first pixel, of a tile of which so many columns and rows lie in the image.
    #[inline(always)]
    fn first(self, [wide, high]: [usize; 2]) -> [usize; 2] {
        let middle = |pixels: usize| (TILE / 2 - 1).min(pixels.min(TILE).saturating_sub(2));
        match self {
            Part::All => [0, 0],
            Part::Rows => [0, middle(high)],
            Part::Columns => [middle(wide), 0],
        }
    }
}

/// What the tiles of an image share.
struct Band<'a, 'w, T, W> {
    field: &'w Corners<'a, T, W>,
    optics: &'w Optics,
    tiles: &'w Tiles,
    points: &'w Points,
    extent: Extent,
    /// Pixels in a row of what is written.
    stride: usize,
    part: Part,
    watch: &'w Watch<'w>,
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512dq,avx512vl")]
fn run_avx512<T: Voxel, W: Weights<T>, const EXACT: bool, const SQUARED: bool>(
    band: &Band<'_, '_, T, W>,
    row: usize,
    columns: Range<usize>,
    out: &mut [f64],
    work: &mut (Counters, Work),
) {
    // SAFETY: this function has the instructions.
    unsafe { band.tiles::<Avx512, EXACT, SQUARED>(row, columns, out, work) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2<T: Voxel, W: Weights<T>, const EXACT: bool, const SQUARED: bool>(
    band: &Band<'_, '_, T, W>,
    row: usize,
    columns: Range<usize>,
    out: &mut [f64],
    work: &mut (Counters, Work),
) {
    // SAFETY: this function has the instructions.
    unsafe { band.tiles::<Avx2, EXACT, SQUARED>(row, columns, out, work) }
}

impl<T: Voxel, W: Weights<T>> Band<'_, '_, T, W> {
    fn run<const EXACT: bool, const SQUARED: bool>(
        &self,
        level: SimdLevel,
        row: usize,
        columns: Range<usize>,
        out: &mut [f64],
        work: &mut (Counters, Work),
    ) {
        match level {
            // SAFETY: plain Rust needs no instructions.
            SimdLevel::Portable => unsafe { self.tiles::<Portable, EXACT, SQUARED>(row, columns, out, work) },
            // SAFETY: levels name only what the processor has (`SimdLevel::available`).
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx2 => unsafe { run_avx2::<T, W, EXACT, SQUARED>(self, row, columns, out, work) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx512 => unsafe { run_avx512::<T, W, EXACT, SQUARED>(self, row, columns, out, work) },
            // SAFETY: as for the first.
            #[cfg(not(target_arch = "x86_64"))]
            _ => unsafe { self.tiles::<Portable, EXACT, SQUARED>(row, columns, out, work) },
        }
    }

    /// The pixels of a row of tiles.
    ///
    /// # Safety
    /// As [`Simd`].
    #[inline(always)]
    unsafe fn tiles<S: Simd, const EXACT: bool, const SQUARED: bool>(
        &self,
        row: usize,
        columns: Range<usize>,
        out: &mut [f64],
        (counters, work): &mut (Counters, Work),
    ) {
        let (height, left) = (self.extent.height - row * TILE, columns.start);
        let rays = self.points.rays() as usize;
        let share = 1.0 / rays as f64;
        let squared = if SQUARED { 1.0 / (self.optics.nearness * self.optics.nearness) } else { 1.0 };
        let scale = squared * self.field.unit();
        for column in columns {
            let pieces = self.tiles.pieces(column, row, GAP * self.optics.spacing);
            if pieces.all().is_empty() || self.watch.cancelled() {
                continue;
            }
            let wide = self.extent.width - column * TILE;
            let [x0, y0] = self.part.first([wide, height]);
            // Pixels of the tile in blocks of four by four, or its two lines.
            let mut places = [(0usize, 0usize); TILE * TILE];
            let mut pixels = 0;
            let most = if self.part == Part::All { TILE * TILE } else { 2 * TILE };
            for n in 0..most {
                let (x, y) = match self.part {
                    Part::All => ((n & 3) | (n >> 2 & 4), (n >> 2 & 3) | (n >> 3 & 4)),
                    Part::Rows => (n & 7, y0 + (n >> 3)),
                    Part::Columns => (x0 + (n >> 3), n & 7),
                };
                if x < wide && y < height {
                    places[pixels] = (x, y);
                    pixels += 1;
                }
            }
            let all = pixels * rays;
            counters.rays += all as u64;
            let mut n = 0;
            // Pixel and ray of lane 0.
            let (mut pixel, mut ray) = (0, 0);
            while n < all {
                let used = LANES.min(all - n);
                let (mut px, mut py, mut phase) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
                let mut owners = [(0usize, 0usize); LANES];
                for l in 0..LANES {
                    let (x, y) = places[pixel];
                    let at = (column * TILE + x, row * TILE + y);
                    let [dx, dy, p] = self.points.of(at.0, at.1, ray as u32);
                    (px[l], py[l], phase[l]) = (at.0 as f64 + dx, at.1 as f64 + dy, p);
                    owners[l] = (x, y);
                    if l + 1 < used {
                        ray += 1;
                        if ray == rays {
                            (pixel, ray) = (pixel + 1, 0);
                        }
                    }
                }
                (pixel, ray) = if ray + 1 == rays { (pixel + 1, 0) } else { (pixel, ray + 1) };
                let mut beam = self.optics.beam(&px, &py, &phase);
                for l in used..LANES {
                    beam.from[l] = f64::INFINITY;
                }
                let mut sums = [0.0f64; LANES];
                for piece in pieces.all() {
                    // SAFETY: the caller's promise, passed on.
                    unsafe {
                        if EXACT {
                            cells::<S, T, W, SQUARED>(self.field, &beam, *piece, &mut sums, work);
                        } else {
                            comb::<S, T, W, SQUARED>(self.field, &beam, *piece, &mut sums, work);
                        }
                    }
                }
                for l in 0..used {
                    let (x, y) = owners[l];
                    out[y * self.stride + (column - left) * TILE + x] += sums[l] * beam.factor[l] * (scale * share);
                }
                n += used;
            }
        }
    }
}
