//! What cases share.

use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::CaseError;

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
