//! The kernels under study, in the library and outside it, and images of any of them under a parallel camera.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use mcvr::scene::{Camera, Image, Kernel};
use mcvr::volume::Grid;
use rayon::prelude::*;

/// A kernel to be judged.
#[derive(Clone, Copy)]
pub struct Candidate {
    pub name: &'static str,
    pub note: &'static str,
    /// The library's kernel, if it has this one.
    pub library: Option<Kernel>,
    /// One-dimensional density; unused for the shell.
    density: fn(f64) -> f64,
    support: f64,
    /// Whether weights move up the gradient before the kernel spreads them.
    pub concentrate: bool,
}

fn of(kernel: Kernel) -> Option<Kernel> {
    Some(kernel)
}

fn bspline3(t: f64) -> f64 {
    Kernel::Bspline3.density(t).unwrap_or(0.0)
}

fn tent(t: f64) -> f64 {
    (1.0 - t.abs()).max(0.0)
}

fn hermite(t: f64) -> f64 {
    let a = t.abs().min(1.0);
    1.0 - a * a * (3.0 - 2.0 * a)
}

fn quintic(t: f64) -> f64 {
    let a = t.abs().min(1.0);
    1.0 - a * a * a * (10.0 - a * (15.0 - 6.0 * a))
}

fn trapezoid(t: f64) -> f64 {
    ((0.75 - t.abs()) * 2.0).clamp(0.0, 1.0)
}

fn mixture(t: f64) -> f64 {
    0.4 * f64::from(u8::from(t.abs() < 0.5)) + 0.6 * tent(t)
}

fn catmull_rom(t: f64) -> f64 {
    match t.abs() {
        a if a < 1.0 => 1.0 - a * a * (2.5 - 1.5 * a),
        a if a < 2.0 => 2.0 - a * (4.0 - a * (2.5 - 0.5 * a)),
        _ => 0.0,
    }
}

/// Every kernel of the study, narrow to wide; then those that break a rule and are shown to say why.
pub fn candidates() -> Vec<Candidate> {
    let new =
        |name, note, library, density, support| Candidate { name, note, library, density, support, concentrate: false };
    vec![
        new("box", "nearest neighbour", of(Kernel::Box), |_| 1.0, 0.5),
        new("shell", "the report's", of(Kernel::Shell), |_| 1.0, 0.5),
        new("trapezoid", "box * box of half the width", None, trapezoid, 0.75),
        new("quintic", "interpolating, C2", None, quintic, 1.0),
        new("hermite", "interpolating, C1: 1 - 3t² + 2t³ for t = 0 to 1", None, hermite, 1.0),
        new("mixture", "box or tent by lot, 2 to 3, on each axis: hermite's variance", None, mixture, 1.0),
        new("tent", "trilinear", of(Kernel::Tent), tent, 1.0),
        new("bspline3", "cubic B-spline", of(Kernel::Bspline3), bspline3, 2.0),
        new("half-tent", "tent of half the width: no partition of unity", None, |t| 2.0 * tent(2.0 * t), 0.5),
        new("catmull-rom", "negative lobes: cannot be sampled as a density", None, catmull_rom, 2.0),
        Candidate {
            concentrate: true,
            ..new("concentrated tent", "tent over weights moved up the gradient: another field", None, tent, 1.0)
        },
    ]
}

impl Candidate {
    /// Nodes and weights per axis of a midpoint rule over the support; the weights sum to 1.
    fn rule(&self, n: usize) -> Vec<(f64, f64)> {
        let at = |i: usize| self.support * ((2 * i + 1) as f64 / n as f64 - 1.0);
        let sum: f64 = (0..n).map(|i| (self.density)(at(i))).sum();
        (0..n).map(|i| (at(i), (self.density)(at(i)) / sum)).collect()
    }

    fn is_shell(&self) -> bool {
        self.library == Some(Kernel::Shell)
    }

    /// Variance of the offset per axis, in voxels².
    pub fn variance(&self) -> f64 {
        if self.is_shell() { 1.0 / 12.0 } else { self.rule(4000).iter().map(|(t, w)| w * t * t).sum() }
    }

    /// How far voxels that rise by 1 each are reproduced as a staircase instead of a ramp: the largest deviation, without a
    /// constant. `None` for the shell, whose field has no values in the ordinary sense.
    pub fn staircase(&self) -> Option<f64> {
        let density = |t: f64| if t.abs() <= self.support { (self.density)(t) } else { 0.0 };
        let at = |x: f64| (-3..=3).map(|i| f64::from(i) * density(x - f64::from(i))).sum::<f64>() - x;
        (!self.is_shell()).then(|| (0..200).map(|n| at((f64::from(n) + 0.5) / 200.0 - 0.5).abs()).fold(0.0, f64::max))
    }

    /// The factor by which the kernel scales a wave of frequency `f` (cycles per voxel).
    pub fn response(&self, f: DVec3) -> f64 {
        if self.is_shell() {
            let x = PI * f.length();
            return if x == 0.0 { 1.0 } else { x.sin() / x };
        }
        let rule = self.rule(4000);
        f.to_array().iter().map(|f| rule.iter().map(|(t, w)| w * (2.0 * PI * f * t).cos()).sum::<f64>()).product()
    }

    /// Offsets in voxels with their shares of the mass.
    fn arms(&self) -> Vec<(DVec3, f64)> {
        if self.is_shell() {
            // A Fibonacci lattice on the sphere of radius half a voxel.
            let n = 1 << 20;
            let golden = PI * (3.0 - 5f64.sqrt());
            return (0..n)
                .map(|k| {
                    let z = 1.0 - (2 * k + 1) as f64 / f64::from(n);
                    let (sin, cos) = (golden * f64::from(k)).sin_cos();
                    let r = (1.0 - z * z).sqrt();
                    (0.5 * DVec3::new(r * cos, r * sin, z), 1.0 / f64::from(n))
                })
                .collect();
        }
        let rule = self.rule(96);
        let mut arms = Vec::with_capacity(rule.len().pow(3));
        for &(z, wz) in &rule {
            for &(y, wy) in &rule {
                arms.extend(rule.iter().map(|&(x, wx)| (DVec3::new(x, y, z), wx * wy * wz)));
            }
        }
        arms
    }
}

/// Positions within a pixel that the footprint tells apart, per axis.
const PHASES: usize = 16;

/// What one voxel of unit mass adds to the pixels around it: under a parallel camera the same for every voxel, up
/// to its position within a pixel.
struct Footprint {
    side: usize,
    reach: usize,
    /// By phase (row, then column), then row, then column of the pixel.
    shares: Vec<f32>,
}

impl Footprint {
    fn new(candidate: &Candidate, grid: &Grid, camera: &Camera) -> Self {
        let to_world = grid.index_to_world().matrix3;
        let m = camera.world_to_pixel();
        let row = |r: usize| DVec3::new(m[r][0], m[r][1], m[r][2]);
        let (right, down) = (row(0), row(1));
        let fine = PHASES as f64;
        let cells: Vec<([i64; 2], f64)> = candidate
            .arms()
            .into_iter()
            .map(|(t, w)| {
                let x = to_world * t;
                let p = DVec2::new(right.dot(x), down.dot(x)) * fine;
                ([p.x.round() as i64, p.y.round() as i64], w)
            })
            .collect();
        let widest = cells.iter().flat_map(|(c, _)| c.map(i64::abs)).max().unwrap_or(0) as usize;
        let reach = widest / PHASES + 1;
        let side = 2 * reach + 1;
        // First the mass by cell, so that the phases below read each cell once instead of every arm.
        let (centre, width) = (widest as i64, 2 * widest + 1);
        let mut table = vec![0.0; width * width];
        for ([x, y], w) in cells {
            table[(x + centre) as usize + width * (y + centre) as usize] += w;
        }
        let mut shares = vec![0.0f32; PHASES * PHASES * side * side];
        shares.par_chunks_mut(side * side).enumerate().for_each(|(phase, shares)| {
            let pixel = |cell: usize, phase: usize| {
                (cell as i64 - centre + phase as i64).div_euclid(PHASES as i64) + reach as i64
            };
            for (n, &w) in table.iter().enumerate().filter(|(_, w)| **w != 0.0) {
                let (x, y) = (pixel(n % width, phase % PHASES), pixel(n / width, phase / PHASES));
                shares[x as usize + side * y as usize] += w as f32;
            }
        });
        Self { side, reach, shares }
    }
}

/// The `line` image of weights on a grid under a kernel, by the footprint: no noise; positions within a pixel are
/// rounded to a sixteenth, offsets to a sixteenth as well.
pub fn splat(candidate: &Candidate, weights: &[f32], grid: &Grid, camera: &Camera) -> Image {
    let footprint = Footprint::new(candidate, grid, camera);
    let [nx, ny, nz] = grid.dims();
    let scale = grid.voxel_volume() * camera.det();
    let extent = camera.extent();
    let (width, height) = (extent.width as i64, extent.height as i64);
    let to_world = grid.index_to_world();
    // A fixed number of parts, so that sums do not depend on the machine.
    let parts: Vec<Image> = (0..4usize)
        .into_par_iter()
        .map(|part| {
            let mut image = Image::zeros(extent);
            for k in (part * nz / 4)..((part + 1) * nz / 4) {
                for j in 0..ny {
                    let row = nx * (j + ny * k);
                    for (i, &w) in weights[row..row + nx].iter().enumerate() {
                        if w == 0.0 {
                            continue;
                        }
                        let centre = to_world.transform_point3(DVec3::new(i as f64, j as f64, k as f64));
                        let (px, py, _) = camera.project(centre);
                        let cell = |p: f64| (p * PHASES as f64).floor() as i64;
                        add(&footprint, &mut image, [cell(px), cell(py)], scale * f64::from(w), [width, height]);
                    }
                }
            }
            image
        })
        .collect();
    let mut sum = Image::zeros(extent);
    for part in parts {
        sum.values_mut().iter_mut().zip(part.values()).for_each(|(a, b)| *a += b);
    }
    sum
}

fn add(footprint: &Footprint, image: &mut Image, cell: [i64; 2], mass: f64, [width, height]: [i64; 2]) {
    let phases = PHASES as i64;
    let [x, y] = cell.map(|c| c.div_euclid(phases));
    let phase = (cell[0].rem_euclid(phases) + phases * cell[1].rem_euclid(phases)) as usize;
    let (side, reach) = (footprint.side, footprint.reach as i64);
    let shares = &footprint.shares[phase * side * side..(phase + 1) * side * side];
    // Columns of the footprint that lie inside the image.
    let from = (reach - x).clamp(0, side as i64) as usize;
    let to = (width - x + reach).clamp(from as i64, side as i64) as usize;
    for (r, row) in shares.chunks(side).enumerate() {
        let line = y + r as i64 - reach;
        if (0..height).contains(&line) && from < to {
            let start = (line * width + x - reach + from as i64) as usize;
            let pixels = &mut image.values_mut()[start..start + to - from];
            pixels.iter_mut().zip(&row[from..to]).for_each(|(p, &s)| *p += mass * f64::from(s));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Weights, distance, exact, parallel};
    use mcvr::scene::View;

    fn few() -> Weights {
        let grid = Grid::with_spacing([7, 6, 5], [1.0, 1.2, 0.9]).expect("a grid");
        let values = (0..grid.len()).map(|n| if n % 3 == 0 { 0.0 } else { (n * 7919 % 97) as f32 });
        Weights { values: values.collect(), grid }
    }

    #[test]
    fn footprints_agree_with_ray_casting_and_keep_the_mass() {
        let weights = few();
        let camera = parallel(View::default(), &weights.grid, 4.0).expect("a camera");
        let mass = weights.values.iter().map(|&w| f64::from(w)).sum::<f64>() * weights.grid.voxel_volume();
        for candidate in candidates() {
            let image = splat(&candidate, &weights.values, &weights.grid, &camera);
            // Every voxel's shares sum to 1 up to the rounding of 32-bit sums over some thousand cells.
            let seen = image.sum() / camera.det();
            assert!((seen / mass - 1.0).abs() < 1e-4, "{}: {seen} of {mass}", candidate.name);
            if let Some(kernel) = candidate.library.filter(|k| *k != Kernel::Shell) {
                let (cast, _) = exact(&weights, kernel, &camera).expect("an image");
                let off = distance(&image, &cast);
                assert!(off < 0.01, "{}: {off}", candidate.name);
                let shell = splat(&candidates()[1], &weights.values, &weights.grid, &camera);
                assert!(distance(&shell, &cast) > 0.05, "the comparison tells kernels apart");
            }
        }
    }
}
