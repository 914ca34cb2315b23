//! A whole run with methods that only pretend. It shows what the folder of a run holds without any renderer.
//!
//! `cargo run --release -p mcvr-harness --example mock_report -- FOLDER`

mod pretended;

use std::error::Error;

use mcvr_harness::{converge::SERIES, key_lines};
use mcvr_scene::Extent;

fn main() -> Result<(), Box<dyn Error>> {
    let out = std::env::args_os().nth(1).ok_or("usage: mock_report FOLDER")?.into();
    let size = pretended::Size {
        extent: Extent::new(200, 160)?,
        samples: (12..=24).step_by(2).map(|m| 1 << m).collect(),
        series: SERIES.to_vec(),
        replicates: 8,
    };
    let progress = |done: u64, total: u64, message: &str| {
        eprint!("\r{:3.0} % {message:60}", 100.0 * done as f64 / total.max(1) as f64);
    };
    let summary = pretended::run(size, out, &progress)?;
    eprintln!();
    key_lines(&summary).iter().for_each(|line| println!("{line}"));
    Ok(())
}
