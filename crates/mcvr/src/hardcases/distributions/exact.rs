//! Exact references in big integers.

use mcvr_sampling::Distribution;
use num_bigint::BigUint;

/// A finite non-negative number as a multiple of 2^-1074.
pub(super) fn whole(w: f64) -> BigUint {
    let (biased, fraction) = (w.to_bits() >> 52, w.to_bits() & ((1 << 52) - 1));
    match biased {
        0 => BigUint::from(fraction),
        _ => BigUint::from(fraction | 1 << 52) << (biased - 1),
    }
}

/// A quotient to six digits behind the point, rounded up.
pub(super) fn ratio(a: &BigUint, b: &BigUint) -> f64 {
    let millionths = (a * 1_000_000u32 + b - 1u32) / b;
    u64::try_from(millionths).map_or(f64::INFINITY, |m| m as f64 / 1e6)
}

/// The running sum of integer weights up to and including each voxel of a row in raster order, as drawing shows it.
pub(super) fn ends(distribution: &Distribution<'_>) -> Vec<u64> {
    let voxels = distribution.density().volume().grid().len();
    let mut low = 0;
    let end = |voxel| {
        low = end_of(distribution, voxel, low);
        low
    };
    (0..voxels).map(end).collect()
}

/// The first target at or after `low` that falls behind a voxel of a row in raster order.
pub(super) fn end_of(distribution: &Distribution<'_>, voxel: usize, mut low: u64) -> u64 {
    let mut high = distribution.total();
    while low < high {
        let middle = low + (high - low) / 2;
        if distribution.voxel_of(middle) <= voxel { low = middle + 1 } else { high = middle }
    }
    low
}
