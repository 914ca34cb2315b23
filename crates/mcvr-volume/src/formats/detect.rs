//! Which format a file has, by its content.

use std::io::Read;

use super::inflate::{Coding, GZIP_MAGIC, unpack};
use super::source::Source;
use super::{metaimage, nifti, nrrd, raw};

/// Bytes that are enough to tell every format, and hold a NIfTI-2 header.
const HEAD: usize = 1024;

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    /// A NRRD header.
    Nrrd,
    /// A MetaImage header.
    MetaImage,
    /// A NIfTI header, perhaps inside gzip.
    Nifti,
    /// None of the formats with a header: raw data, perhaps inside gzip.
    Unknown,
    /// Recognised, but not read; the text says what it is and what to do.
    Refused(&'static str),
}

/// Packing, content and unpacked beginning of a file.
pub(crate) fn detect(source: &Source) -> (Coding, Content, Vec<u8>) {
    let bytes = source.bytes();
    if !bytes.starts_with(&GZIP_MAGIC) {
        let head = bytes[..bytes.len().min(HEAD)].to_vec();
        return (Coding::Plain, content(&head), head);
    }
    let head = unpacked_head(bytes);
    let inside = match content(&head) {
        Content::Nrrd | Content::MetaImage => {
            Content::Refused("a NRRD or MetaImage file inside gzip is not supported; unpack it first (gunzip)")
        }
        other => other,
    };
    (Coding::Gzip, inside, head)
}

/// The first bytes that a gzip file unpacks to; fewer when it is damaged, which is reported where it is read.
fn unpacked_head(packed: &[u8]) -> Vec<u8> {
    let mut head = Vec::new();
    let mut reader = unpack(packed, Coding::Gzip).take(HEAD as u64);
    // What was read before an error stays in `head`.
    let _ = reader.read_to_end(&mut head);
    head
}

fn content(head: &[u8]) -> Content {
    if head.starts_with(nrrd::MAGIC) {
        Content::Nrrd
    } else if nifti::version(head).is_some() {
        Content::Nifti
    } else if metaimage::is_header(head) {
        Content::MetaImage
    } else if head.get(257..262) == Some(b"ustar") {
        Content::Refused(
            "is a tar archive, which is not supported; unpack it (a DICOM series: then convert it to NIfTI or NRRD, e.g. with dcm2niix)",
        )
    } else if head.get(128..132) == Some(b"DICM") {
        Content::Refused("is DICOM, which is not supported; convert the series to NIfTI or NRRD, e.g. with dcm2niix")
    } else {
        Content::Unknown
    }
}

/// What a file without a known header or geometry seems to be.
pub(crate) fn other_format(head: &[u8]) -> Option<&'static str> {
    const MAGICS: [(&[u8], &str); 12] = [
        (b"\x89PNG", "a PNG image"),
        (b"II*\0", "a TIFF image"),
        (b"MM\0*", "a TIFF image"),
        (b"\x89HDF", "an HDF5 file"),
        (b"CDF", "a NetCDF (perhaps MINC) file"),
        (b"PK\x03\x04", "a zip archive"),
        (b"BZh", "a bzip2 file"),
        (b"\xfd7zXZ", "an xz file"),
        (b"\x28\xb5\x2f\xfd", "a zstd file"),
        (b"# vtk DataFile", "a VTK file"),
        (b"<?xml", "an XML (perhaps VTK) file"),
        (b"\x93NUMPY", "a NumPy array"),
    ];
    MAGICS.iter().find(|m| head.starts_with(m.0)).map(|m| m.1)
}

/// True when the raw reader would know dimensions and type.
pub(crate) fn has_raw_geometry(source: &Source, options: &super::RawOptions) -> bool {
    let hints = raw::name_hints(&source.name());
    (options.dims.is_some() || hints.dims.is_some()) && (options.voxel_type.is_some() || hints.voxel_type.is_some())
}
