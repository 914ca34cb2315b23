//! From isovalues to weights: the density map.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Hounsfield;
use crate::SceneError;
use crate::effects::Gains;

/// How an isovalue becomes a weight (before emphasis).
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Transfer {
    /// The weight is the isovalue.
    #[default]
    Identity,
    /// `slope * isovalue + intercept`.
    Linear {
        /// Weight per isovalue.
        slope: f64,
        /// Weight of isovalue 0.
        intercept: f64,
    },
    /// Straight lines between (isovalue, weight) points, constant outside the first and the last.
    Piecewise(Vec<[f64; 2]>),
    /// Hounsfield units to linear attenuation per mm, from the attenuation of water or at a photon energy.
    Hounsfield(Hounsfield),
}

/// The report's improvement 2: isovalues from a threshold on count more, so that a faint halo dims.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Emphasis {
    /// Smallest isovalue that is emphasised.
    pub threshold: f64,
    /// Factor on the weight of emphasised isovalues.
    pub gain: f64,
}

/// What happens to voxels whose weight comes out negative.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum NegativePolicy {
    /// They become 0; the mass report says how many and how much mass that drops.
    #[default]
    Clamp,
    /// They are an error.
    Refuse,
}

/// The density map `W` of METHOD section 1.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DensityMap {
    /// Isovalue to weight.
    pub transfer: Transfer,
    /// Extra weight above a threshold.
    pub emphasis: Option<Emphasis>,
    /// What to do with negative weights.
    pub negative: NegativePolicy,
    /// Move weights up the gradient first, so that thin structures keep their contrast under smooth kernels
    /// (see [`Density::concentrated`](crate::Density::concentrated)). Takes 4 bytes a voxel. Not with materials.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub concentrate: bool,
    /// Factors by isovalue, as [materials](crate::Effects::gains) ask for them; scene files do not write them here.
    #[serde(skip_deserializing, skip_serializing_if = "Option::is_none")]
    #[schemars(skip)]
    pub gains: Option<Gains>,
}

impl DensityMap {
    /// Checks the parameters.
    ///
    /// # Errors
    /// [`SceneError::Density`] when one is not finite or points are not in rising order.
    pub fn check(&self) -> Result<(), SceneError> {
        let fail = |m: String| Err(SceneError::Density(m));
        if self.concentrate && self.gains.is_some() {
            return fail("concentrate changes isovalues, by which materials are told apart; use one of the two".into());
        }
        match &self.transfer {
            Transfer::Identity => {}
            Transfer::Linear { slope, intercept } if slope.is_finite() && intercept.is_finite() => {}
            Transfer::Linear { slope, intercept } => {
                return fail(format!("slope and intercept must be finite, got {slope} and {intercept}"));
            }
            // Checked when it was made.
            Transfer::Hounsfield(_) => {}
            Transfer::Piecewise(points) => {
                if points.is_empty() || points.iter().flatten().any(|v| !v.is_finite()) {
                    return fail("piecewise points must be finite, and at least one".into());
                }
                if let Some(w) = points.windows(2).find(|w| w[0][0] >= w[1][0]) {
                    return fail(format!("piecewise isovalues must rise, but {} follows {}", w[1][0], w[0][0]));
                }
            }
        }
        match self.emphasis {
            Some(e) if !e.threshold.is_finite() || !e.gain.is_finite() || e.gain < 0.0 => fail(format!(
                "emphasis needs a finite threshold and a gain of at least 0, got {} and {}",
                e.threshold, e.gain
            )),
            _ => Ok(()),
        }
    }

    /// Weight of an isovalue before the negative policy.
    pub fn raw_weight(&self, isovalue: f64) -> f64 {
        let w = match &self.transfer {
            Transfer::Identity => isovalue,
            Transfer::Linear { slope, intercept } => slope * isovalue + intercept,
            Transfer::Hounsfield(h) => h.attenuation(isovalue),
            Transfer::Piecewise(points) => piecewise(points, isovalue),
        };
        let w = match self.emphasis {
            Some(e) if isovalue >= e.threshold => w * e.gain,
            _ => w,
        };
        match &self.gains {
            Some(g) => w * g.at(isovalue),
            None => w,
        }
    }
}

/// A straight line between two points at an isovalue between theirs.
fn between([v0, w0]: [f64; 2], [v1, w1]: [f64; 2], v: f64) -> f64 {
    let (width, rise) = (v1 - v0, w1 - w0);
    let product = rise * (v - v0);
    // Integers stay integers this way, but the product may leave the range of numbers where the quotient would not.
    if product.is_normal() && width.is_finite() {
        return w0 + product / width;
    }
    let t = if width.is_finite() { (v - v0) / width } else { (0.5 * v - 0.5 * v0) / (0.5 * v1 - 0.5 * v0) };
    if rise.is_finite() { w0 + rise * t } else { w0 * (1.0 - t) + w1 * t }
}

fn piecewise(points: &[[f64; 2]], v: f64) -> f64 {
    let after = points.partition_point(|p| p[0] <= v);
    match (after.checked_sub(1).map(|i| points[i]), points.get(after)) {
        (Some(low), Some(&high)) => between(low, high, v),
        (Some([_, w]), None) | (None, Some(&[_, w])) => w,
        (None, None) => f64::NAN,
    }
}
