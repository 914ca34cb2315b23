//! Names that lead elsewhere: links, folders, pipes, devices, long and foreign names, files without permission.

use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use super::super::program::{Place, finish};
use super::super::{Case, CaseError, Context, Finding};
use super::case;
use super::damage::{May, Tally, place, print_of};
use super::good::{GoodFile, Reader, good_files};

pub(super) const CASES: &[Case] = &[
    case(
        "file-links",
        "a link is refused, or a loop of links is followed for ever",
        "links to files are followed; loops and links to nothing are errors that name the file",
        links,
    ),
    case(
        "file-not-regular",
        "opening a pipe waits for a writer that never comes; reading a device never ends",
        "every reader refuses folders, pipes, devices and empty files at once",
        not_regular,
    ),
    case(
        "file-names",
        "a name that is no UTF-8, has a line break or looks like an option cannot be opened",
        "every reader opens its file under every name that the file system takes",
        names,
    ),
    case(
        "file-long-path",
        "a path that is too long is cut, or the error says only that the file is missing",
        "names beyond 255 bytes and paths beyond 4096 are errors that name the file",
        long_path,
    ),
    case(
        "file-no-permission",
        "the reader says that the file is damaged, or is empty",
        "a file that may not be read is an error that names it",
        no_permission,
    ),
    case(
        "file-detached",
        "a header names itself, a folder, a list or nothing as its data, and noise or zeros come out",
        "data files that are missing, the header itself, no files, many or of another length are refused; others are read",
        detached,
    ),
];

/// The good files, one per reader where one is enough.
fn one_each(folder: &Path) -> Result<Vec<GoodFile>, CaseError> {
    let mut files = good_files(folder)?;
    let mut seen = vec![];
    files.retain(|g| {
        let array = g.format == "NPY" || g.beside.is_some();
        let new = array || !seen.contains(&g.reader);
        seen.push(g.reader);
        new
    });
    Ok(files)
}

#[cfg(unix)]
fn link(to: &Path, at: &Path) -> Result<(), CaseError> {
    Ok(std::os::unix::fs::symlink(to, at)?)
}

#[cfg(not(unix))]
fn link(_: &Path, _: &Path) -> Result<(), CaseError> {
    Err(CaseError::Impossible("symbolic links need Unix here".into()))
}

/// Exact.
fn links(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let mut total = Tally::default();
    for good in one_each(folder.path())? {
        let own = context.folder()?;
        let at = |name: &str| own.path().join(name).join(good.name);
        for name in ["file", "link", "chain", "loop", "nothing"] {
            std::fs::create_dir(own.path().join(name))?;
        }
        let file = place(&good, &own.path().join("file"))?;
        let print = print_of(&good, &file)?;
        if let Some((beside, bytes)) = &good.beside {
            // Data are looked for where the header's name stands, link or not.
            ["link", "chain"].iter().try_for_each(|n| std::fs::write(own.path().join(n).join(beside), bytes))?;
        }
        link(&file, &at("link"))?;
        link(&at("link"), &at("chain"))?;
        link(&at("loop"), &at("loop"))?;
        link(&own.path().join("no such file"), &at("nothing"))?;
        for (name, may) in [("link", May::Keep), ("chain", May::Keep), ("loop", May::Refuse), ("nothing", May::Refuse)]
        {
            total.judge(&format!("{}, {name}", good.format), &at(name), good.reader, may, Some(&print));
        }
    }
    Ok(total.finding("links", ""))
}

/// Counts a reader that does not return. Its thread is left behind; it ends with the program.
fn judge_in_time(total: &mut Tally, what: &str, path: &Path, reader: Reader) {
    let (done, wait) = mpsc::channel();
    let (label, own) = (what.to_owned(), path.to_owned());
    std::thread::spawn(move || {
        let mut tally = Tally::default();
        tally.judge(&label, &own, reader, May::Refuse, None);
        let _ = done.send(tally);
    });
    match wait.recv_timeout(Duration::from_secs(10)) {
        Ok(tally) => *total += tally,
        Err(_) => total.check(&format!("{what}: not done after 10 s"), false),
    }
}

/// Exact; ten seconds stand for ever (a refusal takes microseconds). An empty scene is a scene, an empty log a log.
fn not_regular(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let mut total = Tally::default();
    let pipe = folder.path().join("pipe");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    let pipe = made.is_ok_and(|s| s.success()).then_some(pipe);
    for good in good_files(folder.path())? {
        let own = context.folder()?;
        let path = place(&good, own.path())?;
        let mut pose = |what: &str| judge_in_time(&mut total, &format!("{}, {what}", good.format), &path, good.reader);
        std::fs::create_dir(&path)?;
        pose("a folder");
        std::fs::remove_dir(&path)?;
        if !matches!(good.reader, Reader::Scene | Reader::Records) {
            std::fs::write(&path, b"")?;
            pose("empty");
            std::fs::remove_file(&path)?;
        }
        // Links, because a reader may go by the name.
        let devices = ["/dev/zero", "/dev/null", "/dev/tty", "/dev/full"].map(PathBuf::from);
        for special in devices.iter().filter(|d| d.exists()).chain(&pipe) {
            link(special, &path)?;
            pose(&special.display().to_string());
            std::fs::remove_file(&path)?;
        }
    }
    let detail = if pipe.is_some() { "" } else { "no pipe could be made" };
    Ok(total.finding("readings", detail))
}

/// Exact. Names that the file system refuses are not counted. The program itself takes volumes as text, because
/// `phantom:NAME` is one, so there a name must be UTF-8.
fn names(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let mut total = Tally::default();
    for good in good_files(folder.path())?.iter().filter(|g| !g.format.starts_with("raw")) {
        let own = context.folder()?;
        let print = print_of(good, &place(good, own.path())?)?;
        let ending = good.name.rsplit_once('.').map_or("", |n| n.1);
        let long = "n".repeat(255 - 1 - ending.len());
        let stems: [&[u8]; 9] = [
            b"with space",
            b"-rf",
            b"--help",
            b"line\nbreak",
            b"\xff\xfe",
            b"\xe2\x80\xae",
            b"%s%n",
            b".",
            long.as_bytes(),
        ];
        for stem in stems {
            let Some(name) = file_name(&[stem, b".", ending.as_bytes()].concat()) else { continue };
            let path = own.path().join(name);
            if std::fs::write(&path, &good.bytes).is_ok() {
                let what = format!("{} called {}", good.format, String::from_utf8_lossy(&stem[..stem.len().min(12)]));
                total.judge(&what, &path, good.reader, May::Keep, Some(&print));
                std::fs::remove_file(&path)?;
            }
        }
    }
    Ok(total.finding("names", ""))
}

#[cfg(unix)]
fn file_name(bytes: &[u8]) -> Option<PathBuf> {
    use std::os::unix::ffi::OsStrExt;
    Some(std::ffi::OsStr::from_bytes(bytes).into())
}

#[cfg(not(unix))]
fn file_name(bytes: &[u8]) -> Option<PathBuf> {
    std::str::from_utf8(bytes).ok().map(PathBuf::from)
}

/// Exact. The error repeats the path, so it may be as long as that and a page.
fn long_path(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let mut total = Tally::default();
    for good in one_each(folder.path())? {
        for length in [256, 2000, 5000, 100_000] {
            let parts = "n".repeat(length.min(256));
            let path = folder.path().join(vec![parts.as_str(); length.div_ceil(256)].join("/")).join(good.name);
            let error = good.reader.read(&path).err().unwrap_or_default();
            let named = error.contains(good.name) && error.len() < path.as_os_str().len() + 4096;
            total.check(&format!("{}, a path of {length} bytes", good.format), named);
        }
    }
    Ok(total.finding("paths", ""))
}

/// Exact. The superuser may read every file; there, the program poses the case for volumes as a user without rights.
fn no_permission(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let secret = folder.path().join("secret");
    std::fs::write(&secret, "x")?;
    forbid(&secret)?;
    if std::fs::File::open(&secret).is_ok() {
        return no_permission_as_nobody(context);
    }
    let mut total = Tally::default();
    for good in good_files(folder.path())? {
        let path = place(&good, folder.path())?;
        std::fs::write(&path, &good.bytes)?;
        forbid(&path)?;
        total.judge(good.format, &path, good.reader, May::Refuse, None);
        std::fs::remove_file(&path)?;
    }
    Ok(total.finding("files", ""))
}

/// The program that reads each format, run by the user 65534, who owns nothing.
fn no_permission_as_nobody(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let nobody = format!("exec {} \"$@\"", place.unprivileged()?);
    let (mut wrong, mut of, mut said) = (0, 0, String::new());
    for good in good_files(context.folder()?.path())? {
        let command = match good.reader {
            Reader::Volume => vec!["info"],
            Reader::Image => vec!["compare", good.name],
            Reader::Cloud => vec!["project", "-o", "out.png"],
            Reader::Scene => vec!["plan"],
            _ => continue,
        };
        let path = place.path(good.name);
        std::fs::write(&path, &good.bytes)?;
        forbid(&path)?;
        let ended = finish(place.shell(&nobody, command.into_iter().chain([good.name])))?;
        of += 1;
        if !ended.failed_with(1, &[good.name, "ermission denied"]) {
            wrong += 1;
            said = format!("{}: {}", good.format, ended.last_words());
        }
        std::fs::remove_file(&path)?;
    }
    Ok(Finding::wrong(wrong, of, "files").with(said))
}

#[cfg(unix)]
fn forbid(path: &Path) -> Result<(), CaseError> {
    Ok(std::fs::set_permissions(path, std::os::unix::fs::PermissionsExt::from_mode(0o000))?)
}

#[cfg(not(unix))]
fn forbid(_: &Path) -> Result<(), CaseError> {
    Err(CaseError::Impossible("permissions of Unix".into()))
}

/// Exact. Absolute names and `..` are read: a header may name any file that its user may read, as the formats have it.
fn detached(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let mut total = Tally::default();
    for good in good_files(folder.path())?.iter().filter(|g| g.beside.is_some()) {
        let outer = context.folder()?;
        let own = outer.path().join("inner");
        std::fs::create_dir(&own)?;
        let path = place(good, &own)?;
        let print = print_of(good, &path)?;
        let data = good.beside.as_ref().map(|b| b.1.clone()).unwrap_or_default();
        std::fs::write(outer.path().join("outer.raw"), &data)?;
        std::fs::write(own.join("short.raw"), &data[1..])?;
        std::fs::write(own.join("long.raw"), [&data[..], b"0"].concat())?;
        std::fs::write(own.join("empty.raw"), b"")?;
        std::fs::write(own.join("name with = and : in it.raw"), &data)?;
        let absolute = outer.path().join("outer.raw").to_string_lossy().into_owned();
        let itself = good.name;
        let keep: [&str; 5] =
            ["../outer.raw", &absolute, "./data.raw", "../inner/data.raw", "name with = and : in it.raw"];
        let refuse: [&str; 13] = [
            "no.raw",
            "short.raw",
            "long.raw",
            "empty.raw",
            ".",
            "..",
            "/",
            "/dev/zero",
            "/dev/stdin",
            "LIST",
            "LIST 2",
            "data%03d.raw 1 5 1",
            itself,
        ];
        let cases = keep.iter().map(|n| (n, May::Keep)).chain(refuse.iter().map(|n| (n, May::Refuse)));
        for (name, may) in cases {
            let text = String::from_utf8_lossy(&good.bytes).replace("data.raw", name);
            std::fs::write(&path, text)?;
            total.judge(&format!("{} with {name}", good.format), &path, good.reader, may, Some(&print));
        }
        // Data that end the header's own file, which it names: as long as they must be, and still the header's text.
        let text = String::from_utf8_lossy(&good.bytes).replace("data.raw", itself);
        let skip = if text.starts_with("NRRD") { "byte skip: -1\n" } else { "" };
        let place = text.find("data file").unwrap_or(0);
        let text = format!("{}{skip}{}", &text[..place], &text[place..]);
        std::fs::write(&path, text)?;
        total.judge(&format!("{} with itself, from its end", good.format), &path, good.reader, May::Refuse, None);
        std::fs::remove_file(&path)?;
    }
    Ok(total.finding("headers", ""))
}
