//! Files of every format, type, byte order and packing, made by hand rather than by the crate's writers.
#![allow(clippy::unwrap_used, reason = "helpers of tests, which clippy does not take for tests")]
#![allow(dead_code, reason = "each test binary uses a part")]

use std::io::Write;
use std::path::PathBuf;

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use mcvr_volume::{Endian, VoxelType};

/// Extents of the made files: all different, so that swapped axes show.
pub const DIMS: [usize; 3] = [5, 4, 3];
/// Number of voxels of the made files.
pub const COUNT: usize = 60;

/// How a made file packs its voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Packing {
    Plain,
    Packed,
}

/// Stored value of voxel `n` of a made file; every type holds it exactly, and no byte of wide types is always 0.
pub fn value(n: usize, voxel_type: VoxelType) -> f64 {
    let n = n as f64;
    match voxel_type {
        VoxelType::U8 => n * 4.0,
        VoxelType::I8 => n * 4.0 - 120.0,
        VoxelType::U16 => n * 1000.0 + 7.0,
        VoxelType::I16 => n * 1000.0 - 30_000.0,
        VoxelType::U32 => n * 70_000_003.0,
        VoxelType::I32 => n * 70_000_003.0 - 2_000_000_000.0,
        VoxelType::F32 => n * 0.375 - 3.0,
        VoxelType::F64 => (n - 20.0) / 3.0,
    }
}

/// One stored value as bytes.
pub fn encode(x: f64, voxel_type: VoxelType, endian: Endian) -> Vec<u8> {
    let mut b = match voxel_type {
        VoxelType::U8 => (x as u8).to_le_bytes().to_vec(),
        VoxelType::I8 => (x as i8).to_le_bytes().to_vec(),
        VoxelType::U16 => (x as u16).to_le_bytes().to_vec(),
        VoxelType::I16 => (x as i16).to_le_bytes().to_vec(),
        VoxelType::U32 => (x as u32).to_le_bytes().to_vec(),
        VoxelType::I32 => (x as i32).to_le_bytes().to_vec(),
        VoxelType::F32 => (x as f32).to_le_bytes().to_vec(),
        VoxelType::F64 => x.to_le_bytes().to_vec(),
    };
    if endian == Endian::Big {
        b.reverse();
    }
    b
}

/// All voxels of a made file as bytes.
pub fn payload(voxel_type: VoxelType, endian: Endian) -> Vec<u8> {
    (0..COUNT).flat_map(|n| encode(value(n, voxel_type), voxel_type, endian)).collect()
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut e = GzEncoder::new(Vec::new(), Compression::best());
    e.write_all(bytes).unwrap();
    e.finish().unwrap()
}

pub fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut e = ZlibEncoder::new(Vec::new(), Compression::best());
    e.write_all(bytes).unwrap();
    e.finish().unwrap()
}

fn nrrd_type(t: VoxelType) -> &'static str {
    match t {
        VoxelType::U8 => "unsigned char",
        VoxelType::I8 => "int8_t",
        VoxelType::U16 => "unsigned short int",
        VoxelType::I16 => "short",
        VoxelType::U32 => "uint32",
        VoxelType::I32 => "signed int",
        VoxelType::F32 => "float",
        VoxelType::F64 => "double",
    }
}

/// A NRRD header without its end; `extra` are whole lines.
pub fn nrrd_header(t: VoxelType, endian: Endian, packing: Packing, extra: &str) -> String {
    let endian = if endian == Endian::Big { "big" } else { "little" };
    let encoding = if packing == Packing::Packed { "gzip" } else { "raw" };
    format!(
        "NRRD0004\n# a comment\ntype: {}\ndimension: 3\nsizes: 5 4 3\nencoding: {encoding}\nendian: {endian}\nkey:=free text\n{extra}",
        nrrd_type(t)
    )
}

pub fn nrrd(t: VoxelType, endian: Endian, packing: Packing) -> Vec<u8> {
    let extra = "space: left-posterior-superior\nkinds: domain domain domain\n\
                 space directions: (0,0.5,0) (-2,0,0) (0,0,3)\nspace origin: (10,-20,30.5)\n\n";
    let mut file = nrrd_header(t, endian, packing, extra).into_bytes();
    let data = payload(t, endian);
    file.extend(if packing == Packing::Packed { gzip(&data) } else { data });
    file
}

fn met_type(t: VoxelType) -> &'static str {
    match t {
        VoxelType::U8 => "MET_UCHAR",
        VoxelType::I8 => "MET_CHAR",
        VoxelType::U16 => "MET_USHORT",
        VoxelType::I16 => "MET_SHORT",
        VoxelType::U32 => "MET_UINT",
        VoxelType::I32 => "MET_INT",
        VoxelType::F32 => "MET_FLOAT",
        VoxelType::F64 => "MET_DOUBLE",
    }
}

/// A MetaImage header whose data file is `file`; `extra` are whole lines.
pub fn metaimage_header(t: VoxelType, endian: Endian, packing: Packing, extra: &str, file: &str) -> String {
    let msb = if endian == Endian::Big { "True" } else { "False" };
    let packed = if packing == Packing::Packed { "True" } else { "False" };
    format!(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = {msb}\nCompressedData = {packed}\n\
         TransformMatrix = 0 1 0 -1 0 0 0 0 1\nOffset = 10 -20 30.5\nCenterOfRotation = 0 0 0\nElementSpacing = 0.5 2 3\n\
         DimSize = 5 4 3\n{extra}ElementType = {}\nElementDataFile = {file}\n",
        met_type(t)
    )
}

pub fn metaimage(t: VoxelType, endian: Endian, packing: Packing) -> Vec<u8> {
    let mut file = metaimage_header(t, endian, packing, "", "LOCAL").into_bytes();
    let data = payload(t, endian);
    file.extend(if packing == Packing::Packed { zlib(&data) } else { data });
    file
}

/// NIfTI datatype code.
pub fn nifti_code(t: VoxelType) -> i16 {
    match t {
        VoxelType::U8 => 2,
        VoxelType::I8 => 256,
        VoxelType::U16 => 512,
        VoxelType::I16 => 4,
        VoxelType::U32 => 768,
        VoxelType::I32 => 8,
        VoxelType::F32 => 16,
        VoxelType::F64 => 64,
    }
}

/// Writes numbers into a header at fixed offsets, in one byte order.
pub struct Patch<'a>(pub &'a mut [u8], pub Endian);

impl Patch<'_> {
    fn put(&mut self, at: usize, le: &[u8]) {
        let mut b = le.to_vec();
        if self.1 == Endian::Big {
            b.reverse();
        }
        self.0[at..at + b.len()].copy_from_slice(&b);
    }
    pub fn i16(&mut self, at: usize, x: i16) {
        self.put(at, &x.to_le_bytes());
    }
    pub fn i32(&mut self, at: usize, x: i32) {
        self.put(at, &x.to_le_bytes());
    }
    pub fn i64(&mut self, at: usize, x: i64) {
        self.put(at, &x.to_le_bytes());
    }
    pub fn f32(&mut self, at: usize, x: f32) {
        self.put(at, &x.to_le_bytes());
    }
    pub fn f64(&mut self, at: usize, x: f64) {
        self.put(at, &x.to_le_bytes());
    }
}

/// The sform of the made NIfTI files, row by row: the same placing as the other formats'.
pub const SROW: [[f64; 4]; 3] = [[0.0, -2.0, 0.0, 10.0], [0.5, 0.0, 0.0, -20.0], [0.0, 0.0, 3.0, 30.5]];

/// A NIfTI-1 header and its four extension bytes, with an sform.
pub fn nifti1_header(t: VoxelType, endian: Endian) -> Vec<u8> {
    let mut h = vec![0u8; 352];
    h[344..348].copy_from_slice(b"n+1\0");
    let mut p = Patch(&mut h, endian);
    p.i32(0, 348);
    for (n, d) in [4i16, 5, 4, 3, 1, 1, 1, 1].into_iter().enumerate() {
        p.i16(40 + 2 * n, d);
    }
    p.i16(70, nifti_code(t));
    p.i16(72, 8 * t.bytes() as i16);
    for (n, s) in [1.0f32, 0.5, 2.0, 3.0, 1.0, 1.0, 1.0, 1.0].into_iter().enumerate() {
        p.f32(76 + 4 * n, s);
    }
    p.f32(108, 352.0);
    p.0[123] = 2;
    p.i16(254, 1);
    for (r, row) in SROW.iter().enumerate() {
        for (c, x) in row.iter().enumerate() {
            p.f32(280 + 16 * r + 4 * c, *x as f32);
        }
    }
    h
}

/// A NIfTI-2 header and its four extension bytes, with an sform.
pub fn nifti2_header(t: VoxelType, endian: Endian) -> Vec<u8> {
    let mut h = vec![0u8; 544];
    h[4..12].copy_from_slice(b"n+2\0\r\n\x1a\n");
    let mut p = Patch(&mut h, endian);
    p.i32(0, 540);
    p.i16(12, nifti_code(t));
    p.i16(14, 8 * t.bytes() as i16);
    for (n, d) in [3i64, 5, 4, 3, 1, 1, 1, 1].into_iter().enumerate() {
        p.i64(16 + 8 * n, d);
    }
    for (n, s) in [1.0, 0.5, 2.0, 3.0, 1.0, 1.0, 1.0, 1.0].into_iter().enumerate() {
        p.f64(104 + 8 * n, s);
    }
    p.i64(168, 544);
    p.i32(348, 1);
    for (r, row) in SROW.iter().enumerate() {
        for (c, x) in row.iter().enumerate() {
            p.f64(400 + 32 * r + 8 * c, *x);
        }
    }
    p.i32(500, 2);
    h
}

/// A whole NIfTI file of version 1 or 2.
pub fn nifti(version: u8, t: VoxelType, endian: Endian, packing: Packing) -> Vec<u8> {
    let mut file = if version == 1 { nifti1_header(t, endian) } else { nifti2_header(t, endian) };
    file.extend(payload(t, endian));
    if packing == Packing::Packed { gzip(&file) } else { file }
}

/// A folder that is removed when dropped.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}
