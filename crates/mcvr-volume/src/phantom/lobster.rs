//! A model after the classic CT scan of a lobster in resin: hard shell, softer inside, claws, thin legs, antennae,
//! and the resin: a disc of low but non-zero isovalues that a renderer must cope with.

use glam::DVec3;

use super::parts::{Lattice, Part};

/// Isovalue of shell.
const SHELL: f64 = 215.0;
/// Isovalue inside the shell.
const FLESH: f64 = 85.0;
/// Isovalue of the resin at the disc's middle; it falls by a third towards the edge.
const RESIN: f64 = 15.0;
/// Thickness of the shell.
const SHELL_THICKNESS: f64 = 0.022;
/// Radius of the resin disc.
const DISC_RADIUS: f64 = 0.97;
/// Half height of the resin disc.
const DISC_HALF_HEIGHT: f64 = 0.168;

/// The animal's parts, in units of half the longer of the grid's x and y sides; it lies in the plane z = 0, head
/// towards +y, and fits |z| < 0.168, so that a grid of 301x324x56 holds all of it.
pub(super) struct Lobster {
    lattice: Lattice,
    parts: Vec<Part>,
}

impl Lobster {
    pub(super) fn new(dims: [usize; 3]) -> Self {
        let step = 2.0 / dims[0].max(dims[1]) as f64;
        let first = DVec3::from_array(dims.map(|n| -0.5 * (n as f64 - 1.0) * step));
        Self { lattice: Lattice { dims, first, step: DVec3::splat(step) }, parts: animal() }
    }

    /// Fills slice `k`.
    pub(super) fn fill_slice(&self, k: usize, slice: &mut [u8]) {
        let h = self.lattice.step.x;
        let mut nearest = vec![f64::INFINITY; slice.len()];
        let mut thin = vec![0.0f64; slice.len()];
        self.lattice.for_near(k, &self.parts, h, |n, part, p| {
            let (d, r) = part.distance(p);
            if 2.0 * r < h {
                // Thinner than a voxel: the voxel holds only part of the tube's cross-section.
                thin[n] = thin[n].max(coverage(d, h) * (2.0 * r / h).powi(2));
            } else {
                nearest[n] = nearest[n].min(d);
            }
        });
        let nx = self.lattice.dims[0];
        for (n, v) in slice.iter_mut().enumerate() {
            let p = self.lattice.at(n % nx, n / nx, k);
            let r = p.truncate().length();
            let resin_value = RESIN * (1.0 - r * r / 3.0);
            let resin = coverage(r - DISC_RADIUS, h) * coverage(p.z.abs() - DISC_HALF_HEIGHT, h) * resin_value;
            let solid = coverage(nearest[n], h);
            let inside = coverage(nearest[n] + SHELL_THICKNESS, h);
            let body = SHELL + (FLESH - SHELL) * inside;
            let cover = solid.max(thin[n]);
            *v = (resin + (body - resin) * cover).round().clamp(0.0, 255.0) as u8;
        }
    }
}

/// Share of a voxel of width `h` that lies inside a plane surface at signed distance `d`.
fn coverage(d: f64, h: f64) -> f64 {
    (0.5 - d / h).clamp(0.0, 1.0)
}

fn animal() -> Vec<Part> {
    let mut parts = vec![
        Part::ball([0.0, -0.02, 0.0], [0.165, 0.30, 0.125], 0.0),
        Part::tube([0.0, 0.22, 0.03], [0.0, 0.37, 0.045], 0.05, 0.010),
    ];
    // Abdomen: six rings, smaller towards the tail.
    for ring in 0..6 {
        let t = f64::from(ring) / 5.0;
        parts.push(Part::ball([0.0, -0.32 - 0.44 * t, -0.01], [0.140 - 0.045 * t, 0.074, 0.105 - 0.04 * t], 0.0));
    }
    // Tail fan: five flat blades.
    for blade in -2..=2 {
        let angle = f64::from(blade) * 27.0;
        let (s, c) = angle.to_radians().sin_cos();
        parts.push(Part::ball([0.15 * s, -0.77 - 0.115 * c, -0.01], [0.045, 0.105, 0.020], angle));
    }
    for side in [-1.0, 1.0] {
        let at = |x: f64, y: f64, z: f64| [side * x, y, z];
        // Eyes on short stalks.
        parts.push(Part::tube(at(0.05, 0.25, 0.06), at(0.075, 0.31, 0.075), 0.012, 0.022));
        // Arms and claws; the right one is the crusher, broader than the cutter.
        let broad = if side > 0.0 { 1.25 } else { 1.0 };
        parts.push(Part::tube(at(0.11, 0.16, 0.0), at(0.26, 0.24, 0.02), 0.035, 0.042));
        parts.push(Part::tube(at(0.26, 0.24, 0.02), at(0.37, 0.36, 0.02), 0.042, 0.045));
        parts.push(Part::tube(at(0.37, 0.36, 0.02), at(0.37, 0.46, 0.01), 0.045, 0.055));
        parts.push(Part::ball(at(0.36, 0.56, 0.0), [0.085 * broad, 0.135, 0.062 * broad], side * 8.0));
        parts.push(Part::tube(at(0.39, 0.64, 0.0), at(0.40, 0.76, 0.0), 0.05 * broad, 0.036 * broad));
        parts.push(Part::tube(at(0.40, 0.76, 0.0), at(0.35, 0.88, 0.0), 0.036 * broad, 0.010));
        parts.push(Part::tube(at(0.30, 0.63, 0.0), at(0.265, 0.74, 0.0), 0.034 * broad, 0.028));
        parts.push(Part::tube(at(0.265, 0.74, 0.0), at(0.30, 0.86, 0.0), 0.028, 0.008));
        // Four pairs of walking legs: out to a raised knee, then down to the tip.
        for leg in 0..4 {
            let n = f64::from(leg);
            let (y, lean) = (0.10 - 0.085 * n, 0.10 - 0.085 * n);
            let knee = at(0.36 + 0.02 * n, y + lean, 0.07);
            let foot = at(0.60 - 0.015 * n, y + 2.2 * lean - 0.03 * n, -0.10);
            parts.push(Part::tube(at(0.12, y, -0.03), knee, 0.020, 0.014));
            parts.push(Part::tube(knee, foot, 0.014, 0.006));
        }
        // Long antennae that sweep out and back along the disc, short antennules before the head.
        let arc = |t: f64| {
            let angle = t * 2.3;
            at(
                0.045 + 0.72 * angle.sin() * (0.35 + 0.65 * t),
                0.30 + 0.34 * (1.0 - (1.55 * angle).cos()) - 0.75 * t * t,
                0.05 - 0.04 * t,
            )
        };
        for piece in 0..24 {
            let (t0, t1) = (f64::from(piece) / 24.0, f64::from(piece + 1) / 24.0);
            parts.push(Part::tube(arc(t0), arc(t1), 0.012 - 0.008 * t0, 0.012 - 0.008 * t1));
        }
        parts.push(Part::tube(at(0.02, 0.34, 0.05), at(0.06, 0.50, 0.07), 0.008, 0.004));
    }
    parts
}
