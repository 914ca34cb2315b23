//! Finding the voxels of many rising targets of one brick at once, with AVX-512.
//!
//! Where a brick holds many targets, they fall into runs that share a row of 16 voxels. The ends of the runs are found for all 16
//! rows together, by counting or by one binary search whose steps are gathers; in a run, 16 targets at a time are searched within the row's 16
//! sums, which stay in a register; so do the coordinates of the row's voxels, of which each target takes its own.

use crate::order::BRICK;

/// Targets in a brick from which on this is the quicker way.
pub(crate) const MANY: usize = 32;

/// Extents of the two inner axes of nested lines of voxels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lines {
    /// Voxels of a line.
    pub inner: u32,
    /// Lines of a plane; at least as many as a brick can touch, and one more.
    pub middle: u32,
}

impl Lines {
    /// `None` where a brick may wrap around the middle axis more than once.
    pub(crate) fn new(inner: usize, middle: usize) -> Option<Self> {
        let touched = BRICK.div_ceil(inner) + 1;
        let (inner, middle) =
            (u32::try_from(inner).ok()?, u32::try_from(middle).ok().filter(|m| *m as usize >= touched)?);
        Some(Self { inner, middle })
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use std::arch::x86_64::*;

    use super::Lines;
    use crate::locate::{BrickSums, ROW};

    /// Targets up to which it is quicker to compare all of them with all rows.
    const FEW: usize = 256;

    /// For each row the number of targets before its end, that is below its last sum.
    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn row_ends(brick: &BrickSums<u32>, targets: &[u64], before: u64) -> [u32; ROW] {
        if targets.len() <= FEW {
            ends_by_counting(brick, targets, before)
        } else {
            ends_by_halving(brick, targets, before)
        }
    }

    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn ends_by_counting(brick: &BrickSums<u32>, targets: &[u64], before: u64) -> [u32; ROW] {
        let mut ends = [0; ROW];
        let offset = _mm512_set1_epi32(before as u32 as i32);
        for from in (0..targets.len()).step_by(ROW) {
            let (target, mask) = sixteen(&targets[from..], offset);
            for (end, row) in ends.iter_mut().zip(brick.rows()) {
                *end += _mm512_mask_cmplt_epu32_mask(mask, target, _mm512_set1_epi32(*row as i32)).count_ones();
            }
        }
        ends
    }

    /// The first 16 targets of a slice, or as many as it has, less `offset`, and which lanes hold one.
    #[inline]
    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn sixteen(targets: &[u64], offset: __m512i) -> (__m512i, u16) {
        let low_words = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
        let many = targets.len().min(ROW);
        let mask = (0xffffu32 >> (ROW - many)) as u16;
        // SAFETY: masked off beyond the slice.
        let (a, b) = unsafe {
            let at: *const i64 = targets.as_ptr().cast();
            let a = _mm512_maskz_loadu_epi64(mask as u8, at);
            (a, _mm512_maskz_loadu_epi64((mask >> 8) as u8, at.wrapping_add(8)))
        };
        (_mm512_sub_epi32(_mm512_permutex2var_epi32(a, low_words, b), offset), mask)
    }

    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn ends_by_halving(brick: &BrickSums<u32>, targets: &[u64], before: u64) -> [u32; ROW] {
        let n = targets.len();
        // SAFETY: 16 words of 32 bits are read from an array of 16.
        let rows = unsafe { _mm512_loadu_si512(brick.rows().as_ptr().cast()) };
        let before = _mm512_set1_epi32(before as i32);
        let count = _mm512_set1_epi32(n as i32);
        let mut ends = _mm512_setzero_si512();
        let mut step = n.next_power_of_two();
        while step > 0 {
            // The target that would be the last of so many more.
            let at = _mm512_add_epi32(ends, _mm512_set1_epi32(step as i32 - 1));
            let there = _mm512_cmplt_epu32_mask(at, count);
            let zero = _mm512_setzero_si512();
            // SAFETY: only lanes whose index is below the number of targets are read: the lower half of a 64-bit word each.
            let low = unsafe { _mm512_mask_i32gather_epi32::<8>(zero, there, at, targets.as_ptr().cast()) };
            let below = _mm512_mask_cmplt_epu32_mask(there, _mm512_sub_epi32(low, before), rows);
            ends = _mm512_mask_add_epi32(ends, below, ends, _mm512_set1_epi32(step as i32));
            step /= 2;
        }
        let mut out = [0; ROW];
        // SAFETY: 16 words are written to an array of 16.
        unsafe { _mm512_storeu_si512(out.as_mut_ptr().cast(), ends) };
        out
    }

    /// Writes the coordinates along the inner, the middle and the outer axis of all targets' voxels. The brick begins at `start`;
    /// its total is below 2^32, and the targets rise from `before` on and stay below `before` plus the total.
    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    pub(crate) fn place(
        brick: &BrickSums<u32>,
        targets: &[u64],
        before: u64,
        start: [u32; 3],
        lines: Lines,
        out: [&mut [u32]; 3],
    ) {
        let n = targets.len();
        let [x, y, z] = out;
        let (x, y, z) = (&mut x[..n], &mut y[..n], &mut z[..n]);
        let ends = row_ends(brick, targets, before);
        let splat = |v: u32| _mm512_set1_epi32(v as i32);
        let lane = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
        let offset = splat(before as u32);
        let mut from = 0;
        for (row, &end) in ends.iter().enumerate() {
            let end = end as usize;
            if end == from {
                continue;
            }
            // SAFETY: the row is below 16, so its 16 words lie within the 256.
            let sums = unsafe { _mm512_loadu_si512(brick.sums.as_ptr().add(row * ROW).cast()) };
            let [rx, ry, rz] = coordinates(start, (row * ROW) as u32, lines, lane);
            while from < end {
                let many = (end - from).min(ROW);
                let mask = (0xffffu32 >> (ROW - many)) as u16;
                let (target, _) = sixteen(&targets[from..from + many], offset);
                // The number of sums of the row that do not exceed the target, which the last one does.
                let m = _mm512_cmple_epu32_mask(_mm512_permutexvar_epi32(splat(7), sums), target);
                let mut c = _mm512_maskz_mov_epi32(m, splat(8));
                let m = _mm512_cmple_epu32_mask(_mm512_permutexvar_epi32(_mm512_add_epi32(c, splat(3)), sums), target);
                c = _mm512_mask_add_epi32(c, m, c, splat(4));
                let m = _mm512_cmple_epu32_mask(_mm512_permutexvar_epi32(_mm512_add_epi32(c, splat(1)), sums), target);
                c = _mm512_mask_add_epi32(c, m, c, splat(2));
                let m = _mm512_cmple_epu32_mask(_mm512_permutexvar_epi32(c, sums), target);
                c = _mm512_mask_add_epi32(c, m, c, splat(1));
                // SAFETY: masked off beyond the run, which ends within the three slices of `n` words.
                unsafe {
                    _mm512_mask_storeu_epi32(x.as_mut_ptr().add(from).cast(), mask, _mm512_permutexvar_epi32(c, rx));
                    _mm512_mask_storeu_epi32(y.as_mut_ptr().add(from).cast(), mask, _mm512_permutexvar_epi32(c, ry));
                    _mm512_mask_storeu_epi32(z.as_mut_ptr().add(from).cast(), mask, _mm512_permutexvar_epi32(c, rz));
                }
                from += many;
            }
        }
    }

    /// Coordinates of 16 voxels from position `first` of a brick on.
    #[inline]
    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn coordinates(start: [u32; 3], first: u32, lines: Lines, lane: __m512i) -> [__m512i; 3] {
        let splat = |v: u32| _mm512_set1_epi32(v as i32);
        let one = splat(1);
        let inner = splat(lines.inner);
        let mut x = _mm512_add_epi32(splat(start[0] + first), lane);
        let mut y = splat(start[1]);
        let mut z = splat(start[2]);
        if lines.inner >= crate::order::BRICK as u32 {
            let over = _mm512_cmpge_epu32_mask(x, inner);
            x = _mm512_mask_sub_epi32(x, over, x, inner);
            y = _mm512_mask_add_epi32(y, over, y, one);
        } else {
            // Below 512 both: the quotient's error, below 512 × 2^-23, is far less than the distance 1/(2n) of (l + 1/2)/n from
            // an integer.
            let inverse = _mm512_set1_ps(1.0 / lines.inner as f32);
            let q = _mm512_mul_ps(_mm512_add_ps(_mm512_cvtepi32_ps(x), _mm512_set1_ps(0.5)), inverse);
            let q = _mm512_cvttps_epi32(q);
            x = _mm512_sub_epi32(x, _mm512_mullo_epi32(q, inner));
            y = _mm512_add_epi32(y, q);
        }
        let over = _mm512_cmpge_epu32_mask(y, splat(lines.middle));
        y = _mm512_mask_sub_epi32(y, over, y, splat(lines.middle));
        z = _mm512_mask_add_epi32(z, over, z, one);
        [x, y, z]
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use avx512::place;

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;
    use crate::SimdLevel;
    use crate::locate::BrickSums;
    use crate::rng::mix;

    /// Against the plain search and division, for bricks full, sparse and of one voxel, lines short and long, any place of the brick.
    #[test]
    fn rising_targets_find_their_voxels_and_coordinates() {
        if SimdLevel::detect() != SimdLevel::Avx512 {
            return;
        }
        let weights: [fn(u64) -> u64; 5] = [
            |i| 1 + i % 7,
            |i| u64::from(i % 17 == 3) * 90,
            |i| u64::from(i == 200) * 5000,
            |i| mix(i) >> 42,
            |i| u64::from(i >= 250) * 300,
        ];
        for (case, weight) in weights.into_iter().enumerate() {
            let mut brick = BrickSums::<u32>::new();
            let mut sum = 0;
            for (i, s) in brick.sums.iter_mut().enumerate() {
                sum += weight(i as u64);
                *s = sum as u32;
            }
            brick.index();
            let before = (7 << 32) - 100;
            for n in [1, 2, 15, 16, 17, 64, 300, 2048] {
                let mut targets: Vec<u64> = (0..n).map(|k| before + mix(k) % sum).collect();
                targets.extend([before, before + sum - 1]);
                targets.sort_unstable();
                let targets = &targets[..];
                for (inner, middle, start) in [
                    (1, 400, [0, 300, 2]),
                    (7, 50, [6, 49, 0]),
                    (56, 301, [55, 298, 9]),
                    (256, 3, [255, 2, 4]),
                    (700, 2, [699, 1, 0]),
                ] {
                    let lines = Lines::new(inner, middle).expect("lines");
                    let mut out = [(); 3].map(|()| vec![0u32; targets.len()]);
                    let [x, y, z] = out.each_mut().map(|v| &mut v[..]);
                    // SAFETY: the processor has what the function needs.
                    unsafe { place(&brick, targets, before, start, lines, [x, y, z]) };
                    for (k, target) in targets.iter().enumerate() {
                        let at = start[0] as usize + brick.find((target - before) as u32) as usize;
                        let line = start[1] as usize + at / inner;
                        let expected = [at % inner, line % middle, start[2] as usize + line / middle];
                        assert_eq!([0, 1, 2].map(|a: usize| out[a][k] as usize), expected, "{case} {n} {inner} {k}");
                    }
                }
            }
        }
    }

    #[test]
    fn lines_that_a_brick_would_wrap_around_twice_are_left_to_the_plain_code() {
        assert!(Lines::new(56, 5).is_none() && Lines::new(56, 6).is_some() && Lines::new(256, 1).is_none());
        assert!(Lines::new(1, 256).is_none() && Lines::new(1, 257).is_some());
    }
}
