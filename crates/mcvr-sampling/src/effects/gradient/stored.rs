//! A field of the gradients of all voxels.

use mcvr_scene::Density;
use mcvr_volume::{Voxel, with_voxels};
use rayon::prelude::*;

use super::read::{Read, with_read};
use super::{Gradients, LANES, cell, trilinear};
use crate::SamplingError;
use crate::real::Real;
use mcvr_volume::{SimdLevel, vectorised};

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

#[allow(clippy::needless_range_loop, reason = "a lane indexes several arrays")]
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
