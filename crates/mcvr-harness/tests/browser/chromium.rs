//! A headless Chromium: opens one local page, waits until its scripts are quiet, and hands back what came of it.

use std::ffi::OsString;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Longest that a page may take; it is seconds.
const PATIENCE: Duration = Duration::from_secs(180);

/// The browser, or `None` with a notice where there is none. Where `MCVR_EXPECT_CHROMIUM` is set, none is a failure.
pub fn find() -> Option<PathBuf> {
    let named = std::env::var_os("MCVR_CHROMIUM").filter(|path| !path.is_empty()).map(PathBuf::from);
    if let Some(path) = &named {
        assert!(path.is_file(), "MCVR_CHROMIUM={} is no file", path.display());
    }
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let found =
        named.or_else(|| names.iter().flat_map(|n| folders.iter().map(move |f| f.join(n))).find(|p| p.is_file()));
    if found.is_none() {
        let notice = "no chromium in PATH (or MCVR_CHROMIUM): the page is not tested in a browser";
        assert!(std::env::var_os("MCVR_EXPECT_CHROMIUM").is_none(), "{notice}, and MCVR_EXPECT_CHROMIUM is set");
        // Past the test harness, which keeps the output of tests that pass.
        let _ = std::io::stderr().write_all(format!("skipped: {notice}\n").as_bytes());
    }
    found
}

/// What came of opening a page.
pub struct Opened {
    /// The document when all scripts were done; empty for a screenshot.
    pub document: String,
    /// Lines that the page, or the browser about it, wrote to the console, at any level.
    pub console: Vec<String>,
}

/// Opens a page; `work` is an empty folder for the browser's own files.
pub fn open(browser: &Path, page: &Path, work: &Path, flags: &[OsString]) -> Opened {
    std::fs::create_dir_all(work).unwrap();
    let [out, log] = ["out", "log"].map(|name| work.join(name));
    let mut child = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"])
        .args(["--no-first-run", "--disable-extensions", "--disable-background-networking", "--disable-sync"])
        .args(["--force-color-profile=srgb", "--force-device-scale-factor=1", "--allow-file-access-from-files"])
        .args(["--enable-logging=stderr", "--v=0", "--virtual-time-budget=20000"])
        .arg(format!("--user-data-dir={}", work.join("profile").display()))
        .args(flags)
        .arg(format!("file://{}", page.display()))
        .stdin(Stdio::null())
        .stdout(File::create(&out).unwrap())
        .stderr(File::create(&log).unwrap())
        .spawn()
        .unwrap();
    let start = Instant::now();
    let status = loop {
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None if start.elapsed() > PATIENCE => {
                child.kill().unwrap();
                child.wait().unwrap();
                panic!("the browser did not end within {PATIENCE:?}: {}", std::fs::read_to_string(&log).unwrap());
            }
            None => std::thread::sleep(Duration::from_millis(20)),
        }
    };
    let text = |path| String::from_utf8_lossy(&std::fs::read(path).unwrap()).into_owned();
    let log = text(&log);
    assert!(status.success(), "{status}: {log}");
    let console = log.lines().filter(|line| line.contains(":CONSOLE")).map(str::to_owned).collect();
    Opened { document: text(&out), console }
}
