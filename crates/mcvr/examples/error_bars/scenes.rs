//! What is looked at.

use std::path::Path;

use mcvr::Scenery;
use mcvr::scene::{Camera, DensityMap, Extent, View};
use mcvr::volume::{self, RawOptions, Volume, VoxelType};

use crate::{Options, Outcome};

/// Full angle of the small images: the lobster fills them.
pub const FOV: f64 = 18.0;
/// Full angle at which no pixel sees past the lobster's disc: all pixels have samples.
pub const INSIDE: f64 = 8.0;
const FILE: &str = "lobster_301x324x56_uint8.raw.gz";

/// A volume under the name that the tables give it.
pub struct Scene {
    pub name: &'static str,
    pub volume: Volume,
}

/// The phantom that anyone can make.
fn phantom() -> Outcome<Scene> {
    Ok(Scene { name: "phantom", volume: volume::load("phantom:lobster@64", None)?.volume })
}

/// The scan of the lobster, if there is a folder of scans.
fn scan(data: Option<&Path>) -> Outcome<Option<Scene>> {
    let Some(data) = data else {
        eprintln!("without --data: the lobster scan is left out");
        return Ok(None);
    };
    let options = RawOptions {
        dims: Some([301, 324, 56]),
        voxel_type: Some(VoxelType::U8),
        spacing: Some([1.0, 1.0, 1.4]),
        ..RawOptions::default()
    };
    let volume = volume::load(&data.join(FILE).to_string_lossy(), Some(&options))?.volume;
    Ok(Some(Scene { name: "lobster", volume }))
}

/// The phantom, and the scan where there is one.
pub fn both(options: &Options) -> Outcome<Vec<Scene>> {
    Ok([Some(phantom()?), scan(options.data.as_deref())?].into_iter().flatten().collect())
}

/// The scan, or else the phantom.
pub fn one(options: &Options) -> Outcome<Scene> {
    scan(options.data.as_deref())?.map_or_else(phantom, Ok)
}

impl Scene {
    /// A square image from 30 degrees around and 60 above.
    pub fn scenery(&self, side: usize, fov: Option<f64>) -> Outcome<Scenery> {
        let view = View { azimuth: 30.0, elevation: 60.0, fov, ..View::default() };
        let camera = Camera::look(&view, self.volume.grid(), Extent::new(side, side)?)?;
        Ok(Scenery::new(self.volume.clone(), DensityMap::default(), camera))
    }
}
