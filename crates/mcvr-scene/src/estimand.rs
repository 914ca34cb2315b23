//! The two quantities a pixel can mean (METHOD section 2).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a pixel's value is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "lowercase")]
pub enum Estimand {
    /// Share of all samples that fall into the pixel: the report's image. Sums to 1 over an image that
    /// contains the whole volume. Dimensionless.
    Count,
    /// Mean line integral of the density over the pixel's area, in weight units times millimetres: the
    /// X-ray optical depth when weights are attenuations per millimetre.
    #[default]
    Line,
}

impl Estimand {
    /// Both estimands.
    pub const ALL: [Estimand; 2] = [Estimand::Count, Estimand::Line];

    /// `count` or `line`.
    pub fn name(self) -> &'static str {
        match self {
            Estimand::Count => "count",
            Estimand::Line => "line",
        }
    }

    /// Unit of a pixel's value.
    pub fn unit(self) -> &'static str {
        match self {
            Estimand::Count => "share of samples",
            Estimand::Line => "weight x mm",
        }
    }
}

impl std::fmt::Display for Estimand {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for Estimand {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|e| e.name() == s)
            .ok_or_else(|| format!("unknown estimand '{s}'; one of count, line"))
    }
}
