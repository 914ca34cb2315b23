//! What can go wrong while measuring.

use std::path::{Path, PathBuf};

/// Errors of this crate; messages name the file or the value and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HarnessError {
    /// A result file could not be read or written.
    #[error("{path}: {problem}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        problem: String,
    },
    /// The folder holds measurements of something else.
    #[error(
        "{path}: this folder holds a run of something else ({differences}); choose another output folder",
        path = path.display()
    )]
    OtherRun {
        /// The header file.
        path: PathBuf,
        /// Which settings differ, with both values.
        differences: String,
    },
    /// A method failed to make an image.
    #[error("method '{method}' at {samples} samples, seed {seed}: {problem}")]
    Method {
        /// The method's name.
        method: String,
        /// The budget it was asked for.
        samples: u64,
        /// The seed it was given.
        seed: u64,
        /// Its own message.
        problem: String,
    },
    /// Two images cannot be compared, or the truth has no usable scale.
    #[error("comparison: {0}")]
    Comparison(String),
    /// The options contradict themselves.
    #[error("options: {0}")]
    Options(String),
    /// A plot could not be drawn.
    #[error("plot '{name}': {problem}")]
    Plot {
        /// Name of the plot.
        name: String,
        /// What went wrong.
        problem: String,
    },
    /// An image file could not be written or read.
    #[error(transparent)]
    Scene(#[from] mcvr_scene::SceneError),
}

impl HarnessError {
    /// A [`HarnessError::File`].
    pub(crate) fn file(path: &Path, problem: impl ToString) -> Self {
        Self::File { path: path.to_owned(), problem: problem.to_string() }
    }
}
