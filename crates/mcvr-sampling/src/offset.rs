//! Kernel offsets from uniforms, vectorised: the maps of [`Kernel::offset`](mcvr_scene::Kernel::offset).

use crate::real::Real;

/// A kernel's map from uniforms to offsets, in voxels. Each agrees with [`Kernel::offset`].
pub(crate) trait Offset: Send + Sync {
    fn offset<R: Real>(words: [u32; 3]) -> [R; 3];
}

pub(crate) struct BoxOffset;
pub(crate) struct TentOffset;
pub(crate) struct BsplineOffset;
pub(crate) struct ShellOffset;

impl Offset for BoxOffset {
    #[inline(always)]
    fn offset<R: Real>(words: [u32; 3]) -> [R; 3] {
        let half = R::lit(0.5);
        [R::uniform(words[0]) - half, R::uniform(words[1]) - half, R::uniform(words[2]) - half]
    }
}

// Written without closures and `array::map`: the compiler does not always inline those into the vector loop,
// and a call in it costs the vectorisation.

/// `min(u, 1 - u)` and whether u is below one half.
#[inline(always)]
fn fold<R: Real>(word: u32) -> (R, bool) {
    let u = R::uniform(word);
    let v = R::lit(1.0) - u;
    (if u < v { u } else { v }, u < v)
}

#[inline(always)]
fn tent<R: Real>(word: u32) -> R {
    let (s, below) = fold::<R>(word);
    let t = (s + s).sqrt() - R::lit(1.0);
    if below { t } else { -t }
}

impl Offset for TentOffset {
    #[inline(always)]
    fn offset<R: Real>(words: [u32; 3]) -> [R; 3] {
        [tent(words[0]), tent(words[1]), tent(words[2])]
    }
}

/// One step of Newton's method for `2τ/3 - τ³/3 + τ⁴/8 = v`.
#[inline(always)]
fn bspline_newton<R: Real>(x: R, v: R) -> R {
    let g = x * (R::lit(2.0 / 3.0) - x * x * (R::lit(1.0 / 3.0) - x * R::lit(0.125)));
    let density = R::lit(2.0 / 3.0) - x * x * (R::lit(1.0) - R::lit(0.5) * x);
    x - (g - v) / density
}

#[inline(always)]
fn bspline<R: Real>(word: u32) -> R {
    let (s, below) = fold::<R>(word);
    let tail = (s * R::lit(24.0)).sqrt().sqrt() - R::lit(2.0);
    // Between: t = -τ where v(τ) = 2τ/3 - τ³/3 + τ⁴/8 equals 1/2 - s. A fitted polynomial starts within 5.4e-3,
    // Newton's method squares the error: 4.3e-5, 2.7e-9, rounding.
    let v = R::lit(0.5) - s;
    let start = R::lit(-19.61483942323312) + v * R::lit(30.927322508881463);
    let x = v * (R::lit(1.215587183876798) + v * (R::lit(4.57589915587964) + v * start));
    let x = bspline_newton(bspline_newton(x, v), v);
    let inner = -(if R::DOUBLE { bspline_newton(x, v) } else { x });
    let t = if s < R::lit(1.0 / 24.0) { tail } else { inner };
    if below { t } else { -t }
}

impl Offset for BsplineOffset {
    #[inline(always)]
    fn offset<R: Real>(words: [u32; 3]) -> [R; 3] {
        [bspline(words[0]), bspline(words[1]), bspline(words[2])]
    }
}

/// A polynomial by Horner's rule.
#[inline(always)]
fn series<R: Real>(x: R, c: [f64; 7]) -> R {
    let mut sum = R::lit(c[6]);
    for k in (0..6).rev() {
        sum = sum * x + R::lit(c[k]);
    }
    sum
}

impl Offset for ShellOffset {
    #[inline(always)]
    fn offset<R: Real>(words: [u32; 3]) -> [R; 3] {
        let z = R::uniform(words[0]) + R::uniform(words[0]) - R::lit(1.0);
        let r = (R::lit(1.0) - z * z).sqrt() * R::lit(0.5);
        // Angle 2πu in quadrants: u = (q + f) / 4 with f in [-1/2, 1/2], from the word's bits exactly.
        let shifted = words[1].wrapping_add(1 << 29);
        let quadrant = shifted >> 30;
        let f = R::uniform(shifted << 2) - R::lit(0.5);
        let a = f * R::lit(std::f64::consts::FRAC_PI_2);
        let a2 = a * a;
        // Taylor polynomials on |a| ≤ π/4: remainders below (π/4)^15 / 15! < 3e-14 and (π/4)^16 / 16! < 2e-15.
        let sin = a * series(
            a2,
            [1.0, -1. / 6., 1. / 120., -1. / 5040., 1. / 362_880., -1. / 39_916_800., 1. / 6_227_020_800.],
        );
        let cos = R::lit(1.0)
            + a2 * series(
                a2,
                [
                    -1. / 2.,
                    1. / 24.,
                    -1. / 720.,
                    1. / 40_320.,
                    -1. / 3_628_800.,
                    1. / 479_001_600.,
                    -1. / 87_178_291_200.,
                ],
            );
        let (c, s) = if quadrant & 1 == 0 { (cos, sin) } else { (-sin, cos) };
        let (c, s) = if quadrant & 2 == 0 { (c, s) } else { (-c, -s) };
        [r * c, r * s, z * R::lit(0.5)]
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use mcvr_scene::Kernel;

    pub(crate) fn words() -> Vec<[u32; 3]> {
        let mut words: Vec<[u32; 3]> = (0..5000u32)
            .map(|i| [1, 2, 3].map(|k| i.wrapping_mul(0x9e37_79b9).wrapping_mul(k).rotate_left(k)))
            .collect();
        let ends = [
            0,
            1,
            511,
            512,
            u32::MAX,
            u32::MAX - 1,
            1 << 31,
            (1 << 31) - 1,
            1 << 30,
            3 << 30,
            178_956_970,
            178_956_971,
        ];
        words.extend(ends.map(|w| [w; 3]));
        words
    }

    fn worst<K: Offset, R: Real + Into<f64>>(kernel: Kernel) -> f64 {
        let bits = if R::DOUBLE { 32 } else { 23 };
        let uniform = |w: u32| ((w >> (32 - bits)) as f64 + 0.5) / 2f64.powi(bits);
        words().into_iter().fold(0.0, |worst, w| {
            let fast = K::offset::<R>(w).map(Into::into);
            // The shell's angle keeps two bits more, as its quadrant is taken off first.
            let u = if kernel == Kernel::Shell && !R::DOUBLE {
                let shifted = w[1].wrapping_add(1 << 29);
                let f = (f64::from(shifted << 2 >> 9) + 0.5) / 2f64.powi(23) - 0.5;
                [uniform(w[0]), (f64::from(shifted >> 30) + f) / 4.0, 0.5]
            } else if kernel == Kernel::Shell {
                let shifted = w[1].wrapping_add(1 << 29);
                let f = (f64::from(shifted << 2) + 0.5) / 2f64.powi(32) - 0.5;
                [uniform(w[0]), (f64::from(shifted >> 30) + f) / 4.0, 0.5]
            } else {
                w.map(uniform)
            };
            let exact = kernel.offset(u);
            (0..3).fold(worst, |worst: f64, a| worst.max((fast[a] - exact[a]).abs()))
        })
    }

    #[test]
    fn vector_offsets_agree_with_the_scalar_kernels() {
        // Bounds: a few roundings of numbers up to 2, times the condition of a fourth root near 0 (at most
        // 1/2 of the relative rounding of its argument).
        let (single, double) = (8.0 * f64::from(f32::EPSILON), 64.0 * f64::EPSILON);
        assert!(worst::<BoxOffset, f32>(Kernel::Box) < single && worst::<BoxOffset, f64>(Kernel::Box) < double);
        assert!(worst::<TentOffset, f32>(Kernel::Tent) < single && worst::<TentOffset, f64>(Kernel::Tent) < double);
        let (s, d) = (worst::<BsplineOffset, f32>(Kernel::Bspline3), worst::<BsplineOffset, f64>(Kernel::Bspline3));
        assert!(s < single && d < double, "{s} {d}");
        // The shell's radius is a square root of a difference from 1: error up to the root of the rounding,
        // but only where the radius itself is as small. Taylor remainders are below 3e-14.
        let (s, d) = (worst::<ShellOffset, f32>(Kernel::Shell), worst::<ShellOffset, f64>(Kernel::Shell));
        assert!(s < f64::from(f32::EPSILON).sqrt() && d < f64::EPSILON.sqrt(), "{s} {d}");
    }
}
