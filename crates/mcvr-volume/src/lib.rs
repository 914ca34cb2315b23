//! Grids, voxel types, file formats and phantoms.
//!
//! A [`Volume`] is a [`Grid`] with [`Voxels`] kept in the type in which the file stores them. [`load`] reads one from
//! a file of any supported format, found by its content, or generates a [`Phantom`].
//!
//! ```
//! let loaded = mcvr_volume::load("phantom:lobster@48", None)?;
//! let summary = mcvr_volume::Summary::of(&loaded.volume);
//! assert_eq!(loaded.volume.grid().dims(), [48, 48, 48]);
//! assert!(summary.max > 100.0 && summary.zero_share() > 0.5);
//! # Ok::<(), mcvr_volume::VolumeError>(())
//! ```

// First, because its `with_voxels!` is used by the others.
#[macro_use]
mod voxel;

mod error;
mod formats;
mod grid;
mod input;
mod phantom;
mod simd;
mod stats;
mod volume;
mod whole;

pub use error::VolumeError;
pub use formats::{Endian, FileFormat, Loaded, RawOptions, load, open, write_metaimage, write_nrrd};
pub use grid::{Grid, checked_voxel_count};
pub use input::{open_regular, read_text};
pub use phantom::{Ellipsoid, Phantom};
pub use simd::SimdLevel;
pub use stats::{HISTOGRAM_BINS, Summary, byte_order_suspicion};
pub use volume::Volume;
pub use voxel::{Buffer, Voxel, VoxelType, Voxels};
pub use whole::{check_writable, write_whole};
