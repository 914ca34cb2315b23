//! The scenes of the stages: phantoms made in memory, small so that a run of all stages takes seconds.

use std::sync::OnceLock;

use mcvr_scene::effects::{DepthColour, DepthCue, Light, LightPosition, Material, Shading, Sides, Unlisted};
use mcvr_scene::{Camera, Density, DensityMap, Effects, Extent, View};
use mcvr_volume::Volume;

use super::BenchError;

/// A volume under a density map, seen by a camera.
pub(super) struct Scene {
    pub volume: Volume,
    pub density: Density,
    pub camera: Camera,
}

impl Scene {
    fn new(phantom: &str, view: &View, [width, height]: [usize; 2]) -> Result<Self, BenchError> {
        let volume = mcvr_volume::load(phantom, None)?.volume;
        let camera = Camera::look(view, volume.grid(), Extent::new(width, height)?)?;
        let density = Density::new(&volume, DensityMap::default())?;
        Ok(Self { volume, density, camera })
    }
}

/// Most voxels empty, as in a scan: what the sampling stages and the march look at.
pub(super) fn lobster() -> Result<&'static Scene, BenchError> {
    static SCENE: OnceLock<Result<Scene, String>> = OnceLock::new();
    let view = View { azimuth: 30.0, elevation: 60.0, ..View::default() };
    kept(&SCENE, || Scene::new("phantom:lobster@64", &view, [200, 200]))
}

/// No voxel empty, so that the ray caster skips nothing.
pub(super) fn dense() -> Result<&'static Scene, BenchError> {
    static SCENE: OnceLock<Result<Scene, String>> = OnceLock::new();
    kept(&SCENE, || Scene::new("phantom:marschner-lobb@48", &View::default(), [32, 32]))
}

fn kept(
    cell: &'static OnceLock<Result<Scene, String>>,
    make: impl FnOnce() -> Result<Scene, BenchError>,
) -> Result<&'static Scene, BenchError> {
    cell.get_or_init(|| make().map_err(|e| e.to_string())).as_ref().map_err(|e| BenchError::Setup(e.clone()))
}

/// Every effect alone, by name, then all together.
pub(super) fn effects() -> Result<Vec<(&'static str, Effects)>, BenchError> {
    let light = Light {
        position: LightPosition::Around { azimuth: 80.0, elevation: 60.0, distance: Some(300.0) },
        ..Light::default()
    };
    let shading = Some(Shading { sides: Sides::One });
    let depth_cue = Some(DepthCue { minimum: Some(50.0) });
    let depth_colour = Some(DepthColour::default());
    let materials =
        vec![material("meat", 0.0, Some(110.0), "#ffffff", 1.0)?, material("shell", 110.0, None, "#ff6a00", 2.0)?];
    let unlisted = Some(Unlisted::default());
    Ok(vec![
        ("shading", Effects { light, shading, ..Effects::default() }),
        ("depth-cue", Effects { light, depth_cue, ..Effects::default() }),
        ("materials", Effects { materials: materials.clone(), unlisted, ..Effects::default() }),
        ("depth-colour", Effects { depth_colour: depth_colour.clone(), ..Effects::default() }),
        ("all", Effects { light, shading, depth_cue, depth_colour, materials, unlisted }),
    ])
}

fn material(name: &str, from: f64, to: Option<f64>, colour: &str, weight: f64) -> Result<Material, BenchError> {
    let colour = colour.parse().map_err(|e| BenchError::Setup(format!("colour {colour}: {e}")))?;
    Ok(Material { name: Some(name.into()), from: Some(from), to, colour, weight })
}
