//! What can go wrong with a volume.

use std::path::PathBuf;

/// Errors of this crate. Every message names the file, the field and the value where there is one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VolumeError {
    /// The grid's geometry is unusable.
    #[error("unusable grid: {0}")]
    Grid(String),

    /// The file could not be opened, read, mapped or written.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },

    /// A header field is missing, malformed, or has a value that is not supported.
    #[error("{path}: {format} header, field '{field}': {problem}", path = path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// The format's name: `NRRD`, `MetaImage`, `NIfTI`.
        format: &'static str,
        /// The header field.
        field: String,
        /// What is wrong, with the offending value and the limit.
        problem: String,
    },

    /// The file holds fewer or more bytes of voxels than its header or arguments ask for.
    #[error("{path}: {problem}", path = path.display())]
    Size {
        /// The file.
        path: PathBuf,
        /// What was expected and found, and what would fit.
        problem: String,
    },

    /// The content is not of any known format and no raw geometry was given.
    #[error("{path}: {problem}", path = path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What was looked for and what to do.
        problem: String,
    },

    /// A phantom's name or size is not understood.
    #[error("phantom '{spec}': {problem}")]
    Phantom {
        /// The specification as given.
        spec: String,
        /// What is wrong and what is accepted.
        problem: String,
    },
}
