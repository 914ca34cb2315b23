//! What each reconstruction kernel does to thin structures: their contrast and width against a fine reference.
//!
//! `cargo run --release -p mcvr --example thin_structures -- --data DIR --out DIR` writes `thin-structures.md`, `.csv`, `.json`
//! and pictures. DIR holds the scans of README's "Real scans"; those that are missing are left out and named.
#![allow(missing_docs, reason = "a program, not a library")]

mod kernels;
mod pictures;
mod report;
mod ridges;
mod tubes;

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::DVec3;
use mcvr::harness::Comparison;
use mcvr::raycast::{ReferenceOptions, reference};
use mcvr::scene::{Camera, Density, DensityMap, Estimand, Extent, Image, Kernel, View, Watch};
use mcvr::volume::{self, Endian, Grid, RawOptions, Volume, VoxelType};
use mcvr::{Method, Request, Scenery, make};

use kernels::{Candidate, candidates, concentrated, splat};
use report::Row;
use ridges::{Measure, Section, measure};

/// Any failure.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Error of the exact images that is asked for, as a share of the mean pixel. The mean of a sparse image lies far below
/// its structures, so this is finer than it sounds.
const TOLERANCE: f64 = 1e-2;
/// How often a pixel's side may be halved: 9×9 rays at most, a pixel being at most half a voxel wide.
const MAX_DEPTH: u32 = 1;
/// Pixels per fine voxel (its smallest spacing).
const PIXELS_PER_VOXEL: f64 = 2.0;

/// A volume with 32-bit weights.
pub struct Weights {
    pub grid: Grid,
    pub values: Vec<f32>,
}

impl Weights {
    /// The volume, cut to even extents so that a copy at half its resolution has the same mass.
    fn of(volume: &Volume) -> Outcome<Self> {
        let from = volume.grid();
        let dims = from.dims().map(|n| n & !1);
        let grid = Grid::new(dims, from.spacing(), from.origin(), from.direction())?;
        let values = (0..grid.len()).map(|n| volume.isovalue(from.linear(grid.unravel(n))).max(0.0) as f32);
        Ok(Self { values: values.collect(), grid })
    }

    /// Means of 2×2×2 voxels.
    fn halved(&self) -> Outcome<Self> {
        let from = &self.grid;
        let dims = from.dims().map(|n| n / 2);
        let origin = from.index_to_world().transform_point3(DVec3::splat(0.5));
        let grid = Grid::new(dims, from.spacing() * 2.0, origin, from.direction())?;
        let mean = |n: usize| {
            let [i, j, k] = grid.unravel(n).map(|v| 2 * v);
            let at = |c: usize| self.values[from.linear([i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)])];
            (0..8).map(|c| f64::from(at(c))).sum::<f64>() as f32 / 8.0
        };
        let values = (0..grid.len()).map(mean).collect();
        Ok(Self { values, grid })
    }

    pub fn volume(&self) -> Outcome<Volume> {
        Ok(Volume::from_vec(self.grid.clone(), self.values.clone(), "weights")?)
    }
}

/// An image under a kernel and how it was made.
pub struct Shown {
    pub image: Image,
    /// The ray caster's estimate of its error, over the mean; `None` for a footprint image.
    pub cast: Option<f64>,
    /// How far the footprint image lies from the ray-cast one, where both exist: [`distance`].
    pub check: Option<f64>,
}

/// Root mean square of the difference over that of `b`: unlike the RMSE over the mean, it says the same of a
/// structure however much empty image surrounds it.
pub fn distance(a: &Image, b: &Image) -> f64 {
    let square: f64 = a.values().iter().zip(b.values()).map(|(a, b)| (a - b).powi(2)).sum();
    (square / b.values().iter().map(|b| b * b).sum::<f64>()).sqrt()
}

/// Root mean square of the difference over the mean of `b`.
pub fn rmse(a: &Image, b: &Image) -> Outcome<f64> {
    Ok(Comparison::of(a, b)?.rel_rmse.unwrap_or(f64::NAN))
}

/// The ray-cast image under one of the library's kernels, and its error by its own estimate.
pub fn exact(weights: &Weights, kernel: Kernel, camera: &Camera) -> Outcome<(Image, f64)> {
    let density = Density::new(&weights.volume()?, DensityMap::default())?;
    let options = ReferenceOptions { kernel, estimand: Estimand::Line, tolerance: TOLERANCE, max_depth: MAX_DEPTH };
    let made = reference(&density, camera, &options, &Watch::default())?;
    Ok((made.image, made.error.rel_rmse_estimate))
}

/// The image under any kernel by its footprint.
fn splatted(weights: &Weights, candidate: &Candidate, camera: &Camera) -> Image {
    let moved = concentrated(&weights.values, weights.grid.dims(), candidate.concentrate);
    splat(candidate, &moved, &weights.grid, camera)
}

/// The image under any kernel: ray cast if the library can, by its footprint otherwise.
pub fn shown(weights: &Weights, candidate: &Candidate, camera: &Camera) -> Outcome<Shown> {
    let image = splatted(weights, candidate, camera);
    match candidate.library {
        Some(kernel) if kernel != Kernel::Shell => {
            let (cast, error) = exact(weights, kernel, camera)?;
            let check = Some(distance(&image, &cast));
            Ok(Shown { image: cast, cast: Some(error), check })
        }
        _ => Ok(Shown { image, cast: None, check: None }),
    }
}

/// A parallel camera that looks from `view`'s angles, `scale` pixels per mm, its image just around the grid.
pub fn parallel(view: View, grid: &Grid, scale: f64) -> Outcome<Camera> {
    let look = Camera::look(&View { parallel: true, ..view }, grid, Extent::new(64, 64)?)?;
    let mut m = look.world_to_pixel();
    let before = DVec3::new(m[0][0], m[0][1], m[0][2]).length();
    m[..2].iter_mut().flatten().for_each(|v| *v *= scale / before);
    let corners = grid.corners(2.5).map(|c| {
        let at = |r: usize| m[r][0] * c.x + m[r][1] * c.y + m[r][2] * c.z + m[r][3];
        [at(0), at(1)]
    });
    let mut size = [0usize; 2];
    for a in 0..2 {
        let low = corners.iter().map(|c| c[a]).fold(f64::INFINITY, f64::min).floor();
        let high = corners.iter().map(|c| c[a]).fold(f64::NEG_INFINITY, f64::max).ceil();
        m[a][3] -= low;
        size[a] = (high - low) as usize;
    }
    Ok(Camera::from_matrix(m, Extent::new(size[0], size[1])?, grid, None)?)
}

/// A scan with thin structures.
struct Scan {
    name: &'static str,
    file: &'static str,
    raw: Option<([usize; 3], VoxelType, [f64; 3])>,
    view: [f64; 2],
}

const SCANS: [Scan; 4] = [
    Scan {
        name: "lobster",
        file: "lobster_301x324x56_uint8.raw.gz",
        raw: Some(([301, 324, 56], VoxelType::U8, [1.0, 1.0, 1.4])),
        view: [30.0, 60.0],
    },
    Scan {
        name: "stent",
        file: "stent_128x128x256_int16le.raw.gz",
        raw: Some(([128, 128, 256], VoxelType::I16, [1.0; 3])),
        view: [30.0, 20.0],
    },
    Scan {
        name: "aneurism",
        file: "aneurism_256x256x256_uint8.raw.gz",
        raw: Some(([256, 256, 256], VoxelType::U8, [1.0; 3])),
        view: [30.0, 20.0],
    },
    Scan { name: "vessels", file: "phantom:vessels@256", raw: None, view: [30.0, 20.0] },
];

impl Scan {
    fn load(&self, data: &Path) -> Outcome<Option<Volume>> {
        let Some((dims, voxel_type, spacing)) = self.raw else {
            return Ok(Some(volume::load(self.file, None)?.volume));
        };
        let path = data.join(self.file);
        if !path.exists() {
            return Ok(None);
        }
        let options = RawOptions {
            dims: Some(dims),
            voxel_type: Some(voxel_type),
            endian: Some(Endian::Little),
            spacing: Some(spacing),
            ..RawOptions::default()
        };
        Ok(Some(volume::load(&path.to_string_lossy(), Some(&options))?.volume))
    }
}

/// Measures of every section in an image, beside those in the reference.
pub fn compared(reference: &[Measure], image: &Image, sections: &[Section], voxel: f64) -> Vec<Option<[f64; 4]>> {
    let one = |(r, s): (&Measure, &Section)| {
        let m = measure(image, s, voxel)?;
        Some([m.contrast / r.contrast, m.width / r.width, m.width, m.shift - r.shift])
    };
    reference.iter().zip(sections).map(one).collect()
}

fn study(scan: &Scan, volume: &Volume, out: &Path, rows: &mut Vec<Row>) -> Outcome<()> {
    let fine = Weights::of(volume)?;
    let coarse = fine.halved()?;
    let finest = fine.grid.spacing().min_element();
    let view = View { azimuth: scan.view[0], elevation: scan.view[1], ..View::default() };
    let camera = parallel(view, &coarse.grid, PIXELS_PER_VOXEL / finest)?;
    let start = Instant::now();
    let (truth, error) = exact(&fine, Kernel::Box, &camera)?;
    let sections = ridges::find(&truth, PIXELS_PER_VOXEL);
    let measured: Vec<Option<Measure>> = sections.iter().map(|s| measure(&truth, s, PIXELS_PER_VOXEL)).collect();
    let measured: Vec<Measure> = measured.into_iter().flatten().collect();
    println!(
        "{}: {} pixels, {} sections, reference good to {error:.1e} of its mean, {:.1} s",
        scan.name,
        camera.extent(),
        sections.len(),
        start.elapsed().as_secs_f64()
    );
    let mm = finest / PIXELS_PER_VOXEL;
    let mut tiles = vec![truth.clone()];
    for (grid, weights) in [("half", &coarse), ("full", &fine)] {
        let voxel = PIXELS_PER_VOXEL * if grid == "half" { 2.0 } else { 1.0 };
        for candidate in candidates() {
            let start = Instant::now();
            // Casting the full scan under every kernel would take an hour; the footprint's accuracy is known by then.
            let shown = match grid {
                "half" => shown(weights, &candidate, &camera)?,
                _ => Shown { image: splatted(weights, &candidate, &camera), cast: None, check: None },
            };
            let compared = compared(&measured, &shown.image, &sections, PIXELS_PER_VOXEL);
            let row = Row::new(grid, scan.name, &candidate, &shown, &compared, [mm, voxel])?
                .rmse(rmse(&shown.image, &truth)?);
            println!("  {grid} {row} in {:.1} s", start.elapsed().as_secs_f64());
            rows.push(row);
            if grid == "half" && pictures::TILES.contains(&candidate.name) {
                tiles.push(shown.image);
            }
        }
    }
    pictures::tiles(&tiles, &sections, &out.join(format!("{}.png", scan.name)))?;
    pictures::marked(&truth, &sections, &out.join(format!("{}-sections.png", scan.name)))
}

/// How far the footprint image of the shell lies from one sampled at 2^27 points, and how far two such lie apart.
fn shell_check() -> Outcome<[f64; 2]> {
    let weights = Weights::of(&volume::load("phantom:vessels@96", None)?.volume)?;
    let camera = parallel(View::default(), &weights.grid, 0.5)?;
    let scenery = Scenery::new(weights.volume()?, DensityMap::default(), camera);
    let request = Request { method: Method::Qmc, kernel: Kernel::Shell, samples: 1 << 27, ..Request::default() };
    let sampled = |seed| make(&scenery, &Request { seed, ..request }, &Watch::default());
    let [a, b] = [sampled(1)?.image, sampled(2)?.image];
    let shell = candidates().into_iter().find(|c| c.library == Some(Kernel::Shell)).ok_or("no shell")?;
    let splatted = splat(&shell, &weights.values, &weights.grid, &scenery.camera);
    Ok([distance(&splatted, &a), distance(&b, &a)])
}

fn main() -> Outcome<()> {
    let (mut data, mut out, mut only) = (PathBuf::new(), None, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().ok_or_else(|| format!("{name} needs a value"))?;
        match name.as_str() {
            "--data" => data = value.into(),
            "--out" => out = Some(PathBuf::from(value)),
            "--only" => only = Some(value),
            _ => return Err(format!("unknown option '{name}'; give --data DIR --out DIR [--only SCENE]").into()),
        }
    }
    let out = out.ok_or("--out DIR is missing")?;
    std::fs::create_dir_all(&out)?;
    let wanted = |name: &str| only.as_ref().is_none_or(|o| o == name);
    let (mut rows, mut missing) = (vec![], vec![]);
    for scan in SCANS.iter().filter(|s| wanted(s.name)) {
        match scan.load(&data)? {
            Some(volume) => study(scan, &volume, &out, &mut rows)?,
            None => missing.push(scan.file),
        }
    }
    if wanted("tubes") {
        tubes::study(&mut rows)?;
    }
    let shell = shell_check()?;
    report::write(&out, &rows, &missing, shell)
}
