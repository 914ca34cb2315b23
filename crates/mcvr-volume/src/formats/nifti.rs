//! NIfTI-1 and NIfTI-2 in one file, `.nii` or `.nii.gz`, of either byte order.
//!
//! Sources: <https://nifti.nimh.nih.gov/pub/dist/src/niftilib/nifti1.h>, <https://nifti.nimh.nih.gov/pub/dist/doc/nifti2.h>.
//! The `nifti` crate reads the NIfTI-1 header; the voxels are read here, in their own type, because the sizes of a
//! hostile header must be checked before memory is taken.

use glam::{DMat3, DVec3};

use super::geometry::{Affine, checked_dims};
use super::inflate::Coding;
use super::options::Endian;
use super::payload::{self, Payload};
use super::source::Source;
use super::{FileFormat, Loaded};
use crate::{Volume, VolumeError, VoxelType};

const FORMAT: &str = "NIfTI";
/// Length of a NIfTI-1 header, and the value of its first field.
const SIZE_1: usize = 348;
/// Length of a NIfTI-2 header, and the value of its first field.
const SIZE_2: usize = 540;

/// A header of either version, in this machine's byte order.
#[derive(Clone, Debug)]
struct Header {
    format: FileFormat,
    endian: Endian,
    dim: [i64; 8],
    datatype: i16,
    bitpix: i16,
    pixdim: [f64; 8],
    /// Offset of the first voxel; not a whole number in a broken NIfTI-1 file.
    vox_offset: f64,
    slope: f64,
    intercept: f64,
    units: i64,
    qform_code: i64,
    sform_code: i64,
    quatern: DVec3,
    quatern_offset: DVec3,
    srow: [[f64; 4]; 3],
}

/// The version of the NIfTI file that begins with `head`: 1 or 2.
pub(crate) fn version(head: &[u8]) -> Option<u8> {
    let first = head.first_chunk::<4>().map(|b| (u32::from_le_bytes(*b) as usize, u32::from_be_bytes(*b) as usize))?;
    let has = |at: usize, magics: [&[u8]; 2]| magics.iter().any(|m| head.get(at..at + 4) == Some(m));
    if (first.0 == SIZE_1 || first.1 == SIZE_1) && has(344, [b"n+1\0", b"ni1\0"]) {
        return Some(1);
    }
    ((first.0 == SIZE_2 || first.1 == SIZE_2) && has(4, [b"n+2\0", b"ni2\0"])).then_some(2)
}

/// Reads a NIfTI file whose (unpacked) beginning is `head`.
///
/// # Errors
/// [`VolumeError::Header`] for a field that is malformed or not supported, [`VolumeError::Size`] when the data are
/// not exactly as long as the header says.
pub(crate) fn read(source: &Source, coding: Coding, head: &[u8]) -> Result<Loaded, VolumeError> {
    let fail = |field: &str, problem: String| source.header_error(FORMAT, field, problem);
    let (h, magic) = match version(head) {
        Some(1) => (parse_1(source, head)?, &head[344..348]),
        _ => (parse_2(source, head)?, head.get(4..8).unwrap_or(b"")),
    };
    if magic.starts_with(b"ni") {
        let problem = "a pair of .hdr and .img is not supported; convert to one .nii file";
        return Err(fail("magic", problem.to_string()));
    }
    let mut notes = Vec::new();
    let dims = dims(source, &h)?;
    let voxel_type = voxel_type(source, &h)?;
    let (affine, which) = affine(&h, &mut notes);
    notes.push(format!("coordinates as in the file (RAS+), from {which}"));
    let to_mm = match h.units & 7 {
        1 => 1000.0,
        3 => 1e-3,
        _ => 1.0,
    };
    if to_mm != 1.0 {
        notes.push(format!("lengths converted to mm (factor {to_mm})"));
    }
    let grid = affine.grid(source, FORMAT, dims, to_mm)?;
    notes.extend(affine.shear_note());

    let least = if h.format == FileFormat::Nifti1 { SIZE_1 + 4 } else { SIZE_2 + 4 } as f64;
    let offset = if h.vox_offset == 0.0 { least } else { h.vox_offset };
    // A writer may put the data right behind the header, without the four extension bytes.
    if offset.is_nan() || offset < least - 4.0 || offset.fract() != 0.0 || offset > (1u64 << 50) as f64 {
        let problem = format!("{} is not a whole number of bytes from {least} on", h.vox_offset);
        return Err(fail("vox_offset", problem));
    }
    let p = Payload { start: 0, coding, skip: offset as u64, count: grid.len(), voxel_type, endian: h.endian };
    let voxels = payload::read(source, &p).map_err(|e| e.into_volume_error(source))?;
    let volume = Volume::new(grid, voxels, source.name())?;
    let volume = rescaled(volume, &h, &mut notes)?;
    Ok(Loaded { volume, format: h.format, notes })
}

/// Slope 0 means that the stored values are the isovalues.
fn rescaled(volume: Volume, h: &Header, notes: &mut Vec<String>) -> Result<Volume, VolumeError> {
    if h.slope == 0.0 || (h.slope == 1.0 && h.intercept == 0.0) {
        return Ok(volume);
    }
    if !h.slope.is_finite() || !h.intercept.is_finite() {
        notes.push(format!("scl_slope {} and scl_inter {} ignored: not finite", h.slope, h.intercept));
        return Ok(volume);
    }
    notes.push(format!("isovalue = {} * stored + {}", h.slope, h.intercept));
    volume.with_rescale(h.slope, h.intercept)
}

fn parse_1(source: &Source, head: &[u8]) -> Result<Header, VolumeError> {
    let h = nifti::NiftiHeader::from_reader(&head[..SIZE_1])
        .map_err(|e| source.header_error(FORMAT, "header", e.to_string()))?;
    if h.sizeof_hdr as usize != SIZE_1 {
        let problem = format!("the byte orders of sizeof_hdr ({}) and of dim[0] ({}) differ", h.sizeof_hdr, h.dim[0]);
        return Err(source.header_error(FORMAT, "dim", problem));
    }
    let native = h.endianness == nifti::Endianness::native();
    let wide = |row: [f32; 4]| row.map(f64::from);
    Ok(Header {
        format: FileFormat::Nifti1,
        endian: match (native, Endian::NATIVE) {
            (true, order) => order,
            (false, Endian::Little) => Endian::Big,
            (false, Endian::Big) => Endian::Little,
        },
        // The crate reads the signed extents as unsigned; negative ones must not become large ones.
        dim: h.dim.map(|n| i64::from(n as i16)),
        datatype: h.datatype,
        bitpix: h.bitpix,
        pixdim: h.pixdim.map(f64::from),
        vox_offset: f64::from(h.vox_offset),
        slope: f64::from(h.scl_slope),
        intercept: f64::from(h.scl_inter),
        units: i64::from(h.xyzt_units),
        qform_code: i64::from(h.qform_code),
        sform_code: i64::from(h.sform_code),
        quatern: DVec3::new(h.quatern_b.into(), h.quatern_c.into(), h.quatern_d.into()),
        quatern_offset: DVec3::new(h.quatern_x.into(), h.quatern_y.into(), h.quatern_z.into()),
        srow: [wide(h.srow_x), wide(h.srow_y), wide(h.srow_z)],
    })
}

fn parse_2(source: &Source, head: &[u8]) -> Result<Header, VolumeError> {
    let Some(bytes) = head.first_chunk::<SIZE_2>() else {
        let problem = format!("truncated: a NIfTI-2 header has {SIZE_2} bytes, the file has {}", head.len());
        return Err(source.size_error(problem));
    };
    let big = bytes[..4] == (SIZE_2 as u32).to_be_bytes();
    // Offsets below are those of nifti2.h and lie within the header.
    let field = |at: usize, n: usize| {
        let mut le = [0u8; 8];
        le[..n].copy_from_slice(&bytes[at..at + n]);
        if big {
            le[..n].reverse();
        }
        u64::from_le_bytes(le)
    };
    let i16_at = |at| field(at, 2) as i16;
    let i32_at = |at| i64::from(field(at, 4) as i32);
    let i64_at = |at| field(at, 8) as i64;
    let f64_at = |at| f64::from_bits(field(at, 8));
    let row = |at| std::array::from_fn(|n| f64_at(at + 8 * n));
    Ok(Header {
        format: FileFormat::Nifti2,
        endian: if big { Endian::Big } else { Endian::Little },
        dim: std::array::from_fn(|n| i64_at(16 + 8 * n)),
        datatype: i16_at(12),
        bitpix: i16_at(14),
        pixdim: std::array::from_fn(|n| f64_at(104 + 8 * n)),
        vox_offset: i64_at(168) as f64,
        slope: f64_at(176),
        intercept: f64_at(184),
        units: i32_at(500),
        qform_code: i32_at(344),
        sform_code: i32_at(348),
        quatern: DVec3::new(f64_at(352), f64_at(360), f64_at(368)),
        quatern_offset: DVec3::new(f64_at(376), f64_at(384), f64_at(392)),
        srow: [row(400), row(432), row(464)],
    })
}

/// Three extents; a fourth to seventh axis may only have extent 1.
fn dims(source: &Source, h: &Header) -> Result<[usize; 3], VolumeError> {
    let n = h.dim[0];
    if !(3..=7).contains(&n) {
        return Err(source.header_error(FORMAT, "dim[0]", format!("3 to 7 dimensions are supported, got {n}")));
    }
    for axis in 4..=n as usize {
        if h.dim[axis] != 1 {
            let problem = format!("only one volume per file is supported, got {} along this axis", h.dim[axis]);
            return Err(source.header_error(FORMAT, format!("dim[{axis}]"), problem));
        }
    }
    checked_dims(source, FORMAT, "dim", &h.dim[1..4])
}

fn voxel_type(source: &Source, h: &Header) -> Result<VoxelType, VolumeError> {
    let voxel_type = match h.datatype {
        2 => VoxelType::U8,
        4 => VoxelType::I16,
        8 => VoxelType::I32,
        16 => VoxelType::F32,
        64 => VoxelType::F64,
        256 => VoxelType::I8,
        512 => VoxelType::U16,
        768 => VoxelType::U32,
        code => {
            let name = match code {
                1 => " (binary)",
                32 | 1792 | 2048 => " (complex)",
                128 | 2304 => " (colour)",
                1024 | 1280 => " (64-bit integer)",
                1536 => " (128-bit float)",
                _ => "",
            };
            let all: Vec<&str> = VoxelType::ALL.iter().map(|t| t.name()).collect();
            let problem = format!("{code}{name} is not supported; the types are {}", all.join(", "));
            return Err(source.header_error(FORMAT, "datatype", problem));
        }
    };
    if h.bitpix != 0 && h.bitpix as i64 != 8 * voxel_type.bytes() as i64 {
        let problem = format!("{} does not agree with datatype {} ({voxel_type})", h.bitpix, h.datatype);
        return Err(source.header_error(FORMAT, "bitpix", problem));
    }
    Ok(voxel_type)
}

/// The map from voxel to world and where it was taken from: sform, else qform, else pixdim.
fn affine(h: &Header, notes: &mut Vec<String>) -> (Affine, &'static str) {
    if h.sform_code > 0 {
        let column = |c: usize| DVec3::new(h.srow[0][c], h.srow[1][c], h.srow[2][c]);
        let affine = Affine { axes: DMat3::from_cols(column(0), column(1), column(2)), origin: column(3) };
        if affine.is_usable() {
            return (affine, "sform");
        }
        notes.push("the sform is singular or not finite and was ignored".to_string());
    }
    let spacing = DVec3::from_array([1, 2, 3].map(|a| {
        let s = h.pixdim[a].abs();
        if s.is_finite() && s > 0.0 {
            return s;
        }
        notes.push(format!("pixdim[{a}] is {}: 1 mm assumed", h.pixdim[a]));
        1.0
    }));
    if h.qform_code > 0 {
        let flip = if h.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        let turn = quaternion_matrix(h.quatern);
        let axes = turn * DMat3::from_diagonal(spacing * DVec3::new(1.0, 1.0, flip));
        let affine = Affine { axes, origin: h.quatern_offset };
        if affine.is_usable() {
            return (affine, "qform");
        }
        notes.push("the qform is not finite and was ignored".to_string());
    }
    (Affine::axis_aligned(spacing, DVec3::ZERO), "pixdim")
}

/// Rotation matrix of the unit quaternion with vector part (b, c, d) and a scalar part a that is not negative
/// (nifti1.h, "quaternion representation of rotation matrix"). NaN for a quaternion that is not finite.
fn quaternion_matrix(v: DVec3) -> DMat3 {
    let rest = 1.0 - v.length_squared();
    let (a, v) = if rest < 1e-7 { (0.0, v / v.length()) } else { (rest.sqrt(), v) };
    let [b, c, d] = v.to_array();
    DMat3::from_cols(
        DVec3::new(a * a + b * b - c * c - d * d, 2.0 * (b * c + a * d), 2.0 * (b * d - a * c)),
        DVec3::new(2.0 * (b * c - a * d), a * a + c * c - b * b - d * d, 2.0 * (c * d + a * b)),
        DVec3::new(2.0 * (b * d + a * c), 2.0 * (c * d - a * b), a * a + d * d - b * b - c * c),
    )
}
