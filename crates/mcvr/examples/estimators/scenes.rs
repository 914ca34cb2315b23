//! The scans and phantoms, their cameras and truths.

use std::path::Path;

use mcvr::raycast::{ReferenceOptions, reference};
use mcvr::scene::{Camera, Density, DensityMap, Extent, Hounsfield, Image, Transfer, View, Watch};

use crate::Outcome;

/// Attenuation of water per mm, for scans in Hounsfield units.
const WATER: f64 = 0.02;

/// Parts of the names of the scans.
const SCANS: [&str; 4] = ["lobster_301", "cthead", "chest_ct_hu", "aneurism"];
const PHANTOMS: [&str; 2] = ["phantom:lobster@256", "phantom:vessels@256"];

/// Largest error of a pixel of the truth, over the mean.
const TOLERANCE: f64 = 1e-3;

pub struct Scene {
    pub name: String,
    pub density: Density,
    pub camera: Camera,
    pub truth: Image,
    /// RMSE of the truth by its own estimate.
    pub truth_error: f64,
    /// All weights are whole multiples of this.
    pub unit: f64,
}

/// Files of the scans, and phantoms; or all files that are volumes.
pub fn sources(folder: &Path, every: bool) -> Outcome<Vec<String>> {
    let mut files: Vec<String> = vec![];
    for entry in std::fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))? {
        files.push(entry?.path().to_string_lossy().into_owned());
    }
    if every {
        files.retain(|f| !f.ends_with(".md") && !f.ends_with(".tar.gz"));
        files.sort();
        return Ok(files);
    }
    let mut all = vec![];
    for scan in SCANS {
        let file = files.iter().find(|f| f.contains(scan));
        all.push(file.ok_or_else(|| format!("{} has no file named {scan}*", folder.display()))?.clone());
    }
    all.extend(PHANTOMS.map(String::from));
    Ok(all)
}

impl Scene {
    /// A view of `side` by `side` pixels, `line`, `tent`.
    pub fn load(source: &str, side: usize, [azimuth, elevation]: [f64; 2]) -> Outcome<Self> {
        let volume = mcvr::volume::load(source, None)?.volume;
        let hounsfield = source.contains("_hu_") || source.contains("abdomen");
        let transfer = if hounsfield { Transfer::Hounsfield(Hounsfield::of_water(WATER)?) } else { Transfer::Identity };
        let unit = if hounsfield { WATER / 1000.0 } else { 1.0 };
        let density = Density::new(&volume, DensityMap { transfer, ..DensityMap::default() })?;
        let camera =
            Camera::look(&View { azimuth, elevation, ..View::default() }, volume.grid(), Extent::new(side, side)?)?;
        let options = ReferenceOptions { tolerance: TOLERANCE, ..ReferenceOptions::default() };
        let truth = reference(&density, &camera, &options, &Watch::default())?;
        let name = source.rsplit(['/', '\\']).next().unwrap_or(source);
        let name = name.trim_start_matches("phantom:").split(['_']).next().unwrap_or(name).to_owned();
        Ok(Self { name, density, camera, truth: truth.image, truth_error: truth.error.rel_rmse_estimate, unit })
    }

    /// One line for the page.
    pub fn described(&self) -> String {
        let [x, y, z] = self.density.volume().grid().dims();
        let report = self.density.report();
        format!(
            "{}, {x}x{y}x{z} {:?}, {:.1} % of the voxels not 0; truth good to {:.3} %",
            self.name,
            self.density.volume().voxel_type(),
            100.0 * report.positive as f64 / report.voxels as f64,
            100.0 * self.truth_error
        )
    }
}
