//! A file opened for reading: checked to be a plain, non-empty file, and mapped.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use memmap2::Mmap;

use crate::{VolumeError, open_regular};

/// A mapped file. Nothing is copied until voxels must be inflated, swapped or aligned.
pub(crate) struct Source {
    path: PathBuf,
    map: Arc<Mmap>,
}

impl Source {
    /// Opens and maps a file.
    ///
    /// # Errors
    /// [`VolumeError::Io`] when it cannot be opened or mapped, or is no regular file; [`VolumeError::Format`] when it is
    /// a directory or empty.
    pub(crate) fn open(path: &Path) -> Result<Self, VolumeError> {
        let io = |source| VolumeError::Io { path: path.to_path_buf(), source };
        let refuse = |problem: &str| VolumeError::Format { path: path.to_path_buf(), problem: problem.to_string() };
        if path.is_dir() {
            return Err(refuse(
                "is a directory; give one file (a DICOM series must first be converted to NIfTI or NRRD)",
            ));
        }
        let file = open_regular(path).map_err(io)?;
        if file.metadata().map_err(io)?.len() == 0 {
            return Err(refuse("the file is empty (0 bytes)"));
        }
        // SAFETY: the map is read-only and lives as long as the buffers that use it. The one hazard, that another
        // process shortens the file meanwhile, is the caller's to avoid; it ends the process, it corrupts nothing.
        let map = unsafe { Mmap::map(&file) }.map_err(io)?;
        Ok(Self { path: path.to_path_buf(), map: Arc::new(map) })
    }

    /// Path of a file that this one names, relative to this one's folder.
    pub(crate) fn sibling(&self, name: &str) -> PathBuf {
        self.path.parent().unwrap_or(Path::new("")).join(name)
    }

    /// True when both are one file, perhaps under two names.
    pub(crate) fn is_same_file(&self, other: &Self) -> bool {
        let real = |path: &Path| path.canonicalize().ok();
        real(&self.path).is_some_and(|p| real(&other.path) == Some(p))
    }

    /// The whole content.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// The map, to be shared by buffers that use it in place.
    pub(crate) fn map(&self) -> &Arc<Mmap> {
        &self.map
    }

    /// The last component of the path, for reports.
    pub(crate) fn name(&self) -> String {
        self.path.file_name().unwrap_or(self.path.as_os_str()).to_string_lossy().into_owned()
    }

    /// A [`VolumeError::Header`] about this file.
    pub(crate) fn header_error(
        &self,
        format: &'static str,
        field: impl Into<String>,
        problem: impl Into<String>,
    ) -> VolumeError {
        VolumeError::Header { path: self.path.clone(), format, field: field.into(), problem: problem.into() }
    }

    /// A [`VolumeError::Format`] about this file.
    pub(crate) fn format_error(&self, problem: impl Into<String>) -> VolumeError {
        VolumeError::Format { path: self.path.clone(), problem: problem.into() }
    }

    /// A [`VolumeError::Size`] about this file.
    pub(crate) fn size_error(&self, problem: impl Into<String>) -> VolumeError {
        VolumeError::Size { path: self.path.clone(), problem: problem.into() }
    }
}
