//! The lanes on x86-64: AVX-512 in one register, AVX2 in two.

use std::arch::x86_64::*;

use super::lanes::{LANES, Row, Simd};

/// Asks for the memory of every lane.
#[inline(always)]
unsafe fn prefetch_each<T>([a, b, c, d]: [*const T; 4], index: &Row<i32>) {
    for &index in index {
        let index = index as isize;
        // SAFETY: every processor with these lanes has the instruction, which reads nothing.
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(a.wrapping_offset(index).cast());
            _mm_prefetch::<_MM_HINT_T0>(b.wrapping_offset(index).cast());
            _mm_prefetch::<_MM_HINT_T0>(c.wrapping_offset(index).cast());
            _mm_prefetch::<_MM_HINT_T0>(d.wrapping_offset(index).cast());
        }
    }
}

/// AVX-512 F.
#[derive(Clone, Copy)]
pub(crate) struct Avx512;

// SAFETY of all blocks in this implementation: the caller promises the instructions (see `Simd`) and the addresses of gathers; loads
// and stores go through references to whole rows.
#[allow(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl Simd for Avx512 {
    type F = __m512;
    type I = __m512i;
    type M = __mmask16;

    #[inline(always)]
    unsafe fn load(a: &Row<f32>) -> __m512 {
        unsafe { _mm512_loadu_ps(a.as_ptr()) }
    }
    #[inline(always)]
    unsafe fn store(v: __m512) -> Row<f32> {
        let mut out = [0.0; LANES];
        unsafe { _mm512_storeu_ps(out.as_mut_ptr(), v) };
        out
    }
    #[inline(always)]
    unsafe fn splat(v: f32) -> __m512 {
        unsafe { _mm512_set1_ps(v) }
    }
    #[inline(always)]
    unsafe fn add(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_add_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn sub(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_sub_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn mul(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_mul_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn min(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_min_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn max(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_max_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn le(a: __m512, b: __m512) -> __mmask16 {
        unsafe { _mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b) }
    }
    #[inline(always)]
    unsafe fn lt(a: __m512, b: __m512) -> __mmask16 {
        unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b) }
    }
    #[inline(always)]
    unsafe fn keep(m: __mmask16, v: __m512) -> __m512 {
        unsafe { _mm512_maskz_mov_ps(m, v) }
    }
    #[inline(always)]
    unsafe fn truncate(v: __m512) -> __m512i {
        unsafe { _mm512_cvttps_epi32(v) }
    }
    #[inline(always)]
    unsafe fn float(v: __m512i) -> __m512 {
        unsafe { _mm512_cvtepi32_ps(v) }
    }
    #[inline(always)]
    unsafe fn iload(a: &Row<i32>) -> __m512i {
        unsafe { _mm512_loadu_si512(a.as_ptr().cast()) }
    }
    #[inline(always)]
    unsafe fn istore(v: __m512i) -> Row<i32> {
        let mut out = [0; LANES];
        unsafe { _mm512_storeu_si512(out.as_mut_ptr().cast(), v) };
        out
    }
    #[inline(always)]
    unsafe fn isplat(v: i32) -> __m512i {
        unsafe { _mm512_set1_epi32(v) }
    }
    #[inline(always)]
    unsafe fn iadd(a: __m512i, b: __m512i) -> __m512i {
        unsafe { _mm512_add_epi32(a, b) }
    }
    #[inline(always)]
    unsafe fn imul(a: __m512i, b: __m512i) -> __m512i {
        unsafe { _mm512_mullo_epi32(a, b) }
    }
    #[inline(always)]
    unsafe fn iand(a: __m512i, b: __m512i) -> __m512i {
        unsafe { _mm512_and_si512(a, b) }
    }
    #[inline(always)]
    unsafe fn ishl<const N: u32>(a: __m512i) -> __m512i {
        unsafe { _mm512_slli_epi32::<N>(a) }
    }
    #[inline(always)]
    unsafe fn ishr<const N: u32>(a: __m512i) -> __m512i {
        unsafe { _mm512_srli_epi32::<N>(a) }
    }
    #[inline(always)]
    unsafe fn isar<const N: u32>(a: __m512i) -> __m512i {
        unsafe { _mm512_srai_epi32::<N>(a) }
    }
    #[inline(always)]
    unsafe fn ikeep(m: __mmask16, v: __m512i) -> __m512i {
        unsafe { _mm512_maskz_mov_epi32(m, v) }
    }
    #[inline(always)]
    unsafe fn float_of_bits(v: __m512i) -> __m512 {
        unsafe { _mm512_castsi512_ps(v) }
    }
    #[inline(always)]
    unsafe fn igt(a: __m512i, b: __m512i) -> __mmask16 {
        unsafe { _mm512_cmpgt_epi32_mask(a, b) }
    }
    #[inline(always)]
    unsafe fn ule(a: __m512i, b: __m512i) -> __mmask16 {
        unsafe { _mm512_cmple_epu32_mask(a, b) }
    }
    #[inline(always)]
    unsafe fn both(a: __mmask16, b: __mmask16) -> __mmask16 {
        a & b
    }
    #[inline(always)]
    unsafe fn bits(m: __mmask16) -> u32 {
        u32::from(m)
    }
    #[inline(always)]
    unsafe fn prefetch<T>(rows: [*const T; 4], index: __m512i) {
        unsafe { prefetch_each(rows, &Self::istore(index)) }
    }
    #[inline(always)]
    unsafe fn gather<const SCALE: i32>(base: *const u8, index: __m512i, mask: __mmask16) -> __m512i {
        unsafe { _mm512_mask_i32gather_epi32::<SCALE>(_mm512_setzero_si512(), mask, index, base.cast()) }
    }
    #[inline(always)]
    unsafe fn gather_pair(base: *const f32, index: __m512i, mask: __mmask16) -> [__m512; 2] {
        // Eight lanes at a time: one load brings both floats.
        unsafe {
            let zero = _mm512_setzero_si512();
            let (near, far) = (_mm512_castsi512_si256(index), _mm512_extracti64x4_epi64::<1>(index));
            let a = _mm512_mask_i32gather_epi64::<4>(zero, mask as __mmask8, near, base.cast());
            let b = _mm512_mask_i32gather_epi64::<4>(zero, (mask >> 8) as __mmask8, far, base.cast());
            let (a, b) = (_mm512_castsi512_ps(a), _mm512_castsi512_ps(b));
            let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let odd = _mm512_setr_epi32(1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
            [_mm512_permutex2var_ps(a, even, b), _mm512_permutex2var_ps(a, odd, b)]
        }
    }
}

/// AVX2.
#[derive(Clone, Copy)]
pub(crate) struct Avx2;

type Halves<T> = [T; 2];

macro_rules! halves {
    ($h:ident => $v:expr) => {{
        let first = {
            let $h = 0;
            $v
        };
        let second = {
            let $h = 1;
            $v
        };
        [first, second]
    }};
}

// SAFETY of all blocks in this implementation: as for AVX-512 above.
#[allow(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl Simd for Avx2 {
    type F = Halves<__m256>;
    type I = Halves<__m256i>;
    /// All bits of a lane set or clear.
    type M = Halves<__m256i>;

    #[inline(always)]
    unsafe fn load(a: &Row<f32>) -> Self::F {
        unsafe { halves!(h => _mm256_loadu_ps(a.as_ptr().add(8 * h))) }
    }
    #[inline(always)]
    unsafe fn store(v: Self::F) -> Row<f32> {
        let mut out = [0.0; LANES];
        unsafe {
            _mm256_storeu_ps(out.as_mut_ptr(), v[0]);
            _mm256_storeu_ps(out.as_mut_ptr().add(8), v[1]);
        }
        out
    }
    #[inline(always)]
    unsafe fn splat(v: f32) -> Self::F {
        unsafe { [_mm256_set1_ps(v); 2] }
    }
    #[inline(always)]
    unsafe fn add(a: Self::F, b: Self::F) -> Self::F {
        unsafe { halves!(h => _mm256_add_ps(a[h], b[h])) }
    }
    #[inline(always)]
    unsafe fn sub(a: Self::F, b: Self::F) -> Self::F {
        unsafe { halves!(h => _mm256_sub_ps(a[h], b[h])) }
    }
    #[inline(always)]
    unsafe fn mul(a: Self::F, b: Self::F) -> Self::F {
        unsafe { halves!(h => _mm256_mul_ps(a[h], b[h])) }
    }
    #[inline(always)]
    unsafe fn min(a: Self::F, b: Self::F) -> Self::F {
        unsafe { halves!(h => _mm256_min_ps(a[h], b[h])) }
    }
    #[inline(always)]
    unsafe fn max(a: Self::F, b: Self::F) -> Self::F {
        unsafe { halves!(h => _mm256_max_ps(a[h], b[h])) }
    }
    #[inline(always)]
    unsafe fn le(a: Self::F, b: Self::F) -> Self::M {
        unsafe { halves!(h => _mm256_castps_si256(_mm256_cmp_ps::<_CMP_LE_OQ>(a[h], b[h]))) }
    }
    #[inline(always)]
    unsafe fn lt(a: Self::F, b: Self::F) -> Self::M {
        unsafe { halves!(h => _mm256_castps_si256(_mm256_cmp_ps::<_CMP_LT_OQ>(a[h], b[h]))) }
    }
    #[inline(always)]
    unsafe fn keep(m: Self::M, v: Self::F) -> Self::F {
        unsafe { halves!(h => _mm256_and_ps(_mm256_castsi256_ps(m[h]), v[h])) }
    }
    #[inline(always)]
    unsafe fn truncate(v: Self::F) -> Self::I {
        unsafe { halves!(h => _mm256_cvttps_epi32(v[h])) }
    }
    #[inline(always)]
    unsafe fn float(v: Self::I) -> Self::F {
        unsafe { halves!(h => _mm256_cvtepi32_ps(v[h])) }
    }
    #[inline(always)]
    unsafe fn iload(a: &Row<i32>) -> Self::I {
        unsafe { halves!(h => _mm256_loadu_si256(a.as_ptr().add(8 * h).cast())) }
    }
    #[inline(always)]
    unsafe fn istore(v: Self::I) -> Row<i32> {
        let mut out = [0; LANES];
        unsafe {
            _mm256_storeu_si256(out.as_mut_ptr().cast(), v[0]);
            _mm256_storeu_si256(out.as_mut_ptr().add(8).cast(), v[1]);
        }
        out
    }
    #[inline(always)]
    unsafe fn isplat(v: i32) -> Self::I {
        unsafe { [_mm256_set1_epi32(v); 2] }
    }
    #[inline(always)]
    unsafe fn iadd(a: Self::I, b: Self::I) -> Self::I {
        unsafe { halves!(h => _mm256_add_epi32(a[h], b[h])) }
    }
    #[inline(always)]
    unsafe fn imul(a: Self::I, b: Self::I) -> Self::I {
        unsafe { halves!(h => _mm256_mullo_epi32(a[h], b[h])) }
    }
    #[inline(always)]
    unsafe fn iand(a: Self::I, b: Self::I) -> Self::I {
        unsafe { halves!(h => _mm256_and_si256(a[h], b[h])) }
    }
    #[inline(always)]
    unsafe fn ishl<const N: u32>(a: Self::I) -> Self::I {
        unsafe { halves!(h => _mm256_sll_epi32(a[h], _mm_cvtsi32_si128(N as i32))) }
    }
    #[inline(always)]
    unsafe fn ishr<const N: u32>(a: Self::I) -> Self::I {
        unsafe { halves!(h => _mm256_srl_epi32(a[h], _mm_cvtsi32_si128(N as i32))) }
    }
    #[inline(always)]
    unsafe fn isar<const N: u32>(a: Self::I) -> Self::I {
        unsafe { halves!(h => _mm256_sra_epi32(a[h], _mm_cvtsi32_si128(N as i32))) }
    }
    #[inline(always)]
    unsafe fn ikeep(m: Self::M, v: Self::I) -> Self::I {
        unsafe { halves!(h => _mm256_and_si256(m[h], v[h])) }
    }
    #[inline(always)]
    unsafe fn float_of_bits(v: Self::I) -> Self::F {
        unsafe { halves!(h => _mm256_castsi256_ps(v[h])) }
    }
    #[inline(always)]
    unsafe fn igt(a: Self::I, b: Self::I) -> Self::M {
        unsafe { halves!(h => _mm256_cmpgt_epi32(a[h], b[h])) }
    }
    #[inline(always)]
    unsafe fn ule(a: Self::I, b: Self::I) -> Self::M {
        unsafe { halves!(h => _mm256_cmpeq_epi32(_mm256_min_epu32(a[h], b[h]), a[h])) }
    }
    #[inline(always)]
    unsafe fn both(a: Self::M, b: Self::M) -> Self::M {
        unsafe { halves!(h => _mm256_and_si256(a[h], b[h])) }
    }
    #[inline(always)]
    unsafe fn bits(m: Self::M) -> u32 {
        unsafe {
            let low = _mm256_movemask_ps(_mm256_castsi256_ps(m[0])) as u32;
            low | (_mm256_movemask_ps(_mm256_castsi256_ps(m[1])) as u32) << 8
        }
    }
    #[inline(always)]
    unsafe fn prefetch<T>(rows: [*const T; 4], index: Self::I) {
        unsafe { prefetch_each(rows, &Self::istore(index)) }
    }
    #[inline(always)]
    unsafe fn gather<const SCALE: i32>(base: *const u8, index: Self::I, mask: Self::M) -> Self::I {
        unsafe {
            halves!(h => _mm256_mask_i32gather_epi32::<SCALE>(_mm256_setzero_si256(), base.cast(), index[h], mask[h]))
        }
    }
    #[inline(always)]
    unsafe fn gather_pair(base: *const f32, index: Self::I, mask: Self::M) -> [Self::F; 2] {
        unsafe {
            let zero = _mm256_setzero_ps();
            let m = halves!(h => _mm256_castsi256_ps(mask[h]));
            [
                halves!(h => _mm256_mask_i32gather_ps::<4>(zero, base, index[h], m[h])),
                halves!(h => _mm256_mask_i32gather_ps::<4>(zero, base.add(1), index[h], m[h])),
            ]
        }
    }
}
