//! Headerless voxels, plain or gzip-packed, described by options or by the file's name.

use super::inflate::{Coding, MAX_DEFLATE_RATIO};
use super::options::{Endian, RawOptions};
use super::payload::{self, Found, Payload, PayloadError, unpacked_size};
use super::source::Source;
use super::{FileFormat, Loaded};
use crate::{Grid, Volume, VolumeError, VoxelType, byte_order_suspicion, checked_voxel_count};

/// What a file's name says: the convention `NAME_301x324x56_uint16be.raw[.gz]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct NameHints {
    pub(crate) dims: Option<[usize; 3]>,
    pub(crate) voxel_type: Option<VoxelType>,
    pub(crate) endian: Option<Endian>,
}

/// Reads dimensions, type and byte order out of a file's name.
pub(crate) fn name_hints(name: &str) -> NameHints {
    let mut hints = NameHints::default();
    for token in name.split(['_', '.', '-', ' ']) {
        if hints.dims.is_none()
            && let Some(dims) = parse_dims(token)
        {
            hints.dims = Some(dims);
        } else if hints.voxel_type.is_none()
            && let Some((voxel_type, endian)) = parse_type(token)
        {
            hints.voxel_type = Some(voxel_type);
            hints.endian = endian;
        }
    }
    hints
}

/// `301x324x56` as three numbers.
pub(crate) fn parse_dims(token: &str) -> Option<[usize; 3]> {
    let mut parts = token
        .split('x')
        .map(|p| (!p.is_empty() && p.bytes().all(|b| b.is_ascii_digit())).then(|| p.parse::<usize>().ok()).flatten());
    let dims = [parts.next()??, parts.next()??, parts.next()??];
    parts.next().is_none().then_some(dims)
}

/// `uint16be`, `int8`, `float32le`, `u16` as a type and a byte order.
fn parse_type(token: &str) -> Option<(VoxelType, Option<Endian>)> {
    let token = token.to_ascii_lowercase();
    let (name, endian) = match (token.strip_suffix("le"), token.strip_suffix("be")) {
        (Some(name), _) => (name, Some(Endian::Little)),
        (_, Some(name)) => (name, Some(Endian::Big)),
        _ => (token.as_str(), None),
    };
    let short = match name {
        "uint8" => "u8",
        "int8" => "i8",
        "uint16" => "u16",
        "int16" => "i16",
        "uint32" => "u32",
        "int32" => "i32",
        "float32" | "float" => "f32",
        "float64" | "double" => "f64",
        other => other,
    };
    Some((short.parse().ok()?, endian))
}

/// Reads a raw file.
///
/// # Errors
/// [`VolumeError::Format`] when dimensions or type are known neither from the options nor from the name,
/// [`VolumeError::Size`] when the size differs, with the geometries that would fit.
pub(crate) fn read(source: &Source, coding: Coding, options: &RawOptions) -> Result<Loaded, VolumeError> {
    let hints = name_hints(&source.name());
    let mut notes = Vec::new();
    let dims = options.dims.or(hints.dims);
    let voxel_type = options.voxel_type.or(hints.voxel_type);
    let (Some(dims), Some(voxel_type)) = (dims, voxel_type) else {
        return Err(source.format_error(unknown_geometry(source, coding, dims, voxel_type)));
    };
    let count = checked_voxel_count(dims).map_err(|e| source.size_error(e.to_string()))?;
    let inferred = [
        (options.dims.is_none(), format!("dimensions {}", display_dims(dims))),
        (options.voxel_type.is_none(), format!("type {voxel_type}")),
    ];
    let inferred: Vec<String> = inferred.into_iter().filter(|i| i.0).map(|i| i.1).collect();
    if !inferred.is_empty() {
        notes.push(format!("{} taken from the file's name", inferred.join(" and ")));
    }
    let endian = options.endian.or(hints.endian).unwrap_or_else(|| {
        if voxel_type.bytes() > 1 {
            notes.push("byte order not given: little-endian assumed".to_string());
        }
        Endian::Little
    });
    if options.spacing.is_none() {
        notes.push("a raw file has no spacing: 1 x 1 x 1 mm assumed".to_string());
    }
    let p = Payload { start: 0, coding, skip: options.skip, count, voxel_type, endian };
    let voxels = payload::read(source, &p).map_err(|e| match e {
        PayloadError::Size { expected, found } => {
            source.size_error(mismatch(dims, voxel_type, options.skip, expected, found))
        }
        other => other.into_volume_error(source),
    })?;
    let grid = Grid::with_spacing(dims, [1.0; 3])?;
    let volume = Volume::new(grid, voxels, source.name())?;
    notes.extend(byte_order_suspicion(&volume));
    let format = if coding == Coding::Plain { FileFormat::Raw } else { FileFormat::RawGz };
    Ok(Loaded { volume, format, notes })
}

fn display_dims([x, y, z]: [usize; 3]) -> String {
    format!("{x}x{y}x{z}")
}

/// What to say when neither options nor name tell the geometry.
fn unknown_geometry(
    source: &Source,
    coding: Coding,
    dims: Option<[usize; 3]>,
    voxel_type: Option<VoxelType>,
) -> String {
    let missing = match (dims, voxel_type) {
        (None, None) => "dimensions and voxel type",
        (None, Some(_)) => "dimensions",
        _ => "voxel type",
    };
    let mut text = format!(
        "not NRRD, MetaImage or NIfTI, so read as raw; give its {missing} (as options, or in the name: NAME_301x324x56_uint8.raw)"
    );
    match unpacked_size(source.bytes(), coding, 1 << 30) {
        Ok(Found::Exactly(n)) => {
            text += &format!("; it holds {n} bytes");
            let fits = match dims {
                Some(dims) => types_that_fit(dims, n, 0),
                None => cubes_that_fit(n),
            };
            if !fits.is_empty() {
                text += &format!(", which fits {}", fits.join(", "));
            }
        }
        Ok(_) => {}
        Err(e) => text += &format!("; its gzip data are damaged: {e}"),
    }
    text
}

/// What to say about a size that differs.
fn mismatch(dims: [usize; 3], voxel_type: VoxelType, skip: u64, expected: u64, found: Found) -> String {
    let wanted = match skip {
        0 => format!("{} voxels of {voxel_type} take {expected} bytes", display_dims(dims)),
        _ => format!("{skip} skipped bytes and {} voxels of {voxel_type} take {expected} bytes", display_dims(dims)),
    };
    let n = match found {
        Found::Exactly(n) => n,
        Found::AtLeast(n) => return format!("{wanted}, but the file holds at least {n}"),
        Found::AtMost(n) => {
            return format!(
                "{wanted}, but a gzip file of this length holds at most {n} bytes ({MAX_DEFLATE_RATIO} to 1); check the dimensions"
            );
        }
    };
    let mut fits = types_that_fit(dims, n, skip);
    let slice = dims[0] as u64 * dims[1] as u64 * voxel_type.bytes() as u64;
    if let Some(rest) = n.checked_sub(skip)
        && rest > 0
        && rest % slice == 0
    {
        fits.push(format!("{}x{}x{} of {voxel_type}", dims[0], dims[1], rest / slice));
    }
    if n > expected && n - expected <= 1 << 20 {
        fits.push(format!(
            "{} of {voxel_type} after a header of {} bytes (skip)",
            display_dims(dims),
            skip + n - expected
        ));
    }
    fits.extend(cubes_that_fit(n.saturating_sub(skip)));
    let difference =
        if n < expected { format!("{} too few", expected - n) } else { format!("{} too many", n - expected) };
    let what_fits = if fits.is_empty() {
        "check dimensions and type".to_string()
    } else {
        format!("would fit: {}", fits.join("; "))
    };
    format!("{wanted}, but the file holds {n} bytes ({difference}); {what_fits}")
}

fn types_that_fit(dims: [usize; 3], n: u64, skip: u64) -> Vec<String> {
    let Ok(count) = checked_voxel_count(dims) else { return Vec::new() };
    VoxelType::ALL
        .iter()
        .filter(|t| (count as u64).checked_mul(t.bytes() as u64).and_then(|b| b.checked_add(skip)) == Some(n))
        .map(|t| format!("{} of {t}", display_dims(dims)))
        .collect()
}

fn cubes_that_fit(n: u64) -> Vec<String> {
    let widths = [(1, "u8"), (2, "u16 or i16"), (4, "u32, i32 or f32"), (8, "f64")];
    let fits = widths.into_iter().filter_map(|(bytes, names)| {
        let side = ((n / bytes) as f64).cbrt().round() as u64;
        let cube = side.checked_pow(3)?.checked_mul(bytes)?;
        (side > 1 && cube == n).then(|| format!("{side}x{side}x{side} of {names}"))
    });
    fits.collect()
}
