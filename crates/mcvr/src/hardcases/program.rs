//! The program in a process of its own, watched: what a case starts ends, whatever happens.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use super::{CaseError, Context};

/// Longest time that a quick case waits for a process.
pub(super) const PATIENCE: Duration = Duration::from_secs(60);

/// A process that has ended.
#[derive(Debug)]
pub(super) struct Ended {
    pub status: ExitStatus,
    pub out: Vec<u8>,
    pub err: String,
    /// Largest anonymous memory seen while it ran, bytes; 0 where the system does not tell.
    anonymous: u64,
}

impl Ended {
    /// The exit status, where there is one.
    pub(super) fn code(&self) -> Option<i32> {
        self.status.code()
    }

    /// Largest anonymous memory seen while it ran, where the system tells.
    pub(super) fn anonymous(&self) -> Result<f64, CaseError> {
        let unknown = || CaseError::Impossible("this system does not tell a process's anonymous memory".into());
        if self.anonymous > 0 { Ok(self.anonymous as f64) } else { Err(unknown()) }
    }

    /// An error said in words: the status, the parts of the message, no panic.
    pub(super) fn failed_with(&self, code: i32, parts: &[&str]) -> bool {
        self.code() == Some(code) && !self.err.contains("panicked") && parts.iter().all(|p| self.err.contains(p))
    }

    /// The status and the last line that was said.
    pub(super) fn last_words(&self) -> String {
        format!("{}: {}", self.status, self.err.trim_end().lines().next_back().unwrap_or("nothing said"))
    }
}

/// A process that runs. It is killed when this is dropped.
pub(super) struct Running {
    child: Child,
    out: Option<File>,
    err: Option<File>,
}

impl Drop for Running {
    fn drop(&mut self) {
        // Both fail where it has ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Where the program runs: a folder of its own.
pub(super) struct Place<'a> {
    program: &'a Path,
    folder: tempfile::TempDir,
}

impl<'a> Place<'a> {
    /// A fresh folder; needs a system with signals and a shell.
    pub(super) fn new(context: &'a Context) -> Result<Self, CaseError> {
        if !cfg!(unix) {
            return Err(CaseError::Impossible("needs a Unix shell".into()));
        }
        Ok(Self { program: context.program()?, folder: context.folder()? })
    }

    /// A path in the folder.
    pub(super) fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Names of all that lies in the folder.
    pub(super) fn names(&self) -> Result<Vec<String>, CaseError> {
        names(self.folder.path())
    }

    /// Words before a command that run it as a user without privileges: none for users who have none. The folder is open to
    /// that user.
    pub(super) fn unprivileged(&self) -> Result<&'static str, CaseError> {
        let user = Command::new("id").arg("-u").output()?;
        if String::from_utf8_lossy(&user.stdout).trim() != "0" {
            return Ok("");
        }
        #[cfg(unix)]
        // The folder of all cases, above this one, is private as well.
        for folder in self.folder.path().canonicalize()?.ancestors().take(2) {
            std::fs::set_permissions(folder, std::os::unix::fs::PermissionsExt::from_mode(0o777))?;
        }
        let nobody = "setpriv --reuid=65534 --regid=65534 --clear-groups";
        let tried = finish(self.shell(&format!("exec {nobody} \"$@\""), ["--version"]))?;
        let cannot = || CaseError::Impossible(format!("the superuser cannot be nobody here: {}", tried.last_words()));
        if tried.status.success() { Ok(nobody) } else { Err(cannot()) }
    }

    /// The program with arguments, in the folder, with nothing to read.
    pub(super) fn command<S: AsRef<OsStr>>(&self, arguments: impl IntoIterator<Item = S>) -> Command {
        let mut command = Command::new(self.program);
        command.args(arguments).current_dir(self.folder.path()).stdin(Stdio::null());
        command
    }

    /// A shell that runs a script whose `"$@"` is the program with arguments.
    pub(super) fn shell<S: AsRef<OsStr>>(&self, script: &str, arguments: impl IntoIterator<Item = S>) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", script, "sh"]).arg(self.program).args(arguments);
        command.current_dir(self.folder.path()).stdin(Stdio::null());
        command
    }

    /// Runs the program with arguments, to its end.
    pub(super) fn run<S: AsRef<OsStr>>(&self, arguments: impl IntoIterator<Item = S>) -> Result<Ended, CaseError> {
        finish(self.command(arguments))
    }

    /// As [`Self::run`]; anything but success is an error of the case.
    pub(super) fn must<S: AsRef<OsStr>>(&self, arguments: impl IntoIterator<Item = S>) -> Result<Ended, CaseError> {
        let ended = self.run(arguments)?;
        if ended.status.success() { Ok(ended) } else { Err(ended.last_words().into()) }
    }
}

/// Names of all that lies in a folder, sorted.
pub(super) fn names(folder: &Path) -> Result<Vec<String>, CaseError> {
    let entries = std::fs::read_dir(folder)?.map(|e| Ok(e?.file_name().to_string_lossy().into_owned()));
    let mut names = entries.collect::<Result<Vec<_>, std::io::Error>>()?;
    names.sort();
    Ok(names)
}

/// Runs a command to its end, catching what it says.
pub(super) fn finish(command: Command) -> Result<Ended, CaseError> {
    start(command)?.wait(PATIENCE)
}

/// Starts a command, catching what it says in files, which never fill up as pipes do.
pub(super) fn start(mut command: Command) -> Result<Running, CaseError> {
    let (out, err) = (tempfile::tempfile()?, tempfile::tempfile()?);
    command.stdout(out.try_clone()?).stderr(err.try_clone()?);
    let child = command.spawn()?;
    Ok(Running { child, out: Some(out), err: Some(err) })
}

/// Starts a command whose standard output and error are as it says.
pub(super) fn start_as_is(mut command: Command) -> Result<Running, CaseError> {
    Ok(Running { child: command.spawn()?, out: None, err: None })
}

impl Running {
    /// Waits for the end; a process that takes too long is an error.
    pub(super) fn wait(mut self, patience: Duration) -> Result<Ended, CaseError> {
        let begin = Instant::now();
        let mut anonymous = 0;
        let status = loop {
            if let Some(status) = self.child.try_wait()? {
                break status;
            }
            anonymous = anonymous.max(anonymous_memory(self.child.id()).unwrap_or(0));
            if begin.elapsed() > patience {
                return Err(format!("still running after {} s", patience.as_secs()).into());
            }
            std::thread::sleep(Duration::from_millis(2));
        };
        let read = |file: Option<File>| -> Result<Vec<u8>, CaseError> {
            let mut bytes = vec![];
            if let Some(mut file) = file {
                file.rewind()?;
                file.read_to_end(&mut bytes)?;
            }
            Ok(bytes)
        };
        let (out, err) = (read(self.out.take())?, read(self.err.take())?);
        Ok(Ended { status, out, err: String::from_utf8_lossy(&err).into_owned(), anonymous })
    }

    /// Waits until something holds; an error when the process ends first.
    pub(super) fn until(&mut self, mut holds: impl FnMut() -> bool) -> Result<(), CaseError> {
        let begin = Instant::now();
        while !holds() {
            if let Some(status) = self.child.try_wait()? {
                return Err(format!("ended too early: {status}").into());
            }
            if begin.elapsed() > PATIENCE {
                return Err("nothing happened".into());
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }

    /// Waits until the program has a handler for Ctrl-C: from then on it is at work.
    pub(super) fn until_at_work(&mut self) -> Result<(), CaseError> {
        let table = PathBuf::from(format!("/proc/{}/status", self.child.id()));
        if !table.exists() {
            return Err(CaseError::Impossible("needs /proc to see when the program is at work".into()));
        }
        self.until(|| {
            let status = std::fs::read_to_string(&table).unwrap_or_default();
            let caught = status.lines().find_map(|l| l.strip_prefix("SigCgt:"));
            // SIGINT is signal 2, the second bit.
            caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 2 != 0)
        })
    }

    /// Sends a signal by name: `INT`, `TERM`, `KILL`.
    pub(super) fn signal(&self, name: &str) -> Result<(), CaseError> {
        let sent = Command::new("kill").arg(format!("-{name}")).arg(self.child.id().to_string()).status()?;
        if sent.success() { Ok(()) } else { Err(format!("kill -{name}: {sent}").into()) }
    }
}

/// Resident memory of a process that no file backs (Linux).
fn anonymous_memory(process: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("RssAnon:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}
