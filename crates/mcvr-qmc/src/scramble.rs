//! Random scrambles of digital nets: each makes every point uniform and keeps the net a net.

use mcvr_sampling::rng::{Purpose, keyed, mix};
use rand::Rng;
use serde::{Deserialize, Serialize};
use sobol_burley::parts::owen_scramble_rev;

use crate::sobol::Columns;

/// How a net is randomised. Independent seeds give independent scrambles, so replicates measure the error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum Scramble {
    /// Random linear matrix scramble and digital shift (Matoušek 1998): costs nothing per point.
    #[default]
    Linear,
    /// Nested uniform scramble of the first 32 digits by `sobol_burley`'s hash (Burley 2020; Vegdahl 2021).
    Owen,
    /// Nested uniform scramble of the first 32 digits as Owen (1995) defines it: every prefix of digits has a random bit of its
    /// own that flips the next digit. The yardstick for the two fast ones; it takes several times their time.
    Nested,
    /// Digital shift alone.
    Shift,
    /// None: the plain net. Biased; for looking at points.
    None,
}

impl Scramble {
    /// Every scramble, by name.
    pub const ALL: [(&'static str, Scramble); 5] = [
        ("linear", Scramble::Linear),
        ("owen", Scramble::Owen),
        ("nested", Scramble::Nested),
        ("shift", Scramble::Shift),
        ("none", Scramble::None),
    ];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, s)| *s == self).map_or("", |(n, _)| n)
    }
}

impl std::str::FromStr for Scramble {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(n, _)| *n == s);
        found
            .map(|(_, v)| *v)
            .ok_or_else(|| format!("unknown scramble '{s}'; one of linear, owen, nested, shift, none"))
    }
}

/// Which nested scramble of digits, and its key.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Key {
    /// Burley's hash.
    Hash(u32),
    /// A random bit for each prefix.
    Prefixes(u64),
}

/// A scrambled dimension: its columns, the digits of point 0, and the key of the nested scramble if any.
#[derive(Clone, Debug)]
pub(crate) struct Scrambled {
    pub(crate) columns: Columns,
    pub(crate) shift: u64,
    pub(crate) owen: Option<Key>,
}

impl Scrambled {
    pub(crate) fn new(columns: Columns, scramble: Scramble, seed: u64, dimension: usize) -> Self {
        let mut words = keyed(seed, Purpose::Scramble, dimension as u64);
        match scramble {
            Scramble::None => Self { columns, shift: 0, owen: None },
            Scramble::Shift => Self { columns, shift: words.next_u64(), owen: None },
            Scramble::Owen => Self { columns, shift: 0, owen: Some(Key::Hash(words.next_u64() as u32)) },
            Scramble::Nested => Self { columns, shift: 0, owen: Some(Key::Prefixes(words.next_u64())) },
            Scramble::Linear => {
                // Row r of a lower triangular matrix with unit diagonal, acting on digits: bit 63 is digit 0,
                // and digit r may depend on digits 0..=r.
                let rows: [u64; 64] = std::array::from_fn(|r| {
                    let diagonal = 1u64 << (63 - r);
                    let above = if r == 0 { 0 } else { !0u64 << (64 - r) };
                    diagonal | words.next_u64() & above
                });
                let columns = columns.map(|c| {
                    rows.iter()
                        .enumerate()
                        .fold(0, |out, (r, row)| out | u64::from((c & row).count_ones() & 1) << (63 - r))
                });
                Self { columns, shift: words.next_u64(), owen: None }
            }
        }
    }
}

/// Nested scramble of 32 digits.
#[inline(always)]
pub(crate) fn owen(digits: u32, key: Key) -> u32 {
    match key {
        Key::Hash(seed) => owen_scramble_rev(digits.reverse_bits(), seed).reverse_bits(),
        Key::Prefixes(key) => by_prefix(digits, key),
    }
}

/// Digits whose prefixes share one hash: a tree of 6 digits has 63 inner nodes, one bit of the hash each.
const TREE: u32 = 6;

/// Digit d flips if the bit of the d digits before it says so.
fn by_prefix(digits: u32, key: u64) -> u32 {
    let mut flips = 0;
    for start in (0..u32::BITS).step_by(TREE as usize) {
        // The digits before the tree, behind a 1 that tells their number.
        let prefix = if start == 0 { 1 } else { u64::from(digits >> (u32::BITS - start)) | 1 << start };
        let bits = mix(key ^ mix(prefix.wrapping_add(0x9e37_79b9_7f4a_7c15)));
        // Node 1 is the tree's root, nodes 2n and 2n + 1 follow node n.
        let mut node = 1;
        for place in start..(start + TREE).min(u32::BITS) {
            let digit = u32::BITS - 1 - place;
            flips |= ((bits >> node & 1) as u32) << digit;
            node = node << 1 | u64::from(digits >> digit & 1);
        }
    }
    digits ^ flips
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nested(seed: u64) -> Key {
        Key::Prefixes(keyed(seed, Purpose::Scramble, 0).next_u64())
    }

    /// The first digit that differs stays the first that differs, which makes every elementary interval one again.
    #[test]
    fn a_nested_scramble_keeps_the_length_of_common_prefixes() {
        for key in [nested(1), Key::Hash(77)] {
            for n in 0..20_000u32 {
                let (a, b) = (mix(u64::from(n)) as u32, mix(u64::from(n) | 1 << 40) as u32 >> (n % 33).min(31));
                let difference = (owen(a, key) ^ owen(a ^ b, key)).leading_zeros();
                assert_eq!(difference, b.leading_zeros(), "{a:x} {b:x}");
            }
        }
    }

    /// Over seeds, the flips of any two different prefixes are fair and independent coins: each of the four outcomes of a
    /// pair has probability 1/4, within 5 deviations of `√(3/16 n)`. Prefixes of neighbouring digits, of the same digit, and
    /// of different trees.
    #[test]
    fn prefixes_have_independent_fair_coins() {
        let n = 4000u32;
        // (digits, which of them): the prefix is what comes before.
        let prefixes =
            [(0u32, 0u32), (0, 1), (1 << 31, 1), (0, 5), (0, 6), (1 << 26, 6), (0x1234_5678, 17), (0x1234_5678, 31)];
        for (i, &(a, da)) in prefixes.iter().enumerate() {
            for &(b, db) in &prefixes[..i] {
                let mut outcomes = [0u32; 4];
                for seed in 0..n {
                    let flip = |digits: u32, d: u32| (owen(digits, nested(seed.into())) ^ digits) >> (31 - d) & 1;
                    outcomes[(flip(a, da) << 1 | flip(b, db)) as usize] += 1;
                }
                let bound = 5.0 * (3.0 / 16.0 * f64::from(n)).sqrt();
                assert!(outcomes.iter().all(|&c| (f64::from(c) - f64::from(n) / 4.0).abs() < bound), "{outcomes:?}");
            }
        }
    }

    /// The flip of a digit belongs to the prefix alone, not to the digit or those behind it.
    #[test]
    fn a_flip_depends_on_the_prefix_alone() {
        let key = nested(3);
        for n in 0..20_000u64 {
            let (a, rest, d) = (mix(n) as u32, mix(n | 1 << 40) as u32, n as u32 % 32);
            let b = if d == 0 { rest } else { a & !0 << (32 - d) | rest >> d };
            assert_eq!((owen(a, key) ^ a) >> (31 - d) & 1, (owen(b, key) ^ b) >> (31 - d) & 1);
        }
    }
}
