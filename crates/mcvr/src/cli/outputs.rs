//! What is found out about outputs before the work, and how they are named in records.

use std::collections::HashSet;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use mcvr::volume::check_writable;

/// Refuses outputs that cannot be written, that are inputs, or that are named twice. `-` is standard output.
pub fn check<'a>(outputs: impl IntoIterator<Item = &'a PathBuf>, inputs: &[Option<&Path>]) -> anyhow::Result<()> {
    let inputs: HashSet<PathBuf> = inputs.iter().flatten().filter_map(|p| p.canonicalize().ok()).collect();
    let mut seen = HashSet::new();
    for path in outputs.into_iter().filter(|p| *p != Path::new("-")) {
        check_writable(path).with_context(|| path.display().to_string())?;
        let place = place(path);
        if inputs.contains(&place) {
            bail!("{}: this is an input; name another file for the output", path.display());
        }
        // Devices may be written twice.
        if (!place.exists() || place.is_file()) && !seen.insert(place) {
            bail!("{}: named twice as an output; the second would replace the first", path.display());
        }
    }
    Ok(())
}

/// One name for a file, there or not.
fn place(path: &Path) -> PathBuf {
    let beside = || {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some(folder.canonicalize().ok()?.join(path.file_name()?))
    };
    path.canonicalize().ok().or_else(beside).unwrap_or_else(|| path.to_owned())
}

/// Standard output, whose errors say so.
pub fn stdout() -> impl Write {
    Stdout(std::io::stdout().lock())
}

struct Stdout(std::io::StdoutLock<'static>);

/// The kind stays: a broken pipe is no failure.
fn named(e: std::io::Error) -> std::io::Error {
    std::io::Error::new(e.kind(), format!("standard output: {e}"))
}

impl Write for Stdout {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.write(bytes).map_err(named)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        self.0.flush().map_err(named)
    }
}

/// Paths as records have them: JSON is Unicode, file names need not be.
pub fn names<'a>(paths: impl IntoIterator<Item = &'a PathBuf>) -> Vec<String> {
    paths.into_iter().map(|p| p.display().to_string()).collect()
}
