//! What can go wrong in sampling.

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SamplingError {
    /// The number of samples is zero or beyond what the accumulators hold.
    #[error("{0} samples: ask for at least 1 and at most 2^40")]
    Samples(u64),
    /// The weights add up to nothing that can be drawn.
    #[error("nothing can be drawn: {0}")]
    Empty(String),
    /// A method's own limit is exceeded.
    #[error("{method}: {problem}")]
    Limit {
        /// The method's name.
        method: &'static str,
        /// The value, the limit, and what to use instead.
        problem: String,
    },
    /// The work was stopped from outside.
    #[error("stopped before it was finished")]
    Cancelled,
    /// A point cloud's parts do not fit each other.
    #[error("point cloud: {0}")]
    Cloud(String),
    /// The camera and the volume cannot be combined.
    #[error("camera: {0}")]
    Camera(String),
}
