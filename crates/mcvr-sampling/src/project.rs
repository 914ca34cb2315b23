//! From voxel coordinates and uniforms to pixels: kernel offset, projection, `line` weight. Vectorised.

use glam::{DMat3, DVec3};
use mcvr_scene::{Camera, Density, Estimand, Kernel};
use serde::Serialize;

use crate::SamplingError;
use crate::simd::{SimdLevel, vectorised};

/// Arithmetic of the projection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32-bit floats: wherever the rounding of a pixel position is below [`Precision::LIMIT`].
    F32,
    /// 64-bit floats.
    F64,
}

impl Precision {
    /// Largest rounding error of a pixel position, in pixels, that 32-bit arithmetic may make.
    pub const LIMIT: f64 = 1.0 / 64.0;
}

/// A floating-point type of the vector code.
pub(crate) trait Real:
    Copy
    + PartialOrd
    + Send
    + Sync
    + std::ops::Add<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::Div<Output = Self>
    + std::ops::Neg<Output = Self>
{
    fn lit(v: f64) -> Self;
    fn from_i32(v: i32) -> Self;
    /// Uniform in (0, 1) from 32 bits, symmetric about 1/2.
    fn uniform(word: u32) -> Self;
    fn sqrt(self) -> Self;
    /// Truncation.
    ///
    /// # Safety
    /// The value must lie in 0..2^31.
    unsafe fn to_i32(self) -> i32;
    /// Nearest integer.
    ///
    /// # Safety
    /// The value must lie in 0..=2^FIXED_BITS.
    unsafe fn to_fixed(self) -> Self::Fixed;
    /// The batch's weights of this type.
    fn slot(weights: &mut Weights) -> &mut Vec<Self::Fixed>;
    /// Integer that holds a fixed-point weight: as narrow as possible, for the vector code's sake.
    type Fixed: Copy + Default + Send + Sync;
    /// Largest fixed-point weight, as a power of two.
    const FIXED_BITS: u32;
    /// True for 64 bits.
    const DOUBLE: bool;
}

impl Real for f32 {
    #[inline(always)]
    fn lit(v: f64) -> Self {
        v as f32
    }
    #[inline(always)]
    fn from_i32(v: i32) -> Self {
        v as f32
    }
    #[inline(always)]
    fn uniform(word: u32) -> Self {
        ((word >> 9) as i32 as f32 + 0.5) * (1.0 / (1 << 23) as f32)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f32::sqrt(self)
    }
    #[inline(always)]
    unsafe fn to_i32(self) -> i32 {
        // SAFETY: the caller keeps the value in range.
        unsafe { self.to_int_unchecked() }
    }
    #[inline(always)]
    unsafe fn to_fixed(self) -> u32 {
        // SAFETY: the caller keeps the value within 2^30.
        unsafe { (self + 0.5).to_int_unchecked::<i32>() as u32 }
    }
    #[inline(always)]
    fn slot(weights: &mut Weights) -> &mut Vec<u32> {
        &mut weights.narrow
    }
    type Fixed = u32;
    const FIXED_BITS: u32 = 30;
    const DOUBLE: bool = false;
}

impl Real for f64 {
    #[inline(always)]
    fn lit(v: f64) -> Self {
        v
    }
    #[inline(always)]
    fn from_i32(v: i32) -> Self {
        f64::from(v)
    }
    #[inline(always)]
    fn uniform(word: u32) -> Self {
        // i32 converts in one vector instruction, u32 does not: shift the range, then back.
        (f64::from((word ^ 0x8000_0000) as i32) + 2_147_483_648.5) * (1.0 / 4_294_967_296.0)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    unsafe fn to_i32(self) -> i32 {
        // SAFETY: the caller keeps the value in range.
        unsafe { self.to_int_unchecked() }
    }
    #[inline(always)]
    unsafe fn to_fixed(self) -> u64 {
        const MAGIC: f64 = (1u64 << 52) as f64;
        (self + MAGIC).to_bits() & ((1 << 52) - 1)
    }
    #[inline(always)]
    fn slot(weights: &mut Weights) -> &mut Vec<u64> {
        &mut weights.wide
    }
    type Fixed = u64;
    const FIXED_BITS: u32 = 40;
    const DOUBLE: bool = true;
}

/// Fixed-point weights of a batch: of the type that the precision has, or none for `count`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weights {
    pub narrow: Vec<u32>,
    pub wide: Vec<u64>,
}

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

/// Whether samples carry the `line` weight.
pub(crate) trait Weigh: Send + Sync {
    const LINE: bool;
}
pub(crate) struct CountWeigh;
pub(crate) struct LineWeigh;
impl Weigh for CountWeigh {
    const LINE: bool = false;
}
impl Weigh for LineWeigh {
    const LINE: bool = true;
}

/// A camera in voxel coordinates, ready for the vector code.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Params<R> {
    /// Voxel coordinates of the reference point, subtracted as integers.
    centre: [i32; 3],
    rows: [[R; 3]; 3],
    shift: [R; 3],
    near: R,
    width: R,
    height: R,
    stride: i32,
    /// Pixel index of samples that miss the image; the next one counts samples in front of the near plane.
    miss: i32,
    middle: [R; 2],
    /// `|M⁻¹ (px, py, 1)|²` about the middle of the image: 1, x, y, x², xy, y².
    stretch: [R; 6],
    /// Fixed-point factor of the weight.
    scale: R,
    largest: R,
}

/// What does not depend on the precision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Projection {
    precision: Precision,
    matrix: [[f64; 3]; 3],
    shift: [f64; 3],
    centre: [i32; 3],
    near: f64,
    extent: mcvr_scene::Extent,
    stretch: [f64; 6],
    /// Largest weight `|M⁻¹(px, py, 1)| / z²` that a sample inside the image can have.
    largest_weight: f64,
    bits: u32,
}

impl Projection {
    /// Sets up the projection of `samples` samples of a density under a kernel.
    pub(crate) fn new(
        density: &Density,
        camera: &Camera,
        kernel: Kernel,
        samples: u64,
        force: Option<Precision>,
    ) -> Result<Self, SamplingError> {
        let grid = density.volume().grid();
        let dims = grid.dims();
        if dims.iter().any(|&n| n >= 1 << 31) {
            return Err(SamplingError::Camera(format!("extents {dims:?} exceed 2^31 - 1 voxels along an axis")));
        }
        let centre = dims.map(|n| (n as i32 - 1) / 2);
        let centre_index = DVec3::from_array(centre.map(f64::from));
        let to_world = grid.index_to_world();
        let rows = camera.world_to_pixel();
        let left = DMat3::from_cols_array_2d(&rows.map(|r| [r[0], r[1], r[2]])).transpose() * to_world.matrix3;
        let middle_world = to_world.transform_point3(centre_index);
        let shift = rows.map(|r| DVec3::new(r[0], r[1], r[2]).dot(middle_world) + r[3]);
        let matrix = left.transpose().to_cols_array_2d();

        let reach: [f64; 3] = std::array::from_fn(|a| f64::from(dims[a] as u32) * 0.5 + kernel.support() + 0.5);
        let span = |r: usize| (0..3).map(|a| matrix[r][a].abs() * reach[a]).sum::<f64>();
        let perspective = !camera.is_parallel();
        let near = if perspective { camera.near() } else { 0.0 };
        let nearest = if perspective { (shift[2] - span(2)).max(near) } else { 1.0 };
        let extent = camera.extent();
        let (w, h) = (extent.width as f64, extent.height as f64);

        let inverse = camera.inverse();
        let at_middle = inverse * DVec3::new(0.5 * w, 0.5 * h, 1.0);
        let (ex, ey) = (inverse.x_axis, inverse.y_axis);
        let stretch = if perspective {
            [
                at_middle.dot(at_middle),
                2.0 * at_middle.dot(ex),
                2.0 * at_middle.dot(ey),
                ex.dot(ex),
                2.0 * ex.dot(ey),
                ey.dot(ey),
            ]
        } else {
            [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        };
        // The stretch is convex, so it is largest at a corner of the image.
        let corner = |sx: f64, sy: f64| quadratic(&stretch, sx * 0.5 * w, sy * 0.5 * h).sqrt();
        let largest =
            [(-1., -1.), (1., -1.), (-1., 1.), (1., 1.)].map(|(x, y)| corner(x, y)).into_iter().fold(0.0, f64::max);
        let largest_weight = largest / (nearest * nearest) * (1.0 + 1e-6);

        // Forward error of three products and sums, then the quotient: |q| and w each err by at most
        // 4 eps (|shift| + span), a pixel position p = q / w by (err_q + |p| err_w) / w + eps |p|.
        let eps = f64::from(f32::EPSILON);
        let err = |r: usize| 4.0 * eps * (shift[r].abs() + span(r));
        let pixel_error =
            ((err(0).max(err(1)) + w.max(h) * if perspective { err(2) } else { 0.0 }) / nearest) + eps * w.max(h);
        let spread = if perspective { ((shift[2] + span(2)) / nearest).powi(2) } else { 1.0 };
        let exact_integers = dims.iter().all(|&n| n < 1 << 23) && w.max(h) < f64::from(1 << 20);
        let fits = pixel_error <= Precision::LIMIT && spread <= 64.0 && exact_integers;
        let precision = force.unwrap_or(if fits { Precision::F32 } else { Precision::F64 });
        let cap = match precision {
            Precision::F32 => f32::FIXED_BITS,
            Precision::F64 => f64::FIXED_BITS,
        };
        // Sums of `samples` weights below 2^bits stay below 2^63.
        let bits = cap.min(62 - (u64::BITS - samples.leading_zeros()));
        Ok(Self { precision, matrix, shift, centre, near, extent, stretch, largest_weight, bits })
    }

    pub(crate) fn precision(&self) -> Precision {
        self.precision
    }

    /// Value of one unit of a fixed-point weight: `|M⁻¹(px, py, 1)| / z²` per unit.
    pub(crate) fn weight_unit(&self) -> f64 {
        self.largest_weight / (1u64 << self.bits) as f64
    }

    fn params<R: Real>(&self) -> Params<R> {
        let (w, h) = (self.extent.width, self.extent.height);
        Params {
            centre: self.centre,
            rows: self.matrix.map(|r| r.map(R::lit)),
            shift: self.shift.map(R::lit),
            near: R::lit(self.near),
            width: R::lit(w as f64),
            height: R::lit(h as f64),
            stride: w as i32,
            miss: (w * h) as i32,
            middle: [R::lit(0.5 * w as f64), R::lit(0.5 * h as f64)],
            stretch: self.stretch.map(R::lit),
            scale: R::lit((1u64 << self.bits) as f64 / self.largest_weight),
            largest: R::lit((1u64 << self.bits) as f64),
        }
    }

    /// The vector code for a kernel and an estimand, as one call per batch.
    pub(crate) fn projector(&self, kernel: Kernel, estimand: Estimand, level: SimdLevel) -> Box<dyn Project> {
        match (self.precision, estimand) {
            (Precision::F32, Estimand::Count) => self.boxed::<f32, CountWeigh>(kernel, level),
            (Precision::F32, Estimand::Line) => self.boxed::<f32, LineWeigh>(kernel, level),
            (Precision::F64, Estimand::Count) => self.boxed::<f64, CountWeigh>(kernel, level),
            (Precision::F64, Estimand::Line) => self.boxed::<f64, LineWeigh>(kernel, level),
        }
    }

    fn boxed<R: Real + 'static, E: Weigh + 'static>(&self, kernel: Kernel, level: SimdLevel) -> Box<dyn Project> {
        let params = self.params::<R>();
        match kernel {
            Kernel::Box => Box::new(Projector::<R, BoxOffset, E> { params, level, kind: Default::default() }),
            Kernel::Tent => Box::new(Projector::<R, TentOffset, E> { params, level, kind: Default::default() }),
            Kernel::Bspline3 => Box::new(Projector::<R, BsplineOffset, E> { params, level, kind: Default::default() }),
            Kernel::Shell => Box::new(Projector::<R, ShellOffset, E> { params, level, kind: Default::default() }),
        }
    }
}

fn quadratic(c: &[f64; 6], x: f64, y: f64) -> f64 {
    c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y
}

/// Samples of one batch that are in no pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Lost {
    /// Beyond the near plane but beside the image.
    pub beside: u32,
    /// In front of the near plane.
    pub near: u32,
}

/// Turns places and uniforms into pixel indices (`width * height` for a miss, one more in front of the near
/// plane) and, for `line`, fixed-point weights.
pub(crate) trait Project: Send + Sync {
    fn project(
        &self,
        places: &[Vec<u32>; 3],
        uniforms: &[Vec<u32>; 3],
        pixels: &mut [u32],
        weights: &mut Weights,
    ) -> Lost;
}

struct Projector<R, K, E> {
    params: Params<R>,
    level: SimdLevel,
    kind: std::marker::PhantomData<(K, E)>,
}

impl<R: Real, K: Offset, E: Weigh> Project for Projector<R, K, E> {
    fn project(
        &self,
        places: &[Vec<u32>; 3],
        uniforms: &[Vec<u32>; 3],
        pixels: &mut [u32],
        weights: &mut Weights,
    ) -> Lost {
        let weights = R::slot(weights);
        weights.resize(if E::LINE { pixels.len() } else { 0 }, R::Fixed::default());
        let [x, y, z] = places;
        let [u, v, w] = uniforms;
        project_batch::<R, K, E>(self.level, &self.params, [x, y, z], [u, v, w], pixels, weights)
    }
}

vectorised! {
    fn project_batch<R: Real, K: Offset, E: Weigh>(
        params: &Params<R>, places: [&[u32]; 3], uniforms: [&[u32]; 3], pixels: &mut [u32], weights: &mut [R::Fixed],
    ) -> Lost = project_body::<R, K, E>
}

#[inline(always)]
fn project_body<R: Real, K: Offset, E: Weigh>(
    p: &Params<R>,
    places: [&[u32]; 3],
    uniforms: [&[u32]; 3],
    pixels: &mut [u32],
    weights: &mut [R::Fixed],
) -> Lost {
    let n = pixels.len();
    let places = places.map(|s| &s[..n]);
    let uniforms = uniforms.map(|s| &s[..n]);
    let weights = if E::LINE { &mut weights[..n] } else { weights };
    let mut lost = Lost::default();
    for i in 0..n {
        let t = K::offset::<R>([uniforms[0][i], uniforms[1][i], uniforms[2][i]]);
        let at = |a: usize| R::from_i32(places[a][i] as i32 - p.centre[a]) + t[a];
        let x = [at(0), at(1), at(2)];
        let row = |r: usize| p.rows[r][0] * x[0] + p.rows[r][1] * x[1] + (p.rows[r][2] * x[2] + p.shift[r]);
        let depth = row(2);
        let inverse = R::lit(1.0) / depth;
        let (px, py) = (row(0) * inverse, row(1) * inverse);
        let zero = R::lit(0.0);
        let ahead = depth >= p.near;
        let inside = ahead & (px >= zero) & (px < p.width) & (py >= zero) & (py < p.height);
        let (cx, cy) = (if inside { px } else { zero }, if inside { py } else { zero });
        // SAFETY: positions inside the image are below its sides, which are below 2^30; others were set to 0.
        let index = unsafe { cy.to_i32() * p.stride + cx.to_i32() };
        let other = if ahead { p.miss } else { p.miss + 1 };
        pixels[i] = if inside { index } else { other } as u32;
        lost.beside += u32::from(ahead & !inside);
        lost.near += u32::from(!ahead);
        if E::LINE {
            let (dx, dy) = (px - p.middle[0], py - p.middle[1]);
            let s = &p.stretch;
            let q = s[0] + dx * (s[1] + dx * s[3] + dy * s[4]) + dy * (s[2] + dy * s[5]);
            let g = q.sqrt() * (inverse * inverse) * p.scale;
            let bounded = if g < p.largest { g } else { p.largest };
            let weight = if inside & (bounded >= zero) { bounded } else { zero };
            // SAFETY: 0 outside the image, and inside it at least 0 (NaN compares false) and at most `largest`.
            weights[i] = unsafe { weight.to_fixed() };
        }
    }
    lost
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_scene::{DensityMap, Extent, View};
    use mcvr_volume::{Grid, Volume};

    fn words() -> Vec<[u32; 3]> {
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

    #[test]
    fn every_level_gives_the_same_bits_for_every_kernel_estimand_and_precision() {
        let grid = Grid::with_spacing([30, 20, 10], [1.0, 1.5, 2.0]).expect("a grid");
        let volume = Volume::from_vec(grid, vec![1u8; 6000], "test").expect("a volume");
        let density = Density::new(&volume, DensityMap::default()).expect("a density");
        let view = View { near: Some(105.0), fov: Some(8.0), ..View::default() };
        let camera = Camera::look(&view, volume.grid(), Extent::new(37, 23).expect("a size")).expect("a camera");
        let words = words();
        let column = |a: usize| words.iter().map(|w| w[a]).collect::<Vec<_>>();
        let uniforms = [column(0), column(1), column(2)];
        let places = [column(1), column(2), column(0)].map(|c| c.iter().map(|w| w % 10).collect::<Vec<_>>());
        for kernel in Kernel::ALL {
            for estimand in Estimand::ALL {
                for precision in [Precision::F32, Precision::F64] {
                    let projection = Projection::new(&density, &camera, kernel, 1 << 20, Some(precision)).expect("ok");
                    let mut first = None;
                    for level in SimdLevel::available() {
                        let mut pixels = vec![0; words.len()];
                        let mut weights = Weights::default();
                        let lost = projection.projector(kernel, estimand, level).project(
                            &places,
                            &uniforms,
                            &mut pixels,
                            &mut weights,
                        );
                        assert!(lost.beside > 0 && lost.near > 0, "{lost:?}");
                        assert!(pixels.iter().any(|p| *p < 37 * 23));
                        let all = (pixels, weights.narrow, weights.wide, lost);
                        assert_eq!(
                            *first.get_or_insert_with(|| all.clone()),
                            all,
                            "{kernel} {estimand} {precision:?} {level:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn weights_are_the_cameras_line_factors() {
        let grid = Grid::with_spacing([30, 20, 10], [1.0, 1.5, 2.0]).expect("a grid");
        let volume = Volume::from_vec(grid, vec![1u8; 6000], "test").expect("a volume");
        let density = Density::new(&volume, DensityMap::default()).expect("a density");
        for parallel in [false, true] {
            let view = View { parallel, distance: Some(60.0), ..View::default() };
            let camera = Camera::look(&view, volume.grid(), Extent::new(64, 48).expect("a size")).expect("a camera");
            let projection = Projection::new(&density, &camera, Kernel::Box, 1 << 20, None).expect("a projection");
            assert_eq!(projection.precision(), Precision::F32);
            let places = [vec![3, 29, 0], vec![4, 19, 0], vec![5, 9, 0]];
            let middle = vec![1u32 << 31; 3];
            let (mut pixels, mut weights) = (vec![0; 3], Weights::default());
            projection.projector(Kernel::Box, Estimand::Line, SimdLevel::detect()).project(
                &places,
                &[middle.clone(), middle.clone(), middle],
                &mut pixels,
                &mut weights,
            );
            for i in 0..3 {
                let index = DVec3::new(f64::from(places[0][i]), f64::from(places[1][i]), f64::from(places[2][i]));
                let (px, py, z) = camera.project(volume.grid().index_to_world().transform_point3(index));
                assert_eq!(pixels[i] as usize, py as usize * 64 + px as usize);
                let weight = f64::from(weights.narrow[i]) * projection.weight_unit() * camera.det();
                let exact = camera.line_factor(px, py, z);
                assert!((weight / exact - 1.0).abs() < 1e-5, "{weight} {exact}");
            }
        }
    }
}
