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

    /// Whether they serve the density.
    pub fn serve(&self) -> bool {
        with_corners(self.density, Nothing).is_some()
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

/// Looks at nothing.
struct Nothing;

impl<'a> Visit<'a> for Nothing {
    type Out = ();

    fn run<T: Voxel, W: Weights<T> + Send + 'a>(self, _: Corners<'a, T, W>) {}
}

/// Four by four rays at even distances: column and row among the squares that tile the image.
pub(crate) type Square = [u32; 2];

/// Rays of a square along an axis.
pub(crate) const SIDE: usize = 4;

/// What the rays of a square saw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Seen {
    /// Row by row.
    pub values: [f64; LANES],
    /// Mean square of the differences between the sums over every other sample of a ray and its whole sum; 0 of exact rays. It is the
    /// variance that a comb of twice the distance adds.
    pub noise: f64,
}

/// Casts parts of an image.
pub(crate) trait Cast {
    /// Casts squares of rays that are `pitch` pixels apart, the first of them half of that from the image's corner.
    /// Phases are those of the pixels of `points`, one for each ray.
    fn squares(&self, along: Along, pitch: f64, points: &Points, squares: &[Square]) -> (Vec<Seen>, Counters);
}

/// Code that looks at parts of an image.
pub(crate) trait Look {
    type Out;

    /// `full` are the columns and rows of the tiles whose rays can meet density.
    fn run(self, full: &[(usize, usize)], cast: &dyn Cast) -> Self::Out;
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

    /// Casts all pixels of a row of tiles, or the places of a strip, into `out`.
    fn cast(&self, (along, optics): (Along, &Optics), what: &What<'_>, out: &mut [f64]) -> (Counters, Work) {
        let extent = self.camera.extent();
        let band = Band { field: self.field, optics, tiles: &self.tiles, extent, watch: self.watch };
        let mut work = (Counters::default(), Work::default());
        match (along == Along::Exact, self.view.squared()) {
            (false, false) => band.run::<false, false>(self.level, what, out, &mut work),
            (false, true) => band.run::<false, true>(self.level, what, out, &mut work),
            (true, false) => band.run::<true, false>(self.level, what, out, &mut work),
            (true, true) => band.run::<true, true>(self.level, what, out, &mut work),
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

impl<'a, T: Voxel, W: Weights<T> + Send + 'a> Cast for Ready<'a, '_, T, W> {
    fn squares(&self, along: Along, pitch: f64, points: &Points, squares: &[Square]) -> (Vec<Seen>, Counters) {
        let optics = self.optics(along);
        let one = |first: &Square| {
            let (x, y) = (SIDE * first[0] as usize, SIDE * first[1] as usize);
            let mut px = [0.0; LANES];
            let (mut py, mut phases) = (px, px);
            for l in 0..LANES {
                let (x, y) = (x + l % SIDE, y + l / SIDE);
                (px[l], py[l]) = ((x as f64 + 0.5) * pitch, (y as f64 + 0.5) * pitch);
                phases[l] = points.of(x, y, 0)[2];
            }
            let places = Places::new(px, py, phases, &self.tiles);
            let mut values = [0.0; LANES];
            let work = self.cast((along, &optics), &What::Places(&places), &mut values);
            (Seen { values, noise: work.1.turns / LANES as f64 }, work)
        };
        let (seen, work): (Vec<_>, Vec<_>) = squares.par_iter().with_min_len(8).map(one).unzip();
        (seen, self.sum(work))
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
            let work = ready.cast((plan.along, &optics), &What::Row(row, &plan.points), &mut *out);
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
        visit.run(&ready.tiles.occupied(), &ready)
    }
}

/// Which rays are cast.
enum What<'w> {
    /// Those of all pixels of a row of tiles.
    Row(usize, &'w Points),
    /// Those through places of the image.
    Places(&'w Places),
}

/// Places of an image, the phases of the samples there, and the tiles where they are.
struct Places {
    x: [f64; LANES],
    y: [f64; LANES],
    phases: [f64; LANES],
    columns: Range<usize>,
    rows: Range<usize>,
}

impl Places {
    fn new(x: [f64; LANES], y: [f64; LANES], phases: [f64; LANES], tiles: &Tiles) -> Self {
        let (columns, rows) = (tiles.met(&x, 0), tiles.met(&y, 1));
        Self { x, y, phases, columns, rows }
    }
}

/// What the tiles of an image share.
struct Band<'a, 'w, T, W> {
    field: &'w Corners<'a, T, W>,
    optics: &'w Optics,
    tiles: &'w Tiles,
    extent: Extent,
    watch: &'w Watch<'w>,
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512dq,avx512vl")]
fn run_avx512<T: Voxel, W: Weights<T>, const EXACT: bool, const SQUARED: bool>(
    band: &Band<'_, '_, T, W>,
    what: &What<'_>,
    out: &mut [f64],
    work: &mut (Counters, Work),
) {
    // SAFETY: this function has the instructions.
    unsafe { band.cast::<Avx512, EXACT, SQUARED>(what, out, work) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2<T: Voxel, W: Weights<T>, const EXACT: bool, const SQUARED: bool>(
    band: &Band<'_, '_, T, W>,
    what: &What<'_>,
    out: &mut [f64],
    work: &mut (Counters, Work),
) {
    // SAFETY: this function has the instructions.
    unsafe { band.cast::<Avx2, EXACT, SQUARED>(what, out, work) }
}

impl<T: Voxel, W: Weights<T>> Band<'_, '_, T, W> {
    fn run<const EXACT: bool, const SQUARED: bool>(
        &self,
        level: SimdLevel,
        what: &What<'_>,
        out: &mut [f64],
        work: &mut (Counters, Work),
    ) {
        match level {
            // SAFETY: plain Rust needs no instructions.
            SimdLevel::Portable => unsafe { self.cast::<Portable, EXACT, SQUARED>(what, out, work) },
            // SAFETY: levels name only what the processor has (`SimdLevel::available`).
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx2 => unsafe { run_avx2::<T, W, EXACT, SQUARED>(self, what, out, work) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx512 => unsafe { run_avx512::<T, W, EXACT, SQUARED>(self, what, out, work) },
            // SAFETY: as for the first.
            #[cfg(not(target_arch = "x86_64"))]
            _ => unsafe { self.cast::<Portable, EXACT, SQUARED>(what, out, work) },
        }
    }

    /// # Safety
    /// As [`Simd`].
    #[inline(always)]
    unsafe fn cast<S: Simd, const EXACT: bool, const SQUARED: bool>(
        &self,
        what: &What<'_>,
        out: &mut [f64],
        (counters, work): &mut (Counters, Work),
    ) {
        let rays = if let What::Row(_, points) = what { points.rays() as usize } else { 1 };
        let share = 1.0 / rays as f64;
        let squared = if SQUARED { 1.0 / (self.optics.nearness * self.optics.nearness) } else { 1.0 };
        let scale = squared * self.field.unit();
        let gap = GAP * self.optics.spacing;
        let (width, height) = (self.extent.width, self.extent.height);
        let columns = if let What::Row(..) = what { 0..width.div_ceil(TILE) } else { 0..1 };
        for column in columns {
            let pieces = match what {
                What::Row(row, _) => self.tiles.pieces(column, *row, gap),
                What::Places(p) => self.tiles.pieces_of(&p.columns, &p.rows, gap),
            };
            if pieces.all().is_empty() || self.watch.cancelled() {
                continue;
            }
            // Pixels of the tile in blocks of four by four.
            let mut places = [(0usize, 0usize); TILE * TILE];
            let mut pixels = LANES;
            if let What::Row(row, _) = what {
                pixels = 0;
                let (wide, high) = (width - column * TILE, height - row * TILE);
                for n in 0..TILE * TILE {
                    let (x, y) = ((n & 3) | (n >> 2 & 4), (n >> 2 & 3) | (n >> 3 & 4));
                    if x < wide && y < high {
                        places[pixels] = (x, y);
                        pixels += 1;
                    }
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
                let mut owners = [0usize; LANES];
                match what {
                    What::Row(row, points) => {
                        for l in 0..LANES {
                            let (x, y) = places[pixel];
                            let at = (column * TILE + x, row * TILE + y);
                            let [dx, dy, p] = points.of(at.0, at.1, ray as u32);
                            (px[l], py[l], phase[l]) = (at.0 as f64 + dx, at.1 as f64 + dy, p);
                            owners[l] = y * width + at.0;
                            if l + 1 < used {
                                ray += 1;
                                if ray == rays {
                                    (pixel, ray) = (pixel + 1, 0);
                                }
                            }
                        }
                        (pixel, ray) = if ray + 1 == rays { (pixel + 1, 0) } else { (pixel, ray + 1) };
                    }
                    What::Places(p) => {
                        (px, py, phase) = (p.x, p.y, p.phases);
                        owners = std::array::from_fn(|l| l);
                    }
                }
                let mut beam = self.optics.beam(&px, &py, &phase);
                for l in used..LANES {
                    beam.from[l] = f64::INFINITY;
                }
                let mut sums = [[0.0f64; LANES]; 2];
                for piece in pieces.all() {
                    // SAFETY: the caller's promise, passed on.
                    unsafe {
                        if EXACT {
                            cells::<S, T, W, SQUARED>(self.field, &beam, *piece, &mut sums[0], work);
                        } else {
                            comb::<S, T, W, SQUARED>(self.field, &beam, *piece, &mut sums, work);
                        }
                    }
                }
                for l in 0..used {
                    out[owners[l]] += sums[0][l] * beam.factor[l] * (scale * share);
                    let turns = sums[1][l] * beam.factor[l] * scale;
                    work.turns += turns * turns;
                }
                n += used;
            }
        }
    }
}
