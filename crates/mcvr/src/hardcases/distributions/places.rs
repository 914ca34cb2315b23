//! Where the weight lies: one voxel, zeros before and behind, the ends of the running sum.

use mcvr_sampling::{Distribution, Provenance, VoxelOrder, sample};
use mcvr_scene::{Density, DensityMap, Kernel, Watch};
use mcvr_volume::{Grid, Volume};

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group, density};
use crate::Request;
use crate::hardcases::support::{SAMPLERS, budget};
use crate::request::point_stream;

pub(super) const CASES: &[Case] = &[
    Case {
        name: "all-zero",
        group: Group::Distributions,
        breaks: "a division by the total gives NaN everywhere, or every sample falls on the last voxel",
        asserts: "an error that says there is nothing to draw",
        cost: Cost::Quick,
        measure: all_zero,
    },
    Case {
        name: "single-voxel",
        group: Group::Distributions,
        breaks: "a search that is off by one at the first or the last voxel finds its neighbour or leaves the volume",
        asserts: "first, last or in the middle, it is drawn every time, by every method in every order",
        cost: Cost::Quick,
        measure: single_voxel,
    },
    Case {
        name: "every-target-once",
        group: Group::Distributions,
        breaks: "leading or trailing zeros are drawn at u = 0 or near 1, the last positive voxel loses its share",
        asserts: "over all targets each voxel is found exactly as often as it weighs, zeros never",
        cost: Cost::Quick,
        measure: every_target_once,
    },
    Case {
        name: "extreme-targets",
        group: Group::Distributions,
        breaks: "u = 0 draws a leading zero, u = 1-2^-53 runs over the end of the running sum",
        asserts: "the first target is on the first positive voxel and the last on the last, from 1e-300 to 1e300",
        cost: Cost::Quick,
        measure: extreme_targets,
    },
];

/// Exact: one volume, one error, whose text must name what is missing.
fn all_zero(_: &Context) -> Result<Finding, CaseError> {
    let says = match density(vec![0u8; 60]) {
        Ok(_) => String::new(),
        Err(CaseError::Failed(e)) => e.to_string(),
        Err(impossible) => return Err(impossible),
    };
    Ok(Finding::new(f64::from(says.contains("nothing can be drawn")), "clear error", Bound::Exactly(1.0)).with(says))
}

/// Exact: every point must lie within half a voxel of the only voxel's centre (the `box` kernel's support; rounding to
/// 32 bits may put a point on its end, never beyond, as the end is a number of 32 bits).
fn single_voxel(_: &Context) -> Result<Finding, CaseError> {
    let dims = [17, 9, 5];
    let grid = Grid::with_spacing(dims, [1.0; 3])?;
    let (mut wrong, mut of) = (0, 0);
    for at in [0, grid.len() / 2, grid.len() - 1] {
        let mut voxels = vec![0f32; grid.len()];
        voxels[at] = 1e-30;
        let density = Density::new(&Volume::from_vec(grid.clone(), voxels, "single")?, DensityMap::default())?;
        let centre = grid.unravel(at).map(|c| c as f64);
        for (_, order) in VoxelOrder::ALL {
            let distribution = Distribution::new(&density, order)?;
            for method in SAMPLERS {
                let request = Request { method, samples: budget(method, 2049), ..Request::default() };
                let stream = point_stream(&request, distribution.total());
                let (cloud, _) =
                    sample(&distribution, &*stream, Kernel::Box, Provenance::default(), &Watch::default())?;
                of += cloud.samples();
                let near = |i: usize| (0..3).all(|a| (cloud.world(i)[a] - centre[a]).abs() <= 0.5);
                wrong += (0..cloud.samples() as usize).filter(|i| !near(*i)).count() as u64;
            }
        }
    }
    Ok(Finding::wrong(wrong, of, "draws"))
}

/// Exact: integer weights are their own units, so over all targets a voxel must be found as often as it weighs. 700 zeros
/// before and behind fill bricks of their own.
fn every_target_once(_: &Context) -> Result<Finding, CaseError> {
    let n = 2000;
    let voxels: Vec<u8> =
        (0..n).map(|i| if (700..n - 700).contains(&i) && i % 3 == 0 { (i * 7 % 256) as u8 } else { 0 }).collect();
    let grid = Grid::with_spacing([20, 10, 10], [1.0; 3])?;
    let density = Density::new(&Volume::from_vec(grid, voxels.clone(), "zeros around")?, DensityMap::default())?;
    let (mut wrong, mut of) = (0, 0);
    for (_, order) in VoxelOrder::ALL {
        let distribution = Distribution::new(&density, order)?;
        let mut counts = vec![0u64; n];
        (0..distribution.total()).for_each(|t| counts[distribution.voxel_of(t)] += 1);
        wrong += counts.iter().zip(&voxels).filter(|(count, v)| **count != u64::from(**v)).count() as u64;
        of += n as u64;
    }
    Ok(Finding::wrong(wrong, of, "voxels"))
}

/// Exact: the first and the last target, and those that the methods make of the smallest and the largest random words.
fn extreme_targets(_: &Context) -> Result<Finding, CaseError> {
    let (mut wrong, mut of) = (0, 0);
    for weight in [5e-324, 1e-300, 1e-30, 1.0, 1e30, 1e300] {
        let mut voxels = vec![0f64; 3000];
        voxels[500..2500].iter_mut().for_each(|v| *v = weight);
        let density = density(voxels)?;
        let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
        let total = distribution.total();
        // Strata reach closest to the ends: the first at fraction 0, the last at 1 - 2^-32.
        let strata = |k, fraction| mcvr_sampling::Strata::new(k, total, 1 << 40).next(fraction);
        let first = [0, strata(0, 0)];
        let last = [total - 1, strata((1 << 40) - 1, u32::MAX)];
        wrong += first.iter().filter(|t| distribution.voxel_of(**t) != 500).count();
        wrong += last.iter().filter(|t| **t >= total || distribution.voxel_of(**t) != 2499).count();
        of += 4;
    }
    Ok(Finding::wrong(wrong as u64, of, "targets"))
}
