//! Materials: isovalue ranges with colours and weights.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Colour;
use crate::SceneError;

/// The isovalues of one substance, its colour, and how much they count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// What it is called in plans and messages.
    #[serde(default)]
    pub name: Option<String>,
    /// Smallest isovalue; absent for no lower end.
    #[serde(default)]
    pub from: Option<f64>,
    /// Isovalue at which the range ends (itself not in it); absent for no upper end.
    #[serde(default)]
    pub to: Option<f64>,
    /// Colour of its voxels.
    #[serde(alias = "color")]
    pub colour: Colour,
    /// Factor on the weight of its voxels, at least 0.
    #[serde(default = "one")]
    pub weight: f64,
}

fn one() -> f64 {
    1.0
}

/// What becomes of isovalues in no material.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Unlisted {
    /// Colour of their voxels.
    #[serde(alias = "color")]
    pub colour: Colour,
    /// Factor on their weight; 0 leaves them out.
    pub weight: f64,
}

impl Default for Unlisted {
    /// Left out.
    fn default() -> Self {
        Self { colour: Colour::WHITE, weight: 0.0 }
    }
}

impl Material {
    /// The half-open range of isovalues.
    pub fn range(&self) -> (f64, f64) {
        (self.from.unwrap_or(f64::NEG_INFINITY), self.to.unwrap_or(f64::INFINITY))
    }

    /// Its name, or its range in words.
    pub fn label(&self) -> String {
        let end = |v: Option<f64>, none: &str| v.map_or_else(|| none.to_owned(), |v| v.to_string());
        self.name.clone().unwrap_or_else(|| format!("{}..{}", end(self.from, "-inf"), end(self.to, "inf")))
    }
}

/// Factors on weights by isovalue: those of the materials.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    /// `[from, to)` and the factor, in rising order without overlap.
    pub ranges: Vec<(f64, f64, f64)>,
    /// Factor elsewhere.
    pub elsewhere: f64,
}

impl Gains {
    pub(super) fn of(materials: &[Material], unlisted: Unlisted) -> Option<Self> {
        let mut ranges: Vec<_> = materials
            .iter()
            .map(|m| {
                let (from, to) = m.range();
                (from, to, m.weight)
            })
            .collect();
        ranges.sort_by(|a, b| a.0.total_cmp(&b.0));
        (!ranges.is_empty()).then_some(Self { ranges, elsewhere: unlisted.weight })
    }

    /// The factor for an isovalue.
    pub fn at(&self, isovalue: f64) -> f64 {
        let i = self.ranges.partition_point(|r| r.0 <= isovalue);
        match i.checked_sub(1).map(|i| self.ranges[i]) {
            Some((_, to, gain)) if isovalue < to => gain,
            _ => self.elsewhere,
        }
    }
}

/// Ranges must be sane and must not overlap; touching and gaps are fine.
pub(super) fn check(materials: &[Material], unlisted: Option<Unlisted>) -> Result<(), SceneError> {
    let fail = |m: String| Err(SceneError::Effects(m));
    let bad_weight = |w: f64| !(w.is_finite() && w >= 0.0);
    for m in materials {
        let (from, to) = m.range();
        if from.is_nan() || to.is_nan() || from >= to {
            return fail(format!("material {}: from must lie below to, got {from} and {to}", m.label()));
        }
        if bad_weight(m.weight) {
            return fail(format!("material {}: weight must be at least 0, got {}", m.label(), m.weight));
        }
    }
    if let Some(u) = unlisted
        && bad_weight(u.weight)
    {
        return fail(format!("unlisted.weight must be at least 0, got {}", u.weight));
    }
    let mut sorted: Vec<&Material> = materials.iter().collect();
    sorted.sort_by(|a, b| a.range().0.total_cmp(&b.range().0));
    for pair in sorted.windows(2) {
        let (end, start) = (pair[0].range().1, pair[1].range().0);
        if start < end {
            let (a, b) = (pair[0].label(), pair[1].label());
            return fail(format!("materials {a} and {b} overlap: {b} starts at {start}, below the end {end} of {a}"));
        }
    }
    Ok(())
}
