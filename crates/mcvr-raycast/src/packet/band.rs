//! The rays of a row of tiles, or of places of an image, on one thread.

use std::ops::Range;

use mcvr_scene::{Extent, Watch};
use mcvr_volume::{SimdLevel, Voxel};

use super::beam::{Beam, Optics};
use super::corners::{Corners, Weights};
use super::driver::{Along, Seen};
use super::lanes::{LANES, Portable, Row, Simd};
use super::tiles::{TILE, Tiles};
use super::trace::{Work, cells, comb};
#[cfg(target_arch = "x86_64")]
use super::x86::{Avx2, Avx512};
use crate::Counters;
use crate::points::Points;

/// Gaps in depth that are not worth a new start, in samples of a comb or in voxels.
const GAP: f64 = 4.0;

/// Which rays are cast, and where what they see goes.
pub(super) enum What<'w> {
    /// Those of all pixels of a row of tiles, to be added to the pixels.
    Row(usize, &'w Points, &'w mut [f64]),
    /// Those through places of the image.
    Places(&'w [Places], &'w mut [Seen]),
}

/// Places of an image, the phases of the samples there, and the tiles where they are.
pub(super) struct Places {
    x: Row<f64>,
    y: Row<f64>,
    phases: Row<f64>,
    columns: Range<usize>,
    rows: Range<usize>,
}

impl Places {
    pub fn new(x: Row<f64>, y: Row<f64>, phases: Row<f64>, tiles: &Tiles) -> Self {
        let (columns, rows) = (tiles.met(&x, 0), tiles.met(&y, 1));
        Self { x, y, phases, columns, rows }
    }
}

/// What the tiles of an image share.
pub(super) struct Band<'a, 'w, T, W> {
    pub field: &'w Corners<'a, T, W>,
    pub optics: &'w Optics,
    pub tiles: &'w Tiles,
    pub extent: Extent,
    pub watch: &'w Watch<'w>,
}

/// Sixteen rays on their way.
struct Packet {
    beam: Beam,
    /// Slots of depth with density.
    mask: u128,
    /// Where the first of them enters the box around all density, and the last leaves it.
    ends: [f64; 2],
    /// Pixels of the row, or the place, that they belong to.
    owners: [usize; LANES],
    used: usize,
    sums: [Row<f64>; 2],
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512dq,avx512vl")]
fn run_avx512<T: Voxel, W: Weights<T>>(band: &Band<'_, '_, T, W>, what: &mut What<'_>, work: &mut (Counters, Work)) {
    // SAFETY: this function has the instructions.
    unsafe { band.cast::<Avx512>(what, work) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2<T: Voxel, W: Weights<T>>(band: &Band<'_, '_, T, W>, what: &mut What<'_>, work: &mut (Counters, Work)) {
    // SAFETY: this function has the instructions.
    unsafe { band.cast::<Avx2>(what, work) }
}

impl<T: Voxel, W: Weights<T>> Band<'_, '_, T, W> {
    pub fn run(&self, level: SimdLevel, what: &mut What<'_>, work: &mut (Counters, Work)) {
        match level {
            // SAFETY: plain Rust needs no instructions.
            SimdLevel::Portable => unsafe { self.cast::<Portable>(what, work) },
            // SAFETY: levels name only what the processor has (`SimdLevel::available`).
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx2 => unsafe { run_avx2::<T, W>(self, what, work) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx512 => unsafe { run_avx512::<T, W>(self, what, work) },
            // SAFETY: as for the first.
            #[cfg(not(target_arch = "x86_64"))]
            _ => unsafe { self.cast::<Portable>(what, work) },
        }
    }

    /// # Safety
    /// As [`Simd`].
    #[inline(always)]
    unsafe fn cast<S: Simd>(&self, what: &mut What<'_>, (counters, work): &mut (Counters, Work)) {
        let mut progress = Progress { column: 0, places: ([(0, 0); TILE * TILE], 0), pixel: 0, ray: 0, place: 0 };
        let share = self.share();
        loop {
            let packet = match what {
                What::Row(row, points, _) => self.next_of_row(&mut progress, (*row, points), counters),
                What::Places(places, _) => self.next_of_places(&mut progress, places, counters),
            };
            let Some(mut packet) = packet else { return };
            // SAFETY: the caller's promise, passed on.
            unsafe { self.trace::<S>(&mut packet, work) };
            match what {
                What::Row(_, points, out) => packet.add_to(out, share / f64::from(points.rays())),
                What::Places(_, seen) => seen[packet.owners[0]] = packet.seen(share),
            }
        }
    }

    /// The next rays of a row of tiles that meet anything.
    #[inline(always)]
    fn next_of_row(
        &self,
        progress: &mut Progress,
        (row, points): (usize, &Points),
        counters: &mut Counters,
    ) -> Option<Packet> {
        let rays = points.rays();
        while progress.column < self.extent.width.div_ceil(TILE) {
            let column = progress.column;
            let mask = self.tiles.mask(column, row);
            if mask != 0 && !self.watch.cancelled() {
                if progress.pixel == 0 && progress.ray == 0 {
                    progress.places = self.pixels(column, row);
                }
                let (places, pixels) = &progress.places;
                while progress.pixel < *pixels {
                    let (mut px, mut py, mut phase) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
                    let (mut owners, mut used) = ([0usize; LANES], 0);
                    for l in 0..LANES {
                        let (x, y) = places[progress.pixel.min(pixels - 1)];
                        let at = (column * TILE + x, row * TILE + y);
                        let [dx, dy, p] = points.of(at.0, at.1, progress.ray);
                        (px[l], py[l], phase[l]) = (at.0 as f64 + dx, at.1 as f64 + dy, p);
                        owners[l] = y * self.extent.width + at.0;
                        used += usize::from(progress.pixel < *pixels);
                        progress.ray += 1;
                        if progress.ray == rays {
                            (progress.pixel, progress.ray) = (progress.pixel + 1, 0);
                        }
                    }
                    counters.rays += used as u64;
                    let packet = Packet::new(self.optics.beam(&px, &py, &phase), mask, owners, used);
                    if packet.is_some() {
                        return packet;
                    }
                }
            }
            (progress.column, progress.pixel, progress.ray) = (column + 1, 0, 0);
        }
        None
    }

    /// The rays of the next places that meet anything.
    #[inline(always)]
    fn next_of_places(&self, progress: &mut Progress, places: &[Places], counters: &mut Counters) -> Option<Packet> {
        while progress.place < places.len() {
            let (n, p) = (progress.place, &places[progress.place]);
            progress.place += 1;
            let mask = self.tiles.mask_of(&p.columns, &p.rows);
            if mask != 0 && !self.watch.cancelled() {
                counters.rays += LANES as u64;
                let packet = Packet::new(self.optics.beam(&p.x, &p.y, &p.phases), mask, [n; LANES], LANES);
                if packet.is_some() {
                    return packet;
                }
            }
        }
        None
    }

    /// From sums to the estimand.
    fn share(&self) -> f64 {
        let squared = if self.optics.squared { 1.0 / (self.optics.nearness * self.optics.nearness) } else { 1.0 };
        squared * self.field.unit()
    }

    /// Pixels of a tile that are in the image, in blocks of four by four, and their number.
    fn pixels(&self, column: usize, row: usize) -> ([(usize, usize); TILE * TILE], usize) {
        let mut places = [(0, 0); TILE * TILE];
        let mut pixels = 0;
        let (wide, high) = (self.extent.width - column * TILE, self.extent.height - row * TILE);
        for n in 0..TILE * TILE {
            let (x, y) = ((n & 3) | (n >> 2 & 4), (n >> 2 & 3) | (n >> 3 & 4));
            if x < wide && y < high {
                places[pixels] = (x, y);
                pixels += 1;
            }
        }
        (places, pixels)
    }

    /// Takes a packet through the volume.
    ///
    /// # Safety
    /// As [`Simd`].
    #[inline(always)]
    unsafe fn trace<S: Simd>(&self, Packet { beam, mask, ends, sums, .. }: &mut Packet, work: &mut Work) {
        for piece in self.tiles.pieces(*mask, GAP * self.optics.spacing) {
            if ends[1] <= piece[0] || piece[1] <= ends[0] {
                continue;
            }
            let beam = (&*beam, self.optics.squared);
            // SAFETY: the caller's promise, passed on.
            unsafe {
                if self.optics.along == Along::Exact {
                    cells::<S, T, W>(self.field, beam, piece, &mut sums[0], work);
                } else {
                    comb::<S, T, W>(self.field, beam, piece, sums, work);
                }
            }
        }
    }
}

/// What is the next to be cast.
struct Progress {
    /// Tile of a row, its pixels, one of them, ray of that.
    column: usize,
    places: ([(usize, usize); TILE * TILE], usize),
    pixel: usize,
    ray: u32,
    /// Or one of the places.
    place: usize,
}

impl Packet {
    /// `None` where no ray meets the box around all density. Only the first rays are used.
    #[inline(always)]
    fn new(mut beam: Beam, mask: u128, owners: [usize; LANES], used: usize) -> Option<Self> {
        for l in used..LANES {
            beam.from[l] = f64::INFINITY;
        }
        let mut ends = [f64::INFINITY, f64::NEG_INFINITY];
        for l in 0..LANES {
            let to = if beam.from[l] < f64::INFINITY { beam.to[l] } else { f64::NEG_INFINITY };
            ends[0] = if beam.from[l] < ends[0] { beam.from[l] } else { ends[0] };
            ends[1] = if to > ends[1] { to } else { ends[1] };
        }
        (ends[0] < ends[1]).then_some(Self { beam, mask, ends, owners, used, sums: [[0.0; LANES]; 2] })
    }

    /// Adds what its rays saw to their pixels.
    fn add_to(&self, out: &mut [f64], share: f64) {
        for l in 0..self.used {
            out[self.owners[l]] += self.sums[0][l] * self.beam.factor[l] * share;
        }
    }

    /// What its rays saw.
    fn seen(&self, share: f64) -> Seen {
        let [mut values, mut turns] = self.sums;
        for l in 0..LANES {
            values[l] *= self.beam.factor[l] * share;
            turns[l] *= self.beam.factor[l] * share;
        }
        Seen { values, noise: turns.iter().map(|t| t * t).sum::<f64>() / LANES as f64 }
    }
}
