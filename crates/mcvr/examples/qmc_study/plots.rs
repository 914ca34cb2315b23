//! Error × √time over that of independent samples, a panel for each scan, a line for each kind of points.

use std::io::Write as _;
use std::path::Path;

use mcvr::harness::panels::{Line, Panel, Plot};

use crate::Outcome;
use crate::entrants::MC;
use crate::figures::Figures;
use crate::scans::VIEWS;

/// Lines of the plots: one for each kind of points, not for each variant of the net.
const LINES: [&str; 8] = ["mc", "stratified", "systematic", "ssp", "random voxels", "net", "lattice", "sequence"];

/// Writes a file for each view of which there is something to show; gives names and what a reader who cannot see them is told.
pub fn write(out: &Path, figures: &Figures<'_>) -> Outcome<Vec<(String, String)>> {
    let mut written = vec![];
    for view in VIEWS {
        let mut panels = vec![];
        for place in figures.places.iter().filter(|p| p.view == view) {
            let line = |method: &str| {
                let ratio = |l: u32| Some(figures.cost(place, method, l)? / figures.cost(place, MC, l)?);
                let points = (10..=30).filter_map(|l| Some((f64::from(l), ratio(l)?))).collect();
                Line { label: method.to_owned(), points }
            };
            let lines: Vec<Line> = LINES.iter().map(|m| line(m)).filter(|l| !l.points.is_empty()).collect();
            if !lines.is_empty() {
                panels.push(Panel { title: place.scan.clone(), lines });
            }
        }
        if panels.is_empty() {
            continue;
        }
        let title = format!("Error × √time over Monte Carlo's, {view} views");
        let plot = Plot {
            title: title.clone(),
            x: "samples".into(),
            y: "error × √time / Monte Carlo's".into(),
            x_label: |level| format!("2^{level:.0}"),
            panels,
        };
        let (svg, name) = (plot.svg()?, format!("{view}.svg"));
        mcvr::volume::write_whole(&out.join(&name), |file| file.write_all(svg.as_bytes()))?;
        written.push((name, title));
    }
    Ok(written)
}
