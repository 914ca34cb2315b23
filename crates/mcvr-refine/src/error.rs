//! Why an image could not be refined.

use mcvr_sampling::SamplingError;

/// Why an image could not be refined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RefineError {
    /// A number that was asked for is unusable.
    #[error("{what} is {value}: {problem}")]
    Value {
        /// Which.
        what: &'static str,
        /// What it is.
        value: String,
        /// What it should be.
        problem: &'static str,
    },
    /// Sampling failed, or was stopped before the first look.
    #[error(transparent)]
    Sampling(#[from] SamplingError),
}
