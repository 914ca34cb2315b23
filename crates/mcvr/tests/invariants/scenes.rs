//! Random small scenes.

use glam::{DMat3, DQuat, DVec3, EulerRot};
use mcvr::Method;
use mcvr::sampling::{Distribution, PointStream, RenderOptions, Rendered, VoxelOrder, render};
use mcvr::scene::{Camera, Density, DensityMap, Estimand, Extent, Kernel, View, Watch};
use mcvr::volume::{Grid, Volume};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::common::{SAMPLERS, noise, stream};

/// `cases` cases (or `PROPTEST_CASES`), the same ones in every run (or those of another `PROPTEST_RNG_SEED`).
pub fn config(cases: u32) -> ProptestConfig {
    let chosen = ProptestConfig::default();
    let cases = if std::env::var_os("PROPTEST_CASES").is_some() { chosen.cases } else { cases };
    let rng_seed = match chosen.rng_seed {
        RngSeed::Random => RngSeed::Fixed(20_261_122),
        fixed => fixed,
    };
    ProptestConfig { cases, rng_seed, failure_persistence: None, ..chosen }
}

/// Voxel types, each with weights that take another way through the distribution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stored {
    U8,
    /// Partly negative: clamped.
    I16,
    U16,
    F32,
    /// Over 12 decades.
    F64,
}

impl Stored {
    /// True for weights that are drawn as the integers they are.
    pub fn is_whole(self) -> bool {
        matches!(self, Self::U8 | Self::I16 | Self::U16)
    }
}

/// A scan: grid and voxels.
#[derive(Clone, Debug)]
pub struct Scan {
    pub dims: [usize; 3],
    pub spacing: [f64; 3],
    pub turn: [f64; 3],
    pub mirrored: bool,
    pub origin: [f64; 3],
    pub stored: Stored,
    /// Of 256 voxels, about so many are 0.
    pub zeros: u8,
    pub seed: u64,
}

impl Scan {
    pub fn grid(&self) -> Grid {
        let [a, b, c] = self.turn;
        let turn = DMat3::from_quat(DQuat::from_euler(EulerRot::XYZ, a, b, c));
        let mirror = DMat3::from_diagonal(DVec3::new(1.0, if self.mirrored { -1.0 } else { 1.0 }, 1.0));
        Grid::new(self.dims, self.spacing.into(), self.origin.into(), turn * mirror).unwrap()
    }

    /// Stored values, at least one of them positive.
    pub fn values(&self) -> Vec<f64> {
        let n = self.dims.iter().product();
        let mut bytes = noise(n, self.seed);
        bytes.iter_mut().for_each(|b| *b = b.saturating_sub(self.zeros));
        bytes[(self.seed % n as u64) as usize] = 255;
        let value = |b: u8| match self.stored {
            Stored::U8 => f64::from(b),
            Stored::I16 => f64::from(b) * 100.0 - 3000.0,
            Stored::U16 => f64::from(b) * 257.0,
            Stored::F32 => f64::from(f32::from(b).sqrt()),
            Stored::F64 => f64::from(b) * 2f64.powi(i32::from(b % 41) - 20),
        };
        bytes.into_iter().map(value).collect()
    }

    /// These values on a grid, in the scan's type.
    pub fn store(&self, grid: Grid, values: &[f64]) -> Volume {
        let name = "random";
        match self.stored {
            Stored::U8 => Volume::from_vec(grid, values.iter().map(|v| *v as u8).collect(), name),
            Stored::I16 => Volume::from_vec(grid, values.iter().map(|v| *v as i16).collect(), name),
            Stored::U16 => Volume::from_vec(grid, values.iter().map(|v| *v as u16).collect(), name),
            Stored::F32 => Volume::from_vec(grid, values.iter().map(|v| *v as f32).collect(), name),
            Stored::F64 => Volume::from_vec(grid, values.to_vec(), name),
        }
        .unwrap()
    }

    pub fn density(&self) -> Density {
        density_of(&self.store(self.grid(), &self.values()))
    }
}

/// The density of a volume under the identity map.
pub fn density_of(volume: &Volume) -> Density {
    Density::new(volume, DensityMap::default()).unwrap()
}

/// A camera by angles; distances in diameters of the grid.
#[derive(Clone, Debug)]
pub struct Sight {
    pub azimuth: f64,
    pub elevation: f64,
    pub distance: f64,
    pub fov: Option<f64>,
    pub parallel: bool,
    pub near: f64,
    pub size: [usize; 2],
}

impl Sight {
    pub fn camera(&self, grid: &Grid) -> Camera {
        let diameter = grid.diameter();
        let view = View {
            azimuth: self.azimuth,
            elevation: self.elevation,
            distance: Some(self.distance * diameter),
            fov: self.fov,
            parallel: self.parallel,
            near: Some(self.near * diameter),
        };
        Camera::look(&view, grid, Extent::new(self.size[0], self.size[1]).unwrap()).unwrap()
    }
}

/// What is asked of the samplers.
#[derive(Clone, Debug)]
pub struct Ask {
    pub method: Method,
    pub kernel: Kernel,
    pub estimand: Estimand,
    pub order: VoxelOrder,
    pub samples: u64,
    pub seed: u64,
}

impl Ask {
    pub fn options(&self) -> RenderOptions {
        RenderOptions { estimand: self.estimand, kernel: self.kernel, ..RenderOptions::default() }
    }

    pub fn stream(&self, distribution: &Distribution) -> Box<dyn PointStream> {
        stream(self.method, self.samples, self.seed, distribution.total().max(1))
    }

    pub fn render(&self, distribution: &Distribution, camera: &Camera) -> Rendered {
        render_by(distribution, &*self.stream(distribution), camera, &self.options())
    }
}

pub fn render_by(d: &Distribution, stream: &dyn PointStream, camera: &Camera, options: &RenderOptions) -> Rendered {
    render(d, stream, camera, options, &Watch::default()).unwrap()
}

fn extent() -> impl Strategy<Value = usize> {
    prop_oneof![1 => Just(1usize), 4 => 1usize..=12]
}

/// Any scan of at most 12³ voxels, spacings from 1/32 to 32 mm.
pub fn scan() -> impl Strategy<Value = Scan> {
    let stored = prop::sample::select(vec![Stored::U8, Stored::I16, Stored::U16, Stored::F32, Stored::F64]);
    (
        [extent(), extent(), extent()],
        [-5.0..5.0f64, -5.0..5.0, -5.0..5.0],
        [-3.2..3.2f64, -3.2..3.2, -3.2..3.2],
        any::<bool>(),
        [-1e4..1e4f64, -1e4..1e4, -1e4..1e4],
        stored,
        any::<u8>(),
        any::<u64>(),
    )
        .prop_map(|(dims, h, turn, mirrored, origin, stored, zeros, seed)| Scan {
            dims,
            spacing: h.map(f64::exp2),
            turn,
            mirrored,
            origin,
            stored,
            zeros,
            seed,
        })
}

/// Any camera, as often inside the scan as outside.
pub fn sight() -> impl Strategy<Value = Sight> {
    (
        -180.0..180.0f64,
        -90.0..90.0f64,
        prop_oneof![0.02..0.5f64, 0.5..4.0f64],
        prop::option::of(1.0..150.0f64),
        any::<bool>(),
        prop_oneof![Just(1e-3), 0.05..1.5f64],
        [1usize..24, 1usize..24],
    )
        .prop_map(|(azimuth, elevation, distance, fov, parallel, near, size)| Sight {
            azimuth,
            elevation,
            distance,
            fov,
            parallel,
            near,
            size,
        })
}

/// Any request of a few blocks.
pub fn ask() -> impl Strategy<Value = Ask> {
    (
        prop::sample::select(SAMPLERS.to_vec()),
        prop::sample::select(Kernel::ALL.to_vec()),
        prop::sample::select(Estimand::ALL.to_vec()),
        prop::sample::select(VoxelOrder::ALL.map(|(_, order)| order).to_vec()),
        prop_oneof![1 => 1u64..4, 4 => 1u64..5000],
        any::<u64>(),
    )
        .prop_map(|(method, kernel, estimand, order, samples, seed)| Ask {
            method,
            kernel,
            estimand,
            order,
            samples,
            seed,
        })
}

/// Every voxel that can be drawn, in the distribution's order, with its number of targets: found by bisection of
/// [`Distribution::voxel_of`], so that nothing but what samplers use is trusted.
pub fn units(distribution: &Distribution) -> Vec<(usize, u64)> {
    let total = distribution.total();
    let (mut out, mut from) = (vec![], 0);
    while from < total {
        let voxel = distribution.voxel_of(from);
        let (mut last, mut beyond) = (from, total);
        while beyond - last > 1 {
            let middle = last + (beyond - last) / 2;
            if distribution.voxel_of(middle) == voxel { last = middle } else { beyond = middle }
        }
        out.push((voxel, beyond - from));
        from = beyond;
    }
    // Bisection took it that a voxel's targets follow each other: then none turns up twice.
    let mut seen: Vec<usize> = out.iter().map(|u| u.0).collect();
    seen.sort_unstable();
    assert!(seen.windows(2).all(|w| w[0] < w[1]), "a voxel's targets are apart");
    out
}
