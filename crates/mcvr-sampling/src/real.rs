//! The floating-point types of the vector code, 32 and 64 bits wide.

#[cfg(target_arch = "x86_64")]
use crate::project::Params;

/// A view in 32 bits and room for its weights.
#[cfg(target_arch = "x86_64")]
pub(crate) type Single<'a> = (&'a Params<f32>, &'a mut [u32]);

/// A floating-point type of the vector code.
pub(crate) trait Real:
    Copy
    + PartialOrd
    + Send
    + Sync
    + std::ops::Add<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::Div<Output = Self>
    + std::ops::Neg<Output = Self>
{
    fn lit(v: f64) -> Self;
    fn from_i32(v: i32) -> Self;
    fn from_f32(v: f32) -> Self;
    fn to_f64(self) -> f64;
    /// Uniform in (0, 1) from 32 bits, symmetric about 1/2.
    fn uniform(word: u32) -> Self;
    fn sqrt(self) -> Self;
    /// Truncation.
    ///
    /// # Safety
    /// The value must lie in 0..2^31.
    unsafe fn to_i32(self) -> i32;
    /// Nearest integer.
    ///
    /// # Safety
    /// The value must lie in 0..=2^FIXED_BITS.
    unsafe fn to_fixed(self) -> Self::Fixed;
    /// The batch's weights of this type.
    fn slot(weights: &mut Weights) -> &mut Vec<Self::Fixed>;
    /// The same as 32 bits, where that is the type.
    #[cfg(target_arch = "x86_64")]
    fn single<'a>(params: &'a Params<Self>, weights: &'a mut [Self::Fixed]) -> Option<Single<'a>>;
    /// Integer that holds a fixed-point weight: as narrow as possible, for the vector code's sake.
    type Fixed: Copy + Default + Send + Sync;
    /// Largest fixed-point weight, as a power of two.
    const FIXED_BITS: u32;
    /// True for 64 bits.
    const DOUBLE: bool;
}

impl Real for f32 {
    #[inline(always)]
    fn lit(v: f64) -> Self {
        v as f32
    }
    #[inline(always)]
    fn from_i32(v: i32) -> Self {
        v as f32
    }
    #[inline(always)]
    fn from_f32(v: f32) -> Self {
        v
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn uniform(word: u32) -> Self {
        ((word >> 9) as i32 as f32 + 0.5) * (1.0 / (1 << 23) as f32)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f32::sqrt(self)
    }
    #[inline(always)]
    unsafe fn to_i32(self) -> i32 {
        // SAFETY: the caller keeps the value in range.
        unsafe { self.to_int_unchecked() }
    }
    #[inline(always)]
    unsafe fn to_fixed(self) -> u32 {
        // SAFETY: the caller keeps the value within 2^30.
        unsafe { (self + 0.5).to_int_unchecked::<i32>() as u32 }
    }
    #[inline(always)]
    fn slot(weights: &mut Weights) -> &mut Vec<u32> {
        &mut weights.narrow
    }
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn single<'a>(params: &'a Params<f32>, weights: &'a mut [u32]) -> Option<Single<'a>> {
        Some((params, weights))
    }
    type Fixed = u32;
    const FIXED_BITS: u32 = 30;
    const DOUBLE: bool = false;
}

impl Real for f64 {
    #[inline(always)]
    fn lit(v: f64) -> Self {
        v
    }
    #[inline(always)]
    fn from_i32(v: i32) -> Self {
        f64::from(v)
    }
    #[inline(always)]
    fn from_f32(v: f32) -> Self {
        f64::from(v)
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
    #[inline(always)]
    fn uniform(word: u32) -> Self {
        // i32 converts in one vector instruction, u32 does not: shift the range, then back.
        (f64::from((word ^ 0x8000_0000) as i32) + 2_147_483_648.5) * (1.0 / 4_294_967_296.0)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    unsafe fn to_i32(self) -> i32 {
        // SAFETY: the caller keeps the value in range.
        unsafe { self.to_int_unchecked() }
    }
    #[inline(always)]
    unsafe fn to_fixed(self) -> u64 {
        const MAGIC: f64 = (1u64 << 52) as f64;
        (self + MAGIC).to_bits() & ((1 << 52) - 1)
    }
    #[inline(always)]
    fn slot(weights: &mut Weights) -> &mut Vec<u64> {
        &mut weights.wide
    }
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn single<'a>(_: &'a Params<f64>, _: &'a mut [u64]) -> Option<Single<'a>> {
        None
    }
    type Fixed = u64;
    const FIXED_BITS: u32 = 40;
    const DOUBLE: bool = true;
}

/// Fixed-point weights of a batch: of the type that the precision has, or none for `count`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weights {
    pub narrow: Vec<u32>,
    pub wide: Vec<u64>,
}
