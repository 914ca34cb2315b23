//! The scene file: everything that the command line can say, as TOML.
//!
//! ```toml
//! #:schema scene.schema.json
//! [volume]
//! input = "phantom:lobster@128"
//! [camera]
//! view = [30.0, 50.0]
//! [image]
//! size = [400, 400]
//! kernel = "tent"
//! estimand = "line"
//! [effects]
//! shading = { sides = "two" }
//! [sampling]
//! method = "qmc"
//! samples = 4194304
//! ```
//!
//! Every key is optional; a flag on the command line wins over the file. Several `[[camera]]` give several images. Unknown
//! keys, unknown values and keys that contradict each other are errors that name the line; [`SceneFile::schema`] describes
//! it all to editors.

mod check;
mod problem;
mod schema;
mod sections;
#[cfg(test)]
mod tests;

use std::path::Path;

use mcvr_scene::film::{Film, Tone};
use mcvr_scene::{DensityMap, Effects};
use mcvr_volume::read_text;
use schemars::JsonSchema;
use serde::Deserialize;

pub use problem::SceneFileError;
pub use sections::{CameraSection, ErrorSection, ImageSection, PixelSection, SamplingSection, VolumeSection};

/// Most bytes of a scene file: thousands of cameras.
const LIMIT: u64 = 1 << 20;

/// A scene: which scan is looked at, from where, how, and what the images are made of.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SceneFile {
    /// Which scan.
    pub volume: VolumeSection,
    /// Isovalue to weight.
    pub density: Option<DensityMap>,
    /// From where: one camera, or several that give an image each.
    #[serde(rename = "camera", deserialize_with = "sections::cameras")]
    #[schemars(schema_with = "schema::cameras")]
    pub cameras: Vec<CameraSection>,
    /// Which image.
    pub image: ImageSection,
    /// What there is on top of the plain X-ray.
    pub effects: Option<Effects>,
    /// What becomes of the line integrals.
    pub film: Option<Film>,
    /// By which method and budget.
    pub sampling: SamplingSection,
    /// Which error is enough.
    pub error: ErrorSection,
    /// How it is shown.
    pub tone: Option<Tone>,
}

impl SceneFile {
    /// Reads a scene; a relative volume path is taken from the scene's folder.
    ///
    /// # Errors
    /// [`SceneFileError`] with the line when the file is missing, not a scene, or contradicts itself.
    pub fn read(path: &Path) -> Result<Self, SceneFileError> {
        let text = read_text(path, LIMIT).map_err(|e| SceneFileError::unreadable(path, &e))?;
        let mut scene = Self::parse(&text, path)?;
        if let Some(input) = &mut scene.volume.input
            && !input.starts_with("phantom:")
            && Path::new(input).is_relative()
            && let Some(folder) = path.parent()
        {
            *input = folder.join(&*input).to_string_lossy().into_owned();
        }
        Ok(scene)
    }

    /// A scene from its text; `path` is what errors call it.
    ///
    /// # Errors
    /// As [`SceneFile::read`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, SceneFileError> {
        if let Some(error) = SceneFileError::of_twins(path, text) {
            return Err(error);
        }
        let scene: SceneFile = toml::from_str(text).map_err(|e| SceneFileError::of_toml(path, text, &e))?;
        match check::check(&scene) {
            Ok(()) => Ok(scene),
            Err(finding) => Err(SceneFileError::of_finding(path, text, &finding)),
        }
    }

    /// The JSON Schema of scene files, for editors.
    pub fn schema() -> serde_json::Value {
        schema::schema()
    }
}
