//! From voxel coordinates and uniforms to pixels: kernel offset, projection, `line` weight. Vectorised.

use glam::{DMat3, DVec3};
use mcvr_scene::{Camera, Estimand, Kernel};
use mcvr_volume::Grid;
use serde::Serialize;

use crate::SamplingError;
use crate::offset::{BoxOffset, BsplineOffset, Offset, ShellOffset, TentOffset};
#[cfg(target_arch = "x86_64")]
use crate::project512::project_tent;
use crate::real::{Real, Weights};
use mcvr_volume::{SimdLevel, vectorised};

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

/// Units of fixed point that the faintest sample must weigh at least: rounding is then at most 1/128 of it, either way.
pub(crate) const LEAST_UNITS: f64 = 64.0;

/// Bound on the error of a kernel's offset in 32 bits, in voxels: a few roundings (the tests of [`crate::offset`] hold them to
/// 8), but for the shell, whose radius is the root of a difference of at least 2^-22 from 1 that errs by 2^-24.
fn offset_error(kernel: Kernel) -> f64 {
    match kernel {
        Kernel::Box | Kernel::Tent | Kernel::Bspline3 => 8.0 * f64::from(f32::EPSILON),
        Kernel::Shell => 0.5f64.powi(14),
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
    pub(crate) centre: [i32; 3],
    pub(crate) rows: [[R; 3]; 3],
    pub(crate) shift: [R; 3],
    pub(crate) near: R,
    pub(crate) width: R,
    pub(crate) height: R,
    pub(crate) stride: i32,
    /// Pixel index of samples that miss the image; the next one counts samples in front of the near plane.
    pub(crate) miss: i32,
    pub(crate) middle: [R; 2],
    /// `|M⁻¹ (px, py, 1)|²` about the middle of the image: 1, x, y, x², xy, y².
    pub(crate) stretch: [R; 6],
    /// Fixed-point factor of the weight.
    pub(crate) scale: R,
    pub(crate) largest: R,
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
    /// Bound from below on the weight of a sample inside the image, over the largest.
    faintest: f64,
    /// Largest depth of a sample, mm.
    farthest: f64,
    samples: u64,
    bits: u32,
}

impl Projection {
    /// Sets up the projection of `samples` samples on a grid under a kernel.
    pub(crate) fn new(
        grid: &Grid,
        camera: &Camera,
        kernel: Kernel,
        samples: u64,
        force: Option<Precision>,
    ) -> Result<Self, SamplingError> {
        let dims = grid.dims();
        if dims.iter().any(|&n| n >= 1 << 31) {
            return Err(SamplingError::Camera(format!("extents {dims:?} exceed 2^31 - 1 voxels along an axis")));
        }
        let centre = centre_voxel(dims);
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
        // A ray gains at least 1 mm of way per mm of depth, so no stretch is below 1.
        let farthest = if perspective { shift[2] + span(2) } else { 1.0 };
        let faintest = 1.0 / (farthest * farthest) / largest_weight;

        // Forward error of three products and sums, then the quotient: |q| and w each err by at most
        // 4 eps (|shift| + span), a pixel position p = q / w by (err_q + |p| err_w) / w + eps |p|.
        let eps = f64::from(f32::EPSILON);
        let offset = offset_error(kernel);
        let err = |r: usize| {
            let per_voxel: f64 = matrix[r].iter().map(|m| m.abs()).sum();
            4.0 * eps * (shift[r].abs() + span(r)) + offset * per_voxel
        };
        let pixel_error =
            ((err(0).max(err(1)) + w.max(h) * if perspective { err(2) } else { 0.0 }) / nearest) + eps * w.max(h);
        let spread = if perspective { ((shift[2] + span(2)) / nearest).powi(2) } else { 1.0 };
        let exact_integers = dims.iter().all(|&n| n < 1 << 23) && w.max(h) < f64::from(1 << 20);
        let resolved = f64::from(1u32 << f32::FIXED_BITS) * faintest >= 64.0 * LEAST_UNITS;
        let fits = pixel_error <= Precision::LIMIT && spread <= 64.0 && exact_integers && resolved;
        let precision = force.unwrap_or(if fits { Precision::F32 } else { Precision::F64 });
        let cap = match precision {
            Precision::F32 => f32::FIXED_BITS,
            Precision::F64 => f64::FIXED_BITS,
        };
        // Sums of `samples` weights below 2^bits stay below 2^63.
        let bits = cap.min(62 - (u64::BITS - samples.leading_zeros()));
        Ok(Self {
            precision,
            matrix,
            shift,
            centre,
            near,
            extent,
            stretch,
            largest_weight,
            faintest,
            farthest,
            samples,
            bits,
        })
    }

    /// The least that a sample inside the image can weigh, in units of fixed point; under `count` all weigh the same.
    pub(crate) fn faintest_units(&self, estimand: Estimand) -> f64 {
        let whole = 2f64.powi(self.bits as i32);
        if estimand == Estimand::Line { whole * self.faintest } else { whole }
    }

    /// Refuses near planes so close that the weights of most samples would be lost to rounding.
    pub(crate) fn check(&self, estimand: Estimand) -> Result<(), SamplingError> {
        if self.faintest_units(estimand) >= LEAST_UNITS {
            return Ok(());
        }
        // Weights grow as the reciprocal square of the near plane; the root of the stretch comes with it.
        let stretch = (self.largest_weight * self.near * self.near).max(1.0);
        let stretch = if stretch.is_finite() { stretch } else { quadratic(&self.stretch, 0.0, 0.0).sqrt() };
        let least = self.farthest * (LEAST_UNITS * stretch / 2f64.powi(self.bits as i32)).sqrt();
        Err(SamplingError::Camera(format!(
            "near plane at {:e} mm: line weights grow as the reciprocal square of the depth, and from there to {:.3} mm they \
             differ by more than {} bits of fixed point hold for {} samples; use a near plane of at least {least:.2e} mm, \
             or the estimand count",
            self.near, self.farthest, self.bits, self.samples
        )))
    }

    pub(crate) fn precision(&self) -> Precision {
        self.precision
    }

    /// Value of one unit of a fixed-point weight: `|M⁻¹(px, py, 1)| / z²` per unit.
    pub(crate) fn weight_unit(&self) -> f64 {
        self.largest_weight / (1u64 << self.bits) as f64
    }

    /// Bits of a fixed-point weight.
    pub(crate) fn weight_bits(&self) -> u32 {
        self.bits
    }

    /// The matrix and the shift that take voxels from the grid's first voxel.
    pub(crate) fn for_first_voxel(&self) -> ([[f64; 3]; 3], [f64; 3]) {
        let mut shift = self.shift;
        for (shift, row) in shift.iter_mut().zip(&self.matrix) {
            for (m, c) in row.iter().zip(self.centre) {
                *shift -= m * f64::from(c);
            }
        }
        (self.matrix, shift)
    }

    pub(crate) fn params<R: Real>(&self) -> Params<R> {
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
        #[cfg(target_arch = "x86_64")]
        if level == SimdLevel::Avx512 && kernel == Kernel::Tent && !R::DOUBLE {
            return Box::new(Tent512::<E> { params: self.params(), kind: Default::default() });
        }
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

/// The `tent` kernel in 32 bits on AVX-512.
#[cfg(target_arch = "x86_64")]
struct Tent512<E> {
    params: Params<f32>,
    kind: std::marker::PhantomData<E>,
}

#[cfg(target_arch = "x86_64")]
impl<E: Weigh> Project for Tent512<E> {
    fn project(
        &self,
        places: &[Vec<u32>; 3],
        uniforms: &[Vec<u32>; 3],
        pixels: &mut [u32],
        weights: &mut Weights,
    ) -> Lost {
        let weights = f32::slot(weights);
        weights.resize(if E::LINE { pixels.len() } else { 0 }, 0);
        let ([x, y, z], [u, v, w]) = (places, uniforms);
        // SAFETY: only made for the level of AVX-512, which is only ever chosen on processors that have it.
        unsafe { project_tent::<E>(&self.params, [x, y, z], [u, v, w], pixels, weights) }
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
    let (places, uniforms) = (places.map(|s| &s[..n]), uniforms.map(|s| &s[..n]));
    let weights = if E::LINE { &mut weights[..n] } else { weights };
    let mut lost = Lost::default();
    for i in 0..n {
        let x = position::<R, K>(
            p.centre,
            [places[0][i], places[1][i], places[2][i]],
            [uniforms[0][i], uniforms[1][i], uniforms[2][i]],
        );
        let landed = land::<R, E>(p, x);
        pixels[i] = landed.pixel;
        lost.beside += u32::from(landed.ahead & !landed.inside);
        lost.near += u32::from(!landed.ahead);
        if E::LINE {
            weights[i] = landed.weight;
        }
    }
    lost
}

/// Where a sample lies, in voxels from the grid's centre voxel.
#[inline(always)]
pub(crate) fn position<R: Real, K: Offset>(centre: [i32; 3], place: [u32; 3], words: [u32; 3]) -> [R; 3] {
    let t = K::offset::<R>(words);
    [
        R::from_i32(place[0] as i32 - centre[0]) + t[0],
        R::from_i32(place[1] as i32 - centre[1]) + t[1],
        R::from_i32(place[2] as i32 - centre[2]) + t[2],
    ]
}

/// What becomes of one sample.
pub(crate) struct Landed<F> {
    pub pixel: u32,
    pub weight: F,
    pub ahead: bool,
    pub inside: bool,
}

/// Projects a sample that lies at `x`, in voxels from the grid's centre voxel: the one projection of all images.
#[inline(always)]
pub(crate) fn land<R: Real, E: Weigh>(p: &Params<R>, x: [R; 3]) -> Landed<R::Fixed> {
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
    let pixel = if inside { index } else { other } as u32;
    if !E::LINE {
        return Landed { pixel, weight: R::Fixed::default(), ahead, inside };
    }
    let (dx, dy) = (px - p.middle[0], py - p.middle[1]);
    let s = &p.stretch;
    let q = s[0] + dx * (s[1] + dx * s[3] + dy * s[4]) + dy * (s[2] + dy * s[5]);
    let g = q.sqrt() * (inverse * inverse) * p.scale;
    let bounded = if g < p.largest { g } else { p.largest };
    let weight = if inside & (bounded >= zero) { bounded } else { zero };
    // SAFETY: 0 outside the image, and inside it at least 0 (NaN compares false) and at most `largest`.
    Landed { pixel, weight: unsafe { weight.to_fixed() }, ahead, inside }
}

/// The voxel from which positions are counted, so that they are small in 32 bits.
pub(crate) fn centre_voxel(dims: [usize; 3]) -> [i32; 3] {
    dims.map(|n| (n as i32 - 1) / 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::offset::tests::words;
    use mcvr_scene::{Extent, View};

    #[test]
    fn every_level_gives_the_same_bits_for_every_kernel_estimand_and_precision() {
        let grid = Grid::with_spacing([30, 20, 10], [1.0, 1.5, 2.0]).expect("a grid");
        let view = View { near: Some(105.0), fov: Some(8.0), ..View::default() };
        let camera = Camera::look(&view, &grid, Extent::new(37, 23).expect("a size")).expect("a camera");
        let words = words();
        let column = |a: usize| words.iter().map(|w| w[a]).collect::<Vec<_>>();
        let uniforms = [column(0), column(1), column(2)];
        let places = [column(1), column(2), column(0)].map(|c| c.iter().map(|w| w % 10).collect::<Vec<_>>());
        for kernel in Kernel::ALL {
            for estimand in Estimand::ALL {
                for precision in [Precision::F32, Precision::F64] {
                    let projection = Projection::new(&grid, &camera, kernel, 1 << 20, Some(precision)).expect("ok");
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

    /// The proof that pixel sums hold: whatever the number of samples and the precision, all of them with the largest weight in one
    /// pixel stay below 2^63; and so do the amounts of effects, which are weights times factors up to 1.
    #[test]
    fn no_number_of_samples_overflows_a_sum_of_weights() {
        let grid = Grid::with_spacing([30, 20, 10], [1.0, 1.5, 2.0]).expect("a grid");
        let camera = Camera::look(&View::default(), &grid, Extent::new(64, 48).expect("a size")).expect("a camera");
        for exponent in 0..=40u32 {
            for samples in [(1u64 << exponent) - 1, 1 << exponent, (1 << exponent) + 1] {
                if !(1..=crate::stream::MAX_SAMPLES).contains(&samples) {
                    continue;
                }
                for precision in [Precision::F32, Precision::F64] {
                    let p = Projection::new(&grid, &camera, Kernel::Tent, samples, Some(precision)).expect("ok");
                    assert!(u128::from(samples) << p.weight_bits() < 1 << 63, "{samples} {precision:?}");
                    assert!(p.weight_bits() >= 21, "{samples} {precision:?}");
                }
            }
        }
    }

    #[test]
    fn weights_are_the_cameras_line_factors() {
        let grid = Grid::with_spacing([30, 20, 10], [1.0, 1.5, 2.0]).expect("a grid");
        for parallel in [false, true] {
            let view = View { parallel, distance: Some(60.0), ..View::default() };
            let camera = Camera::look(&view, &grid, Extent::new(64, 48).expect("a size")).expect("a camera");
            let projection = Projection::new(&grid, &camera, Kernel::Box, 1 << 20, None).expect("a projection");
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
                let (px, py, z) = camera.project(grid.index_to_world().transform_point3(index));
                assert_eq!(pixels[i] as usize, py as usize * 64 + px as usize);
                let weight = f64::from(weights.narrow[i]) * projection.weight_unit() * camera.det();
                let exact = camera.line_factor(px, py, z);
                assert!((weight / exact - 1.0).abs() < 1e-5, "{weight} {exact}");
            }
        }
    }
}
