//! NRRD, attached (`.nrrd`) or detached (`.nhdr` and a data file); encodings raw and gzip.
//!
//! Source: the format's definition at <https://teem.sourceforge.net/nrrd/format.html>.

use glam::{DMat3, DVec3};

use super::geometry::{Affine, checked_dims, millimetres};
use super::inflate::Coding;
use super::options::Endian;
use super::payload::{self, Payload};
use super::source::Source;
use super::text::{Fields, MAX_HEADER, clip, line_at};
use super::{FileFormat, Loaded};
use crate::{Volume, VolumeError, VoxelType};

const FORMAT: &str = "NRRD";
/// What every NRRD file begins with; a version digit follows.
pub(crate) const MAGIC: &[u8] = b"NRRD000";

/// Reads a NRRD file.
///
/// # Errors
/// [`VolumeError::Header`] for a field that is missing, malformed or not supported, [`VolumeError::Size`] when the data
/// are not exactly as long as the header says.
pub(crate) fn read(source: &Source) -> Result<Loaded, VolumeError> {
    let (fields, data_start) = parse_header(source)?;
    let mut notes = Vec::new();

    let dimension = fields.require(&["dimension"])?;
    if dimension.trim() != "3" {
        return Err(fields.error("dimension", format!("only 3 is supported, got '{}'", clip(dimension))));
    }
    let sizes = fields.integers("sizes", fields.require(&["sizes"])?)?;
    let dims = checked_dims(source, FORMAT, "sizes", &sizes)?;
    let type_name = fields.require(&["type"])?;
    let voxel_type = voxel_type(type_name).ok_or_else(|| fields.error("type", unsupported_type(type_name)))?;
    let endian = endian(&fields, voxel_type, &mut notes)?;
    let encoding = fields.require(&["encoding"])?.to_ascii_lowercase();
    let coding = match encoding.as_str() {
        "raw" => Coding::Plain,
        "gzip" | "gz" => Coding::Gzip,
        _ => {
            let problem = format!("'{}' is not supported; convert to encoding raw or gzip", clip(&encoding));
            return Err(fields.error("encoding", problem));
        }
    };
    if let Some(kinds) = fields.get(&["kinds"])
        && let Some(kind) = kinds.split_whitespace().find(|k| !matches!(*k, "domain" | "space" | "none" | "???"))
    {
        notes.push(format!("axis kind '{}' of the NRRD ignored: every axis is taken as spatial", clip(kind)));
    }

    let affine = affine(&fields, &mut notes)?;
    let grid = affine.grid(source, FORMAT, dims, length_unit(&fields, &mut notes))?;
    notes.extend(affine.shear_note());

    let detached = match fields.get(&["data file", "datafile"]) {
        Some(name) => Some(open_data_file(&fields, name)?),
        None => None,
    };
    let (data, start) = detached.as_ref().map_or((source, data_start), |d| (d, 0));
    let start = skip_lines(&fields, data, start)?;
    let byte_skip = fields.get(&["byte skip", "byteskip"]).unwrap_or("0");
    let byte_skip = match fields.integers("byte skip", byte_skip)?[..] {
        [n] => n,
        _ => return Err(fields.error("byte skip", "one integer is needed")),
    };
    let mut p = Payload { start, coding, skip: 0, count: grid.len(), voxel_type, endian };
    match (u64::try_from(byte_skip), coding) {
        (Ok(skip), _) => p.skip = skip,
        (Err(_), Coding::Plain) if byte_skip == -1 => {
            // The voxels are the last bytes of the file.
            let need = (grid.len() as u64).saturating_mul(voxel_type.bytes() as u64);
            p.skip = ((data.bytes().len() - start) as u64).saturating_sub(need);
        }
        _ => {
            return Err(fields.error("byte skip", format!("{byte_skip} is not supported with encoding {encoding}")));
        }
    }
    let voxels = payload::read(data, &p).map_err(|e| e.into_volume_error(data))?;
    let volume = Volume::new(grid, voxels, source.name())?;
    Ok(Loaded { volume, format: FileFormat::Nrrd, notes })
}

/// Fields of the header and the offset behind the empty line that ends it.
fn parse_header(source: &Source) -> Result<(Fields<'_>, usize), VolumeError> {
    let all = source.bytes();
    let bytes = &all[..all.len().min(MAX_HEADER)];
    let mut fields = Fields::new(source, FORMAT);
    let version = bytes.get(MAGIC.len()).copied().unwrap_or(b'?');
    let Some((magic, mut at)) = line_at(bytes, 0) else {
        return Err(fields.error("magic", "the file is empty"));
    };
    if magic.len() != MAGIC.len() + 1 || !(b'1'..=b'5').contains(&version) {
        let magic = clip(&String::from_utf8_lossy(magic));
        return Err(fields.error("magic", format!("'{magic}' is not one of NRRD0001 to NRRD0005")));
    }
    loop {
        let line = line_at(bytes, at);
        if all.len() > MAX_HEADER && line.is_none_or(|(_, next)| next == bytes.len()) {
            return Err(fields.error("end", format!("no empty line within the first {MAX_HEADER} bytes")));
        }
        let Some((line, next)) = line else {
            // A detached header may end without an empty line.
            if fields.get(&["data file", "datafile"]).is_some() {
                return Ok((fields, all.len()));
            }
            return Err(fields.error("end", "the file ends before the empty line that ends the header"));
        };
        at = next;
        if line.is_empty() {
            return Ok((fields, at));
        }
        if line.starts_with(b"#") {
            continue;
        }
        let line = String::from_utf8_lossy(line);
        let Some((key, value)) = line.split_once(':') else {
            return Err(fields.error(&clip(&line), "is not a comment, 'field: value' or 'key:=value'"));
        };
        // `key:=value` is free text of the writer.
        if !value.starts_with('=') {
            fields.insert(key.trim().to_ascii_lowercase(), value.trim().to_string())?;
        }
    }
}

fn voxel_type(name: &str) -> Option<VoxelType> {
    let words: Vec<String> = name.split_whitespace().map(str::to_ascii_lowercase).collect();
    Some(match words.join(" ").as_str() {
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => VoxelType::U8,
        "signed char" | "int8" | "int8_t" => VoxelType::I8,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => VoxelType::U16,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => VoxelType::I16,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => VoxelType::U32,
        "int" | "signed int" | "int32" | "int32_t" => VoxelType::I32,
        "float" => VoxelType::F32,
        "double" => VoxelType::F64,
        _ => return None,
    })
}

fn unsupported_type(name: &str) -> String {
    let all: Vec<&str> = VoxelType::ALL.iter().map(|t| t.name()).collect();
    format!("'{}' is not supported; the types are {}", clip(name), all.join(", "))
}

fn endian(fields: &Fields<'_>, voxel_type: VoxelType, notes: &mut Vec<String>) -> Result<Endian, VolumeError> {
    match fields.get(&["endian"]) {
        Some(text) => match text.to_ascii_lowercase().as_str() {
            "little" => Ok(Endian::Little),
            "big" => Ok(Endian::Big),
            _ => Err(fields.error("endian", format!("'{}' is neither 'little' nor 'big'", clip(text)))),
        },
        None => {
            if voxel_type.bytes() > 1 {
                notes.push("the NRRD header gives no 'endian': little-endian assumed".to_string());
            }
            Ok(Endian::Little)
        }
    }
}

/// `(1,0,0)` as a vector.
fn vector(fields: &Fields<'_>, field: &str, text: &str) -> Result<DVec3, VolumeError> {
    let inner = text.trim().strip_prefix('(').and_then(|t| t.strip_suffix(')'));
    let inner = inner.ok_or_else(|| fields.error(field, format!("'{}' is not a vector '(x,y,z)'", clip(text))))?;
    Ok(DVec3::from_array(fields.numbers::<3>(field, &inner.replace(',', " "))?))
}

/// `(1,0,0) (0,1,0) (0,0,1)`, with any white space, as the columns of a matrix.
fn vectors(fields: &Fields<'_>, field: &str, text: &str) -> Result<DMat3, VolumeError> {
    let parts: Vec<&str> = text.split_inclusive(')').filter(|p| !p.trim().is_empty()).collect();
    let [x, y, z] = parts[..] else {
        return Err(fields.error(field, format!("three vectors '(x,y,z)' are needed, got '{}'", clip(text))));
    };
    Ok(DMat3::from_cols(vector(fields, field, x)?, vector(fields, field, y)?, vector(fields, field, z)?))
}

fn affine(fields: &Fields<'_>, notes: &mut Vec<String>) -> Result<Affine, VolumeError> {
    if let Some(n) = fields.get(&["space dimension"])
        && n != "3"
    {
        return Err(fields.error("space dimension", format!("only 3 is supported, got '{}'", clip(n))));
    }
    let origin = match fields.get(&["space origin"]) {
        Some(text) => vector(fields, "space origin", text)?,
        None => DVec3::ZERO,
    };
    if let Some(space) = fields.get(&["space"]) {
        notes.push(format!("coordinates as in the file, space '{}'", clip(space)));
    }
    if let Some(text) = fields.get(&["space directions"]) {
        return Ok(Affine { axes: vectors(fields, "space directions", text)?, origin });
    }
    let Some(text) = fields.get(&["spacings"]) else {
        notes.push("the NRRD header gives no spacing: 1 x 1 x 1 mm assumed".to_string());
        return Ok(Affine::axis_aligned(DVec3::ONE, origin));
    };
    let mut spacing = fields.numbers::<3>("spacings", text)?;
    for s in &mut spacing {
        if s.is_nan() {
            notes.push("a spacing of the NRRD is NaN (unknown): 1 mm assumed".to_string());
            *s = 1.0;
        }
        if *s <= 0.0 {
            return Err(fields.error("spacings", format!("must be positive, got {s}")));
        }
    }
    Ok(Affine::axis_aligned(DVec3::from_array(spacing), origin))
}

/// Millimetres per unit of the header's lengths: from `space units: "mm" "mm" "mm"`, else 1.
fn length_unit(fields: &Fields<'_>, notes: &mut Vec<String>) -> f64 {
    let Some(text) = fields.get(&["space units"]) else { return 1.0 };
    let units: Vec<&str> = text.split('"').skip(1).step_by(2).collect();
    let same = units.first().filter(|u| units.iter().all(|v| v == *u)).and_then(|u| millimetres(u));
    match same {
        Some(1.0) => 1.0,
        Some(mm) => {
            notes.push(format!("lengths converted from {text} to mm"));
            mm
        }
        None => {
            notes.push(format!("space units '{}' not understood: mm assumed", clip(text)));
            1.0
        }
    }
}

fn open_data_file(fields: &Fields<'_>, name: &str) -> Result<Source, VolumeError> {
    if name.starts_with("LIST") || name.contains('%') {
        let problem = format!("'{}': data spread over several files are not supported; join them into one", clip(name));
        return Err(fields.error("data file", problem));
    }
    fields.data_file("data file", name)
}

/// Start of the data after `line skip` lines.
fn skip_lines(fields: &Fields<'_>, data: &Source, start: usize) -> Result<usize, VolumeError> {
    let text = fields.get(&["line skip", "lineskip"]).unwrap_or("0");
    let lines = match fields.integers("line skip", text)?[..] {
        [n] if n >= 0 => n,
        _ => return Err(fields.error("line skip", format!("a count of lines is needed, got '{}'", clip(text)))),
    };
    let mut at = start;
    for _ in 0..lines {
        let found = line_at(data.bytes(), at).map(|l| l.1);
        at = found.ok_or_else(|| fields.error("line skip", format!("the data have fewer than {lines} lines")))?;
    }
    Ok(at)
}
