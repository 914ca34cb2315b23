//! Every effect by method and kernel: agreement with ray casting, slope, error and time; and the report's shaded figures.
//!
//! `cargo run --release -p mcvr --example effects_table -- --data DIR --out DIR [--only table|timing|pictures|page] [--quick]`
//! writes `effects.json` (all records), `effects.csv`, `effects.md` and pictures. DIR holds the lobster and the CT head of
//! README's "Real scans". `--only` measures one part anew and keeps the records of the others; `--resume` goes on with a
//! table that was interrupted. `--side`, `--tolerance` and `--depth` say how large the table's images and how good its
//! truths are. Truths are kept in
//! `OUT/truths` and cast again only where the scene changed.
#![allow(missing_docs, reason = "a program, not a library")]

mod agreement;
mod page;
mod pictures;
mod report_figures;
mod scenes;
mod table;
mod timing;
mod truths;

use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

/// Any failure.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// What was asked for on the command line.
pub struct Options {
    pub data: PathBuf,
    pub out: PathBuf,
    /// The `mcvr` program, for peaks of memory.
    pub program: PathBuf,
    pub only: Option<String>,
    /// Small and few, to see whether everything runs.
    pub quick: bool,
    /// Keep the rows of the table that there are.
    pub resume: bool,
    /// Pixels of a side of the table's images.
    pub side: usize,
    /// Error of the truth's pixels over their mean that is asked for.
    pub tolerance: f64,
    /// How often a pixel of a truth may be halved.
    pub depth: u32,
}

impl Options {
    fn read() -> Outcome<Self> {
        let (mut data, mut out, mut program, mut only, mut quick) = (None, None, None, None, false);
        let (mut resume, mut side, mut tolerance, mut depth) = (false, None, None, None);
        let mut arguments = std::env::args().skip(1);
        while let Some(name) = arguments.next() {
            match name.as_str() {
                "--quick" => quick = true,
                "--resume" => resume = true,
                _ => {}
            }
            if ["--quick", "--resume"].contains(&name.as_str()) {
                continue;
            }
            let value = arguments.next().ok_or_else(|| format!("{name} needs a value"))?;
            match name.as_str() {
                "--data" => data = Some(PathBuf::from(value)),
                "--out" => out = Some(PathBuf::from(value)),
                "--program" => program = Some(PathBuf::from(value)),
                "--side" => side = Some(value.parse()?),
                "--tolerance" => tolerance = Some(value.parse()?),
                "--depth" => depth = Some(value.parse()?),
                "--only" if PARTS.contains(&value.as_str()) => only = Some(value),
                "--only" => return Err(format!("--only takes one of {}", PARTS.join(", ")).into()),
                _ => {
                    return Err(
                        format!("unknown option '{name}'; give --data DIR --out DIR [--only PART] [--quick]").into()
                    );
                }
            }
        }
        let built = || Some(std::env::current_exe().ok()?.parent()?.parent()?.join("mcvr"));
        Ok(Self {
            data: data.ok_or("--data DIR is missing")?,
            out: out.ok_or("--out DIR is missing")?,
            program: program.or_else(built).ok_or("--program FILE is missing")?,
            only,
            quick,
            resume,
            side: side.unwrap_or(if quick { 24 } else { table::SIDE }),
            tolerance: tolerance.unwrap_or(if quick { 3e-2 } else { table::TOLERANCE }),
            depth: depth.unwrap_or(table::DEPTH),
        })
    }

    fn wants(&self, part: &str) -> bool {
        self.only.as_ref().is_none_or(|o| o == part)
    }
}

const PARTS: [&str; 4] = ["table", "timing", "pictures", "page"];

/// Where and from what a part was measured.
fn circumstances(quick: bool) -> Value {
    json!({
        "machine": mcvr::harness::machine(),
        "commit": mcvr::harness::git_commit(),
        "threads": rayon::current_num_threads(),
        "quick": quick,
    })
}

fn load(path: &Path) -> Outcome<Map<String, Value>> {
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(serde_json::from_str(&text)?),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Map::new()),
        Err(e) => Err(e.into()),
    }
}

/// Replaces one part of the records and writes them all.
fn keep(store: &mut Map<String, Value>, options: &Options, part: &str, mut records: Value) -> Outcome<()> {
    records["circumstances"] = circumstances(options.quick);
    store.insert(part.to_owned(), records);
    std::fs::write(options.out.join("effects.json"), serde_json::to_string_pretty(store)? + "\n")?;
    page::write(&options.out, store)
}

fn main() -> Outcome<()> {
    let options = Options::read()?;
    std::fs::create_dir_all(&options.out)?;
    let mut store = load(&options.out.join("effects.json"))?;
    if options.wants("pictures") {
        let records = pictures::all(&options)?;
        keep(&mut store, &options, "pictures", records)?;
    }
    if options.wants("timing") {
        let records = json!({
            "effects": timing::effects(&options)?,
            "report": report_figures::million(&options)?,
            "memory": report_figures::memory(&options)?,
            "gradients": report_figures::gradients(&options)?,
        });
        keep(&mut store, &options, "timing", records)?;
    }
    if options.wants("table") {
        let before = store.get("table").cloned().unwrap_or_default();
        table::measure(&options, &before, |records| keep(&mut store, &options, "table", records))?;
    }
    page::write(&options.out, &store)
}
