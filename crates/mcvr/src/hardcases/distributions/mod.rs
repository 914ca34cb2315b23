//! Distributions: weights that break running sums.

mod exact;
mod images;
mod many;
mod maps;
mod places;
mod weights;

use mcvr_sampling::{Distribution, VoxelOrder};
use mcvr_scene::{Density, DensityMap};
use mcvr_volume::{Grid, Volume, Voxel};
use num_bigint::BigUint;

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group};

pub(super) const CASES: [&[Case]; 5] = [places::CASES, weights::CASES, many::CASES, maps::CASES, images::CASES];

/// A row of voxels of 1 mm.
fn row<T: Voxel>(voxels: Vec<T>) -> Result<Volume, CaseError> {
    Ok(Volume::from_vec(Grid::with_spacing([voxels.len(), 1, 1], [1.0; 3])?, voxels, "row")?)
}

/// The same under the identity map.
fn density<T: Voxel>(voxels: Vec<T>) -> Result<Density, CaseError> {
    Ok(Density::new(&row(voxels)?, DensityMap::default())?)
}

/// How far the probabilities of a row's voxels are from the exact ones, over the most that they may be.
///
/// With the integers `u_i = w_i/unit + r_i`, `|r_i| ≤ 1/2`, of n positive weights, `U = Σu` and `S = Σw`, the probability
/// `u_i/U` is wrong by `|r_i - p_i Σr| / U ≤ (1 + n p_i) / 2U`. Times `2US` that is `2 |u_i S - w_i U| ≤ S + n w_i`: an
/// inequality of integers, as every `f64` is a multiple of 2^-1074, so the ratio of its sides is measured without rounding.
fn worst_error(weights: &[f64]) -> Result<f64, CaseError> {
    let density = density(weights.to_vec())?;
    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
    let ends = exact::ends(&distribution);
    let exact: Vec<BigUint> = weights.iter().map(|w| exact::whole(*w)).collect();
    let sum: BigUint = exact.iter().sum();
    let positive = density.report().positive;
    let mut before = 0;
    let mut worst = 0.0f64;
    for (weight, end) in exact.iter().zip(ends) {
        let (here, there) = (&sum * (end - before), weight * distribution.total());
        let error = if here > there { here - there } else { there - here };
        worst = worst.max(exact::ratio(&(error * 2u32), &(&sum + weight * positive)));
        before = end;
    }
    Ok(worst)
}

/// [`worst_error`] as a finding: no more than allowed.
fn probabilities(weights: &[f64]) -> Result<Finding, CaseError> {
    Ok(Finding::new(worst_error(weights)?, "of the error that rounding to integers may make", Bound::AtMost(1.0)))
}
