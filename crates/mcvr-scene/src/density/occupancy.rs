//! Which parts of a volume hold no weight at all: what a ray may leap over.

use mcvr_volume::{Voxel, with_voxels};
use rayon::prelude::*;

use super::{Density, Transfer, WeightFn};

/// A bit for each brick of 8×8×8 voxels: whether any of them has a positive weight.
///
/// Brick `(bx, by, bz)` holds the voxels from `8 bx`, `8 by`, `8 bz` on; the last of an axis may be cut by the grid's end. A
/// kernel spreads weights [`Kernel::support`](crate::Kernel::support) voxels beyond the brick.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Occupancy {
    bricks: [usize; 3],
    /// Words of 64 bricks along x a row.
    words: usize,
    bits: Vec<u64>,
}

impl Occupancy {
    /// Voxels along a side of a brick.
    pub const SIDE: usize = 8;

    /// Number of bricks along x, y and z.
    pub fn bricks(&self) -> [usize; 3] {
        self.bricks
    }

    /// Whether a voxel of the brick has a positive weight.
    ///
    /// # Panics
    /// When there is no such brick.
    #[inline(always)]
    pub fn occupied(&self, bx: usize, by: usize, bz: usize) -> bool {
        debug_assert!(bx < self.bricks[0] && by < self.bricks[1]);
        let row = (by + self.bricks[1] * bz) * self.words;
        self.bits[row + (bx >> 6)] >> (bx & 63) & 1 != 0
    }

    /// The bits of the bricks along x at `(by, bz)`: brick `bx` is bit `bx % 64` of word `bx / 64`; bits beyond the last are 0.
    ///
    /// # Panics
    /// When there is no such row.
    #[inline(always)]
    pub fn row(&self, by: usize, bz: usize) -> &[u64] {
        &self.bits[(by + self.bricks[1] * bz) * self.words..][..self.words]
    }

    /// The bricks that hold weight, x fastest.
    pub fn all(&self) -> impl Iterator<Item = [usize; 3]> + '_ {
        let [nx, ny, nz] = self.bricks();
        let rows = (0..nz).flat_map(move |z| (0..ny).map(move |y| (y, z)));
        rows.flat_map(move |(y, z)| (0..nx).filter(move |x| self.occupied(*x, y, z)).map(move |x| [x, y, z]))
    }

    /// Number of occupied bricks.
    pub fn count(&self) -> usize {
        self.bits.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// Bytes held: a bit for 512 voxels, rows rounded up to 8 bytes.
    pub fn bytes(&self) -> usize {
        self.bits.capacity() * size_of::<u64>()
    }

    /// Reads every voxel once.
    pub(super) fn of(density: &Density) -> Self {
        let dims = density.volume.grid().dims();
        let bricks = dims.map(|n| n.div_ceil(Self::SIDE));
        let words = bricks[0].div_ceil(64);
        let mut bits = vec![0u64; words * bricks[1] * bricks[2]];
        with_voxels!(density.volume.voxels(), v => mark(density, &v[..], dims, bricks, words, &mut bits));
        Self { bricks, words, bits }
    }
}

/// How voxels of positive weight are told from the others.
enum Test<T> {
    /// Weights are stored values.
    Stored,
    /// All from one value to another and no other.
    Between(T, T),
    /// By weight.
    Weight,
}

impl<T: Voxel> Test<T> {
    fn of(density: &Density) -> Self {
        let (map, volume) = (&density.map, &density.volume);
        if density.table.is_empty() {
            let plain = map.transfer == Transfer::Identity && map.gains.is_none() && map.emphasis.is_none();
            return if plain && volume.slope() == 1.0 && volume.intercept() == 0.0 {
                Self::Stored
            } else {
                Self::Weight
            };
        }
        let positive = |w: &f64| *w > 0.0;
        let first = density.table.iter().position(positive).unwrap_or(0);
        let last = density.table.iter().rposition(positive).unwrap_or(0);
        match (T::of_ordinal(first), T::of_ordinal(last)) {
            (Some(low), Some(high)) if density.table[first..=last].iter().all(positive) => Self::Between(low, high),
            _ => Self::Weight,
        }
    }

    /// Sets the flags of those voxels of a line that have a positive weight.
    fn flag(&self, density: &Density, line: &[T], flags: &mut [u8]) {
        match *self {
            Self::Stored => {
                for (flag, v) in flags.iter_mut().zip(line) {
                    *flag |= u8::from(v.to_f64() > 0.0);
                }
            }
            Self::Between(low, high) => {
                for (flag, v) in flags.iter_mut().zip(line) {
                    *flag |= u8::from((*v >= low) & (*v <= high));
                }
            }
            Self::Weight => {
                for (flag, v) in flags.iter_mut().zip(line) {
                    *flag |= u8::from(density.lookup().weight(*v) > 0.0);
                }
            }
        }
    }
}

fn mark<T: Voxel>(
    density: &Density,
    voxels: &[T],
    [nx, ny, nz]: [usize; 3],
    bricks: [usize; 3],
    words: usize,
    bits: &mut [u64],
) {
    let test = Test::<T>::of(density);
    bits.par_chunks_mut(words * bricks[1]).enumerate().for_each(|(bz, slab)| {
        let mut flags = vec![0u8; nx];
        for (by, row) in slab.chunks_mut(words).enumerate() {
            flags.fill(0);
            for z in bz * Occupancy::SIDE..nz.min((bz + 1) * Occupancy::SIDE) {
                for y in by * Occupancy::SIDE..ny.min((by + 1) * Occupancy::SIDE) {
                    test.flag(density, &voxels[nx * (y + ny * z)..][..nx], &mut flags);
                }
            }
            for (bx, brick) in flags.chunks(Occupancy::SIDE).enumerate() {
                row[bx >> 6] |= u64::from(brick.iter().any(|f| *f != 0)) << (bx & 63);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DensityMap, Emphasis};
    use mcvr_volume::{Grid, Volume};

    fn check<T: Voxel>(dims: [usize; 3], map: DensityMap, value: impl Fn(usize) -> T) {
        let n = dims.iter().product::<usize>();
        // Far fewer voxels with a value than bricks, so that some bricks stay empty.
        let stored = |i: usize| if (i * 7919) % 1361 < 6 { i } else { 0 };
        let grid = Grid::with_spacing(dims, [1.0; 3]).unwrap();
        let volume = Volume::from_vec(grid, (0..n).map(|i| value(stored(i))).collect(), "test").unwrap();
        let density = Density::new(&volume, map).unwrap();
        let occupancy = density.occupancy();
        let [bx, by, bz] = occupancy.bricks();
        assert_eq!([bx, by, bz], dims.map(|n| n.div_ceil(8)));
        let mut expected = vec![false; bx * by * bz];
        for i in 0..n {
            let [x, y, z] = volume.grid().unravel(i).map(|v| v / 8);
            expected[x + bx * (y + by * z)] |= density.weight(i) > 0.0;
        }
        for (i, expected) in expected.iter().enumerate() {
            let [x, y, z] = [i % bx, i / bx % by, i / bx / by];
            assert_eq!(occupancy.occupied(x, y, z), *expected, "brick {x},{y},{z} of {}", T::TYPE);
            assert_eq!(occupancy.row(y, z)[x / 64] >> (x % 64) & 1 == 1, *expected);
        }
        assert_eq!(occupancy.count(), expected.iter().filter(|e| **e).count());
        assert!(expected.iter().any(|e| *e) && (bx * by * bz < 20 || !expected.iter().all(|e| *e)));
    }

    #[test]
    fn a_brick_is_occupied_exactly_when_one_of_its_voxels_has_weight() {
        for dims in [[40, 33, 17], [530, 9, 3], [1, 1, 3000], [16, 16, 9]] {
            let line = |slope, intercept| DensityMap {
                transfer: Transfer::Linear { slope, intercept },
                ..DensityMap::default()
            };
            let holes = DensityMap { emphasis: Some(Emphasis { threshold: 90.0, gain: 0.0 }), ..DensityMap::default() };
            check(dims, DensityMap::default(), |i| (i % 251) as u8);
            check(dims, DensityMap::default(), |i| (i % 251) as f32 - 20.0);
            check(dims, line(1.0, -100.0), |i| (i % 251) as u16);
            check(dims, line(1.0, -100.0), |i| (i % 251) as i32);
            check(dims, line(0.3, 30.1), |i| (i % 200) as i16 - 110);
            check(dims, holes, |i| (i % 251) as u8);
            let ends = DensityMap {
                transfer: Transfer::Piecewise(vec![[0.0, 0.0], [10.0, 1.0], [20.0, 0.0], [30.0, 0.0], [40.0, 1.0]]),
                ..DensityMap::default()
            };
            check(dims, ends, |i| (i % 100) as i8);
        }
    }
}
