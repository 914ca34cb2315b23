//! What is fuzzed.

use std::path::{Path, PathBuf};

use mcvr::harness::record;
use mcvr::scene::film;
use mcvr::volume::{self, Endian, RawOptions, VoxelType};
use tempfile::TempDir;

use crate::{numbers, seeds};

/// Names, as `scripts/fuzz.sh` knows them.
const NAMES: [&str; 8] = ["volume", "image", "npy", "cloud", "scene", "matrix", "records", "numbers"];

/// A target and the folder in which its files are made.
pub struct Target {
    name: &'static str,
    folder: TempDir,
}

/// Under these names a volume file is opened; the last byte of the input picks one.
const VOLUMES: [&str; 4] = ["x", "x_8x6x5_int16.raw", "x_8x6x5_float32be.raw.gz", "x.nhdr"];

impl Target {
    /// The target that the environment names.
    pub fn from_environment() -> Self {
        let wanted = std::env::var("MCVR_FUZZ_TARGET").unwrap_or_default();
        let Some(name) = NAMES.into_iter().find(|n| *n == wanted) else {
            panic!("MCVR_FUZZ_TARGET: one of {}", NAMES.join(", "));
        };
        // Memory instead of a disk where there is such a place.
        let memory = Path::new("/dev/shm");
        let place = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
        let folder = tempfile::Builder::new().prefix("mcvr-fuzz-").tempdir_in(place).expect("a folder");
        std::fs::write(folder.path().join("data.raw"), [7; 480]).expect("space");
        Self { name, folder }
    }

    /// Good files, one each, from which the search starts.
    pub fn write_seeds(&self, to: &Path) {
        for (number, bytes) in seeds::of(self.name, self.folder.path()).into_iter().enumerate() {
            std::fs::write(to.join(format!("seed-{number}")), bytes).expect("space");
        }
    }

    /// Reads one input as the target does. Errors are fine.
    pub fn run(&self, data: &[u8]) {
        let file = |name: &str, bytes: &[u8]| -> PathBuf {
            let path = self.folder.path().join(name);
            std::fs::write(&path, bytes).expect("space");
            path
        };
        match self.name {
            "volume" => self.volume(data),
            "image" => {
                drop(film::read(&file("x.png", data)));
                drop(film::read_layers(&file("x.exr", data)));
            }
            "npy" => drop(film::read(&file("x.npy", data))),
            "cloud" => drop(mcvr::read_cloud(&file("x.mcvr", data))),
            "scene" => drop(mcvr::SceneFile::read(&file("x.toml", data))),
            "matrix" => drop(mcvr::read_matrix(&file("x.txt", data))),
            "records" => drop(record::read_log(&file("x.jsonl", data))),
            _ => {
                let text = String::from_utf8_lossy(data);
                let _ = (numbers::count(&text), numbers::counts(&text), numbers::dims(&text));
                let _ = (numbers::spacing(&text), numbers::percentiles(&text));
                let _ = text.parse::<mcvr::scene::Kernel>();
                // A size that is accepted is generated: only those that are refused are tried here.
                let _ = volume::Phantom::parse(&text);
            }
        }
    }

    /// The last byte says how the file is called and whether options describe it.
    fn volume(&self, data: &[u8]) {
        let Some((&how, bytes)) = data.split_last() else { return };
        let path = self.folder.path().join(VOLUMES[how as usize % VOLUMES.len()]);
        std::fs::write(&path, bytes).expect("space");
        let options = RawOptions {
            dims: Some([8, 6, 5]),
            voxel_type: Some(VoxelType::I16),
            endian: Some(if how & 8 == 0 { Endian::Little } else { Endian::Big }),
            spacing: None,
            skip: u64::from(how >> 4),
        };
        let loaded = volume::open(&path, (how & 4 != 0).then_some(&options));
        if let Ok(loaded) = &loaded {
            let v = &loaded.volume;
            assert_eq!(v.voxels().len(), v.grid().len());
            let _ = (volume::Summary::of(v), volume::byte_order_suspicion(v), v.isovalue(v.grid().len() - 1));
            assert!(v.grid().diameter() > 0.0);
        }
        drop(loaded);
        let _ = std::fs::remove_file(&path);
    }
}
