//! What can go wrong when casting rays.

use mcvr_volume::Grid;

/// Most voxels along an axis.
const EXTENT_LIMIT: usize = 1 << 30;

/// # Errors
/// [`RaycastError::Extent`].
pub(crate) fn check_extents(grid: &Grid) -> Result<(), RaycastError> {
    let dims = grid.dims();
    let long = dims.iter().any(|&n| n > EXTENT_LIMIT);
    if long { Err(RaycastError::Extent { dims, limit: EXTENT_LIMIT }) } else { Ok(()) }
}

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

    /// Rays are integrated exactly for the plain X-ray only.
    #[error("exact rays know no effects along the ray; use march, comb, exact or a sampling method")]
    Effects,

    /// Means over pixels are told from values on a grid only.
    #[error("averaging over pixels needs a square number of rays a pixel without jitter, got {rays}{}", if *jitter { " with jitter" } else { "" })]
    Grid {
        /// Rays a pixel.
        rays: u32,
        /// Whether they are at random places.
        jitter: bool,
    },

    /// A ray serves a block of pixels only where means are told from neighbours.
    #[error(
        "blocks of pixels that share a ray must be 1 to {limit} pixels wide, and those of more than 1 need one ray each and averaging over pixels, got {given}"
    )]
    Block {
        /// Pixels along a side.
        given: u32,
        /// The largest that is accepted.
        limit: u32,
    },

    /// The error that may be left between rays is no share.
    #[error("the error that adaptive rays may leave must be positive and finite (a share of the mean pixel), got {0}")]
    Left(f64),

    /// The noise of adaptive rays is no share.
    #[error("the noise of adaptive rays is a share of what their halves differ by: zero or more and finite, got {0}")]
    Noise(f64),

    /// Adaptive rays begin at another distance.
    #[error("adaptive rays begin with one for a block of 4, 2 or 1 pixels along a side, got {0}")]
    Coarsest(u32),

    /// Adaptive rays are for the plain X-ray.
    #[error(
        "rays are cast where the image needs them only for a plain X-ray by comb or rays under kernel 'tent', without jitter; \
         cast a fixed number of rays a pixel"
    )]
    Adaptive,

    /// Adaptive rays go sixteen at a time only.
    #[error(
        "adaptive rays go sixteen at a time, which serves voxels of 8 and 16 bits and f32 whose weights are in the range of f32, \
         fewer than 2^31 of them, and linear maps of f32; cast a fixed number of rays a pixel"
    )]
    Packets,

    /// An image that is to be checked is not the camera's.
    #[error("the image that is checked: {0}")]
    Checked(String),

    /// The image with its margin is too large.
    #[error("the image with a margin for its means: {0}")]
    Image(String),

    /// Cells along a ray are counted in 32 bits.
    #[error("a volume of {dims:?} voxels has too long an axis to cast rays through: at most {limit}")]
    Extent {
        /// Voxels along x, y and z.
        dims: [usize; 3],
        /// Most along one axis.
        limit: usize,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_beyond_32_bits_are_refused() {
        let grid = |n: usize| Grid::with_spacing([2, n, 1], [1.0; 3]).unwrap();
        assert_eq!(check_extents(&grid(EXTENT_LIMIT)), Ok(()));
        let text = check_extents(&grid(EXTENT_LIMIT + 1)).unwrap_err().to_string();
        assert!(text.contains("1073741825") && text.contains("1073741824"), "{text}");
    }
}
