//! Effects made ready for one grid and one camera.

use glam::DVec3;
use mcvr_volume::Grid;
use serde::Serialize;

use super::{Effects, Sides};
use crate::{Camera, Kernel, SceneError};

/// Colours by isovalue: half-open ranges in rising order, and the colour elsewhere.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Palette {
    ranges: Vec<(f64, f64, [f64; 3])>,
    elsewhere: [f64; 3],
}

impl Palette {
    /// The colour of a voxel.
    pub fn colour(&self, isovalue: f64) -> [f64; 3] {
        let i = self.ranges.partition_point(|r| r.0 <= isovalue);
        match i.checked_sub(1).map(|i| self.ranges[i]) {
            Some((_, to, colour)) if isovalue < to => colour,
            _ => self.elsewhere,
        }
    }
}

/// Colours by depth: straight lines between evenly spaced stops.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthRamp {
    range: [f64; 2],
    stops: Vec<[f64; 3]>,
}

impl DepthRamp {
    /// At least two stops over a rising range of depths in mm.
    pub(super) fn new(range: [f64; 2], stops: Vec<[f64; 3]>) -> Self {
        Self { range, stops }
    }

    /// Depths (mm) of the first and the last stop.
    pub fn range(&self) -> [f64; 2] {
        self.range
    }

    /// The stops' colours.
    pub fn stops(&self) -> &[[f64; 3]] {
        &self.stops
    }

    /// The colour at a depth in mm.
    pub fn colour(&self, depth: f64) -> [f64; 3] {
        let last = self.stops.len() - 1;
        let share = (depth - self.range[0]) / (self.range[1] - self.range[0]);
        // Colours end in fixed point, so NaN (a depth or a range that is no number) is the first one.
        let t = if share > 0.0 { share.min(1.0) } else { 0.0 } * last as f64;
        let i = (t as usize).min(last - 1);
        let f = t - i as f64;
        if f == 1.0 {
            return self.stops[i + 1];
        }
        // Rounding may leave a colour just beyond its stops.
        let mix = |a: f64, b: f64| (a + f * (b - a)).clamp(a.min(b), a.max(b));
        // Written out: in a loop over samples a closure over an array may become a call.
        let (a, b) = (self.stops[i], self.stops[i + 1]);
        [mix(a[0], b[0]), mix(a[1], b[1]), mix(a[2], b[2])]
    }
}

/// The effects of a scene for one grid and camera.
///
/// The integrand of channel `c` is `ρ_c(x) · factor_c(x)` with `ρ_c = Σ w_i palette_c(v_i) K(x - c_i)`, and the finished
/// channel is [`Look::tint`]`[c]` times its integral. With neither palette nor ramp there is one channel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Look {
    /// World position of the light (mm); `None` when no effect needs it.
    pub light: Option<DVec3>,
    /// Shading, and whether it is one- or two-sided.
    pub shading: Option<Sides>,
    /// Depth cue, and its smallest distance in mm.
    pub cue_minimum: Option<f64>,
    /// Colours of the drawn voxels.
    pub palette: Option<Palette>,
    /// Colours by depth.
    pub ramp: Option<DepthRamp>,
    /// Factor on the finished image: the light's colour times its intensity, when shading is on; else 1.
    pub tint: [f64; 3],
}

impl Effects {
    /// The effects for one grid and camera.
    ///
    /// # Errors
    /// [`SceneError::Effects`] when a parameter is unusable, or the light is to be at the eye of a parallel camera.
    pub fn look(&self, grid: &Grid, camera: &Camera) -> Result<Look, SceneError> {
        self.check()?;
        let lit = self.shading.is_some() || self.depth_cue.is_some();
        let palette = (!self.materials.is_empty()).then(|| {
            let mut ranges: Vec<_> = self
                .materials
                .iter()
                .map(|m| {
                    let (from, to) = m.range();
                    (from, to, m.colour.rgb())
                })
                .collect();
            ranges.sort_by(|a, b| a.0.total_cmp(&b.0));
            Palette { ranges, elsewhere: self.unlisted.unwrap_or_default().colour.rgb() }
        });
        Ok(Look {
            light: if lit { Some(self.light.place(grid, camera)?) } else { None },
            shading: self.shading.map(|s| s.sides),
            cue_minimum: self.depth_cue.map(|c| c.minimum.unwrap_or(0.01 * grid.diameter())),
            palette,
            ramp: self.depth_colour.as_ref().map(|d| d.ramp(grid, camera)),
            tint: match self.shading {
                Some(_) => self.light.colour.rgb().map(|c| c * self.light.intensity),
                None => [1.0; 3],
            },
        })
    }
}

impl Look {
    /// The plain X-ray.
    pub fn plain() -> Self {
        Self { light: None, shading: None, cue_minimum: None, palette: None, ramp: None, tint: [1.0; 3] }
    }

    /// True when every factor is 1.
    pub fn is_plain(&self) -> bool {
        self.shading.is_none() && self.cue_minimum.is_none() && self.palette.is_none() && self.ramp.is_none()
    }

    /// Channels to integrate: 3 with a palette or a ramp, else 1.
    pub fn channels(&self) -> usize {
        if self.palette.is_some() || self.ramp.is_some() { 3 } else { 1 }
    }

    /// True when the finished image has three different channels.
    pub fn is_coloured(&self) -> bool {
        self.channels() == 3 || self.tint.iter().any(|t| *t != self.tint[0])
    }

    /// Lambert's factor for a gradient (any finite length) at a world position: 0 for no gradient, or with the light there.
    pub fn lambert(&self, sides: Sides, x: DVec3, gradient: DVec3) -> f64 {
        let to_light = self.light.unwrap_or(DVec3::ZERO) - x;
        // The largest component first, so that squares neither overflow nor vanish.
        let largest = gradient.abs().max_element();
        let normal = gradient / largest;
        let scale = (normal.length_squared() * to_light.length_squared()).sqrt();
        if largest == 0.0 || scale == 0.0 || !largest.is_finite() {
            return 0.0;
        }
        let cosine = -normal.dot(to_light) / scale;
        match sides {
            Sides::One => cosine.max(0.0),
            Sides::Two => cosine.abs(),
        }
    }

    /// The depth cue at a world position, in 1/mm.
    pub fn cue(&self, minimum: f64, x: DVec3) -> f64 {
        1.0 / (self.light.unwrap_or(DVec3::ZERO) - x).length().max(minimum)
    }

    /// A bound that no sample's depth cue exceeds, in 1/mm: from the distance between the light and the box of all samples of a
    /// grid under a kernel. 1 without a depth cue.
    pub fn largest_cue(&self, grid: &Grid, kernel: Kernel) -> f64 {
        let (Some(minimum), Some(light)) = (self.cue_minimum, self.light) else { return 1.0 };
        let at = grid.world_to_index().transform_point3(light);
        let low = DVec3::splat(-kernel.support());
        let high = DVec3::from_array(grid.dims().map(|n| n as f64)) - 1.0 + kernel.support();
        let beyond = (low - at).max(at - high).max(DVec3::ZERO);
        // Planes one index apart are 1 / |row of the map to indices| mm apart; the farthest pair of sides bounds the distance.
        let to_index = grid.world_to_index().matrix3;
        let nearest = (0..3).map(|a| beyond[a] / to_index.row(a).length()).fold(0.0, f64::max);
        (1.0 + 1e-9) / nearest.max(minimum)
    }

    /// Factor of each channel at a world position (mm) of known depth (mm), without palette and tint; with one channel all
    /// three are equal. `gradient` is called only when shading is on.
    pub fn factor(&self, x: DVec3, depth: f64, gradient: impl FnOnce() -> DVec3) -> [f64; 3] {
        let mut grey = 1.0;
        if let Some(minimum) = self.cue_minimum {
            grey *= self.cue(minimum, x);
        }
        if let Some(sides) = self.shading {
            grey *= self.lambert(sides, x, gradient());
        }
        match &self.ramp {
            Some(ramp) => ramp.colour(depth).map(|c| c * grey),
            None => [grey; 3],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{Colour, DepthColour, DepthCue, Light, LightPosition, Material, Shading};
    use crate::{Extent, View};

    fn grid() -> Grid {
        Grid::with_spacing([10, 10, 10], [1.0; 3]).unwrap()
    }

    fn camera(parallel: bool) -> Camera {
        Camera::look(&View { parallel, ..View::default() }, &grid(), Extent::new(8, 8).unwrap()).unwrap()
    }

    fn material(from: f64, to: f64, colour: &str) -> Material {
        Material { name: None, from: Some(from), to: Some(to), colour: colour.parse().unwrap(), weight: 2.0 }
    }

    #[test]
    fn shading_and_cue_have_their_textbook_values() {
        let light = Light { position: LightPosition::World([0.0, 0.0, 10.0]), ..Light::default() };
        let effects = Effects {
            light,
            shading: Some(Shading::default()),
            depth_cue: Some(DepthCue { minimum: Some(4.0) }),
            ..Effects::default()
        };
        let look = effects.look(&grid(), &camera(false)).unwrap();
        // Density falls towards the light: the surface faces it.
        let at = |g: DVec3, x: DVec3| look.factor(x, 1.0, || g)[0];
        assert_eq!(at(DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO), 0.1);
        assert!((at(DVec3::new(0.0, 2.0, -2.0), DVec3::ZERO) - 0.1 * 0.5f64.sqrt()).abs() < 1e-15);
        assert_eq!(at(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO), 0.0);
        assert_eq!(at(DVec3::ZERO, DVec3::ZERO), 0.0);
        assert_eq!(at(DVec3::NEG_Z, DVec3::new(0.0, 0.0, 9.0)), 0.25);
        assert_eq!(at(DVec3::NEG_Z, DVec3::new(0.0, 0.0, 10.0)), 0.0);
    }

    #[test]
    fn no_sample_has_a_larger_cue_than_the_bound() {
        let turn = glam::DMat3::from_rotation_z(0.7) * glam::DMat3::from_rotation_x(0.4);
        let grid = Grid::new([9, 7, 5], DVec3::new(0.5, 1.0, 2.0), DVec3::new(3.0, -2.0, 1.0), turn).unwrap();
        let bounds = |light: DVec3| {
            let look = Look { light: Some(light), cue_minimum: Some(0.5), ..Look::plain() };
            let at_corners = grid.corners(1.0).into_iter().map(|x| look.cue(0.5, x)).fold(0.0, f64::max);
            (at_corners, look.largest_cue(&grid, Kernel::Tent))
        };
        // From outside a corner is not far behind the nearest point of the box; within it nothing bounds but the minimum.
        let (largest, bound) = bounds(DVec3::new(40.0, 3.0, 1.0));
        assert!(largest <= bound && largest > 0.3 * bound, "{largest} {bound}");
        assert_eq!(bounds(grid.centre()).1, (1.0 + 1e-9) / 0.5);
        assert_eq!(Look::plain().largest_cue(&grid, Kernel::Tent), 1.0);
    }

    #[test]
    fn a_light_at_the_eye_needs_an_eye() {
        let effects = Effects { shading: Some(Shading::default()), ..Effects::default() };
        let message = effects.look(&grid(), &camera(true)).unwrap_err().to_string();
        assert!(message.contains("parallel"), "{message}");
        assert_eq!(effects.look(&grid(), &camera(false)).unwrap().light, camera(false).eye());
    }

    #[test]
    fn hues_run_from_red_to_blue_over_the_volume() {
        let effects = Effects { depth_colour: Some(DepthColour::default()), ..Effects::default() };
        let ramp = effects.look(&grid(), &camera(false)).unwrap().ramp.unwrap();
        let [near, far] = ramp.range();
        assert_eq!(ramp.colour(near - 1.0), [1.0, 0.0, 0.0]);
        assert_eq!(ramp.colour(far + 1.0), [0.0, 0.0, 1.0]);
        let middle = ramp.colour(0.5 * (near + far));
        assert!(middle.iter().zip([0.0, 1.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{middle:?}");
        let eighth = ramp.colour(near + 0.125 * (far - near));
        assert!((eighth[0] - 1.0).abs() < 1e-12 && (eighth[1] - 0.5).abs() < 1e-12);
    }

    #[test]
    fn materials_may_touch_and_leave_gaps_but_not_overlap() {
        let effects = |b: f64| Effects {
            materials: vec![material(b, 30.0, "#0000ff"), material(10.0, 20.0, "#ff0000")],
            ..Effects::default()
        };
        let message = effects(15.0).check().unwrap_err().to_string();
        assert!(message.contains("overlap") && message.contains("10..20"), "{message}");
        let touching = effects(20.0);
        let look = touching.look(&grid(), &camera(false)).unwrap();
        let palette = look.palette.as_ref().unwrap();
        assert_eq!(palette.colour(19.99), [1.0, 0.0, 0.0]);
        assert_eq!(palette.colour(20.0), [0.0, 0.0, 1.0]);
        assert_eq!(palette.colour(30.0), Colour::WHITE.rgb());
        let gains = effects(25.0).gains().unwrap();
        assert_eq!([5.0, 10.0, 22.0, 25.0, 30.0].map(|v| gains.at(v)), [0.0, 2.0, 0.0, 2.0, 0.0]);
        assert_eq!((look.channels(), look.is_coloured()), (3, true));
    }
}
