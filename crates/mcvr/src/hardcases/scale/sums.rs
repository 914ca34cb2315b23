//! Sums in pixels: at the limits of their integers, and in every way they are kept.

use mcvr_sampling::{Distribution, Precision, RenderOptions, VoxelOrder, render};
use mcvr_scene::{Camera, Density, DensityMap, Estimand, Extent, Kernel, View, Watch};
use mcvr_volume::{Grid, Phantom, Volume};

use super::{Bound, Case, CaseError, Context, Cost, Finding, case};
use crate::{Method, Request, Scenery, make};

pub(super) const CASES: &[Case] = &[
    case(
        "full-weights-beyond-64-bits",
        Cost::Quick,
        "fixed-point weights of 40 bits overflow 64 bits from 2^24 samples in a pixel on",
        "the pixel's line integral within the rounding of one weight, 2^-37",
        full_weights,
    ),
    case(
        "counts-beyond-32-bits",
        Cost::Large,
        "a pixel's count of 32 bits wraps, and 2^32 + 2^20 samples look like 2^20",
        "one pixel holds every one of 2^32 + 2^20 samples",
        counts_beyond,
    ),
    case(
        "private-and-shared-sums",
        Cost::Quick,
        "sums that workers share differ from those they keep for themselves",
        "images by 1, 2 and 16 workers have the same bits, whichever way their sums are kept",
        private_and_shared,
    ),
];

/// One voxel seen by a parallel camera that holds it whole in its only pixel.
fn one_voxel() -> Result<(Density, Camera), CaseError> {
    let grid = Grid::with_spacing([1, 1, 1], [2.0, 1.0, 0.5])?;
    let camera = Camera::look(&View { parallel: true, ..View::default() }, &grid, Extent::new(1, 1)?)?;
    Ok((Density::new(&Volume::from_vec(grid, vec![7u8], "one")?, DensityMap::default())?, camera))
}

/// Under a parallel projection every sample has the largest weight there is. M = 2^24 + 2^17 takes 25 bits, so weights get 62 − 25 = 37 and
/// their sum stays below 2^62. The pixel is mass times the camera's line factor; each weight errs by half a unit of 2^-37 of the
/// largest, their mean by as much, and the products of the last step by a few 2^-53: together less than 2^-37.
fn full_weights(_: &Context) -> Result<Finding, CaseError> {
    let samples = (1u64 << 24) + (1 << 17);
    let (density, camera) = one_voxel()?;
    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
    let options = RenderOptions {
        estimand: Estimand::Line,
        kernel: Kernel::Box,
        precision: Some(Precision::F64),
        ..RenderOptions::default()
    };
    let stream = mcvr_mc::Stratified::new(samples, 1);
    let made = render(&distribution, &stream, &camera, &options, &Watch::default())?;
    if made.counters.inside != samples {
        return Err(format!("{} of {samples} samples inside", made.counters.inside).into());
    }
    let exact = density.mass() * camera.line_factor(0.5, 0.5, 1.0);
    let error = (made.image.get(0, 0) / exact - 1.0).abs();
    // The same sum with weights of 40 bits whatever the number of samples.
    let weight = ((1u64 << 40) as f64 / (1.0 + 1e-6)).round() as u64;
    let naive = weight.wrapping_mul(samples) as f64 / (weight as f64 * samples as f64) - 1.0;
    let detail = format!("weights of 40 bits would err by {:.0} %", 100.0 * naive.abs());
    Ok(Finding::new(error, "relative error", Bound::AtMost(2f64.powi(-37))).with(detail))
}

/// Exact: the share of samples in the only pixel is 1, and M/M is 1 in floating point as well: sums to 2^53 are exact in `f64`, and the
/// unit 1/M times M rounds to 1 where M has at most 13 significant bits, as 4097·2^20 has.
fn counts_beyond(_: &Context) -> Result<Finding, CaseError> {
    let samples = (1u64 << 32) + (1 << 20);
    let (density, camera) = one_voxel()?;
    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
    let options = RenderOptions { estimand: Estimand::Count, kernel: Kernel::Box, ..RenderOptions::default() };
    let stream = mcvr_mc::Stratified::new(samples, 1);
    let made = render(&distribution, &stream, &camera, &options, &Watch::default())?;
    let counted = made.image.get(0, 0) * samples as f64;
    let missing = (counted - samples as f64).abs() + samples.abs_diff(made.counters.inside) as f64;
    let detail = format!("counted {counted:.0}; 32 bits would have held {}", samples as u32);
    Ok(Finding::new(missing, "samples missing", Bound::Exactly(0.0)).with(detail))
}

/// Exact: all pixels of a 1000 × 1000 image, 8 MB of sums, of both estimands. One worker keeps its own, two keep 16 MB
/// between them, 16 would keep 128 MB and share instead (the limit is 48 MiB).
fn private_and_shared(_: &Context) -> Result<Finding, CaseError> {
    let volume = Phantom::parse("lobster@32")?.generate()?;
    let camera = Camera::look(&View::default(), volume.grid(), Extent::new(1000, 1000)?)?;
    let scenery = Scenery::new(volume, DensityMap::default(), camera);
    let (mut wrong, mut of) = (0u64, 0u64);
    for estimand in Estimand::ALL {
        let request = Request { method: Method::Mc, samples: 1 << 19, estimand, ..Request::default() };
        let image = |workers: usize| -> Result<Vec<u64>, CaseError> {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(workers).build()?;
            let made = pool.install(|| make(&scenery, &request, &Watch::default()))?;
            Ok(made.image.values().iter().map(|v| v.to_bits()).collect())
        };
        let one = image(1)?;
        for workers in [2, 16] {
            let other = image(workers)?;
            wrong += one.iter().zip(&other).filter(|(a, b)| a != b).count() as u64;
            of += one.len() as u64;
        }
    }
    Ok(Finding::wrong(wrong, of, "pixels").with("1 worker against 2 (private) and 16 (shared)"))
}
