//! What an image will cost, and how wrong it will be.

use mcvr_scene::{Camera, Density, Extent};
use mcvr_volume::Grid;

use crate::FootprintOptions;
use crate::image::{MARGIN, image_bytes, workers};
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

/// Expected bias.
pub fn predicted_error(_density: &Density, _camera: &Camera, _options: &FootprintOptions) -> f64 {
    0.003
}
