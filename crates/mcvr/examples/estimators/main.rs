//! Estimators that mcvr does not offer, beside those that it does: is any of them the cheapest way to any error?
//!
//! `cargo run --release -p mcvr --example estimators -- DATA_DIR [--markdown FILE] [--json FILE] [--rounds 3] [--only PART]
//! [--families LIST] [--all yes] [--view AZIMUTH,ELEVATION]`
//!
//! `--only` takes the volumes whose name has the part, `--families` some families (names with commas between them), `--all yes` every scan
//! of the folder.
//!
//! | family | what it is |
//! | --- | --- |
//! | `rays`, `comb`, `march`, `qmc` | mcvr's own, for comparison |
//! | `cv` | control variate: rays through a coarse grid, the signed residual by a Sobol net |
//! | `cv comb` | the same with a comb through the coarse grid |
//! | `multilevel` | nested grids of factors 2, 4 and 8, samples shared out by an independent pilot |
//! | `comb difference` | rays through the coarse grid, plus a comb of the fine less the same comb of the coarse grid |
//! | `cv footprint` | rays or a comb through the coarse grid, footprints of the residual |
//! | `footprint` | every voxel that is not 0 adds the projection of its tent to the image |
//! | `joseph` | bilinear interpolation in slices, slice after slice in the order of memory |
//!
//! Seconds are processor time of one thread, the least of several rounds in which all take turns, for the image alone; what can be
//! kept from view to view (tables, grids, lists) is timed by itself as preparation. The error is the RMSE over the mean pixel against
//! [`reference`](mcvr::raycast::reference()), over the rounds' seeds.
#![allow(missing_docs, reason = "a program, not a library")]

mod baseline;
mod clock;
mod control_variate;
mod footprint;
mod footprint_table;
mod joseph;
mod nested;
mod page;
mod scenes;
#[cfg(test)]
mod tests;

use std::io::Write;
use std::path::{Path, PathBuf};

use mcvr::scene::Image;

/// Any failure.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// An image and its work: points drawn, evaluations of the field, or voxels projected.
pub struct Made {
    pub image: Image,
    pub work: u64,
}

/// An estimator with all its settings.
pub struct Entry<'a> {
    pub family: &'static str,
    pub setting: String,
    /// Names of the preparations that it needs.
    pub needs: Vec<&'static str>,
    /// Makes an image from a seed.
    pub work: Box<dyn FnMut(u64) -> Outcome<Made> + Send + 'a>,
}

/// Work that serves all views.
pub struct Preparation<'a> {
    pub name: &'static str,
    pub work: Box<dyn FnMut() -> Outcome<()> + Send + 'a>,
}

struct Options {
    data: PathBuf,
    markdown: Option<PathBuf>,
    json: Option<PathBuf>,
    rounds: usize,
    only: Option<String>,
    families: Option<String>,
    all: bool,
    /// Azimuth and elevation in degrees.
    view: [f64; 2],
}

const USAGE: &str = "usage: estimators DATA_DIR [--markdown FILE] [--json FILE] [--rounds N] [--only PART] \
                     [--families LIST] [--all yes] [--view AZIMUTH,ELEVATION]";

fn options() -> Outcome<Options> {
    let mut args = std::env::args().skip(1);
    let data = PathBuf::from(args.next().ok_or(USAGE)?);
    let mut options = Options {
        data,
        markdown: None,
        json: None,
        rounds: 3,
        only: None,
        families: None,
        all: false,
        view: [30.0, 20.0],
    };
    while let Some(flag) = args.next() {
        let value = args.next().ok_or(USAGE)?;
        match &flag[..] {
            "--markdown" => options.markdown = Some(value.into()),
            "--json" => options.json = Some(value.into()),
            "--rounds" => options.rounds = value.parse::<usize>()?.max(1),
            "--only" => options.only = Some(value),
            "--families" => options.families = Some(value),
            "--view" => {
                let (azimuth, elevation) = value.split_once(',').ok_or(USAGE)?;
                options.view = [azimuth.parse()?, elevation.parse()?];
            }
            "--all" => options.all = value == "yes",
            _ => return Err(USAGE.into()),
        }
    }
    Ok(options)
}

fn main() -> Outcome<()> {
    let options = options()?;
    let mut results = vec![];
    for source in scenes::sources(&options.data, options.all)? {
        if options.only.as_ref().is_some_and(|o| !source.contains(&o[..])) {
            continue;
        }
        let scene = scenes::Scene::load(&source, 400, options.view)?;
        let result = clock::one_thread(|| measure(&scene, options.rounds, options.families.as_deref()))??;
        eprintln!("{}", page::section(&result));
        results.push(result);
    }
    let text = page::markdown(&results);
    println!("{text}");
    if let Some(path) = &options.markdown {
        write(path, text.as_bytes())?;
    }
    if let Some(path) = &options.json {
        write(path, page::json(&results).as_bytes())?;
    }
    Ok(())
}

fn write(path: &Path, bytes: &[u8]) -> Outcome<()> {
    Ok(mcvr::volume::write_whole(path, |out| out.write_all(bytes))?)
}

/// Prepares and measures all estimators, or those of some families, on one scene.
pub fn measure(scene: &scenes::Scene, rounds: usize, families: Option<&str>) -> Outcome<page::Measured> {
    let wanted = |family: &str| families.is_none_or(|list| list.split(',').any(|f| f == family));
    let base = baseline::Ready::new(scene)?;
    let depth = if control_variate::FAMILIES.into_iter().any(wanted) { nested::DEPTH } else { 0 };
    let chain = nested::Chain::new(&scene.density, scene.unit, depth)?;
    let nets = control_variate::Nets::new(&chain)?;
    let list = footprint::Splats::new(&scene.density);
    let mut entries = baseline::entries(scene, &base);
    let mut preparations = baseline::preparations(scene);
    if depth > 0 {
        entries.extend(control_variate::entries(scene, &nets)?);
        preparations.extend(control_variate::preparations(scene, &chain));
    }
    entries.extend(footprint::entries(scene, &list));
    preparations.push(footprint::preparation(scene));
    entries.extend(joseph::entries(scene));
    entries.retain(|e| wanted(e.family));
    let times = clock::measure(&mut preparations, &mut entries, rounds, &scene.truth)?;
    Ok(page::Measured { scene: scene.described(), facts: chain.facts(), times })
}
