//! Weights as integers, so that every sum is exact.
//!
//! Weights that are small integers already (any 8- or 16-bit volume under the identity map) are taken as they
//! are. All others are scaled so that the whole sum is about 2^62 and rounded: a voxel's probability is then
//! wrong by at most 2^-63, however widely the weights range, and a positive weight below that share of the
//! whole may round to zero.

use mcvr_scene::{Density, WeightFn};
use mcvr_volume::Voxel;

/// Largest integer weight for which 256 of them surely sum below 2^31 (vector code compares as `i32`).
const SMALL: f64 = (1 << 23) as f64 - 1.0;

/// An integer type for running sums within a brick.
pub(crate) trait Word: Copy + Default + Ord + Send + Sync + 'static {
    fn from_u64(v: u64) -> Self;
    fn to_u64(self) -> u64;
    fn plus(self, other: Self) -> Self;
}

impl Word for u32 {
    #[inline(always)]
    fn from_u64(v: u64) -> Self {
        v as u32
    }
    #[inline(always)]
    fn to_u64(self) -> u64 {
        u64::from(self)
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.wrapping_add(other)
    }
}

impl Word for u64 {
    #[inline(always)]
    fn from_u64(v: u64) -> Self {
        v
    }
    #[inline(always)]
    fn to_u64(self) -> u64 {
        self
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.wrapping_add(other)
    }
}

/// Integer weight of a stored voxel.
pub(crate) trait Units<T>: Copy + Send + Sync {
    type Word: Word;
    fn units(self, stored: T) -> Self::Word;
}

/// Integer weights by table, for 8- and 16-bit voxels.
#[derive(Clone, Copy)]
pub(crate) struct TableUnits<'a, W>(pub &'a [W]);

impl<T: Voxel, W: Word> Units<T> for TableUnits<'_, W> {
    type Word = W;
    #[inline(always)]
    fn units(self, stored: T) -> W {
        // Only built for types that have ordinals, with one entry for each.
        self.0[stored.ordinal().unwrap_or(0)]
    }
}

/// Integer weights by calculation, for wider voxels.
#[derive(Clone, Copy)]
pub(crate) struct ScaledUnits<'a> {
    pub density: &'a Density,
    pub scale: f64,
}

impl<T: Voxel> Units<T> for ScaledUnits<'_> {
    type Word = u64;
    #[inline(always)]
    fn units(self, stored: T) -> u64 {
        (self.density.lookup().weight(stored) * self.scale + 0.5) as u64
    }
}

/// The integer weights of a density.
#[derive(Clone, Debug)]
pub(crate) enum UnitWeights {
    /// Per ordinal; 256 of them stay below 2^31.
    Small(Vec<u32>),
    /// Per ordinal, scaled.
    Large(Vec<u64>),
    /// By calculation, scaled.
    Scaled(f64),
}

impl UnitWeights {
    pub(crate) fn of(density: &Density) -> Self {
        let scale = 2f64.powi(62) / density.report().weight_sum;
        match density.table() {
            Some(table) if table.iter().all(|w| w.fract() == 0.0 && *w <= SMALL) => {
                Self::Small(table.iter().map(|&w| w as u32).collect())
            }
            Some(table) => Self::Large(
                // Ordinals that no voxel has may be huge; the cast saturates and they are never summed.
                table.iter().map(|&w| (w * scale + 0.5) as u64).collect(),
            ),
            None => Self::Scaled(scale),
        }
    }
}

impl UnitWeights {
    /// The units of the whole density, up to rounding.
    pub(crate) fn whole(&self, density: &Density) -> f64 {
        match self {
            Self::Small(_) => density.report().weight_sum,
            Self::Large(_) | Self::Scaled(_) => 2f64.powi(62),
        }
    }
}

/// Runs an expression with `$units` bound to the concrete [`Units`], compiled once per kind.
macro_rules! with_units {
    ($weights:expr, $density:expr, $units:ident => $body:expr) => {
        match $weights {
            $crate::units::UnitWeights::Small(table) => {
                let $units = $crate::units::TableUnits(&table[..]);
                $body
            }
            $crate::units::UnitWeights::Large(table) => {
                let $units = $crate::units::TableUnits(&table[..]);
                $body
            }
            $crate::units::UnitWeights::Scaled(scale) => {
                let $units = $crate::units::ScaledUnits { density: $density, scale: *scale };
                $body
            }
        }
    };
}
pub(crate) use with_units;
