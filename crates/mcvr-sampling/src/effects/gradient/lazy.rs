//! Gradients from the voxels around each sample, read when they are asked for.

use bytemuck::Zeroable;
use mcvr_scene::Density;
use mcvr_volume::{Voxel, with_voxels};

use super::read::{Read, with_read};
use super::{Gradients, LANES, cell, trilinear};
use crate::real::Real;
use mcvr_volume::{SimdLevel, vectorised};

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

/// Index of (x, y, z) offsets -1..=2 in a 4×4×4 stencil, of which the corner columns are not used.
const fn at(x: usize, y: usize, z: usize) -> usize {
    x + 4 * (y + 4 * z)
}

#[allow(clippy::needless_range_loop, reason = "a lane indexes several arrays")]
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
