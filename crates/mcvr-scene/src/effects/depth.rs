//! Hue by depth: the 2003 paper's coloured depth, the report's Figure 4.

use mcvr_volume::Grid;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Colour, DepthRamp};
use crate::{Camera, SceneError};

/// Colours along the depth: straight lines between evenly spaced stops, constant beyond the ends.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DepthColour {
    /// Depths in mm (along the optical axis; from the eye for a pinhole, from the world's origin for a parallel camera)
    /// of the first and the last stop; the depths of the grid's nearest and farthest corner when absent.
    pub range: Option<[f64; 2]>,
    /// Colours from near to far, at least two; hues from red over yellow, green and cyan to blue when absent.
    pub stops: Option<Vec<Colour>>,
}

impl DepthColour {
    pub(super) fn check(&self) -> Result<(), SceneError> {
        if let Some([near, far]) = self.range
            && !(near < far && (far - near).is_finite())
        {
            let m =
                format!("depth-colour.range must rise, from near to far in mm, by a finite width; got {near}, {far}");
            return Err(SceneError::Effects(m));
        }
        match &self.stops {
            Some(s) if s.len() < 2 => {
                Err(SceneError::Effects(format!("depth-colour.stops needs at least two colours, got {}", s.len())))
            }
            _ => Ok(()),
        }
    }

    /// With every default filled in.
    pub(super) fn ramp(&self, grid: &Grid, camera: &Camera) -> DepthRamp {
        let stops = match &self.stops {
            Some(s) => s.iter().map(|c| c.rgb()).collect(),
            // Hues 0 to 240 degrees: between multiples of 60 they are straight lines in red, green and blue.
            None => vec![[1., 0., 0.], [1., 1., 0.], [0., 1., 0.], [0., 1., 1.], [0., 0., 1.]],
        };
        let range = self.range.unwrap_or_else(|| {
            let depths = grid.corners(0.5).map(|c| camera.project(c).2);
            let (low, high) =
                depths.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), d| (l.min(*d), h.max(*d)));
            [low, high]
        });
        DepthRamp::new(range, stops)
    }
}
