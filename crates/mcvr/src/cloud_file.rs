//! Point clouds in files: a native form that loses nothing, and PLY for other programs.
//!
//! The native form, all numbers little-endian: the 8 bytes `MCVRCLD\n`, a `u32` version (1), a `u32` length, so many
//! bytes of JSON (the grid, the kernel, the mass `F`, the number of points, where they come from), then x of all
//! points as `f32`, then y, then z, in voxels from the grid's centre voxel `(n - 1) / 2`.

use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use mcvr_sampling::{Cloud, Provenance};
use mcvr_scene::{Kernel, SceneError, film};
use mcvr_volume::{Grid, open_regular};
use serde::{Deserialize, Serialize};

const MAGIC: &[u8; 8] = b"MCVRCLD\n";
const VERSION: u32 = 1;
/// Bytes before the JSON.
const PREFIX: u64 = 16;
/// Longest JSON that is read.
const HEADER_LIMIT: u32 = 1 << 20;
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
    };
    replace(path, |out| {
        let text = serde_json::to_vec(&header)?;
        out.write_all(MAGIC)?;
        out.write_all(&VERSION.to_le_bytes())?;
        out.write_all(&(text.len() as u32).to_le_bytes())?;
        out.write_all(&text)?;
        let mut bytes = vec![];
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
/// what cannot be (see [`Cloud::new`]).
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
    if version != VERSION {
        return Err(fail(&format!("version {version} of the format; this program reads {VERSION}")));
    }
    if header_length > HEADER_LIMIT || PREFIX + u64::from(header_length) > length {
        return Err(fail(&format!("a header of {header_length} bytes in a file of {length}; at most {HEADER_LIMIT}")));
    }
    let mut text = vec![0; header_length as usize];
    file.read_exact(&mut text).map_err(|e| fail(&e))?;
    let header: Header = serde_json::from_slice(&text).map_err(|e| fail(&format!("header: {e}")))?;
    let payload = length - PREFIX - u64::from(header_length);
    if header.samples.checked_mul(Cloud::BYTES_PER_POINT) != Some(payload) {
        return Err(fail(&format!(
            "{payload} bytes of positions, but {} points take {} each",
            header.samples,
            Cloud::BYTES_PER_POINT
        )));
    }
    let grid = Grid::new(
        header.dims,
        DVec3::from_array(header.spacing),
        DVec3::from_array(header.origin),
        DMat3::from_cols_array_2d(&header.direction),
    )
    .map_err(|e| fail(&e))?;
    let mut axis = || {
        let mut values = Vec::new();
        values.try_reserve_exact(header.samples as usize).map_err(|e| fail(&e))?;
        let mut bytes = vec![0; 4 * CHUNK];
        let mut left = header.samples as usize;
        while left > 0 {
            let n = left.min(CHUNK);
            file.read_exact(&mut bytes[..4 * n]).map_err(|e| fail(&e))?;
            values.extend(bytes[..4 * n].chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])));
            left -= n;
        }
        Ok(values)
    };
    let positions = [axis()?, axis()?, axis()?];
    Cloud::new(grid, header.kernel, header.mass, positions, header.provenance).map_err(|e| fail(&e))
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
        for index in 0..cloud.samples() as usize {
            for v in cloud.world(index).to_array() {
                if double {
                    out.write_all(&v.to_le_bytes())?;
                } else {
                    out.write_all(&(v as f32).to_le_bytes())?;
                }
            }
        }
        Ok(())
    })
}

/// [`film::write_whole`] with this module's error.
fn replace(path: &Path, fill: impl FnOnce(&mut BufWriter<&File>) -> std::io::Result<()>) -> Result<(), CloudFileError> {
    film::write_whole(path, fill).map_err(|e| match e {
        SceneError::File { path, problem } => CloudFileError { path, problem },
        other => fail(path)(&other),
    })
}
