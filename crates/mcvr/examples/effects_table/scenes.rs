//! The scans, the views and the effects.

use std::path::Path;

use mcvr::scene::effects::{DepthColour, DepthCue, Light, LightPosition, Material, Shading, Sides, Unlisted};
use mcvr::scene::{Camera, DensityMap, Effects, Emphasis, Extent, Transfer, View};
use mcvr::volume::{self, Endian, RawOptions, Volume, VoxelType};
use mcvr::{Scenery, scene};

use crate::Outcome;

/// The density map of the table: the resin around the lobster (isovalues below 50) weighs nothing, as in `examples/shaded.toml`.
pub const NO_RESIN: [[f64; 2]; 3] = [[50.0, 0.0], [70.0, 70.0], [255.0, 255.0]];
/// Degrees around and above the lobster.
pub const VIEW: [f64; 2] = [30.0, 60.0];
/// Full angle of the table's images: the lobster fills them.
pub const FOV: f64 = 18.0;

pub struct Scan {
    pub file: &'static str,
    dims: [usize; 3],
    voxel_type: VoxelType,
    endian: Endian,
    spacing: [f64; 3],
}

pub const LOBSTER: Scan = Scan {
    file: "lobster_301x324x56_uint8.raw.gz",
    dims: [301, 324, 56],
    voxel_type: VoxelType::U8,
    endian: Endian::Little,
    spacing: [1.0, 1.0, 1.4],
};

pub const HEAD: Scan = Scan {
    file: "cthead_256x256x113_uint16be.raw.gz",
    dims: [256, 256, 113],
    voxel_type: VoxelType::U16,
    endian: Endian::Big,
    spacing: [1.0, 1.0, 2.0],
};

impl Scan {
    pub fn load(&self, data: &Path) -> Outcome<Volume> {
        let options = RawOptions {
            dims: Some(self.dims),
            voxel_type: Some(self.voxel_type),
            endian: Some(self.endian),
            spacing: Some(self.spacing),
            ..RawOptions::default()
        };
        Ok(volume::load(&data.join(self.file).to_string_lossy(), Some(&options))?.volume)
    }

    /// The options of the `mcvr` program that say the same.
    pub fn arguments(&self) -> [String; 4] {
        let endian = if self.endian == Endian::Big { "be" } else { "le" };
        let spacing = self.spacing.map(|s| s.to_string()).join(",");
        ["--endian".into(), endian.into(), "--spacing".into(), spacing]
    }
}

/// One line of the table.
pub struct Effect {
    pub name: &'static str,
    pub effects: Effects,
    pub emphasis: Option<Emphasis>,
}

pub fn around(azimuth: f64, elevation: f64, distance: Option<f64>) -> Light {
    Light { position: LightPosition::Around { azimuth, elevation, distance }, ..Light::default() }
}

pub fn material(name: &str, from: f64, to: Option<f64>, colour: &str, weight: f64) -> Outcome<Material> {
    Ok(Material { name: Some(name.into()), from: Some(from), to, colour: colour.parse()?, weight })
}

/// Every effect alone, the report's pair, and all together.
pub fn effects() -> Outcome<Vec<Effect>> {
    let light = around(80.0, 60.0, Some(300.0));
    let emphasis = Some(Emphasis { threshold: 110.0, gain: 4.0 });
    let cue = Some(DepthCue { minimum: Some(50.0) });
    let shaded = |sides| Effects { light, shading: Some(Shading { sides }), ..Effects::default() };
    let materials = Effects {
        materials: vec![
            material("meat", 50.0, Some(110.0), "#ffffff", 1.0)?,
            material("shell", 110.0, None, "#ff6a00", 2.0)?,
        ],
        unlisted: Some(Unlisted::default()),
        ..Effects::default()
    };
    let depth_colour = Some(DepthColour::default());
    let pair = Effects { depth_cue: cue, ..shaded(Sides::One) };
    let all = Effects {
        depth_colour: depth_colour.clone(),
        shading: pair.shading,
        depth_cue: cue,
        light,
        ..materials.clone()
    };
    let plain = |name, effects| Effect { name, effects, emphasis: None };
    Ok(vec![
        plain("plain", Effects::default()),
        plain("shading, one-sided", shaded(Sides::One)),
        plain("shading, two-sided", shaded(Sides::Two)),
        plain("depth cue", Effects { light, depth_cue: cue, ..Effects::default() }),
        plain("shading + depth cue", pair),
        plain("materials", materials),
        plain("depth colour", Effects { depth_colour, ..Effects::default() }),
        Effect { name: "emphasis", effects: Effects::default(), emphasis },
        Effect { name: "all together", effects: all, emphasis },
    ])
}

pub fn camera(volume: &Volume, view: [f64; 2], fov: Option<f64>, side: usize) -> Outcome<Camera> {
    let view = View { azimuth: view[0], elevation: view[1], fov, ..View::default() };
    Ok(Camera::look(&view, volume.grid(), Extent::new(side, side)?)?)
}

pub fn piecewise(points: &[[f64; 2]], emphasis: Option<Emphasis>) -> DensityMap {
    DensityMap { transfer: Transfer::Piecewise(points.to_vec()), emphasis, ..DensityMap::default() }
}

/// The table's scene with one effect.
pub fn scenery(volume: &Volume, effect: &Effect, side: usize) -> Outcome<Scenery> {
    let camera = camera(volume, VIEW, Some(FOV), side)?;
    let map = piecewise(&NO_RESIN, effect.emphasis);
    Ok(Scenery::new(volume.clone(), map, camera).with_effects(effect.effects.clone()))
}

/// Largest factor that a sample of the scenery can carry, its colour included.
pub fn largest_factor(scenery: &Scenery, kernel: scene::Kernel) -> Outcome<f64> {
    let grid = scenery.volume.grid();
    let look = scenery.effects.look(grid, &scenery.camera)?;
    Ok(look.largest_cue(grid, kernel) * look.tint.into_iter().fold(0.0, f64::max))
}

/// Kernels that ray casting knows.
pub const KERNELS: [scene::Kernel; 3] = [scene::Kernel::Tent, scene::Kernel::Box, scene::Kernel::Bspline3];
/// Methods of the table.
pub const METHODS: [mcvr::Method; 3] = [mcvr::Method::Mc, mcvr::Method::Stratified, mcvr::Method::Qmc];
