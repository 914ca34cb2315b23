//! Whether voxels were read with their bytes in the wrong order: scans are smooth, byte-swapped scans are not; and hardly a
//! scan has values like 1e-40.

use crate::{Volume, Voxel, VoxelType, Voxels};

/// Pairs of neighbours that are looked at, at most.
const PAIRS: usize = 1 << 20;
/// How many times smoother the swapped reading must be.
const FACTOR: f64 = 3.0;
/// Magnitudes of floats beyond these bounds are outlandish.
const PLAUSIBLE: std::ops::Range<f64> = 1e-20..1e20;
/// Share of outlandish floats that is suspicious where the swapped reading has fewer than a tenth of it: wrong exponents
/// are spread over all of them, half of which are outlandish.
const OUTLANDISH: f64 = 0.1;

/// Says so when 16- or 32-bit integers would be far smoother, or floats far less outlandish, with their bytes in the opposite
/// order.
///
/// Smoothness is the mean absolute difference of neighbours along x over the range of the values, on rows spread
/// evenly over the volume (a million pairs at most, so that it takes milliseconds). A float is outlandish when it is no
/// number, or its magnitude is neither 0 nor between 1e-20 and 1e20. `None` when nothing is suspicious, for 8-bit voxels,
/// and for integers all of whose bytes but one are 0, which the test cannot tell.
pub fn byte_order_suspicion(volume: &Volume) -> Option<String> {
    if let Voxels::F32(_) | Voxels::F64(_) = volume.voxels() {
        let (read, swapped) =
            with_voxels!(volume.voxels(), v => (outlandish(v, |x| x), outlandish(v, Voxel::swap_bytes)));
        return (read > OUTLANDISH && swapped < read / 10.0).then(|| {
            format!(
                "the voxels look byte-swapped: {:.1} % of them are no numbers or of magnitudes like 1e-30 as read, {:.1} % in the opposite byte order; check the byte order",
                100.0 * read,
                100.0 * swapped
            )
        });
    }
    if !matches!(volume.voxel_type(), VoxelType::U16 | VoxelType::I16 | VoxelType::U32 | VoxelType::I32) {
        return None;
    }
    let nx = volume.grid().dims()[0];
    let (read, swapped) =
        with_voxels!(volume.voxels(), v => (roughness(v, nx, |x| x), roughness(v, nx, Voxel::swap_bytes)));
    let (read, swapped) = (read?, swapped?);
    (read > FACTOR * swapped).then(|| {
        format!(
            "the voxels look byte-swapped: neighbours differ by {:.2} % of the range as read, by {:.2} % in the opposite byte order; check the byte order",
            100.0 * read,
            100.0 * swapped
        )
    })
}

/// Mean absolute difference of neighbours along x over the range; `None` when the range is 0 or there are no pairs.
fn roughness<T: Voxel>(voxels: &[T], nx: usize, map: impl Fn(T) -> T) -> Option<f64> {
    let rows = voxels.len() / nx;
    let step = rows.div_ceil((PAIRS / nx).max(1)).max(1);
    let (mut sum, mut pairs) = (0.0, 0u64);
    let (mut min, mut max) = (f64::INFINITY, f64::NEG_INFINITY);
    for row in voxels.chunks_exact(nx).step_by(step) {
        let mut last: Option<f64> = None;
        for &v in row.iter().take(PAIRS) {
            let x = map(v).to_f64();
            min = min.min(x);
            max = max.max(x);
            if let Some(last) = last {
                sum += (x - last).abs();
                pairs += 1;
            }
            last = Some(x);
        }
    }
    (pairs > 0 && max > min).then(|| sum / pairs as f64 / (max - min))
}

/// Share of values, spread evenly, that are neither 0 nor of a plausible magnitude.
fn outlandish<T: Voxel>(voxels: &[T], map: impl Fn(T) -> T) -> f64 {
    let looked = voxels.iter().step_by(voxels.len().div_ceil(PAIRS).max(1));
    let values = looked.map(|&v| map(v).to_f64());
    let (all, odd) = values
        .fold((0u64, 0u64), |(all, odd), x| (all + 1, odd + u64::from(x != 0.0 && !PLAUSIBLE.contains(&x.abs()))));
    odd as f64 / all.max(1) as f64
}
