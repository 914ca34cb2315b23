//! Why a measurement or a comparison could not be made.

use std::path::{Path, PathBuf};

use mcvr_raycast::RaycastError;
use mcvr_sampling::SamplingError;
use mcvr_scene::SceneError;
use mcvr_volume::VolumeError;

use crate::MakeError;

/// Errors of the regression benchmarks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BenchError {
    /// A file could not be read or written, or holds something else.
    #[error("{path}: {problem}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// There is no such stage.
    #[error("no stage is called '{0}'; `mcvr bench --list` names all")]
    Stage(String),
    /// Valgrind did not do its work.
    #[error("callgrind, stage {stage}: {problem}")]
    Callgrind {
        /// The stage that was run.
        stage: String,
        /// What went wrong.
        problem: String,
    },
    /// A scene of the benchmarks could not be made.
    #[error("benchmark scene: {0}")]
    Setup(String),
    /// An image could not be made.
    #[error(transparent)]
    Make(#[from] MakeError),
    /// Stopped by the caller.
    #[error("stopped")]
    Cancelled,
}

impl BenchError {
    /// A [`BenchError::File`].
    pub(crate) fn file(path: &Path, problem: impl ToString) -> Self {
        Self::File { path: path.to_owned(), problem: problem.to_string() }
    }

    /// True when the caller stopped the work.
    pub fn is_cancelled(&self) -> bool {
        matches!(self, Self::Cancelled) || matches!(self, Self::Make(e) if e.is_cancelled())
    }
}

impl From<SceneError> for BenchError {
    fn from(e: SceneError) -> Self {
        Self::Make(e.into())
    }
}

impl From<SamplingError> for BenchError {
    fn from(e: SamplingError) -> Self {
        Self::Make(e.into())
    }
}

impl From<RaycastError> for BenchError {
    fn from(e: RaycastError) -> Self {
        Self::Make(e.into())
    }
}

impl From<VolumeError> for BenchError {
    fn from(e: VolumeError) -> Self {
        Self::Setup(e.to_string())
    }
}
