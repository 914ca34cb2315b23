//! The folder of a run: its header file, which keeps measurements of different things apart.

use std::collections::BTreeMap;
use std::path::Path;

use mcvr_scene::{Extent, Image};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::record::write_file;
use crate::{HarnessError, RunMeta};

/// `run.json`: what the folder's records measure.
#[derive(Debug, Serialize, Deserialize)]
struct Header {
    /// Version of this layout.
    format: u32,
    /// Settings that must be the same for records to belong together.
    fingerprint: BTreeMap<String, String>,
    /// Everything about the run that first used the folder, for people.
    meta: serde_json::Value,
}

const FORMAT: u32 = 1;

/// Settings that decide what a record means. Command and source revision are not among them: a resumed run may ask
/// for more sample counts, and every record names its own revision.
pub(crate) fn fingerprint(meta: &RunMeta, seed: u64, extent: Extent, sha256: &str) -> BTreeMap<String, String> {
    [
        ("dataset", meta.dataset.clone()),
        ("density", meta.density.clone()),
        ("view", meta.view.clone()),
        ("size", extent.to_string()),
        ("kernel", meta.kernel.name().to_owned()),
        ("estimand", meta.estimand.name().to_owned()),
        ("seed", seed.to_string()),
        ("threads", meta.threads.to_string()),
        ("machine", meta.machine.clone()),
        ("truth", sha256.to_owned()),
    ]
    .into_iter()
    .map(|(k, v)| (k.to_owned(), v))
    .collect()
}

/// Claims a folder for a run: writes its header, or checks that the one there is of the same run.
///
/// # Errors
/// [`HarnessError::OtherRun`] naming every setting that differs; [`HarnessError::File`] when the header is unreadable.
pub(crate) fn claim(
    folder: &Path,
    meta: &impl Serialize,
    fingerprint: BTreeMap<String, String>,
) -> Result<(), HarnessError> {
    if check(folder, &fingerprint)? {
        return Ok(());
    }
    let path = folder.join("run.json");
    let meta = serde_json::to_value(meta).map_err(|e| HarnessError::file(&path, e))?;
    let header = Header { format: FORMAT, fingerprint, meta };
    let text = serde_json::to_vec_pretty(&header).map_err(|e| HarnessError::file(&path, e))?;
    write_file(&path, &text)
}

/// Whether a folder has a header, which must then agree with each of these settings.
///
/// # Errors
/// As [`claim`].
pub(crate) fn check(folder: &Path, fingerprint: &BTreeMap<String, String>) -> Result<bool, HarnessError> {
    let path = folder.join("run.json");
    let found: Header = match std::fs::read(&path) {
        Ok(bytes) => serde_json::from_slice(&bytes).map_err(|e| HarnessError::file(&path, e))?,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(false),
        Err(e) => return Err(HarnessError::file(&path, e)),
    };
    if found.format != FORMAT {
        return Err(HarnessError::file(&path, format!("layout {} is not {FORMAT}", found.format)));
    }
    let short = |v: Option<&String>| v.map_or("absent".to_owned(), |v| v.chars().take(60).collect());
    let differences: Vec<String> = fingerprint
        .iter()
        .filter(|(k, v)| found.fingerprint.get(*k) != Some(v))
        .map(|(k, v)| format!("{k}: '{}' there, '{}' now", short(found.fingerprint.get(k)), short(Some(v))))
        .collect();
    if differences.is_empty() {
        Ok(true)
    } else {
        Err(HarnessError::OtherRun { path, differences: differences.join("; ") })
    }
}

/// Removes what a killed run left half written. Only for a folder that is locked: nobody else is writing there.
///
/// # Errors
/// [`HarnessError::File`] when the folder cannot be read or a file not removed.
pub(crate) fn tidy(folder: &Path) -> Result<(), HarnessError> {
    for folder in [folder.to_owned(), folder.join("images")].into_iter().filter(|f| f.is_dir()) {
        for entry in std::fs::read_dir(&folder).map_err(|e| HarnessError::file(&folder, e))? {
            let path = entry.map_err(|e| HarnessError::file(&folder, e))?.path();
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            if name.starts_with(".mcvr-") && name.ends_with(".tmp") {
                std::fs::remove_file(&path).map_err(|e| HarnessError::file(&path, e))?;
            }
        }
    }
    Ok(())
}

/// SHA-256 of an image's size and values, in hexadecimal.
pub fn sha256(image: &Image) -> String {
    let mut hash = Sha256::new();
    hash.update(image.extent().to_string());
    for v in image.values() {
        hash.update(v.to_le_bytes());
    }
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}
