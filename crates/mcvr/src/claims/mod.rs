//! The claims that A. Law and E. Blythe's report *Monte Carlo Volume Rendering* makes, each tested on a volume.
//!
//! A [`Claim`] says what is claimed, how it is tested and by which criterion it is judged. The criterion stands in the
//! theme's file as constants and one `judge` function of a few figures, and was fixed before anything was measured; the
//! measurement fills in the figures. Where the spread of the deciding figures reaches across a limit of the criterion,
//! the [`Finding`] says so. `mcvr claims` prints the table.
//!
//! ```
//! use mcvr::claims::{self, Verdict};
//! assert_eq!(claims::CATALOGUE.len(), 8);
//! // Twice the voxels in twice the time is no independence, whatever the machine.
//! assert_eq!(claims::data_size::judge(1.0, 1.0), Verdict::DoesNotHold);
//! ```

mod bench;
pub mod convergence;
pub mod data_size;
pub mod faster;
mod figure;
pub mod linear;
mod model;
pub mod qmc;
pub mod shading;
mod sizes;
pub mod sorting;
pub mod thin;

pub use bench::{Bench, Options};
pub use figure::{Figure, Unit};
pub use model::{Claim, ClaimError, Finding, Outcome, Verdict};

/// Every claim, in the order of the table.
pub static CATALOGUE: [Claim; 8] = [
    data_size::CLAIM,
    linear::CLAIM,
    sorting::CLAIM,
    convergence::CLAIM,
    faster::CLAIM,
    thin::CLAIM,
    qmc::CLAIM,
    shading::CLAIM,
];

/// The budget that the report speaks of.
pub(crate) const MILLION: u64 = 1_000_000;
