//! Interpolated quantities along a straight line through a cell, as polynomials.
//!
//! Polynomials are given by their coefficients in powers of `x`, which runs over [-1, 1] from one end of the line to the
//! other.

use crate::cell::spline_weights;

/// Trilinear interpolation of four quantities at once along the line from `p` to `q` (local coordinates in [0, 1]), in
/// Bernstein form of degree 3. Corners as in [`corner`](crate::neighbours::corner).
///
/// The coefficients are the polar form: the trilinear function with each coordinate taken from one of the ends. They
/// are convex combinations of the corners, so corners of exactly 0 give exactly 0.
#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "corners are told by the bits of their numbers")]
pub(crate) fn trilinear(corners: &[[f64; 4]; 8], p: [f64; 3], q: [f64; 3]) -> [[f64; 4]; 4] {
    // Ends along x, then y, then z; index bits as for corners. Plain loops: whether closures over arrays are inlined changes with
    // code elsewhere, and with it a sixth of the time of shaded rays.
    let (mut x, mut y, mut z) = ([[0.0; 4]; 8], [[0.0; 4]; 8], [[0.0; 4]; 8]);
    for n in 0..8 {
        let (edge, end) = (n & 6, if n & 1 == 0 { p[0] } else { q[0] });
        x[n] = lerp(&corners[edge], &corners[edge + 1], end);
    }
    for n in 0..8 {
        let (edge, end) = (n & 5, if n & 2 == 0 { p[1] } else { q[1] });
        y[n] = lerp(&x[edge], &x[edge + 2], end);
    }
    for n in 0..8 {
        let (edge, end) = (n & 3, if n & 4 == 0 { p[2] } else { q[2] });
        z[n] = lerp(&y[edge], &y[edge + 4], end);
    }
    [z[0], third(&z[1], &z[2], &z[4]), third(&z[3], &z[5], &z[6]), z[7]]
}

#[inline(always)]
fn lerp(a: &[f64; 4], b: &[f64; 4], t: f64) -> [f64; 4] {
    [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2]), a[3] + t * (b[3] - a[3])]
}

#[inline(always)]
fn third(a: &[f64; 4], b: &[f64; 4], c: &[f64; 4]) -> [f64; 4] {
    let mut mean = [0.0; 4];
    for n in 0..4 {
        mean[n] = (a[n] + b[n] + c[n]) * (1.0 / 3.0);
    }
    mean
}

/// Powers of `x` from Bernstein coefficients of degree 3.
#[inline(always)]
pub(crate) fn powers(b: [f64; 4]) -> [f64; 4] {
    let (outer, inner) = (b[0] + b[3], b[1] + b[2]);
    let (across, between) = (b[3] - b[0], b[2] - b[1]);
    [
        0.125 * (outer + 3.0 * inner),
        0.375 * (across + between),
        0.375 * (outer - inner),
        0.125 * (across - 3.0 * between),
    ]
}

/// The polynomial at `x`.
#[inline(always)]
pub(crate) fn horner<const N: usize>(c: &[f64; N], x: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// The polynomial at several places: loops over the lanes inside, so that they become vectors.
#[inline(always)]
pub(crate) fn horners<const N: usize, const L: usize>(c: &[f64; N], x: &[f64; L]) -> [f64; L] {
    let mut sum = [c[N - 1]; L];
    for c in c[..N - 1].iter().rev() {
        for i in 0..L {
            sum[i] = sum[i] * x[i] + c;
        }
    }
    sum
}

/// The cubic B-spline field of 4×4×4 weights at local coordinates.
#[inline(always)]
pub(crate) fn spline(w: &[f64; 64], [x, y, z]: [f64; 3]) -> f64 {
    let (wx, wy, wz) = (spline_weights(x), spline_weights(y), spline_weights(z));
    let mut plane = [0.0; 16];
    for (c, &wc) in wz.iter().enumerate() {
        for (p, v) in plane.iter_mut().zip(&w[16 * c..16 * c + 16]) {
            *p += wc * v;
        }
    }
    let mut row = [0.0; 4];
    for (b, &wb) in wy.iter().enumerate() {
        for (r, v) in row.iter_mut().zip(&plane[4 * b..4 * b + 4]) {
            *r += wb * v;
        }
    }
    row[0] * wx[0] + row[1] * wx[1] + row[2] * wx[2] + row[3] * wx[3]
}

/// Turns values at `N` Chebyshev points into powers.
pub(crate) struct Fit<const N: usize> {
    pub points: [f64; N],
    /// Row n: coefficient of `x^n` from the values.
    matrix: [[f64; N]; N],
}

impl<const N: usize> Fit<N> {
    pub fn new() -> Self {
        let angle = |k: usize| std::f64::consts::PI * (k as f64 + 0.5) / N as f64;
        let points = std::array::from_fn(|k| angle(k).cos());
        // Powers of the Chebyshev polynomials by their recurrence; value k counts 2/N cos(n θ_k), 1/N for n = 0.
        let mut matrix = [[0.0; N]; N];
        let (mut previous, mut current) = ([0.0; N], [0.0; N]);
        current[0] = 1.0;
        for n in 0..N {
            let share = if n == 0 { 1.0 } else { 2.0 } / N as f64;
            for (row, power) in matrix.iter_mut().zip(current) {
                for (k, m) in row.iter_mut().enumerate() {
                    *m += power * share * (n as f64 * angle(k)).cos();
                }
            }
            let factor = if n == 0 { 1.0 } else { 2.0 };
            let next = std::array::from_fn(|i| if i == 0 { 0.0 } else { factor * current[i - 1] } - previous[i]);
            (previous, current) = (current, next);
        }
        Self { points, matrix }
    }

    /// The polynomial of degree `N - 1` through the values at the points.
    #[inline(always)]
    pub fn through(&self, values: [f64; N]) -> [f64; N] {
        self.matrix.map(|row| row.iter().zip(values).map(|(m, v)| m * v).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trilinear_function_along_a_line_is_its_cubic() {
        let corners: [[f64; 4]; 8] = std::array::from_fn(|n| {
            std::array::from_fn(|c| if c == 3 { 0.0 } else { ((n * 37 + c * 101) % 19) as f64 - 6.0 })
        });
        let (p, q) = ([0.1, 0.9, 0.0], [0.7, 0.2, 1.0]);
        let b = trilinear(&corners, p, q);
        for c in 0..4 {
            let poly = powers([b[0][c], b[1][c], b[2][c], b[3][c]]);
            for i in 0..=10 {
                let s = f64::from(i) / 10.0;
                let at: [f64; 3] = std::array::from_fn(|a| p[a] + s * (q[a] - p[a]));
                let expected: f64 = (0..8)
                    .map(|n| {
                        let w: f64 = (0..3).map(|a| if n >> a & 1 == 1 { at[a] } else { 1.0 - at[a] }).product();
                        w * corners[n][c]
                    })
                    .sum();
                assert!((horner(&poly, 2.0 * s - 1.0) - expected).abs() < 1e-13);
            }
        }
        assert!(b.iter().all(|b| b[3] == 0.0), "zero corners give exactly zero");
    }

    #[test]
    fn polynomials_pass_through_their_values() {
        let fit = Fit::<10>::new();
        let f = |x: f64| (1..=9).fold(0.3, |s, n| s * x + f64::from(n % 4) - 1.5);
        let poly = fit.through(fit.points.map(f));
        for i in 0..=20 {
            let x = f64::from(i) / 10.0 - 1.0;
            assert!((horner(&poly, x) - f(x)).abs() < 1e-13);
        }
    }
}
