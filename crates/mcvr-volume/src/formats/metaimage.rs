//! MetaImage, `.mha` (header and data in one file) or `.mhd` (header and a data file); plain or zlib-packed.
//!
//! Source: <https://itk.org/Wiki/ITK/MetaIO/Documentation>. `TransformMatrix` lists the direction of the first axis, then of
//! the second, then of the third (the direction matrix in column-major order), as ITK writes and reads it.

use glam::{DMat3, DVec3};

use super::geometry::{Affine, checked_dims, millimetres};
use super::inflate::{Coding, GZIP_MAGIC};
use super::options::Endian;
use super::payload::{self, Payload};
use super::source::Source;
use super::text::{Fields, MAX_HEADER, clip, line_at};
use super::{FileFormat, Loaded};
use crate::{Volume, VolumeError, VoxelType};

const FORMAT: &str = "MetaImage";

/// True when `head` begins with a line that only MetaImage has.
pub(crate) fn is_header(head: &[u8]) -> bool {
    let mut at = 0;
    // A comment may stand first.
    for _ in 0..8 {
        let Some((line, next)) = line_at(head, at) else { return false };
        at = next;
        let key: Vec<u8> = line.iter().copied().take_while(|&b| b != b'=').collect();
        if key.len() == line.len() && !line.is_empty() {
            return false;
        }
        match key.trim_ascii() {
            b"ObjectType" | b"NDims" => return true,
            b"Comment" | b"ObjectSubType" | b"Name" | b"ID" | b"" => {}
            _ => return false,
        }
    }
    false
}

/// Reads a MetaImage file.
///
/// # Errors
/// [`VolumeError::Header`] for a field that is missing, malformed or not supported, [`VolumeError::Size`] when the data
/// are not exactly as long as the header says.
pub(crate) fn read(source: &Source) -> Result<Loaded, VolumeError> {
    let (fields, data_start) = parse_header(source)?;
    let mut notes = Vec::new();
    check_supported(&fields)?;
    let sizes = fields.integers("DimSize", fields.require(&["DimSize"])?)?;
    let dims = checked_dims(source, FORMAT, "DimSize", &sizes)?;
    let voxel_type = voxel_type(&fields, fields.require(&["ElementType"])?)?;
    let msb = flag(&fields, &["BinaryDataByteOrderMSB", "ElementByteOrderMSB"])?;
    if msb.is_none() && voxel_type.bytes() > 1 {
        notes.push("the MetaImage header gives no byte order: little-endian assumed".to_string());
    }
    let endian = if msb == Some(true) { Endian::Big } else { Endian::Little };

    let affine = affine(&fields, &mut notes)?;
    let to_mm = match fields.get(&["DistanceUnits"]) {
        Some(unit) => millimetres(unit).unwrap_or_else(|| {
            notes.push(format!("DistanceUnits '{}' not understood: mm assumed", clip(unit)));
            1.0
        }),
        None => 1.0,
    };
    let grid = affine.grid(source, FORMAT, dims, to_mm)?;
    notes.extend(affine.shear_note());
    if let Some(slope) = fields.get(&["ElementToIntensityFunctionSlope"])
        && slope.parse::<f64>().is_ok_and(|s| s != 1.0)
    {
        notes.push(format!("ElementToIntensityFunctionSlope = {} ignored, as ITK does", clip(slope)));
    }

    let file = fields.require(&["ElementDataFile"])?;
    let detached = match file {
        "LOCAL" | "Local" | "local" => None,
        "" => return Err(fields.error("ElementDataFile", "is empty")),
        _ if file.starts_with("LIST") || file.contains('%') => {
            let problem =
                format!("'{}': data spread over several files are not supported; join them into one", clip(file));
            return Err(fields.error("ElementDataFile", problem));
        }
        _ => Some(fields.data_file("ElementDataFile", file)?),
    };
    let (data, start) = detached.as_ref().map_or((source, data_start), |d| (d, 0));
    let compressed = flag(&fields, &["CompressedData"])?.unwrap_or(false);
    let need = (grid.len() as u64).saturating_mul(voxel_type.bytes() as u64);
    let start = header_size(&fields, data, start, compressed, need)?;
    let coding = match compressed {
        false => Coding::Plain,
        true if data.bytes()[start..].starts_with(&GZIP_MAGIC) => Coding::Gzip,
        true => Coding::Zlib,
    };
    let p = Payload { start, coding, skip: 0, count: grid.len(), voxel_type, endian };
    let voxels = payload::read(data, &p).map_err(|e| e.into_volume_error(data))?;
    let volume = Volume::new(grid, voxels, source.name())?;
    Ok(Loaded { volume, format: FileFormat::MetaImage, notes })
}

/// Fields of the header and the offset behind `ElementDataFile`, which is its last line.
fn parse_header(source: &Source) -> Result<(Fields<'_>, usize), VolumeError> {
    let all = source.bytes();
    let bytes = &all[..all.len().min(MAX_HEADER)];
    let mut fields = Fields::new(source, FORMAT);
    let mut at = 0;
    while let Some((line, next)) = line_at(bytes, at) {
        at = next;
        let line = String::from_utf8_lossy(line);
        if line.trim().is_empty() {
            continue;
        }
        let Some((key, value)) = line.split_once('=') else {
            return Err(fields.error(&clip(&line), "is not 'Key = value'"));
        };
        let key = key.trim().to_string();
        if key == "Comment" {
            continue;
        }
        let last = key == "ElementDataFile";
        fields.insert(key, value.trim().to_string())?;
        if last {
            return Ok((fields, at));
        }
    }
    let limit =
        if all.len() > MAX_HEADER { format!("within the first {MAX_HEADER} bytes") } else { "in the file".into() };
    Err(fields.error("ElementDataFile", format!("is missing: the header does not end {limit}")))
}

/// Refuses what this reader would get wrong.
fn check_supported(fields: &Fields<'_>) -> Result<(), VolumeError> {
    if let Some(kind) = fields.get(&["ObjectType"])
        && kind != "Image"
    {
        return Err(fields.error("ObjectType", format!("only Image is supported, got '{}'", clip(kind))));
    }
    let n = fields.require(&["NDims"])?;
    if n != "3" {
        return Err(fields.error("NDims", format!("only 3 is supported, got '{}'", clip(n))));
    }
    if let Some(channels) = fields.get(&["ElementNumberOfChannels"])
        && channels != "1"
    {
        let problem = format!("only 1 is supported, got '{}'", clip(channels));
        return Err(fields.error("ElementNumberOfChannels", problem));
    }
    if flag(fields, &["BinaryData"])? == Some(false) {
        return Err(fields.error("BinaryData", "text data are not supported; convert to binary"));
    }
    Ok(())
}

/// `True`, `False`, `1`, `0`, in any case.
fn flag(fields: &Fields<'_>, keys: &[&str]) -> Result<Option<bool>, VolumeError> {
    let Some(text) = fields.get(keys) else { return Ok(None) };
    match text.to_ascii_lowercase().as_str() {
        "true" | "t" | "1" | "yes" | "y" => Ok(Some(true)),
        "false" | "f" | "0" | "no" | "n" => Ok(Some(false)),
        _ => Err(fields.error(keys.first().unwrap_or(&""), format!("'{}' is neither True nor False", clip(text)))),
    }
}

fn voxel_type(fields: &Fields<'_>, name: &str) -> Result<VoxelType, VolumeError> {
    Ok(match name {
        "MET_UCHAR" | "MET_ASCII_CHAR" => VoxelType::U8,
        "MET_CHAR" => VoxelType::I8,
        "MET_USHORT" => VoxelType::U16,
        "MET_SHORT" => VoxelType::I16,
        // MetaIO stores a long in 4 bytes on every platform.
        "MET_UINT" | "MET_ULONG" => VoxelType::U32,
        "MET_INT" | "MET_LONG" => VoxelType::I32,
        "MET_FLOAT" => VoxelType::F32,
        "MET_DOUBLE" => VoxelType::F64,
        _ => {
            let problem = format!(
                "'{}' is not supported; one of MET_UCHAR, MET_CHAR, MET_USHORT, MET_SHORT, MET_UINT, MET_INT, MET_FLOAT, MET_DOUBLE",
                clip(name)
            );
            return Err(fields.error("ElementType", problem));
        }
    })
}

fn affine(fields: &Fields<'_>, notes: &mut Vec<String>) -> Result<Affine, VolumeError> {
    let spacing = match fields.get(&["ElementSpacing", "ElementSize"]) {
        Some(text) => DVec3::from_array(fields.numbers::<3>("ElementSpacing", text)?),
        None => {
            notes.push("the MetaImage header gives no spacing: 1 x 1 x 1 mm assumed".to_string());
            DVec3::ONE
        }
    };
    if spacing.is_nan() || spacing.min_element() <= 0.0 {
        return Err(fields.error("ElementSpacing", format!("must be positive on every axis, got {spacing}")));
    }
    let origin = match fields.get(&["Offset", "Position", "Origin"]) {
        Some(text) => DVec3::from_array(fields.numbers::<3>("Offset", text)?),
        None => DVec3::ZERO,
    };
    let direction = match fields.get(&["TransformMatrix", "Rotation", "Orientation"]) {
        Some(text) => DMat3::from_cols_array(&fields.numbers::<9>("TransformMatrix", text)?),
        None => DMat3::IDENTITY,
    };
    if let Some(anatomy) = fields.get(&["AnatomicalOrientation"])
        && anatomy != "???"
    {
        notes.push(format!("coordinates as in the file, anatomical orientation '{}'", clip(anatomy)));
    }
    Ok(Affine { axes: direction * DMat3::from_diagonal(spacing), origin })
}

/// First byte of the data: `HeaderSize` counts from the data file's beginning, -1 says that the data end the file.
fn header_size(
    fields: &Fields<'_>,
    data: &Source,
    start: usize,
    compressed: bool,
    need: u64,
) -> Result<usize, VolumeError> {
    let Some(text) = fields.get(&["HeaderSize"]) else { return Ok(start) };
    let length = data.bytes().len();
    match fields.integers("HeaderSize", text)?[..] {
        [0] => Ok(start),
        [-1] if compressed => Err(fields.error("HeaderSize", "-1 is not supported for compressed data")),
        // Where the data are too short, the size check says so.
        [-1] => Ok(usize::try_from(need).ok().and_then(|need| length.checked_sub(need)).unwrap_or(0).max(start)),
        [n] => usize::try_from(n).ok().filter(|&n| n >= start && n <= length).ok_or_else(|| {
            fields.error("HeaderSize", format!("{n} is outside of the data, bytes {start} to {length} of the file"))
        }),
        _ => Err(fields.error("HeaderSize", "one integer is needed")),
    }
}
