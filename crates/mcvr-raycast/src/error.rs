//! What can go wrong when casting rays.

/// Errors of this crate.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RaycastError {
    /// The kernel has no density that could be integrated along a ray.
    #[error(
        "kernel 'shell' has no separable density, so no ray can be integrated through it; use box, tent or bspline3"
    )]
    Shell,

    /// The tolerance cannot be met by any computation.
    #[error("the reference's tolerance must be positive and finite (a share of the mean pixel), got {0}")]
    Tolerance(f64),

    /// The subdivision limit is too large.
    #[error("the reference may halve a pixel's side at most {limit} times, got {given}")]
    Depth {
        /// What was asked for.
        given: u32,
        /// The largest that is accepted.
        limit: u32,
    },

    /// The march would not advance.
    #[error("the march's step must be positive and finite (in units of the smallest voxel spacing), got {0}")]
    Step(f64),

    /// The march would take days.
    #[error(
        "the march's step of {given} (in units of the smallest voxel spacing) would take more than {limit} steps a ray; \
         this volume's smallest is {smallest:.3e}"
    )]
    Steps {
        /// What was asked for.
        given: f64,
        /// The smallest that is accepted.
        smallest: f64,
        /// Most steps on a ray.
        limit: u32,
    },

    /// No ray was asked for, or more than can be laid out in a pixel.
    #[error("rays per pixel must lie between 1 and {limit}, got {given}")]
    Rays {
        /// What was asked for.
        given: u32,
        /// The largest that is accepted.
        limit: u32,
    },

    /// The work was stopped from outside.
    #[error("cancelled")]
    Cancelled,
}
