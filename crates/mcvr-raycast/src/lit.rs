//! A field seen with effects: the walk of a ray through its cells, and the adaptive integral on the way.

use glam::{DMat3, DVec3};
use mcvr_scene::effects::Look;
use mcvr_scene::{Camera, Density, Kernel, power_of_two};

use crate::adaptive::Integrand;
use crate::cell::Piece;
use crate::factor::{CellIntegrand, Facing, components, facing};
use crate::field::with_field;
use crate::line::{Fit, powers, spline, trilinear};
use crate::neighbours::{MakeNeighbours, Neighbours, Stencil, corner};
use crate::nested::{Aim, Tally, integrate};
use crate::view::{IndexRay, View, WorldRay};
use crate::walk::Walk;
use crate::{Counters, ReferenceOptions};

/// Share of the pixel's tolerance that goes to the error along the rays. Small, so that what the rays' errors do to the
/// pixel's own estimate cannot set off refinement.
const RAY_SHARE: f64 = 0.05;

/// A density with a look, for one camera and estimand: `C` channels, a density of `N` coefficients along a line in a cell.
///
/// Cells lie between voxel centres for every kernel, since that is where the gradient is one polynomial; `box` is cut at
/// the half planes as well. Cell coordinates are index coordinates plus 1, or plus 2 for the B-spline, and the stencil of
/// cell c starts at voxel c − 2 or c − 3.
pub(crate) struct LitField<'a, const C: usize, const N: usize> {
    neighbours: Box<dyn Neighbours + 'a>,
    walk: Walk,
    look: &'a Look,
    kernel: Kernel,
    view: View,
    /// From differences per voxel to the gradient per mm in the world, up to a factor.
    to_gradient: DMat3,
    /// Depths at which the ramp has a kink.
    stops: Vec<f64>,
    fit: Fit<N>,
    /// The processor has AVX2.
    #[cfg(target_arch = "x86_64")]
    wide: bool,
}

/// Added to an index to get cell coordinates.
fn shift(kernel: Kernel) -> i32 {
    if kernel == Kernel::Bspline3 { 2 } else { 1 }
}

/// A ray on its way.
struct Ray<'r, const C: usize> {
    index: &'r IndexRay,
    world: WorldRay,
    /// Parameter at which the ray enters, and the error allowed per unit of it.
    start: f64,
    rate: f64,
    tally: Tally<C>,
    /// Ends of the segments of a piece, in `x`.
    cuts: Vec<f64>,
    stencil: Stencil,
}

impl<'a, const C: usize, const N: usize> LitField<'a, C, N> {
    /// Scans the voxels once for the brick map.
    pub fn new(density: &'a Density, camera: &Camera, look: &'a Look, options: &ReferenceOptions) -> Self {
        let (kernel, volume) = (options.kernel, density.volume());
        let shift = shift(kernel);
        let palette = look.palette.as_ref();
        // Only directions count: over a power of two near the weights' sum, so that squares neither overflow nor vanish.
        let unit = power_of_two((-61 - density.report().unit_exponent()).clamp(-900, 900));
        let (neighbours, walk) = with_field(density, MakeNeighbours { volume, palette, taps: 2 * shift as usize });
        let stops = look.ramp.as_ref().map_or_else(Vec::new, |ramp| {
            let ([near, far], last) = (ramp.range(), ramp.stops().len() - 1);
            (0..=last).map(|n| near + (far - near) * n as f64 / last as f64).collect()
        });
        Self {
            neighbours,
            walk,
            look,
            kernel,
            view: View::new(camera, volume.grid(), options.estimand, density.mass(), f64::from(shift)),
            to_gradient: volume.grid().world_to_index().matrix3.transpose() * unit,
            stops,
            fit: Fit::new(),
            #[cfg(target_arch = "x86_64")]
            wide: std::arch::is_x86_feature_detected!("avx2"),
        }
    }

    pub fn view(&self) -> &View {
        &self.view
    }

    /// The box around all density, in index coordinates.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let shift = f64::from(shift(self.kernel));
        (self.walk.low.map(|v| v - shift), self.walk.high.map(|v| v - shift))
    }

    /// Adds the integral over one cell.
    #[inline]
    fn cell(&self, ray: &mut Ray<'_, C>, cell: [i32; 3], piece: &Piece, counters: &mut Counters) {
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` says that the processor has AVX2.
            return unsafe { self.cell_wide(ray, cell, piece, counters) };
        }
        self.cell_any(ray, cell, piece, counters);
    }

    /// [`Self::cell_any`] compiled for wide vectors: the same operations in the same order, hence the same bits.
    ///
    /// # Safety
    /// The processor must have AVX2.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    unsafe fn cell_wide(&self, ray: &mut Ray<'_, C>, cell: [i32; 3], piece: &Piece, counters: &mut Counters) {
        self.cell_any(ray, cell, piece, counters);
    }

    #[inline(always)]
    fn cell_any(&self, ray: &mut Ray<'_, C>, cell: [i32; 3], piece: &Piece, counters: &mut Counters) {
        let first = cell.map(|c| c - 1 - shift(self.kernel));
        let wide = self.kernel == Kernel::Bspline3;
        if !self.neighbours.density(first, wide, &mut ray.stencil, counters) {
            return;
        }
        counters.cells += 1;
        let (middle, half) = (0.5 * (piece.from + piece.to), 0.5 * (piece.to - piece.from));
        let at = |t: f64| -> [f64; 3] { std::array::from_fn(|a| piece.local[a] + t * piece.step[a]) };
        let (p, q) = (at(piece.from), at(piece.to));
        let to_light = self.look.light.unwrap_or(DVec3::ZERO) - (ray.world.origin + ray.world.direction * middle);
        let slope = ray.world.direction * -half;
        let light = [0, 1, 2].map(|a| [to_light[a], slope[a]]);
        let (mut gradient, mut kinks) = ([[0.0; 4]; 3], false);
        if let Some(sides) = self.look.shading {
            if !wide {
                self.neighbours.surround(first, &mut ray.stencil, counters);
            }
            let differences = ray.stencil.differences();
            let along = trilinear(&differences.map(|[x, y, z]| [x, y, z, 0.0]), p, q);
            let along = along.map(|[x, y, z, _]| (self.to_gradient * DVec3::new(x, y, z)).to_array());
            let facing = facing(sides, &along, &light);
            if facing == Facing::Dark {
                return;
            }
            kinks = facing == Facing::Mixed;
            gradient = components(&along);
        }
        let mut integrand = CellIntegrand::<C, N> {
            density: self.densities(&ray.stencil, p, q),
            gradient,
            light,
            shading: self.look.shading,
            kinks,
            cue: self.look.cue_minimum,
            ramp: None,
            squared: self.view.squared().then_some([middle, half]),
        };
        self.cut(ray, piece, (p, q));
        let budget = ray.rate * (piece.to - ray.start);
        for n in 1..ray.cuts.len() {
            let (a, b) = (ray.cuts[n - 1], ray.cuts[n]);
            if self.kernel == Kernel::Box {
                integrand.density = self.nearest(&ray.stencil, p, q, 0.5 * (a + b));
            }
            if integrand.density.iter().flatten().all(|c| *c == 0.0) {
                continue;
            }
            if let Some(ramp) = &self.look.ramp {
                // Straight between the stops: the colours at a quarter and at three quarters say it all, and lie
                // clear of the stops.
                let [x, y] = [0.25, 0.75].map(|s| a + s * (b - a));
                let [u, v] = [x, y].map(|x| ramp.colour(ray.world.depth + middle + half * x));
                integrand.ramp = Some(std::array::from_fn(|c| {
                    let slope = (v[c] - u[c]) / (y - x);
                    [u[c] - slope * x, slope]
                }));
            }
            let aim = integrand.degree().map_or(Aim::Error(budget), Aim::Polynomial);
            let before = ray.tally.points;
            integrate(&integrand, (a, b), half, aim, &mut ray.tally);
            let points = ray.tally.points - before;
            counters.evaluations += points;
            counters.gradients += if self.look.shading.is_some() { points } else { 0 };
        }
    }

    /// Ends of the segments on which the integrand has no kinks but those of shading and of the cue's minimum.
    #[inline(always)]
    fn cut(&self, ray: &mut Ray<'_, C>, piece: &Piece, (p, q): ([f64; 3], [f64; 3])) {
        let cuts = &mut ray.cuts;
        cuts.clear();
        cuts.push(-1.0);
        if self.kernel == Kernel::Box {
            for a in 0..3 {
                cuts.push((1.0 - p[a] - q[a]) / (q[a] - p[a]));
            }
        }
        for stop in &self.stops {
            let t = stop - ray.world.depth;
            cuts.push((2.0 * t - piece.from - piece.to) / (piece.to - piece.from));
        }
        cuts.retain(|x| (-1.0..1.0).contains(x));
        cuts.push(1.0);
        cuts.sort_unstable_by(f64::total_cmp);
        cuts.dedup();
    }

    /// Densities between `p` and `q`. For `box` they follow later, segment by segment.
    #[inline(always)]
    fn densities(&self, stencil: &Stencil, p: [f64; 3], q: [f64; 3]) -> [[f64; N]; C] {
        let mut out = [[0.0; N]; C];
        let tinted = self.look.palette.is_some();
        let weights = |c: usize| if tinted { &stencil.tinted[c] } else { &stencil.weights };
        match self.kernel {
            Kernel::Box => return out,
            Kernel::Bspline3 => {
                for (c, out) in out.iter_mut().enumerate().take(if tinted { 3 } else { 1 }) {
                    *out = self.fit.through(self.fit.points.map(|x| {
                        let at = std::array::from_fn(|a| 0.5 * (p[a] + q[a] + x * (q[a] - p[a])));
                        spline(weights(c), at)
                    }));
                }
            }
            Kernel::Tent | Kernel::Shell => {
                let mut corners = [[0.0; 4]; 8];
                for (n, values) in corners.iter_mut().enumerate() {
                    let at = corner(n);
                    values[0] = weights(0)[at];
                    if tinted {
                        values[1] = weights(1)[at];
                        values[2] = weights(2)[at];
                    }
                }
                let b = trilinear(&corners, p, q);
                for (c, out) in out.iter_mut().enumerate() {
                    for (o, v) in out.iter_mut().zip(powers([b[0][c], b[1][c], b[2][c], b[3][c]])) {
                        *o = v;
                    }
                }
            }
        }
        if !tinted {
            out = [out[0]; C];
        }
        out
    }

    /// The density of the voxel nearest to the ray at `x`.
    #[inline(always)]
    fn nearest(&self, stencil: &Stencil, p: [f64; 3], q: [f64; 3], x: f64) -> [[f64; N]; C] {
        let bit = |a: usize| usize::from(0.5 * (p[a] + q[a] + x * (q[a] - p[a])) >= 0.5) << a;
        let at = corner(bit(0) | bit(1) | bit(2));
        let mut out = [[0.0; N]; C];
        for (c, out) in out.iter_mut().enumerate() {
            out[0] = if self.look.palette.is_some() { stencil.tinted[c][at] } else { stencil.weights[at] };
        }
        out
    }
}

impl<const C: usize, const N: usize> Integrand<C> for LitField<'_, C, N> {
    fn ray_share(&self) -> f64 {
        // Without shading and cue the integrand is a polynomial in every segment.
        if self.look.shading.is_none() && self.look.cue_minimum.is_none() { 0.0 } else { RAY_SHARE }
    }

    fn at(&self, px: f64, py: f64, tolerance: f64, counters: &mut Counters) -> ([f64; C], [f64; C]) {
        let (index, factor) = self.view.ray(px, py);
        counters.rays += 1;
        let Some((from, to)) = index.clip(self.walk.low, self.walk.high) else { return ([0.0; C], [0.0; C]) };
        let mut ray = Ray {
            index: &index,
            world: self.view.world(px, py),
            start: from,
            rate: tolerance / (factor * (to - from)),
            tally: Tally { sum: [0.0; C], error: [0.0; C], points: 0 },
            cuts: Vec::new(),
            stencil: Stencil::default(),
        };
        self.walk.bricks(&index, from..to, counters, |brick, range, counters| {
            Walk::cells(ray.index, brick, range, |cell, piece| self.cell(&mut ray, cell, piece, counters));
        });
        (ray.tally.sum.map(|v| v * factor), ray.tally.error.map(|e| e * factor))
    }
}

#[cfg(test)]
mod tests;
