//! Many voxels: sums that stall, and sums that overflow.

use std::fs::OpenOptions;
use std::io::Write;

use mcvr_sampling::{Distribution, VoxelOrder, block_count};
use mcvr_scene::{Density, DensityMap, Transfer, power_of_two};
use mcvr_volume::{Grid, RawOptions, Volume, VoxelType, load};
use num_bigint::BigUint;

use super::exact::{end_of, whole};
use super::{Bound, Case, CaseError, Context, Cost, Finding, Group, density};
use crate::hardcases::support::block_of;
use crate::request::point_stream;
use crate::{Method, Request};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "tiny-weights-beside-a-huge-one",
        group: Group::Distributions,
        breaks: "an f32 running sum stalls at 2^24: the rare half is never drawn",
        asserts: "2^25 weights of 1 beside one as heavy as all of them get half of the samples, by every method",
        cost: Cost::Quick,
        measure: tiny_beside_huge,
    },
    Case {
        name: "2-33-tiny-weights-beside-a-huge-one",
        group: Group::Distributions,
        breaks: "an f32 running sum stalls at 2^24, a 32-bit voxel index wraps at 2^32",
        asserts: "2^33 weights of 1 beside one as heavy as all of them get half of the samples, by every method",
        cost: Cost::Large,
        measure: tiny_beside_huge_large,
    },
    Case {
        name: "u32-maxima",
        group: Group::Distributions,
        breaks: "a 64-bit sum of 2^32-1 overflows from 2^32 voxels on; a 32-bit sum from the second",
        asserts: "every voxel of a volume of u32 maxima has exactly the same number of targets",
        cost: Cost::Quick,
        measure: u32_maxima,
    },
    Case {
        name: "2-33-u32-maxima",
        group: Group::Distributions,
        breaks: "the sum of 2^33 weights of 2^32-1 takes 65 bits",
        asserts: "the total stays below 2^63 and every voxel probed has exactly the same number of targets",
        cost: Cost::Large,
        measure: u32_maxima_large,
    },
    Case {
        name: "rounding-cannot-overflow",
        group: Group::Distributions,
        breaks: "weights that all round up push a total scaled to just below the limit over it",
        asserts: "n weights of half a unit each add at most n/2 units: 2^62 + 2^39 at 2^40 voxels, below 2^63",
        cost: Cost::Quick,
        measure: rounding,
    },
];

/// A cube whose voxels are 0 but the first, which is 1.
fn one_of(dims: [usize; 3]) -> Result<Volume, CaseError> {
    let grid = Grid::with_spacing(dims, [1.0; 3])?;
    let mut voxels = vec![0u8; grid.len()];
    voxels[0] = 1;
    Ok(Volume::from_vec(grid, voxels, "one of many")?)
}

/// The same of 2^33 voxels, in a sparse file that is mapped: 8 GiB of addresses, a page of disk.
fn one_of_2_33(context: &Context) -> Result<(Volume, tempfile::TempDir), CaseError> {
    let folder = context.folder()?;
    let path = folder.path().join("one.raw");
    let mut file = OpenOptions::new().create_new(true).write(true).open(&path)?;
    file.write_all(&[1])?;
    let side = 2048;
    if let Err(e) = file.set_len((side * side * side) as u64) {
        return Err(CaseError::Impossible(format!("no sparse file of 8 GiB here: {e}")));
    }
    let options = RawOptions { dims: Some([side; 3]), voxel_type: Some(VoxelType::U8), ..RawOptions::default() };
    Ok((load(&path.to_string_lossy(), Some(&options))?.volume, folder))
}

/// 0 weighs 1, and 1 as much as all zeros, n - 1. The n - 1 rare ones hold the targets from the end of the first voxel on.
///
/// Of M independent draws a Binomial(M, 1/2) number is rare, of deviation √M/2; a normal variate exceeds 5.3 with
/// probability 1.2e-7, so four methods raise a false alarm with less than 1e-6. Stratified draws vary less.
fn rare_half(volume: &Volume) -> Result<Finding, CaseError> {
    let n = volume.grid().len();
    let transfer = Transfer::Piecewise(vec![[0.0, 1.0], [1.0, (n - 1) as f64]]);
    let density = Density::new(volume, DensityMap { transfer, ..DensityMap::default() })?;
    let distribution = Distribution::new(&density, VoxelOrder::Raster)?;
    let (total, huge) = (distribution.total(), end_of(&distribution, 0, 0));
    let samples = 1u64 << 19;
    let mut worst = 0.0f64;
    for method in [Method::Mc, Method::McBinary, Method::Stratified, Method::Qmc] {
        let stream = point_stream(&Request { method, samples, ..Request::default() }, total);
        let rare: usize = (0..block_count(samples))
            .map(|b| block_of(&*stream, b, total).targets.iter().filter(|t| **t >= huge).count())
            .sum();
        worst = worst.max((rare as f64 - samples as f64 / 2.0).abs() / (samples as f64).sqrt() * 2.0);
    }
    if distribution.voxel_of(total - 1) != n - 1 || distribution.voxel_of(huge) != 1 {
        return Err("the last target is not on the last voxel, or the first rare one not on the second".into());
    }
    // Once adding a weight leaves the sum as it is, so do all that follow.
    let (mut sum, mut i) = ((n - 1) as f32, 1);
    while i < n && sum + 1.0 > sum {
        (sum, i) = (sum + 1.0, i + 1);
    }
    Ok(Finding::new(worst, "deviations from M/2, the worst of 4 methods", Bound::AtMost(5.3)).with(format!(
        "an f32 running sum can draw {} of the {} rare voxels",
        i - 1,
        n - 1
    )))
}

/// Bound in [`rare_half`].
fn tiny_beside_huge(_: &Context) -> Result<Finding, CaseError> {
    rare_half(&one_of([512, 256, 256])?)
}

/// Bound in [`rare_half`].
fn tiny_beside_huge_large(context: &Context) -> Result<Finding, CaseError> {
    let (volume, _folder) = one_of_2_33(context)?;
    rare_half(&volume)
}

/// Exact: n equal weights have equal units, so voxel v of n ends at (v + 1) / n of the total, a whole number. Probed at both
/// ends, where 32 bits end, and at places between.
fn equal_shares(density: &Density) -> Result<Finding, CaseError> {
    let n = density.volume().grid().len() as u64;
    let distribution = Distribution::new(density, VoxelOrder::Raster)?;
    let total = distribution.total();
    if total % n != 0 || total >= 1 << 63 {
        return Err(format!("a total of {total} for {n} equal voxels").into());
    }
    let probes: Vec<u64> = (0..64).map(|i| (n - 1) / 63 * i).chain([n - 1, n / 2, (1 << 32) - 1, 1 << 32]).collect();
    let probes: Vec<u64> = probes.into_iter().filter(|v| *v < n).collect();
    let end = |v: u64| end_of(&distribution, v as usize, 0);
    let wrong = probes.iter().filter(|v| end(**v) != (**v + 1) * (total / n)).count() as u64;
    let bits = (u128::from(n) * u128::from(u32::MAX)).ilog2() + 1;
    Ok(Finding::wrong(wrong, probes.len() as u64, "voxels")
        .with(format!("their plain sum takes {bits} bits, the total {}", total.ilog2() + 1)))
}

/// Bound in [`equal_shares`].
fn u32_maxima(_: &Context) -> Result<Finding, CaseError> {
    equal_shares(&density(vec![u32::MAX; 1 << 21])?)
}

/// As if each of 2^33 voxels stored 2^32-1: zeros with that intercept. The first stores the same by a flat map; bound in
/// [`equal_shares`].
fn u32_maxima_large(context: &Context) -> Result<Finding, CaseError> {
    let (volume, _folder) = one_of_2_33(context)?;
    let transfer = Transfer::Piecewise(vec![[0.0, f64::from(u32::MAX)]]);
    equal_shares(&Density::new(&volume, DensityMap { transfer, ..DensityMap::default() })?)
}

/// The unit of a sum in [1, 2) is 2^-61; n weights of 2^-62 round up by half of one each, the worst there is. The excess of
/// the total over the exact sum is then n/2 units, and no scheme of weights makes it more.
fn rounding(_: &Context) -> Result<Finding, CaseError> {
    let n = 1u32 << 16;
    let mut weights = vec![power_of_two(-62); n as usize];
    weights.push(2.0 - power_of_two(-40));
    let exact: BigUint = weights.iter().map(|w| whole(*w)).sum();
    let density = density(weights)?;
    let total = Distribution::new(&density, VoxelOrder::Raster)?.total();
    // In units of 2^-61, rounded down.
    let excess = BigUint::from(total) - (exact >> (1074 - 61));
    let excess = u64::try_from(excess)? as f64;
    Ok(Finding::new(excess, "units above the exact sum", Bound::AtMost(f64::from(n) / 2.0))
        .with(format!("the total is {:.6} of 2^62", total as f64 / 2f64.powi(62))))
}
