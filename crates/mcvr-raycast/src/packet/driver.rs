//! Images by packets: rows of tiles of pixels, or squares of rays, each on one thread.

use mcvr_scene::{Camera, Density, Estimand, Image, Watch};
use mcvr_volume::{SimdLevel, Voxel};
use rayon::prelude::*;

use super::band::{Band, Places, What};
use super::beam::Optics;
use super::corners::{Corners, Weights};
use super::lanes::LANES;
use super::tiles::{TILE, Tiles};
use super::trace::Work;
use super::weigh::{Visit, with_corners};
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

/// Squares that a thread takes at a time, at most.
const SQUARES: usize = 32;

/// Samples of sixteen rays that are worth another thread: some 5 microseconds.
const WORTH: f64 = 300.0;

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

    /// Squares whose rays take longer than another thread takes to begin.
    fn worth_a_thread(&self, along: Along) -> usize {
        let size = (0..3).map(|a| self.tiles.high[a] - self.tiles.low[a]).fold(0.0, f64::max);
        // Along the box's longest side; cells take more than samples.
        let samples = match along {
            Along::Exact => 3.0 * size,
            Along::Comb(distance) => size * self.smallest / distance,
        };
        // `as` saturates.
        ((WORTH / samples.max(1.0)) as usize).clamp(1, SQUARES)
    }

    fn optics(&self, along: Along) -> Optics {
        Optics::new(&self.view, &self.tiles, along, self.smallest)
    }

    /// Casts all pixels of a row of tiles, or the rays of places.
    fn cast(&self, optics: &Optics, mut what: What<'_>) -> (Counters, Work) {
        let extent = self.camera.extent();
        let band = Band { field: self.field, optics, tiles: &self.tiles, extent, watch: self.watch };
        let mut work = (Counters::default(), Work::default());
        band.run(self.level, &mut what, &mut work);
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
            Places::new(px, py, phases, &self.tiles)
        };
        let mut seen = vec![Seen { values: [0.0; LANES], noise: 0.0 }; squares.len()];
        let side_by_side = squares.len().div_ceil(4 * rayon::current_num_threads()).clamp(4, SQUARES);
        let side_by_side = side_by_side.max(self.worth_a_thread(along));
        let parts = squares.par_chunks(side_by_side).zip(seen.par_chunks_mut(side_by_side));
        let cast = |(squares, seen): (&[Square], &mut [Seen])| {
            let places: Vec<Places> = squares.iter().map(one).collect();
            self.cast(&optics, What::Places(&places, seen))
        };
        let work: Vec<_> = parts.map(cast).collect();
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
            let work = ready.cast(&optics, What::Row(row, &plan.points, &mut *out));
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
