//! Tells the program what compiled it: instruction counts of two builds compare only where that is the same.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let set = |name: &str| std::env::var(name).unwrap_or_default();
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let version = Command::new(rustc).arg("-V").output().ok();
    let version = version.map(|out| String::from_utf8_lossy(&out.stdout).trim().to_owned()).unwrap_or_default();
    let mut words = vec![version, format!("{} build", set("PROFILE")), format!("opt-level {}", set("OPT_LEVEL"))];
    words.push(set("TARGET"));
    // Flags are separated by the unit separator; those of a tool that only watches the build are not many.
    words.push(set("CARGO_ENCODED_RUSTFLAGS").replace('\u{1f}', " "));
    words.retain(|w| !w.is_empty());
    println!("cargo::rustc-env=MCVR_COMPILER={}", words.join(", "));
}
