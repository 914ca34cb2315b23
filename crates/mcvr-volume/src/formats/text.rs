//! Text headers: lines of `key SEPARATOR value` in front of binary data, of limited length.

use super::source::Source;
use crate::VolumeError;

/// Most bytes of a text header.
pub(crate) const MAX_HEADER: usize = 1 << 20;

/// Most fields of a text header: each new one is compared with all before it.
const MAX_FIELDS: usize = 4096;

/// Longest path that any common system opens, bytes.
const MAX_PATH: usize = 4096;

/// The line that begins at `from` without its end (`\n` or `\r\n`), and where the next one begins. `None` at the
/// end of the bytes. A last line without an end counts as one.
pub(crate) fn line_at(bytes: &[u8], from: usize) -> Option<(&[u8], usize)> {
    let rest = bytes.get(from..).filter(|r| !r.is_empty())?;
    let (line, next) = match rest.iter().position(|&b| b == b'\n') {
        Some(end) => (&rest[..end], from + end + 1),
        None => (rest, bytes.len()),
    };
    Some((line.strip_suffix(b"\r").unwrap_or(line), next))
}

/// Named values of a header, with lookup and number parsing that report the field.
pub(crate) struct Fields<'a> {
    pub(crate) source: &'a Source,
    pub(crate) format: &'static str,
    entries: Vec<(String, String)>,
}

impl<'a> Fields<'a> {
    /// No fields yet.
    pub(crate) fn new(source: &'a Source, format: &'static str) -> Self {
        Self { source, format, entries: Vec::new() }
    }

    /// Adds a field.
    ///
    /// # Errors
    /// [`VolumeError::Header`] when it is there already, or when there are too many.
    pub(crate) fn insert(&mut self, key: String, value: String) -> Result<(), VolumeError> {
        if self.entries.iter().any(|e| e.0 == key) {
            return Err(self.error(&clip(&key), "is given twice"));
        }
        if self.entries.len() >= MAX_FIELDS {
            return Err(self.error(&clip(&key), format!("is one field too many: the limit is {MAX_FIELDS}")));
        }
        self.entries.push((key, value));
        Ok(())
    }

    /// Value of the first of `keys` that is there.
    pub(crate) fn get(&self, keys: &[&str]) -> Option<&str> {
        keys.iter().find_map(|key| self.entries.iter().find(|e| e.0 == *key)).map(|e| e.1.as_str())
    }

    /// As [`Self::get`], an error when there is none.
    pub(crate) fn require(&self, keys: &[&str]) -> Result<&str, VolumeError> {
        self.get(keys).ok_or_else(|| self.error(keys.first().unwrap_or(&""), "is missing"))
    }

    /// The error that says that `field` is wrong.
    pub(crate) fn error(&self, field: &str, problem: impl Into<String>) -> VolumeError {
        self.source.header_error(self.format, field, problem)
    }

    /// Opens the data file that a field names, seen from the header's folder.
    ///
    /// # Errors
    /// [`VolumeError::Header`] when it cannot be opened, or is the header itself.
    pub(crate) fn data_file(&self, field: &str, name: &str) -> Result<Source, VolumeError> {
        if name.len() > MAX_PATH {
            return Err(self.error(field, format!("'{}' is longer than {MAX_PATH} bytes", clip(name))));
        }
        let path = self.source.sibling(name);
        let data = Source::open(&path).map_err(|e| self.error(field, e.to_string()))?;
        if data.is_same_file(self.source) {
            return Err(self.error(field, format!("'{}' is the header itself", clip(name))));
        }
        Ok(data)
    }

    /// Whitespace-separated integers.
    pub(crate) fn integers(&self, field: &str, text: &str) -> Result<Vec<i64>, VolumeError> {
        let parse = |w: &str| w.parse().map_err(|_| self.error(field, format!("'{}' is not an integer", clip(w))));
        text.split_whitespace().map(parse).collect()
    }

    /// Whitespace-separated numbers, exactly `N`; `nan` is a number here.
    pub(crate) fn numbers<const N: usize>(&self, field: &str, text: &str) -> Result<[f64; N], VolumeError> {
        let parse = |w: &str| w.parse().map_err(|_| self.error(field, format!("'{}' is not a number", clip(w))));
        let numbers: Vec<f64> = text.split_whitespace().map(parse).collect::<Result<_, _>>()?;
        let count = numbers.len();
        numbers.try_into().map_err(|_| self.error(field, format!("{N} numbers are needed, got {count}")))
    }
}

/// The beginning of a value, for messages.
pub(crate) fn clip(text: &str) -> String {
    if text.chars().count() <= 60 { text.to_string() } else { text.chars().take(60).chain("...".chars()).collect() }
}
