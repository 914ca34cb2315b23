//! Fixed point: what one unit of the image of sums is worth. Integers commute, so that the image is the same for any number of threads.

use mcvr_scene::{Camera, Density, Estimand, power_of_two};

use crate::projection::Projection;

/// Scale of the sums. Amounts are shares of the largest that a voxel can have; a voxel adds less than 2^50 units and all together
/// less than 2^61, so that nothing can overflow, and a unit is less than 2^-48 of the largest voxel or 2^-58 of the whole.
pub(crate) struct Scale {
    /// Units of the largest amount, a power of two.
    pub units: f32,
    /// The estimand's value of one unit.
    pub value: f64,
}

/// Bits of the largest amount, and of all amounts together.
const ONE: i32 = 49;
const ALL: i32 = 60;

impl Scale {
    pub fn new(density: &Density, camera: &Camera, projection: &Projection, estimand: Estimand) -> Self {
        let report = density.report();
        // At least 1, at most the number of voxels.
        let sum = report.weight_sum / report.max_weight;
        let bits = ONE.min(ALL - sum.log2().ceil() as i32);
        let largest = match estimand {
            Estimand::Count => sum.recip(),
            Estimand::Line => {
                let factor = camera.det() * projection.longest / (projection.least_depth * projection.least_depth);
                factor * density.volume().grid().voxel_volume() * report.max_weight
            }
        };
        Self { units: power_of_two(bits) as f32, value: largest * power_of_two(-bits) }
    }
}
