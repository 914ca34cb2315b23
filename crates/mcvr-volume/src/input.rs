//! Opening files that others wrote: regular files only, and no more text than a program can have meant.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Opens a regular file, following symbolic links.
///
/// # Errors
/// What the operating system says, and [`ErrorKind::InvalidInput`] for a directory, a pipe or a device: opening a
/// pipe waits for its writer, and a device may never end.
pub fn open_regular(path: &Path) -> Result<File> {
    // Looked at before opening, and again behind it, because the name may have changed hands in between.
    regular(&std::fs::metadata(path)?)?;
    let file = File::open(path)?;
    regular(&file.metadata()?)?;
    Ok(file)
}

fn regular(meta: &std::fs::Metadata) -> Result<()> {
    let refuse = |what| Err(Error::new(ErrorKind::InvalidInput, what));
    if meta.is_dir() {
        return refuse("is a directory; give one file");
    }
    if !meta.is_file() {
        return refuse("is not a regular file (a pipe or a device?); save the data to a file first");
    }
    Ok(())
}

/// The text of a regular file of at most `limit` bytes.
///
/// # Errors
/// As [`open_regular`]; [`ErrorKind::FileTooLarge`] beyond the limit, [`ErrorKind::InvalidData`] for what is not UTF-8.
pub fn read_text(path: &Path, limit: u64) -> Result<String> {
    let mut text = String::new();
    // One byte more than the limit tells a longer file, also one that grows meanwhile.
    let read = open_regular(path)?.take(limit + 1).read_to_string(&mut text)?;
    if read as u64 > limit {
        let problem = format!("is longer than {limit} bytes, the most that is read as text");
        return Err(Error::new(ErrorKind::FileTooLarge, problem));
    }
    Ok(text)
}
