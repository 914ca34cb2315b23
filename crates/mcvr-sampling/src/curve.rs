//! The order of the Hilbert curve.

use mcvr_volume::Voxel;

use crate::SimdLevel;
use crate::dense::Lines;
use crate::hilbert::{Hilbert, unpack};
use crate::order::{BRICK, Layout};
use crate::units::Units;
use crate::word::Word;

/// The Hilbert order: half a cube of 8³ voxels per brick.
#[derive(Clone, Debug)]
pub(crate) struct Curve {
    pub(crate) dims: [usize; 3],
    pub(crate) curve: Hilbert,
}

impl Layout for Curve {
    fn bricks(&self) -> usize {
        2 * self.curve.len()
    }

    #[inline]
    fn sums<T: Voxel, U: Units<T>>(&self, brick: usize, voxels: &[T], units: U, sums: &mut [U::Word; BRICK]) -> usize {
        let (at, local) = self.curve.cube(brick / 2);
        let [nx, ny, nz] = self.dims;
        let mut sum = U::Word::default();
        let mut read = 0;
        for (s, &packed) in sums.iter_mut().zip(&local[brick % 2 * BRICK..]) {
            let [x, y, z] = unpack(packed);
            let (x, y, z) = ((at[0] + x) as usize, (at[1] + y) as usize, (at[2] + z) as usize);
            if x < nx && y < ny && z < nz {
                sum = sum.plus(units.units(voxels[x + nx * (y + ny * z)]));
                read += 1;
            }
            *s = sum;
        }
        read
    }

    fn voxels(&self, brick: usize) -> usize {
        let (at, local) = self.curve.cube(brick / 2);
        let inside = |packed: &&u16| {
            let p = unpack(**packed);
            (0..3).all(|a| ((at[a] + p[a]) as usize) < self.dims[a])
        };
        local[brick % 2 * BRICK..][..BRICK].iter().filter(inside).count()
    }

    #[inline(always)]
    fn place(&self, brick: usize, at: [u32; 3], position: u32) -> [u32; 3] {
        let (_, local) = self.curve.cube(brick / 2);
        let p = unpack(local[brick % 2 * BRICK + position as usize]);
        [at[0] + p[0], at[1] + p[1], at[2] + p[2]]
    }

    fn start(&self, brick: usize) -> [u32; 3] {
        self.curve.cube(brick / 2).0
    }

    fn bounds(&self, brick: usize) -> ([u32; 3], [u32; 3]) {
        let at = self.curve.cube(brick / 2).0;
        let last = |a: usize| (at[a] + 7).min(self.dims[a] as u32 - 1);
        (at, [last(0), last(1), last(2)])
    }

    fn resolve(&self, _: SimdLevel, _: &mut [Vec<u32>; 3]) {}

    fn lines(&self) -> Option<Lines> {
        None
    }

    fn turn(&self, _: &mut [Vec<u32>; 3]) {}
}
