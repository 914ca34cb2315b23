//! First inputs: the good files of the catalogue of hard cases.

use std::path::Path;

use mcvr::hardcases::files::{Reader, good_files};

/// The first inputs of a target; files are made in `folder`.
pub fn of(target: &str, folder: &Path) -> Vec<Vec<u8>> {
    if target == "numbers" {
        let all = ["2^10..2^24,3M", "1e6", "256x256x113", "1,1,1.4", "lobster@64x32x16", "99.9,100", "tent"];
        return all.map(Vec::from).into();
    }
    let files = good_files(folder).expect("space for small files");
    let wanted = files.into_iter().filter(|g| match g.reader {
        Reader::Volume => target == "volume",
        Reader::Image => target == if g.format == "NPY" { "npy" } else { "image" },
        Reader::Cloud => target == "cloud",
        Reader::Scene => target == "scene",
        Reader::Matrix => target == "matrix",
        Reader::Records => target == "records",
    });
    let mut seeds: Vec<Vec<u8>> = wanted
        .map(|g| {
            // The last byte of a volume says how it is opened: headerless ones with options.
            let how: &[u8] =
                if g.reader == Reader::Volume { &[if g.format.starts_with("raw") { 4 } else { 0 }] } else { b"" };
            [&g.bytes, how].concat()
        })
        .collect();
    if target == "scene" {
        let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
        let paths = std::fs::read_dir(examples).expect("the repository").flatten().map(|e| e.path());
        seeds.extend(paths.filter(|p| p.extension().is_some_and(|e| e == "toml")).flat_map(std::fs::read));
    }
    seeds
}
