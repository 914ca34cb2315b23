//! Sixteen rays of a camera, side by side.

use super::driver::Along;
use super::lanes::{LANES, Row};
use super::tiles::Tiles;
use crate::view::{Affine, View};

/// Rays `u(t) = origin + t * direction` in cell coordinates (see [`crate::cell`]), with what a trace needs of them. Lanes that
/// meet nothing have `from` = infinity.
pub(crate) struct Beam {
    pub origin: [Row<f64>; 3],
    pub direction: [Row<f64>; 3],
    /// Where the ray enters and leaves the box around all density.
    pub from: Row<f64>,
    pub to: Row<f64>,
    /// From the integral over `t` to the estimand.
    pub factor: Row<f64>,
    /// Samples lie at `t = (n + phase) * distance`.
    pub distance: Row<f64>,
    /// `1 / distance`.
    pub teeth: Row<f64>,
    pub phase: Row<f64>,
    /// Factor that brings every `t` of the image near 1, so that its square is a good `f32`.
    pub nearness: f64,
}

/// What all beams of an image share.
pub(crate) struct Optics {
    pub rays: Affine,
    /// Box around all density, in cell coordinates.
    pub low: [f64; 3],
    pub high: [f64; 3],
    pub along: Along,
    /// Millimetres of path between samples, or the smallest side of a voxel.
    pub spacing: f64,
    pub nearness: f64,
    /// Whether the estimand weighs with the depth's square.
    pub squared: bool,
}

impl Optics {
    /// `smallest` is the smallest side of a voxel.
    pub fn new(view: &View, tiles: &Tiles, along: Along, smallest: f64) -> Self {
        let spacing = match along {
            Along::Comb(spacing) => spacing,
            Along::Exact => smallest,
        };
        let farthest = tiles.farthest();
        let nearness = if farthest > 0.0 && farthest.is_finite() { 1.0 / farthest } else { 1.0 };
        let (low, high, squared) = (tiles.low, tiles.high, view.squared());
        Self { rays: view.affine(), low, high, along, spacing, nearness, squared }
    }

    /// The rays through sixteen image points. Without branches, so that the compiler turns it into vector code.
    #[inline(always)]
    pub fn beam(&self, px: &Row<f64>, py: &Row<f64>, phase: &Row<f64>) -> Beam {
        let r = &self.rays;
        let mut beam = Beam {
            origin: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            from: [r.start; LANES],
            to: [f64::INFINITY; LANES],
            factor: [0.0; LANES],
            distance: [0.0; LANES],
            teeth: [0.0; LANES],
            phase: *phase,
            nearness: self.nearness,
        };
        for axis in 0..3 {
            let of = |v: &[[f64; 3]; 3]| [v[0][axis], v[1][axis], v[2][axis]];
            let (o, d) = (of(&r.origin), of(&r.direction));
            let (low, high) = (self.low[axis], self.high[axis]);
            for l in 0..LANES {
                let origin = o[0] + o[1] * px[l] + o[2] * py[l];
                let direction = d[0] + d[1] * px[l] + d[2] * py[l];
                let inverse = 1.0 / direction;
                let (p, q) = ((low - origin) * inverse, (high - origin) * inverse);
                // A direction along the planes meets none: inside for ever, or never.
                let along = inverse.abs() == f64::INFINITY || inverse.is_nan();
                let inside = low <= origin && origin < high;
                let never = if inside { f64::NEG_INFINITY } else { f64::INFINITY };
                let (enter, leave) = if p < q { (p, q) } else { (q, p) };
                let enter = if along { never } else { enter };
                let leave = if along { -never } else { leave };
                beam.from[l] = if enter > beam.from[l] { enter } else { beam.from[l] };
                beam.to[l] = if leave < beam.to[l] { leave } else { beam.to[l] };
                beam.origin[axis][l] = origin;
                beam.direction[axis][l] = direction;
            }
        }
        let [w0, w1, w2] = r.world;
        for l in 0..LANES {
            let x = w0[0] + w1[0] * px[l] + w2[0] * py[l];
            let y = w0[1] + w1[1] * px[l] + w2[1] * py[l];
            let z = w0[2] + w1[2] * px[l] + w2[2] * py[l];
            // Millimetres of path per unit of `t`.
            let stretch = (x * x + y * y + z * z).sqrt();
            beam.factor[l] = r.scale * if r.stretches { stretch } else { 1.0 };
            beam.distance[l] = self.spacing / stretch;
            beam.teeth[l] = stretch / self.spacing;
            let meets = beam.from[l] < beam.to[l] && beam.to[l] < f64::INFINITY;
            beam.from[l] = if meets { beam.from[l] } else { f64::INFINITY };
        }
        beam
    }
}
