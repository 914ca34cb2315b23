//! Random scrambles of digital nets: each makes every point uniform and keeps the net a net.

use mcvr_sampling::rng::{Purpose, keyed};
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
    /// Digital shift alone.
    Shift,
    /// None: the plain net. Biased; for looking at points.
    None,
}

impl Scramble {
    /// Every scramble, by name.
    pub const ALL: [(&'static str, Scramble); 4] =
        [("linear", Scramble::Linear), ("owen", Scramble::Owen), ("shift", Scramble::Shift), ("none", Scramble::None)];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, s)| *s == self).map_or("", |(n, _)| n)
    }
}

impl std::str::FromStr for Scramble {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(n, _)| *n == s);
        found.map(|(_, v)| *v).ok_or_else(|| format!("unknown scramble '{s}'; one of linear, owen, shift, none"))
    }
}

/// A scrambled dimension: its columns, the digits of point 0, and the seed of the nested scramble if any.
#[derive(Clone, Debug)]
pub(crate) struct Scrambled {
    pub(crate) columns: Columns,
    pub(crate) shift: u64,
    pub(crate) owen: Option<u32>,
}

impl Scrambled {
    pub(crate) fn new(columns: Columns, scramble: Scramble, seed: u64, dimension: usize) -> Self {
        let mut words = keyed(seed, Purpose::Scramble, dimension as u64);
        match scramble {
            Scramble::None => Self { columns, shift: 0, owen: None },
            Scramble::Shift => Self { columns, shift: words.next_u64(), owen: None },
            Scramble::Owen => Self { columns, shift: 0, owen: Some(words.next_u64() as u32) },
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
pub(crate) fn owen(digits: u32, seed: u32) -> u32 {
    owen_scramble_rev(digits.reverse_bits(), seed).reverse_bits()
}
