//! A claim, what was measured of it, and the verdict.

use std::time::Instant;

use mcvr_harness::HarnessError;
use mcvr_raycast::RaycastError;
use serde::Serialize;

use super::{Bench, Figure};
use crate::MakeError;

/// The judgement on a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// As claimed.
    Holds,
    /// In one sense or range, not in another; the criterion says which.
    HoldsInPart,
    /// Not as claimed.
    DoesNotHold,
    /// This volume, view or kernel cannot show it.
    NotTestable,
}

impl Verdict {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Verdict::Holds => "holds",
            Verdict::HoldsInPart => "holds in part",
            Verdict::DoesNotHold => "does not hold",
            Verdict::NotTestable => "not testable here",
        }
    }

    /// The usual ladder: the first condition for `Holds`, the second for `HoldsInPart`. Deciding figures that are not
    /// numbers decide nothing.
    pub(super) fn ladder(figures: &[f64], holds: bool, in_part: bool) -> Self {
        match (figures.iter().all(|f| f.is_finite()), holds, in_part) {
            (false, ..) => Verdict::NotTestable,
            (_, true, _) => Verdict::Holds,
            (_, _, true) => Verdict::HoldsInPart,
            _ => Verdict::DoesNotHold,
        }
    }
}

/// What was measured of a claim, and the verdict by its criterion.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// The judgement.
    pub verdict: Verdict,
    /// Whether the spread of the deciding figures reaches to another verdict.
    pub uncertain: bool,
    /// The figures, those that decide first.
    pub figures: Vec<Figure>,
    /// What to know to read them.
    pub note: String,
}

impl Finding {
    /// A verdict on the middles of the deciding figures, and those on their ends.
    pub(super) fn new(verdict: Verdict, at_ends: &[Verdict], figures: Vec<Figure>, note: impl Into<String>) -> Self {
        Self { verdict, uncertain: at_ends.iter().any(|v| *v != verdict), figures, note: note.into() }
    }
}

/// Why a claim has no finding.
#[derive(Debug, thiserror::Error)]
pub enum ClaimError {
    /// This volume, view or kernel cannot show it: a verdict, not a failure.
    #[error("{0}")]
    NotTestable(String),
    /// Stopped from outside.
    #[error("stopped")]
    Cancelled,
    /// A measurement failed.
    #[error("{0}")]
    Failed(#[source] Box<dyn std::error::Error + Send + Sync>),
}

impl From<MakeError> for ClaimError {
    fn from(e: MakeError) -> Self {
        match e {
            e if e.is_cancelled() => Self::Cancelled,
            MakeError::Raycast(e @ RaycastError::Shell) => Self::NotTestable(e.to_string()),
            e => Self::Failed(e.into()),
        }
    }
}

impl From<HarnessError> for ClaimError {
    fn from(e: HarnessError) -> Self {
        Self::Failed(e.into())
    }
}

impl From<mcvr_volume::VolumeError> for ClaimError {
    fn from(e: mcvr_volume::VolumeError) -> Self {
        Self::Failed(e.into())
    }
}

/// A claim that has been tested.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// What was found, or why it cannot be tested here; absent where a measurement failed.
    pub finding: Option<Finding>,
    /// Why a measurement failed.
    pub error: Option<String>,
    /// Wall time of the test, s.
    pub seconds: f64,
}

/// One claim.
#[derive(Debug, Serialize)]
pub struct Claim {
    /// Stable name.
    pub name: &'static str,
    /// What is claimed.
    pub quote: &'static str,
    /// How it is tested.
    pub tested: &'static str,
    /// What decides the verdict.
    pub criterion: &'static str,
    /// Measures and judges.
    #[serde(skip)]
    pub(super) measure: fn(&Bench<'_>) -> Result<Finding, ClaimError>,
}

impl Claim {
    /// Tests the claim; `None` when it was stopped.
    pub fn test(&self, bench: &Bench<'_>) -> Option<Outcome> {
        let start = Instant::now();
        let measured = (self.measure)(bench);
        let seconds = start.elapsed().as_secs_f64();
        let (finding, error) = match measured {
            Ok(finding) => (Some(finding), None),
            Err(ClaimError::NotTestable(why)) => (Some(Finding::new(Verdict::NotTestable, &[], vec![], why)), None),
            Err(ClaimError::Failed(e)) => (None, Some(e.to_string())),
            Err(ClaimError::Cancelled) => return None,
        };
        Some(Outcome { finding, error, seconds })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ladder_reaches_every_verdict_and_nothing_is_decided_by_what_is_no_number() {
        assert_eq!(Verdict::ladder(&[1.0], true, true), Verdict::Holds);
        assert_eq!(Verdict::ladder(&[1.0], false, true), Verdict::HoldsInPart);
        assert_eq!(Verdict::ladder(&[1.0], false, false), Verdict::DoesNotHold);
        assert_eq!(Verdict::ladder(&[1.0, f64::NAN], true, true), Verdict::NotTestable);
        assert_eq!(Verdict::ladder(&[f64::INFINITY], true, true), Verdict::NotTestable);
    }

    #[test]
    fn a_finding_whose_ends_are_judged_otherwise_is_uncertain() {
        let uncertain = |ends| Finding::new(Verdict::Holds, ends, vec![], "").uncertain;
        assert!(!uncertain(&[Verdict::Holds; 2]) && uncertain(&[Verdict::Holds, Verdict::HoldsInPart]));
    }
}
