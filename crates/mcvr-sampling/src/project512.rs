//! The projection in 32 bits by AVX-512 instructions: the `tent` kernel, and points that are there already.
//!
//! The same operations in the same order as [`land`](crate::project::land) and [`TentOffset`](crate::offset::TentOffset), so the
//! same bits (a test holds them to it). What the compiler's version of those waits for is the one unit that divides and takes
//! square roots, for 18 cycles a root of 16 numbers. Here two roots of three are taken by Newton's method on the other units.

use std::arch::x86_64::*;

use crate::project::{Lost, Params, Weigh};

/// Samples at a time.
const LANES: usize = 16;

/// A view's numbers, one to a register.
struct View {
    rows: [[__m512; 3]; 3],
    shift: [__m512; 3],
    near: __m512,
    size: [__m512; 2],
    stride: __m512i,
    miss: [__m512i; 2],
    middle: [__m512; 2],
    stretch: [__m512; 6],
    scale: __m512,
    largest: __m512,
}

impl View {
    #[inline]
    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn new(p: &Params<f32>) -> Self {
        let all = |v: f32| _mm512_set1_ps(v);
        let row = |r: [f32; 3]| [all(r[0]), all(r[1]), all(r[2])];
        let [r0, r1, r2] = p.rows;
        let [a, b, c, d, e, f] = p.stretch;
        Self {
            rows: [row(r0), row(r1), row(r2)],
            shift: row(p.shift),
            near: all(p.near),
            size: [all(p.width), all(p.height)],
            stride: _mm512_set1_epi32(p.stride),
            miss: [_mm512_set1_epi32(p.miss), _mm512_set1_epi32(p.miss + 1)],
            middle: [all(p.middle[0]), all(p.middle[1])],
            stretch: [all(a), all(b), all(c), all(d), all(e), all(f)],
            scale: all(p.scale),
            largest: all(p.largest),
        }
    }
}

/// Square roots of numbers `k / 2^23` with odd k below 2^23: one step of Newton's method from an estimate to 14 bits, then one with
/// the exact remainder. The fused operations here are exact corrections, not contractions: the result is the nearest number,
/// which a test checks for all 2^22 arguments.
#[inline]
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn roots_by_newton(x: __m512) -> __m512 {
    let half = _mm512_set1_ps(0.5);
    let y = _mm512_rsqrt14_ps(x);
    let s = _mm512_mul_ps(x, y);
    let h = _mm512_mul_ps(y, half);
    let r = _mm512_fnmadd_ps(s, h, half);
    let (s, h) = (_mm512_fmadd_ps(s, r, s), _mm512_fmadd_ps(h, r, h));
    let remainder = _mm512_fnmadd_ps(s, s, x);
    _mm512_fmadd_ps(remainder, h, s)
}

/// Offsets under `tent`: `±(√(2 min(u, 1-u)) - 1)`. Of a word's upper 23 bits k, u is `(2k + 1) / 2^24`.
#[inline]
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn tent<const NEWTON: bool>(words: __m512i) -> __m512 {
    let odd = _mm512_or_si512(_mm512_srli_epi32::<8>(words), _mm512_set1_epi32(1));
    let folded = _mm512_min_epu32(odd, _mm512_sub_epi32(_mm512_set1_epi32(1 << 24), odd));
    let twice = _mm512_mul_ps(_mm512_cvtepi32_ps(folded), _mm512_set1_ps(1.0 / (1 << 23) as f32));
    let t = _mm512_sub_ps(if NEWTON { roots_by_newton(twice) } else { _mm512_sqrt_ps(twice) }, _mm512_set1_ps(1.0));
    // The other sign from u = 1/2 on: where the highest bit is set. (0xf8: a ^ (b & c) is 0x78.)
    let bits = _mm512_ternarylogic_epi32::<0x78>(_mm512_castps_si512(t), words, _mm512_set1_epi32(i32::MIN));
    _mm512_castsi512_ps(bits)
}

/// What becomes of 16 samples.
struct Landed {
    pixels: __m512i,
    weights: __m512i,
    ahead: u16,
    inside: u16,
}

/// A row of the camera's matrix times a position.
#[inline]
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn row(v: &View, r: usize, x: [__m512; 3]) -> __m512 {
    let [a, b, c] = v.rows[r];
    let ab = _mm512_add_ps(_mm512_mul_ps(a, x[0]), _mm512_mul_ps(b, x[1]));
    _mm512_add_ps(ab, _mm512_add_ps(_mm512_mul_ps(c, x[2]), v.shift[r]))
}

/// Projects samples at `x`, in voxels from the grid's centre voxel.
#[inline]
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn land<E: Weigh>(v: &View, x: [__m512; 3]) -> Landed {
    let zero = _mm512_setzero_ps();
    let depth = row(v, 2, x);
    let inverse = _mm512_div_ps(_mm512_set1_ps(1.0), depth);
    let (px, py) = (_mm512_mul_ps(row(v, 0, x), inverse), _mm512_mul_ps(row(v, 1, x), inverse));
    let ahead = _mm512_cmp_ps_mask::<_CMP_GE_OQ>(depth, v.near);
    let inside = _mm512_mask_cmp_ps_mask::<_CMP_GE_OQ>(ahead, px, zero);
    let inside = _mm512_mask_cmp_ps_mask::<_CMP_LT_OQ>(inside, px, v.size[0]);
    let inside = _mm512_mask_cmp_ps_mask::<_CMP_GE_OQ>(inside, py, zero);
    let inside = _mm512_mask_cmp_ps_mask::<_CMP_LT_OQ>(inside, py, v.size[1]);
    // Beside the image the integers are anything, and not used.
    let line = _mm512_mullo_epi32(_mm512_cvttps_epi32(py), v.stride);
    let index = _mm512_add_epi32(line, _mm512_cvttps_epi32(px));
    let other = _mm512_mask_mov_epi32(v.miss[1], ahead, v.miss[0]);
    let pixels = _mm512_mask_mov_epi32(other, inside, index);
    if !E::LINE {
        return Landed { pixels, weights: _mm512_setzero_si512(), ahead, inside };
    }
    let (dx, dy) = (_mm512_sub_ps(px, v.middle[0]), _mm512_sub_ps(py, v.middle[1]));
    let s = &v.stretch;
    let along = _mm512_add_ps(_mm512_add_ps(s[1], _mm512_mul_ps(dx, s[3])), _mm512_mul_ps(dy, s[4]));
    let across = _mm512_add_ps(s[2], _mm512_mul_ps(dy, s[5]));
    let q = _mm512_add_ps(_mm512_add_ps(s[0], _mm512_mul_ps(dx, along)), _mm512_mul_ps(dy, across));
    let g = _mm512_mul_ps(_mm512_mul_ps(_mm512_sqrt_ps(q), _mm512_mul_ps(inverse, inverse)), v.scale);
    // The second operand where one is not a number.
    let bounded = _mm512_min_ps(g, v.largest);
    let good = _mm512_mask_cmp_ps_mask::<_CMP_GE_OQ>(inside, bounded, zero);
    let weights = _mm512_maskz_cvttps_epi32(good, _mm512_add_ps(bounded, _mm512_set1_ps(0.5)));
    Landed { pixels, weights, ahead, inside }
}

/// Samples of a batch: 16 from `at` on, or the last ones of the batch, fewer.
#[derive(Clone, Copy)]
struct Part<const ALL: bool> {
    at: usize,
    many: usize,
}

impl<const ALL: bool> Part<ALL> {
    /// A mask of the lanes in use.
    #[inline]
    fn mask(self) -> u16 {
        if ALL { 0xffff } else { (0xffffu32 >> (LANES - self.many)) as u16 }
    }

    #[inline]
    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn words(self, slice: &[u32]) -> __m512i {
        let slice = &slice[self.at..self.at + self.many];
        // SAFETY: the slice has 16 words, or the load is masked off beyond it.
        unsafe {
            match ALL {
                true => _mm512_loadu_si512(slice.as_ptr().cast()),
                false => _mm512_maskz_loadu_epi32(self.mask(), slice.as_ptr().cast()),
            }
        }
    }

    #[inline]
    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn numbers(self, slice: &[f32]) -> __m512 {
        let slice = &slice[self.at..self.at + self.many];
        // SAFETY: as in `words`.
        unsafe {
            match ALL {
                true => _mm512_loadu_ps(slice.as_ptr()),
                false => _mm512_maskz_loadu_ps(self.mask(), slice.as_ptr()),
            }
        }
    }

    /// Asks for the memory that the batch after this one will want: while samples are added to the image, nothing else would be read.
    #[inline]
    fn expect<T>(self, slice: &[T]) {
        let at = slice.as_ptr().wrapping_add(self.at + crate::BLOCK);
        // SAFETY: a hint, for any address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(at.cast()) };
    }

    #[inline]
    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn fractions(self, slice: &[u16]) -> __m512 {
        let slice = &slice[self.at..self.at + self.many];
        // SAFETY: as in `words`.
        let halves = unsafe {
            match ALL {
                true => _mm256_loadu_si256(slice.as_ptr().cast()),
                false => _mm256_maskz_loadu_epi16(self.mask(), slice.as_ptr().cast()),
            }
        };
        _mm512_cvtepi32_ps(_mm512_cvtepu16_epi32(halves))
    }

    #[inline]
    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn store(self, words: __m512i, slice: &mut [u32]) {
        let slice = &mut slice[self.at..self.at + self.many];
        // SAFETY: as in `words`.
        unsafe {
            match ALL {
                true => _mm512_storeu_si512(slice.as_mut_ptr().cast(), words),
                false => _mm512_mask_storeu_epi32(slice.as_mut_ptr().cast(), self.mask(), words),
            }
        }
    }

    /// Writes what became of the samples, and counts those that are in no pixel.
    #[inline]
    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn keep<E: Weigh>(self, landed: &Landed, pixels: &mut [u32], weights: &mut [u32], lost: &mut Lost) {
        self.store(landed.pixels, pixels);
        if E::LINE {
            self.store(landed.weights, weights);
        }
        lost.beside += (landed.ahead & !landed.inside & self.mask()).count_ones();
        lost.near += (!landed.ahead & self.mask()).count_ones();
    }
}

/// Runs a step on all parts of `0..n`: `$part` is each in turn.
macro_rules! in_parts {
    ($n:expr, $part:ident => $step:expr) => {
        let n = $n;
        for at in (0..n / LANES * LANES).step_by(LANES) {
            let $part = Part::<true> { at, many: LANES };
            $step;
        }
        if n % LANES > 0 {
            let $part = Part::<false> { at: n / LANES * LANES, many: n % LANES };
            $step;
        }
    };
}

/// Samples at voxels, offset by `tent`. All slices are as long as `pixels`, but for `weights` under `count`.
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(crate) fn project_tent<E: Weigh>(
    p: &Params<f32>,
    [i, j, k]: [&[u32]; 3],
    [u, v, w]: [&[u32]; 3],
    pixels: &mut [u32],
    weights: &mut [u32],
) -> Lost {
    let view = View::new(p);
    let mut lost = Lost::default();
    in_parts!(pixels.len(), part => {
        let x = _mm512_add_ps(voxel(part.words(i), p.centre[0]), tent::<false>(part.words(u)));
        let y = _mm512_add_ps(voxel(part.words(j), p.centre[1]), tent::<true>(part.words(v)));
        let z = _mm512_add_ps(voxel(part.words(k), p.centre[2]), tent::<true>(part.words(w)));
        part.keep::<E>(&land::<E>(&view, [x, y, z]), pixels, weights, &mut lost);
    });
    lost
}

/// Voxel coordinates from the centre's.
#[inline]
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn voxel(places: __m512i, centre: i32) -> __m512 {
    _mm512_cvtepi32_ps(_mm512_sub_epi32(places, _mm512_set1_epi32(centre)))
}

/// Points whose positions are stored. All slices are as long as `pixels`, but for `weights` under `count`.
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(crate) fn project_stored<E: Weigh>(
    p: &Params<f32>,
    [x, y, z]: [&[f32]; 3],
    pixels: &mut [u32],
    weights: &mut [u32],
) -> Lost {
    let view = View::new(p);
    let mut lost = Lost::default();
    in_parts!(pixels.len(), part => {
        part.expect(x);
        part.expect(y);
        part.expect(z);
        let landed = land::<E>(&view, [part.numbers(x), part.numbers(y), part.numbers(z)]);
        part.keep::<E>(&landed, pixels, weights, &mut lost);
    });
    lost
}

/// Points in fractions of a brick, whose view this is. All slices are as long as `pixels`, but for `weights` under `count`.
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub(crate) fn project_words<E: Weigh>(
    p: &Params<f32>,
    [x, y, z]: [&[u16]; 3],
    pixels: &mut [u32],
    weights: &mut [u32],
) -> Lost {
    let view = View::new(p);
    let mut lost = Lost::default();
    in_parts!(pixels.len(), part => {
        part.expect(x);
        part.expect(y);
        part.expect(z);
        let landed = land::<E>(&view, [part.fractions(x), part.fractions(y), part.fractions(z)]);
        part.keep::<E>(&landed, pixels, weights, &mut lost);
    });
    lost
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SimdLevel;
    use crate::offset::{Offset, TentOffset};

    #[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn offsets<const NEWTON: bool>(words: &[u32; LANES]) -> [f32; LANES] {
        let mut out = [0.0; LANES];
        // SAFETY: 16 words are read from an array of 16, and as many written.
        unsafe {
            let t = tent::<NEWTON>(_mm512_loadu_si512(words.as_ptr().cast()));
            _mm512_storeu_ps(out.as_mut_ptr(), t);
        }
        out
    }

    /// All 2^23 uniforms that 32-bit offsets know.
    #[test]
    fn every_offset_is_that_of_the_plain_code_whichever_way_its_root_is_taken() {
        if SimdLevel::detect() != SimdLevel::Avx512 {
            return;
        }
        for first in (0..1u32 << 23).step_by(LANES) {
            let words: [u32; LANES] = std::array::from_fn(|l| (first + l as u32) << 9 | (first >> 3 & 511));
            let plain = words.map(|w| TentOffset::offset::<f32>([w; 3])[0].to_bits());
            // SAFETY: the processor has what the functions need.
            let (roots, newton) = unsafe { (offsets::<false>(&words), offsets::<true>(&words)) };
            assert_eq!(roots.map(f32::to_bits), plain, "{first}");
            assert_eq!(newton.map(f32::to_bits), plain, "{first}");
        }
    }
}
