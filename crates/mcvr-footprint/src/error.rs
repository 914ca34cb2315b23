//! What can go wrong with footprints.

use mcvr_scene::Kernel;

/// Errors of this crate.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FootprintError {
    /// Only the tent's projections are tabulated.
    #[error(
        "footprints are those of the kernel 'tent', not of '{0}'; use tent, or rays, march, comb or exact for '{0}'"
    )]
    Kernel(Kernel),

    /// Footprints know the plain X-ray only.
    #[error("footprints know no effects along the ray; use march, comb, exact or a sampling method")]
    Effects,

    /// Too many parts of a voxel.
    #[error("footprints may refine a voxel 1 to {limit} times along each axis, got {given}")]
    Refine {
        /// What was asked for.
        given: u32,
        /// The largest that is accepted.
        limit: u32,
    },

    /// Positions are kept in 32-bit floats.
    #[error(
        "a volume of {dims:?} voxels has too long an axis for footprints: at most {limit}; use rays, comb or exact"
    )]
    Extent {
        /// Voxels along x, y and z.
        dims: [usize; 3],
        /// Most along one axis.
        limit: usize,
    },

    /// No memory for the sums.
    #[error("no memory for the sums of an image with its margin: {bytes} bytes; ask for a smaller image")]
    Memory {
        /// Bytes of one image of sums.
        bytes: u64,
    },

    /// The image cannot be made.
    #[error("the image of footprints: {0}")]
    Image(String),

    /// The work was stopped from outside.
    #[error("cancelled")]
    Cancelled,
}
