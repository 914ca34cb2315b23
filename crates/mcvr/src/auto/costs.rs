//! What work costs, in nanoseconds of one thread.

use mcvr_volume::Volume;

/// Nanoseconds of one thread, calibrated on processors of 2023 and 2024 with AVX-512 of two makers, between which they lie where these
/// differ (gathers by up to twice). Only ratios matter to a choice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Costs {
    /// A ray: its start, and its share of the tiles' bookkeeping.
    pub ray: f64,
    /// A pixel of the image: its mean over its neighbours, and its memory.
    pub pixel: f64,
    /// A sample along a ray, its voxels near.
    pub step: f64,
    /// A cell integrated exactly, its voxels near.
    pub cell: f64,
    /// What voxels add that are far and that no neighbouring ray reads.
    pub far: f64,
    /// A sample of the volume: drawn, projected and added.
    pub sample: f64,
    /// The tables of footprints.
    pub tables: f64,
    /// A voxel's footprint, and each pixel that it meets.
    pub footprint: f64,
    pub add: f64,
    /// A voxel of an occupied brick, looked at for its weight.
    pub visit: f64,
    /// A byte of the volume read for the map of empty bricks.
    pub occupancy: f64,
    /// A voxel summed for the distribution.
    pub distribution: f64,
}

/// Voxels between rays beyond which four by four of them share no lines of memory.
const APART: f64 = 2.6;

impl Costs {
    /// A sample or a cell of rays so many voxels apart.
    pub fn of_rays(&self, near: f64, apart: f64) -> f64 {
        near + self.far * (apart / APART).min(1.0).powf(1.2)
    }

    /// For a volume: random reads of large ones miss the caches.
    pub fn of(volume: &Volume) -> Self {
        let bytes = volume.bytes() as f64;
        let far = (bytes / 16e6).log2().clamp(0.0, 7.0);
        Self {
            ray: 28.0,
            pixel: 3.0,
            step: 2.2,
            cell: 3.0,
            // They are asked for ahead: 1.3 at 18 megabytes, 5.6 at 268.
            far: 1.1 * (bytes / 8e6).log2().clamp(0.0, 6.0),
            sample: 5.0 + 0.4 * far,
            tables: 1.5e6,
            footprint: 2.8,
            add: 0.55,
            visit: 0.5,
            occupancy: 0.1,
            distribution: 0.25,
        }
    }
}
