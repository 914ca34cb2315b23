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

use kernels::{Candidate, candidates, splat};
use report::Row;
use ridges::{Look, Measure, Section, measure};

/// Any failure.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Error of the exact images that is asked for, as a share of the mean pixel. The mean of a sparse image lies far below
/// its structures, so this is finer than it sounds.
const TOLERANCE: f64 = 1e-2;
/// How often a pixel's side may be halved: 9×9 rays at most, a pixel being at most half a voxel wide.
const MAX_DEPTH: u32 = 1;
/// Most pixels of a ray-cast image under `bspline3`, which takes minutes (the stent's is the largest below); its footprint
/// image, which lies within half a percent, stands in above.
const SPLINE_PIXELS: usize = 250_000;
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
fn splatted(weights: &Weights, candidate: &Candidate, camera: &Camera) -> Outcome<Image> {
    if !candidate.concentrate {
        return Ok(splat(candidate, &weights.values, &weights.grid, camera));
    }
    let moved = Density::new(&weights.volume()?, DensityMap::default())?.concentrated()?;
    let values: Vec<f32> = (0..moved.grid().len()).map(|n| moved.isovalue(n) as f32).collect();
    Ok(splat(candidate, &values, &weights.grid, camera))
}

/// The image under any kernel: ray cast if the library can within reason, by its footprint otherwise.
pub fn shown(weights: &Weights, candidate: &Candidate, camera: &Camera) -> Outcome<Shown> {
    let image = splatted(weights, candidate, camera)?;
    let affordable = |kernel| match kernel {
        Kernel::Shell => false,
        Kernel::Bspline3 => camera.extent().pixels() <= SPLINE_PIXELS,
        Kernel::Box | Kernel::Tent => true,
    };
    match candidate.library {
        Some(kernel) if affordable(kernel) => {
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
pub struct Scan {
    pub name: &'static str,
    file: &'static str,
    raw: Option<([usize; 3], VoxelType, [f64; 3])>,
    pub view: [f64; 2],
    pub look: Look,
}

/// Structures with room around them, down to faint ones.
const LONE: Look = Look { reach: 10.0, faintest: 0.02 };
/// The stent's wires lie close to each other and outshine the tissue around them.
const MESH: Look = Look { reach: 5.0, faintest: 0.1 };

pub const SCANS: [Scan; 4] = [
    Scan {
        name: "lobster",
        file: "lobster_301x324x56_uint8.raw.gz",
        raw: Some(([301, 324, 56], VoxelType::U8, [1.0, 1.0, 1.4])),
        view: [30.0, 60.0],
        look: LONE,
    },
    Scan {
        name: "stent",
        file: "stent_128x128x256_int16le.raw.gz",
        raw: Some(([128, 128, 256], VoxelType::I16, [1.0; 3])),
        view: [30.0, 20.0],
        look: MESH,
    },
    Scan {
        name: "aneurism",
        file: "aneurism_256x256x256_uint8.raw.gz",
        raw: Some(([256, 256, 256], VoxelType::U8, [1.0; 3])),
        view: [30.0, 20.0],
        look: LONE,
    },
    Scan { name: "vessels", file: "phantom:vessels@256", raw: None, view: [30.0, 20.0], look: LONE },
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

/// Sections with what they measure in a reference, which is theirs alone to choose.
pub struct Yardstick {
    pub sections: Vec<Section>,
    measured: Vec<Measure>,
    voxel: f64,
}

impl Yardstick {
    /// Those of the sections that can be measured in the reference; `voxel` is the fine voxel in pixels.
    pub fn new(reference: &Image, sections: &[Section], voxel: f64) -> Self {
        let one = |s: &Section| Some((*s, measure(reference, s, voxel)?));
        let (sections, measured) = sections.iter().filter_map(one).unzip();
        Self { sections, measured, voxel }
    }

    /// Contrast and width over the reference's, width and displacement in pixels, by section.
    pub fn compared(&self, image: &Image) -> Vec<Option<[f64; 4]>> {
        let one = |(r, s): (&Measure, &Section)| {
            let m = measure(image, s, self.voxel)?;
            Some([m.contrast / r.contrast, m.width / r.width, m.width, m.shift - r.shift])
        };
        self.measured.iter().zip(&self.sections).map(one).collect()
    }
}

/// Means over squares of `n` pixels around every pixel: the image as larger pixels would see it, wherever they lie.
fn pooled(image: &Image, n: usize) -> Image {
    let Extent { width, height } = image.extent();
    let mut out = Image::zeros(image.extent());
    for y in 0..height.saturating_sub(n - 1) {
        for x in 0..width.saturating_sub(n - 1) {
            let row = |j: usize| (0..n).map(|i| image.get(x + i, y + j)).sum::<f64>();
            out.values_mut()[x + n / 2 + width * (y + n / 2)] = (0..n).map(row).sum::<f64>() / (n * n) as f64;
        }
    }
    out
}

fn study(scan: &Scan, volume: &Volume, out: &Path, rows: &mut Vec<Row>) -> Outcome<()> {
    let fine = Weights::of(volume)?;
    let coarse = fine.halved()?;
    let finest = fine.grid.spacing().min_element();
    let view = View { azimuth: scan.view[0], elevation: scan.view[1], ..View::default() };
    let camera = parallel(view, &coarse.grid, PIXELS_PER_VOXEL / finest)?;
    let start = Instant::now();
    let (truth, error) = exact(&fine, Kernel::Box, &camera)?;
    let yardstick = Yardstick::new(&truth, &ridges::find(&truth, PIXELS_PER_VOXEL, scan.look), PIXELS_PER_VOXEL);
    println!(
        "{}: {} pixels, {} sections, reference good to {error:.1e} of its mean, {:.1} s",
        scan.name,
        camera.extent(),
        yardstick.sections.len(),
        start.elapsed().as_secs_f64()
    );
    let mm = finest / PIXELS_PER_VOXEL;
    // A pixel as wide as a voxel of the copy.
    let pixel = 2 * PIXELS_PER_VOXEL as usize;
    let large = pooled(&truth, pixel);
    let large_yardstick = Yardstick::new(&large, &yardstick.sections, PIXELS_PER_VOXEL);
    let mut tiles = vec![truth.clone()];
    let (mut half, mut half_large, mut full) = (vec![], vec![], vec![]);
    for candidate in candidates() {
        let start = Instant::now();
        let shown = shown(&coarse, &candidate, &camera)?;
        let row = |study, shown: &Shown, truth: &Image, yardstick: &Yardstick, voxel| -> Outcome<Row> {
            let row = Row::new(study, scan.name, &candidate, shown, &yardstick.compared(&shown.image), [mm, voxel]);
            Ok(row.rmse(rmse(&shown.image, truth)?))
        };
        half.push(row("half", &shown, &truth, &yardstick, 2.0 * PIXELS_PER_VOXEL)?);
        let pool = Shown { image: pooled(&shown.image, pixel), ..shown };
        half_large.push(row("half in large pixels", &pool, &large, &large_yardstick, 2.0 * PIXELS_PER_VOXEL)?);
        if pictures::TILES.contains(&candidate.name) {
            tiles.push(shown.image);
        }
        // Casting the full scan under every kernel would take an hour; the footprint's accuracy is known by now.
        let shown = Shown { image: splatted(&fine, &candidate, &camera)?, cast: None, check: None };
        full.push(row("full", &shown, &truth, &yardstick, PIXELS_PER_VOXEL)?);
        println!("  {} in {:.1} s", half[half.len() - 1], start.elapsed().as_secs_f64());
    }
    rows.extend(half.into_iter().chain(half_large).chain(full));
    pictures::tiles(&tiles, &yardstick.sections, &out.join(format!("{}.png", scan.name)))?;
    pictures::marked(&truth, &yardstick.sections, &out.join(format!("{}-sections.png", scan.name)))
}

/// How far the footprint image of the shell lies from one sampled at 2^28 points, and how far two such lie apart.
fn shell_check() -> Outcome<[f64; 2]> {
    let weights = Weights::of(&volume::load("phantom:vessels@64", None)?.volume)?;
    // As many pixels per voxel as in the study of the copies.
    let scale = 2.0 * PIXELS_PER_VOXEL / weights.grid.spacing().x;
    let camera = parallel(View::default(), &weights.grid, scale)?;
    let scenery = Scenery::new(weights.volume()?, DensityMap::default(), camera);
    let request = Request { method: Method::Qmc, kernel: Kernel::Shell, samples: 1 << 28, ..Request::default() };
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
