//! Point clouds in files: a native form that loses nothing, and PLY for other programs.
//!
//! The native form, all numbers little-endian: the 8 bytes `MCVRCLD\n`, a `u32` version, a `u32` length, so many
//! bytes of JSON (the grid, the kernel, the mass `F`, the number of points, where they come from), then the points.
//! Version 1: x of all points as `f32`, then y, then z, in voxels from the grid's centre voxel `(n - 1) / 2`.
//! Version 2, of compact clouds: the JSON also has `bricks`, their number, and `side`, theirs in voxels; then for each brick four
//! `u32`, its place along x, y and z and its number of points; then brick by brick x of all its points as `u16`, then y, then z:
//! w stands for `side (place + (w + 1/2) / 65536) - 4` voxels from the grid's first voxel.

use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use mcvr_sampling::{Cloud, Compact, CompactBrick, Provenance};
use mcvr_scene::{Kernel, SceneError, film};
use mcvr_volume::{Grid, open_regular};
use serde::{Deserialize, Serialize};

const MAGIC: &[u8; 8] = b"MCVRCLD\n";
/// Versions of the format: 32-bit positions, and compact ones.
const SINGLE: u32 = 1;
const COMPACT: u32 = 2;
/// Bytes before the JSON.
const PREFIX: u64 = 16;
/// Longest JSON that is read.
const HEADER_LIMIT: u32 = 1 << 20;
/// Bytes of a brick of a compact cloud, besides its points.
const BRICK_BYTES: u64 = 16;
/// Numbers converted at a time.
const CHUNK: usize = 1 << 14;

/// A point cloud file could not be read or written.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {problem}", path = path.display())]
pub struct CloudFileError {
    /// The file.
    pub path: PathBuf,
    /// What went wrong.
    pub problem: String,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    samples: u64,
    mass: f64,
    kernel: Kernel,
    dims: [usize; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    /// Columns: the world directions of the grid axes.
    direction: [[f64; 3]; 3],
    provenance: Provenance,
    /// Number of bricks of a compact cloud.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    bricks: Option<u64>,
    /// Their side in voxels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    side: Option<u32>,
}

fn fail(path: &Path) -> impl Fn(&dyn std::fmt::Display) -> CloudFileError + '_ {
    |problem| CloudFileError { path: path.to_owned(), problem: problem.to_string() }
}

/// True when a file starts as a native point cloud does; false also when it cannot be read.
pub fn is_cloud(path: &Path) -> bool {
    let mut magic = [0; 8];
    open_regular(path).and_then(|mut f| f.read_exact(&mut magic)).is_ok() && magic == *MAGIC
}

/// Writes the native form, beside the target and then renamed.
///
/// # Errors
/// [`CloudFileError`] when the folder is missing or not writable, or the disk is full.
pub fn write_cloud(cloud: &Cloud, path: &Path) -> Result<(), CloudFileError> {
    let grid = cloud.grid();
    let header = Header {
        samples: cloud.samples(),
        mass: cloud.mass(),
        kernel: cloud.kernel(),
        dims: grid.dims(),
        spacing: grid.spacing().to_array(),
        origin: grid.origin().to_array(),
        direction: grid.direction().to_cols_array_2d(),
        provenance: cloud.provenance().clone(),
        bricks: cloud.compact().map(|c| c.bricks().len() as u64),
        side: cloud.compact().map(Compact::side),
    };
    let version = if cloud.compact().is_some() { COMPACT } else { SINGLE };
    replace(path, |out| {
        let text = serde_json::to_vec(&header)?;
        out.write_all(MAGIC)?;
        out.write_all(&version.to_le_bytes())?;
        out.write_all(&(text.len() as u32).to_le_bytes())?;
        out.write_all(&text)?;
        let mut bytes = vec![];
        if let Some(points) = cloud.compact() {
            for brick in points.bricks() {
                let [x, y, z] = brick.at;
                for number in [x, y, z, brick.points] {
                    out.write_all(&number.to_le_bytes())?;
                }
            }
            for chunk in points.words().chunks(CHUNK) {
                bytes.clear();
                bytes.extend(chunk.iter().flat_map(|w| w.to_le_bytes()));
                out.write_all(&bytes)?;
            }
            return Ok(());
        }
        for chunk in cloud.positions().iter().flat_map(|axis| axis.chunks(CHUNK)) {
            bytes.clear();
            bytes.extend(chunk.iter().flat_map(|v| v.to_le_bytes()));
            out.write_all(&bytes)?;
        }
        Ok(())
    })
}

/// Reads the native form. The file's length is checked against its header before memory is taken.
///
/// # Errors
/// [`CloudFileError`] when the file is missing, no point cloud, of a later version, too short, too long, or says
/// what cannot be (see [`Cloud::new`], [`Cloud::of_compact`]).
pub fn read_cloud(path: &Path) -> Result<Cloud, CloudFileError> {
    let fail = fail(path);
    let mut file = open_regular(path).map_err(|e| fail(&e))?;
    let length = file.metadata().map_err(|e| fail(&e))?.len();
    let mut prefix = [0; PREFIX as usize];
    file.read_exact(&mut prefix).map_err(|_| fail(&format!("{length} bytes are too few for a point cloud")))?;
    if prefix[..8] != *MAGIC {
        return Err(fail(&"no point cloud of `mcvr sample` (its first bytes are wrong; PLY is written, not read)"));
    }
    let word = |at: usize| u32::from_le_bytes([prefix[at], prefix[at + 1], prefix[at + 2], prefix[at + 3]]);
    let (version, header_length) = (word(8), word(12));
    if ![SINGLE, COMPACT].contains(&version) {
        return Err(fail(&format!("version {version} of the format; this program reads {SINGLE} and {COMPACT}")));
    }
    if header_length > HEADER_LIMIT || PREFIX + u64::from(header_length) > length {
        return Err(fail(&format!("a header of {header_length} bytes in a file of {length}; at most {HEADER_LIMIT}")));
    }
    let mut text = vec![0; header_length as usize];
    file.read_exact(&mut text).map_err(|e| fail(&e))?;
    let header: Header = serde_json::from_slice(&text).map_err(|e| fail(&format!("header: {e}")))?;
    let payload = length - PREFIX - u64::from(header_length);
    // What a version has not is refused, so that no number is passed over.
    let (bricks, per_point) = match (version, header.bricks, header.side) {
        (SINGLE, None, None) => (0, Cloud::BYTES_PER_POINT),
        (COMPACT, Some(bricks), Some(_)) => (bricks, Compact::BYTES_PER_POINT),
        (SINGLE, ..) => return Err(fail(&"header: bricks or side in version 1 of the format, which has none")),
        _ => return Err(fail(&"header: bricks and side are missing, which version 2 of the format has")),
    };
    let points_bytes = header.samples.checked_mul(per_point);
    let bytes = points_bytes.and_then(|b| b.checked_add(bricks.checked_mul(BRICK_BYTES)?));
    if bytes != Some(payload) {
        return Err(fail(&format!(
            "{payload} bytes of positions, but {} points take {per_point} each and {bricks} bricks {BRICK_BYTES}",
            header.samples
        )));
    }
    let grid = Grid::new(
        header.dims,
        DVec3::from_array(header.spacing),
        DVec3::from_array(header.origin),
        DMat3::from_cols_array_2d(&header.direction),
    )
    .map_err(|e| fail(&e))?;
    if let (COMPACT, Some(side)) = (version, header.side) {
        let number = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        let brick =
            |b: &[u8]| CompactBrick { at: [number(b), number(&b[4..]), number(&b[8..])], points: number(&b[12..]) };
        let bricks = numbers::<16, _>(&mut file, bricks, brick).map_err(|e| fail(&e))?;
        let word = |b: &[u8]| u16::from_le_bytes([b[0], b[1]]);
        let words = numbers::<2, _>(&mut file, 3 * header.samples, word).map_err(|e| fail(&e))?;
        let points = Compact::new(side, bricks, words).map_err(|e| fail(&e))?;
        return Cloud::of_compact(grid, header.kernel, header.mass, points, header.provenance).map_err(|e| fail(&e));
    }
    let mut axis = || {
        let single = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        numbers::<4, _>(&mut file, header.samples, single).map_err(|e| fail(&e))
    };
    let positions = [axis()?, axis()?, axis()?];
    Cloud::new(grid, header.kernel, header.mass, positions, header.provenance).map_err(|e| fail(&e))
}

/// Reads `count` items of `SIZE` bytes each.
fn numbers<const SIZE: usize, T>(file: &mut File, count: u64, item: impl Fn(&[u8]) -> T) -> std::io::Result<Vec<T>> {
    let mut values = Vec::new();
    values.try_reserve_exact(count as usize)?;
    let mut bytes = vec![0; SIZE * CHUNK];
    let mut left = count as usize;
    while left > 0 {
        let n = left.min(CHUNK);
        file.read_exact(&mut bytes[..SIZE * n])?;
        values.extend(bytes[..SIZE * n].chunks_exact(SIZE).map(&item));
        left -= n;
    }
    Ok(values)
}

/// Writes binary little-endian PLY, beside the target and then renamed: x, y and z in world millimetres, as `float`
/// where that rounds by less than 1/1000 of the smallest spacing, else as `double`. Comments carry what the native
/// form does, in words.
///
/// # Errors
/// As [`write_cloud`].
pub fn write_ply(cloud: &Cloud, path: &Path) -> Result<(), CloudFileError> {
    let grid = cloud.grid();
    let farthest = grid.corners(2.0).iter().fold(0.0, |f: f64, c| f.max(c.abs().max_element()));
    let double = farthest * f64::from(f32::EPSILON) > 1e-3 * grid.spacing().min_element();
    let kind = if double { "double" } else { "float" };
    let p = cloud.provenance();
    // A line break in a name must not end the comment.
    let line = |text: &str| text.replace(char::is_control, " ");
    let header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment mcvr point cloud, world coordinates in mm\n\
         comment mass F (weight x mm^3) {:e}\ncomment kernel {}\ncomment method {}\ncomment seed {}\n\
         comment voxel order {}\ncomment scramble {}\ncomment density map {}\ncomment source {}\n\
         element vertex {}\nproperty {kind} x\nproperty {kind} y\nproperty {kind} z\nend_header\n",
        cloud.mass(),
        cloud.kernel(),
        line(&p.method),
        p.seed,
        line(&p.order),
        line(p.scramble.as_deref().unwrap_or("none")),
        line(&p.map),
        line(&p.source),
        cloud.samples()
    );
    replace(path, |out| {
        out.write_all(header.as_bytes())?;
        let mut written = Ok(());
        cloud.for_each_world(|point| {
            for v in point.to_array() {
                if written.is_ok() {
                    written =
                        if double { out.write_all(&v.to_le_bytes()) } else { out.write_all(&(v as f32).to_le_bytes()) };
                }
            }
        });
        written
    })
}

/// [`film::write_whole`] with this module's error.
fn replace(path: &Path, fill: impl FnOnce(&mut BufWriter<&File>) -> std::io::Result<()>) -> Result<(), CloudFileError> {
    film::write_whole(path, fill).map_err(|e| match e {
        SceneError::File { path, problem } => CloudFileError { path, problem },
        other => fail(path)(&other),
    })
}
