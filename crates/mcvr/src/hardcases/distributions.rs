//! Distributions: weights that break running sums.

use mcvr_scene::{Density, DensityMap};
use mcvr_volume::{Grid, Volume};

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group};

pub(super) const CASES: &[Case] = &[Case {
    name: "all-zero",
    group: Group::Distributions,
    breaks: "a division by the total gives NaN everywhere, or every sample falls on the last voxel",
    asserts: "an error that says there is nothing to draw",
    cost: Cost::Quick,
    measure: all_zero,
}];

/// Exact: one volume, one error, whose text must name what is missing.
fn all_zero(_: &Context) -> Result<Finding, CaseError> {
    let grid = Grid::with_spacing([3, 4, 5], [1.0; 3])?;
    let volume = Volume::from_vec(grid, vec![0u8; 60], "zeros")?;
    let says = match Density::new(&volume, DensityMap::default()) {
        Ok(_) => String::new(),
        Err(e) => e.to_string(),
    };
    Ok(Finding::new(f64::from(says.contains("zero")), "clear error", Bound::Exactly(1.0)).with(says))
}
