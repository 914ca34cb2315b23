//! Weights as integers, so that every sum is exact.
//!
//! Weights that are small multiples of one power of two (any 8- or 16-bit volume under the identity map) are taken as
//! they are: all probabilities are exact. All others are rounded to whole multiples of the power of two of which the sum
//! holds 2^61 to 2^62. Scaling by a power of two rounds nothing, so a weight `w_i` becomes `u_i = w_i/unit + r_i` with
//! `|r_i| ≤ 1/2`, and of n positive weights the probability `p_i` is wrong by `(r_i - p_i Σr)/Σu`: at most
//! `(1 + n p_i) 2^-62`, however widely the weights range. Weights below half a unit are never drawn;
//! [`MassReport::faint`](mcvr_scene::MassReport::faint) counts them. Sums stay below 2^62 + 2^40 (+ 2^26 for the rounding
//! of the sum that chose the unit), so below 2^63.

use mcvr_scene::{Density, Transfer, WeightFn, power_of_two};
use mcvr_volume::Voxel;

use crate::order::BRICK;
use crate::running_totals::TotalType;
use crate::word::Word;

/// Largest integer weight for which 256 of them surely sum below 2^31 (vector code compares as `i32`).
const SMALL: f64 = (1 << 23) as f64 - 1.0;

/// Integer weight of a stored voxel.
pub(crate) trait Units<T>: Copy + Send + Sync {
    type Word: Word;
    /// Whether no weight exceeds 255, so that sums of a brick fit 16 bits and [`Units::byte`] may be used.
    const BYTES: bool = false;
    fn units(self, stored: T) -> Self::Word;
    /// [`Units::units`] of a voxel of which none exceeds 255.
    #[inline(always)]
    fn byte(self, stored: T) -> u8 {
        self.units(stored).to_u64() as u8
    }
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

/// Integer weights that are the ordinal less a number, or 0: those of the identity map, without a table.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ramp(u32);

impl<T: Voxel> Units<T> for Ramp {
    type Word = u32;
    const BYTES: bool = size_of::<T>() == 1;
    #[inline(always)]
    fn units(self, stored: T) -> u32 {
        // Only built for types that have ordinals.
        (stored.ordinal().unwrap_or(0) as u32).saturating_sub(self.0)
    }
    #[inline(always)]
    fn byte(self, stored: T) -> u8 {
        // The zero is one of 256 ordinals.
        (stored.ordinal().unwrap_or(0) as u8).saturating_sub(self.0 as u8)
    }
}

/// Integer weights of wider voxels under a map without a branch, which vector code can follow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Affine {
    /// From stored values to isovalues, and from those to weights.
    steps: [[f64; 2]; 2],
    scale: Scale,
}

impl Affine {
    fn of(density: &Density, scale: Scale) -> Option<Self> {
        let (map, volume) = (density.map(), density.volume());
        let line = match map.transfer {
            // Exactly the isovalue.
            Transfer::Identity => [1.0, 0.0],
            Transfer::Linear { slope, intercept } => [slope, intercept],
            _ => return None,
        };
        let plain = map.emphasis.is_none() && map.gains.is_none();
        plain.then(|| Self { steps: [[volume.slope(), volume.intercept()], line], scale })
    }
}

impl<T: Voxel> Units<T> for Affine {
    type Word = u64;
    #[inline(always)]
    fn units(self, stored: T) -> u64 {
        let [[a, b], [c, d]] = self.steps;
        let weight = c * (a * stored.to_f64() + b) + d;
        self.scale.units(if weight > 0.0 { weight } else { 0.0 })
    }
}

/// Integer weights by calculation, for wider voxels.
#[derive(Clone, Copy)]
pub(crate) struct ScaledUnits<'a> {
    pub density: &'a Density,
    pub scale: Scale,
}

/// Division by the unit, in two steps: for the smallest weights the factor exceeds the largest number.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale(f64, f64);

impl Scale {
    /// Division by two to a power.
    fn by(exponent: i32) -> Self {
        let first = (-exponent - 1000).max(0);
        Self(power_of_two(first), power_of_two(-exponent - first))
    }

    /// The nearest integer of the quotient. Beyond 2^52 every number is an integer, and adding 1/2 would round odd ones up.
    #[inline(always)]
    fn units(self, weight: f64) -> u64 {
        let units = weight * self.0 * self.1;
        // Through `i64`, which all sums fit: one instruction where `u64` takes ten.
        (units + if units < (1u64 << 52) as f64 { 0.5 } else { 0.0 }) as i64 as u64
    }
}

impl<T: Voxel> Units<T> for ScaledUnits<'_> {
    type Word = u64;
    #[inline(always)]
    fn units(self, stored: T) -> u64 {
        self.scale.units(self.density.lookup().weight(stored))
    }
}

/// The integer weights of a density.
#[derive(Clone, Debug)]
pub(crate) enum UnitWeights {
    /// Per ordinal, multiples of some power of two; 256 of them stay below 2^31.
    Small(Vec<u32>),
    /// Per ordinal, scaled.
    Large(Vec<u64>),
    /// By calculation, scaled.
    Scaled(Scale),
    /// [`Small`](Self::Small), where it is a ramp.
    Ramp(Ramp),
    /// [`Scaled`](Self::Scaled), where the map is a line.
    Affine(Affine),
}

impl UnitWeights {
    /// The same weights in the form that is made fastest.
    pub(crate) fn fastest(density: &Density) -> Self {
        match Self::of(density) {
            Self::Small(table) => match ramp(&table) {
                Some(ramp) => Self::Ramp(ramp),
                None => Self::Small(table),
            },
            Self::Scaled(scale) => Affine::of(density, scale).map_or(Self::Scaled(scale), Self::Affine),
            other => other,
        }
    }

    pub(crate) fn of(density: &Density) -> Self {
        let scale = Scale::by(density.report().unit_exponent());
        match density.table() {
            Some(table) => match small(table) {
                Some(units) => Self::Small(units),
                // Ordinals that no voxel has may be huge; the cast saturates and they are never summed.
                None => Self::Large(table.iter().map(|&w| scale.units(w)).collect()),
            },
            None => Self::Scaled(scale),
        }
    }
}

impl UnitWeights {
    /// The type that holds the total of any brick.
    pub(crate) fn total_type(&self, density: &Density) -> TotalType {
        match self {
            Self::Small(table) => holding(table),
            Self::Ramp(Ramp(zero)) => {
                let ordinals = density.table().unwrap_or_default().len() as u64;
                TotalType::holding(BRICK as u64 * (ordinals - 1 - u64::from(*zero)))
            }
            Self::Large(_) | Self::Scaled(_) | Self::Affine(_) => TotalType::U64,
        }
    }

    /// The units of the whole density, up to rounding.
    pub(crate) fn whole(&self, density: &Density) -> f64 {
        let weights = density.table().unwrap_or_default();
        let units = match self {
            Self::Small(table) => table.iter().fold(0, |a, b| a.max(*b)),
            Self::Ramp(Ramp(zero)) => weights.len() as u32 - 1 - zero,
            _ => {
                let Scale(first, second) = Scale::by(density.report().unit_exponent());
                return density.report().weight_sum * first * second;
            }
        };
        // Any weight tells the unit; the largest does so without loss.
        let largest = weights.iter().fold(0.0f64, |a, b| a.max(*b));
        density.report().weight_sum / (largest / f64::from(units.max(1)))
    }
}

/// [`UnitWeights::total_type`] of the weights per ordinal, which are none for wider voxels.
pub(crate) fn total_type(weights: &[f64]) -> TotalType {
    small(weights).map_or(TotalType::U64, |units| holding(&units))
}

/// The type that holds the total of any brick of such voxels.
fn holding(units: &[u32]) -> TotalType {
    TotalType::holding(BRICK as u64 * u64::from(units.iter().copied().max().unwrap_or(0)))
}

/// Weights as multiples of the largest power of two of which all are multiples, if the largest is [`SMALL`] enough. Weights
/// times a power of two give the same units, so the same draws.
fn small(table: &[f64]) -> Option<Vec<u32>> {
    let unit = power_of_two(table.iter().filter(|w| **w > 0.0).map(|w| lowest_bit(*w)).min()?);
    table.iter().map(|w| Some(w / unit).filter(|units| *units <= SMALL).map(|units| units as u32)).collect()
}

/// The ramp that a table holds, if it holds one.
fn ramp(table: &[u32]) -> Option<Ramp> {
    let zero = table.iter().rposition(|w| *w == 0)? as u32;
    table.iter().enumerate().all(|(i, w)| *w == (i as u32).saturating_sub(zero)).then_some(Ramp(zero))
}

/// The largest power of two of which a positive finite number is a multiple; for an infinite one a large number.
fn lowest_bit(w: f64) -> i32 {
    let (biased, fraction) = ((w.to_bits() >> 52) as i32, w.to_bits() & ((1 << 52) - 1));
    let digits = if biased == 0 { fraction } else { fraction | 1 << 52 };
    digits.trailing_zeros() as i32 + biased.max(1) - 1075
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
            $crate::units::UnitWeights::Ramp(ramp) => {
                let $units = *ramp;
                $body
            }
            $crate::units::UnitWeights::Affine(affine) => {
                let $units = *affine;
                $body
            }
        }
    };
}
pub(crate) use with_units;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_common_power_of_two_leaves_the_units_as_they_are() {
        let table: Vec<f64> = (0..256).map(f64::from).collect();
        let units: Vec<u32> = (0..256).collect();
        for e in [-1074, -1000, -1, 0, 1, 1000] {
            let scaled: Vec<f64> = table.iter().map(|w| w * power_of_two(e)).collect();
            assert_eq!(small(&scaled), Some(units.clone()), "2^{e}");
        }
        assert_eq!(small(&[0.0, 0.75, 3.0]), Some(vec![0, 3, 12]));
        for large in [[1.0, SMALL + 1.0], [0.1, 1.0], [5e-324, 1.0], [1.0, f64::INFINITY]] {
            assert_eq!(small(&large), None, "{large:?}");
        }
        assert_eq!(small(&[0.0]), None);
    }

    #[test]
    fn faster_forms_give_the_same_units() {
        use mcvr_scene::DensityMap;
        use mcvr_volume::{Grid, Volume};
        fn agree<T: Voxel>(voxels: Vec<T>, map: DensityMap, fast: bool) {
            let grid = Grid::with_spacing([voxels.len(), 1, 1], [1.0; 3]).unwrap();
            let volume = Volume::from_vec(grid, voxels.clone(), "test").unwrap();
            let density = Density::new(&volume, map).unwrap();
            let (plain, fastest) = (UnitWeights::of(&density), UnitWeights::fastest(&density));
            assert_eq!(matches!(fastest, UnitWeights::Ramp(_) | UnitWeights::Affine(_)), fast, "{}", T::TYPE);
            assert_eq!(plain.whole(&density), fastest.whole(&density));
            let all = |weights: &UnitWeights| -> Vec<u64> {
                with_units!(weights, &density, u => voxels.iter().map(|v| u.units(*v).to_u64()).collect())
            };
            assert_eq!(all(&plain), all(&fastest), "{}", T::TYPE);
        }
        let line =
            |slope, intercept| DensityMap { transfer: Transfer::Linear { slope, intercept }, ..DensityMap::default() };
        let noise: Vec<u64> = (0..5000u64).map(|i| i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32).collect();
        agree(noise.iter().map(|v| *v as u8).collect(), DensityMap::default(), true);
        agree(noise.iter().map(|v| *v as i8).collect(), line(0.25, -3.0), true);
        agree(noise.iter().map(|v| *v as i16).collect(), line(1.0, 1000.0), true);
        agree(noise.iter().map(|v| *v as u16).collect(), line(0.3, 0.0), false);
        agree(noise.iter().map(|v| *v as u16).collect(), line(1.0, 5.0), false);
        for map in [DensityMap::default(), line(0.37, -100.0), line(1e-280, 0.0)] {
            agree(noise.iter().map(|v| *v as u32).collect(), map.clone(), true);
            agree(noise.iter().map(|v| *v as f32 * 1e-3 - 1e5).collect(), map.clone(), true);
            agree(noise.iter().map(|v| *v as f64 * 1e-3).collect(), map, true);
        }
        let last = DensityMap { transfer: Transfer::Piecewise(vec![[0.0, 0.0], [1.0, 2.0]]), ..DensityMap::default() };
        agree(noise.iter().map(|v| *v as f32).collect(), last, false);
    }

    #[test]
    fn units_are_the_nearest_integers_at_every_size() {
        let scale = Scale::by(0);
        for (weight, units) in [(0.0, 0), (0.49, 0), (0.5, 1), (1.5, 2), (2.49, 2)] {
            assert_eq!(scale.units(weight), units);
        }
        for bits in 40..62 {
            let odd = (1u64 << bits) + 1;
            assert_eq!(scale.units(odd as f64), odd as f64 as u64, "{bits}");
        }
        for e in [-1136, -1074, -1000, -999, 0, 900] {
            let weight = power_of_two((e + 61).max(-1074));
            assert_eq!(Scale::by(e).units(weight), 1 << ((e + 61).max(-1074) - e), "2^{e}");
        }
    }
}
