//! Camera matrices in text files.

use std::path::{Path, PathBuf};

use mcvr_volume::read_text;

/// Most bytes of a matrix file: twelve numbers and many comments.
const LIMIT: u64 = 1 << 16;

/// A file that holds no 3x4 matrix.
#[derive(Debug, thiserror::Error)]
#[error("{path}{at}: {problem}", path = path.display(), at = line.map_or(String::new(), |l| format!(", line {l}")))]
pub struct MatrixFileError {
    path: PathBuf,
    line: Option<usize>,
    problem: String,
}

/// Reads a 3x4 matrix by rows: twelve finite numbers separated by white space, commas or semicolons; `#` starts a
/// comment.
///
/// # Errors
/// [`MatrixFileError`] when the file cannot be read, or holds another count of numbers or what is not a finite number.
pub fn read_matrix(path: &Path) -> Result<[[f64; 4]; 3], MatrixFileError> {
    let fail = |line, problem: String| MatrixFileError { path: path.to_owned(), line, problem };
    let text = read_text(path, LIMIT).map_err(|e| fail(None, e.to_string()))?;
    let mut numbers = vec![];
    for (i, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or("");
        for word in line.split([' ', '\t', ',', ';']).filter(|w| !w.is_empty()) {
            let value = word.parse().ok().filter(|v: &f64| v.is_finite());
            numbers.push(value.ok_or_else(|| {
                let word: String = word.chars().take(60).collect();
                fail(Some(i + 1), format!("'{word}' is not a finite number"))
            })?);
        }
    }
    let Ok(flat) = <[f64; 12]>::try_from(numbers.as_slice()) else {
        return Err(fail(None, format!("{} numbers, but a 3x4 matrix has 12", numbers.len())));
    };
    Ok(std::array::from_fn(|r| std::array::from_fn(|c| flat[r * 4 + c])))
}
