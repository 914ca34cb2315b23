//! Hard cases: where programs of this kind break, and the evidence that this one does not.
//!
//! A [`Case`] names what usually breaks and what is asserted, measures one figure and holds it to a bound that its
//! documentation derives. The verdict is the catalogue's, never the case's own. `mcvr hardcases` prints the table; the tests
//! run the same code.
//!
//! ```
//! use mcvr::hardcases::{self, Context, Verdict};
//! let case = hardcases::catalogue().find(|c| c.name == "all-zero").expect("it is there");
//! let outcome = case.run(&Context::new(None)?);
//! assert_eq!(outcome.verdict, Verdict::Pass);
//! # Ok::<(), std::io::Error>(())
//! ```

mod case;
mod distributions;
mod effects;
pub mod files;
mod geometry;
mod measures;
mod program;
mod running;
mod scale;
mod scenes;
mod sequences;
mod support;

pub use case::{Bound, Case, CaseError, Cost, Finding, Group, Outcome, Verdict, figure};
pub use support::Context;

/// Every case, group by group.
pub fn catalogue() -> impl Iterator<Item = &'static Case> {
    distributions::CASES
        .into_iter()
        .chain(sequences::CASES)
        .chain([geometry::CASES, effects::CASES])
        .chain(scale::CASES)
        .chain([measures::CASES])
        .chain(files::CASES.iter().copied())
        .chain(running::CASES)
        .flatten()
}
