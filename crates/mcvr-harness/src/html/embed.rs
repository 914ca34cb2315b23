//! Files that a page carries inside itself, as `data:` addresses.

use std::io::Write;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;

use super::escape;
use crate::HarnessError;

/// Data of more bytes than this are compressed; below, a plain file is handier.
pub(super) const PLAIN_MOST: usize = 32 << 10;

/// A figure with its picture inside; `attributes` are added to the figure's tag. `None` when the file is not there.
///
/// # Errors
/// [`HarnessError::File`] when it is there but cannot be read.
pub(super) fn picture(path: &Path, what: &str, attributes: &str) -> Result<Option<String>, HarnessError> {
    Ok(read(path)?.map(|bytes| {
        let (what, data) = (escape(what), STANDARD.encode(&bytes));
        let size = png_size(&bytes).map_or(String::new(), |[w, h]| format!(" width=\"{w}\" height=\"{h}\""));
        format!(
            "<figure{attributes}><img alt=\"{what}\"{size} src=\"data:image/png;base64,{data}\">\
             <figcaption>{what}</figcaption></figure>\n"
        )
    }))
}

/// Width and height that a PNG states in its first chunk, so that the page keeps room for the picture.
fn png_size(bytes: &[u8]) -> Option<[u32; 2]> {
    let head = bytes.strip_prefix(b"\x89PNG\r\n\x1a\n")?;
    let side = |at: usize| Some(u32::from_be_bytes(head.get(at..at + 4)?.try_into().ok()?));
    (head.get(4..8)? == b"IHDR").then_some([side(8)?, side(12)?])
}

/// A list item that saves the file, whose bytes are in the link itself. `None` when the file is not there.
///
/// # Errors
/// [`HarnessError::File`] when it is there but cannot be read.
pub(super) fn download(folder: &Path, name: &str, what: &str) -> Result<Option<String>, HarnessError> {
    let path = folder.join(name);
    let Some(bytes) = read(&path)? else { return Ok(None) };
    let (saved, kind, data) = if bytes.len() > PLAIN_MOST {
        let mut packed = GzEncoder::new(Vec::new(), Compression::best());
        let data = packed.write_all(&bytes).and_then(|()| packed.finish()).map_err(|e| HarnessError::file(&path, e))?;
        (format!("{name}.gz"), "application/gzip", data)
    } else {
        (name.to_owned(), kind(name), bytes)
    };
    let size = data.len().div_ceil(1000);
    let (saved, what, data) = (escape(&saved), escape(what), STANDARD.encode(data));
    Ok(Some(format!(
        "<li><a download=\"{saved}\" href=\"data:{kind};base64,{data}\">{saved}</a> ({size} kB): {what}</li>\n"
    )))
}

fn kind(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, end)| end) {
        Some("csv") => "text/csv;charset=utf-8",
        Some("json") => "application/json",
        Some("md" | "txt") => "text/plain;charset=utf-8",
        _ => "application/octet-stream",
    }
}

/// The file's bytes, or `None` when it is not there.
///
/// # Errors
/// [`HarnessError::File`] when it is there but cannot be read.
pub(super) fn read(path: &Path) -> Result<Option<Vec<u8>>, HarnessError> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(HarnessError::file(path, e)),
    }
}
