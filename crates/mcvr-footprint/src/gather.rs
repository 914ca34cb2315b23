//! The voxels of positive weight, brick by brick.

use std::sync::atomic::{AtomicUsize, Ordering};

use mcvr_scene::{Density, Occupancy, WeightFn};
use mcvr_volume::{SimdLevel, Voxel, vectorised};

use crate::frame::BATCH;

/// Bricks in different parts of the volume take turns.
pub(crate) const STREAMS: usize = 8;

/// Bricks taken at a time.
const GRAB: usize = 8;

const SIDE: usize = Occupancy::SIDE;
const ROOM: usize = BATCH + SIDE * SIDE * SIDE + 1;

/// The occupied bricks in as many parts as there are streams.
pub(crate) struct Bricks {
    all: Vec<[u32; 3]>,
    next: [AtomicUsize; STREAMS],
    share: usize,
}

impl Bricks {
    pub fn new(occupancy: &Occupancy) -> Self {
        let [_, by, bz] = occupancy.bricks();
        let mut all = Vec::with_capacity(occupancy.count());
        for (z, y) in (0..bz).flat_map(|z| (0..by).map(move |y| (z, y))) {
            for (w, word) in occupancy.row(y, z).iter().enumerate() {
                let mut bits = *word;
                while bits != 0 {
                    // Axes have at most 2^24 voxels.
                    all.push([(w * 64) as u32 + bits.trailing_zeros(), y as u32, z as u32]);
                    bits &= bits - 1;
                }
            }
        }
        let share = all.len().div_ceil(STREAMS).next_multiple_of(GRAB);
        Self { next: std::array::from_fn(|s| AtomicUsize::new(s * share)), share, all }
    }

    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// Voxels of all bricks.
    pub fn voxels(&self, dims: [usize; 3]) -> u64 {
        let side = |b: u32, n: usize| (n - b as usize * SIDE).min(SIDE) as u64;
        self.all.iter().map(|b| (0..3).map(|a| side(b[a], dims[a])).product::<u64>()).sum()
    }

    /// The next bricks of a part, or of another one.
    fn take(&self, stream: usize) -> Option<&[[u32; 3]]> {
        for s in (0..STREAMS).map(|n| (stream + n) % STREAMS) {
            let end = ((s + 1) * self.share).min(self.all.len());
            if self.next[s].load(Ordering::Relaxed) >= end {
                continue;
            }
            let from = self.next[s].fetch_add(GRAB, Ordering::Relaxed);
            if from < end {
                return Some(&self.all[from..end.min(from + GRAB)]);
            }
        }
        None
    }
}

/// Where weights come from.
pub(crate) struct Source<'a, T> {
    pub voxels: &'a [T],
    density: &'a Density,
    dims: [usize; 3],
    middle: [f32; 3],
    /// Weights in units by ordinal, for types that have them.
    table: Vec<f32>,
    /// Least and largest stored value of positive weight, for those types.
    range: Option<(T, T)>,
    units: f64,
}

impl<'a, T: Voxel> Source<'a, T> {
    /// With `units` for the largest weight.
    pub fn new(density: &'a Density, voxels: &'a [T], units: f32) -> Self {
        let dims = density.volume().grid().dims();
        let weights = density.table().unwrap_or_default();
        let units = f64::from(units) / density.report().max_weight;
        let ends = [weights.iter().position(|w| *w > 0.0), weights.iter().rposition(|w| *w > 0.0)];
        let range = ends[0].and_then(T::of_ordinal).zip(ends[1].and_then(T::of_ordinal));
        Self {
            voxels,
            density,
            dims,
            middle: dims.map(|n| 0.5 * (n as f32 - 1.0)),
            table: weights.iter().map(|w| (w * units) as f32).collect(),
            range,
            units,
        }
    }

    /// Weight in units of a stored value.
    #[inline(always)]
    fn weight(&self, stored: T) -> f32 {
        match stored.ordinal().and_then(|o| self.table.get(o)) {
            Some(w) => *w,
            None => (self.density.lookup().weight(stored) * self.units) as f32,
        }
    }
}

/// Voxels of positive weight that wait to be projected: index coordinates from the grid's middle, and weights in units.
pub(crate) struct Waiting {
    at: [Vec<f32>; 3],
    weight: Vec<f32>,
    many: usize,
    used: usize,
}

impl Waiting {
    pub fn new() -> Self {
        Self { at: std::array::from_fn(|_| vec![0.0; ROOM]), weight: vec![0.0; ROOM], many: 0, used: 0 }
    }

    /// The next batch; it stays until [`Waiting::drop_batch`].
    pub fn batch(&self) -> ([&[f32]; 3], &[f32]) {
        let range = self.used..self.many.min(self.used + BATCH);
        let [x, y, z] = &self.at;
        ([&x[range.clone()], &y[range.clone()], &z[range.clone()]], &self.weight[range])
    }

    pub fn drop_batch(&mut self) {
        self.used = self.many.min(self.used + BATCH);
    }

    /// Gathers more voxels until there is a whole batch, or no more bricks. Returns the bricks looked at.
    pub fn refill<'b, T: Voxel>(
        &mut self,
        level: SimdLevel,
        source: &Source<'_, T>,
        bricks: &'b Bricks,
        (stream, left): (usize, &mut &'b [[u32; 3]]),
    ) -> usize {
        if self.many - self.used >= BATCH {
            return 0;
        }
        let range = self.used..self.many;
        for v in self.at.iter_mut().chain([&mut self.weight]) {
            v.copy_within(range.clone(), 0);
        }
        (self.many, self.used) = (range.len(), 0);
        let mut looked_at = 0;
        while self.many < BATCH {
            let Some((brick, rest)) = left.split_first() else {
                match bricks.take(stream) {
                    Some(more) => *left = more,
                    None => break,
                }
                continue;
            };
            *left = rest;
            gathered(level, source, brick, self);
            looked_at += 1;
        }
        looked_at
    }
}

/// Appends the voxels of positive weight of a brick.
#[inline(always)]
fn gather<T: Voxel>(source: &Source<'_, T>, brick: &[u32; 3], out: &mut Waiting) {
    let [nx, ny, nz] = source.dims;
    let [x, y, z] = brick.map(|b| b as usize * SIDE);
    let mut many = out.many;
    let [ax, ay, az] = &mut out.at;
    // A brick has at most 512 voxels, and places are written whether or not they are kept: one more.
    let (ax, ay, az) = (&mut ax[..ROOM], &mut ay[..ROOM], &mut az[..ROOM]);
    let weights = &mut out.weight[..ROOM];
    let left = x as f32 - source.middle[0];
    for k in z..nz.min(z + SIDE) {
        for j in y..ny.min(y + SIDE) {
            let from = x + nx * (j + ny * k);
            let line = &source.voxels[from..from + SIDE.min(nx - x)];
            let mut row = [0f32; SIDE];
            if let Some((low, high)) = source.range {
                let mut any = false;
                if let Ok(line) = <&[T; SIDE]>::try_from(line) {
                    for v in line {
                        any |= (*v >= low) & (*v <= high);
                    }
                } else {
                    for v in line {
                        any |= (*v >= low) & (*v <= high);
                    }
                }
                if !any {
                    continue;
                }
            }
            for (w, v) in row.iter_mut().zip(line) {
                *w = source.weight(*v);
            }
            let (v, w) = (j as f32 - source.middle[1], k as f32 - source.middle[2]);
            for (i, weight) in row.iter().enumerate() {
                ax[many] = left + i as f32;
                ay[many] = v;
                az[many] = w;
                weights[many] = *weight;
                many += usize::from(*weight > 0.0);
            }
        }
    }
    out.many = many;
}

vectorised! {
    /// Appends the voxels of positive weight of a brick.
    fn gathered<T: Voxel>(source: &Source<'_, T>, brick: &[u32; 3], out: &mut Waiting) = gather
}
