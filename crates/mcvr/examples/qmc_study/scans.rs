//! The scans and the views.

use std::path::Path;

use mcvr::sampling::{Distribution, VoxelOrder};
use mcvr::scene::{Camera, Density, DensityMap, Extent, Hounsfield, Kernel, Transfer, View};
use mcvr::volume::{self, Endian, RawOptions, VoxelType};

use crate::Outcome;

/// Pixels of a side of the images.
const SIDE: usize = 400;
/// The same of a quick run.
const QUICK_SIDE: usize = 64;
/// Photons of the chest's attenuations, keV.
const KEV: f64 = 60.0;

/// Name, azimuth and elevation in degrees.
pub type NamedView = (&'static str, [f64; 2]);
/// Near an axis, not on it, and far from all.
pub const VIEWS: [&str; 2] = ["near-axis", "oblique"];

pub struct Scan {
    pub name: &'static str,
    pub file: &'static str,
    raw: Option<([usize; 3], VoxelType, Endian, [f64; 3])>,
    hounsfield: bool,
    pub views: [NamedView; 2],
}

const fn scan(
    name: &'static str,
    file: &'static str,
    raw: Option<([usize; 3], VoxelType, Endian, [f64; 3])>,
    oblique: [f64; 2],
) -> Scan {
    Scan { name, file, raw, hounsfield: false, views: [(VIEWS[0], [85.0, 5.0]), (VIEWS[1], oblique)] }
}

/// Six scans: soft and hard, thin and thick, of 8 and 16 bits, of equal and of unequal spacings.
pub fn all(quick: bool) -> Vec<Scan> {
    use Endian::{Big, Little};
    use VoxelType::{I16, U8, U16};
    if quick {
        return vec![scan("phantom", "phantom:lobster@64", None, [30.0, 20.0])];
    }
    let usual = [30.0, 20.0];
    let chest = Some(([256, 256, 137], I16, Little, [1.5625, 1.5625, 2.0]));
    vec![
        scan(
            "lobster",
            "lobster_301x324x56_uint8.raw.gz",
            Some(([301, 324, 56], U8, Little, [1.0, 1.0, 1.4])),
            [30.0, 60.0],
        ),
        scan("cthead", "cthead_256x256x113_uint16be.raw.gz", Some(([256, 256, 113], U16, Big, [1.0, 1.0, 2.0])), usual),
        scan("aneurism", "aneurism_256x256x256_uint8.raw.gz", Some(([256; 3], U8, Little, [1.0; 3])), usual),
        Scan { hounsfield: true, ..scan("chest", "chest_ct_hu_256x256x137_int16le.raw.gz", chest, usual) },
        scan(
            "statue leg",
            "statue_leg_341x341x93_uint8.raw.gz",
            Some(([341, 341, 93], U8, Little, [1.0, 1.0, 4.0])),
            usual,
        ),
        scan("stent", "stent_128x128x256_int16le.raw.gz", Some(([128, 128, 256], I16, Little, [1.0; 3])), usual),
    ]
}

impl Scan {
    /// `None` when the file is not there.
    pub fn load(&self, data: &Path) -> Outcome<Option<Density>> {
        let transfer = if self.hounsfield {
            Transfer::Hounsfield(Hounsfield::at_energy(KEV, Hounsfield::SCAN_KEV)?)
        } else {
            Transfer::default()
        };
        let map = DensityMap { transfer, ..DensityMap::default() };
        let Some((dims, voxel_type, endian, spacing)) = self.raw else {
            return Ok(Some(Density::new(&volume::load(self.file, None)?.volume, map)?));
        };
        let path = data.join(self.file);
        if !path.exists() {
            return Ok(None);
        }
        let options = RawOptions {
            dims: Some(dims),
            voxel_type: Some(voxel_type),
            endian: Some(endian),
            spacing: Some(spacing),
            ..RawOptions::default()
        };
        Ok(Some(Density::new(&volume::load(&path.to_string_lossy(), Some(&options))?.volume, map)?))
    }

    /// What a reader should know of it.
    pub fn described(&self, density: &Density) -> String {
        let grid = density.volume().grid();
        let [x, y, z] = grid.dims();
        let h = grid.spacing();
        let map = if self.hounsfield { format!(", Hounsfield units at {KEV} keV") } else { String::new() };
        format!("{x}×{y}×{z}, spacing {}, {}, {}{map}", h.x, h.y, h.z)
    }
}

/// A scan from a view, with the distributions of all orders.
pub struct Scene<'a> {
    pub scan: &'a Scan,
    pub view: NamedView,
    pub density: &'a Density,
    pub camera: Camera,
    /// The order along the axis nearest to the view.
    pub depth: VoxelOrder,
    distributions: Vec<(VoxelOrder, Distribution<'a>, f64)>,
}

impl<'a> Scene<'a> {
    pub fn new(scan: &'a Scan, view: &NamedView, density: &'a Density, quick: bool) -> Outcome<Self> {
        let side = if quick { QUICK_SIDE } else { SIDE };
        let [azimuth, elevation] = view.1;
        let grid = density.volume().grid();
        let camera = Camera::look(&View { azimuth, elevation, ..View::default() }, grid, Extent::new(side, side)?)?;
        let mut distributions = vec![];
        for (_, order) in VoxelOrder::ALL.into_iter().filter(|(_, o)| *o != VoxelOrder::Depth) {
            let start = std::time::Instant::now();
            let distribution = Distribution::in_view(density, order, &camera, Kernel::Tent)?;
            distributions.push((order, distribution, start.elapsed().as_secs_f64()));
        }
        let depth = VoxelOrder::Depth.resolve(&camera, grid);
        Ok(Self { scan, view: *view, density, camera, depth, distributions })
    }

    /// The distribution of an order, and the seconds that it took.
    pub fn distribution(&self, order: VoxelOrder) -> Outcome<(&Distribution<'a>, f64)> {
        let order = if order == VoxelOrder::Depth { self.depth } else { order };
        let found = self.distributions.iter().find(|d| d.0 == order).ok_or("an order without a distribution")?;
        Ok((&found.1, found.2))
    }

    /// Axis that the default order has innermost.
    pub fn depth_axis(&self) -> &'static str {
        match self.depth {
            VoxelOrder::YInnermost => "y",
            VoxelOrder::ZInnermost => "z",
            _ => "x",
        }
    }

    pub fn label(&self) -> String {
        format!("{}, {}", self.scan.name, self.view.0)
    }
}
