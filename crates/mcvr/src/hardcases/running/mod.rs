//! Running: full disks, signals, closed descriptors, odd names, too many threads, too little memory.

mod disk;
mod interrupts;
mod limits;
mod outputs;
mod streams;

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group, program};

pub(super) const CASES: [&[Case]; 5] = [disk::CASES, interrupts::CASES, streams::CASES, outputs::CASES, limits::CASES];

/// A quick case of this group.
const fn quick(
    name: &'static str,
    breaks: &'static str,
    asserts: &'static str,
    measure: fn(&Context) -> Result<Finding, CaseError>,
) -> Case {
    Case { name, group: Group::Running, breaks, asserts, cost: Cost::Quick, measure }
}

/// Checks that were made and those that failed, with the names of the first few.
#[derive(Default)]
struct Tally {
    of: u64,
    wrong: Vec<String>,
}

impl Tally {
    fn check(&mut self, holds: bool, what: impl FnOnce() -> String) {
        self.of += 1;
        if !holds {
            self.wrong.push(what());
        }
    }

    /// None may fail.
    fn finding(self, unit: &str, otherwise: &str) -> Finding {
        let shown: Vec<&str> = self.wrong.iter().take(3).map(String::as_str).collect();
        let detail = if shown.is_empty() { otherwise.to_owned() } else { shown.join("; ") };
        Finding::wrong(self.wrong.len() as u64, self.of, unit).with(detail)
    }
}

/// A small picture of a phantom: enough to have something to write.
const PICTURE: [&str; 7] = ["render", "phantom:lobster@24", "--samples", "2^16", "--size", "400x400", "--quiet"];

/// Arguments after those of [`PICTURE`].
fn picture<'a>(more: &[&'a str]) -> Vec<&'a str> {
    PICTURE.into_iter().chain(more.iter().copied()).collect()
}

/// A run of `converge` that takes no time; its folder comes last.
#[rustfmt::skip]
const SMALL_RUN: [&str; 15] = [
    "converge", "phantom:lobster@24", "--methods", "mc", "--samples", "2^8", "--replicates", "2", "--series", "none",
    "--size", "8x8", "--tolerance", "1e-2", "-o",
];
