//! Sixteen lanes of 32-bit numbers: one interface, three sets of instructions, the same bits.
//!
//! Every operation is one IEEE operation per lane, and none is fused, so the results do not depend on the instructions. The
//! functions are `unsafe` because they may only run where the processor has the instructions: inside a function compiled
//! for them (see [`mcvr_volume::SimdLevel`]).

/// Rays in a packet.
pub(crate) const LANES: usize = 16;

/// One value per lane.
pub(crate) type Row<T> = [T; LANES];

/// Sixteen floats, sixteen integers, sixteen truths, and what can be done with them.
///
/// # Safety
/// All functions require the processor to have the implementor's instructions; gathers require every address of a lane
/// whose mask is set to be readable for the stated number of bytes.
pub(crate) trait Simd: Copy + Send + Sync + 'static {
    type F: Copy;
    type I: Copy;
    type M: Copy;

    unsafe fn load(a: &Row<f32>) -> Self::F;
    unsafe fn store(v: Self::F) -> Row<f32>;
    unsafe fn splat(v: f32) -> Self::F;
    unsafe fn add(a: Self::F, b: Self::F) -> Self::F;
    unsafe fn sub(a: Self::F, b: Self::F) -> Self::F;
    unsafe fn mul(a: Self::F, b: Self::F) -> Self::F;
    /// The smaller, or `b` where they cannot be compared.
    unsafe fn min(a: Self::F, b: Self::F) -> Self::F;
    /// The larger, or `b` where they cannot be compared.
    unsafe fn max(a: Self::F, b: Self::F) -> Self::F;
    unsafe fn le(a: Self::F, b: Self::F) -> Self::M;
    unsafe fn lt(a: Self::F, b: Self::F) -> Self::M;
    /// `v` where the mask is set, else 0.
    unsafe fn keep(m: Self::M, v: Self::F) -> Self::F;

    /// Towards zero; `i32::MIN` for what no `i32` holds.
    unsafe fn truncate(v: Self::F) -> Self::I;
    unsafe fn float(v: Self::I) -> Self::F;
    unsafe fn iload(a: &Row<i32>) -> Self::I;
    unsafe fn istore(v: Self::I) -> Row<i32>;
    unsafe fn isplat(v: i32) -> Self::I;
    /// Wraps, as all integer operations here.
    unsafe fn iadd(a: Self::I, b: Self::I) -> Self::I;
    unsafe fn imul(a: Self::I, b: Self::I) -> Self::I;
    unsafe fn iand(a: Self::I, b: Self::I) -> Self::I;
    unsafe fn ishl<const N: u32>(a: Self::I) -> Self::I;
    /// Fills with zeros.
    unsafe fn ishr<const N: u32>(a: Self::I) -> Self::I;
    /// Fills with the sign.
    unsafe fn isar<const N: u32>(a: Self::I) -> Self::I;
    unsafe fn ikeep(m: Self::M, v: Self::I) -> Self::I;
    unsafe fn float_of_bits(v: Self::I) -> Self::F;
    /// `a > b`, signed.
    unsafe fn igt(a: Self::I, b: Self::I) -> Self::M;
    /// `a <= b`, unsigned.
    unsafe fn ule(a: Self::I, b: Self::I) -> Self::M;

    unsafe fn both(a: Self::M, b: Self::M) -> Self::M;
    /// Bit `n` is lane `n`.
    unsafe fn bits(m: Self::M) -> u32;

    /// Asks for the memory at `index` of each row, which need not be readable; a hint that may do nothing.
    unsafe fn prefetch<T>(rows: [*const T; 4], index: Self::I);
    /// The 4 bytes at `base + SCALE * index`, 0 where the mask is clear.
    unsafe fn gather<const SCALE: i32>(base: *const u8, index: Self::I, mask: Self::M) -> Self::I;
    /// The two floats from `base + index` on, 0 where the mask is clear.
    unsafe fn gather_pair(base: *const f32, index: Self::I, mask: Self::M) -> [Self::F; 2];
}

/// Plain Rust, which every target has.
#[derive(Clone, Copy)]
pub(crate) struct Portable;

macro_rules! each {
    ($l:ident => $v:expr) => {{
        let mut out = [Default::default(); LANES];
        let mut $l = 0;
        while $l < LANES {
            out[$l] = $v;
            $l += 1;
        }
        out
    }};
}

/// The smaller as the processors' instructions take it: `b` where they cannot be compared.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Towards zero, as the processors' instructions do it.
#[inline(always)]
fn truncated(v: f32) -> i32 {
    if (-2147483648.0..2147483648.0).contains(&v) { v as i32 } else { i32::MIN }
}

impl Simd for Portable {
    type F = Row<f32>;
    type I = Row<i32>;
    type M = Row<bool>;

    #[inline(always)]
    unsafe fn load(a: &Row<f32>) -> Row<f32> {
        *a
    }
    #[inline(always)]
    unsafe fn store(v: Row<f32>) -> Row<f32> {
        v
    }
    #[inline(always)]
    unsafe fn splat(v: f32) -> Row<f32> {
        [v; LANES]
    }
    #[inline(always)]
    unsafe fn add(a: Row<f32>, b: Row<f32>) -> Row<f32> {
        each!(l => a[l] + b[l])
    }
    #[inline(always)]
    unsafe fn sub(a: Row<f32>, b: Row<f32>) -> Row<f32> {
        each!(l => a[l] - b[l])
    }
    #[inline(always)]
    unsafe fn mul(a: Row<f32>, b: Row<f32>) -> Row<f32> {
        each!(l => a[l] * b[l])
    }
    #[inline(always)]
    unsafe fn min(a: Row<f32>, b: Row<f32>) -> Row<f32> {
        each!(l => smaller(a[l], b[l]))
    }
    #[inline(always)]
    unsafe fn max(a: Row<f32>, b: Row<f32>) -> Row<f32> {
        each!(l => larger(a[l], b[l]))
    }
    #[inline(always)]
    unsafe fn le(a: Row<f32>, b: Row<f32>) -> Row<bool> {
        each!(l => a[l] <= b[l])
    }
    #[inline(always)]
    unsafe fn lt(a: Row<f32>, b: Row<f32>) -> Row<bool> {
        each!(l => a[l] < b[l])
    }
    #[inline(always)]
    unsafe fn keep(m: Row<bool>, v: Row<f32>) -> Row<f32> {
        each!(l => if m[l] { v[l] } else { 0.0 })
    }
    #[inline(always)]
    unsafe fn truncate(v: Row<f32>) -> Row<i32> {
        each!(l => truncated(v[l]))
    }
    #[inline(always)]
    unsafe fn float(v: Row<i32>) -> Row<f32> {
        each!(l => v[l] as f32)
    }
    #[inline(always)]
    unsafe fn iload(a: &Row<i32>) -> Row<i32> {
        *a
    }
    #[inline(always)]
    unsafe fn istore(v: Row<i32>) -> Row<i32> {
        v
    }
    #[inline(always)]
    unsafe fn isplat(v: i32) -> Row<i32> {
        [v; LANES]
    }
    #[inline(always)]
    unsafe fn iadd(a: Row<i32>, b: Row<i32>) -> Row<i32> {
        each!(l => a[l].wrapping_add(b[l]))
    }
    #[inline(always)]
    unsafe fn imul(a: Row<i32>, b: Row<i32>) -> Row<i32> {
        each!(l => a[l].wrapping_mul(b[l]))
    }
    #[inline(always)]
    unsafe fn iand(a: Row<i32>, b: Row<i32>) -> Row<i32> {
        each!(l => a[l] & b[l])
    }
    #[inline(always)]
    unsafe fn ishl<const N: u32>(a: Row<i32>) -> Row<i32> {
        each!(l => a[l] << N)
    }
    #[inline(always)]
    unsafe fn ishr<const N: u32>(a: Row<i32>) -> Row<i32> {
        each!(l => (a[l] as u32 >> N) as i32)
    }
    #[inline(always)]
    unsafe fn isar<const N: u32>(a: Row<i32>) -> Row<i32> {
        each!(l => a[l] >> N)
    }
    #[inline(always)]
    unsafe fn ikeep(m: Row<bool>, v: Row<i32>) -> Row<i32> {
        each!(l => if m[l] { v[l] } else { 0 })
    }
    #[inline(always)]
    unsafe fn float_of_bits(v: Row<i32>) -> Row<f32> {
        each!(l => f32::from_bits(v[l] as u32))
    }
    #[inline(always)]
    unsafe fn igt(a: Row<i32>, b: Row<i32>) -> Row<bool> {
        each!(l => a[l] > b[l])
    }
    #[inline(always)]
    unsafe fn ule(a: Row<i32>, b: Row<i32>) -> Row<bool> {
        each!(l => a[l] as u32 <= b[l] as u32)
    }
    #[inline(always)]
    unsafe fn both(a: Row<bool>, b: Row<bool>) -> Row<bool> {
        each!(l => a[l] & b[l])
    }
    #[inline(always)]
    unsafe fn bits(m: Row<bool>) -> u32 {
        let mut bits = 0;
        for (l, m) in m.iter().enumerate() {
            bits |= u32::from(*m) << l;
        }
        bits
    }
    #[inline(always)]
    unsafe fn prefetch<T>(_: [*const T; 4], _: Row<i32>) {}
    #[inline(always)]
    unsafe fn gather<const SCALE: i32>(base: *const u8, index: Row<i32>, mask: Row<bool>) -> Row<i32> {
        each!(l => if mask[l] {
            // SAFETY: the caller promises that the addresses of set lanes are readable.
            unsafe { base.offset(index[l] as isize * SCALE as isize).cast::<i32>().read_unaligned() }
        } else { 0 })
    }
    #[inline(always)]
    unsafe fn gather_pair(base: *const f32, index: Row<i32>, mask: Row<bool>) -> [Row<f32>; 2] {
        // SAFETY: as above.
        let at = |l: usize, next: isize| unsafe { *base.offset(index[l] as isize + next) };
        [each!(l => if mask[l] { at(l, 0) } else { 0.0 }), each!(l => if mask[l] { at(l, 1) } else { 0.0 })]
    }
}
