//! Whether integers were read with their bytes in the wrong order: scans are smooth, byte-swapped scans are not.

use crate::{Volume, Voxel, VoxelType};

/// Pairs of neighbours that are looked at, at most.
const PAIRS: usize = 1 << 20;
/// How many times smoother the swapped reading must be.
const FACTOR: f64 = 3.0;

/// Says so when 16- or 32-bit integers would be far smoother with their bytes in the opposite order.
///
/// Smoothness is the mean absolute difference of neighbours along x over the range of the values, on rows spread
/// evenly over the volume (a million pairs at most, so that it takes milliseconds). `None` when nothing is suspicious,
/// for 8-bit and float voxels, and for values all of whose bytes but one are 0, which the test cannot tell.
pub fn byte_order_suspicion(volume: &Volume) -> Option<String> {
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
