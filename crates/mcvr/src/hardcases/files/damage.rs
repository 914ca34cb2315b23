//! One engine: a good file, its damaged variants, what a reader made of each, and what it may have made.

use std::ops::AddAssign;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::super::{CaseError, Context, Finding};
use super::good::{GoodFile, Print, Reader, good_files};

/// What a reader may make of a damaged file. A panic is never among it, nor an error that does not name the file or is
/// longer than a page, nor what cannot be used (another number of voxels than the grid has, a size that is no number).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum May {
    /// An error.
    Refuse,
    /// An error, or all that the good file holds.
    RefuseOrKeep,
    /// An error, or other content of the same size.
    KeepSize,
    /// An error, or anything usable.
    ReadSoundly,
    /// All that the good file holds.
    Keep,
}

/// Longest error, bytes, which is shown on a terminal: half a page, and the longest path that a system opens.
const LONGEST_ERROR: usize = 2048 + 4096;

/// Counts over many variants.
#[derive(Clone, Debug, Default)]
pub(super) struct Tally {
    pub(super) of: u64,
    pub(super) refused: u64,
    pub(super) kept: u64,
    pub(super) other: u64,
    pub(super) wrong: u64,
    first: Option<String>,
}

impl AddAssign for Tally {
    fn add_assign(&mut self, more: Self) {
        self.of += more.of;
        self.refused += more.refused;
        self.kept += more.kept;
        self.other += more.other;
        self.wrong += more.wrong;
        self.first = self.first.take().or(more.first);
    }
}

impl Tally {
    /// Counts one reading.
    pub(super) fn judge(&mut self, what: &str, path: &Path, reader: Reader, may: May, good: Option<&Print>) {
        let outcome = catch_unwind(AssertUnwindSafe(|| reader.read(path)));
        let keeps = |p: &Print| good.is_some_and(|g| g == p);
        let wrong = match &outcome {
            Err(_) => Some("a panic".to_owned()),
            Ok(Err(e)) if may == May::Keep => Some(e.clone()),
            Ok(Err(e)) if e.len() > LONGEST_ERROR => Some(format!("an error of {} bytes", e.len())),
            Ok(Err(e)) if !names(e, path) => Some(format!("an error without the file's name: {e}")),
            Ok(Err(_)) => None,
            Ok(Ok(p)) if !p.sound => Some("was read, and is unusable".to_owned()),
            Ok(Ok(p)) => match may {
                May::Refuse => Some("was read".to_owned()),
                May::RefuseOrKeep | May::Keep => (!keeps(p)).then(|| "was read as something else".to_owned()),
                May::KeepSize => {
                    good.is_none_or(|g| g.size != p.size).then(|| format!("was read with size {:?}", p.size))
                }
                May::ReadSoundly => None,
            },
        };
        self.of += 1;
        match &outcome {
            Err(_) => {}
            Ok(Err(_)) => self.refused += 1,
            Ok(Ok(p)) if keeps(p) => self.kept += 1,
            Ok(Ok(_)) => self.other += 1,
        }
        if let Some(wrong) = wrong {
            self.wrong += 1;
            let clipped: String = wrong.chars().take(200).collect();
            self.first.get_or_insert(format!("{what}: {clipped}"));
        }
    }

    /// Counts a check of another kind.
    pub(super) fn check(&mut self, what: &str, right: bool) {
        self.of += 1;
        if !right {
            self.wrong += 1;
            self.first.get_or_insert(what.to_owned());
        }
    }

    /// The finding: no variant may be wrong.
    pub(super) fn finding(self, what: &str, detail: &str) -> Finding {
        let Self { of, refused, kept, other, wrong, first } = self;
        let mut text = detail.to_owned();
        if refused + kept + other > 0 {
            let remark = if detail.is_empty() { String::new() } else { format!("; {detail}") };
            text = format!("{refused} refused, {kept} read unchanged, {other} read as others that are usable{remark}");
        }
        if let Some(first) = first {
            text = format!("first wrong: {first}; {text}");
        }
        Finding::wrong(wrong, of, what).with(text)
    }
}

/// Whether an error names a file: the one that was read, or one beside it that this one names.
fn names(error: &str, path: &Path) -> bool {
    let folder = path.parent().map(|p| p.to_string_lossy().into_owned()).unwrap_or_default();
    error.contains(&*path.to_string_lossy()) || (!folder.is_empty() && error.contains(&folder))
}

/// A damaged file: in words, and its bytes.
pub(super) type Variant = (String, Vec<u8>);

/// Writes a file's companion into a folder and returns the path for itself.
pub(super) fn place(good: &GoodFile, folder: &Path) -> Result<PathBuf, CaseError> {
    if let Some((name, bytes)) = &good.beside {
        std::fs::write(folder.join(name), bytes)?;
    }
    Ok(folder.join(good.name))
}

/// What the good file holds; an error where the reader refuses it.
pub(super) fn print_of(good: &GoodFile, path: &Path) -> Result<Print, CaseError> {
    std::fs::write(path, &good.bytes)?;
    Ok(good.reader.read(path).map_err(|e| format!("the good {} is refused: {e}", good.format))?)
}

/// A folder in memory where there is such a place: tens of thousands of files are written.
fn fast_folder(context: &Context) -> Result<TempDir, CaseError> {
    let memory = tempfile::Builder::new().prefix("mcvr-hardcases-").tempdir_in("/dev/shm");
    memory.or_else(|_| context.folder())
}

/// Every variant of one file, judged on all processors, each with a folder of its own.
pub(super) fn judge(context: &Context, good: &GoodFile, may: May, variants: &[Variant]) -> Result<Tally, CaseError> {
    let folder = fast_folder(context)?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(variants.len()).max(1);
    let mut paths = vec![];
    for n in 0..threads {
        let own = folder.path().join(n.to_string());
        std::fs::create_dir(&own)?;
        paths.push(place(good, &own)?);
    }
    let Some(path) = paths.first() else { return Err("no processor".into()) };
    let print = print_of(good, path)?;
    let work = |(n, path): (usize, &PathBuf)| {
        let mut tally = Tally::default();
        for (what, bytes) in variants.iter().skip(n).step_by(threads) {
            // A new file each time: a journal may wait for the disk when one is cut and written anew.
            let _ = std::fs::remove_file(path);
            std::fs::write(path, bytes)?;
            tally.judge(&format!("{}, {what}", good.format), path, good.reader, may, Some(&print));
        }
        Ok::<Tally, std::io::Error>(tally)
    };
    let mut total = Tally::default();
    std::thread::scope(|scope| {
        let started: Vec<_> = paths.iter().enumerate().map(|p| scope.spawn(move || work(p))).collect();
        for thread in started {
            total += thread.join().map_err(|_| "a checking thread ended")??;
        }
        Ok(total)
    })
}

/// Every variant that `vary` makes of every good file.
pub(super) fn judge_all(
    context: &Context,
    may: impl Fn(&GoodFile) -> May,
    vary: impl Fn(&GoodFile) -> Vec<Variant>,
) -> Result<Tally, CaseError> {
    let folder = context.folder()?;
    let mut total = Tally::default();
    for good in good_files(folder.path())? {
        let variants = vary(&good);
        if !variants.is_empty() {
            total += judge(context, &good, may(&good), &variants)?;
        }
    }
    Ok(total)
}
