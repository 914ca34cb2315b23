//! Grids, voxel types, file formats and phantoms.
//!
//! A [`Volume`] is a [`Grid`] with [`Voxels`] kept in the type in which the file stores them.

mod error;
mod grid;
mod volume;
mod voxel;

pub use error::VolumeError;
pub use grid::{Grid, checked_voxel_count};
pub use volume::Volume;
pub use voxel::{Buffer, Voxel, VoxelType, Voxels};
