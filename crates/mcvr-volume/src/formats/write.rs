//! Writers: NRRD and MetaImage, one file each, little-endian, not packed.
//!
//! Both pad the header so that the voxels begin at a multiple of 16 bytes and can be mapped in place when read.

use std::io::{self, Write};
use std::path::Path;

use glam::DVec3;

use crate::{Volume, VolumeError, Voxel, VoxelType, write_whole};

/// Alignment (bytes) of the first voxel in a written file.
const ALIGN: usize = 16;
/// Voxels that are converted at a time.
const CHUNK: usize = 1 << 16;

/// Writes an attached NRRD file (`NRRD0004`, raw, little-endian).
///
/// Voxels keep their type. A volume with a slope or intercept is written as its isovalues, because NRRD has no fields
/// for them: as `f32` when the stored type has at most 16 bits or is `f32`, else as `f64`. The file appears under its name
/// only when it is complete.
///
/// # Errors
/// [`VolumeError::Io`] when the file cannot be written or renamed.
pub fn write_nrrd(volume: &Volume, path: &Path) -> Result<(), VolumeError> {
    let grid = volume.grid();
    let voxel_type = written_type(volume);
    let type_name = match voxel_type {
        VoxelType::U8 => "uint8",
        VoxelType::I8 => "int8",
        VoxelType::U16 => "uint16",
        VoxelType::I16 => "int16",
        VoxelType::U32 => "uint32",
        VoxelType::I32 => "int32",
        VoxelType::F32 => "float",
        VoxelType::F64 => "double",
    };
    let [x, y, z] = grid.dims();
    let (h, d, o) = (grid.spacing(), grid.direction(), grid.origin());
    let vector = |v: DVec3| format!("({},{},{})", v.x, v.y, v.z);
    let header = format!(
        "NRRD0004\n# {}\ntype: {type_name}\ndimension: 3\nspace dimension: 3\nsizes: {x} {y} {z}\n\
         space directions: {} {} {}\nkinds: domain domain domain\nendian: little\nencoding: raw\nspace origin: {}\n",
        one_line(volume.name()),
        vector(d.x_axis * h.x),
        vector(d.y_axis * h.y),
        vector(d.z_axis * h.z),
        vector(o),
    );
    let header = padded(&header, "# ", "\n");
    write_file(path, &header, volume, voxel_type)
}

/// Writes a MetaImage file with the data inside (`.mha`, little-endian, not packed).
///
/// Types, slope and intercept as in [`write_nrrd`].
///
/// # Errors
/// [`VolumeError::Io`] when the file cannot be written or renamed.
pub fn write_metaimage(volume: &Volume, path: &Path) -> Result<(), VolumeError> {
    let grid = volume.grid();
    let voxel_type = written_type(volume);
    let type_name = match voxel_type {
        VoxelType::U8 => "MET_UCHAR",
        VoxelType::I8 => "MET_CHAR",
        VoxelType::U16 => "MET_USHORT",
        VoxelType::I16 => "MET_SHORT",
        VoxelType::U32 => "MET_UINT",
        VoxelType::I32 => "MET_INT",
        VoxelType::F32 => "MET_FLOAT",
        VoxelType::F64 => "MET_DOUBLE",
    };
    let [x, y, z] = grid.dims();
    let (h, o) = (grid.spacing(), grid.origin());
    let direction = grid.direction().to_cols_array().map(|v| v.to_string()).join(" ");
    let header = format!(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n\
         TransformMatrix = {direction}\nOffset = {} {} {}\nElementSpacing = {} {} {}\nDimSize = {x} {y} {z}\n\
         ElementType = {type_name}\n",
        o.x, o.y, o.z, h.x, h.y, h.z,
    );
    let header = padded(&header, "Comment = ", "ElementDataFile = LOCAL\n");
    write_file(path, &header, volume, voxel_type)
}

/// The stored type, or a float type where slope and intercept must be applied.
fn written_type(volume: &Volume) -> VoxelType {
    if volume.slope() == 1.0 && volume.intercept() == 0.0 {
        return volume.voxel_type();
    }
    match volume.voxel_type() {
        t if t.bytes() <= 2 => VoxelType::F32,
        VoxelType::F32 => VoxelType::F32,
        _ => VoxelType::F64,
    }
}

/// A header followed by a comment line that makes its length, with `end`, a multiple of [`ALIGN`].
fn padded(header: &str, comment: &str, end: &str) -> String {
    let length = header.len() + comment.len() + 1 + end.len();
    let fill = ".".repeat(length.next_multiple_of(ALIGN) - length);
    format!("{header}{comment}{fill}\n{end}")
}

fn one_line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(200).collect()
}

/// Writes header and voxels; the file is whole or absent.
fn write_file(path: &Path, header: &str, volume: &Volume, voxel_type: VoxelType) -> Result<(), VolumeError> {
    let written = write_whole(path, |out| {
        out.write_all(header.as_bytes())?;
        write_voxels(out, volume, voxel_type)
    });
    written.map_err(|source| VolumeError::Io { path: path.to_path_buf(), source })
}

fn write_voxels(out: &mut impl Write, volume: &Volume, voxel_type: VoxelType) -> io::Result<()> {
    let (slope, intercept) = (volume.slope(), volume.intercept());
    if voxel_type == volume.voxel_type() && slope == 1.0 && intercept == 0.0 {
        return with_voxels!(volume.voxels(), v => v.chunks(CHUNK).try_for_each(|c| write_little(out, c)));
    }
    with_voxels!(volume.voxels(), v => v.chunks(CHUNK).try_for_each(|chunk| {
        let isovalues = chunk.iter().map(|x| slope * x.to_f64() + intercept);
        match voxel_type {
            VoxelType::F32 => write_little(out, &isovalues.map(|x| x as f32).collect::<Vec<_>>()),
            _ => write_little(out, &isovalues.collect::<Vec<_>>()),
        }
    }))
}

/// Writes values with their least significant byte first.
fn write_little<T: Voxel>(out: &mut impl Write, values: &[T]) -> io::Result<()> {
    if cfg!(target_endian = "big") {
        let swapped: Vec<T> = values.iter().map(|v| v.swap_bytes()).collect();
        return out.write_all(bytemuck::cast_slice(&swapped));
    }
    out.write_all(bytemuck::cast_slice(values))
}
