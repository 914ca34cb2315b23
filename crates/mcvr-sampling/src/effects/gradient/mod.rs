//! Gradients at samples: central differences of the weights, trilinearly interpolated, in index space.
//!
//! Two sources give the same numbers. [`lazy()`] reads the 32 voxels around a sample when it is asked; [`Stored`] computes
//! the differences of every voxel first (12 bytes a voxel) and reads 8 of them. Differences come before interpolation in
//! both, so equal weights give exactly zero. Only directions are used, so weights may carry any common factor; it keeps
//! squares of gradients finite.

mod lazy;
mod read;
mod stored;
#[cfg(test)]
mod tests;

use crate::real::Real;

pub(crate) use lazy::lazy;
pub(crate) use stored::Stored;

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

/// The cell of a position along one axis, and the place in it.
#[inline(always)]
fn cell(position: f64) -> (i64, f64) {
    let base = position.floor();
    (base as i64, position - base)
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
