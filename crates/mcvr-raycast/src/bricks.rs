//! Which bricks of 8×8×8 cells hold any density, so that rays cross the others in one step.

use mcvr_scene::Density;
use mcvr_volume::Voxel;
use rayon::prelude::*;

use crate::field::{Visit, Weigh, with_field};

/// Cells per brick and axis.
pub(crate) const SIDE: usize = 8;

/// Occupancy of bricks, one byte each (1/512 of the number of cells), and the box around the occupied ones.
pub(crate) struct Bricks {
    /// Bricks along (x, y, z).
    pub counts: [usize; 3],
    occupied: Vec<bool>,
    dims: [usize; 3],
    /// First and last occupied brick on each axis.
    pub first: [usize; 3],
    pub last: [usize; 3],
}

struct Scan {
    dims: [usize; 3],
    taps: usize,
}

impl<'a> Visit<'a, f64> for Scan {
    type Out = Bricks;

    fn run<T: Voxel, W: Weigh<T, f64> + Send + 'a>(self, voxels: &'a [T], weights: W) -> Bricks {
        Bricks::new(voxels, &weights, self.dims, self.taps)
    }
}

impl Bricks {
    /// Scans a density's voxels.
    pub fn of(density: &Density, taps: usize) -> Self {
        with_field(density, Scan { dims: density.volume().grid().dims(), taps })
    }

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
        Self { counts, occupied, dims, first, last }
    }

    /// The box around the occupied bricks, in cell coordinates; a cell depends on `taps` voxels per axis.
    pub fn bounds(&self, taps: usize) -> ([f64; 3], [f64; 3]) {
        let side = SIDE as f64;
        let low = std::array::from_fn(|a| self.first[a] as f64 * side);
        let high = std::array::from_fn(|a| ((self.last[a] + 1) as f64 * side).min((self.dims[a] + taps - 1) as f64));
        (low, high)
    }

    /// True when a brick between two corners, both included, is occupied.
    pub fn any(&self, first: [usize; 3], last: [usize; 3]) -> bool {
        (first[2]..=last[2]).any(|z| {
            (first[1]..=last[1]).any(|y| {
                let row = self.counts[0] * (y + self.counts[1] * z);
                self.occupied[row + first[0]..=row + last[0]].contains(&true)
            })
        })
    }

    /// True when some cell of the brick may hold density.
    #[inline(always)]
    pub fn occupied(&self, [x, y, z]: [i32; 3]) -> bool {
        let n = x as usize + self.counts[0] * (y as usize + self.counts[1] * z as usize);
        self.occupied.get(n).copied().unwrap_or(false)
    }
}
