//! Reconstruction kernels: their densities, their inverse distribution functions, their supports.

use glam::DVec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a voxel's weight is spread around its centre (METHOD section 1). Arguments and offsets are in
/// units of the voxel spacing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "lowercase")]
pub enum Kernel {
    /// Uniform over ±1/2: nearest neighbour.
    Box,
    /// Triangle over ±1: exactly trilinear interpolation.
    #[default]
    Tent,
    /// Cubic B-spline over ±2.
    Bspline3,
    /// The report's own: a random direction of length 1/2. Not separable, no density in the ordinary sense.
    ///
    /// It blurs no more than `box` does (both have variance 1/12), but it is no partition of unity: where an image has more
    /// than about a pixel per voxel, the spheres show as a net.
    Shell,
}

impl Kernel {
    /// Every kernel.
    pub const ALL: [Kernel; 4] = [Kernel::Box, Kernel::Tent, Kernel::Bspline3, Kernel::Shell];

    /// `box`, `tent`, `bspline3` or `shell`.
    pub fn name(self) -> &'static str {
        match self {
            Kernel::Box => "box",
            Kernel::Tent => "tent",
            Kernel::Bspline3 => "bspline3",
            Kernel::Shell => "shell",
        }
    }

    /// Half the width of the support along each axis, in voxels.
    pub fn support(self) -> f64 {
        match self {
            Kernel::Box | Kernel::Shell => 0.5,
            Kernel::Tent => 1.0,
            Kernel::Bspline3 => 2.0,
        }
    }

    /// Variance of the offset along each axis, in voxels²: 1/12, 1/6, 1/3 and 1/12.
    pub fn variance(self) -> f64 {
        match self {
            Kernel::Box | Kernel::Shell => 1.0 / 12.0,
            Kernel::Tent => 1.0 / 6.0,
            Kernel::Bspline3 => 1.0 / 3.0,
        }
    }

    /// One-dimensional density at `t`; the kernel is the product over the axes. `None` for `shell`,
    /// which is not separable.
    pub fn density(self, t: f64) -> Option<f64> {
        let a = t.abs();
        Some(match self {
            Kernel::Box => f64::from(u8::from((-0.5..0.5).contains(&t))),
            Kernel::Tent => (1.0 - a).max(0.0),
            Kernel::Bspline3 if a < 1.0 => 2.0 / 3.0 - a * a + 0.5 * a * a * a,
            Kernel::Bspline3 => (2.0 - a).max(0.0).powi(3) / 6.0,
            Kernel::Shell => return None,
        })
    }

    /// Offset of a sample from its voxel's centre, from three uniforms in (0, 1): by inversion of the
    /// distribution function on each axis, or by the cylinder map onto the sphere for `shell` (which
    /// leaves the third uniform unused). Every map is monotone in each uniform, so low-discrepancy
    /// points stay so. This is the scalar reference of the vectorised maps in `mcvr-sampling`.
    pub fn offset(self, u: [f64; 3]) -> DVec3 {
        match self {
            Kernel::Box => DVec3::from_array(u.map(|u| u - 0.5)),
            Kernel::Tent => DVec3::from_array(u.map(tent_inverse)),
            Kernel::Bspline3 => DVec3::from_array(u.map(bspline3_inverse)),
            Kernel::Shell => {
                let z = 2.0 * u[0] - 1.0;
                let (sin, cos) = (std::f64::consts::TAU * u[1]).sin_cos();
                let r = (1.0 - z * z).max(0.0).sqrt();
                0.5 * DVec3::new(r * cos, r * sin, z)
            }
        }
    }
}

/// Inverse distribution function of the triangle density on ±1.
fn tent_inverse(u: f64) -> f64 {
    if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).sqrt() }
}

/// Inverse distribution function of the cubic B-spline on ±2: a fourth root in the tails, Newton's method
/// on the quartic `G(t) = 1/2 + 2t/3 - t³/3 - t⁴/8` (t in [-1, 0]) in between.
fn bspline3_inverse(u: f64) -> f64 {
    let s = u.min(1.0 - u);
    let t = if s <= 1.0 / 24.0 {
        (24.0 * s).sqrt().sqrt() - 2.0
    } else {
        let mut t = (s - 0.5) * 1.75;
        for _ in 0..6 {
            let g = 0.5 + t * (2.0 / 3.0 - t * t * (1.0 / 3.0 + t * 0.125));
            let density = 2.0 / 3.0 - t * t * (1.0 + 0.5 * t);
            t = (t - (g - s) / density).clamp(-1.0, 0.0);
        }
        t
    };
    if u <= 0.5 { t } else { -t }
}

impl std::fmt::Display for Kernel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for Kernel {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|k| k.name() == s)
            .ok_or_else(|| format!("unknown kernel '{s}'; one of box, tent, bspline3, shell"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integral of the density from below the support to `t`, by the midpoint rule.
    fn cdf(kernel: Kernel, t: f64) -> f64 {
        let (a, n) = (-kernel.support(), 40_000);
        let h = (t - a) / n as f64;
        (0..n).map(|i| kernel.density(a + (i as f64 + 0.5) * h).unwrap() * h).sum()
    }

    #[test]
    fn separable_kernels_integrate_to_one() {
        for k in [Kernel::Box, Kernel::Tent, Kernel::Bspline3] {
            // Midpoint rule error h²/24 * total variation of the derivative < 1e-8.
            assert!((cdf(k, k.support()) - 1.0).abs() < 1e-8, "{k}");
        }
    }

    #[test]
    fn offsets_invert_the_distribution_function() {
        for k in [Kernel::Box, Kernel::Tent, Kernel::Bspline3] {
            for i in 1..200 {
                let u = i as f64 / 200.0;
                let t = k.offset([u; 3]).x;
                assert!((cdf(k, t) - u).abs() < 2e-8, "{k}: u = {u}, t = {t}, G(t) = {}", cdf(k, t));
            }
        }
    }

    #[test]
    fn offsets_have_the_stated_variance() {
        // Midpoint rule over the uniforms; the slowest case is bspline3, whose inverse behaves like u^(1/4)
        // at the ends: error of the second moment O(n^(-5/4)), below 1e-7 for a million points.
        let n = 1_000_000;
        let mid = |i: usize| (i as f64 + 0.5) / n as f64;
        for k in [Kernel::Box, Kernel::Tent, Kernel::Bspline3] {
            let square: f64 = (0..n).map(|i| k.offset([mid(i); 3]).x.powi(2)).sum();
            assert!((square / n as f64 - k.variance()).abs() < 1e-6, "{k}: {}", square / n as f64);
        }
    }

    #[test]
    fn shell_offsets_are_uniform_directions_of_length_one_half() {
        let n = 400;
        let mut second = [DVec3::ZERO; 3];
        for i in 0..n * n {
            let t = Kernel::Shell.offset([(i / n) as f64 + 0.5, (i % n) as f64 + 0.5, 0.0].map(|v| v / n as f64));
            assert!((t.length() - 0.5).abs() < 1e-12);
            (0..3).for_each(|a| second[a] += t * t[a]);
        }
        for (a, row) in second.iter().enumerate() {
            let expected = DVec3::from_array(std::array::from_fn(|b| if a == b { 1.0 / 12.0 } else { 0.0 }));
            assert!((*row / (n * n) as f64 - expected).abs().max_element() < 1e-5);
        }
    }

    #[test]
    fn all_but_the_shell_are_partitions_of_unity() {
        // A kernel's Fourier transform at whole frequencies is what it leaves of the voxel lattice in a uniform region.
        let n = 60;
        let mid = |i: usize| (i as f64 + 0.5) / n as f64;
        let lattice = |k: Kernel, f: DVec3| {
            let at = |i: usize| k.offset([mid(i / (n * n)), mid(i / n % n), mid(i % n)]);
            (0..n * n * n).map(|i| (std::f64::consts::TAU * f.dot(at(i))).cos()).sum::<f64>() / (n * n * n) as f64
        };
        for f in [DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::ONE] {
            // The midpoint rule over uniforms: the slowest is bspline3, whose inverse behaves like u^(1/4) at the ends.
            for k in [Kernel::Box, Kernel::Tent, Kernel::Bspline3] {
                assert!(lattice(k, f).abs() < 2e-3, "{k} at {f}: {}", lattice(k, f));
            }
            let x = std::f64::consts::PI * f.length();
            let shell = lattice(Kernel::Shell, f);
            assert!((shell - x.sin() / x).abs() < 2e-3, "shell at {f}: {shell}");
        }
        assert!(lattice(Kernel::Shell, DVec3::new(1.0, 1.0, 0.0)) < -0.2);
    }

    #[test]
    fn offsets_stay_inside_the_support_at_the_ends() {
        for k in Kernel::ALL {
            for u in [f64::MIN_POSITIVE, 2f64.powi(-53), 0.5, 1.0 - 2f64.powi(-53)] {
                let t = k.offset([u; 3]);
                assert!(t.is_finite() && t.abs().max_element() <= k.support(), "{k} at {u}: {t}");
            }
        }
    }
}
