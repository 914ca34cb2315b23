//! Reading and writing volume files. A file's format is found by its content; its name is only a hint for raw data.

mod detect;
mod geometry;
mod inflate;
mod metaimage;
mod nifti;
mod nrrd;
mod options;
mod payload;
mod raw;
mod source;
mod text;
mod write;

use std::path::Path;

use glam::DVec3;

pub use options::{Endian, RawOptions};
pub use write::{write_metaimage, write_nrrd};

use crate::{Grid, Phantom, Volume, VolumeError};
use detect::Content;
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
    let (coding, content, head) = detect::detect(&source);
    let mut loaded = match content {
        Content::Nrrd => nrrd::read(&source)?,
        Content::MetaImage => metaimage::read(&source)?,
        Content::Nifti => nifti::read(&source, coding, &head)?,
        // Whoever gives dimensions and type knows better than a few magic bytes.
        Content::Refused(why) if options.dims.is_none() || options.voxel_type.is_none() => {
            return Err(source.format_error(why));
        }
        Content::Refused(_) | Content::Unknown => {
            if !detect::has_raw_geometry(&source, options)
                && let Some(what) = detect::other_format(&head)
            {
                return Err(source.format_error(format!(
                    "seems to be {what}, which is not supported; convert it to NRRD, MetaImage or NIfTI"
                )));
            }
            raw::read(&source, coding, options)?
        }
    };
    if options.describes_raw() && !matches!(loaded.format, FileFormat::Raw | FileFormat::RawGz) {
        let note = format!("the file is {}: dimensions, type, byte order and skip are its header's", loaded.format);
        loaded.notes.push(note);
    }
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

/// Replaces the spacing where the options give one; the first voxel's centre stays where it was (a phantom's middle
/// stays at the world's origin).
fn override_spacing(loaded: Loaded, options: &RawOptions) -> Result<Loaded, VolumeError> {
    let Some(spacing) = options.spacing else { return Ok(loaded) };
    let Loaded { volume, format, mut notes } = loaded;
    let old = volume.grid().spacing();
    let grid = volume.grid();
    let mut grid = Grid::new(grid.dims(), DVec3::from_array(spacing), grid.origin(), grid.direction())?;
    if format == FileFormat::Phantom {
        grid = Grid::new(grid.dims(), grid.spacing(), grid.origin() - grid.centre(), grid.direction())?;
    }
    if !matches!(format, FileFormat::Raw | FileFormat::RawGz) && old != grid.spacing() {
        let [x, y, z] = spacing;
        notes.push(format!(
            "spacing {} x {} x {} mm of the {format} replaced by {x} x {y} x {z} mm",
            old.x, old.y, old.z
        ));
    }
    Ok(Loaded { volume: volume.with_grid(grid)?, format, notes })
}
