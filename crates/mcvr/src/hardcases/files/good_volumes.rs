//! Good volume files: what the writers write, and by hand what they do not.

use std::io::{Result, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use glam::{DMat3, DVec3};
use mcvr_volume::{Grid, Volume, write_metaimage, write_nrrd};

use super::super::CaseError;
use super::good::{GoodFile, Reader};

/// Extents of the volumes.
pub(super) const DIMS: [usize; 3] = [8, 6, 5];

/// Smooth voxels on a turned grid.
pub(super) fn volume() -> std::result::Result<Volume, CaseError> {
    let turn = DMat3::from_cols(DVec3::Y, -DVec3::X, DVec3::Z);
    let grid = Grid::new(DIMS, DVec3::new(0.5, 1.0, 2.0), DVec3::new(10.0, -20.0, 30.5), turn)?;
    let voxels: Vec<i16> = (0..240).map(|n| 40 * (n % 8) - 7 * (n / 8)).collect();
    Ok(Volume::from_vec(grid, voxels, "good")?)
}

/// A file for every format, plain and packed, in one piece and in two.
pub(super) fn volumes(folder: &Path) -> std::result::Result<Vec<GoodFile>, CaseError> {
    let volume = volume()?;
    let path = folder.join("made");
    let parts = |write: &dyn Fn(&Path) -> std::result::Result<(), mcvr_volume::VolumeError>| {
        write(&path)?;
        let mut header = std::fs::read(&path)?;
        let data = header.split_off(header.len() - volume.bytes());
        Ok::<_, CaseError>((String::from_utf8_lossy(&header).into_owned(), data))
    };
    let (nrrd, data) = parts(&|p| write_nrrd(&volume, p))?;
    let (meta, _) = parts(&|p| write_metaimage(&volume, p))?;
    let file = |format: &'static str, name, header: &[u8], data: &[u8]| GoodFile {
        format,
        reader: Reader::Volume,
        name,
        bytes: [header, data].concat(),
        beside: None,
        header: header.len(),
        text: !(format.starts_with("NIfTI") || format.starts_with("raw")),
        sealed: format.ends_with("packed"),
    };
    let beside = |good: GoodFile| GoodFile { beside: Some(("data.raw", data.clone())), ..good };
    let [one, two] = [1, 2].map(nifti_header);
    Ok(vec![
        file("NRRD", "a.nrrd", nrrd.as_bytes(), &data),
        file("NRRD, packed", "a.nrrd", nrrd.replace("encoding: raw", "encoding: gzip").as_bytes(), &gzip(&data)?),
        beside(file(
            "NRRD, detached",
            "a.nhdr",
            (nrrd.trim_end().to_owned() + "\ndata file: data.raw\n").as_bytes(),
            b"",
        )),
        file("MetaImage", "a.mha", meta.as_bytes(), &data),
        file("MetaImage, packed", "a.mha", meta.replace("Data = False", "Data = True").as_bytes(), &zlib(&data)?),
        beside(file("MetaImage, detached", "a.mhd", meta.replace("= LOCAL", "= data.raw").as_bytes(), b"")),
        file("NIfTI-1", "a.nii", &one, &data),
        file("NIfTI-2", "a.nii", &two, &data),
        file("NIfTI-1, packed", "a.nii.gz", b"", &gzip(&[one.clone(), data.clone()].concat())?),
        file("NIfTI-2, packed", "a.nii.gz", b"", &gzip(&[two.clone(), data.clone()].concat())?),
        file("raw", "scan_8x6x5_int16le.raw", b"", &data),
        file("raw, packed", "scan_8x6x5_int16le.raw.gz", b"", &gzip(&data)?),
    ])
}

/// Packs as gzip.
pub(super) fn gzip(bytes: &[u8]) -> Result<Vec<u8>> {
    let mut out = GzEncoder::new(Vec::new(), Compression::best());
    out.write_all(bytes)?;
    out.finish()
}

/// Packs as zlib.
pub(super) fn zlib(bytes: &[u8]) -> Result<Vec<u8>> {
    let mut out = ZlibEncoder::new(Vec::new(), Compression::best());
    out.write_all(bytes)?;
    out.finish()
}

/// A NIfTI header with its four extension bytes, little-endian, of [`volume`] without its turn; offsets as in nifti1.h and
/// nifti2.h.
fn nifti_header(version: u8) -> Vec<u8> {
    let first = version == 1;
    let mut h = vec![0u8; if first { 352 } else { 544 }];
    let size = h.len() as u32 - 4;
    let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &size.to_le_bytes());
    put(if first { 344 } else { 4 }, if first { b"n+1\0" } else { b"n+2\0\r\n\x1a\n" });
    put(if first { 70 } else { 12 }, &4i16.to_le_bytes());
    put(if first { 72 } else { 14 }, &16i16.to_le_bytes());
    for (n, extent) in [3i16, 8, 6, 5, 1, 1, 1, 1].into_iter().enumerate() {
        match first {
            true => put(40 + 2 * n, &extent.to_le_bytes()),
            false => put(16 + 8 * n, &i64::from(extent).to_le_bytes()),
        }
    }
    for (n, step) in [1.0f32, 0.5, 1.0, 2.0].into_iter().enumerate() {
        match first {
            true => put(76 + 4 * n, &step.to_le_bytes()),
            false => put(104 + 8 * n, &f64::from(step).to_le_bytes()),
        }
    }
    match first {
        true => put(108, &352f32.to_le_bytes()),
        false => put(168, &544i64.to_le_bytes()),
    }
    h
}
