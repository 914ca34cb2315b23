//! What can go wrong with a scene.

use std::path::PathBuf;

/// Errors of this crate; messages name the key, the value and what is accepted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// A camera parameter is out of range or the matrix is degenerate.
    #[error("camera: {0}")]
    Camera(String),
    /// The density map cannot be applied to this volume.
    #[error("density map: {0}")]
    Density(String),
    /// An effect's parameter is out of range, or two contradict each other.
    #[error("effects: {0}")]
    Effects(String),
    /// A film's parameter is out of range, or a pixel cannot be exposed.
    #[error("film: {0}")]
    Film(String),
    /// An image has an unusable size, or two images do not match.
    #[error("image: {0}")]
    Image(String),
    /// An image file could not be read or written.
    #[error("{path}: {problem}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        problem: String,
    },
}
