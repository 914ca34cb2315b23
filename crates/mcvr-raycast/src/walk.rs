//! The walk of a ray through bricks and cells (Amanatides and Woo 1987), and the exact integral on the way.

use std::marker::PhantomData;
use std::ops::Range;

use mcvr_volume::Voxel;

use crate::Counters;
use crate::bricks::{Bricks, SIDE};
use crate::cell::{CellKernel, Piece, local};
use crate::field::Weigh;
use crate::view::IndexRay;

/// A field that can be integrated along rays.
pub(crate) trait RayField: Send + Sync {
    /// `∫ ρ dt` along the ray, or `∫ ρ t² dt` when `squared`.
    fn integrate(&self, ray: &IndexRay, squared: bool, counters: &mut Counters) -> f64;

    /// The box around all density, in cell coordinates.
    fn bounds(&self) -> ([f64; 3], [f64; 3]);
}

/// The way through the bricks and cells of a grid.
pub(crate) struct Walk {
    bricks: Bricks,
    /// The box around the occupied bricks, in cell coordinates.
    pub low: [f64; 3],
    pub high: [f64; 3],
}

/// Typed voxels with their weights, kernel and brick map.
pub(crate) struct CellField<'a, T, W, K> {
    voxels: &'a [T],
    weights: W,
    dims: [usize; 3],
    walk: Walk,
    kernel: PhantomData<K>,
}

/// `v` or 0, without a branch.
#[inline(always)]
fn keep(v: f64, when: bool) -> f64 {
    f64::from_bits(v.to_bits() & u64::from(when).wrapping_neg())
}

/// Where a ray meets the next plane between cells (or bricks) on each axis.
#[derive(Clone, Copy)]
struct Crossings {
    next: [f64; 3],
    delta: [f64; 3],
    step: [i32; 3],
}

impl Crossings {
    /// From index `at` on, for planes at multiples of `side`.
    #[inline(always)]
    fn new(ray: &IndexRay, inverse: [f64; 3], at: [i32; 3], side: f64) -> Self {
        let mut c = Self { next: [f64::INFINITY; 3], delta: [f64::INFINITY; 3], step: [0; 3] };
        for (a, &inverse) in inverse.iter().enumerate() {
            // A direction of 0 (or one so small that its inverse overflows) never meets a plane.
            if inverse.is_finite() {
                let forward = inverse > 0.0;
                let plane = f64::from(at[a] + i32::from(forward)) * side;
                c.next[a] = (plane - ray.origin[a]) * inverse;
                c.delta[a] = side * inverse.abs();
                c.step[a] = if forward { 1 } else { -1 };
            }
        }
        c
    }

    /// The nearest plane's parameter.
    #[inline(always)]
    fn nearest(&self) -> f64 {
        let m = if self.next[0] < self.next[1] { self.next[0] } else { self.next[1] };
        if m < self.next[2] { m } else { self.next[2] }
    }

    /// Crosses the nearest plane; exactly one of the three is 1. Written without branches: which axis comes
    /// next is unpredictable.
    #[inline(always)]
    fn cross(&mut self) -> [bool; 3] {
        let [x, y, z] = self.next;
        let sx = (x <= y) & (x <= z);
        let sy = !sx & (y <= z);
        let sz = !(sx | sy);
        let hit = [sx, sy, sz];
        for (next, (delta, hit)) in self.next.iter_mut().zip(self.delta.iter().zip(hit)) {
            *next += keep(*delta, hit);
        }
        hit
    }
}

impl Walk {
    /// Scans the voxels once for the brick map; a cell depends on the `taps` voxels that end at its own index.
    pub fn new<T: Voxel, W: Weigh<T, f64>>(voxels: &[T], weights: &W, dims: [usize; 3], taps: usize) -> Self {
        let bricks = Bricks::new(voxels, weights, dims, taps);
        let side = SIDE as f64;
        let low = std::array::from_fn(|a| bricks.first[a] as f64 * side);
        let high = std::array::from_fn(|a| ((bricks.last[a] + 1) as f64 * side).min((dims[a] + taps - 1) as f64));
        Self { bricks, low, high }
    }

    /// Index of the unit (cell, or brick when `side` is 8) that holds the ray's point at `t`, kept in `low..=high`.
    #[inline(always)]
    fn locate(ray: &IndexRay, t: f64, inverse_side: f64, low: [i32; 3], high: [i32; 3]) -> [i32; 3] {
        std::array::from_fn(|a| {
            let u = (ray.origin[a] + t * ray.direction[a]) * inverse_side;
            (u as i32).max(low[a]).min(high[a])
        })
    }

    /// Calls `f` with every occupied brick and its part of the ray's range, from near to far. Counts the others.
    #[inline(always)]
    pub fn bricks(
        &self,
        ray: &IndexRay,
        Range { start: mut t, end }: Range<f64>,
        counters: &mut Counters,
        mut f: impl FnMut([i32; 3], Range<f64>, &mut Counters),
    ) {
        let first = self.bricks.first.map(|b| b as i32);
        let last = self.bricks.last.map(|b| b as i32);
        let mut brick = Self::locate(ray, t, 1.0 / SIDE as f64, first, last);
        let mut planes = Crossings::new(ray, ray.direction.map(|d| 1.0 / d), brick, SIDE as f64);
        loop {
            let leave = planes.nearest().min(end);
            if leave > t {
                if self.bricks.occupied(brick) {
                    f(brick, t..leave, counters);
                } else {
                    counters.empty_bricks += 1;
                }
                t = leave;
            }
            let hit = planes.cross();
            let mut inside = leave < end;
            for a in 0..3 {
                brick[a] += if hit[a] { planes.step[a] } else { 0 };
                inside &= first[a] <= brick[a] && brick[a] <= last[a];
            }
            if !inside {
                return;
            }
        }
    }

    /// Calls `f` with every cell of a brick that the ray's range meets, and the piece of the ray in it.
    #[inline(always)]
    pub fn cells(
        ray: &IndexRay,
        brick: [i32; 3],
        Range { start: mut t, end }: Range<f64>,
        mut f: impl FnMut([i32; 3], &Piece),
    ) {
        let low = brick.map(|b| b * SIDE as i32);
        let high = low.map(|c| c + SIDE as i32 - 1);
        let mut cell = Self::locate(ray, t, 1.0, low, high);
        let mut planes = Crossings::new(ray, ray.direction.map(|d| 1.0 / d), cell, 1.0);
        let mut piece = Piece { local: local(ray, cell), step: ray.direction, from: t, to: t };
        let back: [f64; 3] = planes.step.map(f64::from);
        // A straight line meets at most 3 * 8 - 2 cells of a brick; the bound also ends walks on which rounding
        // keeps `t` from advancing.
        for _ in 0..3 * SIDE {
            let leave = planes.nearest();
            let leave = if leave < end { leave } else { end };
            if leave > t {
                (piece.from, piece.to) = (t, leave);
                f(cell, &piece);
                t = leave;
            }
            if leave >= end {
                break;
            }
            let hit = planes.cross();
            for a in 0..3 {
                cell[a] += planes.step[a] & -i32::from(hit[a]);
                piece.local[a] -= keep(back[a], hit[a]);
            }
        }
    }
}

impl<'a, T: Voxel, W: Weigh<T, f64>, K: CellKernel> CellField<'a, T, W, K> {
    /// Scans the voxels once for the brick map.
    pub fn new(voxels: &'a [T], weights: W, dims: [usize; 3]) -> Self {
        let walk = Walk::new(voxels, &weights, dims, K::TAPS);
        Self { voxels, weights, dims, walk, kernel: PhantomData }
    }

    fn trace<const SQUARED: bool>(&self, ray: &IndexRay, counters: &mut Counters) -> f64 {
        counters.rays += 1;
        let Some((from, to)) = ray.clip(self.walk.low, self.walk.high) else { return 0.0 };
        let mut sum = 0.0;
        self.walk.bricks(ray, from..to, counters, |brick, range, counters| {
            sum += self.brick::<SQUARED>(ray, brick, range, counters);
        });
        sum
    }

    /// The integral within one brick.
    #[inline(always)]
    fn brick<const SQUARED: bool>(
        &self,
        ray: &IndexRay,
        brick: [i32; 3],
        range: Range<f64>,
        counters: &mut Counters,
    ) -> f64 {
        let (mut sum, mut cells, mut reads) = (0.0, 0, 0);
        Walk::cells(ray, brick, range, |cell, piece| {
            let weights = self.gather(cell, &mut reads);
            sum += K::integrate::<SQUARED>(&weights, piece);
            cells += 1;
        });
        counters.cells += cells;
        counters.voxel_reads += reads;
        counters.evaluations += cells * K::points(SQUARED);
        sum
    }

    /// Weights of a cell; voxels outside the grid weigh 0 (METHOD section 1).
    #[inline(always)]
    fn gather(&self, cell: [i32; 3], reads: &mut u64) -> K::Weights {
        let reach = K::TAPS - 1;
        let [nx, ny, nz] = self.dims;
        // Wraps to a huge number when the cell needs voxels before the grid.
        let [x, y, z] = cell.map(|c| (c as usize).wrapping_sub(reach));
        let fits = |at: usize, n: usize| n > reach && at < n - reach;
        if fits(x, nx) && fits(y, ny) && fits(z, nz) {
            *reads += (K::TAPS * K::TAPS * K::TAPS) as u64;
            let base = x + nx * (y + ny * z);
            return K::gather(|a, b, c| {
                debug_assert!(a <= reach && b <= reach && c <= reach);
                // SAFETY: `fits` gives x + a < nx, y + b < ny and z + c < nz for taps up to `reach`, and the
                // slice holds nx * ny * nz voxels (`Volume::new` checks it), so the index is in range.
                let v = unsafe { *self.voxels.get_unchecked(base + a + nx * (b + ny * c)) };
                self.weights.weigh(v)
            });
        }
        K::gather(|a, b, c| {
            let (i, j, k) = (x.wrapping_add(a), y.wrapping_add(b), z.wrapping_add(c));
            if i < nx && j < ny && k < nz {
                *reads += 1;
                self.weights.weigh(self.voxels[i + nx * (j + ny * k)])
            } else {
                0.0
            }
        })
    }
}

impl<T: Voxel, W: Weigh<T, f64> + Send, K: CellKernel> RayField for CellField<'_, T, W, K> {
    fn integrate(&self, ray: &IndexRay, squared: bool, counters: &mut Counters) -> f64 {
        if squared { self.trace::<true>(ray, counters) } else { self.trace::<false>(ray, counters) }
    }

    fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        (self.walk.low, self.walk.high)
    }
}
