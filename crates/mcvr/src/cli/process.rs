//! What the operating system knows of this process.

use anyhow::bail;
use serde_json::{Value, json};

/// Bytes of memory that this process could still take: what the machine has without swapping, less where a limit
/// (`ulimit -v`, `ulimit -d`) allows less. Where the system tells (Linux).
pub fn free_memory() -> Option<u64> {
    let machine = kib("/proc/meminfo", "MemAvailable:")?;
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let left = |limit: &str, taken: &str| {
        let soft = limits.lines().find_map(|l| l.strip_prefix(limit))?.split_whitespace().next()?;
        Some(soft.parse::<u64>().ok()?.saturating_sub(kib("/proc/self/status", taken)?))
    };
    let limited = [left("Max address space", "VmSize:"), left("Max data size", "VmData:")];
    Some(limited.into_iter().flatten().fold(machine, u64::min))
}

/// Largest resident memory so far in bytes, where the system tells (Linux).
pub fn peak_memory() -> Option<u64> {
    kib("/proc/self/status", "VmHWM:")
}

/// Seconds that this process has spent on processors so far, all threads together, where the system tells.
fn cpu_seconds() -> Option<f64> {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        Some(time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9)
    }
    #[cfg(not(unix))]
    None
}

/// Makes an image so many times: the seconds of each on the clock, which `make` gives, and on all processors together.
pub fn repeated(times: u32, mut make: impl FnMut() -> anyhow::Result<f64>) -> anyhow::Result<Value> {
    let (mut wall, mut cpu) = (vec![], vec![]);
    for _ in 0..times {
        let begin = cpu_seconds();
        wall.push(make()?);
        cpu.push(cpu_seconds().zip(begin).map(|(now, then)| now - then));
    }
    Ok(json!({ "complete": wall, "cpu": cpu }))
}

/// A line of one of the kernel's tables in bytes.
fn kib(table: &str, name: &str) -> Option<u64> {
    let table = std::fs::read_to_string(table).ok()?;
    let line = table.lines().find_map(|l| l.strip_prefix(name))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

/// Refuses what will not fit, before the work: a failed allocation ends the process without a word of what to do.
pub fn check_memory(bytes: u64, what: &str) -> anyhow::Result<()> {
    match free_memory().filter(|free| bytes > *free) {
        Some(free) => bail!("{what} takes {bytes} bytes of memory and {free} are free; ask for less"),
        None => Ok(()),
    }
}
