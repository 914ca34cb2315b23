//! Sums of ramps with AVX2: all figures in one pass of registers, bytes added up eight at once (`vpsadbw`).

use std::arch::x86_64::*;

use super::ramp::Sums;

/// Vectors whose lanes are counted in the voxels' own width before they overflow.
const ROWS: usize = 128;

/// Sums over voxels in whole vectors, and the voxels left over. `flip` turns stored bits into ordinals; without `NEGATIVE` the
/// zero is the smallest ordinal.
macro_rules! sums {
    (
        $name:ident, $t:ty, $signed:ty, $lanes:literal, $splat:ident, $over:ident, $less:ident, $max:ident, $min:ident, $same:ident, $sum:ident
    ) => {
        #[target_feature(enable = "avx2,popcnt")]
        pub(super) fn $name<const NEGATIVE: bool>(voxels: &[$t], flip: $t, zero: $t) -> (Sums, &[$t]) {
            let (rows, rest) = voxels.as_chunks::<$lanes>();
            let none = _mm256_setzero_si256();
            // Less `zero + 1`, so that all that is not above it wraps round to the largest numbers.
            let least = $splat(zero.wrapping_add(1) as $signed);
            let (flip, from) = ($splat(flip as $signed), $splat(zero as $signed));
            let (mut positive, mut negative) = (none, none);
            let (mut largest, mut smallest) = (none, _mm256_set1_epi8(-1));
            // Voxels that are not above the zero, and not below it.
            let (mut not_above, mut not_below) = (0, 0);
            for part in rows.chunks(ROWS) {
                let (mut a, mut b) = (none, none);
                for row in part {
                    let v = _mm256_xor_si256(bytemuck::pod_read_unaligned(bytemuck::bytes_of(row)), flip);
                    let above = $over(v, from);
                    positive = _mm256_add_epi64(positive, $sum(above));
                    a = $less(a, $same(above, none));
                    largest = $max(largest, v);
                    smallest = $min(smallest, $less(v, least));
                    if NEGATIVE {
                        let below = $over(from, v);
                        negative = _mm256_add_epi64(negative, $sum(below));
                        b = $less(b, $same(below, none));
                    }
                }
                for (count, lanes) in [(&mut not_above, a), (&mut not_below, b)] {
                    let lanes: [$t; $lanes] = bytemuck::cast(lanes);
                    for lane in lanes {
                        *count += u64::from(lane);
                    }
                }
            }
            let voxels = (rows.len() * $lanes) as u64;
            let total = |sums: __m256i| {
                let [a, b, c, d]: [u64; 4] = bytemuck::cast(sums);
                a + b + c + d
            };
            let (largest, smallest): ([$t; $lanes], [$t; $lanes]) = (bytemuck::cast(largest), bytemuck::cast(smallest));
            let sums = Sums {
                positive: total(positive),
                negative: total(negative),
                above: voxels - not_above,
                below: if NEGATIVE { voxels - not_below } else { 0 },
                largest: largest.into_iter().fold(0, <$t>::max).into(),
                // Used only where some voxel is above the zero, and then it is one.
                smallest: u64::from(smallest.into_iter().fold(<$t>::MAX, <$t>::min)) + u64::from(zero) + 1,
            };
            (sums, rest)
        }
    };
}

/// Four sums of 8 bytes.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn sum_bytes(v: __m256i) -> __m256i {
    _mm256_sad_epu8(v, _mm256_setzero_si256())
}

/// Four sums of 4 words: of their lower and of their upper bytes.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn sum_words(v: __m256i) -> __m256i {
    let (low, high) = (_mm256_and_si256(v, _mm256_set1_epi16(255)), _mm256_srli_epi16::<8>(v));
    _mm256_add_epi64(sum_bytes(low), _mm256_slli_epi64::<8>(sum_bytes(high)))
}

sums!(
    bytes,
    u8,
    i8,
    32,
    _mm256_set1_epi8,
    _mm256_subs_epu8,
    _mm256_sub_epi8,
    _mm256_max_epu8,
    _mm256_min_epu8,
    _mm256_cmpeq_epi8,
    sum_bytes
);
sums!(
    words,
    u16,
    i16,
    16,
    _mm256_set1_epi16,
    _mm256_subs_epu16,
    _mm256_sub_epi16,
    _mm256_max_epu16,
    _mm256_min_epu16,
    _mm256_cmpeq_epi16,
    sum_words
);
