//! Packed data: bombs, promises and lies.

use std::path::Path;
use std::process::Command;

use super::super::{Case, CaseError, Context, Finding};
use super::case;
use super::damage::{May, Tally, judge};
use super::good::{GoodFile, good_files};
use super::good_volumes::{DIMS, gzip, zlib};

pub(super) const CASES: &[Case] = &[
    case(
        "file-packing-lies",
        "a header says gzip and the data are plain, or the other way round, and noise comes out",
        "refused whatever the header says against the data; packing of headerless files is known by content",
        lies,
    ),
    case(
        "file-bombs",
        "a megabyte unpacks to a gigabyte, and the memory is gone before the size is looked at",
        "gzip and PNG bombs are refused by the program within 512 MiB of address space",
        bombs,
    ),
    case(
        "file-promises",
        "a header of a hundred bytes promises 2^40 voxels, and memory is taken for them",
        "such headers of every format are refused by the program within 512 MiB of address space",
        promises,
    ),
];

/// Exact. A raw file is found packed or not by its first bytes, under either name.
fn lies(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let files = good_files(folder.path())?;
    let mut total = Tally::default();
    for good in &files {
        let (header, data) = good.bytes.split_at(good.header);
        let text = String::from_utf8_lossy(header).into_owned();
        let swapped = |from: &str, to: &str| [text.replace(from, to).as_bytes(), data].concat();
        let variants = match good.format {
            "NRRD" => vec![("gzip over plain data".to_owned(), swapped("encoding: raw", "encoding: gzip"))],
            "NRRD, packed" => vec![
                ("raw over gzip".to_owned(), swapped("encoding: gzip", "encoding: raw")),
                ("gzip twice".to_owned(), [header, &gzip(data)?].concat()),
                ("zlib for gzip".to_owned(), [header, &zlib(&[7; 480])?].concat()),
                ("all inside gzip".to_owned(), gzip(&good.bytes)?),
            ],
            "MetaImage" => vec![("zlib over plain data".to_owned(), swapped("Data = False", "Data = True"))],
            "MetaImage, packed" => vec![("plain over zlib".to_owned(), swapped("Data = True", "Data = False"))],
            "NIfTI-1, packed" | "NIfTI-2, packed" => vec![("gzip twice".to_owned(), gzip(&good.bytes)?)],
            _ => vec![],
        };
        total += judge(context, good, May::Refuse, &variants)?;
        let content = match good.format {
            "raw" => vec![("packed under a plain name".to_owned(), gzip(&good.bytes)?)],
            "MetaImage, packed" => {
                vec![("gzip for zlib".to_owned(), [header, &gzip(&plain_data(&files))?].concat())]
            }
            _ => vec![],
        };
        total += judge(context, good, May::Keep, &content)?;
    }
    Ok(total.finding("files", "gzip data in a MetaImage are read, as ITK reads them"))
}

/// The voxels of the good volumes.
fn plain_data(files: &[GoodFile]) -> Vec<u8> {
    files.iter().find(|g| g.format == "raw").map(|g| g.bytes.clone()).unwrap_or_default()
}

/// Runs a command of the program on a file under a limit of its address space; its exit status, if it ended by itself,
/// and its error. Address space is more than memory, so the limit holds for that as well: 512 MiB, of which threads and
/// libraries reserve some 200.
fn limited(program: &Path, command: &str, file: &Path) -> Result<(Option<i32>, String), CaseError> {
    let mut shell = Command::new("sh");
    shell
        .args(["-c", "ulimit -v 524288 && exec \"$@\"", "sh"])
        .arg(program)
        .args(["--threads", "2", command])
        .arg(file);
    if command == "compare" {
        shell.arg(file);
    }
    let out = shell.output().map_err(|e| CaseError::Impossible(format!("no shell: {e}")))?;
    Ok((out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned()))
}

/// Whether the program refused each file, with status 1 and an error that names it: name, command that reads it, content.
fn refused(context: &Context, files: &[(&str, &str, Vec<u8>)]) -> Result<Finding, CaseError> {
    let program = context.program()?;
    if !cfg!(target_os = "linux") {
        return Err(CaseError::Impossible("address space is limited by `ulimit -v` of Linux".into()));
    }
    let folder = context.folder()?;
    let mut total = Tally::default();
    let good = folder.path().join("good_8x6x5_int16.raw");
    std::fs::write(&good, vec![1; 480])?;
    let (code, error) = limited(program, "info", &good)?;
    total.check(&format!("a good file: {error}"), code == Some(0));
    for (name, command, bytes) in files {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes)?;
        let (code, error) = limited(program, command, &path)?;
        total.check(&format!("{name}: {code:?} {error}"), code == Some(1) && error.contains(&*path.to_string_lossy()));
        std::fs::remove_file(&path)?;
    }
    Ok(total.finding("files", ""))
}

/// Exact. One gzip member of 32 MiB of zeros, 32 KiB long, repeated to a gibibyte; a name that asks for 8 bytes of it, for
/// all of it but one byte, and a NIfTI header in front of it.
fn bombs(context: &Context) -> Result<Finding, CaseError> {
    let member = gzip(&vec![0; 32 << 20])?;
    let bomb = member.repeat(32);
    let folder = context.folder()?;
    let files = good_files(folder.path())?;
    let header = |format: &str| files.iter().find(|g| g.format == format).map(|g| g.bytes[..g.header].to_vec());
    let mut nifti = gzip(&header("NIfTI-1").unwrap_or_default())?;
    nifti.extend(&bomb);
    let mut nrrd = header("NRRD, packed").unwrap_or_default();
    nrrd.extend(&bomb);
    let mut png = picture(20_000, 20_000, 8);
    // One row after another of zeros; the picture would take 400 MB.
    png.extend(chunk(b"IDAT", &zlib(&vec![0; 32 << 20])?));
    png.extend(chunk(b"IEND", b""));
    refused(
        context,
        &[
            ("bomb_2x2x2_uint8.raw.gz", "info", bomb.clone()),
            ("bomb_2x2x2_float64.raw", "info", bomb),
            ("bomb.nii.gz", "info", nifti),
            ("bomb.nrrd", "info", nrrd),
            ("bomb.png", "compare", png),
        ],
    )
}

/// The beginning of a grey PNG.
fn picture(width: u32, height: u32, depth: u8) -> Vec<u8> {
    let header = [&width.to_be_bytes()[..], &height.to_be_bytes(), &[depth, 0, 0, 0, 0]].concat();
    [b"\x89PNG\r\n\x1a\n".to_vec(), chunk(b"IHDR", &header)].concat()
}

fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let mut sum = flate2::Crc::new();
    sum.update(kind);
    sum.update(data);
    [&(data.len() as u32).to_be_bytes()[..], kind, data, &sum.sum().to_be_bytes()].concat()
}

/// Found by fuzzing: 12 x 10 pixels in tiles of 64 x 8,388,672, for which a decoder asked for two gigabytes.
fn tiled_exr() -> Vec<u8> {
    let attribute = |name: &str, kind: &str, value: &[u8]| {
        [name.as_bytes(), b"\0", kind.as_bytes(), b"\0", &(value.len() as u32).to_le_bytes(), value].concat()
    };
    let channel =
        |name: &[u8]| [name, b"\0", &2u32.to_le_bytes(), &[0; 4], &1u32.to_le_bytes(), &1u32.to_le_bytes()].concat();
    let window = [0u32, 0, 11, 9].map(u32::to_le_bytes).concat();
    let tiles = [&64u32.to_le_bytes()[..], &8_388_672u32.to_le_bytes(), &[0]].concat();
    let one = 1f32.to_le_bytes();
    [
        vec![0x76, 0x2f, 0x31, 0x01, 2, 2, 0, 0],
        attribute("channels", "chlist", &[channel(b"B"), channel(b"G"), channel(b"R"), vec![0]].concat()),
        attribute("compression", "compression", &[1]),
        attribute("dataWindow", "box2i", &window),
        attribute("displayWindow", "box2i", &window),
        attribute("lineOrder", "lineOrder", &[0]),
        attribute("pixelAspectRatio", "float", &one),
        attribute("screenWindowCenter", "v2f", &[0; 8]),
        attribute("screenWindowWidth", "float", &one),
        attribute("tiles", "tiledesc", &tiles),
        vec![0; 64],
    ]
    .concat()
}

/// Exact. Each promises a gibibyte or more, in a file of a few hundred bytes.
fn promises(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let files = good_files(folder.path())?;
    let good = |format: &str| {
        let found = files.iter().find(|g| g.format == format);
        found.ok_or_else(|| CaseError::from(format!("no good {format}")))
    };
    let edit = |format: &str, from: &str, to: &str| -> Result<Vec<u8>, CaseError> {
        let good = good(format)?;
        let at = good.bytes.windows(from.len()).position(|w| w == from.as_bytes());
        let at = at.ok_or_else(|| CaseError::from(format!("{format} without {from}")))?;
        Ok(good.with(at..at + from.len(), to.as_bytes()))
    };
    let [x, y, z] = DIMS;
    let extents = format!("{x} {y} {z}");
    let mut nifti = good("NIfTI-2")?.bytes.clone();
    nifti[24..32].copy_from_slice(&(1i64 << 30).to_le_bytes());
    let mut array = b"\x93NUMPY\x02\x00".to_vec();
    array.extend(u32::MAX.to_le_bytes());
    array.extend(&good("NPY")?.bytes[10..]);
    let png = [picture(1 << 30, 1, 8), chunk(b"IDAT", &zlib(b"0")?), chunk(b"IEND", b"")].concat();
    let window = |format: &str, value: &[u8; 4], to: u32| -> Result<Vec<u8>, CaseError> {
        let mut bytes = good(format)?.bytes.clone();
        for at in 0..bytes.len() - 4 {
            if bytes[at..at + 4] == *value {
                bytes[at..at + 4].copy_from_slice(&to.to_le_bytes());
            }
        }
        Ok(bytes)
    };
    // Found by fuzzing: sample formats for four million channels.
    let mut tiff = good("TIFF")?.bytes.clone();
    let tag = tiff.windows(4).position(|w| w == [0x53, 0x01, 3, 0]).ok_or("a TIFF without sample formats")?;
    tiff[tag + 4..tag + 8].copy_from_slice(&(1u32 << 26).to_le_bytes());
    // Found by fuzzing: a meaning of pixels for eight million channels, for which a decoder asked for 256 MB before it heard of limits.
    let mut bytes = good("TIFF")?.bytes.clone();
    let tag = bytes.windows(4).position(|w| w == [6, 1, 3, 0]).ok_or("a TIFF without a photometric interpretation")?;
    bytes[tag + 4..tag + 8].copy_from_slice(&8_000_000u32.to_le_bytes());
    refused(
        context,
        &[
            ("d.tiff", "compare", bytes),
            ("a.nrrd", "info", edit("NRRD", &extents, "1048576 1048576 1")?),
            ("b.nrrd", "info", edit("NRRD, packed", &extents, "65536 65536 16")?),
            ("a.mha", "info", edit("MetaImage", &extents, "4096 4096 4096")?),
            ("b.mha", "info", edit("MetaImage, packed", &extents, "4096 4096 4096")?),
            ("a.nii", "info", nifti.clone()),
            ("a.nii.gz", "info", gzip(&nifti)?),
            ("a_65536x65536x16_float64.raw.gz", "info", good("raw, packed")?.bytes.clone()),
            ("a.npy", "compare", edit("NPY", "(10, 12, )", "(32768, 32768)")?),
            ("b.npy", "compare", edit("NPY", "(10, 12, )", "(4294967296, 4294967296)")?),
            ("c.npy", "compare", array),
            ("a.png", "compare", png),
            // Width and height, 12 and 10, wherever they stand; windows of EXR count from 0.
            ("a.tiff", "compare", window("TIFF", &10u32.to_le_bytes(), 1 << 26)?),
            ("b.tiff", "compare", tiff),
            ("a.exr", "compare", window("EXR", &9u32.to_le_bytes(), 1 << 26)?),
            ("b.exr", "compare", window("EXR", &11u32.to_le_bytes(), 1 << 30)?),
            ("c.exr", "compare", tiled_exr()),
            ("deep.npy", "compare", edit("NPY", "(10, 12, )", &"(".repeat(9000))?),
        ],
    )
}
