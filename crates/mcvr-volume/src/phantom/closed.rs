//! Fields given by a formula: uniform, linear, a single voxel, a Gaussian, the Marschner-Lobb signal.

use std::f64::consts::PI;

use super::unit;

/// Isovalue of every voxel of `box`.
pub(super) const BOX_VALUE: u8 = 100;
/// Isovalue of the one voxel of `voxel`.
const VOXEL_VALUE: u8 = 255;
/// Standard deviation of `gaussian` in unit coordinates: a tenth of each side.
const GAUSSIAN_SIGMA: f64 = 0.2;

/// `ramp`: isovalue of voxel (i, j, k) is i.
pub(super) fn ramp(dims: [usize; 3], slice: &mut [u16]) {
    for row in slice.chunks_mut(dims[0]) {
        for (i, v) in row.iter_mut().enumerate() {
            // At most 65535: checked where the specification is parsed.
            *v = i as u16;
        }
    }
}

/// `voxel`: 255 at voxel (nx/2, ny/2, nz/2), rounded down, 0 elsewhere.
pub(super) fn single_voxel(dims: [usize; 3], k: usize, slice: &mut [u8]) {
    if k == dims[2] / 2 {
        slice[dims[0] / 2 + dims[0] * (dims[1] / 2)] = VOXEL_VALUE;
    }
}

/// `gaussian`: `exp(-|q|² / 2σ²)`, q in unit coordinates, σ = 0.2, sampled at the voxel centres.
pub(super) fn gaussian(dims: [usize; 3], k: usize, slice: &mut [f32]) {
    let term = |i: usize, n: usize| (-unit(i, n).powi(2) / (2.0 * GAUSSIAN_SIGMA.powi(2))).exp();
    let along_x: Vec<f64> = (0..dims[0]).map(|i| term(i, dims[0])).collect();
    let z = term(k, dims[2]);
    for (j, row) in slice.chunks_mut(dims[0]).enumerate() {
        let yz = term(j, dims[1]) * z;
        for (v, x) in row.iter_mut().zip(&along_x) {
            *v = (x * yz) as f32;
        }
    }
}

/// `marschner-lobb`: `ρ = (1 − sin(πz/2) + α(1 + cos(2π f cos(πr/2)))) / (2(1+α))`, `r = √(x²+y²)`, f = 6, α = 0.25,
/// stored as `floor(255 ρ)`. The first and the last voxel centre of each axis lie at −1 and 1, as in the paper.
/// Source: S. Marschner and R. Lobb, *An evaluation of reconstruction filters for volume rendering*, Visualization 1994.
pub(super) fn marschner_lobb(dims: [usize; 3], k: usize, slice: &mut [u8]) {
    const F: f64 = 6.0;
    const ALPHA: f64 = 0.25;
    let at = |i: usize, n: usize| if n == 1 { 0.0 } else { 2.0 * i as f64 / (n - 1) as f64 - 1.0 };
    let along_z = 1.0 - (PI * at(k, dims[2]) / 2.0).sin();
    for (j, row) in slice.chunks_mut(dims[0]).enumerate() {
        let y = at(j, dims[1]);
        for (i, v) in row.iter_mut().enumerate() {
            let r = at(i, dims[0]).hypot(y);
            let ripple = 1.0 + (2.0 * PI * F * (PI * r / 2.0).cos()).cos();
            *v = (255.0 * (along_z + ALPHA * ripple) / (2.0 * (1.0 + ALPHA))) as u8;
        }
    }
}
