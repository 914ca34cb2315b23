//! Tones: how linear values become grey levels. Only for looking; numbers are compared without them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Image;

/// Shape of the tone curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Curve {
    /// Grey proportional to the value.
    #[default]
    Linear,
    /// Grey proportional to `ln(1 + 100 x)`: faint parts show.
    Log,
    /// Dark where the value is large, as on an exposed film: `exp(-3 x)` rescaled to 0..1.
    Film,
}

impl std::str::FromStr for Curve {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        match s {
            "linear" => Ok(Curve::Linear),
            "log" => Ok(Curve::Log),
            "film" => Ok(Curve::Film),
            _ => Err(format!("unknown tone '{s}'; one of linear, log, film")),
        }
    }
}

/// A window of values and a curve over it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Tone {
    /// Shape over the window.
    pub curve: Curve,
    /// Exchange black and white after the curve.
    pub invert: bool,
    /// Percentiles of the pixel values that become the ends of the window, 0 ≤ low < high ≤ 100.
    pub window: [f64; 2],
}

impl Default for Tone {
    fn default() -> Self {
        Self { curve: Curve::Linear, invert: false, window: [0.0, 99.9] }
    }
}

impl Tone {
    /// Values at which the curve starts and ends for this image. A flat image gets a window of width > 0.
    pub fn limits(&self, image: &Image) -> [f64; 2] {
        let mut values: Vec<f64> = image.values().iter().copied().filter(|v| v.is_finite()).collect();
        let last = values.len().saturating_sub(1);
        let mut at = |percent: f64| {
            let rank = ((percent / 100.0) * last as f64).round().clamp(0.0, last as f64) as usize;
            if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(rank, f64::total_cmp).1 }
        };
        let (low, high) = (at(self.window[0]), at(self.window[1]));
        if high > low {
            return [low, high];
        }
        // The next number above, as adding a little changes nothing at most sizes.
        [low, at(100.0).max(low.next_up())]
    }

    /// Grey levels in 0..=1 between the given limits.
    pub fn apply(&self, image: &Image, limits: [f64; 2]) -> Vec<f64> {
        let [low, high] = limits;
        let grey = |v: f64| {
            // Halves where the window is wider than the largest number. The value next to that is infinite.
            let share = if (high - low).is_finite() {
                (v - low) / (high - low)
            } else {
                (0.5 * v - 0.5 * low) / (0.5 * high - 0.5 * low)
            };
            let x = share.clamp(0.0, 1.0);
            let y = match self.curve {
                Curve::Linear => x,
                Curve::Log => (100.0 * x).ln_1p() / 100f64.ln_1p(),
                Curve::Film => ((-3.0 * x).exp() - (-3.0f64).exp()) / (1.0 - (-3.0f64).exp()),
            };
            if self.invert { 1.0 - y } else { y }
        };
        image.values().iter().map(|&v| if v.is_nan() { 0.0 } else { grey(v) }).collect()
    }
}

/// Colours for signed values: blue below zero, white at zero, red above; `scale` is the value that is full red.
pub fn diverging_rgb(image: &Image, scale: f64) -> Vec<[u8; 3]> {
    let ends = [[33.0, 102.0, 172.0], [178.0, 24.0, 43.0]];
    image
        .values()
        .iter()
        .map(|&v| {
            let x = if scale > 0.0 { (v / scale).clamp(-1.0, 1.0) } else { 0.0 };
            let end = ends[usize::from(x > 0.0)];
            end.map(|c: f64| (255.0 + (c - 255.0) * x.abs()).round() as u8)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Extent;

    fn ramp() -> Image {
        Image::from_values(Extent::new(101, 1).unwrap(), (0..101).map(f64::from).collect()).unwrap()
    }

    #[test]
    fn percentiles_set_the_window() {
        let tone = Tone { window: [10.0, 90.0], ..Tone::default() };
        assert_eq!(tone.limits(&ramp()), [10.0, 90.0]);
        let grey = tone.apply(&ramp(), [10.0, 90.0]);
        assert_eq!((grey[10], grey[50], grey[90], grey[100]), (0.0, 0.5, 1.0, 1.0));
    }

    #[test]
    fn every_curve_is_monotone_and_spans_black_to_white() {
        for curve in [Curve::Linear, Curve::Log, Curve::Film] {
            let tone = Tone { curve, invert: curve == Curve::Film, window: [0.0, 100.0] };
            let grey = tone.apply(&ramp(), tone.limits(&ramp()));
            assert!(grey.windows(2).all(|w| w[0] <= w[1]), "{curve:?}");
            assert!(grey[0].abs() < 1e-12 && (grey[100] - 1.0).abs() < 1e-12, "{curve:?}");
        }
    }

    #[test]
    fn a_flat_image_gives_finite_greys() {
        let flat = Image::zeros(Extent::new(3, 2).unwrap());
        let tone = Tone::default();
        assert!(tone.apply(&flat, tone.limits(&flat)).iter().all(|g| g.is_finite()));
    }
}
