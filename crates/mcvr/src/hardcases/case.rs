//! A case, what it measured, and the verdict on it.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

use serde::Serialize;

use super::Context;

/// What a case is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "the names say it")]
pub enum Group {
    Distributions,
    Sequences,
    Geometry,
    Effects,
    Scale,
    Measures,
    Files,
    Running,
}

impl Group {
    /// Every group, in the order of the table.
    pub const ALL: [Group; 8] = [
        Group::Distributions,
        Group::Sequences,
        Group::Geometry,
        Group::Effects,
        Group::Scale,
        Group::Measures,
        Group::Files,
        Group::Running,
    ];

    /// Stable name, also on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Group::Distributions => "distributions",
            Group::Sequences => "sequences",
            Group::Geometry => "geometry",
            Group::Effects => "effects",
            Group::Scale => "scale",
            Group::Measures => "measures",
            Group::Files => "files",
            Group::Running => "running",
        }
    }
}

impl std::str::FromStr for Group {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|g| g.name() == s)
            .ok_or_else(|| format!("unknown group '{s}'; one of {}", Self::ALL.map(Group::name).join(", ")))
    }
}

/// Whether a case belongs to the default set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cost {
    /// At most a few seconds.
    Quick,
    /// Many seconds, or gigabytes of disk: only with `--all`.
    Large,
}

/// What a measured figure must keep. A figure that is not a number keeps nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bound {
    /// No more than this.
    AtMost(f64),
    /// No less than this.
    AtLeast(f64),
    /// From the first to the second.
    Within(f64, f64),
    /// Exactly this.
    Exactly(f64),
}

impl Bound {
    /// Whether a figure keeps the bound.
    pub fn holds(self, measured: f64) -> bool {
        match self {
            Bound::AtMost(most) => measured <= most,
            Bound::AtLeast(least) => measured >= least,
            Bound::Within(least, most) => (least..=most).contains(&measured),
            Bound::Exactly(value) => measured == value,
        }
    }
}

impl std::fmt::Display for Bound {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match *self {
            Bound::AtMost(v) => write!(f, "≤ {}", figure(v)),
            Bound::AtLeast(v) => write!(f, "≥ {}", figure(v)),
            Bound::Within(a, b) => write!(f, "{} to {}", figure(a), figure(b)),
            Bound::Exactly(v) => write!(f, "= {}", figure(v)),
        }
    }
}

/// A figure for people: integers whole, everything else to three digits.
pub fn figure(v: f64) -> String {
    if v.fract() == 0.0 && v.abs() < 1e15 {
        format!("{v:.0}")
    } else if (1e-3..1e4).contains(&v.abs()) {
        format!("{v:.3}")
    } else {
        format!("{v:.2e}")
    }
}

/// What a case measured, and the bound that it must keep.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The figure.
    pub measured: f64,
    /// What it counts or its unit.
    pub unit: String,
    /// What it must keep.
    pub bound: Bound,
    /// What else is worth knowing: what a naive program gives, where the worst was.
    pub detail: String,
}

impl Finding {
    /// A figure and its bound.
    pub fn new(measured: f64, unit: &str, bound: Bound) -> Self {
        Self { measured, unit: unit.to_owned(), bound, detail: String::new() }
    }

    /// Checks that failed, out of those that were made; none may fail, and none made is a failure.
    pub fn wrong(wrong: u64, of: u64, what: &str) -> Self {
        let bound = if of == 0 { Bound::AtLeast(1.0) } else { Bound::AtMost(0.0) };
        Self::new(wrong as f64, &format!("wrong of {of} {what}"), bound)
    }

    /// The same with a remark.
    pub fn with(mut self, detail: impl Into<String>) -> Self {
        self.detail = detail.into();
        self
    }
}

/// Why a case gave no figure. Not itself an `Error`, so that every error turns into one by `?`.
#[derive(Debug)]
pub enum CaseError {
    /// This machine cannot pose the case.
    Impossible(String),
    /// Something failed that should not.
    Failed(Box<dyn std::error::Error + Send + Sync>),
}

impl<E: Into<Box<dyn std::error::Error + Send + Sync>>> From<E> for CaseError {
    fn from(e: E) -> Self {
        Self::Failed(e.into())
    }
}

/// The judgement on a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The bound holds.
    Pass,
    /// The bound does not hold, or the case ended in an error or a panic.
    Fail,
    /// This machine cannot pose the case.
    Skip,
}

/// A case that has been run.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// The figure and its bound, where the case gave one.
    pub finding: Option<Finding>,
    /// The judgement.
    pub verdict: Verdict,
    /// Why there is no figure.
    pub error: Option<String>,
    /// Wall time, s.
    pub seconds: f64,
}

/// One hard case.
#[derive(Debug, Serialize)]
pub struct Case {
    /// Stable name.
    pub name: &'static str,
    /// What it is about.
    pub group: Group,
    /// What usually breaks.
    pub breaks: &'static str,
    /// What is asserted.
    pub asserts: &'static str,
    /// Whether it is in the default set.
    pub cost: Cost,
    /// Measures.
    #[serde(skip)]
    pub(super) measure: fn(&Context) -> Result<Finding, CaseError>,
}

impl Case {
    /// Poses the case and judges what it measured. A panic is a failure, not the end of the catalogue.
    pub fn run(&self, context: &Context) -> Outcome {
        let start = Instant::now();
        let measured = catch_unwind(AssertUnwindSafe(|| (self.measure)(context)));
        let seconds = start.elapsed().as_secs_f64();
        let (finding, verdict, error) = match measured {
            Ok(Ok(finding)) => {
                let verdict = if finding.bound.holds(finding.measured) { Verdict::Pass } else { Verdict::Fail };
                (Some(finding), verdict, None)
            }
            Ok(Err(CaseError::Impossible(why))) => (None, Verdict::Skip, Some(why)),
            Ok(Err(CaseError::Failed(e))) => (None, Verdict::Fail, Some(e.to_string())),
            Err(panic) => {
                let text = panic.downcast_ref::<String>().map(String::as_str);
                let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
                (None, Verdict::Fail, Some(format!("panic: {text}")))
            }
        };
        Outcome { finding, verdict, error, seconds }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(measure: fn(&Context) -> Result<Finding, CaseError>) -> Outcome {
        let case = Case { name: "x", group: Group::Files, breaks: "", asserts: "", cost: Cost::Quick, measure };
        case.run(&Context::new(None).unwrap())
    }

    #[test]
    fn a_broken_bound_an_error_and_a_panic_fail() {
        assert_eq!(case(|_| Ok(Finding::new(1.0, "", Bound::AtMost(1.0)))).verdict, Verdict::Pass);
        assert_eq!(case(|_| Ok(Finding::new(1.1, "", Bound::AtMost(1.0)))).verdict, Verdict::Fail);
        assert_eq!(case(|_| Ok(Finding::wrong(0, 7, "draws"))).verdict, Verdict::Pass);
        assert_eq!(case(|_| Ok(Finding::wrong(1, 7, "draws"))).verdict, Verdict::Fail);
        assert_eq!(case(|_| Ok(Finding::wrong(0, 0, "draws"))).verdict, Verdict::Fail);
        assert_eq!(case(|_| Err("broken".into())).verdict, Verdict::Fail);
        assert_eq!(case(|_| Err(CaseError::Impossible("no disk".into()))).verdict, Verdict::Skip);
    }

    #[test]
    fn nothing_holds_for_what_is_not_a_number() {
        for bound in [Bound::AtMost(1.0), Bound::AtLeast(1.0), Bound::Within(0.0, 1.0), Bound::Exactly(f64::NAN)] {
            assert!(!bound.holds(f64::NAN), "{bound}");
        }
        assert!(Bound::Within(0.0, 1.0).holds(1.0) && !Bound::Within(0.0, 1.0).holds(1.5));
        assert!(Bound::Exactly(2.0).holds(2.0) && !Bound::AtLeast(2.0).holds(1.0));
    }
}
