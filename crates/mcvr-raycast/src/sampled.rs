//! The field at single points, in `f32`: what the march evaluates at every step.

use mcvr_scene::Kernel;
use mcvr_volume::Voxel;

use crate::Counters;
use crate::field::Weigh;
use crate::view::IndexRay;

/// Typed voxels with their weights and kernel, in plain index coordinates (voxel centres at whole numbers).
pub(crate) struct SampledField<'a, T, W> {
    voxels: &'a [T],
    weights: W,
    dims: [usize; 3],
    kernel: Kernel,
}

impl<'a, T: Voxel, W: Weigh<T, f32>> SampledField<'a, T, W> {
    pub fn new(voxels: &'a [T], weights: W, dims: [usize; 3], kernel: Kernel) -> Self {
        Self { voxels, weights, dims, kernel }
    }

    /// Lowest corner of the field's support (index coordinates).
    pub fn low(&self) -> [f64; 3] {
        [-self.kernel.support(); 3]
    }

    /// Highest corner of the field's support (index coordinates).
    pub fn high(&self) -> [f64; 3] {
        self.dims.map(|n| n as f64 - 1.0 + self.kernel.support())
    }

    /// `Σ ρ` (or `Σ ρ t²`) at `t = from + (s + 1/2) dt`, s = 0..steps.
    pub fn sum<const SQUARED: bool>(
        &self,
        ray: &IndexRay,
        from: f64,
        dt: f64,
        steps: u64,
        counters: &mut Counters,
    ) -> f64 {
        counters.evaluations += steps;
        let mut sum = 0.0;
        // Steps whose points surely lie between voxel centres; the others go the careful way.
        let (a, b) = if self.kernel == Kernel::Tent { self.interior(ray, from, dt, steps) } else { (0, 0) };
        for s in (0..a).chain(b..steps) {
            let t = from + (s as f64 + 0.5) * dt;
            let u: [f64; 3] = std::array::from_fn(|a| ray.origin[a] + t * ray.direction[a]);
            let rho = f64::from(self.at(u, counters));
            sum += if SQUARED { rho * t * t } else { rho };
        }
        if a < b {
            counters.voxel_reads += 8 * (b - a);
            sum += self.inner::<SQUARED>(ray, from, dt, a..b);
        }
        sum
    }

    /// Range of steps whose points lie at least 1/1024 voxel inside the box of voxel centres.
    fn interior(&self, ray: &IndexRay, from: f64, dt: f64, steps: u64) -> (u64, u64) {
        const MARGIN: f64 = 1.0 / 1024.0;
        // `f32` counts steps and voxels exactly up to here.
        const EXACT: u64 = 1 << 24;
        if steps > EXACT || self.dims.iter().any(|&n| n < 2 || n as u64 > EXACT) {
            return (0, 0);
        }
        let Some((p, q)) = ray.clip([MARGIN; 3], self.dims.map(|n| n as f64 - 1.0 - MARGIN)) else { return (0, 0) };
        // `as` saturates; a negative start becomes 0.
        let a = ((p - from) / dt - 0.5).ceil() as u64;
        let b = ((q - from) / dt - 0.5).floor() as u64 + 1;
        let (a, b) = (a.min(steps), b.min(steps));
        if a < b && self.holds(ray, from, dt, a..b) { (a, b) } else { (0, 0) }
    }

    /// True when every position that [`Self::inner`] computes on a range of at least one step lies between -1 and the extent on each
    /// axis. Its products and sums are rounded, but rounding is monotone: the first and the last position bound all others. Fails for
    /// eyes so far away that a double has no digits left for a voxel.
    #[inline]
    fn holds(&self, ray: &IndexRay, from: f64, dt: f64, range: std::ops::Range<u64>) -> bool {
        let (u, d) = Self::line(ray, from, dt, range.start);
        let last = (range.end - range.start - 1) as f32;
        (0..3).all(|a| {
            let extent = -1.0..self.dims[a] as f32;
            extent.contains(&u[a]) && extent.contains(&(u[a] + last * d[a]))
        })
    }

    /// Position of a step, and the way from one step to the next.
    #[inline]
    fn line(ray: &IndexRay, from: f64, dt: f64, step: u64) -> ([f32; 3], [f32; 3]) {
        let start = from + (step as f64 + 0.5) * dt;
        let u = std::array::from_fn(|a| (ray.origin[a] + start * ray.direction[a]) as f32);
        let d = std::array::from_fn(|a| (ray.direction[a] * dt) as f32);
        (u, d)
    }

    /// The trilinear hot loop: `f32` positions relative to the volume, no check of the border.
    #[inline]
    fn inner<const SQUARED: bool>(&self, ray: &IndexRay, from: f64, dt: f64, range: std::ops::Range<u64>) -> f64 {
        let [nx, ny, nz] = self.dims;
        let plane = nx * ny;
        // The last cell on each axis: `interior` found room for at least one.
        let last = [nx, ny, nz].map(|n| n.saturating_sub(2));
        assert!(nx >= 2 && ny >= 2 && nz >= 2 && self.voxels.len() == plane * nz, "interior of a flat grid");
        let (u, d) = Self::line(ray, from, dt, range.start);
        let (mut sum, mut n) = (0.0, 0.0f32);
        for s in range {
            let mut cell = [0usize; 3];
            let mut f = [0f32; 3];
            for a in 0..3 {
                let p = u[a] + n * d[a];
                debug_assert!((-1.0..self.dims[a] as f32).contains(&p), "{p} on axis {a}");
                // SAFETY: `interior` admits only ranges whose positions, as computed here, lie between -1 and the extent (`holds`),
                // of at most 2^24 voxels per axis. So p fits an `i32`.
                let i = unsafe { p.to_int_unchecked::<i32>() };
                cell[a] = (i as u32 as usize).min(last[a]);
                f[a] = p - i as f32;
            }
            let base = cell[0] + nx * (cell[1] + ny * cell[2]);
            // SAFETY: `cell` is at most `dims - 2` on each axis, so all 8 corners are voxels of the grid, and the
            // slice holds all of them (asserted above).
            let v = |o: usize| self.weights.weigh(unsafe { *self.voxels.get_unchecked(base + o) });
            let lerp = |a: f32, b: f32, x: f32| a + x * (b - a);
            let p = lerp(lerp(v(0), v(1), f[0]), lerp(v(nx), v(nx + 1), f[0]), f[1]);
            let q = lerp(lerp(v(plane), v(plane + 1), f[0]), lerp(v(plane + nx), v(plane + nx + 1), f[0]), f[1]);
            let rho = f64::from(lerp(p, q, f[2]));
            sum += if SQUARED {
                let t = from + (s as f64 + 0.5) * dt;
                rho * t * t
            } else {
                rho
            };
            n += 1.0;
        }
        sum
    }

    /// The field at an index position; voxels outside the grid weigh 0.
    fn at(&self, u: [f64; 3], counters: &mut Counters) -> f32 {
        let support = self.kernel.support();
        let taps = (2.0 * support) as i64;
        let [nx, ny, nz] = self.dims;
        let mut first = [0i64; 3];
        let mut w = [[0f32; 4]; 3];
        for a in 0..3 {
            // The cell in cell coordinates; the voxels it depends on end at the same number.
            let c = (u[a] + support).floor();
            // Beyond every grid, and beyond the integers below.
            if c.is_nan() || c.abs() >= (1u64 << 41) as f64 {
                return 0.0;
            }
            first[a] = c as i64 - (taps - 1);
            let x = (u[a] + support - c) as f32;
            w[a] = kernel_weights(self.kernel, x);
        }
        let mut sum = 0.0;
        for (k, wz) in (first[2]..first[2] + taps).zip(w[2]) {
            for (j, wy) in (first[1]..first[1] + taps).zip(w[1]) {
                for (i, wx) in (first[0]..first[0] + taps).zip(w[0]) {
                    // Negative numbers wrap to huge ones.
                    let (i, j, k) = (i as usize, j as usize, k as usize);
                    if i < nx && j < ny && k < nz {
                        counters.voxel_reads += 1;
                        sum += wx * wy * wz * self.weights.weigh(self.voxels[i + nx * (j + ny * k)]);
                    }
                }
            }
        }
        sum
    }
}

/// Weights of the voxels on which a cell depends, at local position `x` in [0, 1].
fn kernel_weights(kernel: Kernel, x: f32) -> [f32; 4] {
    match kernel {
        Kernel::Box | Kernel::Shell => [1.0, 0.0, 0.0, 0.0],
        Kernel::Tent => [1.0 - x, x, 0.0, 0.0],
        Kernel::Bspline3 => crate::cell::spline_weights(f64::from(x)).map(|w| w as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Value;

    impl Weigh<u8, f32> for Value {
        fn weigh(&self, stored: u8) -> f32 {
            f32::from(stored)
        }
    }

    #[test]
    fn the_unchecked_loop_equals_the_careful_one() {
        let dims = [9, 8, 7];
        let voxels: Vec<u8> = (0..dims.iter().product()).map(|n: usize| (n * 7919 % 251) as u8).collect();
        let field = SampledField::new(&voxels, Value, dims, Kernel::Tent);
        for direction in [[0.31, 0.17, 0.2], [-0.3, 0.05, -0.21], [0.0, 0.4, 0.0]] {
            let ray = IndexRay { origin: [4.1, 3.2, 3.3], direction, start: f64::NEG_INFINITY };
            let (from, to) = ray.clip(field.low(), field.high()).unwrap();
            let dt = (to - from) / 100.0;
            let (a, b) = field.interior(&ray, from, dt, 100);
            assert!(b > a + 40, "most steps lie inside");
            let careful: f64 = (a..b)
                .map(|s| {
                    let t = from + (s as f64 + 0.5) * dt;
                    let u = std::array::from_fn(|a| ray.origin[a] + t * ray.direction[a]);
                    f64::from(field.at(u, &mut Counters::default()))
                })
                .sum();
            let fast = field.inner::<false>(&ray, from, dt, a..b);
            assert!((fast - careful).abs() < 1e-5 * careful, "{fast} {careful}");
        }
    }

    /// Where a double's neighbours are voxels apart, clipping and the positions on the clipped ray round differently: points
    /// that should lie inside are computed to lie outside. Such ranges must go the careful way (`inner` asserts it).
    #[test]
    fn rays_from_where_voxels_have_no_digits_are_not_taken_for_interior_ones() {
        let dims = [40, 40, 40];
        let voxels = vec![1u8; 40 * 40 * 40];
        let field = SampledField::new(&voxels, Value, dims, Kernel::Tent);
        let mut clipped = 0;
        for far in 30..90 {
            for k in 0..40 {
                let direction = [0.3 + 0.01 * f64::from(k), 0.9 - 0.013 * f64::from(k), -0.37];
                let origin = [0, 1, 2].map(|a: usize| 10.0 - 2f64.powi(far) * direction[a]);
                let ray = IndexRay { origin, direction, start: f64::NEG_INFINITY };
                if let Some((from, to)) = ray.clip(field.low(), field.high()) {
                    clipped += 1;
                    let sum = field.sum::<false>(&ray, from, (to - from) / 100.0, 100, &mut Counters::default());
                    assert!((0.0..=100.5).contains(&sum), "{sum}");
                }
            }
        }
        assert!(clipped > 100, "{clipped} rays met the volume");
    }
}
