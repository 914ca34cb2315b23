//! Random numbers keyed by (seed, purpose, block), and the conversions that golden files rely on.

use rand::Rng;
use rand_pcg::Pcg64Dxsm;

/// What random numbers are for; different purposes never share a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Spacings between sorted targets, or targets themselves.
    Targets = 1,
    /// Uniforms of the kernel offsets.
    Offsets = 2,
    /// Totals of whole blocks of spacings.
    Blocks = 3,
    /// Scrambles and shifts of low-discrepancy points.
    Scramble = 4,
    /// Shift of the first coordinate of a net.
    Shift = 5,
    /// Keys of independent replicates.
    Replicate = 6,
    /// Digital shifts of the regions of a sequence.
    Regions = 7,
}

/// SplitMix64's finaliser: a bijection of 64-bit words whose output bits all depend on all input bits
/// (Steele, Lea, Flood 2014).
pub fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A hash of several words, each position distinct.
pub fn hash(words: &[u64]) -> u64 {
    words.iter().fold(0x9e37_79b9_7f4a_7c15, |h, &w| {
        mix(h.rotate_left(23).wrapping_add(mix(w.wrapping_add(0x9e37_79b9_7f4a_7c15))))
    })
}

/// The generator for a seed, a purpose and a block. Streams of different keys are independent: the key sets
/// both the state and the increment of a PCG64-DXSM (plain PCG64 streams correlate).
pub fn keyed(seed: u64, purpose: Purpose, block: u64) -> Pcg64Dxsm {
    let key = hash(&[seed, purpose as u64, block]);
    let word = |i: u64| u128::from(mix(key.wrapping_add(i.wrapping_mul(0x9e37_79b9_7f4a_7c15))));
    Pcg64Dxsm::new(word(0) << 64 | word(1), word(2) << 64 | word(3))
}

/// Generators that run side by side in [`fill_u32`]: one vector of 32-bit words.
const LANES: usize = 16;

/// Fills a slice with 32-bit words of a key: 16 xoshiro128++ generators (Blackman and Vigna 2021) in turn, each
/// with its 128 bits of state from the key's own [`keyed`] PCG. One PCG alone gives a word in about a
/// nanosecond; the sixteen give it in less than a tenth, as they run in one vector.
pub fn fill_u32(seed: u64, purpose: Purpose, block: u64, out: &mut [u32]) {
    let mut source = keyed(seed, purpose, block);
    let mut state = [[0u32; LANES]; 4];
    let [s0, s1, s2, s3] = &mut state;
    for (((a, b), c), d) in s0.iter_mut().zip(s1).zip(s2).zip(s3) {
        let (low, high) = (source.next_u64(), source.next_u64());
        // A state of all zeros would stay there: the odd word rules it out.
        [*a, *b, *c, *d] = [low as u32 | 1, (low >> 32) as u32, high as u32, (high >> 32) as u32];
    }
    words_at(crate::SimdLevel::detect(), &mut state, out);
}

mcvr_volume::vectorised! {
    fn words_at(state: &mut [[u32; LANES]; 4], out: &mut [u32]) = words_body
}

#[inline(always)]
fn words_body(state: &mut [[u32; LANES]; 4], out: &mut [u32]) {
    let [mut s0, mut s1, mut s2, mut s3] = *state;
    let mut next = || {
        let mut words = [0u32; LANES];
        for l in 0..LANES {
            words[l] = s0[l].wrapping_add(s3[l]).rotate_left(7).wrapping_add(s0[l]);
            let t = s1[l] << 9;
            s2[l] ^= s0[l];
            s3[l] ^= s1[l];
            s1[l] ^= s2[l];
            s0[l] ^= s3[l];
            s2[l] ^= t;
            s3[l] = s3[l].rotate_left(11);
        }
        words
    };
    let mut chunks = out.chunks_exact_mut(LANES);
    for chunk in &mut chunks {
        chunk.copy_from_slice(&next());
    }
    let rest = chunks.into_remainder();
    let words = next();
    rest.copy_from_slice(&words[..rest.len()]);
}

/// Fraction bits of the fixed-point numbers that [`exponentials`] gives.
pub const EXPONENTIAL_BITS: u32 = 32;

mcvr_volume::vectorised! {
    fn xor_at(base: u32, table: &[u32], out: &mut [u32]) = xor_body
}

/// `out[i] = base ^ table[i]`: a run of points of a digital net.
pub fn xor(base: u32, table: &[u32], out: &mut [u32]) {
    xor_at(crate::SimdLevel::detect(), base, table, out);
}

#[inline(always)]
fn xor_body(base: u32, table: &[u32], out: &mut [u32]) {
    for (o, t) in out.iter_mut().zip(table) {
        *o = base ^ t;
    }
}

mcvr_volume::vectorised! {
    fn spread_at(positions: &mut [u64], offset: f64, scale: f64, largest: f64) = spread_body
}

/// `positions[i] = floor(min(offset + positions[i] * scale, largest))` for positions below 2^52 (of others the lower 52
/// bits) and results in 0..2^63.
///
/// # Panics
/// When the results could leave 0..2^63.
pub fn spread(positions: &mut [u64], offset: f64, scale: f64, largest: f64) {
    assert!(
        offset >= 0.0 && scale >= 0.0 && (0.0..9_223_372_036_854_775_808.0).contains(&largest),
        "{offset} {scale} {largest}"
    );
    spread_at(crate::SimdLevel::detect(), positions, offset, scale, largest);
}

#[inline(always)]
fn spread_body(positions: &mut [u64], offset: f64, scale: f64, largest: f64) {
    const MAGIC_STEPS: u64 = 1 << 52;
    const MAGIC: f64 = MAGIC_STEPS as f64;
    for p in positions {
        // The mask keeps x within 0..2^52 whatever a caller hands over.
        let x = f64::from_bits(*p & (MAGIC_STEPS - 1) | MAGIC.to_bits()) - MAGIC;
        let y = offset + x * scale;
        let z = if y < largest { y } else { largest };
        // SAFETY: x, offset and scale are at least 0 (`spread` asserts the two), so 0 ≤ z ≤ largest < 2^63 (a NaN has become
        // `largest`).
        *p = unsafe { z.to_int_unchecked::<i64>() as u64 };
    }
}

mcvr_volume::vectorised! {
    fn exponentials_at(words: &[u32], out: &mut [u64]) = exponentials_body
}

/// Exponential variates `-ln((n + 1/2) / 2^32)` of words n, in fixed point with [`EXPONENTIAL_BITS`] fraction
/// bits. Relative error below 1e-12; the same bits on every processor, unlike the system's logarithm.
pub fn exponentials(words: &[u32], out: &mut [u64]) {
    exponentials_at(crate::SimdLevel::detect(), words, out);
}

#[inline(always)]
fn exponentials_body(words: &[u32], out: &mut [u64]) {
    for (o, &w) in out.iter_mut().zip(words) {
        // Shifted so that the conversion is from a signed word, which vectorises.
        let u = (f64::from((w ^ 0x8000_0000) as i32) + 2_147_483_648.5) * (1.0 / 4_294_967_296.0);
        // u = m 2^e with m in [√½, √2): adding the distance to √½'s bits carries into the exponent.
        let bits = u.to_bits() + (0x3ff0_0000_0000_0000 - 0x3fe6_a09e_667f_3bcd);
        let e = ((bits >> 52) as i32 - 1023) as f64;
        let m = f64::from_bits((bits & 0x000f_ffff_ffff_ffff) + 0x3fe6_a09e_667f_3bcd);
        // ln m = 2 artanh((m - 1) / (m + 1)), |s| ≤ 0.1716: the first term left out is below 2 s^17 / 17 = 1e-14.
        let s = (m - 1.0) / (m + 1.0);
        let s2 = s * s;
        let p = 1.0 / 3.0
            + s2 * (1.0 / 5.0
                + s2 * (1.0 / 7.0 + s2 * (1.0 / 9.0 + s2 * (1.0 / 11.0 + s2 * (1.0 / 13.0 + s2 / 15.0)))));
        let ln = e * std::f64::consts::LN_2 + 2.0 * (s + s * s2 * p);
        // Rounds to an integer below 2^52 in the bits of the sum.
        const MAGIC: f64 = (1u64 << 52) as f64;
        *o = (MAGIC - ln * (1u64 << EXPONENTIAL_BITS) as f64).to_bits() & ((1 << 52) - 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_key_gives_the_same_words_and_any_other_key_different_ones() {
        let words = |seed, purpose, block| {
            let mut out = [0u32; 37];
            fill_u32(seed, purpose, block, &mut out);
            out
        };
        let base = words(1, Purpose::Offsets, 0);
        assert_eq!(base, words(1, Purpose::Offsets, 0));
        for other in [words(2, Purpose::Offsets, 0), words(1, Purpose::Targets, 0), words(1, Purpose::Offsets, 1)] {
            assert!(base.iter().zip(other).filter(|(a, b)| **a == *b).count() < 2);
        }
    }

    /// The conversion in [`spread`] is unchecked, so no argument that it accepts may lead out of range.
    #[test]
    fn spread_stays_in_range_whatever_the_positions() {
        let words = [0, 1, (1 << 52) - 1, 1 << 52, 1 << 62, 1 << 63, 0xfff0 << 48, u64::MAX];
        for (offset, scale) in [(0.0, 1.0), (0.0, f64::MAX), (1e300, 0.0), (0.0, f64::INFINITY), (7.5, 1e-300)] {
            for largest in [0.0, 254.0, 9.19e18] {
                for level in crate::SimdLevel::available() {
                    let mut positions = [words; 3].concat();
                    spread_at(level, &mut positions, offset, scale, largest);
                    assert!(
                        positions.iter().all(|p| *p <= largest as u64),
                        "{level:?} {offset} {scale}: {positions:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn exponentials_are_logarithms_on_every_level() {
        let mut words: Vec<u32> = (0..4096u32).map(|i| i.wrapping_mul(0x9e37_79b9)).collect();
        words.extend([0, 1, 2, u32::MAX, u32::MAX - 1, 1 << 31, (1 << 31) - 1, 0xb504_f333]);
        let mut expected = vec![];
        for level in crate::SimdLevel::available() {
            let mut out = vec![0; words.len()];
            exponentials_at(level, &words, &mut out);
            for (&w, &o) in words.iter().zip(&out) {
                let exact = -((f64::from(w) + 0.5) / 4_294_967_296.0).ln() * (1u64 << EXPONENTIAL_BITS) as f64;
                assert!((o as f64 - exact).abs() <= 0.5 + 1e-12 * exact, "{w}: {o} {exact}");
            }
            if expected.is_empty() {
                expected = out;
            } else {
                assert_eq!(expected, out);
            }
        }
    }

    /// The first words of a lane follow the published definition, at every level.
    #[test]
    fn words_are_those_of_xoshiro128_plus_plus() {
        for level in crate::SimdLevel::available() {
            let mut state = [[1u32; LANES], [2; LANES], [3; LANES], [4; LANES]];
            let mut out = [0u32; 3 * LANES + 5];
            words_at(level, &mut state, &mut out);
            // Reference output of the authors' code for the state 1, 2, 3, 4.
            for (k, expected) in [641, 1_573_767, 3_222_811_527].into_iter().enumerate() {
                assert!(
                    out[k * LANES..(k + 1) * LANES].iter().all(|w| *w == expected),
                    "{level:?} {k}: {}",
                    out[k * LANES]
                );
            }
        }
    }

    /// Each bit of the words is set half the time, and words of neighbouring blocks are unrelated: 2^20 words,
    /// each count within five deviations of its binomial.
    #[test]
    fn bits_are_fair_and_blocks_unrelated() {
        let n = 512;
        let (mut a, mut b) = (vec![0u32; 2048], vec![0u32; 2048]);
        let (mut ones, mut same) = ([0u32; 32], [0u32; 32]);
        for block in 0..n {
            fill_u32(1, Purpose::Offsets, block, &mut a);
            fill_u32(1, Purpose::Offsets, block + 1, &mut b);
            for (x, y) in a.iter().zip(&b) {
                for bit in 0..32 {
                    ones[bit] += x >> bit & 1;
                    same[bit] += !(x ^ y) >> bit & 1;
                }
            }
        }
        let total = (n * 2048) as f64;
        for count in ones.into_iter().chain(same) {
            assert!((f64::from(count) - total / 2.0).abs() < 5.0 * total.sqrt() / 2.0, "{count}");
        }
    }
}
