//! The light.

use glam::DVec3;
use mcvr_volume::Grid;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Colour;
use crate::{Camera, SceneError};

/// Where the light is.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum LightPosition {
    /// At the camera's eye (a parallel camera has none).
    #[default]
    Eye,
    /// World position in mm.
    World([f64; 3]),
    /// Seen from the volume's centre, by the angles of a view.
    Around {
        /// Degrees in the x-y plane from +x towards +y.
        azimuth: f64,
        /// Degrees above the x-y plane.
        elevation: f64,
        /// Millimetres from the volume's centre; two diameters when absent.
        #[serde(default)]
        distance: Option<f64>,
    },
}

/// A point light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Light {
    /// Where it is.
    pub position: LightPosition,
    /// Its colour `C`.
    #[serde(alias = "color")]
    pub colour: Colour,
    /// Its intensity `I`, at least 0.
    pub intensity: f64,
}

impl Default for Light {
    fn default() -> Self {
        Self { position: LightPosition::Eye, colour: Colour::WHITE, intensity: 1.0 }
    }
}

impl Light {
    pub(super) fn check(&self) -> Result<(), SceneError> {
        let fail = |m: String| Err(SceneError::Effects(m));
        if !(self.intensity.is_finite() && self.intensity >= 0.0) {
            return fail(format!("light.intensity must be at least 0, got {}", self.intensity));
        }
        match self.position {
            LightPosition::World(p) if p.iter().any(|v| !v.is_finite()) => {
                fail(format!("light.position must be finite, got {p:?}"))
            }
            LightPosition::Around { azimuth, elevation, distance } => {
                if !azimuth.is_finite() || !elevation.is_finite() {
                    return fail(format!("the light's angles must be finite, got {azimuth},{elevation}"));
                }
                match distance {
                    Some(d) if !(d.is_finite() && d >= 0.0) => {
                        fail(format!("the light's distance must be at least 0, in mm; got {d}"))
                    }
                    _ => Ok(()),
                }
            }
            _ => Ok(()),
        }
    }

    /// World position in mm.
    pub(super) fn place(&self, grid: &Grid, camera: &Camera) -> Result<DVec3, SceneError> {
        match self.position {
            LightPosition::World(p) => Ok(p.into()),
            LightPosition::Around { azimuth, elevation, distance } => {
                let (sa, ca) = azimuth.to_radians().sin_cos();
                let (se, ce) = elevation.to_radians().sin_cos();
                let distance = distance.unwrap_or(2.0 * grid.diameter());
                Ok(grid.centre() + DVec3::new(ce * ca, ce * sa, se) * distance)
            }
            LightPosition::Eye => camera.eye().ok_or_else(|| {
                SceneError::Effects(
                    "light.position is the eye, but a parallel camera has none; give world or around".into(),
                )
            }),
        }
    }
}
