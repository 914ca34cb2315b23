//! Rays of a camera in the index space of a grid.

use glam::DVec3;
use mcvr_scene::{Camera, Estimand};
use mcvr_volume::Grid;

/// A ray in (shifted) index space: `u(t) = origin + t * direction` voxels. The parameter `t` is the depth in mm
/// for a pinhole (so that the weight of `count` is `t²`), the path length in mm for a parallel camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct IndexRay {
    pub origin: [f64; 3],
    pub direction: [f64; 3],
    /// Smallest parameter that counts.
    pub start: f64,
}

impl IndexRay {
    /// Parameters at which the ray enters and leaves the box `[low, high]`, after `start`; `None` for a miss.
    #[inline]
    pub fn clip(&self, low: [f64; 3], high: [f64; 3]) -> Option<(f64, f64)> {
        let (mut from, mut to) = (self.start, f64::INFINITY);
        for a in 0..3 {
            let (o, d) = (self.origin[a], self.direction[a]);
            let inverse = 1.0 / d;
            if inverse.is_finite() {
                let (p, q) = ((low[a] - o) * inverse, (high[a] - o) * inverse);
                from = from.max(p.min(q));
                to = to.min(p.max(q));
            } else if !(low[a] <= o && o < high[a]) {
                return None;
            }
        }
        (from < to && to.is_finite()).then_some((from, to))
    }
}

/// The same ray in the world: `x(t) = origin + t * direction` mm, at depth `depth + t` mm.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WorldRay {
    pub origin: DVec3,
    pub direction: DVec3,
    pub depth: f64,
}

/// A camera's rays as affine functions of the pixel coordinates (exact: both kinds of camera are).
pub(crate) struct View {
    origin: [DVec3; 3],
    direction: [DVec3; 3],
    /// World direction per unit depth as a function of the pixel, for the length of a pinhole's ray.
    world: [DVec3; 3],
    world_origin: [DVec3; 3],
    /// Depth at parameter 0.
    depth: f64,
    start: f64,
    parallel: bool,
    estimand: Estimand,
    /// `1 / (F |det M|)` for `count`, 1 for `line`.
    scale: f64,
}

/// Rays as numbers: index coordinates of origin and direction are `c[0] + c[1] px + c[2] py`.
pub(crate) struct Affine {
    pub origin: [[f64; 3]; 3],
    pub direction: [[f64; 3]; 3],
    /// World direction per unit of the parameter; its length is mm of path per unit.
    pub world: [[f64; 3]; 3],
    /// Smallest parameter that counts.
    pub start: f64,
    /// Factor from the integral over the path to the estimand; over the parameter unless `stretches`.
    pub scale: f64,
    pub stretches: bool,
}

#[inline(always)]
fn affine(c: &[DVec3; 3], px: f64, py: f64) -> DVec3 {
    c[0] + c[1] * px + c[2] * py
}

impl View {
    /// `shift` voxels are added to every index coordinate.
    pub fn new(camera: &Camera, grid: &Grid, estimand: Estimand, mass: f64, shift: f64) -> Self {
        let to_index = grid.world_to_index();
        let shift = DVec3::splat(shift);
        let m = camera.inverse();
        let scale = match estimand {
            Estimand::Line => 1.0,
            Estimand::Count => 1.0 / (mass * camera.det()),
        };
        let parallel = camera.is_parallel();
        let (world_origin, world, start, depth) = match camera.eye() {
            Some(eye) => ([eye, DVec3::ZERO, DVec3::ZERO], [m.z_axis, m.x_axis, m.y_axis], camera.near(), 0.0),
            None => {
                // Rays start beside the grid's centre, so that a far world origin costs no digits.
                let axis = camera.axis();
                let corner = camera.ray(0.0, 0.0).origin;
                let corner = corner + axis * (grid.centre() - corner).dot(axis);
                let world_origin = [corner, m.x_axis, m.y_axis];
                (world_origin, [axis, DVec3::ZERO, DVec3::ZERO], f64::NEG_INFINITY, camera.project(corner).2)
            }
        };
        let [o, x, y] = world_origin;
        let across = |v: DVec3| to_index.transform_vector3(v);
        let origin = [to_index.transform_point3(o) + shift, across(x), across(y)];
        let direction = world.map(across);
        Self { origin, direction, world, world_origin, depth, start, parallel, estimand, scale }
    }

    /// The coefficients of the rays, for code that makes many at once.
    pub fn affine(&self) -> Affine {
        Affine {
            origin: self.origin.map(|v| v.to_array()),
            direction: self.direction.map(|v| v.to_array()),
            world: self.world.map(|v| v.to_array()),
            start: self.start,
            scale: self.scale,
            stretches: !self.parallel && self.estimand == Estimand::Line,
        }
    }

    /// Depth at parameter 0, mm.
    pub fn depth(&self) -> f64 {
        self.depth
    }

    /// True when the integrand carries the weight `t²`.
    pub fn squared(&self) -> bool {
        !self.parallel && self.estimand == Estimand::Count
    }

    /// The ray through (px, py), and the factor from `∫ ρ dt` (or `∫ ρ t² dt` when [`Self::squared`]) to the
    /// estimand.
    #[inline]
    pub fn ray(&self, px: f64, py: f64) -> (IndexRay, f64) {
        let ray = IndexRay {
            origin: affine(&self.origin, px, py).to_array(),
            direction: affine(&self.direction, px, py).to_array(),
            start: self.start,
        };
        let stretch =
            if self.parallel || self.estimand == Estimand::Count { 1.0 } else { affine(&self.world, px, py).length() };
        (ray, stretch * self.scale)
    }

    /// The ray through (px, py) in the world.
    #[inline]
    pub fn world(&self, px: f64, py: f64) -> WorldRay {
        WorldRay {
            origin: affine(&self.world_origin, px, py),
            direction: affine(&self.world, px, py),
            depth: self.depth,
        }
    }

    /// Length in voxels of one pixel's side, the longer of the two, at parameter `t` of the ray.
    pub fn pixel_in_voxels(&self, t: f64) -> f64 {
        let t = if self.parallel { 1.0 } else { t };
        let side = |n: usize| {
            if self.parallel { self.origin[n].length() } else { self.direction[n].length() * t.abs() }
        };
        side(1).max(side(2))
    }
}
