//! Scale: volumes, samples, pixels and sums beyond 2^32, in bounded memory.

mod limits;
mod samples;
mod sums;
mod volumes;

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group, program};

pub(super) const CASES: [&[Case]; 4] = [volumes::CASES, samples::CASES, sums::CASES, limits::CASES];

/// A case of this group.
const fn case(
    name: &'static str,
    cost: Cost,
    breaks: &'static str,
    asserts: &'static str,
    measure: fn(&Context) -> Result<Finding, CaseError>,
) -> Case {
    Case { name, group: Group::Scale, breaks, asserts, cost, measure }
}

/// Bytes in a mebibyte.
const MIB: u64 = 1 << 20;
