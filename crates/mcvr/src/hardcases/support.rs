//! What cases share.

use std::path::{Path, PathBuf};

use mcvr_sampling::{PointBlock, PointStream, block_len};
use tempfile::TempDir;

use super::CaseError;
use crate::Method;

/// The methods that draw samples.
pub(super) const SAMPLERS: [Method; 6] =
    [Method::Mc, Method::McQuicksort, Method::McBinary, Method::McLinear, Method::Stratified, Method::Qmc];

/// A number of samples, fewer for the method that searches from the first voxel.
pub(super) fn budget(method: Method, samples: u64) -> u64 {
    if method == Method::McLinear { samples.min(Method::LINEAR_LIMIT) } else { samples }
}

/// One block of a stream.
pub(super) fn block_of(stream: &dyn PointStream, block: u64, total: u64) -> PointBlock {
    let mut points = PointBlock::default();
    points.resize(block_len(stream.samples(), block));
    stream.fill(block, total, &mut points);
    points
}

/// What cases run with: the program for those that need a process of its own, and a folder that goes when this goes.
#[derive(Debug)]
pub struct Context {
    program: Option<PathBuf>,
    folder: TempDir,
}

impl Context {
    /// A context with a fresh temporary folder. Without a program, the cases that start one are skipped.
    ///
    /// # Errors
    /// Where no temporary folder can be made.
    pub fn new(program: Option<PathBuf>) -> std::io::Result<Self> {
        Ok(Self { program, folder: tempfile::Builder::new().prefix("mcvr-hardcases-").tempdir()? })
    }

    /// A fresh empty folder for one case.
    pub(super) fn folder(&self) -> Result<TempDir, CaseError> {
        Ok(tempfile::tempdir_in(self.folder.path())?)
    }

    /// The `mcvr` program.
    pub(super) fn program(&self) -> Result<&Path, CaseError> {
        self.program.as_deref().ok_or_else(|| CaseError::Impossible("no program to start".to_owned()))
    }
}
