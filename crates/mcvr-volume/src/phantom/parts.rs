//! Solid parts given by signed distances: tapered tubes and ellipsoids, drawn slice by slice.

use glam::{DMat3, DVec3};

/// A solid body.
#[derive(Clone, Copy, Debug)]
pub(super) enum Part {
    /// A tube from `a` to `b` whose radius changes linearly from `ra` to `rb`, with round ends.
    Tube { a: DVec3, b: DVec3, ra: f64, rb: f64 },
    /// An ellipsoid with semi-axes `radii`, turned by `turn` (world from body).
    Ball { centre: DVec3, radii: DVec3, turn: DMat3 },
}

impl Part {
    /// An ellipsoid turned about z by `degrees`.
    pub(super) fn ball(centre: [f64; 3], radii: [f64; 3], degrees: f64) -> Self {
        let turn = DMat3::from_rotation_z(degrees.to_radians());
        Part::Ball { centre: centre.into(), radii: radii.into(), turn }
    }

    /// A tapered tube.
    pub(super) fn tube(a: [f64; 3], b: [f64; 3], ra: f64, rb: f64) -> Self {
        Part::Tube { a: a.into(), b: b.into(), ra, rb }
    }

    /// Signed distance (negative inside; approximate for ellipsoids) and radius of the part nearby.
    pub(super) fn distance(&self, p: DVec3) -> (f64, f64) {
        match *self {
            Part::Tube { a, b, ra, rb } => {
                let axis = b - a;
                let t = ((p - a).dot(axis) / axis.length_squared().max(1e-12)).clamp(0.0, 1.0);
                let r = ra + (rb - ra) * t;
                ((p - a - axis * t).length() - r, r)
            }
            Part::Ball { centre, radii, turn } => {
                let q = turn.transpose() * (p - centre);
                let k0 = (q / radii).length();
                let k1 = (q / (radii * radii)).length();
                let r = radii.min_element();
                (if k1 < 1e-9 { -r } else { k0 * (k0 - 1.0) / k1 }, r)
            }
        }
    }

    /// Corners of an axis-aligned box around the part.
    pub(super) fn bounds(&self) -> (DVec3, DVec3) {
        match *self {
            Part::Tube { a, b, ra, rb } => ((a - ra).min(b - rb), (a + ra).max(b + rb)),
            Part::Ball { centre, radii, turn } => {
                let r = DVec3::new(
                    (turn.row(0) * radii).length(),
                    (turn.row(1) * radii).length(),
                    (turn.row(2) * radii).length(),
                );
                (centre - r, centre + r)
            }
        }
    }
}

/// The placing of voxels in a part's coordinates: voxel (i, j, k) has its centre at `first + step * (i, j, k)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice {
    pub(super) dims: [usize; 3],
    pub(super) first: DVec3,
    pub(super) step: DVec3,
}

impl Lattice {
    /// Centre of voxel (i, j, k).
    pub(super) fn at(&self, i: usize, j: usize, k: usize) -> DVec3 {
        self.first + self.step * DVec3::new(i as f64, j as f64, k as f64)
    }

    /// Voxels of axis `axis` whose centres lie within [low, high].
    fn range(&self, axis: usize, low: f64, high: f64) -> std::ops::Range<usize> {
        let n = self.dims[axis] as f64;
        let index = |x: f64| (x - self.first[axis]) / self.step[axis];
        let from = index(low).ceil().clamp(0.0, n) as usize;
        let to = (index(high).floor() + 1.0).clamp(0.0, n) as usize;
        from..to.max(from)
    }

    /// Calls `visit(linear index in the slice, part, voxel centre)` for each voxel of slice `k` within `margin` of a
    /// part's box, in the order of the parts.
    pub(super) fn for_near(&self, k: usize, parts: &[Part], margin: f64, mut visit: impl FnMut(usize, &Part, DVec3)) {
        for part in parts {
            let (low, high) = part.bounds();
            if !self.range(2, low.z - margin, high.z + margin).contains(&k) {
                continue;
            }
            let across = self.range(0, low.x - margin, high.x + margin);
            for j in self.range(1, low.y - margin, high.y + margin) {
                for i in across.clone() {
                    visit(i + self.dims[0] * j, part, self.at(i, j, k));
                }
            }
        }
    }
}
