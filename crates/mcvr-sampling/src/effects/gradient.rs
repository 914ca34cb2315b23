//! Gradients at samples: central differences of the weights, trilinearly interpolated, in index space.
//!
//! Two sources give the same numbers. [`Lazy`] reads the 32 voxels around a sample when it is asked; [`Stored`] computes
//! the differences of every voxel first (12 bytes a voxel) and reads 8 of them. Differences come before interpolation in
//! both, so equal weights give exactly zero. Only directions are used, so weights may carry any common factor; it keeps
//! squares of gradients finite.

use bytemuck::Zeroable;
use mcvr_scene::{Density, WeightFn, WeightLookup};
use mcvr_volume::{Voxel, with_voxels};
use rayon::prelude::*;

use crate::SamplingError;
use crate::real::Real;
use crate::simd::{SimdLevel, vectorised};
use crate::units::UnitWeights;

/// Samples whose stencils are laid side by side, so that the arithmetic on them is vector code.
const LANES: usize = 16;

/// Voxels in the stencil of one gradient.
pub(crate) const STENCIL: u64 = 32;

/// Corners read from a stored field for one gradient.
pub(crate) const CORNERS: u64 = 8;

/// Gradients (weight differences per voxel, times a constant) at positions in voxels.
pub(crate) trait Gradients: Send + Sync {
    fn fill(&self, positions: [&[f64]; 3], out: [&mut [f64]; 3]);
}

/// How stored voxels become the weights that are differenced, up to a common factor.
trait Read<T>: Send + Sync {
    type Real: Real;
    /// What is kept of a voxel until its stencil is complete; all bits zero stands for weight 0.
    type Staged: Copy + Zeroable + Send + Sync;
    fn stage(&self, stored: T) -> Self::Staged;
    fn weight(staged: Self::Staged) -> Self::Real;
}

/// The stored value is the weight, or its negative part is cut: exact in `f32` for 8 and 16 bits.
struct Direct;

impl<T: Voxel> Read<T> for Direct {
    type Real = f32;
    type Staged = T;
    #[inline(always)]
    fn stage(&self, stored: T) -> T {
        stored
    }
    #[inline(always)]
    fn weight(staged: T) -> f32 {
        let w = staged.to_f64() as f32;
        if w > 0.0 { w } else { 0.0 }
    }
}

/// Small integer weights by ordinal: exact in `f32`.
struct Small(Vec<f32>);

impl<T: Voxel> Read<T> for Small {
    type Real = f32;
    type Staged = f32;
    #[inline(always)]
    fn stage(&self, stored: T) -> f32 {
        self.0[stored.ordinal().unwrap_or(0)]
    }
    #[inline(always)]
    fn weight(staged: f32) -> f32 {
        staged
    }
}

/// Any other weights, over the largest.
struct Mapped<'a> {
    lookup: WeightLookup<'a>,
    scale: f64,
}

impl<T: Voxel> Read<T> for Mapped<'_> {
    type Real = f64;
    type Staged = f64;
    #[inline(always)]
    fn stage(&self, stored: T) -> f64 {
        self.lookup.weight(stored) * self.scale
    }
    #[inline(always)]
    fn weight(staged: f64) -> f64 {
        staged
    }
}

/// Runs an expression with `$read` bound to the density's cheapest exact [`Read`].
macro_rules! with_read {
    ($density:expr, $t:ident, $read:ident => $body:expr) => {
        match UnitWeights::of($density) {
            UnitWeights::Small(table) if is_direct::<$t>(&table) => {
                let $read = Direct;
                $body
            }
            UnitWeights::Small(table) => {
                let $read = Small(table.into_iter().map(|w| w as f32).collect());
                $body
            }
            _ => {
                let $read = Mapped { lookup: $density.lookup(), scale: 1.0 / $density.report().max_weight };
                $body
            }
        }
    };
}

/// True when the table holds every stored value itself, or 0 for negative ones.
fn is_direct<T: Voxel>(table: &[u32]) -> bool {
    let first = if T::TYPE.name().starts_with('i') { table.len() as i64 / 2 } else { 0 };
    table.iter().enumerate().all(|(i, w)| i64::from(*w) == (i as i64 - first).max(0))
}

/// Gradients read from the voxels when they are asked for.
pub(crate) fn lazy<'a>(density: &'a Density, level: SimdLevel) -> Box<dyn Gradients + 'a> {
    fn make<'a, T: Voxel>(density: &'a Density, voxels: &'a [T], level: SimdLevel) -> Box<dyn Gradients + 'a> {
        let dims = density.volume().grid().dims();
        with_read!(density, T, read => Box::new(Lazy { voxels, dims, read, level }))
    }
    with_voxels!(density.volume().voxels(), v => make(density, &v[..], level))
}

struct Lazy<'a, T, W> {
    voxels: &'a [T],
    dims: [usize; 3],
    read: W,
    level: SimdLevel,
}

impl<T: Voxel, W: Read<T>> Gradients for Lazy<'_, T, W> {
    fn fill(&self, positions: [&[f64]; 3], out: [&mut [f64]; 3]) {
        let [x, y, z] = positions;
        let [gx, gy, gz] = out;
        lazy_batch::<T, W>(self.level, self.voxels, self.dims, &self.read, [x, y, z], [gx, gy, gz]);
    }
}

vectorised! {
    fn lazy_batch<T: Voxel, W: Read<T>>(
        voxels: &[T], dims: [usize; 3], read: &W, positions: [&[f64]; 3], out: [&mut [f64]; 3],
    ) = lazy_body::<T, W>
}

/// The cell of a position along one axis, and the place in it.
#[inline(always)]
fn cell(position: f64) -> (i64, f64) {
    let base = position.floor();
    (base as i64, position - base)
}

/// Index of (x, y, z) offsets -1..=2 in a 4×4×4 stencil, of which the corner columns are not used.
const fn at(x: usize, y: usize, z: usize) -> usize {
    x + 4 * (y + 4 * z)
}

#[inline(always)]
fn lazy_body<T: Voxel, W: Read<T>>(
    voxels: &[T],
    dims: [usize; 3],
    read: &W,
    positions: [&[f64]; 3],
    out: [&mut [f64]; 3],
) {
    let n = positions[0].len();
    let [px, py, pz] = positions.map(|p| &p[..n]);
    let [gx, gy, gz] = out.map(|o| &mut o[..n]);
    let mut staged = [[W::Staged::zeroed(); LANES]; 64];
    let mut place = [[W::Real::lit(0.0); LANES]; 3];
    let mut first = 0;
    while first < n {
        let count = LANES.min(n - first);
        for lane in 0..count {
            let i = first + lane;
            let ((x, fx), (y, fy), (z, fz)) = (cell(px[i]), cell(py[i]), cell(pz[i]));
            place[0][lane] = W::Real::lit(fx);
            place[1][lane] = W::Real::lit(fy);
            place[2][lane] = W::Real::lit(fz);
            stage::<T, W>(voxels, dims, read, [x, y, z], lane, &mut staged);
        }
        let mut sums = [[W::Real::lit(0.0); LANES]; 3];
        interpolate_stencil::<T, W>(&staged, &place, &mut sums);
        for lane in 0..count {
            gx[first + lane] = sums[0][lane].to_f64();
            gy[first + lane] = sums[1][lane].to_f64();
            gz[first + lane] = sums[2][lane].to_f64();
        }
        first += count;
    }
}

/// Puts the stencil of the cell at (x, y, z) into a lane.
#[inline(always)]
fn stage<T: Voxel, W: Read<T>>(
    voxels: &[T],
    dims: [usize; 3],
    read: &W,
    [x, y, z]: [i64; 3],
    lane: usize,
    staged: &mut [[W::Staged; LANES]; 64],
) {
    let [nx, ny, nz] = dims;
    let fits = |v: i64, n: usize| v >= 1 && v + 2 < n as i64;
    if fits(x, nx) && fits(y, ny) && fits(z, nz) {
        let (stride_y, stride_z) = (nx, nx * ny);
        let base = (x - 1) as usize + (y - 1) as usize * stride_y + (z - 1) as usize * stride_z;
        for dz in 0..4 {
            for dy in 0..4 {
                let inner = (dy == 1 || dy == 2) && (dz == 1 || dz == 2);
                let outer = (dy == 1 || dy == 2) || (dz == 1 || dz == 2);
                if inner {
                    let row = &voxels[base + dy * stride_y + dz * stride_z..][..4];
                    for dx in 0..4 {
                        staged[at(dx, dy, dz)][lane] = read.stage(row[dx]);
                    }
                } else if outer {
                    let row = &voxels[base + dy * stride_y + dz * stride_z + 1..][..2];
                    staged[at(1, dy, dz)][lane] = read.stage(row[0]);
                    staged[at(2, dy, dz)][lane] = read.stage(row[1]);
                }
            }
        }
        return;
    }
    let along = |v: i64, d: usize, n: usize| {
        let v = v + d as i64 - 1;
        (v >= 0 && v < n as i64).then_some(v as usize)
    };
    for dz in 0..4 {
        for dy in 0..4 {
            for dx in 0..4 {
                let voxel = match (along(x, dx, nx), along(y, dy, ny), along(z, dz, nz)) {
                    (Some(x), Some(y), Some(z)) => read.stage(voxels[x + nx * (y + ny * z)]),
                    _ => W::Staged::zeroed(),
                };
                staged[at(dx, dy, dz)][lane] = voxel;
            }
        }
    }
}

/// `a + f (b - a)` in all lanes.
#[inline(always)]
fn lerp<R: Real>(a: &[R; LANES], b: &[R; LANES], f: &[R; LANES]) -> [R; LANES] {
    let mut out = *a;
    for l in 0..LANES {
        out[l] = a[l] + f[l] * (b[l] - a[l]);
    }
    out
}

/// Trilinear interpolation of eight corners, x fastest.
#[inline(always)]
fn trilinear<R: Real>(c: &[[R; LANES]; 8], place: &[[R; LANES]; 3]) -> [R; LANES] {
    let [fx, fy, fz] = place;
    let near = lerp(&lerp(&c[0], &c[1], fx), &lerp(&c[2], &c[3], fx), fy);
    let far = lerp(&lerp(&c[4], &c[5], fx), &lerp(&c[6], &c[7], fx), fy);
    lerp(&near, &far, fz)
}

/// Differences at the eight corners along each axis, interpolated.
#[inline(always)]
fn interpolate_stencil<T: Voxel, W: Read<T>>(
    staged: &[[W::Staged; LANES]; 64],
    place: &[[W::Real; LANES]; 3],
    out: &mut [[W::Real; LANES]; 3],
) {
    for axis in 0..3 {
        let mut corners = [[W::Real::lit(0.0); LANES]; 8];
        for (k, corner) in corners.iter_mut().enumerate() {
            let here = [1 + (k & 1), 1 + (k >> 1 & 1), 1 + (k >> 2)];
            let (mut low, mut high) = (here, here);
            low[axis] -= 1;
            high[axis] += 1;
            let (low, high) = (&staged[at(low[0], low[1], low[2])], &staged[at(high[0], high[1], high[2])]);
            for l in 0..LANES {
                corner[l] = W::weight(high[l]) - W::weight(low[l]);
            }
        }
        out[axis] = trilinear(&corners, place);
    }
}

/// Differences at every voxel and at those that touch the grid from outside, kept.
pub(crate) struct Stored {
    field: Vec<[f32; 3]>,
    /// Extents with a voxel of margin on each side; farther out every difference is 0.
    padded: [usize; 3],
    level: SimdLevel,
}

impl Stored {
    /// Bytes of memory a voxel.
    pub(crate) const BYTES: u64 = 12;

    /// Voxels that the field of a grid holds, margin included.
    pub(crate) fn voxels(dims: [usize; 3]) -> u64 {
        dims.iter().map(|&n| n as u64 + 2).product()
    }

    /// Computes the differences on the current pool.
    pub(crate) fn new(density: &Density, level: SimdLevel) -> Result<Self, SamplingError> {
        fn fill<T: Voxel>(density: &Density, voxels: &[T], dims: [usize; 3], field: &mut [[f32; 3]]) {
            with_read!(density, T, read => differences::<T, _>(voxels, dims, &read, field));
        }
        let dims = density.volume().grid().dims();
        let len = Self::voxels(dims);
        let mut field = vec![];
        field.try_reserve_exact(len as usize).map_err(|_| SamplingError::Limit {
            method: "shading",
            problem: format!("no memory for a gradient field of {len} voxels of {} bytes", Self::BYTES),
        })?;
        field.resize(len as usize, [0.0; 3]);
        with_voxels!(density.volume().voxels(), v => fill(density, &v[..], dims, &mut field));
        Ok(Self { field, padded: dims.map(|n| n + 2), level })
    }
}

fn differences<T: Voxel, W: Read<T>>(voxels: &[T], dims: [usize; 3], read: &W, field: &mut [[f32; 3]]) {
    let [nx, ny, nz] = dims;
    let (lines, depth) = (ny + 2, nx + 2);
    field.par_chunks_mut(depth).enumerate().for_each(|(line, out)| {
        // Voxel coordinates, wrapped to huge numbers on the near margin.
        let (y, z) = ((line % lines).wrapping_sub(1), (line / lines).wrapping_sub(1));
        let weight = |x: usize, y: usize, z: usize| {
            let inside = x < nx && y < ny && z < nz;
            if inside { W::weight(read.stage(voxels[x + nx * (y + ny * z)])).to_f64() } else { 0.0 }
        };
        for (x, g) in out.iter_mut().enumerate() {
            let x = x.wrapping_sub(1);
            let (up, down) = (|v: usize| v.wrapping_add(1), |v: usize| v.wrapping_sub(1));
            *g = [
                (weight(up(x), y, z) - weight(down(x), y, z)) as f32,
                (weight(x, up(y), z) - weight(x, down(y), z)) as f32,
                (weight(x, y, up(z)) - weight(x, y, down(z))) as f32,
            ];
        }
    });
}

impl Gradients for Stored {
    fn fill(&self, positions: [&[f64]; 3], out: [&mut [f64]; 3]) {
        let [x, y, z] = positions;
        let [gx, gy, gz] = out;
        stored_batch(self.level, &self.field, self.padded, [x, y, z], [gx, gy, gz]);
    }
}

vectorised! {
    fn stored_batch(field: &[[f32; 3]], padded: [usize; 3], positions: [&[f64]; 3], out: [&mut [f64]; 3]) = stored_body
}

#[inline(always)]
fn stored_body(field: &[[f32; 3]], padded: [usize; 3], positions: [&[f64]; 3], out: [&mut [f64]; 3]) {
    let n = positions[0].len();
    let [px, py, pz] = positions.map(|p| &p[..n]);
    let [gx, gy, gz] = out.map(|o| &mut o[..n]);
    let [nx, ny, nz] = padded;
    let mut corners = [[[0f32; LANES]; 8]; 3];
    let mut place = [[0f32; LANES]; 3];
    let mut first = 0;
    while first < n {
        let count = LANES.min(n - first);
        for lane in 0..count {
            let i = first + lane;
            let ((x, fx), (y, fy), (z, fz)) = (cell(px[i]), cell(py[i]), cell(pz[i]));
            place[0][lane] = fx as f32;
            place[1][lane] = fy as f32;
            place[2][lane] = fz as f32;
            let ([x, y, z], fits) = ([x + 1, y + 1, z + 1], |v: i64, n: usize| v >= 0 && v + 1 < n as i64);
            let inside = fits(x, nx) && fits(y, ny) && fits(z, nz);
            let base = if inside { x as usize + nx * (y as usize + ny * z as usize) } else { 0 };
            for k in 0..8 {
                let (dx, dy, dz) = (k & 1, k >> 1 & 1, k >> 2);
                let corner = [x + dx as i64, y + dy as i64, z + dz as i64].map(|v| v as usize);
                let g = if inside {
                    field[base + dx + nx * (dy + ny * dz)]
                } else if corner[0] < nx && corner[1] < ny && corner[2] < nz {
                    field[corner[0] + nx * (corner[1] + ny * corner[2])]
                } else {
                    [0.0; 3]
                };
                for axis in 0..3 {
                    corners[axis][k][lane] = g[axis];
                }
            }
        }
        let sums = [trilinear(&corners[0], &place), trilinear(&corners[1], &place), trilinear(&corners[2], &place)];
        for lane in 0..count {
            gx[first + lane] = f64::from(sums[0][lane]);
            gy[first + lane] = f64::from(sums[1][lane]);
            gz[first + lane] = f64::from(sums[2][lane]);
        }
        first += count;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use mcvr_scene::effects::gradient;
    use mcvr_scene::{DensityMap, Emphasis, Transfer};
    use mcvr_volume::{Grid, Volume};

    fn density<T: Voxel>(voxel: impl Fn(usize) -> T, map: DensityMap) -> Density {
        let grid = Grid::with_spacing([7, 5, 6], [1.0; 3]).unwrap();
        let voxels = (0..grid.len()).map(|i| voxel(i * 7919 % 251)).collect();
        Density::new(&Volume::from_vec(grid, voxels, "test").unwrap(), map).unwrap()
    }

    /// Every source at every level against the definition, inside, on the border and beyond it.
    fn check(d: &Density, scale: f64) {
        let positions: Vec<[f64; 3]> = (0..1000u32)
            .map(|i| {
                let u = |k: u32| f64::from(i.wrapping_mul(0x9e37_79b9).wrapping_mul(k).rotate_left(k)) / 2f64.powi(32);
                [u(1) * 10.5 - 2.0, u(3) * 8.5 - 2.0, u(5) * 9.5 - 2.0]
            })
            .chain([[0.0, 0.0, 0.0], [6.0, 4.0, 5.0], [3.0, 2.0, 2.0], [-1.0, 2.5, 3.5], [-2.0, -2.0, -2.0]])
            .collect();
        let column = |a: usize| positions.iter().map(|p| p[a]).collect::<Vec<_>>();
        let [x, y, z] = [column(0), column(1), column(2)];
        for level in SimdLevel::available() {
            let stored = Stored::new(d, level).unwrap();
            let sources: [(&str, Box<dyn Gradients + '_>); 2] =
                [("lazy", lazy(d, level)), ("stored", Box::new(stored))];
            for (name, source) in sources {
                let n = positions.len();
                let mut g = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
                let [gx, gy, gz] = &mut g;
                source.fill([&x, &y, &z], [gx, gy, gz]);
                for i in 0..n {
                    let exact = gradient(d, DVec3::from_array(positions[i])) * 2.0 * scale;
                    let found = DVec3::new(g[0][i], g[1][i], g[2][i]);
                    // A place in a cell has 24 bits, a difference at most the largest weight (1 or 250 here).
                    let bound = 16.0 * f64::from(f32::EPSILON) * d.report().max_weight * scale;
                    assert!((found - exact).length() <= bound, "{name} {level:?} {:?} {found} {exact}", positions[i]);
                }
            }
        }
    }

    #[test]
    fn both_sources_agree_with_the_definition_for_every_way_of_reading() {
        check(&density(|v| v as u8, DensityMap::default()), 1.0);
        check(&density(|v| v as i16 - 100, DensityMap::default()), 1.0);
        let emphasis = DensityMap { emphasis: Some(Emphasis { threshold: 99.0, gain: 3.0 }), ..DensityMap::default() };
        check(&density(|v| v as u8, emphasis), 1.0);
        let map = DensityMap { transfer: Transfer::Linear { slope: 2e-5, intercept: 0.02 }, ..DensityMap::default() };
        let d = density(|v| v as i16 * 10 - 1100, map);
        check(&d, 1.0 / d.report().max_weight);
        let d = density(|v| v as f32 * 1e30, DensityMap::default());
        check(&d, 1.0 / d.report().max_weight);
        let d = density(|v| v as f64 * 1e300, DensityMap::default());
        check(&d, 1.0 / d.report().max_weight);
    }

    #[test]
    fn a_flat_region_has_exactly_no_gradient() {
        let d = density(|_| 0.1f32, DensityMap::default());
        let mut g = [[1.0; 1]; 3];
        let [gx, gy, gz] = &mut g;
        lazy(&d, SimdLevel::detect()).fill([&[2.3], &[1.7], &[2.9]], [gx, gy, gz]);
        assert_eq!(g, [[0.0]; 3]);
    }
}
