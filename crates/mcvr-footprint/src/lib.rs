//! Footprints: every voxel of positive weight adds the projection of its tent to the image.
//!
//! [`footprints()`] visits the bricks of the volume that hold any weight, projects their voxels, and adds for each of them the product
//! of its tent's projections onto the image's two axes, integrated over every pixel it meets (L. Westover, *Footprint evaluation for
//! volume rendering*, SIGGRAPH 1990; for perspective M. Zwicker et al., *EWA splatting*, IEEE Trans. Visualization and Computer
//! Graphics 8(3), 2002). There is no noise and no seed. The time goes with the voxels that are not 0, so that sparse scans are the
//! quickest. A pixel holds what it does for `mcvr-raycast`, by [`Estimand`](mcvr_scene::Estimand).
//!
//! # Bias
//!
//! What is wrong is the footprint's shape, for the true one is no product. A projected tent has the right place and mass, and along
//! each axis of the image the right variance at its place and depth, and the right shape in the view's middle. Then:
//!
//! - the two axes count as uncorrelated. They are so for cubic voxels and square pixels; other grids are refined first, which is exact
//!   ([`FootprintOptions::refine`]);
//! - places are told to 1/512 pixel, and widths to half a percent;
//! - the factor of `line` is that at the voxel's centre, and so is the near plane: a voxel whose centre lies before it is left out as a
//!   whole, where the truth cuts through it.
//!
//! [`predicted_error`] tells what that amounts to.

mod amount;
mod counters;
mod error;
mod frame;
mod gather;
mod image;
mod large;
mod law;
mod options;
mod profiles;
mod projection;
mod refine;
mod shape;
mod splat;

pub use counters::Counters;
pub use error::FootprintError;
pub use image::{FootprintImage, LookFootprints, footprints, footprints_with_look};
pub use law::{footprints_in_all, footprints_of_a_voxel, predicted_error, sums_bytes};
pub use mcvr_scene::Watch;
pub use options::{FootprintOptions, Refine};
