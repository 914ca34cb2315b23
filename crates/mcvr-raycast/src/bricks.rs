//! Which bricks of 8×8×8 cells hold any density, so that rays cross the others in one step.

use mcvr_volume::Voxel;
use rayon::prelude::*;

use crate::field::Weigh;

/// Cells per brick and axis.
pub(crate) const SIDE: usize = 8;

/// Occupancy of bricks, one byte each (1/512 of the number of cells), and the box around the occupied ones.
pub(crate) struct Bricks {
    /// Bricks along (x, y, z).
    pub counts: [usize; 3],
    occupied: Vec<bool>,
    /// First and last occupied brick on each axis.
    pub first: [usize; 3],
    pub last: [usize; 3],
}

impl Bricks {
    /// Scans the voxels; a cell depends on the `taps` voxels that end at its own index.
    pub fn new<T: Voxel, W: Weigh<T, f64>>(voxels: &[T], weights: &W, dims: [usize; 3], taps: usize) -> Self {
        let counts = dims.map(|n| (n + taps - 1).div_ceil(SIDE));
        let range = |brick: usize, axis: usize| {
            let from = (brick * SIDE).saturating_sub(taps - 1);
            from.min(dims[axis])..(brick * SIDE + SIDE).min(dims[axis])
        };
        let occupied: Vec<bool> = (0..counts[0] * counts[1] * counts[2])
            .into_par_iter()
            .map(|n| {
                let (bx, by, bz) = (n % counts[0], n / counts[0] % counts[1], n / (counts[0] * counts[1]));
                range(bz, 2).any(|k| {
                    range(by, 1).any(|j| {
                        let row = dims[0] * (j + dims[1] * k);
                        let x = range(bx, 0);
                        voxels[row + x.start..row + x.end].iter().any(|&v| weights.weigh(v) > 0.0)
                    })
                })
            })
            .collect();
        let (mut first, mut last) = (counts, [0; 3]);
        for (n, _) in occupied.iter().enumerate().filter(|o| *o.1) {
            let at = [n % counts[0], n / counts[0] % counts[1], n / (counts[0] * counts[1])];
            for a in 0..3 {
                first[a] = first[a].min(at[a]);
                last[a] = last[a].max(at[a]);
            }
        }
        Self { counts, occupied, first, last }
    }

    /// True when some cell of the brick may hold density.
    #[inline(always)]
    pub fn occupied(&self, [x, y, z]: [i32; 3]) -> bool {
        let n = x as usize + self.counts[0] * (y as usize + self.counts[1] * z as usize);
        self.occupied.get(n).copied().unwrap_or(false)
    }
}
