//! What an image will cost, and how wrong it will be.

use mcvr_scene::{Camera, Density, Extent};
use mcvr_volume::Grid;

use crate::FootprintOptions;
use crate::image::{MARGIN, image_bytes, workers};
use crate::projection::Projection;
use crate::refine::parts;

/// Footprints that an image takes at most: those of all voxels of positive weight, or of their parts.
pub fn footprints_in_all(density: &Density, options: &FootprintOptions) -> u64 {
    density.report().positive.saturating_mul(footprints_of_a_voxel(density.volume().grid(), options))
}

/// Footprints of one voxel: 1, or those of its parts where the grid is refined.
pub fn footprints_of_a_voxel(grid: &Grid, options: &FootprintOptions) -> u64 {
    parts(grid, options).iter().map(|n| 2 * u64::from(*n) - 1).product()
}

/// Most bytes that the sums of an image take on the threads there are.
pub fn sums_bytes(camera: &Camera) -> u64 {
    let Extent { width, height } = camera.extent();
    let (width, height) = (width + 2 * MARGIN, height + 2 * MARGIN);
    (image_bytes(width, height) * workers(width, height)) as u64
}

/// Norm of what is wrong with the footprint of one voxel of mass 1 that is small beside a pixel, measured.
const OFF: f64 = 0.003;
/// Side of a voxel in pixels from which the norm falls with it.
const WIDE: f64 = 2.8;
/// Side in pixels below which voxels in a row along the view share their offset, so that their errors add up.
const SMALL: f64 = 0.25;
/// How the norm falls with the parts along an axis.
const PARTS: f64 = -1.6;

/// The bias to expect: RMSE over the mean pixel, right to about a factor of 2 either way for images of the whole volume.
///
/// Errors of voxels are independent, so that they are `k √(P / N)` for `P` pixels and `N` voxels of equal weight, with `k` the norm
/// of one voxel's error: `0.003 √(1 + (0.25 / s)²) / √(1 + (s / 2.8)²)` for voxels of `s` pixels. `N` is
/// [`Density::equal_voxels`]. Measured: noise in all voxels 0.02 % at 0.3 pixels a voxel, 0.2 % at 1.6, 0.5 % at 11; a
/// tube of two voxels in an empty volume 0.2 %, 1.4 % and 5 %. Grids of unequal spacing are as good with the parts they are given.
pub fn predicted_error(density: &Density, camera: &Camera, options: &FootprintOptions) -> f64 {
    let grid = density.volume().grid();
    let Some(projection) = Projection::new(grid, [1; 3], camera, MARGIN) else { return 0.0 };
    let square = projection.steps.iter().flatten().map(|s| f64::from(*s).powi(2)).sum::<f64>() / 2.0;
    let together = (1.0 + SMALL * SMALL / square.max(1e-12)).sqrt();
    let voxels = density.equal_voxels();
    let each = OFF * f64::from(options.refine.number()).powf(PARTS) / (1.0 + square / (WIDE * WIDE)).sqrt();
    each * together * (camera.extent().pixels() as f64 / voxels).sqrt()
}
