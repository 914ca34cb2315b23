//! Where a run took place and what was run.

use std::fs::read_to_string;
use std::process::{Command, Stdio};

/// Processor, cores available to this process and memory, for example `AMD EPYC 7B13, 8 cores, 32 GiB`; what the system
/// does not tell is left out, and `unknown` is all when it tells nothing.
pub fn machine() -> String {
    let cpu = read_to_string("/proc/cpuinfo").ok().and_then(|text| cpu_model(&text));
    let cores = std::thread::available_parallelism().ok().map(|n| match n.get() {
        1 => "1 core".to_owned(),
        n => format!("{n} cores"),
    });
    let memory = read_to_string("/proc/meminfo").ok().and_then(|text| memory_gib(&text));
    let parts: Vec<String> = [cpu, cores, memory.map(|gib| format!("{gib} GiB"))].into_iter().flatten().collect();
    if parts.is_empty() { "unknown".to_owned() } else { parts.join(", ") }
}

fn cpu_model(cpuinfo: &str) -> Option<String> {
    let line = cpuinfo.lines().find(|l| l.starts_with("model name"))?;
    let name = line.split_once(':')?.1.replace("(R)", "").replace("(TM)", "");
    let name = name.split_whitespace().collect::<Vec<_>>().join(" ");
    (!name.is_empty()).then_some(name)
}

fn memory_gib(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find(|l| l.starts_with("MemTotal"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some((kib / 1024.0 / 1024.0).round() as u64)
}

/// The short revision of the program's source: what the variable `MCVR_COMMIT` said when it was built, else what git says
/// of the tree it was built in, as far as that is still there; then a trailing `-dirty` says that tracked files are
/// changed. The current folder is not asked: it may belong to another project. `None` when nothing tells.
pub fn git_commit() -> Option<String> {
    if let Some(commit) = option_env!("MCVR_COMMIT").filter(|c| !c.is_empty()) {
        return Some(commit.to_owned());
    }
    let git = |arguments: &[&str]| {
        let mut command = Command::new("git");
        command.arg("-C").arg(env!("CARGO_MANIFEST_DIR")).args(arguments);
        let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let commit = git(&["rev-parse", "--short", "HEAD"]).filter(|c| !c.is_empty())?;
    let changed = git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|s| !s.is_empty());
    Some(if changed { format!("{commit}-dirty") } else { commit })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_machine_is_described_in_one_short_line() {
        let text = machine();
        assert!(!text.is_empty() && !text.contains('\n') && text.len() < 120, "{text}");
        assert_eq!(cpu_model("model name\t: Some(R)  CPU @ 2 GHz\n").as_deref(), Some("Some CPU @ 2 GHz"));
        assert_eq!(memory_gib("MemTotal:       32768000 kB\n"), Some(31));
        assert_eq!((cpu_model(""), memory_gib("")), (None, None));
    }
}
