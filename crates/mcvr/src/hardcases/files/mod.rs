//! Files: whatever they hold, reading gives what was stored or an error that helps.
//!
//! Most cases count over variants of good files of every format (see [`good_files`]); each variant's outcome is exact, so
//! the bound is 0 wrong. What counts as wrong is said beside the engine in `damage.rs`.

mod bytes;
mod damage;
mod good;
mod good_volumes;
mod live;
mod packed;
mod paths;
mod text;
mod values;

pub use good::{GoodFile, Reader, good_files};

use super::{Case, CaseError, Context, Cost, Finding, Group};

/// One case of this group, in the default set.
const fn case(
    name: &'static str,
    breaks: &'static str,
    asserts: &'static str,
    measure: fn(&Context) -> Result<Finding, CaseError>,
) -> Case {
    Case { name, group: Group::Files, breaks, asserts, cost: Cost::Quick, measure }
}

pub(super) const CASES: &[&[Case]] =
    &[bytes::CASES, values::CASES, text::CASES, packed::CASES, paths::CASES, live::CASES];
