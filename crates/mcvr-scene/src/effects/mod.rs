//! Effects on top of the plain X-ray (METHOD section 5): what a scene may ask for, and the factor each puts on the
//! integrand.
//!
//! [`Effects`] is what a scene file says. [`Effects::look`] turns it into a [`Look`] for one grid and camera: positions
//! in world millimetres, and nothing left to decide per sample. [`Look::factor`] and [`gradient()`] are the definitions,
//! in plain `f64`; the samplers' vector code and the ray caster are tested against them.

mod colour;
mod depth;
mod gradient;
mod light;
mod look;
mod material;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use colour::Colour;
pub use depth::DepthColour;
pub use gradient::gradient;
pub use light::{Light, LightPosition};
pub use look::{DepthRamp, Look, Palette};
pub use material::{Gains, Material, Unlisted};

use crate::SceneError;

/// Which faces a shaded sample shows to the light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Sides {
    /// `max(0, L·N)`: only surfaces turned to the light.
    #[default]
    One,
    /// `|L·N|`: either face.
    Two,
}

/// Lambert shading `I C max(0, L·N)` with `N = -∇ρ/|∇ρ|`: gradients by central differences of the weights over
/// millimetres at the voxels, trilinearly interpolated. Where the gradient is exactly zero, or the light is at the
/// sample, the factor is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Shading {
    /// One-sided or two-sided.
    pub sides: Sides,
}

/// Depth cue `1 / max(c, minimum)`, `c` the distance in mm from the light to the sample.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DepthCue {
    /// Smallest distance in mm that counts; a hundredth of the grid's diagonal when absent.
    pub minimum: Option<f64>,
}

/// What a scene asks for on top of the plain X-ray. The default asks for nothing.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Effects {
    /// The light that shading and depth cue refer to.
    pub light: Light,
    /// Lambert shading.
    pub shading: Option<Shading>,
    /// Dimming with the distance from the light.
    pub depth_cue: Option<DepthCue>,
    /// Hue by depth.
    #[serde(alias = "depth-color")]
    pub depth_colour: Option<DepthColour>,
    /// Isovalue ranges with colours and weights.
    pub materials: Vec<Material>,
    /// What becomes of isovalues in no material; only with materials.
    pub unlisted: Option<Unlisted>,
}

impl Effects {
    /// True when the scene asks for the plain X-ray.
    pub fn is_plain(&self) -> bool {
        self.first().is_none()
    }

    /// The key of the first effect that is asked for; `None` for the plain X-ray.
    pub fn first(&self) -> Option<&'static str> {
        let asked = [
            ("shading", self.shading.is_some()),
            ("depth-cue", self.depth_cue.is_some()),
            ("depth-colour", self.depth_colour.is_some()),
            ("materials", !self.materials.is_empty()),
        ];
        asked.iter().find(|(_, on)| *on).map(|(key, _)| *key)
    }

    /// The factors on the weights that the materials ask for, for [`DensityMap::gains`](crate::DensityMap::gains);
    /// `None` when every weight stays as it is.
    pub fn gains(&self) -> Option<Gains> {
        Gains::of(&self.materials, self.unlisted.unwrap_or_default())
    }

    /// Checks the parameters, whatever the camera.
    ///
    /// # Errors
    /// [`SceneError::Effects`] with the key, the value and what is accepted.
    pub fn check(&self) -> Result<(), SceneError> {
        self.light.check()?;
        if let Some(DepthCue { minimum: Some(m) }) = self.depth_cue
            && !(m.is_finite() && m > 0.0)
        {
            return Err(SceneError::Effects(format!("depth-cue.minimum must be positive, in mm; got {m}")));
        }
        if let Some(d) = &self.depth_colour {
            d.check()?;
        }
        if self.materials.is_empty() && self.unlisted.is_some() {
            return Err(SceneError::Effects("unlisted means nothing without materials".into()));
        }
        material::check(&self.materials, self.unlisted)
    }
}
