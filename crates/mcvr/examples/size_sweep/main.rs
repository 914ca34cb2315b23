//! Seconds and memory of every phase of an image, from 64³ to 1024³ voxels, of a scan that stays in its file.
//!
//! `cargo run --release -p mcvr --example size_sweep -- [--max 1024] [--types u8,u16,i16,f32] [--repeats 5] [--memory file|heap]
//! [--folder DIR] [--markdown FILE] [--json FILE]` writes the lobster phantom to DIR (the system's temporary folder; a file at a time, removed
//! afterwards), maps it (or, with `--memory heap`, copies it) and measures. Each size has a process of its own, so that memory is that of one image.
//! Views look along x, y and z, which is the order in which voxels are drawn.
#![allow(missing_docs, reason = "a program, not a library")]

mod files;
mod page;
mod worker;

use std::path::PathBuf;
use std::process::Command;

use serde_json::{Value, json};

/// Any failure.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// What was asked for on the command line.
pub struct Options {
    max: usize,
    types: Vec<String>,
    repeats: usize,
    memory: String,
    folder: PathBuf,
    markdown: Option<PathBuf>,
    json: Option<PathBuf>,
}

const USAGE: &str = "give [--max 1024] [--types u8,u16,i16,f32] [--repeats 5] [--memory file|heap] [--folder DIR] [--markdown FILE] [--json FILE]";

impl Options {
    fn read() -> Outcome<Self> {
        let mut options = Self {
            max: 1024,
            types: vec!["u8".into()],
            repeats: 5,
            memory: "file".into(),
            folder: std::env::temp_dir(),
            markdown: None,
            json: None,
        };
        let mut arguments = std::env::args().skip(1);
        while let Some(name) = arguments.next() {
            let value = arguments.next().ok_or_else(|| format!("{name} needs a value; {USAGE}"))?;
            match name.as_str() {
                "--max" => options.max = value.parse().map_err(|e| format!("--max {value}: {e}"))?,
                "--repeats" => options.repeats = value.parse().map_err(|e| format!("--repeats {value}: {e}"))?,
                "--types" => options.types = value.split(',').map(str::to_owned).collect(),
                "--memory" => options.memory = value,
                "--folder" => options.folder = value.into(),
                "--markdown" => options.markdown = Some(value.into()),
                "--json" => options.json = Some(value.into()),
                _ => return Err(format!("unknown option '{name}'; {USAGE}").into()),
            }
        }
        if let Some(unknown) = options.types.iter().find(|t| !files::TYPES.contains(&t.as_str())) {
            return Err(format!("--types: '{unknown}' is none of {}", files::TYPES.join(", ")).into());
        }
        if !["file", "heap"].contains(&options.memory.as_str()) {
            return Err(format!("--memory: '{}' is none of file, heap", options.memory).into());
        }
        if options.max < 64 || options.repeats == 0 {
            return Err(format!("--max is at least 64 and --repeats at least 1; {USAGE}").into());
        }
        Ok(options)
    }
}

/// Runs this program again for one file, and reads what it says.
fn in_a_process(arguments: &[String]) -> Outcome<Value> {
    let run = Command::new(std::env::current_exe()?).args(arguments).output()?;
    if !run.status.success() {
        return Err(format!("{}: {}", arguments.join(" "), String::from_utf8_lossy(&run.stderr)).into());
    }
    Ok(serde_json::from_slice(&run.stdout)?)
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["write", side, kind, path] => {
            files::write(side.parse()?, kind, path.as_ref())?;
            println!("null");
            return Ok(());
        }
        ["measure", path, memory, threads, repeats] => {
            println!("{}", worker::measure(path.as_ref(), memory == "heap", threads.parse()?, repeats.parse()?)?);
            return Ok(());
        }
        _ => {}
    }
    let options = Options::read()?;
    let folder = tempfile::tempdir_in(&options.folder)?;
    let threads = [1, rayon::current_num_threads()];
    let mut rows = vec![];
    for kind in &options.types {
        for side in [64, 128, 256, 512, 1024].into_iter().filter(|side| *side <= options.max) {
            let path = folder.path().join(format!("{kind}-{side}.nrrd"));
            let name = path.display().to_string();
            in_a_process(&["write".into(), side.to_string(), kind.clone(), name.clone()])?;
            for threads in &threads[..if threads[1] > 1 { 2 } else { 1 }] {
                let memory = options.memory.clone();
                let measured = in_a_process(&[
                    "measure".into(),
                    name.clone(),
                    memory,
                    threads.to_string(),
                    options.repeats.to_string(),
                ])?;
                eprintln!("{kind} {side}³, {threads} thread(s): {}", page::summary(&measured));
                rows.push(json!({ "type": kind, "side": side, "threads": threads, "measured": measured }));
            }
            std::fs::remove_file(&path)?;
        }
    }
    let page = page::page(&rows);
    println!("{page}");
    if let Some(path) = &options.markdown {
        mcvr::volume::write_whole(path, |out| std::io::Write::write_all(out, page.as_bytes()))?;
    }
    if let Some(path) = &options.json {
        let text = serde_json::to_string_pretty(&rows)?;
        mcvr::volume::write_whole(path, |out| std::io::Write::write_all(out, text.as_bytes()))?;
    }
    Ok(())
}
