//! A measured figure with its spread.

use mcvr_harness::format;
use mcvr_harness::{SlopeFit, Spread};
use serde::Serialize;

/// What a figure counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Unit {
    /// An exponent; its ends are those of the 95 % interval.
    Exponent,
    /// One value over another.
    Ratio,
    /// A share of 1, shown in percent.
    Share,
    /// Wall time in seconds.
    Seconds,
    /// A number of samples.
    Samples,
    /// A number of things that the name says.
    Count,
}

/// A measured figure.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// What it is.
    pub name: String,
    /// The value: of times and ratios of times the median over the repeats.
    pub value: f64,
    /// Lower end: smallest of the repeats, or of the 95 % interval of an exponent.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
    /// What it counts.
    pub unit: Unit,
}

impl Figure {
    /// A value that has no spread.
    pub fn plain(name: impl Into<String>, value: f64, unit: Unit) -> Self {
        Self { name: name.into(), value, low: None, high: None, unit }
    }

    /// A median with its extremes.
    pub fn spread(name: impl Into<String>, spread: Spread, unit: Unit) -> Self {
        Self { low: Some(spread.min), high: Some(spread.max), ..Self::plain(name, spread.median, unit) }
    }

    /// A fitted exponent with its interval.
    pub fn exponent(name: impl Into<String>, fit: &SlopeFit) -> Self {
        Self { low: fit.low, high: fit.high, ..Self::plain(name, fit.slope, Unit::Exponent) }
    }

    fn shown(&self, value: f64) -> String {
        match self.unit {
            Unit::Exponent => format::slope(value),
            Unit::Ratio => format!("{}×", format::significant(value, 3)),
            Unit::Share => format::percent(value),
            // Hours are what the report speaks of.
            Unit::Seconds if value >= 3600.0 => format!("{} h", format::significant(value / 3600.0, 3)),
            Unit::Seconds if value >= 600.0 => format!("{} min", format::significant(value / 60.0, 3)),
            Unit::Seconds => format::seconds(value),
            Unit::Samples if value < 1e7 => format::samples(value.round() as u64),
            Unit::Samples => format!("{value:.2e}"),
            Unit::Count => format!("{value:.0}"),
        }
    }
}

impl std::fmt::Display for Figure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.name, self.shown(self.value))?;
        match (self.low, self.high) {
            (Some(low), Some(high)) if low < high => write!(f, " ({} to {})", self.shown(low), self.shown(high)),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_read_with_their_unit_and_spread() {
        let spread = Spread::of(vec![3.0, 1.0, 2.0]);
        assert_eq!(Figure::spread("a", spread, Unit::Ratio).to_string(), "a: 2.00× (1.00× to 3.00×)");
        assert_eq!(Figure::plain("b", 7200.0, Unit::Seconds).to_string(), "b: 2.00 h");
        assert_eq!(Figure::plain("c", 0.05, Unit::Share).to_string(), "c: 5.00 %");
        assert_eq!(Figure::plain("d", 1.6e9, Unit::Samples).to_string(), "d: 1.60e9");
    }
}
