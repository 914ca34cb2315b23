//! A tree of thin tubes after angiographies: most voxels 0, structures near the size of a voxel.

use glam::DVec3;

use super::parts::{Lattice, Part};
use super::unit;

/// Isovalue inside a vessel.
const BLOOD: f64 = 255.0;
/// Generations of branches after the root.
const GENERATIONS: u32 = 9;
/// Straight pieces per branch.
const PIECES: u32 = 4;
/// Radius of the root in unit coordinates.
const ROOT_RADIUS: f64 = 0.045;
/// Length of the root.
const ROOT_LENGTH: f64 = 0.50;
/// Largest distance of a vessel from the middle, per axis.
const REACH: f64 = 0.93;
/// Point samples per axis and voxel.
const SUB: usize = 3;

/// The tree, in unit coordinates (each axis over [-1, 1]).
///
/// A root rises from the bottom; every branch ends in two whose radii follow Murray's law (the cubes add up; C. Murray,
/// *The physiological principle of minimum work*, 1926), turned by random angles from a fixed seed; one
/// early branch carries a ball, an aneurism.
pub(super) struct Vessels {
    lattice: Lattice,
    parts: Vec<Part>,
}

impl Vessels {
    pub(super) fn new(dims: [usize; 3]) -> Self {
        let step = DVec3::from_array(dims.map(|n| 2.0 / n as f64));
        let first = DVec3::from_array(dims.map(|n| unit(0, n)));
        Self { lattice: Lattice { dims, first, step }, parts: tree() }
    }

    /// Fills slice `k`: share of 3x3x3 points of a voxel that lie inside a vessel; a vessel between the points
    /// counts by its cross-section.
    pub(super) fn fill_slice(&self, k: usize, slice: &mut [u8]) {
        let step = self.lattice.step;
        let reach = step.length() / 2.0;
        let mut cover = vec![0.0f64; slice.len()];
        let fine = step.max_element() / SUB as f64;
        self.lattice.for_near(k, &self.parts, reach, |n, part, p| {
            let (d, _) = part.distance(p);
            if d > reach || cover[n] >= 1.0 {
                return;
            }
            let mut sum = 0.0;
            let sub = |s: usize| (2 * s + 1) as f64 / (2 * SUB) as f64 - 0.5;
            for s in 0..SUB * SUB * SUB {
                let offset = DVec3::new(sub(s % SUB), sub(s / SUB % SUB), sub(s / SUB / SUB));
                let (d, r) = part.distance(p + step * offset);
                sum += (0.5 - d / fine).clamp(0.0, 1.0) * (2.0 * r / fine).powi(2).min(1.0);
            }
            cover[n] = cover[n].max(sum / (SUB * SUB * SUB) as f64);
        });
        for (v, c) in slice.iter_mut().zip(cover) {
            *v = (BLOOD * c).round() as u8;
        }
    }
}

/// A stream of uniform numbers in [0, 1): splitmix64 (G. Steele et al., OOPSLA 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A vector with coordinates in [-1, 1).
    fn vector(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
    }
}

fn tree() -> Vec<Part> {
    let mut parts = Vec::new();
    let mut random = Random(1926);
    let root = DVec3::new(0.05, 0.0, -0.95);
    grow(&mut parts, &mut random, root, DVec3::Z, ROOT_LENGTH, ROOT_RADIUS, GENERATIONS);
    parts
}

fn grow(
    parts: &mut Vec<Part>,
    random: &mut Random,
    start: DVec3,
    direction: DVec3,
    length: f64,
    radius: f64,
    left: u32,
) {
    let mut at = start;
    let mut direction = direction;
    for _ in 0..PIECES {
        // Wander, and turn back before the border.
        let inward = DVec3::from_array(at.to_array().map(|x| -x.signum() * ((x.abs() - 0.6) / 0.3).max(0.0).powi(2)));
        direction = (direction + 0.28 * random.vector() + 0.5 * inward).normalize_or(DVec3::Z);
        let next = (at + direction * (length / f64::from(PIECES))).clamp(DVec3::splat(-REACH), DVec3::splat(REACH));
        parts.push(Part::Tube { a: at, b: next, ra: radius, rb: radius });
        at = next;
    }
    if left == GENERATIONS - 2 && random.next() < 0.5 {
        parts.push(Part::Ball {
            centre: at + DVec3::new(0.0, 0.05, 0.0),
            radii: DVec3::new(0.085, 0.07, 0.075),
            turn: glam::DMat3::IDENTITY,
        });
    }
    if left == 0 {
        return;
    }
    // Murray: the cubes of the children's radii add up to the parent's.
    let share = 0.5 + 0.3 * (random.next() - 0.5);
    let side = direction.cross(random.vector()).normalize_or(DVec3::X);
    for (share, sign) in [(share, 1.0), (1.0 - share, -1.0)] {
        let angle: f64 = sign * (0.35 + 0.45 * random.next());
        let turned = direction * angle.cos() + side * angle.sin();
        let child_length = length * (0.72 + 0.2 * random.next());
        grow(parts, random, at, turned, child_length, radius * share.cbrt(), left - 1);
    }
}
