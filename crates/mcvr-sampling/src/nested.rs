//! Axes nested in one another: the orders of memory, of depth, and those with y or z innermost.

use mcvr_volume::{Voxel, vectorised};

use crate::dense::Lines;
use crate::order::{BRICK, Layout};
use crate::units::Units;
use crate::unpack::{Turned, prefetch, running};
use crate::word::Word;
use crate::{SamplingError, SimdLevel, totals};

/// Axes nested in one another: innermost, middle, outermost.
#[derive(Clone, Debug)]
pub(crate) struct Nested {
    dims: [usize; 3],
    axes: [usize; 3],
}

impl Nested {
    /// Axis `innermost` varies fastest, the others in memory order.
    pub(crate) fn new(dims: [usize; 3], innermost: usize) -> Result<Self, SamplingError> {
        if dims.iter().any(|&n| n >= 1 << 31) {
            return Err(SamplingError::Limit {
                method: "voxel order",
                problem: format!("extents {dims:?}: at most 2^31 - 1 voxels along an axis"),
            });
        }
        let axes = match innermost {
            0 => [0, 1, 2],
            1 => [1, 0, 2],
            _ => [2, 0, 1],
        };
        Ok(Self { dims, axes })
    }

    fn len(&self) -> usize {
        self.dims.iter().product()
    }

    pub(crate) fn axes(&self) -> [usize; 3] {
        self.axes
    }

    pub(crate) fn strides(&self) -> [usize; 3] {
        let memory = [1, self.dims[0], self.dims[0] * self.dims[1]];
        self.axes.map(|a| memory[a])
    }

    pub(crate) fn extents(&self) -> [usize; 3] {
        self.axes.map(|a| self.dims[a])
    }
}

impl Layout for Nested {
    fn bricks(&self) -> usize {
        self.len().div_ceil(BRICK)
    }

    #[inline]
    fn sums<T: Voxel, U: Units<T>>(&self, brick: usize, voxels: &[T], units: U, sums: &mut [U::Word; BRICK]) -> usize {
        let first = brick * BRICK;
        let count = BRICK.min(self.len() - first);
        let mut sum = U::Word::default();
        if self.axes[0] == 0 {
            running::<T, U>(SimdLevel::detect(), &voxels[first..first + count], units, sums);
            return count;
        } else {
            let ([n0, n1, _], [s0, s1, s2]) = (self.extents(), self.strides());
            let (mut i0, rest) = (first % n0, first / n0);
            let (mut i1, mut i2) = (rest % n1, rest / n1);
            let mut out = &mut sums[..count];
            while !out.is_empty() {
                let line = &voxels[i0 * s0 + i1 * s1 + i2 * s2..];
                let (these, rest) = out.split_at_mut(out.len().min(n0 - i0));
                for (s, &v) in these.iter_mut().zip(line.iter().step_by(s0)) {
                    sum = sum.plus(units.units(v));
                    *s = sum;
                }
                out = rest;
                i0 = 0;
                i1 += 1;
                if i1 == n1 {
                    i1 = 0;
                    i2 += 1;
                }
            }
        }
        sums[count..].fill(sum);
        count
    }

    #[inline]
    fn unpack<T: Voxel, U: Units<T>>(
        &self,
        brick: usize,
        voxels: &[T],
        units: U,
        turned: &mut Turned,
        sums: &mut [U::Word; BRICK],
    ) -> usize {
        if self.axes[0] != 0
            && let Some(lines) = turned.brick(self, brick, voxels)
        {
            running::<T, U>(SimdLevel::detect(), lines, units, sums);
            return lines.len();
        }
        self.sums(brick, voxels, units, sums)
    }

    #[inline(always)]
    fn prefetch<T: Voxel>(&self, brick: usize, voxels: &[T]) {
        if self.axes[0] == 0 {
            prefetch(&voxels[brick * BRICK..((brick + 1) * BRICK).min(voxels.len())]);
        }
    }

    fn voxels(&self, brick: usize) -> usize {
        BRICK.min(self.len() - brick * BRICK)
    }

    fn bricks_at_once(&self) -> usize {
        totals::bricks_at_once(self)
    }

    fn totals<T: Voxel, U: Units<T>>(&self, first: usize, voxels: &[T], units: U, totals: &mut [u64]) -> usize {
        totals::totals::<T, U>(SimdLevel::detect(), self, first, voxels, units, totals);
        (totals.len() * BRICK).min(self.len() - first * BRICK)
    }

    #[inline(always)]
    fn place(&self, _: usize, [i0, i1, i2]: [u32; 3], position: u32) -> [u32; 3] {
        [i0 + position, i1, i2]
    }

    #[inline]
    fn start(&self, brick: usize) -> [u32; 3] {
        let [n0, n1, _] = self.extents();
        let first = brick * BRICK;
        [(first % n0) as u32, (first / n0 % n1) as u32, (first / n0 / n1) as u32]
    }

    fn bounds(&self, brick: usize) -> ([u32; 3], [u32; 3]) {
        let [n0, n1, _] = self.extents().map(|n| n as u32);
        let last = ((brick + 1) * BRICK).min(self.len()) - 1;
        let [a0, a1, a2] = self.start(brick);
        let extents = self.extents();
        let [b0, b1, b2] =
            [last % extents[0], last / extents[0] % extents[1], last / extents[0] / extents[1]].map(|v| v as u32);
        // Whoever crosses an end of a line or a plane covers all of it.
        let (low, high) = if a2 < b2 {
            ([0, 0, a2], [n0 - 1, n1 - 1, b2])
        } else if a1 < b1 {
            ([0, a1, a2], [n0 - 1, b1, b2])
        } else {
            ([a0, a1, a2], [b0, b1, b2])
        };
        let (mut from, mut to) = ([0; 3], [0; 3]);
        for (r, &axis) in self.axes.iter().enumerate() {
            (from[axis], to[axis]) = (low[r], high[r]);
        }
        (from, to)
    }

    fn resolve(&self, level: SimdLevel, places: &mut [Vec<u32>; 3]) {
        let [n0, n1, _] = self.extents();
        let [p0, p1, p2] = places;
        // A place is less than a brick beyond the innermost extent, and so fewer than `lines` beyond the next.
        let lines = BRICK.div_ceil(n0) + 1;
        if n0 >= BRICK {
            carry_once(level, p0, p1, n0 as u32);
        } else {
            carry_small(level, p0, p1, n0 as u32);
        }
        if n1 >= lines {
            carry_once(level, p1, p2, n1 as u32);
        } else {
            carry_small(level, p1, p2, n1 as u32);
        }
        self.turn(places);
    }

    fn lines(&self) -> Option<Lines> {
        let [n0, n1, _] = self.extents();
        Lines::new(n0, n1)
    }

    fn turn(&self, places: &mut [Vec<u32>; 3]) {
        // places[r] is the coordinate along axes[r].
        match self.axes {
            [1, 0, 2] => places.swap(0, 1),
            [2, 0, 1] => places.rotate_left(1),
            _ => {}
        }
    }
}

vectorised! {
    /// Carries from digits below `2 n`.
    fn carry_once(low: &mut [u32], high: &mut [u32], n: u32) = carry_once_body
}

#[inline(always)]
fn carry_once_body(low: &mut [u32], high: &mut [u32], n: u32) {
    for (l, h) in low.iter_mut().zip(high) {
        let over = u32::from(*l >= n);
        *l -= over * n;
        *h += over;
    }
}

vectorised! {
    /// Carries from digits below 1024 where `n` is below 512: the quotient in f32 is exact, as its error
    /// (below 1024 * 2^-23) is far less than the distance 1/(2n) of `(l + 1/2) / n` from an integer.
    fn carry_small(low: &mut [u32], high: &mut [u32], n: u32) = carry_small_body
}

#[inline(always)]
fn carry_small_body(low: &mut [u32], high: &mut [u32], n: u32) {
    let inverse = 1.0 / n as f32;
    for (l, h) in low.iter_mut().zip(high) {
        let q = ((*l as i32 as f32 + 0.5) * inverse) as i32 as u32;
        *l -= q * n;
        *h += q;
    }
}
