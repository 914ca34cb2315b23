//! Sums of ellipsoids: the 3-D Shepp-Logan head and a small set for tests, with closed-form line integrals.

use glam::{DMat3, DVec3};

use super::unit;

/// A solid ellipsoid: `amplitude` where `|inverse · (x − centre)| ≤ 1`, 0 elsewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipsoid {
    /// Value that it adds inside, in isovalues; may be negative.
    pub amplitude: f64,
    /// Its centre (mm).
    pub centre: DVec3,
    /// The map that takes it, moved to the origin, to the unit ball (1/mm).
    pub inverse: DMat3,
}

impl Ellipsoid {
    /// From the columns of the usual tables: semi-axes, centre, and rotation about z in degrees.
    fn from_table([amplitude, a, b, c, x, y, z, degrees]: [f64; 8]) -> Self {
        let turn = DMat3::from_rotation_z(-degrees.to_radians());
        let inverse = DMat3::from_diagonal(DVec3::new(1.0 / a, 1.0 / b, 1.0 / c)) * turn;
        Self { amplitude, centre: DVec3::new(x, y, z), inverse }
    }

    /// The same ellipsoid with every coordinate multiplied by `factor`.
    pub(super) fn scaled(self, factor: DVec3) -> Self {
        Self { centre: self.centre * factor, inverse: self.inverse * DMat3::from_diagonal(factor.recip()), ..self }
    }

    /// Integral of the ellipsoid along the whole line through `origin` with unit vector `direction`
    /// (isovalue times mm).
    pub fn line_integral(&self, origin: DVec3, direction: DVec3) -> f64 {
        let (o, d) = (self.inverse * (origin - self.centre), self.inverse * direction);
        let (a, b, c) = (d.dot(d), d.dot(o), o.dot(o) - 1.0);
        let discriminant = b * b - a * c;
        if discriminant <= 0.0 { 0.0 } else { self.amplitude * 2.0 * discriminant.sqrt() / a }
    }

    /// Its volume times its amplitude (isovalue times mm³).
    pub fn mass(&self) -> f64 {
        self.amplitude * 4.0 / 3.0 * std::f64::consts::PI / self.inverse.determinant().abs()
    }
}

/// Stored value of Shepp-Logan's 1.0.
const SHEPP_LOGAN_ONE: f64 = 10_000.0;

/// The modified 3-D Shepp-Logan head. Contrast: P. Toft, *The Radon Transform* (1996), table B.3; extent along z:
/// M. Schabel's 3-D extension of A. Kak and M. Slaney, *Principles of Computerized Tomographic Imaging*, table 3.1.
/// Columns: amplitude, semi-axes, centre (halves of a side), rotation about z (degrees).
pub(super) fn shepp_logan() -> Vec<Ellipsoid> {
    const TABLE: [[f64; 8]; 10] = [
        [1.0, 0.6900, 0.920, 0.810, 0.0, 0.0, 0.0, 0.0],
        [-0.8, 0.6624, 0.874, 0.780, 0.0, -0.0184, 0.0, 0.0],
        [-0.2, 0.1100, 0.310, 0.220, 0.22, 0.0, 0.0, -18.0],
        [-0.2, 0.1600, 0.410, 0.280, -0.22, 0.0, 0.0, 18.0],
        [0.1, 0.2100, 0.250, 0.410, 0.0, 0.35, -0.15, 0.0],
        [0.1, 0.0460, 0.046, 0.050, 0.0, 0.1, 0.25, 0.0],
        [0.1, 0.0460, 0.046, 0.050, 0.0, -0.1, 0.25, 0.0],
        [0.1, 0.0460, 0.023, 0.050, -0.08, -0.605, 0.0, 0.0],
        [0.1, 0.0230, 0.023, 0.020, 0.0, -0.606, 0.0, 0.0],
        [0.1, 0.0230, 0.046, 0.020, 0.06, -0.605, 0.0, 0.0],
    ];
    TABLE.iter().map(|row| Ellipsoid { amplitude: row[0] * SHEPP_LOGAN_ONE, ..Ellipsoid::from_table(*row) }).collect()
}

/// The phantom `ellipsoids`: three overlapping ellipsoids of positive amplitude, no symmetry.
pub(super) fn three_ellipsoids() -> Vec<Ellipsoid> {
    const TABLE: [[f64; 8]; 3] = [
        [1.0, 0.70, 0.50, 0.60, 0.05, -0.10, 0.08, 20.0],
        [0.5, 0.25, 0.40, 0.30, -0.35, 0.25, -0.20, -35.0],
        [2.0, 0.12, 0.10, 0.20, 0.40, 0.15, 0.30, 0.0],
    ];
    TABLE.iter().map(|row| Ellipsoid::from_table(*row)).collect()
}

/// Point samples per axis and voxel where a surface passes.
const SUB: usize = 4;

/// Fills slice `k` with the mean of the sum of `table` (unit coordinates) over each voxel: exact inside and outside,
/// the mean of 4x4x4 points where a surface may pass.
pub(super) fn fill_slice<T>(
    table: &[Ellipsoid],
    dims: [usize; 3],
    k: usize,
    slice: &mut [T],
    store: impl Fn(f64) -> T,
) {
    let [nx, ny, nz] = dims;
    let half = DVec3::new(1.0 / nx as f64, 1.0 / ny as f64, 1.0 / nz as f64);
    let sub: [f64; SUB] = std::array::from_fn(|s| (2 * s + 1) as f64 / SUB as f64 - 1.0);
    let mut row_sum = vec![0.0f64; nx];
    for (j, row) in slice.chunks_mut(nx).enumerate() {
        row_sum.fill(0.0);
        for e in table {
            let m = e.inverse;
            // How far the mapped corner of a voxel lies from its mapped centre, at most.
            let reach = (m * half)
                .length()
                .max((m * DVec3::new(-half.x, half.y, half.z)).length())
                .max((m * DVec3::new(half.x, -half.y, half.z)).length())
                .max((m * DVec3::new(half.x, half.y, -half.z)).length());
            // The run of voxels whose centre is mapped within 1 + reach: a quadratic in x.
            let at = |x: f64| m * (DVec3::new(x, unit(j, ny), unit(k, nz)) - e.centre);
            let (o, d) = (at(0.0), m.x_axis);
            let outer = (1.0 + reach).powi(2);
            let (a, b, c) = (d.dot(d), d.dot(o), o.dot(o) - outer);
            let discriminant = b * b - a * c;
            if discriminant <= 0.0 {
                continue;
            }
            let (from, to) = ((-b - discriminant.sqrt()) / a, (-b + discriminant.sqrt()) / a);
            let index = |x: f64| (x + 1.0) * nx as f64 / 2.0;
            let first = index(from).floor().clamp(0.0, nx as f64) as usize;
            let last = index(to).ceil().clamp(0.0, nx as f64) as usize;
            let inner = (1.0 - reach).max(0.0).powi(2);
            for (i, sum) in row_sum.iter_mut().enumerate().take(last).skip(first) {
                let p = at(unit(i, nx));
                let q = p.length_squared();
                if q >= outer {
                    continue;
                }
                if q < inner {
                    *sum += e.amplitude;
                    continue;
                }
                let mut inside = 0u32;
                for sz in sub {
                    for sy in sub {
                        for sx in sub {
                            let s = p + m * (half * DVec3::new(sx, sy, sz));
                            inside += u32::from(s.length_squared() <= 1.0);
                        }
                    }
                }
                *sum += e.amplitude * f64::from(inside) / (SUB * SUB * SUB) as f64;
            }
        }
        for (v, sum) in row.iter_mut().zip(&row_sum) {
            *v = store(*sum);
        }
    }
}
