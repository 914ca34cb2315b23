//! Outputs in odd places: devices, links, folders, inputs, names that are no Unicode.

use std::ffi::{OsStr, OsString};
use std::path::Path;

use super::program::{Place, finish};
use super::{Case, CaseError, Context, Finding, SMALL_RUN, Tally, picture, quick};

pub(super) const CASES: &[Case] = &[
    quick(
        "device-as-output",
        "writing beside and renaming replaces /dev/full, and for root /dev/null, by an ordinary file",
        "the device gets the bytes or the error and stays a device; a link to it stays a link",
        device_as_output,
    ),
    quick(
        "output-is-input",
        "the scan is replaced by the image that was made of it, or one output by the next",
        "exit 1 before the work, the file named, every byte of the input still there",
        output_is_input,
    ),
    quick(
        "output-in-the-way",
        "a folder of the same name, a missing folder or a circle of links gives a panic or an error after the work",
        "exit 1 before the work, the path named",
        output_in_the_way,
    ),
    quick(
        "output-through-a-link",
        "renaming replaces the link, and the file behind it keeps the old result",
        "the link stays, the file behind it has the bits of an ordinary output",
        output_through_a_link,
    ),
    quick(
        "names-beyond-unicode",
        "a name that is no UTF-8 makes the program panic when it writes down what it did",
        "every kind of output is written under such a name; an input is read or refused in words",
        names_beyond_unicode,
    ),
];

/// Exact: the full device named as an output directly, through a link, and by an ending that asks for an image; the null device
/// must take what the full one refuses.
#[cfg(unix)]
fn device_as_output(context: &Context) -> Result<Finding, CaseError> {
    use std::os::unix::fs::{FileTypeExt, symlink};
    let device = |path: &Path| std::fs::metadata(path).is_ok_and(|m| m.file_type().is_char_device());
    if !device(Path::new("/dev/full")) {
        return Err(CaseError::Impossible("no /dev/full".into()));
    }
    let place = Place::new(context)?;
    let mut tally = Tally::default();
    let direct: [Vec<&str>; 3] = [
        vec!["info", "phantom:lobster@24", "--json"],
        vec!["plan", "phantom:lobster@24", "--quiet", "--json"],
        vec!["hardcases", "--list", "-o"],
    ];
    for arguments in direct {
        for (path, works) in [("/dev/null", true), ("/dev/full", false)] {
            let ended = place.run(arguments.iter().chain(&[path]))?;
            let right = if works { ended.status.success() } else { ended.failed_with(1, &[path, "No space left"]) };
            tally.check(right && device(Path::new(path)), || format!("{path}: {}", ended.last_words()));
        }
    }
    for name in ["a.png", "a.npy", "a.exr", "a.tiff"] {
        symlink("/dev/full", place.path(name))?;
        let ended = place.run(picture(&["-o", name]))?;
        tally.check(ended.failed_with(1, &[name, "No space left"]), || format!("{name}: {}", ended.last_words()));
        let link = std::fs::symlink_metadata(place.path(name))?.is_symlink();
        tally.check(link && device(Path::new("/dev/full")), || format!("{name} is a link no more"));
    }
    Ok(tally.finding("checks", "/dev/null took it, /dev/full refused it, both are devices still"))
}

#[cfg(not(unix))]
fn device_as_output(_: &Context) -> Result<Finding, CaseError> {
    Err(CaseError::Impossible("needs devices".into()))
}

/// Exact: seven ways to name an input as an output, or one output twice; the inputs' bytes before and after.
fn output_is_input(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    // Raw voxels may have any ending: this scan looks like an image.
    std::fs::write(place.path("scan.png"), (0..32u32 * 32 * 32).map(|i| (i % 251) as u8).collect::<Vec<_>>())?;
    std::fs::write(place.path("view.txt"), "1 0 0 10  0 1 0 10  0 0 0 1")?;
    std::fs::write(place.path("scene.toml"), "[volume]\ninput = \"phantom:lobster@24\"\n")?;
    place.must(picture(&["-o", "a.npy"]))?;
    place.must(["sample", "phantom:lobster@24", "--samples", "2^10", "-o", "cloud.mcvr"])?;
    let raw = ["render", "scan.png", "--dims", "32,32,32", "--type", "u8", "--samples", "2^40", "-o"];
    let ways: [(&str, Vec<&str>); 8] = [
        ("scan.png", raw.into_iter().chain(["scan.png"]).collect()),
        ("scan.png", raw.into_iter().chain(["./sub/../scan.png"]).collect()),
        ("scan.png", raw.into_iter().chain(["b.png", "--json", "scan.png"]).collect()),
        ("view.txt", picture(&["-o", "b.png", "--matrix", "view.txt", "--json", "view.txt"])),
        ("scene.toml", vec!["render", "scene.toml", "-o", "b.png", "--json", "scene.toml"]),
        ("a.npy", vec!["compare", "a.npy", "a.npy", "--json", "a.npy"]),
        ("cloud.mcvr", vec!["project", "cloud.mcvr", "-o", "b.png", "--json", "cloud.mcvr"]),
        ("b.png", picture(&["-o", "b.png", "--json", "b.png"])),
    ];
    std::fs::create_dir(place.path("sub"))?;
    let mut tally = Tally::default();
    for (name, arguments) in ways {
        let before = std::fs::read(place.path(name)).ok();
        let ended = place.run(arguments)?;
        tally.check(ended.failed_with(1, &[name]), || format!("{name}: {}", ended.last_words()));
        tally.check(std::fs::read(place.path(name)).ok() == before, || format!("{name} is not what it was"));
    }
    Ok(tally.finding("checks of 8 ways", "by its name, by another path, as a record, twice"))
}

/// Exact: five unusable places; the budget would take hours, so an error after the work would not come.
fn output_in_the_way(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    std::fs::create_dir(place.path("folder.png"))?;
    std::fs::write(place.path("file"), "")?;
    let mut ways = vec!["folder.png", "missing/a.png", "file/a.png"];
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("circle.png", place.path("circle.png"))?;
        std::os::unix::fs::symlink("missing/b.png", place.path("dangling.png"))?;
        ways.extend(["circle.png", "dangling.png"]);
    }
    let mut tally = Tally::default();
    for name in ways {
        let before = place.names()?;
        let long = ["render", "phantom:lobster@24", "--samples", "2^40", "-o", name];
        let ended = place.run(long)?;
        tally.check(ended.failed_with(1, &[name]), || format!("{name}: {}", ended.last_words()));
        tally.check(place.names()? == before, || format!("{name} left something behind"));
    }
    Ok(tally.finding("checks of 5 places", "2^40 samples were asked for, and refused at once"))
}

/// Exact: the bytes behind a link to a file, a link to nothing yet, and a link to a link.
#[cfg(unix)]
fn output_through_a_link(context: &Context) -> Result<Finding, CaseError> {
    use std::os::unix::fs::symlink;
    let place = Place::new(context)?;
    place.must(picture(&["-o", "ordinary.npy"]))?;
    let ordinary = std::fs::read(place.path("ordinary.npy"))?;
    std::fs::create_dir(place.path("elsewhere"))?;
    std::fs::write(place.path("elsewhere/old"), "earlier")?;
    symlink("elsewhere/old", place.path("a.npy"))?;
    symlink("elsewhere/new", place.path("b.npy"))?;
    symlink("elsewhere/older", place.path("c.npy"))?;
    symlink("../elsewhere/oldest", place.path("elsewhere/older"))?;
    let mut tally = Tally::default();
    for (name, behind) in [("a.npy", "old"), ("b.npy", "new"), ("c.npy", "oldest")] {
        let ended = place.run(picture(&["-o", name]))?;
        let written = std::fs::read(place.path("elsewhere").join(behind)).is_ok_and(|b| b == ordinary);
        tally.check(written, || format!("{name}: {}", ended.last_words()));
        tally.check(std::fs::symlink_metadata(place.path(name))?.is_symlink(), || format!("{name} is a link no more"));
    }
    Ok(tally.finding("checks of 3 links", "to a file, to none yet, to a link"))
}

#[cfg(not(unix))]
fn output_through_a_link(_: &Context) -> Result<Finding, CaseError> {
    Err(CaseError::Impossible("needs symbolic links".into()))
}

/// A name that is no UTF-8, where the system has such names.
fn odd(ending: &str) -> OsString {
    #[cfg(unix)]
    let name: &OsStr = std::os::unix::ffi::OsStrExt::from_bytes(b"odd-\xff\xfe");
    #[cfg(not(unix))]
    let name = OsStr::new("odd");
    let mut name = name.to_owned();
    name.push(ending);
    name
}

/// Exact: seven kinds of output and the folder of a measurement; then a scan of such a name, which is refused in words.
fn names_beyond_unicode(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    if std::fs::write(place.path(odd("")), "").is_err() {
        return Err(CaseError::Impossible("this file system has no such names".into()));
    }
    let mut tally = Tally::default();
    let fixed: [(&[&str], &str); 6] = [
        (&["render", "phantom:lobster@24", "--samples", "2^10", "--size", "20x20", "-o"], ".png"),
        (&["render", "phantom:lobster@24", "--samples", "2^10", "--size", "20x20", "-o", "a.npy", "--json"], ".json"),
        (&["sample", "phantom:lobster@24", "--samples", "2^10", "-o"], ".mcvr"),
        (&["plan", "phantom:lobster@24", "--json"], ".plan"),
        (&["orbit", "phantom:lobster@24", "--samples", "2^10", "--frames", "2", "--size", "20x20", "-o"], ".gif"),
        (&SMALL_RUN, "-run"),
    ];
    for (arguments, ending) in fixed {
        let name = odd(ending);
        let ended = place.run(arguments.iter().map(|a| OsStr::new(*a)).chain([name.as_os_str()]))?;
        let made = ended.status.success() && place.path(&name).exists();
        tally.check(made, || format!("{ending}: {}", ended.last_words()));
    }
    // One image a camera: the camera's name goes into the file's.
    std::fs::write(
        place.path("scene.toml"),
        "[volume]\ninput = \"phantom:lobster@24\"\n[[camera]]\nname = \"one\"\n[[camera]]\nname = \"two\"\n",
    )?;
    let name = odd(".png");
    let two = ["render", "scene.toml", "--samples", "2^10", "--size", "20x20", "-o"].map(OsStr::new);
    let ended = place.run(two.into_iter().chain([name.as_os_str()]))?;
    let both = [odd("-one.png"), odd("-two.png")].iter().all(|n| place.path(n).exists());
    tally.check(both, || format!("two cameras: {}", ended.last_words()));
    let ended = finish(place.command([OsStr::new("info"), odd("").as_os_str()]))?;
    tally.check(ended.failed_with(2, &["UTF-8"]), || format!("as an input: {}", ended.last_words()));
    Ok(tally.finding("commands", "an input of such a name is refused: its name would not fit into any record"))
}
