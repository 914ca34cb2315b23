//! What a caller can say about a file: geometry of headerless data, and a spacing for any format.

use serde::{Deserialize, Serialize};

use crate::VoxelType;

/// Byte order of multi-byte voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Endian {
    /// Least significant byte first (x86, ARM).
    Little,
    /// Most significant byte first.
    Big,
}

impl Endian {
    /// The byte order of this machine.
    pub const NATIVE: Endian = if cfg!(target_endian = "big") { Endian::Big } else { Endian::Little };

    /// True when values stored in this order must be swapped on this machine.
    pub fn is_swapped(self) -> bool {
        self != Self::NATIVE
    }
}

impl std::fmt::Display for Endian {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Endian::Little => "little-endian",
            Endian::Big => "big-endian",
        })
    }
}

impl std::str::FromStr for Endian {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s.to_ascii_lowercase().as_str() {
            "little" | "le" | "little-endian" | "lsb" => Ok(Endian::Little),
            "big" | "be" | "big-endian" | "msb" => Ok(Endian::Big),
            _ => Err(format!("unknown byte order '{s}'; one of little, big")),
        }
    }
}

/// Options for opening a file. `dims`, `voxel_type`, `endian` and `skip` describe headerless (raw) files;
/// each wins over what the file's name says and is ignored, with a note, by formats that have a header.
/// `spacing` replaces the spacing of every format.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RawOptions {
    /// Number of voxels along (x, y, z); x varies fastest in the file.
    pub dims: Option<[usize; 3]>,
    /// Type of one voxel.
    pub voxel_type: Option<VoxelType>,
    /// Byte order; little-endian when neither this nor the name says.
    pub endian: Option<Endian>,
    /// Millimetres per voxel along (x, y, z); 1, 1, 1 for raw files when not given.
    pub spacing: Option<[f64; 3]>,
    /// Bytes before the first voxel (after decompression).
    pub skip: u64,
}

impl RawOptions {
    /// True when something is said that only a headerless file needs.
    pub(crate) fn describes_raw(&self) -> bool {
        self.dims.is_some() || self.voxel_type.is_some() || self.endian.is_some() || self.skip != 0
    }
}
