//! The integrand with effects along a piece of a ray in one cell.

use mcvr_scene::effects::Sides;

use crate::line::{horner, horners, powers};
use crate::nested::{Along, LANES};

/// Density, gradient, light and depth colour as polynomials in `x`, which runs over [-1, 1] on the piece.
pub(crate) struct CellIntegrand<const C: usize, const N: usize> {
    /// Density by channel.
    pub density: [[f64; N]; C],
    /// Gradient in the world by component; zero without shading.
    pub gradient: [[f64; 4]; 3],
    /// Vector to the light by component: constant and slope.
    pub light: [[f64; 2]; 3],
    pub shading: Option<Sides>,
    /// Shading may have an edge of shadow here.
    pub kinks: bool,
    /// Smallest distance of the depth cue in mm.
    pub cue: Option<f64>,
    /// Depth colour by channel: constant and slope.
    pub ramp: Option<[[f64; 2]; C]>,
    /// The ray's parameter (constant and slope) when its square weighs the integrand.
    pub squared: Option<[f64; 2]>,
}

/// What shading makes of a cell as a whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Facing {
    /// The factor is 0 everywhere.
    Dark,
    /// It has no kinks.
    Lit,
    /// It may have kinks.
    Mixed,
}

/// Finds cells that shading leaves dark: no gradient, or one-sided and turned away. `gradient` in Bernstein form of
/// degree 3; the light as in [`CellIntegrand::light`].
///
/// A polynomial lies between its Bernstein coefficients; those of `N·L` are the products of the factors'.
#[inline(always)]
pub(crate) fn facing(sides: Sides, gradient: &[[f64; 3]; 4], light: &[[f64; 2]; 3]) -> Facing {
    if gradient.iter().flatten().all(|g| *g == 0.0) {
        return Facing::Dark;
    }
    let dot = |g: &[f64; 3], sign: f64| -> f64 {
        g.iter().zip(light).map(|(g, [constant, slope])| g * (constant + sign * slope)).sum()
    };
    let [near, far] = [-1.0, 1.0].map(|sign| [0, 1, 2, 3].map(|k: usize| dot(&gradient[k], sign)));
    let coefficients = [0, 1, 2, 3, 4].map(|k: usize| {
        let left = if k < 4 { (4 - k) as f64 * near[k] } else { 0.0 };
        let right = if k > 0 { k as f64 * far[k - 1] } else { 0.0 };
        left + right
    });
    let away = coefficients.iter().all(|c| *c >= 0.0);
    if away && sides == Sides::One {
        Facing::Dark
    } else if away || coefficients.iter().all(|c| *c <= 0.0) {
        Facing::Lit
    } else {
        Facing::Mixed
    }
}

/// Components from Bernstein form to powers.
#[inline(always)]
pub(crate) fn components(gradient: &[[f64; 3]; 4]) -> [[f64; 4]; 3] {
    [0, 1, 2].map(|a| powers([gradient[0][a], gradient[1][a], gradient[2][a], gradient[3][a]]))
}

impl<const C: usize, const N: usize> CellIntegrand<C, N> {
    /// Degree in `x` when nothing but polynomials is involved.
    pub fn degree(&self) -> Option<u32> {
        (self.shading.is_none() && self.cue.is_none())
            .then(|| N as u32 - 1 + u32::from(self.ramp.is_some()) + 2 * u32::from(self.squared.is_some()))
    }

    /// `-∇ρ·L`: what changes sign at the edge of shadow.
    #[inline(always)]
    fn towards(&self, x: f64) -> f64 {
        let dot = |(g, [constant, slope]): (&[f64; 4], &[f64; 2])| horner(g, x) * (constant + slope * x);
        -self.gradient.iter().zip(&self.light).map(dot).sum::<f64>()
    }
}

impl<const C: usize, const N: usize> Along<C> for CellIntegrand<C, N> {
    #[inline(always)]
    fn at(&self, x: &[f64; LANES]) -> [[f64; LANES]; C] {
        let mut grey = [1.0; LANES];
        if self.shading.is_some() || self.cue.is_some() {
            let (mut light2, mut gradient2, mut towards) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
            for a in 0..3 {
                let to_light = horners(&self.light[a], x);
                let g = horners(&self.gradient[a], x);
                for i in 0..LANES {
                    light2[i] += to_light[i] * to_light[i];
                }
                for i in 0..LANES {
                    gradient2[i] += g[i] * g[i];
                }
                for i in 0..LANES {
                    towards[i] -= g[i] * to_light[i];
                }
            }
            if let Some(sides) = self.shading {
                let mut scale = [0.0; LANES];
                for i in 0..LANES {
                    scale[i] = (gradient2[i] * light2[i]).sqrt();
                }
                match sides {
                    Sides::One => towards.iter_mut().for_each(|t| *t = if *t > 0.0 { *t } else { 0.0 }),
                    Sides::Two => towards.iter_mut().for_each(|t| *t = t.abs()),
                }
                for i in 0..LANES {
                    // Where the scale is 0 so is the numerator, but for underflow.
                    let divisor = if scale[i] > 0.0 { scale[i] } else { f64::INFINITY };
                    grey[i] = towards[i] / divisor;
                }
            }
            if let Some(minimum) = self.cue {
                for i in 0..LANES {
                    let distance = light2[i].sqrt();
                    grey[i] /= if distance > minimum { distance } else { minimum };
                }
            }
        }
        if let Some(squared) = &self.squared {
            let t = horners(squared, x);
            for i in 0..LANES {
                grey[i] *= t[i] * t[i];
            }
        }
        let mut out = [grey; C];
        for (c, out) in out.iter_mut().enumerate() {
            let density = horners(&self.density[c], x);
            for i in 0..LANES {
                out[i] *= density[i];
            }
            if let Some(ramp) = &self.ramp {
                let colour = horners(&ramp[c], x);
                for i in 0..LANES {
                    out[i] *= colour[i];
                }
            }
        }
        out
    }

    /// The edge of shadow, when it is between the ends: by regula falsi with the Illinois rule.
    fn kink(&self, a: f64, b: f64) -> Option<f64> {
        if !self.kinks {
            return None;
        }
        let (mut low, mut high) = ((a, self.towards(a)), (b, self.towards(b)));
        if low.1 * high.1 >= 0.0 {
            return None;
        }
        // A cut that is off by δ leaves an error of the order of δ².
        let step = 1e-7 * (b - a);
        for _ in 0..60 {
            let x = (low.0 * high.1 - high.0 * low.1) / (high.1 - low.1);
            let v = self.towards(x);
            if v == 0.0 || high.0 - low.0 < step {
                break;
            }
            if v * high.1 > 0.0 {
                if (high.0 - x).abs() < step {
                    break;
                }
                high = (x, v);
                low.1 *= 0.5;
            } else {
                if (x - low.0).abs() < step {
                    break;
                }
                low = (x, v);
                high.1 *= 0.5;
            }
        }
        let x = (low.0 * high.1 - high.0 * low.1) / (high.1 - low.1);
        // A cut next to an end would cut nothing.
        let margin = 1e-9 * (b - a);
        (a + margin < x && x < b - margin).then_some(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_turned_away_are_dark_and_only_those() {
        let light = [[0.0, 0.0], [0.0, 0.0], [5.0, 1.0]];
        let g = |z: [f64; 4]| z.map(|z| [0.3, -0.2, z]);
        let flat = [[0.0; 3]; 4];
        for sides in [Sides::One, Sides::Two] {
            assert_eq!(facing(sides, &flat, &light), Facing::Dark);
            assert_eq!(facing(sides, &g([-1.0, -2.0, -1.0, -3.0]), &light), Facing::Lit);
            assert_eq!(facing(sides, &g([1.0, 2.0, 1.0, -1.0]), &light), Facing::Mixed);
        }
        assert_eq!(facing(Sides::One, &g([1.0, 2.0, 1.0, 3.0]), &light), Facing::Dark);
        assert_eq!(facing(Sides::Two, &g([1.0, 2.0, 1.0, 3.0]), &light), Facing::Lit);
    }

    #[test]
    fn the_edge_of_shadow_is_found() {
        let integrand = CellIntegrand::<1, 4> {
            density: [[1.0, 0.0, 0.0, 0.0]],
            gradient: [[0.0; 4], [0.0; 4], [0.2, -1.0, 0.3, 0.4]],
            light: [[0.0; 2], [0.0; 2], [5.0, 1.0]],
            shading: Some(Sides::One),
            kinks: true,
            cue: None,
            ramp: None,
            squared: None,
        };
        let x = integrand.kink(-1.0, 0.9).unwrap();
        assert!(integrand.towards(x).abs() < 1e-6 && (0.0..0.5).contains(&x), "{x}");
        assert_eq!(integrand.kink(-1.0, 0.0), None);
    }
}
