//! Reading and writing volume files. A file's format is found by its content; its name is only a hint for raw data.

mod inflate;
mod options;
mod payload;
mod raw;
mod source;

use std::path::Path;

use glam::DVec3;

pub use options::{Endian, RawOptions};

use crate::{Grid, Phantom, Volume, VolumeError};
use inflate::{Coding, GZIP_MAGIC};
use source::Source;

/// Where a volume came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum FileFormat {
    /// Headerless voxels.
    Raw,
    /// Headerless voxels in gzip.
    RawGz,
    /// NRRD, attached or detached header.
    Nrrd,
    /// MetaImage, `.mha` or `.mhd`.
    MetaImage,
    /// NIfTI-1, `.nii` or `.nii.gz`.
    Nifti1,
    /// NIfTI-2, `.nii` or `.nii.gz`.
    Nifti2,
    /// Not a file: generated.
    Phantom,
}

impl std::fmt::Display for FileFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            FileFormat::Raw => "raw",
            FileFormat::RawGz => "raw.gz",
            FileFormat::Nrrd => "NRRD",
            FileFormat::MetaImage => "MetaImage",
            FileFormat::Nifti1 => "NIfTI-1",
            FileFormat::Nifti2 => "NIfTI-2",
            FileFormat::Phantom => "phantom",
        })
    }
}

/// A volume, the format that it was read from, and what a user should know about how it was read.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The volume.
    pub volume: Volume,
    /// The format found.
    pub format: FileFormat,
    /// Assumptions and overrides, one sentence each.
    pub notes: Vec<String>,
}

/// Opens a volume file of any supported format, found by its content.
///
/// # Errors
/// [`VolumeError`] when the file cannot be read, is of no known format and has no raw geometry, or when header and
/// data disagree. Nothing is allocated for voxels that the file cannot hold.
pub fn open(path: &Path, options: Option<&RawOptions>) -> Result<Loaded, VolumeError> {
    let default = RawOptions::default();
    let options = options.unwrap_or(&default);
    let source = Source::open(path)?;
    let coding = if source.bytes().starts_with(&GZIP_MAGIC) { Coding::Gzip } else { Coding::Plain };
    let loaded = raw::read(&source, coding, options)?;
    override_spacing(loaded, options)
}

/// Loads a file, or generates a phantom when the input is `phantom:NAME[@SIZE]`.
///
/// # Errors
/// As [`open`] and [`Phantom::parse`].
pub fn load(input: &str, options: Option<&RawOptions>) -> Result<Loaded, VolumeError> {
    let Some(spec) = input.strip_prefix("phantom:") else { return open(Path::new(input), options) };
    let volume = Phantom::parse(spec)?.generate()?;
    let loaded = Loaded { volume, format: FileFormat::Phantom, notes: Vec::new() };
    override_spacing(loaded, options.unwrap_or(&RawOptions::default()))
}

/// Replaces the spacing where the options give one; the first voxel's centre stays where it was.
fn override_spacing(loaded: Loaded, options: &RawOptions) -> Result<Loaded, VolumeError> {
    let Some(spacing) = options.spacing else { return Ok(loaded) };
    let Loaded { volume, format, mut notes } = loaded;
    let old = volume.grid().spacing();
    let grid = volume.grid();
    let grid = Grid::new(grid.dims(), DVec3::from_array(spacing), grid.origin(), grid.direction())?;
    if !matches!(format, FileFormat::Raw | FileFormat::RawGz) && old != grid.spacing() {
        let [x, y, z] = spacing;
        notes.push(format!(
            "spacing {} x {} x {} mm of the {format} replaced by {x} x {y} x {z} mm",
            old.x, old.y, old.z
        ));
    }
    Ok(Loaded { volume: volume.with_grid(grid)?, format, notes })
}
