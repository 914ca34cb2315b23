//! What is asked for, what is known, and why work ended.

use serde::Serialize;

use crate::RefineError;

/// The error that is enough. Relative errors are over the mean pixel of the image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Goal {
    /// Relative RMSE of the image, if asked for.
    pub error: Option<f64>,
    /// Error of most pixels, if asked for.
    pub pixel: Option<PixelGoal>,
    /// Probability with which the error is to be met; also that of the pixels' intervals.
    pub confidence: f64,
}

/// An error that at least this share of the pixels is to keep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PixelGoal {
    /// Largest error, relative to the mean pixel.
    pub error: f64,
    /// Share of the pixels, in (0, 1).
    pub share: f64,
}

impl Default for Goal {
    fn default() -> Self {
        Self { error: None, pixel: None, confidence: 0.95 }
    }
}

impl Goal {
    /// Refuses unusable numbers.
    ///
    /// # Errors
    /// [`RefineError::Value`].
    pub fn check(&self) -> Result<(), RefineError> {
        let check = |what, value: f64, good: bool, problem| match good {
            true => Ok(()),
            false => Err(RefineError::Value { what, value: value.to_string(), problem }),
        };
        for (what, error) in [("the error", self.error), ("the pixel error", self.pixel.map(|p| p.error))] {
            let error = error.unwrap_or(1.0);
            check(what, error, error.is_finite() && error > 0.0, "expected a positive number, such as 0.01 or 1%")?;
        }
        let share = self.pixel.map_or(0.5, |p| p.share);
        let inside = |v: f64| v > 0.0 && v < 1.0;
        check("the share of pixels", share, inside(share), "expected more than 0 and less than 1, such as 0.95")?;
        let c = self.confidence;
        check("the confidence", c, (0.5..=0.9999).contains(&c), "expected 0.5 to 0.9999, such as 0.95 or 95%")
    }

    /// Number of errors that are asked for.
    pub fn errors(&self) -> u64 {
        u64::from(self.error.is_some()) + u64::from(self.pixel.is_some())
    }

    /// By what factor the bounds still exceed what is asked for, at most; at most 1 when all are met. `None` when nothing is
    /// asked for or known.
    pub fn excess(&self, estimate: &Estimate) -> Option<f64> {
        let over = |asked: Option<f64>, known: Option<f64>| asked.map(|a| known.map_or(f64::INFINITY, |k| k / a));
        let errors = [over(self.error, estimate.bound), over(self.pixel.map(|p| p.error), estimate.pixel_bound)];
        errors.into_iter().flatten().reduce(f64::max)
    }
}

/// When to stop at the latest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Samples of all replicates together.
    pub samples: u64,
    /// Seconds from the start.
    pub seconds: Option<f64>,
}

/// The error of an image as its replicates show it; relative figures are over the mean pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Estimate {
    /// Mean pixel, in the estimand's unit.
    pub mean: f64,
    /// Relative RMSE: unbiased in its square. `None` for a black image.
    pub error: Option<f64>,
    /// What the relative RMSE does not exceed, with the goal's confidence at all looks together.
    pub bound: Option<f64>,
    /// Error that the asked share of the pixels keeps, where it was asked for.
    pub pixel_error: Option<f64>,
    /// What that does not exceed, with the goal's confidence.
    pub pixel_bound: Option<f64>,
}

/// Why refinement ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Stop {
    /// The error is what was asked for.
    Reached,
    /// All samples that were allowed are drawn.
    Samples,
    /// No further pass fits into the time.
    Time,
    /// Stopped from outside; the picture is that of the last finished pass.
    Interrupted,
}
