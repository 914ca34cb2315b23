//! Generated volumes: models that look like scans, and fields with closed forms for tests.
//!
//! Every phantom is isotropic with a spacing of `256 mm / max(dims)`, so that its physical size does not depend on
//! its resolution, and its middle lies at the world's origin. Shapes are given in *unit coordinates*: each axis runs
//! over [-1, 1] from border to border of the grid (not from first to last voxel centre), x to the right, y up in
//! the plane, z through the slices. The same specification gives the same voxels, bit for bit, on any number of threads.

mod closed;
mod ellipsoid;
mod lobster;
mod parts;
mod vessels;

use glam::DVec3;
use rayon::prelude::*;

pub use ellipsoid::Ellipsoid;

use crate::{Grid, Volume, VolumeError, checked_voxel_count};

/// Physical length (mm) of a phantom's longest side.
const SIDE_MM: f64 = 256.0;
/// Voxels per axis when the specification gives no size.
const DEFAULT_SIZE: usize = 128;
/// Most voxels of a phantom.
const MAX_VOXELS: usize = 1 << 32;

/// Which phantom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    SheppLogan,
    Lobster,
    Vessels,
    MarschnerLobb,
    Box,
    Ramp,
    Voxel,
    Gaussian,
    Ellipsoids,
}

const CATALOGUE: [(Kind, &str, &str); 9] = [
    (Kind::SheppLogan, "shepp-logan", "modified 3-D Shepp-Logan head, u16, 1.0 stored as 10000"),
    (Kind::Lobster, "lobster", "lobster in a faint non-zero disc, after the classic CT scan, u8"),
    (Kind::Vessels, "vessels", "branching tree of thin tubes, about 99 % zeros, u8"),
    (Kind::MarschnerLobb, "marschner-lobb", "Marschner-Lobb test signal near the Nyquist limit, u8"),
    (Kind::Box, "box", "uniform 100, u8"),
    (Kind::Ramp, "ramp", "isovalue = x index, u16"),
    (Kind::Voxel, "voxel", "single voxel of 255 in the middle, u8"),
    (Kind::Gaussian, "gaussian", "exp(-r^2 / 2 s^2), s = a tenth of each side, f32"),
    (Kind::Ellipsoids, "ellipsoids", "three ellipsoids with closed-form line integrals, f32"),
];

/// A phantom of a given size, not yet generated.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Phantom {
    kind: Kind,
    dims: [usize; 3],
}

impl Phantom {
    /// Parses `NAME`, `NAME@256` or `NAME@301x324x56`; 128 cubed when no size is given.
    ///
    /// # Errors
    /// [`VolumeError::Phantom`] when the name is unknown (with the nearest ones) or the size unusable.
    pub fn parse(spec: &str) -> Result<Self, VolumeError> {
        let fail = |problem: String| VolumeError::Phantom { spec: spec.to_string(), problem };
        let text = spec.strip_prefix("phantom:").unwrap_or(spec);
        let (name, size) = text.split_once('@').map_or((text, None), |(name, size)| (name, Some(size)));
        let kind = CATALOGUE.iter().find(|c| c.1 == name).map(|c| c.0).ok_or_else(|| fail(unknown_name(name)))?;
        let dims = match size {
            None => [DEFAULT_SIZE; 3],
            Some(size) => parse_size(size)
                .ok_or_else(|| fail(format!("size '{size}' is not understood; give '@128' or '@301x324x56'")))?,
        };
        let count = checked_voxel_count(dims).map_err(|e| fail(e.to_string()))?;
        if count > MAX_VOXELS {
            return Err(fail(format!("{count} voxels exceed the limit of 2^32 for phantoms")));
        }
        if kind == Kind::Ramp && dims[0] > 1 << 16 {
            return Err(fail(format!("{} voxels along x exceed the 65536 values of u16", dims[0])));
        }
        Ok(Self { kind, dims })
    }

    /// Name and one-line description of every phantom, for help texts.
    pub fn names() -> impl Iterator<Item = (&'static str, &'static str)> {
        CATALOGUE.iter().map(|c| (c.1, c.2))
    }

    /// The phantom's name.
    pub fn name(&self) -> &'static str {
        CATALOGUE.iter().find(|c| c.0 == self.kind).map_or("phantom", |c| c.1)
    }

    /// Number of voxels along (x, y, z).
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// The grid: `256 / max(dims)` mm per voxel, its middle at the world's origin, axes along the world's.
    ///
    /// # Errors
    /// None for a parsed phantom.
    pub fn grid(&self) -> Result<Grid, VolumeError> {
        let longest = self.dims.iter().copied().max().unwrap_or(1) as f64;
        let spacing = DVec3::splat(SIDE_MM / longest);
        let middle = (DVec3::from_array(self.dims.map(|n| n as f64)) - 1.0) * 0.5 * spacing;
        Grid::new(self.dims, spacing, -middle, glam::DMat3::IDENTITY)
    }

    /// The ellipsoids (world millimetres, amplitudes in isovalues) of which `shepp-logan` and `ellipsoids` are
    /// the sum, for closed-form line integrals; `None` for the other phantoms.
    pub fn ellipsoids(&self) -> Option<Vec<Ellipsoid>> {
        let table = match self.kind {
            Kind::SheppLogan => ellipsoid::shepp_logan(),
            Kind::Ellipsoids => ellipsoid::three_ellipsoids(),
            _ => return None,
        };
        let longest = self.dims.iter().copied().max().unwrap_or(1) as f64;
        let half = DVec3::from_array(self.dims.map(|n| SIDE_MM / 2.0 * n as f64 / longest));
        Some(table.into_iter().map(|e| e.scaled(half)).collect())
    }

    /// Generates the voxels, slices in parallel.
    ///
    /// # Errors
    /// [`VolumeError::Phantom`] when there is no memory for them.
    pub fn generate(&self) -> Result<Volume, VolumeError> {
        let grid = self.grid()?;
        let [x, y, z] = self.dims;
        let name = format!("phantom:{}@{x}x{y}x{z}", self.name());
        match self.kind {
            Kind::SheppLogan => {
                let table = ellipsoid::shepp_logan();
                let voxels = self.fill(|k, slice| {
                    ellipsoid::fill_slice(&table, self.dims, k, slice, |v| v.round().clamp(0.0, 65535.0) as u16)
                })?;
                Volume::from_vec(grid, voxels, name)
            }
            Kind::Ellipsoids => {
                let table = ellipsoid::three_ellipsoids();
                let voxels = self.fill(|k, slice| ellipsoid::fill_slice(&table, self.dims, k, slice, |v| v as f32))?;
                Volume::from_vec(grid, voxels, name)
            }
            Kind::Lobster => {
                let lobster = lobster::Lobster::new(self.dims);
                Volume::from_vec(grid, self.fill(|k, slice| lobster.fill_slice(k, slice))?, name)
            }
            Kind::Vessels => {
                let tree = vessels::Vessels::new(self.dims);
                Volume::from_vec(grid, self.fill(|k, slice| tree.fill_slice(k, slice))?, name)
            }
            Kind::MarschnerLobb => {
                let voxels = self.fill(|k, slice| closed::marschner_lobb(self.dims, k, slice))?;
                Volume::from_vec(grid, voxels, name)
            }
            Kind::Gaussian => {
                let voxels = self.fill(|k, slice| closed::gaussian(self.dims, k, slice))?;
                Volume::from_vec(grid, voxels, name)
            }
            Kind::Box => Volume::from_vec(grid, self.fill(|_, slice: &mut [u8]| slice.fill(closed::BOX_VALUE))?, name),
            Kind::Ramp => {
                let voxels = self.fill(|_, slice: &mut [u16]| closed::ramp(self.dims, slice))?;
                Volume::from_vec(grid, voxels, name)
            }
            Kind::Voxel => {
                let voxels = self.fill(|k, slice: &mut [u8]| closed::single_voxel(self.dims, k, slice))?;
                Volume::from_vec(grid, voxels, name)
            }
        }
    }

    /// A vector of all voxels, each slice filled by `f(k, slice)`.
    fn fill<T: bytemuck::Zeroable + Clone + Send>(
        &self,
        f: impl Fn(usize, &mut [T]) + Sync,
    ) -> Result<Vec<T>, VolumeError> {
        let count = checked_voxel_count(self.dims)?;
        let mut voxels: Vec<T> = Vec::new();
        voxels.try_reserve_exact(count).map_err(|_| VolumeError::Phantom {
            spec: self.name().to_string(),
            problem: format!("no memory for {count} voxels of {} bytes", size_of::<T>()),
        })?;
        voxels.resize(count, T::zeroed());
        voxels.par_chunks_mut(self.dims[0] * self.dims[1]).enumerate().for_each(|(k, slice)| f(k, slice));
        Ok(voxels)
    }
}

impl std::fmt::Display for Phantom {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.dims;
        write!(f, "phantom:{}@{x}x{y}x{z}", self.name())
    }
}

/// Unit coordinate of the centre of voxel `i` of `n`.
fn unit(i: usize, n: usize) -> f64 {
    (2 * i + 1) as f64 / n as f64 - 1.0
}

fn parse_size(size: &str) -> Option<[usize; 3]> {
    let digits = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
    let parts: Vec<usize> =
        size.split('x').map(|p| if digits(p) { p.parse().ok() } else { None }).collect::<Option<_>>()?;
    match parts[..] {
        [n] => Some([n; 3]),
        [x, y, z] => Some([x, y, z]),
        _ => None,
    }
}

fn unknown_name(name: &str) -> String {
    let mut nearest: Vec<(usize, &str)> = CATALOGUE.iter().map(|c| (edit_distance(name, c.1), c.1)).collect();
    nearest.sort();
    let close: Vec<&str> = nearest.iter().filter(|n| n.0 <= 3).map(|n| n.1).take(2).collect();
    let all: Vec<&str> = CATALOGUE.iter().map(|c| c.1).collect();
    match close[..] {
        [] => format!("unknown name '{name}'; one of {}", all.join(", ")),
        _ => format!("unknown name '{name}'; did you mean {}? All names: {}", close.join(" or "), all.join(", ")),
    }
}

/// Levenshtein distance, of at most 64 characters.
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().take(64).collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().take(64).enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, &cb) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(ca != cb);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}
