//! Sums over voxels of more than 16 bits.

use mcvr_volume::Voxel;
use rayon::prelude::*;

use super::{Tally, smaller};

/// Voxels that are summed one after the other: sums do not depend on the number of threads.
const CHUNK: usize = 1 << 16;
/// Chunks that are summed side by side, since one sum has to wait for each of its additions.
const LANES: usize = 8;
/// Voxels of a chunk that are weighed together.
const STEP: usize = 64;

/// The sums over voxels that weigh `weight(stored)`. Chunks are fixed and joined pairwise in order, so the error of the sum
/// grows with the logarithm of the number of chunks.
pub(super) fn tally<T: Voxel>(voxels: &[T], weight: impl Fn(f64) -> f64 + Sync) -> Tally {
    let chunks: Vec<Tally> = voxels
        .par_chunks(CHUNK * LANES)
        .flat_map_iter(|group| {
            let full = group.len() == CHUNK * LANES;
            let side_by_side = full.then(|| lanes(group, &weight).to_vec());
            side_by_side.unwrap_or_else(|| group.chunks(CHUNK).map(|chunk| one(chunk, &weight)).collect())
        })
        .collect();
    pairwise(&chunks)
}

/// One chunk, voxel by voxel.
fn one<T: Voxel>(chunk: &[T], weight: &impl Fn(f64) -> f64) -> Tally {
    let mut tally = Tally::default();
    for v in chunk {
        tally.add(weight(v.to_f64()), 1);
    }
    tally
}

// Several chunks at once, each with the same sums as `one` gives.
avx2! {
    fn lanes [T: Voxel, W: Fn(f64) -> f64] [T, W] (group: &[T], weight: &W) -> [Tally; LANES] {
    let mut tallies = [Tally::default(); LANES];
    let mut sums = [0.0; LANES];
    let mut kept = [[0.0; STEP]; LANES];
    for at in (0..CHUNK).step_by(STEP) {
        for (lane, kept) in kept.iter_mut().enumerate() {
            let stored = &group[lane * CHUNK + at..][..STEP];
            let (mut positive, mut others) = (0u64, 0u64);
            let (mut max, mut min) = (0.0f64, f64::INFINITY);
            for (w, v) in kept.iter_mut().zip(stored) {
                let plain = weight(v.to_f64());
                let usable = (plain > 0.0) & (plain < f64::INFINITY);
                positive += u64::from(usable);
                // Negative, infinite or no number.
                others += u64::from(!(0.0..f64::INFINITY).contains(&plain));
                *w = if usable { plain } else { 0.0 };
                max = if *w > max { *w } else { max };
                let candidate = if usable { plain } else { f64::INFINITY };
                min = if candidate < min { candidate } else { min };
            }
            let tally = &mut tallies[lane];
            tally.positive += positive;
            tally.max = tally.max.max(max);
            tally.min = smaller(tally.min, if positive > 0 { min } else { 0.0 });
            if others > 0 {
                for v in stored {
                    let w = weight(v.to_f64());
                    // Positive ones are in already.
                    if !(w > 0.0 && w.is_finite()) {
                        tally.add(w, 1);
                    }
                }
            }
        }
        // Adding 0 changes no sum.
        for i in 0..STEP {
            for (sum, kept) in sums.iter_mut().zip(&kept) {
                    *sum += kept[i];
                }
        }
    }
    for (tally, sum) in tallies.iter_mut().zip(sums) {
        tally.sum = sum;
    }
    tallies
}
}

fn pairwise(tallies: &[Tally]) -> Tally {
    match tallies {
        [] => Tally::default(),
        [one] => *one,
        _ => {
            let (a, b) = tallies.split_at(tallies.len() / 2);
            pairwise(a).join(pairwise(b))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_side_by_side_have_the_sums_that_each_has_alone() {
        let noise = |i: usize| ((i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 33) as f32 / (1u64 << 31) as f32;
        let plain: Vec<f32> = (0..CHUNK * LANES).map(|i| noise(i) - 0.01).collect();
        let mut odd = plain.clone();
        odd[77] = f32::NAN;
        odd[CHUNK + 3] = f32::INFINITY;
        odd[CHUNK + 4] = f32::NEG_INFINITY;
        odd[5 * CHUNK..6 * CHUNK].fill(0.0);
        for voxels in [plain, odd] {
            let weight = |s: f64| 1.7 * s - 0.2;
            let expected: Vec<Tally> = voxels.chunks(CHUNK).map(|c| one(c, &weight)).collect();
            assert_eq!(lanes(&voxels, &weight).to_vec(), expected);
            assert_eq!(lanes::portable(&voxels, &weight).to_vec(), expected);
        }
    }
}
