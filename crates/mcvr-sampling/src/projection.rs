//! A camera and a kernel made ready for samples: matrices in voxel coordinates, the precision they allow, fixed-point scales.

use glam::{DMat3, DVec3};
use mcvr_scene::{Camera, Estimand, Kernel};
use mcvr_volume::Grid;
use serde::Serialize;

use crate::SamplingError;
use crate::project::{Params, centre_voxel};
use crate::real::Real;

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
}

fn quadratic(c: &[f64; 6], x: f64, y: f64) -> f64 {
    c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_scene::{Extent, View};

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
}
