//! The scan, as a file of a given size and voxel type.

use std::path::Path;

use mcvr::volume::{Volume, Voxels, load, write_nrrd};

use crate::Outcome;

/// Voxel types that can be asked for.
pub const TYPES: [&str; 4] = ["u8", "u16", "i16", "f32"];

/// Writes the lobster; 16-bit and wider types hold the same structure with more digits, `i16` as Hounsfield units.
pub fn write(side: usize, kind: &str, path: &Path) -> Outcome<()> {
    let phantom = load(&format!("phantom:lobster@{side}"), None)?.volume;
    let Voxels::U8(bytes) = phantom.voxels() else { return Err("the lobster is made of bytes".into()) };
    let (grid, name) = (phantom.grid().clone(), phantom.name());
    let volume = match kind {
        "u16" => Volume::from_vec(grid, bytes.iter().map(|v| u16::from(*v) * 16).collect(), name)?,
        "i16" => Volume::from_vec(grid, bytes.iter().map(|v| i16::from(*v) * 16 - 1000).collect(), name)?,
        "f32" => Volume::from_vec(grid, bytes.iter().map(|v| f32::from(*v) * 0.37).collect(), name)?,
        _ => phantom,
    };
    Ok(write_nrrd(&volume, path)?)
}
