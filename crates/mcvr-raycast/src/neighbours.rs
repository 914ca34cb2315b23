//! The weights around a cell between voxel centres: what effects need of the volume.

use mcvr_scene::effects::Palette;
use mcvr_volume::{Volume, Voxel};

use crate::Counters;
use crate::field::{Visit, Weigh};
use crate::walk::Walk;

/// Weights of 4×4×4 voxels, `[z][y][x]` with x fastest; the cell's corners are those with all positions 1 or 2.
pub(crate) struct Stencil {
    pub weights: [f64; 64],
    /// The weights times red, green and blue of their voxels; only where the density needs them, only with materials.
    pub tinted: [[f64; 64]; 3],
}

impl Default for Stencil {
    fn default() -> Self {
        Self { weights: [0.0; 64], tinted: [[0.0; 64]; 3] }
    }
}

/// Reads stencils from a volume of any type. `first` is the index of the stencil's first voxel; voxels outside the
/// grid weigh 0.
pub(crate) trait Neighbours: Send + Sync {
    /// Fills in what the density depends on: all 64 voxels when `wide`, else the corners. False when all weigh 0.
    fn density(&self, first: [i32; 3], wide: bool, stencil: &mut Stencil, counters: &mut Counters) -> bool;

    /// Adds to the corners the 24 voxels beside them, for central differences.
    fn surround(&self, first: [i32; 3], stencil: &mut Stencil, counters: &mut Counters);
}

/// Colours by stored value.
enum Colours<'a> {
    None,
    /// By ordinal.
    Table(Vec<[f64; 3]>),
    /// By isovalue.
    Ranges(&'a Palette, f64, f64),
}

impl<'a> Colours<'a> {
    fn new<T: Voxel>(palette: Option<&'a Palette>, volume: &Volume) -> Self {
        let (slope, intercept) = (volume.slope(), volume.intercept());
        match (palette, T::TYPE.cardinality()) {
            (None, _) => Self::None,
            (Some(p), Some(n)) => {
                // Signed types count their ordinals from the smallest value.
                let offset = if T::TYPE.name().starts_with('i') { n as f64 / 2.0 } else { 0.0 };
                Self::Table((0..n).map(|i| p.colour(slope * (i as f64 - offset) + intercept)).collect())
            }
            (Some(p), None) => Self::Ranges(p, slope, intercept),
        }
    }

    #[inline]
    fn of<T: Voxel>(&self, stored: T) -> [f64; 3] {
        match self {
            Self::None => [1.0; 3],
            Self::Table(t) => stored.ordinal().and_then(|i| t.get(i)).copied().unwrap_or([1.0; 3]),
            Self::Ranges(p, slope, intercept) => p.colour(slope * stored.to_f64() + intercept),
        }
    }
}

struct Typed<'a, T, W> {
    voxels: &'a [T],
    weights: W,
    dims: [usize; 3],
    colours: Colours<'a>,
}

/// Prepares neighbours and the walk to them.
pub(crate) struct MakeNeighbours<'a> {
    pub volume: &'a Volume,
    pub palette: Option<&'a Palette>,
    /// Voxels per axis on which a cell's density depends.
    pub taps: usize,
}

impl<'a> Visit<'a, f64> for MakeNeighbours<'a> {
    type Out = (Box<dyn Neighbours + 'a>, Walk);

    fn run<T: Voxel, W: Weigh<T, f64> + Send + 'a>(self, voxels: &'a [T], weights: W) -> Self::Out {
        let dims = self.volume.grid().dims();
        let walk = Walk::new(voxels, &weights, dims, self.taps);
        let colours = Colours::new::<T>(self.palette, self.volume);
        (Box::new(Typed { voxels, weights, dims, colours }), walk)
    }
}

impl<T: Voxel, W: Weigh<T, f64>> Typed<'_, T, W> {
    /// Calls `f` with the position in the stencil and the voxel, for every voxel of the ranges that the grid has.
    #[inline(always)]
    fn rows<const N: usize>(
        &self,
        first: [i32; 3],
        [x, y, z]: [std::ops::Range<usize>; 3],
        counters: &mut Counters,
        mut f: impl FnMut(usize, Option<T>),
    ) {
        let [nx, ny, nz] = self.dims;
        let start = i64::from(first[0]) + x.start as i64;
        for c in z {
            for b in y.clone() {
                let (j, k) = (i64::from(first[1]) + b as i64, i64::from(first[2]) + c as i64);
                let at = 16 * c + 4 * b + x.start;
                let inside = 0 <= j && j < ny as i64 && 0 <= k && k < nz as i64;
                let row = if inside { nx * (j as usize + ny * k as usize) } else { 0 };
                if inside && 0 <= start && start + N as i64 <= nx as i64 {
                    let from = row + start as usize;
                    let voxels = &self.voxels[from..from + N];
                    counters.voxel_reads += N as u64;
                    for (a, v) in voxels.iter().enumerate() {
                        f(at + a, Some(*v));
                    }
                    continue;
                }
                for a in 0..N {
                    let i = start + a as i64;
                    let inside = inside && 0 <= i && i < nx as i64;
                    counters.voxel_reads += u64::from(inside);
                    f(at + a, inside.then(|| self.voxels[row + i as usize]));
                }
            }
        }
    }

    #[inline(always)]
    fn density_of<const N: usize>(&self, first: [i32; 3], stencil: &mut Stencil, counters: &mut Counters) -> bool {
        let from = (4 - N) / 2;
        let range = from..from + N;
        let mut largest = 0.0f64;
        let mut looked_up = 0;
        self.rows::<N>(first, [range.clone(), range.clone(), range], counters, |at, voxel| {
            let w = voxel.map_or(0.0, |v| self.weights.weigh(v));
            largest = largest.max(w);
            stencil.weights[at] = w;
            if !matches!(self.colours, Colours::None) {
                let colour = match voxel {
                    Some(v) if w > 0.0 => {
                        looked_up += 1;
                        self.colours.of(v)
                    }
                    _ => [0.0; 3],
                };
                for (t, c) in stencil.tinted.iter_mut().zip(colour) {
                    t[at] = w * c;
                }
            }
        });
        counters.colours += looked_up;
        largest > 0.0
    }
}

impl<T: Voxel, W: Weigh<T, f64> + Send> Neighbours for Typed<'_, T, W> {
    fn density(&self, first: [i32; 3], wide: bool, stencil: &mut Stencil, counters: &mut Counters) -> bool {
        if wide {
            self.density_of::<4>(first, stencil, counters)
        } else {
            self.density_of::<2>(first, stencil, counters)
        }
    }

    fn surround(&self, first: [i32; 3], stencil: &mut Stencil, counters: &mut Counters) {
        let mut put = |at: usize, v: Option<T>| stencil.weights[at] = v.map_or(0.0, |v| self.weights.weigh(v));
        for x in [0, 3] {
            self.rows::<1>(first, [x..x + 1, 1..3, 1..3], counters, &mut put);
            self.rows::<2>(first, [1..3, x..x + 1, 1..3], counters, &mut put);
            self.rows::<2>(first, [1..3, 1..3, x..x + 1], counters, &mut put);
        }
    }
}

/// Position of a corner in the stencil; bits of `corner` are the steps along x, y and z.
pub(crate) const fn corner(corner: usize) -> usize {
    21 + (corner & 1) + 4 * (corner >> 1 & 1) + 16 * (corner >> 2 & 1)
}

impl Stencil {
    /// Central differences at the corners, in weights per voxel along the grid's axes.
    #[inline(always)]
    pub fn differences(&self) -> [[f64; 3]; 8] {
        let w = &self.weights;
        std::array::from_fn(|n| {
            let at = corner(n);
            [0.5 * (w[at + 1] - w[at - 1]), 0.5 * (w[at + 4] - w[at - 4]), 0.5 * (w[at + 16] - w[at - 16])]
        })
    }
}
