//! Points in six bytes each: fixed point within bricks of space, sorted by brick.
//!
//! A point is 12 bytes as three `f32`, and a projection that is fast enough waits for them. Within a cube of 16, 32 or 64 voxels 16
//! bits an axis place it to 1/4096, 1/2048 or 1/1024 of a voxel. A point stands for the middle of its cell, so none is moved by
//! more than [`Compact::error`], half as much, and on average by nothing: next to a kernel, whose deviation is 0.29 voxels (`box`)
//! or more, that is 1/600 at most. What is sorted by brick also falls on few pixels at a time, whatever the size of the image.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Voxels beyond the grid's first voxel at which the first brick begins: more than any kernel reaches.
const MARGIN: u32 = 4;

/// Most voxels along an axis. The 32-bit positions of larger grids are no finer than half a voxel.
pub(crate) const MOST_VOXELS: usize = 1 << 22;

/// Points per brick from which on a brick is worth its 16 bytes and its own start of the vector code.
const ENOUGH: u64 = 512;

/// A cube of space that holds points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompactBrick {
    /// Its number along x, y and z; brick 0 begins 4 voxels before the grid's first voxel.
    pub at: [u32; 3],
    /// Its points, at least 1.
    pub points: u32,
}

impl CompactBrick {
    /// Bricks follow each other along x, then y, then z.
    fn key(&self) -> [u32; 3] {
        let [x, y, z] = self.at;
        [z, y, x]
    }
}

/// Points as 16-bit fractions of bricks.
#[derive(Clone, Debug, PartialEq)]
pub struct Compact {
    side: u32,
    bricks: Vec<CompactBrick>,
    /// Points before each brick, and in all.
    starts: Vec<u64>,
    /// Brick by brick x of all its points, then y, then z.
    words: Vec<u16>,
}

/// Points of one brick that lie in a row: their fractions along each axis.
pub(crate) struct Piece<'a> {
    /// Where a fraction of 0 stands for, in voxels from the grid's first voxel.
    pub origin: [f64; 3],
    pub words: [&'a [u16]; 3],
}

impl Compact {
    /// Bytes that a point takes, without its brick's 16.
    pub const BYTES_PER_POINT: u64 = 6;
    /// Sides of a brick, in voxels, that there are.
    pub const SIDES: [u32; 3] = [16, 32, 64];

    /// Joins the parts: the side of a brick in voxels, the bricks, and brick by brick x of all its points, then y, then z, in
    /// 1/65536 of a side.
    ///
    /// # Errors
    /// In words, when the side is not one of [`Compact::SIDES`], bricks are empty or do not rise (along x, then y, then z), or the
    /// words are not three for each point.
    pub fn new(side: u32, bricks: Vec<CompactBrick>, words: Vec<u16>) -> Result<Self, String> {
        if !Self::SIDES.contains(&side) {
            return Err(format!("bricks of {side} voxels a side; there are those of {:?}", Self::SIDES));
        }
        if let Some(n) = bricks.iter().position(|b| b.points == 0) {
            return Err(format!("brick {n} holds no points; expected at least 1"));
        }
        if let Some(n) = bricks.windows(2).position(|b| b[0].key() >= b[1].key()) {
            return Err(format!("brick {} does not follow brick {n} along x, then y, then z", n + 1));
        }
        let mut starts = vec![0u64];
        starts.extend(bricks.iter().scan(0, |sum, b| {
            *sum += u64::from(b.points);
            Some(*sum)
        }));
        let points = starts[bricks.len()];
        if points == 0 || points.checked_mul(3) != Some(words.len() as u64) {
            return Err(format!("{} fractions of {points} points: expected three each, and a point", words.len()));
        }
        Ok(Self { side, bricks, starts, words })
    }

    /// Sorts positions (voxels from the grid's first voxel) into bricks. The order of points within a brick is kept.
    ///
    /// # Errors
    /// In words, when there is no memory, or a brick would hold 2^32 points.
    pub(crate) fn of(dims: [usize; 3], centre: [i32; 3], positions: &[Vec<f32>; 3]) -> Result<Self, String> {
        let samples = positions[0].len();
        let refused = |_| format!("no memory for {samples} points of {} bytes", Self::BYTES_PER_POINT + 4);
        let mut keys: Vec<u32> = vec![];
        keys.try_reserve_exact(samples).map_err(refused)?;
        keys.resize(samples, 0);
        let (mut counts, mut side) = (vec![], 0);
        for s in Self::SIDES {
            side = s;
            let extents = dims.map(|n| (n + 2 * MARGIN as usize).div_ceil(s as usize));
            let all = extents.iter().try_fold(1usize, |n, e| n.checked_mul(*e)).filter(|n| *n < 1 << 32);
            let Some(all) = all else {
                if s == Self::SIDES[2] {
                    return Err(format!("extents {dims:?} make 2^32 bricks or more"));
                }
                continue;
            };
            keys.par_iter_mut().enumerate().for_each(|(k, key)| {
                let [x, y, z] = [0, 1, 2].map(|a| cell(positions[a][k], centre[a], s).0 as usize);
                *key = (x + extents[0] * (y + extents[1] * z)) as u32;
            });
            counts = vec![];
            counts.try_reserve_exact(all).map_err(refused)?;
            counts.resize(all, 0u64);
            keys.iter().for_each(|k| counts[*k as usize] += 1);
            if counts.iter().filter(|n| **n > 0).count() as u64 * ENOUGH <= samples as u64 {
                break;
            }
        }
        let extents = dims.map(|n| (n + 2 * MARGIN as usize).div_ceil(side as usize));
        let mut bricks = vec![];
        // From here on, where a brick's next point goes; three words a point, of which this is the first.
        let mut before = 0;
        for (key, count) in counts.iter_mut().enumerate().filter(|(_, n)| **n > 0) {
            let points = u32::try_from(*count).map_err(|_| format!("{count} points in one brick: at most 2^32 - 1"))?;
            let at = [key % extents[0], key / extents[0] % extents[1], key / extents[0] / extents[1]];
            bricks.push(CompactBrick { at: at.map(|v| v as u32), points });
            *count = 3 * before;
            before += u64::from(points);
        }
        let mut words: Vec<u16> = vec![];
        words.try_reserve_exact(3 * samples).map_err(refused)?;
        words.resize(3 * samples, 0);
        let mut sizes = vec![0u32; counts.len()];
        for brick in &bricks {
            let [x, y, z] = brick.at.map(|v| v as usize);
            sizes[x + extents[0] * (y + extents[1] * z)] = brick.points;
        }
        for (k, key) in keys.iter().enumerate() {
            let (next, size) = (&mut counts[*key as usize], sizes[*key as usize] as usize);
            for a in 0..3 {
                words[*next as usize + a * size] = cell(positions[a][k], centre[a], side).1;
            }
            *next += 1;
        }
        Self::new(side, bricks, words)
    }

    /// Number of points.
    pub fn samples(&self) -> u64 {
        self.starts[self.bricks.len()]
    }

    /// Side of a brick, in voxels.
    pub fn side(&self) -> u32 {
        self.side
    }

    /// The bricks.
    pub fn bricks(&self) -> &[CompactBrick] {
        &self.bricks
    }

    /// Brick by brick x of all its points, then y, then z, in 1/65536 of a side.
    pub fn words(&self) -> &[u16] {
        &self.words
    }

    /// The most that a point was moved along an axis, in voxels: half a step.
    pub fn error(&self) -> f64 {
        0.5 * self.step()
    }

    /// What a unit of a fraction is, in voxels.
    pub(crate) fn step(&self) -> f64 {
        f64::from(self.side) / 65536.0
    }

    /// Points `from..to` of the cloud, brick by brick.
    pub(crate) fn pieces(&self, from: u64, to: u64) -> impl Iterator<Item = Piece<'_>> {
        let first = self.starts.partition_point(|s| *s <= from) - 1;
        let bricks = first..self.starts.partition_point(|s| *s < to);
        bricks.map(move |b| {
            let (start, n) = (self.starts[b], self.bricks[b].points as usize);
            let base = 3 * start as usize;
            let (low, high) = ((from.max(start) - start) as usize, (to.min(self.starts[b + 1]) - start) as usize);
            let words = [0, 1, 2].map(|a| &self.words[base + a * n + low..base + a * n + high]);
            let origin = self.bricks[b].at.map(|v| f64::from(v) * f64::from(self.side) - f64::from(MARGIN));
            Piece { origin, words }
        })
    }

    /// Voxels from the grid's first voxel, of all points.
    pub(crate) fn decoded(&self, mut each: impl FnMut([f64; 3])) {
        for piece in self.pieces(0, self.samples()) {
            let [x, y, z] = piece.words;
            for ((x, y), z) in x.iter().zip(y).zip(z) {
                let [x, y, z] = [x, y, z].map(|w| (f64::from(*w) + 0.5) * self.step());
                each([piece.origin[0] + x, piece.origin[1] + y, piece.origin[2] + z]);
            }
        }
    }

    /// The first point that lies outside the ranges (voxels from the grid's first voxel), with its axis.
    pub(crate) fn outside(&self, ranges: [[f64; 2]; 3]) -> Option<(usize, f64)> {
        let step = self.step();
        self.pieces(0, self.samples()).find_map(|piece| {
            (0..3).find_map(|a| {
                let [low, high] = ranges[a];
                // Most bricks lie inside whole.
                if piece.origin[a] >= low && piece.origin[a] + f64::from(self.side) <= high {
                    return None;
                }
                let at = |w: &u16| piece.origin[a] + (f64::from(*w) + 0.5) * step;
                piece.words[a].iter().map(at).find(|v| !(low..=high).contains(v)).map(|v| (a, v))
            })
        })
    }
}

/// Brick and fraction of a position in voxels from the centre voxel.
#[inline]
fn cell(position: f32, centre: i32, side: u32) -> (u32, u16) {
    let at = f64::from(position) + f64::from(centre) + f64::from(MARGIN);
    let units = (at * (65536.0 / f64::from(side))) as u64;
    ((units >> 16) as u32, units as u16)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(n: usize) -> [Vec<f32>; 3] {
        let uniform = |i: usize| (crate::rng::mix(i as u64) >> 40) as f32 / (1 << 24) as f32;
        let axis = |k: usize| (0..n).map(|i| uniform(3 * i + k) * 99.0 - 49.5).collect();
        [axis(0), axis(1), axis(2)]
    }

    #[test]
    fn no_point_moves_by_more_than_the_stated_error_and_all_are_there() {
        let (dims, centre) = ([99, 99, 99], [49, 49, 49]);
        for (n, side) in [(1, 64), (1000, 64), (20_000, 64), (60_000, 32), (600_000, 16)] {
            let positions = points(n);
            let compact = Compact::of(dims, centre, &positions).unwrap();
            assert_eq!((compact.samples(), compact.side()), (n as u64, side), "{n}");
            assert_eq!(compact.error(), f64::from(side) / 131_072.0);
            // Sorted alike: by brick, and within it as they came.
            let mut order: Vec<usize> = (0..n).collect();
            let key = |k: &usize| [2, 1, 0].map(|a: usize| cell(positions[a][*k], centre[a], side).0);
            order.sort_by_key(key);
            let mut next = order.into_iter();
            let mut moved = [0.0; 3];
            compact.decoded(|at| {
                let k = next.next().unwrap();
                for a in 0..3 {
                    let exact = f64::from(positions[a][k]) + 49.0;
                    assert!((at[a] - exact).abs() <= compact.error(), "{n}: {at:?}");
                    moved[a] += (at[a] - exact) / n as f64;
                }
            });
            assert!(next.next().is_none());
            // The mean of n uniform errors, within five deviations; and half the distance between the values that a position takes
            // here, as a cell has its lower end and not its upper.
            let bound = 5.0 * compact.error() / (3.0 * n as f64).sqrt() + 99.0 * 0.5f64.powi(25);
            assert!(n < 1000 || moved.iter().all(|m| m.abs() < bound), "{moved:?}");
        }
    }

    #[test]
    fn parts_that_do_not_fit_are_refused() {
        let brick = |x, points| CompactBrick { at: [x, 0, 0], points };
        let refused = |side, bricks: &[CompactBrick], words: usize| {
            Compact::new(side, bricks.to_vec(), vec![0; words]).unwrap_err()
        };
        assert!(refused(20, &[brick(0, 1)], 3).contains("20 voxels"));
        assert!(refused(16, &[], 0).contains("0 points"));
        assert!(refused(16, &[brick(0, 0)], 0).contains("no points"));
        assert!(refused(16, &[brick(1, 1), brick(1, 1)], 6).contains("brick 1 does not follow"));
        assert!(refused(16, &[brick(1, 1), brick(0, 1)], 6).contains("brick 1 does not follow"));
        assert!(refused(16, &[brick(0, 2)], 5).contains("three"));
        assert!(refused(16, &[brick(0, u32::MAX)], 3).contains("three"));
    }
}
