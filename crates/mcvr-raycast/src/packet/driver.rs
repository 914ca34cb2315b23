//! Images by packets: tiles of pixels, the rays of their pixels, packets of rays.

use std::ops::Range;

use mcvr_scene::{Camera, Density, Estimand, Image, Watch};
use mcvr_volume::Voxel;
use rayon::prelude::*;

use super::beam::Optics;
use super::corners::{Corners, Weights};
use super::lanes::{LANES, Portable, Simd};
use super::level::Level;
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
pub(crate) struct Packets<'a> {
    density: &'a Density,
    level: Level,
}

/// Gaps in depth that are not worth a new start, in samples of a comb or in voxels.
const GAP: f64 = 4.0;

impl<'a> Packets<'a> {
    pub fn new(density: &'a Density) -> Self {
        Self { density, level: Level::detect() }
    }

    /// The same on other instructions.
    #[cfg(test)]
    pub fn on(self, level: Level) -> Self {
        Self { level, ..self }
    }

    /// Casts an image; `None` where packets do not serve the density. The same bits for any number of threads and on any
    /// instructions.
    pub fn image(&self, camera: &Camera, plan: &Plan, watch: &Watch) -> Option<(Image, Counters)> {
        with_corners(self.density, Job { packets: self, camera, plan, watch, only: None }).map(|made| match made {
            Made::Image(image, counters) => (image, counters),
            // Not asked for.
            Made::Tiles(_, counters) => (Image::zeros(camera.extent()), counters),
        })
    }

    /// Casts some tiles of an image, given by column and row of tiles: their values row by row, 0 beyond the image's edge.
    pub fn tiles(
        &self,
        camera: &Camera,
        plan: &Plan,
        tiles: &[(usize, usize)],
        watch: &Watch,
    ) -> Option<(Vec<Vec<f64>>, Counters)> {
        with_corners(self.density, Job { packets: self, camera, plan, watch, only: Some(tiles) }).map(|made| match made {
            Made::Tiles(values, counters) => (values, counters),
            // Not asked for.
            Made::Image(_, counters) => (vec![], counters),
        })
    }

    /// Tiles, by column and row, whose rays can meet density; `None` where packets do not serve the density.
    pub fn occupied_tiles(&self, camera: &Camera, estimand: Estimand) -> Option<Vec<(usize, usize)>> {
        with_corners(self.density, Served)?;
        let grid = self.density.volume().grid();
        let view = View::new(camera, grid, estimand, self.density.mass(), 1.0);
        Some(Tiles::new(self.density.occupancy(), camera, grid, view.depth()).occupied())
    }
}

/// Whether packets serve a density.
struct Served;

impl<'a> Visit<'a> for Served {
    type Out = ();

    fn run<T: Voxel, W: Weights<T> + Send + 'a>(self, _: Corners<'a, T, W>) {}
}

/// What a job was asked for.
enum Made {
    Image(Image, Counters),
    Tiles(Vec<Vec<f64>>, Counters),
}

struct Job<'a, 'w> {
    packets: &'w Packets<'a>,
    camera: &'w Camera,
    plan: &'w Plan,
    watch: &'w Watch<'w>,
    /// These tiles instead of the whole image.
    only: Option<&'w [(usize, usize)]>,
}

impl<'a> Visit<'a> for Job<'_, '_> {
    type Out = Made;

    fn run<T: Voxel, W: Weights<T> + Send + 'a>(self, field: Corners<'a, T, W>) -> Self::Out {
        let Self { packets, camera, plan, watch, only } = self;
        let (density, level) = (packets.density, packets.level);
        let grid = density.volume().grid();
        let view = View::new(camera, grid, plan.estimand, density.mass(), 1.0);
        let spacing = match plan.along {
            Along::Comb(spacing) => spacing,
            Along::Exact => grid.spacing().min_element(),
        };
        let tiles = Tiles::new(density.occupancy(), camera, grid, view.depth());
        let optics = Optics::new(&view, &tiles, spacing);
        let width = camera.extent().width;
        let band = Band { field: &field, optics: &optics, tiles: &tiles, points: &plan.points, width, watch };
        let exact = plan.along == Along::Exact;
        let cast = |row: usize, columns: Range<usize>, out: &mut [f64]| {
            let mut work = (Counters::default(), Work::default());
            match (exact, view.squared()) {
                (false, false) => band.run::<false, false>(level, row, columns, out, &mut work),
                (false, true) => band.run::<false, true>(level, row, columns, out, &mut work),
                (true, false) => band.run::<true, false>(level, row, columns, out, &mut work),
                (true, true) => band.run::<true, true>(level, row, columns, out, &mut work),
            }
            work
        };
        let sum = |work: Vec<(Counters, Work)>| {
            let points = if view.squared() { 3 } else { 2 };
            let mut counters = Counters::default();
            for (mut c, w) in work {
                c.cells = w.cells;
                c.evaluations = w.evaluations + points * w.cells;
                c.voxel_reads = 8 * (w.evaluations + w.cells - w.border.cells) + w.border.reads;
                counters += c;
            }
            counters
        };
        if let Some(only) = only {
            let one = |&(column, row): &(usize, usize)| {
                let height = TILE.min(camera.extent().height - row * TILE);
                let wide = TILE.min(width - column * TILE);
                let mut band = vec![0.0; height * width];
                let work = cast(row, column..column + 1, &mut band);
                let mut values = vec![0.0; TILE * TILE];
                for y in 0..height {
                    values[TILE * y..][..wide].copy_from_slice(&band[y * width + column * TILE..][..wide]);
                }
                (values, work)
            };
            let (values, work) = only.par_iter().map(one).unzip();
            return Made::Tiles(values, sum(work));
        }
        let mut image = Image::zeros(camera.extent());
        let rows = image.values_mut().par_chunks_mut(TILE * width).enumerate().with_max_len(1);
        let work = rows.map(|(row, out)| {
            let work = cast(row, 0..width.div_ceil(TILE), out);
            watch.advance((out.len() / width) as u64);
            work
        });
        let work = work.collect();
        Made::Image(image, sum(work))
    }
}

/// What the tiles of an image share.
struct Band<'a, 'w, T, W> {
    field: &'w Corners<'a, T, W>,
    optics: &'w Optics,
    tiles: &'w Tiles,
    points: &'w Points,
    width: usize,
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
        level: Level,
        row: usize,
        columns: Range<usize>,
        out: &mut [f64],
        work: &mut (Counters, Work),
    ) {
        match level {
            // SAFETY: plain Rust needs no instructions.
            Level::Portable => unsafe { self.tiles::<Portable, EXACT, SQUARED>(row, columns, out, work) },
            // SAFETY: levels name only what the processor has (`Level::available`).
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => unsafe { run_avx2::<T, W, EXACT, SQUARED>(self, row, columns, out, work) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe { run_avx512::<T, W, EXACT, SQUARED>(self, row, columns, out, work) },
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
        let height = out.len() / self.width;
        let rays = self.points.rays() as usize;
        let share = 1.0 / rays as f64;
        let squared = if SQUARED { 1.0 / (self.optics.nearness * self.optics.nearness) } else { 1.0 };
        let scale = squared * self.field.unit();
        for column in columns {
            let pieces = self.tiles.pieces(column, row, GAP * self.optics.spacing);
            if pieces.all().is_empty() || self.watch.cancelled() {
                continue;
            }
            let wide = TILE.min(self.width - column * TILE);
            // Pixels of the tile in blocks of four by four.
            let mut places = [(0usize, 0usize); TILE * TILE];
            let mut pixels = 0;
            for n in 0..TILE * TILE {
                let (x, y) = ((n & 3) | (n >> 2 & 4), (n >> 2 & 3) | (n >> 3 & 4));
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
                    out[y * self.width + column * TILE + x] += sums[l] * beam.factor[l] * (scale * share);
                }
                n += used;
            }
        }
    }
}
