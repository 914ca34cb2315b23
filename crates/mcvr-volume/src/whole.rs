//! Files that are whole or absent: the one way in which results reach a disk.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

/// Bytes that are gathered before they are written.
const BUFFER: usize = 1 << 18;

/// Symbolic links that are followed before they are taken for a circle, as Linux does.
const LINKS: usize = 40;

/// Writes a file by `fill` into a temporary one in the same folder, waits until that is on disk, then renames it over the
/// target: whatever goes wrong, power included, the target is whole or as it was, and nothing else is left behind. (Only a
/// process that is killed in the middle leaves its hidden `.mcvr-*.tmp`.)
///
/// A symbolic link stays one: the file it names is replaced. A file that may not be written is refused, though its folder
/// would let it be replaced, and keeps its permissions otherwise. What is no file, such as a device or a pipe, cannot be
/// replaced and gets the bytes written into it.
///
/// # Errors
/// What `fill` or the operating system said.
pub fn write_whole<E>(path: &Path, fill: impl FnOnce(&mut BufWriter<&File>) -> Result<(), E>) -> io::Result<()>
where
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    let target = resolved(path)?;
    let there = check_target(&target)?;
    if there.as_ref().is_some_and(|t| !t.is_file()) {
        let mut whole = tempfile::tempfile()?;
        filled(&whole, fill)?;
        whole.rewind()?;
        return io::copy(&mut whole, &mut OpenOptions::new().write(true).open(path)?).map(drop);
    }
    let temporary = beside(&target)?;
    filled(temporary.as_file(), fill)?;
    if let Some(there) = there {
        temporary.as_file().set_permissions(there.permissions())?;
    }
    // Without this a power cut just after the renaming could leave an empty file where a whole one was.
    temporary.as_file().sync_all()?;
    temporary.persist(&target).map(drop).map_err(|e| e.error)
}

/// Refuses what [`write_whole`] will not be able to write, as far as that can be known before the work.
///
/// # Errors
/// A missing folder or one that may not be written, a folder in the file's place, a file that may not be written.
pub fn check_writable(path: &Path) -> io::Result<()> {
    let target = resolved(path)?;
    match check_target(&target)? {
        Some(there) if !there.is_file() => Ok(()),
        _ => beside(&target).map(drop),
    }
}

/// A temporary file in a target's folder, to become the target. It goes when it is dropped.
fn beside(target: &Path) -> io::Result<tempfile::NamedTempFile> {
    let folder = target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        let problem = format!("no such folder for the output: '{}'", folder.display());
        return Err(io::Error::new(io::ErrorKind::NotFound, problem));
    }
    let mut builder = tempfile::Builder::new();
    // Temporary files are private by default; this one becomes an ordinary file, less what the umask takes.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.prefix(".mcvr-").suffix(".tmp").tempfile_in(folder).map_err(|e| {
        // The name of the temporary file says nothing to people.
        let reason = e.raw_os_error().map_or(e.to_string(), |code| io::Error::from_raw_os_error(code).to_string());
        io::Error::new(e.kind(), format!("cannot write into '{}': {reason}", folder.display()))
    })
}

/// What there is at a target, if it may be written.
fn check_target(target: &Path) -> io::Result<Option<std::fs::Metadata>> {
    let there = match std::fs::metadata(target) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        other => other?,
    };
    if there.is_dir() {
        return Err(io::Error::new(io::ErrorKind::IsADirectory, "this is a folder; name a file"));
    }
    if there.is_file() {
        // Renaming asks the folder only; whoever protected a file means its content.
        OpenOptions::new()
            .write(true)
            .open(target)
            .map_err(|e| io::Error::new(e.kind(), format!("this file may not be written: {e}")))?;
    }
    Ok(Some(there))
}

/// The name behind symbolic links, there or not. A link to what is no file (`/dev/stdout`) is left to the system.
fn resolved(path: &Path) -> io::Result<PathBuf> {
    if std::fs::metadata(path).is_ok_and(|m| !m.is_file()) {
        return Ok(path.to_owned());
    }
    let mut target = path.to_owned();
    for _ in 0..LINKS {
        match std::fs::read_link(&target) {
            Ok(to) => target = target.parent().unwrap_or(Path::new("")).join(to),
            Err(_) => return Ok(target),
        }
    }
    Err(io::Error::other(format!("more than {LINKS} symbolic links, one after the other")))
}

fn filled<E>(file: &File, fill: impl FnOnce(&mut BufWriter<&File>) -> Result<(), E>) -> io::Result<()>
where
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    let mut out = BufWriter::with_capacity(BUFFER, file);
    fill(&mut out).map_err(|e| match e.into().downcast::<io::Error>() {
        Ok(own) => *own,
        Err(other) => io::Error::other(other),
    })?;
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn put(path: &Path, text: &str) -> io::Result<()> {
        write_whole(path, |out| out.write_all(text.as_bytes()))
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_failure_leaves_the_earlier_file_and_nothing_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        put(&path, "first").unwrap();
        let failed = write_whole(&path, |out| {
            out.write_all(&[0; 2 * BUFFER])?;
            Err::<(), _>(io::Error::other("no more"))
        });
        assert_eq!(failed.unwrap_err().to_string(), "no more");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "first");
        assert_eq!(names(folder.path()), ["a"]);
        put(&path, "second").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "second");
    }

    #[test]
    fn a_folder_in_the_files_place_and_a_missing_folder_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        for path in [folder.path().to_owned(), folder.path().join("missing/a")] {
            assert!(check_writable(&path).is_err() && put(&path, "x").is_err(), "{}", path.display());
        }
        assert_eq!(names(folder.path()), Vec::<String>::new());
        assert!(check_writable(&folder.path().join("a")).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_a_link_and_permissions_stay() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let [file, link, circle] = ["file", "link", "circle"].map(|n| folder.path().join(n));
        symlink("file", &link).unwrap();
        put(&link, "through a dangling link").unwrap();
        std::fs::set_permissions(&file, PermissionsExt::from_mode(0o600)).unwrap();
        put(&link, "again").unwrap();
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "again");
        assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        symlink("circle", &circle).unwrap();
        assert!(put(&circle, "x").is_err());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_device_is_written_into_and_never_replaced() {
        use std::os::unix::fs::FileTypeExt;
        for (path, works) in [("/dev/null", true), ("/dev/full", false)] {
            assert_eq!(put(Path::new(path), "x").is_ok(), works, "{path}");
            assert!(std::fs::metadata(path).unwrap().file_type().is_char_device(), "{path}");
        }
    }
}
