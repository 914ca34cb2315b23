//! The scene file: everything that the command line can say, as TOML.
//!
//! ```toml
//! [volume]
//! input = "phantom:lobster@128"
//! [camera]
//! view = [30.0, 50.0]
//! [image]
//! size = [400, 400]
//! kernel = "tent"
//! estimand = "line"
//! [sampling]
//! method = "qmc"
//! samples = 4194304
//! ```
//!
//! Every key is optional; a flag on the command line wins over the file. Unknown keys are errors that name the
//! line and the keys that exist.

use std::path::{Path, PathBuf};

use mcvr_qmc::Scramble;
use mcvr_sampling::VoxelOrder;
use mcvr_scene::film::Tone;
use mcvr_scene::{DensityMap, Estimand, Kernel};
use mcvr_volume::{Endian, VoxelType};
use serde::Deserialize;

use crate::Method;

/// A scene as read from a file.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SceneFile {
    /// Which scan.
    pub volume: VolumeSection,
    /// Isovalue to weight.
    pub density: Option<DensityMap>,
    /// From where.
    pub camera: CameraSection,
    /// Which image.
    pub image: ImageSection,
    /// By which method and budget.
    pub sampling: SamplingSection,
    /// How it is shown.
    pub tone: Option<Tone>,
}

/// `[volume]`
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VolumeSection {
    /// File (relative to the scene file) or `phantom:NAME@SIZE`.
    pub input: Option<String>,
    /// Raw files: voxels along x, y, z.
    pub dims: Option<[usize; 3]>,
    /// Raw files: voxel type.
    #[serde(rename = "type")]
    pub voxel_type: Option<VoxelType>,
    /// Raw files: byte order.
    pub endian: Option<Endian>,
    /// Raw files: bytes before the first voxel.
    pub skip: Option<u64>,
    /// Millimetres per voxel; replaces the file's own.
    pub spacing: Option<[f64; 3]>,
}

/// `[camera]`
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraSection {
    /// Azimuth and elevation in degrees.
    pub view: Option<[f64; 2]>,
    /// Millimetres from the eye to the volume's centre.
    pub distance: Option<f64>,
    /// Full angle in degrees across the shorter side.
    pub fov: Option<f64>,
    /// Parallel rays.
    pub parallel: Option<bool>,
    /// Near plane in mm.
    pub near: Option<f64>,
    /// World millimetres to homogeneous pixels, by rows; instead of view, distance, fov and parallel.
    pub matrix: Option<[[f64; 4]; 3]>,
}

/// `[image]`
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImageSection {
    /// Columns and rows.
    pub size: Option<[usize; 2]>,
    /// Reconstruction kernel.
    pub kernel: Option<Kernel>,
    /// What a pixel means.
    pub estimand: Option<Estimand>,
}

/// `[sampling]`
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SamplingSection {
    /// Method by name.
    pub method: Option<Method>,
    /// Samples (rays for a march).
    pub samples: Option<u64>,
    /// Key of all randomness.
    pub seed: Option<u64>,
    /// Order of the voxels.
    pub order: Option<VoxelOrder>,
    /// Randomisation of the net.
    pub scramble: Option<Scramble>,
    /// Step of a march in voxels.
    pub step: Option<f64>,
    /// Tolerance of exact ray casting.
    pub tolerance: Option<f64>,
}

/// Why a scene file could not be read.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {problem}", path = path.display())]
pub struct SceneFileError {
    path: PathBuf,
    problem: String,
}

impl SceneFile {
    /// Reads a scene; a relative volume path is taken from the scene's folder.
    ///
    /// # Errors
    /// [`SceneFileError`] with the line when the file is missing or not a scene.
    pub fn read(path: &Path) -> Result<Self, SceneFileError> {
        let fail = |problem: String| SceneFileError { path: path.to_owned(), problem };
        let text = std::fs::read_to_string(path).map_err(|e| fail(e.to_string()))?;
        let mut scene: SceneFile = toml::from_str(&text).map_err(|e| fail(e.to_string()))?;
        if let Some(input) = &mut scene.volume.input
            && !input.starts_with("phantom:")
            && Path::new(input).is_relative()
            && let Some(folder) = path.parent()
        {
            *input = folder.join(&*input).to_string_lossy().into_owned();
        }
        Ok(scene)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_section_is_read() {
        let text = r#"
            [volume]
            input = "phantom:box@8"
            spacing = [1.0, 1.0, 2.0]
            [density]
            transfer = { linear = { slope = 2.0, intercept = 1.0 } }
            emphasis = { threshold = 40.0, gain = 4.0 }
            [camera]
            view = [10.0, 20.0]
            [image]
            size = [64, 48]
            kernel = "box"
            estimand = "count"
            [sampling]
            method = "mc-quicksort"
            order = "hilbert"
            scramble = "owen"
            [tone]
            curve = "log"
        "#;
        let scene: SceneFile = toml::from_str(text).unwrap();
        assert_eq!(scene.sampling.method, Some(Method::McQuicksort));
        assert_eq!(scene.density.unwrap().emphasis.unwrap().gain, 4.0);
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line() {
        let problem = toml::from_str::<SceneFile>("[image]\nsizes = [1, 2]\n").unwrap_err().to_string();
        assert!(problem.contains("line 2") && problem.contains("sizes") && problem.contains("size"), "{problem}");
    }
}
