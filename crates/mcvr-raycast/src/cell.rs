//! The field inside one cell, and its exact integral along a piece of a ray.
//!
//! Coordinates are *cell coordinates*: `u = index + support`, so that cell `c` spans `[c, c+1)` on each axis, the
//! first cell is 0, and the field on it depends on the `TAPS` voxels `c - (TAPS-1) ..= c`. `box` has
//! cells centred on voxels, `tent` and `bspline3` cells between voxel centres.

use crate::view::IndexRay;

/// A piece of a ray inside one cell: local position at parameter 0, change per unit of the parameter, and the
/// parameters of both ends. `local + t * step` runs over `[0, 1]` on each axis within the cell.
pub(crate) struct Piece {
    pub local: [f64; 3],
    pub step: [f64; 3],
    pub from: f64,
    pub to: f64,
}

impl Piece {
    #[inline(always)]
    fn middle(&self) -> (f64, f64) {
        (0.5 * (self.from + self.to), 0.5 * (self.to - self.from))
    }

    #[inline(always)]
    fn at(&self, t: f64) -> [f64; 3] {
        [self.local[0] + t * self.step[0], self.local[1] + t * self.step[1], self.local[2] + t * self.step[2]]
    }

    /// `∫ f dt`, or `∫ f t² dt` when `SQUARED`, by a Gauss-Legendre rule given by its positive nodes.
    #[inline(always)]
    fn gauss<const SQUARED: bool>(&self, centre: f64, nodes: &[(f64, f64)], mut f: impl FnMut([f64; 3]) -> f64) -> f64 {
        let (m, h) = self.middle();
        let mut at = |t: f64| if SQUARED { t * t * f(self.at(t)) } else { f(self.at(t)) };
        let mut sum = if centre > 0.0 { centre * at(m) } else { 0.0 };
        for &(x, w) in nodes {
            sum += w * (at(m - h * x) + at(m + h * x));
        }
        sum * h
    }
}

// Gauss-Legendre on [-1, 1]: (node, weight) of the positive nodes; centre weights apart.
const GAUSS_2: [(f64, f64); 1] = [(0.577_350_269_189_625_8, 1.0)];
const GAUSS_3: [(f64, f64); 1] = [(0.774_596_669_241_483_4, 5.0 / 9.0)];
const GAUSS_3_CENTRE: f64 = 8.0 / 9.0;
const GAUSS_5: [(f64, f64); 2] =
    [(0.538_469_310_105_683_1, 0.478_628_670_499_366_47), (0.906_179_845_938_664, 0.236_926_885_056_189_08)];
const GAUSS_5_CENTRE: f64 = 128.0 / 225.0;
const GAUSS_6: [(f64, f64); 3] = [
    (0.238_619_186_083_196_9, 0.467_913_934_572_691_04),
    (0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
    (0.932_469_514_203_152, 0.171_324_492_379_170_36),
];

/// A separable kernel, as a polynomial on each cell.
pub(crate) trait CellKernel: Send + Sync + 'static {
    /// Voxels per axis on which a cell depends.
    const TAPS: usize;

    /// The weights of a cell, `[z][y][x]` with x fastest.
    type Weights;

    /// Gathers the weights; `read(a, b, c)` gives voxel `c - (TAPS-1) + (a, b, c)`, x first.
    fn gather(read: impl FnMut(usize, usize, usize) -> f64) -> Self::Weights;

    /// Field evaluations per cell.
    fn points(squared: bool) -> u64;

    /// `∫ ρ dt`, or `∫ ρ t² dt` when `SQUARED`, over the piece; exact up to rounding.
    fn integrate<const SQUARED: bool>(weights: &Self::Weights, piece: &Piece) -> f64;
}

/// Nearest neighbour: degree 0 (Siddon 1985).
pub(crate) struct BoxCell;

impl CellKernel for BoxCell {
    const TAPS: usize = 1;
    type Weights = f64;

    #[inline(always)]
    fn gather(mut read: impl FnMut(usize, usize, usize) -> f64) -> f64 {
        read(0, 0, 0)
    }

    fn points(_: bool) -> u64 {
        1
    }

    #[inline(always)]
    fn integrate<const SQUARED: bool>(&weight: &f64, piece: &Piece) -> f64 {
        let (m, h) = piece.middle();
        // ∫ t² over [m-h, m+h] without the cancellation of a difference of cubes.
        weight * 2.0 * h * if SQUARED { m * m + h * h * (1.0 / 3.0) } else { 1.0 }
    }
}

/// Trilinear: degree 3 along a ray.
pub(crate) struct TentCell;

impl CellKernel for TentCell {
    const TAPS: usize = 2;
    type Weights = [f64; 8];

    #[inline(always)]
    fn gather(mut read: impl FnMut(usize, usize, usize) -> f64) -> [f64; 8] {
        [
            read(0, 0, 0),
            read(1, 0, 0),
            read(0, 1, 0),
            read(1, 1, 0),
            read(0, 0, 1),
            read(1, 0, 1),
            read(0, 1, 1),
            read(1, 1, 1),
        ]
    }

    fn points(squared: bool) -> u64 {
        if squared { 3 } else { 2 }
    }

    #[inline(always)]
    fn integrate<const SQUARED: bool>(w: &[f64; 8], piece: &Piece) -> f64 {
        // The differences along x are shared by the Gauss points.
        let slope = [w[1] - w[0], w[3] - w[2], w[5] - w[4], w[7] - w[6]];
        let f = |[x, y, z]: [f64; 3]| {
            let a = w[0] + x * slope[0];
            let b = w[2] + x * slope[1];
            let c = w[4] + x * slope[2];
            let d = w[6] + x * slope[3];
            let p = a + y * (b - a);
            let q = c + y * (d - c);
            p + z * (q - p)
        };
        if SQUARED { piece.gauss::<true>(GAUSS_3_CENTRE, &GAUSS_3, f) } else { piece.gauss::<false>(0.0, &GAUSS_2, f) }
    }
}

/// Cubic B-spline: degree 9 along a ray.
pub(crate) struct SplineCell;

/// The four cubic B-spline weights at local position `x` in [0, 1]: of the voxels 2 − x … −1 − x away.
#[inline(always)]
pub(crate) fn spline_weights(x: f64) -> [f64; 4] {
    let y = 1.0 - x;
    let (x2, y2) = (x * x, y * y);
    [y2 * y * (1.0 / 6.0), 2.0 / 3.0 - x2 + 0.5 * x2 * x, 2.0 / 3.0 - y2 + 0.5 * y2 * y, x2 * x * (1.0 / 6.0)]
}

impl CellKernel for SplineCell {
    const TAPS: usize = 4;
    type Weights = [f64; 64];

    #[inline(always)]
    fn gather(mut read: impl FnMut(usize, usize, usize) -> f64) -> [f64; 64] {
        let mut w = [0.0; 64];
        for c in 0..4 {
            for b in 0..4 {
                for a in 0..4 {
                    w[16 * c + 4 * b + a] = read(a, b, c);
                }
            }
        }
        w
    }

    fn points(squared: bool) -> u64 {
        if squared { 6 } else { 5 }
    }

    #[inline(always)]
    fn integrate<const SQUARED: bool>(w: &[f64; 64], piece: &Piece) -> f64 {
        let f = |[x, y, z]: [f64; 3]| {
            let (wx, wy, wz) = (spline_weights(x), spline_weights(y), spline_weights(z));
            // z, then y, then x: the first two contract whole rows, which the compiler turns into vector code.
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
        };
        if SQUARED { piece.gauss::<true>(0.0, &GAUSS_6, f) } else { piece.gauss::<false>(GAUSS_5_CENTRE, &GAUSS_5, f) }
    }
}

/// Local coordinates of a ray in the cell with the given index.
#[inline(always)]
pub(crate) fn local(ray: &IndexRay, cell: [i32; 3]) -> [f64; 3] {
    std::array::from_fn(|a| ray.origin[a] - f64::from(cell[a]))
}
