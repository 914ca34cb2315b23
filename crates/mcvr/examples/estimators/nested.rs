//! A volume as a sum of nested grids: `ρ = ρ_coarse + ρ_residual`, exactly, under the kernel `tent`.
//!
//! The nodes of the coarse grid are the even nodes of the fine one, so the coarse field, linear between its nodes, is the tent
//! of its own values at the fine nodes: exactly so in whole numbers, for these are eighths of sums of eight coarse weights. It fades to 0
//! one coarse spacing outside its last node, which is up to one fine node beyond the fine grid; the residual has these nodes too.
//!
//! Any coarse weights make the sum exact. Two rules are tried, and that with the smaller `κ = Σ|w − w_c| / Σw` is taken: every second
//! weight, and the least squares of the residual, which is separable: a tridiagonal system along each axis.

use mcvr::scene::{Density, DensityMap};
use mcvr::volume::{Grid, Volume};

use crate::Outcome;

/// Levels above the volume itself: factors 2, 4 and 8.
pub const DEPTH: usize = 3;

/// Coarse weights are eighths in the residual, which is stored in 16 bits.
const LARGEST: f64 = 8191.0;

/// Whole weights on a grid.
pub struct Level {
    pub grid: Grid,
    pub weights: Vec<u16>,
}

/// The positive and the negative part of what a coarse grid leaves, in eighths.
pub struct Residual {
    pub parts: [Option<Density>; 2],
    /// Sum of the absolute residual over that of the finer level.
    pub kappa: f64,
    /// Share of the voxels that are not 0.
    pub filled: f64,
}

/// A volume, its coarser grids, and the residuals between neighbours.
pub struct Chain {
    pub levels: Vec<Level>,
    /// Densities of the coarser grids, finest first, in units.
    pub coarse: Vec<Density>,
    pub residuals: Vec<Residual>,
    /// Weight that a whole number of 1 stands for.
    pub unit: f64,
}

impl Chain {
    pub fn new(density: &Density, unit: f64, depth: usize) -> Outcome<Self> {
        let levels = if depth > 0 { vec![whole(density, unit)?] } else { vec![] };
        let mut chain = Self { levels, coarse: vec![], residuals: vec![], unit };
        for _ in 0..depth {
            let Some(fine) = chain.levels.last() else { break };
            let tried = [coarsen(fine, false)?, coarsen(fine, true)?].map(|c| (absolute(fine, &c), c));
            let [every, fitted] = tried;
            let (_, coarse) = if every.0 <= fitted.0 { every } else { fitted };
            chain.residuals.push(residual(fine, &coarse)?);
            let made = density_of(coarse.grid.clone(), coarse.weights.clone())?;
            chain.coarse.push(made.ok_or("the coarse grid holds nothing")?);
            chain.levels.push(coarse);
        }
        Ok(chain)
    }

    /// One line a level for the page.
    pub fn facts(&self) -> Vec<String> {
        let line = |(l, r): (usize, &Residual)| {
            format!("factor {}: κ {:.3}, {:.1} % of the residual not 0", 2 << l, r.kappa, 100.0 * r.filled)
        };
        self.residuals.iter().enumerate().map(line).collect()
    }
}

/// A density of stored weights, `None` when all are 0.
pub fn density_of(grid: Grid, weights: Vec<u16>) -> Outcome<Option<Density>> {
    if weights.iter().all(|w| *w == 0) {
        return Ok(None);
    }
    let density = Density::new(&Volume::from_vec(grid, weights, "level")?, DensityMap::default())?;
    density.occupancy();
    Ok(Some(density))
}

/// The weights of a density as whole numbers of a unit.
pub fn whole(density: &Density, unit: f64) -> Outcome<Level> {
    let largest = density.report().max_weight / unit;
    if largest > LARGEST {
        return Err(format!("the largest weight is {largest} units, the residual holds {LARGEST}").into());
    }
    let lookup = density.lookup();
    let weights: Vec<u16> = mcvr::volume::with_voxels!(density.volume().voxels(), v => {
        use mcvr::scene::WeightFn;
        v.iter().map(|s| (lookup.weight(*s) / unit).round() as u16).collect()
    });
    Ok(Level { grid: density.volume().grid().clone(), weights })
}

/// The grid of every second node, with weights by one of the two rules.
pub fn coarsen(fine: &Level, fitted: bool) -> Outcome<Level> {
    let [nx, ny, nz] = fine.grid.dims();
    let [kx, ky, kz] = [nx, ny, nz].map(|n| n.div_ceil(2));
    let spacing = 2.0 * fine.grid.spacing();
    let grid = Grid::new([kx, ky, kz], spacing, fine.grid.origin(), fine.grid.direction())?;
    let weights = if fitted {
        let w: Vec<f32> = fine.weights.iter().map(|w| f32::from(*w)).collect();
        let w = fit(&w, ny * nz, nx, 1);
        let w = fit(&w, nz, ny, kx);
        // A Rust cast saturates: what the fit makes negative becomes 0.
        fit(&w, 1, nz, kx * ky).into_iter().map(|w| w.round().min(LARGEST as f32) as u16).collect()
    } else {
        let at = |z: usize, y: usize| (0..kx).map(move |x| fine.weights[2 * x + nx * (2 * y + ny * 2 * z)]);
        (0..kz).flat_map(|z| (0..ky).flat_map(move |y| at(z, y))).collect()
    };
    Ok(Level { grid, weights })
}

/// Least squares along the middle axis of `outer` by `n` by `inner` values: every second node's tent of twice the width.
fn fit(values: &[f32], outer: usize, n: usize, inner: usize) -> Vec<f32> {
    let k = n.div_ceil(2);
    let mut out = vec![0f32; outer * k * inner];
    // The tents' products: 3/2 with themselves, 1/4 with their neighbours.
    let mut back = vec![0f32; k];
    for (source, out) in values.chunks_exact(n * inner).zip(out.chunks_exact_mut(k * inner)) {
        for j in 0..k {
            let m = 1.0 / (1.5 - 0.25 * if j > 0 { back[j - 1] } else { 0.0 });
            back[j] = 0.25 * m;
            let (before, rest) = out.split_at_mut(j * inner);
            for (i, o) in rest[..inner].iter_mut().enumerate() {
                let mut b = source[2 * j * inner + i];
                b += if j > 0 { 0.5 * source[(2 * j - 1) * inner + i] } else { 0.0 };
                b += if 2 * j + 1 < n { 0.5 * source[(2 * j + 1) * inner + i] } else { 0.0 };
                *o = m * (b - if j > 0 { 0.25 * before[(j - 1) * inner + i] } else { 0.0 });
            }
        }
        for j in (0..k - 1).rev() {
            let (before, after) = out.split_at_mut((j + 1) * inner);
            for (o, a) in before[j * inner..].iter_mut().zip(after) {
                *o -= back[j] * *a;
            }
        }
    }
    out
}

/// Twice the coarse weights at the fine nodes along the middle axis, from one node before the first coarse one to one after the last.
fn spread(values: &[i32], outer: usize, k: usize, inner: usize) -> Vec<i32> {
    let wide = 2 * k + 1;
    let mut out = vec![0; outer * wide * inner];
    for (source, out) in values.chunks_exact(k * inner).zip(out.chunks_exact_mut(wide * inner)) {
        for (j, row) in source.chunks_exact(inner).enumerate() {
            for (share, offset) in [(1, 0), (2, 1), (1, 2)] {
                for (o, v) in out[(2 * j + offset) * inner..][..inner].iter_mut().zip(row) {
                    *o += share * v;
                }
            }
        }
    }
    out
}

/// Calls `each` with every padded plane's residual in eighths.
fn planes(fine: &Level, coarse: &Level, mut each: impl FnMut(&[i32])) {
    let [nx, ny, nz] = fine.grid.dims();
    let [kx, ky, kz] = coarse.grid.dims();
    let [ex, ey, ez] = [kx, ky, kz].map(|k| 2 * k + 1);
    let whole: Vec<i32> = coarse.weights.iter().map(|w| i32::from(*w)).collect();
    let spread_y = spread(&spread(&whole, ky * kz, kx, 1), kz, ky, ex);
    let plane = |k: usize| spread_y.get(k * ex * ey..(k + 1) * ex * ey);
    let mut out = vec![0i32; ex * ey];
    for z in 0..ez {
        out.fill(0);
        let pair = if z % 2 == 1 { [Some(z / 2), Some(z / 2)] } else { [(z / 2).checked_sub(1), Some(z / 2)] };
        for row in pair.into_iter().flatten().filter_map(plane) {
            for (o, v) in out.iter_mut().zip(row) {
                *o -= v;
            }
        }
        for y in (0..ny).filter(|_| (1..=nz).contains(&z)) {
            let source = &fine.weights[nx * (y + ny * (z - 1))..][..nx];
            for (o, w) in out[ex * (y + 1) + 1..].iter_mut().zip(source) {
                *o += 8 * i32::from(*w);
            }
        }
        each(&out);
    }
}

/// Sum of the absolute residual, in eighths.
fn absolute(fine: &Level, coarse: &Level) -> u64 {
    let mut sum = 0;
    planes(fine, coarse, |p| sum += p.iter().map(|v| u64::from(v.unsigned_abs())).sum::<u64>());
    sum
}

/// What the coarse level leaves of the fine one, on the fine grid with a node more on each side.
pub fn residual(fine: &Level, coarse: &Level) -> Outcome<Residual> {
    let dims = coarse.grid.dims().map(|k| 2 * k + 1);
    let origin = fine.grid.index_to_world().transform_point3(glam::DVec3::splat(-1.0));
    let grid = Grid::new(dims, fine.grid.spacing(), origin, fine.grid.direction())?;
    let mut parts = [Vec::with_capacity(grid.len()), Vec::with_capacity(grid.len())];
    let [plus, minus] = &mut parts;
    planes(fine, coarse, |p| {
        plus.extend(p.iter().map(|v| (*v).clamp(0, 65535) as u16));
        minus.extend(p.iter().map(|v| (-*v).clamp(0, 65535) as u16));
    });
    let all: u64 = parts.iter().flatten().map(|v| u64::from(*v)).sum();
    let filled = parts.iter().flatten().filter(|v| **v != 0).count() as f64 / grid.len() as f64;
    let fine_sum: u64 = fine.weights.iter().map(|v| u64::from(*v)).sum();
    let [plus, minus] = parts;
    let parts = [density_of(grid.clone(), plus)?, density_of(grid, minus)?];
    Ok(Residual { parts, kappa: all as f64 / (8 * fine_sum.max(1)) as f64, filled })
}
