//! Sums over 8- and 16-bit voxels whose weights rise by one step from value to value, as under the identity map: in integers,
//! exact, without a table, at the speed of the memory.

use mcvr_volume::Voxel;
use rayon::prelude::*;

use super::Tally;

/// Voxels that a thread takes at a time.
const CHUNK: usize = 1 << 20;

/// Sums in units of the step: of `ordinal - zero` where it is positive, of `zero - ordinal` elsewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sums {
    pub(super) positive: u64,
    pub(super) negative: u64,
    pub(super) above: u64,
    pub(super) below: u64,
    /// Ordinals; the smallest of those above `zero`.
    pub(super) largest: u64,
    pub(super) smallest: u64,
}

impl Sums {
    const NONE: Self = Self { positive: 0, negative: 0, above: 0, below: 0, largest: 0, smallest: u64::MAX };

    fn join(self, o: Self) -> Self {
        Self {
            positive: self.positive + o.positive,
            negative: self.negative + o.negative,
            above: self.above + o.above,
            below: self.below + o.below,
            largest: self.largest.max(o.largest),
            smallest: self.smallest.min(o.smallest),
        }
    }
}

/// The sums over voxels whose weight is a step times the ordinal less a whole number. `None` where weights are not of that form,
/// or where sums of `f64` would round: those depend on their order, which is that of the ordinals.
pub(super) fn tally<T: Voxel>(voxels: &[T], table: &[f64]) -> Option<Tally> {
    let step = table[1] - table[0];
    let zero = -table[0] / step;
    let ramp = step > 0.0 && step.is_finite() && zero.fract() == 0.0 && (0.0..table.len() as f64).contains(&zero);
    if !ramp || table.iter().enumerate().any(|(i, w)| *w != (i as f64 - zero) * step) {
        return None;
    }
    // Every partial sum is a multiple of the step's lowest bit; all of them have 53 digits if the largest possible has.
    let digits = (step.to_bits() & ((1 << 52) - 1) | 1 << 52) >> (step.to_bits() | 1 << 52).trailing_zeros();
    let largest = u128::from(digits) * table.len() as u128 * voxels.len().max(1) as u128;
    if step < f64::MIN_POSITIVE || largest >= 1 << 53 {
        return None;
    }
    let signed = T::TYPE.name().starts_with('i');
    let sums = voxels.par_chunks(CHUNK).map(|chunk| match (size_of::<T>(), zero == 0.0) {
        (1, true) => bytes::<false>(bytemuck::cast_slice(chunk), if signed { 0x80 } else { 0 }, zero as u8),
        (1, false) => bytes::<true>(bytemuck::cast_slice(chunk), if signed { 0x80 } else { 0 }, zero as u8),
        (_, true) => words::<false>(bytemuck::cast_slice(chunk), if signed { 0x8000 } else { 0 }, zero as u16),
        (_, false) => words::<true>(bytemuck::cast_slice(chunk), if signed { 0x8000 } else { 0 }, zero as u16),
    });
    let sums = sums.reduce(|| Sums::NONE, Sums::join);
    Some(Tally {
        positive: sums.above,
        negative: sums.below,
        dropped: sums.negative as f64 * step,
        sum: sums.positive as f64 * step,
        max: if sums.above > 0 { table[sums.largest as usize] } else { 0.0 },
        min: if sums.above > 0 { table[sums.smallest as usize] } else { 0.0 },
        bad: 0,
    })
}

/// Sums of one chunk of 8- or 16-bit voxels. `flip` turns stored bits into ordinals; without `NEGATIVE` the zero is the smallest
/// ordinal. `portable` goes through a part that stays in the first cache once for each figure: simple loops become vector code.
macro_rules! sums {
    ($name:ident, $t:ty, $part:literal) => {
        mod $name {
            use super::Sums;

            pub(super) fn portable<const NEGATIVE: bool>(voxels: &[$t], flip: $t, zero: $t) -> Sums {
                let mut sums = Sums::NONE;
                let mut largest = 0;
                // Less `zero + 1`, so that all that is not above it wraps round to the largest numbers.
                let mut smallest = <$t>::MAX;
                let least = zero.wrapping_add(1);
                // So short that sums of 32 bits cannot overflow.
                for part in voxels.chunks($part) {
                    let (mut positive, mut above) = (0u32, 0u32);
                    for v in part {
                        positive += u32::from((*v ^ flip).saturating_sub(zero));
                    }
                    // Counted in the voxels' own width, which keeps vectors full.
                    for few in part.chunks(128) {
                        let mut count = 0;
                        for v in few {
                            count += <$t>::from((*v ^ flip) > zero);
                        }
                        above += u32::from(count);
                    }
                    for v in part {
                        largest = largest.max(*v ^ flip);
                    }
                    for v in part {
                        smallest = smallest.min((*v ^ flip).wrapping_sub(least));
                    }
                    sums.positive += u64::from(positive);
                    sums.above += u64::from(above);
                    if NEGATIVE {
                        let (mut negative, mut below) = (0u32, 0u32);
                        for v in part {
                            negative += u32::from(zero.saturating_sub(*v ^ flip));
                        }
                        for few in part.chunks(128) {
                            let mut count = 0;
                            for v in few {
                                count += <$t>::from((*v ^ flip) < zero);
                            }
                            below += u32::from(count);
                        }
                        sums.negative += u64::from(negative);
                        sums.below += u64::from(below);
                    }
                }
                sums.largest = u64::from(largest);
                // Used only where some voxel is above the zero, and then it is one.
                sums.smallest = u64::from(smallest) + u64::from(zero) + 1;
                sums
            }
        }

        fn $name<const NEGATIVE: bool>(voxels: &[$t], flip: $t, zero: $t) -> Sums {
            #[cfg(target_arch = "x86_64")]
            if mcvr_volume::SimdLevel::detect() >= mcvr_volume::SimdLevel::Avx2 {
                // SAFETY: `detect` names only what the processor has.
                let (sums, rest) = unsafe { super::ramp_avx2::$name::<NEGATIVE>(voxels, flip, zero) };
                return sums.join($name::portable::<NEGATIVE>(rest, flip, zero));
            }
            $name::portable::<NEGATIVE>(voxels, flip, zero)
        }
    };
}

sums!(bytes, u8, 8192);
sums!(words, u16, 4096);

#[cfg(test)]
mod tests {
    use super::super::{DensityMap, Tally, Transfer, histogram, scan};
    use super::*;
    use mcvr_volume::{Grid, Volume};

    fn agree<T: Voxel>(voxels: Vec<T>, slope: f64, intercept: f64, ramp: bool) {
        let grid = Grid::with_spacing([voxels.len(), 1, 1], [1.0; 3]).unwrap();
        let map = DensityMap { transfer: Transfer::Linear { slope, intercept }, ..DensityMap::default() };
        let volume = Volume::from_vec(grid, voxels.clone(), "test").unwrap();
        let (table, got) = scan(&volume, &map, &voxels);
        let expected: Tally = histogram::tally(&voxels, &table);
        assert_eq!(got, expected, "{} {slope} {intercept}", T::TYPE);
        assert_eq!(tally(&voxels, &table).is_some(), ramp, "{} {slope} {intercept}", T::TYPE);
    }

    #[test]
    fn integers_and_histograms_give_the_same_sums() {
        for n in [1usize, 31, 32, 33, 8160, 8161, 70_000] {
            let noise: Vec<u64> = (0..n as u64).map(|i| i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40).collect();
            for (slope, intercept, ramp) in
                [(1.0, 0.0, true), (0.25, -25.0, true), (3.0, -90.0, true), (0.3, 1.0, false), (1.0, 0.5, false)]
            {
                agree(noise.iter().map(|v| *v as u8).collect(), slope, intercept, ramp);
                agree(noise.iter().map(|v| *v as u16).collect(), slope, intercept, ramp);
                agree(noise.iter().map(|v| *v as i8).collect(), slope, intercept, ramp);
                agree(noise.iter().map(|v| *v as i16).collect(), slope, intercept, ramp);
            }
            for same in [0, 1, 254, 255] {
                agree(vec![same as u8; n], 1.0, 0.0, true);
                agree(vec![same as i8; n], 1.0, 0.0, true);
                agree(vec![same as u8; n], 1.0, -255.0, true);
            }
            agree(vec![u16::MAX; n], 1.0, 0.0, true);
            agree(vec![i16::MIN; n], 1.0, 0.0, true);
        }
        // Both ways of adding up, of chunks that do and do not fill vectors, with the zero anywhere.
        let noise: Vec<u16> = (0..100_000u32).map(|i| (i.wrapping_mul(0x9e37_79b9) >> 16) as u16).collect();
        let small: Vec<u8> = noise.iter().map(|v| (v >> 8) as u8).collect();
        for n in [0, 1, 15, 16, 31, 32, 33, 4095, 4096, 4128, 100_000] {
            for zero in [0, 9, 128, 254, 255] {
                let (b, w) = (&small[..n], &noise[..n]);
                for flip in [0, 0x80] {
                    assert_eq!(bytes::<true>(b, flip, zero), bytes::portable::<true>(b, flip, zero), "{n} {zero}");
                    let (zero, flip) = (u16::from(zero) * 257, u16::from(flip) << 8);
                    assert_eq!(words::<true>(w, flip, zero), words::portable::<true>(w, flip, zero), "{n} {zero}");
                }
            }
            assert_eq!(bytes::<false>(&small[..n], 0x80, 0), bytes::portable::<false>(&small[..n], 0x80, 0), "{n}");
            assert_eq!(words::<false>(&noise[..n], 0, 0), words::portable::<false>(&noise[..n], 0, 0), "{n}");
        }
        for same in [0u16, 1, 254, 255, 65_535] {
            let (b, w) = (vec![same as u8; 70_001], vec![same; 70_001]);
            assert_eq!(bytes::<true>(&b, 0, 254), bytes::portable::<true>(&b, 0, 254), "{same}");
            assert_eq!(words::<true>(&w, 0, 254), words::portable::<true>(&w, 0, 254), "{same}");
        }
        // Weights that 53 digits hold one by one, but not their sums.
        agree(vec![65535u16; 9000], 1.0 + 2f64.powi(-36), 0.0, false);
    }
}
