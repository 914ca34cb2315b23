//! Measures the bias of footprints against the reference, and their time: `cargo run --release -p mcvr-footprint --example bias`.
//! With paths or phantoms as arguments it measures those; else small fields by the size of a voxel in pixels.

use std::sync::OnceLock;
use std::time::Instant;

use glam::DVec3;
use mcvr_footprint::{FootprintOptions, Refine, footprints, footprints_in_all, predicted_error};
use mcvr_raycast::{ReferenceOptions, reference};
use mcvr_scene::{Camera, Density, DensityMap, Estimand, Extent, Image, View, Watch};
use mcvr_volume::{Grid, Volume};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// RMSE over the mean pixel of the truth.
fn error(image: &Image, truth: &Image) -> f64 {
    let sum: f64 = image.values().iter().zip(truth.values()).map(|(a, b)| (a - b) * (a - b)).sum();
    (sum / truth.values().len() as f64).sqrt() / truth.mean()
}

/// Seconds that this process' threads have been on a processor; wall time where the system does not tell.
fn processor() -> f64 {
    static START: OnceLock<Instant> = OnceLock::new();
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let on = |task: std::fs::DirEntry| {
        std::fs::read_to_string(task.path().join("schedstat")).ok()?.split(' ').next()?.parse::<f64>().ok()
    };
    let nanoseconds: f64 = tasks.filter_map(on).sum();
    if nanoseconds > 0.0 { 1e-9 * nanoseconds } else { START.get_or_init(Instant::now).elapsed().as_secs_f64() }
}

/// Independent voxels, or those of which only a share is not 0, or a smooth bump.
fn field(kind: &str, dims: [usize; 3], spacing: [f64; 3]) -> Outcome<Density> {
    let mut state = 99u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1u64 << 24) as f64
    };
    let value = |n: usize| {
        let p = [n % dims[0], n / dims[0] % dims[1], n / dims[0] / dims[1]];
        let u: [f64; 3] = std::array::from_fn(|a| (p[a] as f64 + 0.5) / dims[a] as f64 - 0.5);
        match kind {
            "noise" => random() as f32,
            "bump" => (-25.0 * u.iter().map(|u| u * u).sum::<f64>()).exp() as f32,
            _ => f32::from(u8::from((u[0] - 0.2 * (7.0 * u[2]).sin()).hypot(u[1] - 0.3 * u[2]) < 0.06)),
        }
    };
    let voxels = (0..dims.iter().product()).map(value).collect();
    Ok(Density::new(&Volume::from_vec(Grid::with_spacing(dims, spacing)?, voxels, kind)?, DensityMap::default())?)
}

fn measured(name: &str, density: &Density, view: &View, extent: Extent, refine: &[Refine]) -> Outcome<()> {
    let grid = density.volume().grid();
    let camera = Camera::look(view, grid, extent)?;
    let options = ReferenceOptions { estimand: Estimand::Line, tolerance: 1e-4, ..ReferenceOptions::default() };
    let truth = reference(density, &camera, &options, &Watch::default())?;
    let (a, b) =
        (camera.project(grid.centre()), camera.project(grid.centre() + DVec3::Z * grid.spacing().min_element()));
    let size = (a.0 - b.0).hypot(a.1 - b.1) / view.elevation.to_radians().cos().max(1e-9);
    for refine in refine {
        let options = FootprintOptions { refine: *refine, ..FootprintOptions::default() };
        let mut least = f64::INFINITY;
        let mut made = footprints(density, &camera, &options, &Watch::default())?;
        for _ in 0..9 {
            let start = processor();
            made = footprints(density, &camera, &options, &Watch::default())?;
            least = least.min(processor() - start);
        }
        println!(
            "{name:<34} {size:>6.2} px a voxel, parts {refine:?}: error {:.4} % (own {:.4}, predicted {:.4}); {:.3} ms of processor, {:.2} ns a \
             footprint of {}; {:?}",
            100.0 * error(&made.image, &truth.image),
            100.0 * truth.error.rel_rmse_estimate,
            100.0 * predicted_error(density, &camera, &options),
            1e3 * least,
            1e9 * least / made.counters.footprints as f64,
            footprints_in_all(density, &options),
            made.counters,
        );
    }
    Ok(())
}

fn main() -> Outcome<()> {
    let inputs: Vec<String> = std::env::args().skip(1).collect();
    for input in &inputs {
        let density = Density::new(&mcvr_volume::load(input, None)?.volume, DensityMap::default())?;
        measured(input, &density, &View::default(), Extent::new(400, 400)?, &[Refine::Cubic(1)])?;
    }
    if !inputs.is_empty() {
        return Ok(());
    }
    let oblique = View::default();
    let axis = View { azimuth: 0.0, elevation: 0.0, ..oblique };
    let diagonal = View { azimuth: 45.0, elevation: 35.264, ..oblique };
    for kind in ["noise", "bump", "tube"] {
        for (name, view) in [("oblique", oblique), ("axis", axis), ("diagonal", diagonal)] {
            for parallel in [false, true] {
                let view = View { parallel, ..view };
                for (n, pixels) in [(96, 50), (48, 80), (32, 100), (24, 160), (16, 200), (12, 300)] {
                    let density = field(kind, [n; 3], [1.0; 3])?;
                    let name = format!("{kind}, {name}{}", if parallel { ", parallel" } else { "" });
                    measured(
                        &name,
                        &density,
                        &view,
                        Extent::new(pixels, pixels)?,
                        &[Refine::Cubic(1), Refine::Each(2)],
                    )?;
                }
            }
        }
        for spacing in [[0.7, 1.0, 1.6], [1.0, 1.0, 1.2], [1.0, 1.0, 3.0]] {
            let density = field(kind, [32, 30, 24], spacing)?;
            let name = format!("{kind}, spacing {spacing:?}");
            measured(
                &name,
                &density,
                &oblique,
                Extent::new(100, 100)?,
                &[Refine::Each(1), Refine::Cubic(1), Refine::Each(2)],
            )?;
        }
    }
    Ok(())
}
