//! Good files of every format that is read, small ones, to be damaged by cases and to start a fuzzer with.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;
use std::path::Path;

use mcvr_harness::record::{RecordLog, read_log};
use mcvr_harness::{PhaseSeconds, Record};
use mcvr_sampling::{Cloud, Provenance};
use mcvr_scene::film::{self, ErrorBars, Image, ImageFormat, Tone};
use mcvr_scene::{Extent, Kernel};
use mcvr_volume::{Grid, Volume};

use super::super::CaseError;
use super::good_volumes::volumes;
use crate::{SceneFile, read_cloud, read_matrix, write_cloud};

/// Who reads a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Reader {
    Volume,
    Image,
    Cloud,
    Scene,
    Matrix,
    Records,
}

/// A whole file.
#[derive(Clone, Debug)]
pub struct GoodFile {
    /// The format.
    pub format: &'static str,
    /// Who reads it.
    pub reader: Reader,
    /// The name it needs.
    pub name: &'static str,
    /// Its content.
    pub bytes: Vec<u8>,
    /// Name and content of a second file, which it names.
    pub beside: Option<(&'static str, Vec<u8>)>,
    /// Bytes in front of the data, or all where both are mixed.
    pub(super) header: usize,
    /// Whether its header is text that a person may edit.
    pub(super) text: bool,
    /// Whether a checksum protects its data.
    pub(super) sealed: bool,
}

/// What was read: its size, a hash of all of it, and whether it is usable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Print {
    pub(super) size: [usize; 4],
    pub(super) hash: u64,
    pub(super) sound: bool,
}

fn print(size: [usize; 4], sound: bool, content: impl IntoIterator<Item = u64>) -> Print {
    let mut hash = DefaultHasher::new();
    content.into_iter().for_each(|v| v.hash(&mut hash));
    Print { size, hash: hash.finish(), sound }
}

fn text_hash(text: &str) -> u64 {
    print([0; 4], true, text.bytes().map(u64::from)).hash
}

impl Reader {
    /// Reads a file as the program does; the error as the program prints it.
    pub(super) fn read(self, path: &Path) -> Result<Print, String> {
        let text = |e: &dyn std::error::Error| e.to_string();
        match self {
            Reader::Volume => {
                let v = mcvr_volume::open(path, None).map_err(|e| text(&e))?.volume;
                Ok(print_volume(&v))
            }
            Reader::Image => {
                let image = film::read(path).map_err(|e| text(&e))?;
                let Extent { width, height } = image.extent();
                let sound = image.values().len() == width * height;
                Ok(print([width, height, 0, 0], sound, image.values().iter().map(|v| v.to_bits())))
            }
            Reader::Cloud => {
                let cloud = read_cloud(path).map_err(|e| text(&e))?;
                let sound = cloud.mass().is_finite() && cloud.samples() > 0;
                let positions = cloud.positions();
                let values = positions.iter().flatten().map(|v| u64::from(v.to_bits()));
                let grid = text_hash(&format!("{:?} {} {:?}", cloud.grid(), cloud.mass(), cloud.provenance()));
                Ok(print([cloud.samples() as usize, 0, 0, 0], sound, values.chain([grid])))
            }
            Reader::Scene => {
                let scene = SceneFile::read(path).map_err(|e| text(&e))?;
                Ok(print([0; 4], true, [text_hash(&format!("{scene:?}").replace(&*path.to_string_lossy(), ""))]))
            }
            Reader::Matrix => {
                let matrix = read_matrix(path).map_err(|e| text(&e))?;
                let sound = matrix.iter().flatten().all(|v| v.is_finite());
                Ok(print([3, 4, 0, 0], sound, matrix.iter().flatten().map(|v| v.to_bits())))
            }
            Reader::Records => {
                let records = read_log(path).map_err(|e| text(&e))?;
                Ok(print([records.len(), 0, 0, 0], true, [text_hash(&format!("{records:?}"))]))
            }
        }
    }
}

pub(super) fn print_volume(v: &Volume) -> Print {
    let grid = v.grid();
    let [x, y, z] = grid.dims();
    let sound = v.voxels().len() == grid.len()
        && grid.voxel_volume().is_normal()
        && grid.diameter().is_normal()
        && grid.centre().is_finite()
        && v.slope().is_finite()
        && v.intercept().is_finite();
    let geometry = text_hash(&format!("{grid:?} {} {}", v.slope(), v.intercept()));
    let values = (0..v.voxels().len()).map(|n| v.voxels().get_f64(n).to_bits());
    print([x, y, z, v.voxel_type().bytes()], sound, values.chain([geometry]))
}

impl GoodFile {
    /// The file with other bytes in place of some; a length in front of a header follows its header.
    pub(super) fn with(&self, range: Range<usize>, value: &[u8]) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        let grown = (self.header + value.len()).saturating_sub(range.len());
        bytes.splice(range, value.iter().copied());
        match self.reader {
            Reader::Cloud => bytes[12..16].copy_from_slice(&((grown - 16) as u32).to_le_bytes()),
            Reader::Image if self.text => bytes[8..10].copy_from_slice(&((grown - 10) as u16).to_le_bytes()),
            _ => {}
        }
        bytes
    }
}

/// One file at least for every reader, each in a form that its own writer or its standard gives.
///
/// # Errors
/// Where a file cannot be written.
pub fn good_files(folder: &Path) -> Result<Vec<GoodFile>, CaseError> {
    let mut files = volumes(folder)?;
    files.extend(images(folder)?);
    let path = folder.join("made");
    write_cloud(&cloud()?, &path)?;
    let bytes = std::fs::read(&path)?;
    let header = 16 + u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
    let plain = |format, reader, name, bytes: Vec<u8>, header| {
        let text = !matches!(format, "PNG" | "EXR" | "TIFF" | "NIfTI-1" | "NIfTI-2" | "raw");
        GoodFile { format, reader, name, bytes, beside: None, header, text, sealed: false }
    };
    files.push(plain("point cloud", Reader::Cloud, "a.mcvr", bytes, header));
    write_cloud(&cloud()?.compacted()?, &path)?;
    let bytes = std::fs::read(&path)?;
    let header = 16 + u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
    files.push(plain("compact point cloud", Reader::Cloud, "b.mcvr", bytes, header));
    let scene = SCENE.as_bytes().to_vec();
    files.push(plain("scene", Reader::Scene, "a.toml", scene, SCENE.len()));
    files.push(plain("matrix", Reader::Matrix, "a.txt", MATRIX.as_bytes().to_vec(), MATRIX.len()));
    std::fs::remove_file(&path)?;
    let (mut log, _) = RecordLog::open(&path)?;
    (0..3).try_for_each(|n| log.append(&record(n)))?;
    let bytes = std::fs::read(&path)?;
    let header = bytes.len();
    files.push(plain("record log", Reader::Records, "records.jsonl", bytes, header));
    std::fs::remove_file(&path)?;
    Ok(files)
}

/// A scene with every kind of value.
const SCENE: &str = "[volume]\ninput = \"phantom:lobster@32\"\n[[camera]]\nname = \"a\"\nview = [30.0, 50.0]\nfov = 20.0\n\
    [image]\nsize = [40, 30]\nkernel = \"tent\"\n[effects]\nshading = { sides = \"two\" }\n\
    [sampling]\nmethod = \"qmc\"\nsamples = 4096\ncull = true\n";

const MATRIX: &str = "1, 0, 0, 5 # rows\n0 1;0 2.5e2\n0\t0 -1e-3 1\n";

fn images(folder: &Path) -> Result<Vec<GoodFile>, CaseError> {
    let extent = Extent::new(12, 10)?;
    let image = Image::from_values(extent, (0..120).map(|n| f64::from(n * n)).collect())?;
    let path = folder.join("made");
    let formats = [
        ("NPY", "a.npy", ImageFormat::Npy),
        ("EXR", "a.exr", ImageFormat::Exr),
        ("TIFF", "a.tiff", ImageFormat::Tiff),
        ("PNG", "a.png", ImageFormat::Png16),
    ];
    let write = |(format, name, kind)| {
        film::write(&image, &path, kind, &Tone::default())?;
        let bytes = std::fs::read(&path)?;
        // Only an array has all of its header in front of its data.
        let header = if kind == ImageFormat::Npy { bytes.len() - 8 * extent.pixels() } else { bytes.len() };
        let (text, sealed) = (kind == ImageFormat::Npy, kind == ImageFormat::Png16);
        Ok(GoodFile { format, reader: Reader::Image, name, bytes, beside: None, header, text, sealed })
    };
    let mut files: Vec<GoodFile> = formats.into_iter().map(write).collect::<Result<_, CaseError>>()?;
    let bars = ErrorBars { error: &image, low: &image, high: &image, unresolved: &image };
    let channels = std::slice::from_ref(&image);
    film::write_with_error(channels, &[bars], 0.95, &path, ImageFormat::Exr, &Tone::default())?;
    let bytes = std::fs::read(&path)?;
    let (format, name, header) = ("EXR with error bars", "b.exr", bytes.len());
    let (text, sealed) = (false, false);
    files.push(GoodFile { format, reader: Reader::Image, name, bytes, beside: None, header, text, sealed });
    Ok(files)
}

fn cloud() -> Result<Cloud, CaseError> {
    let grid = Grid::with_spacing([8, 6, 5], [0.5, 1.0, 2.0])?;
    let axis = |size: u8| (0..100u8).map(|n| f32::from(n % size) * 0.25).collect();
    let provenance = Provenance { source: "good".into(), method: "mc".into(), ..Provenance::default() };
    Ok(Cloud::new(grid, Kernel::Tent, 1.5, [axis(7), axis(6), axis(5)], provenance)?)
}

fn record(replicate: u32) -> Record {
    Record {
        dataset: "phantom, \"quoted\"".into(),
        view: "azimuth 30".into(),
        size: "12x10".into(),
        kernel: "tent".into(),
        estimand: "line".into(),
        method: "mc".into(),
        budget_unit: "samples".into(),
        samples: 1 << 40,
        replicate,
        seed: 7,
        rmse: Some(0.1 * 3.0),
        rel_rmse: Some(1.0 / 3.0),
        rel_rmse_peak: None,
        mae: Some(1e-300),
        max: Some(1e300),
        psnr: None,
        bias: Some(-0.0),
        bias_se: None,
        seconds: PhaseSeconds { distribution: 0.1, sampling: 0.2, projection: 0.3, complete: 0.6 },
        threads: 2,
        counters: serde_json::json!({ "outside": [1, 2] }),
        reference_error: 1e-6,
        version: "0.0.0".into(),
        commit: None,
        machine: "none".into(),
    }
}
