//! Sums over the voxels, before the negative policy: by the cheapest way that gives the same numbers.

use mcvr_volume::{Volume, Voxel, with_voxels};

/// Compiles a function for AVX2 as well, which runs where the processor has it; `name::portable` is the other one. No step is
/// fused or reordered: both give the same bits.
macro_rules! avx2 {
    (fn $name:ident [$($declared:tt)*] [$($used:tt)*] ($($arg:ident: $ty:ty),*) -> $r:ty $body:block) => {
        mod $name {
            use super::*;

            #[inline(always)]
            pub(super) fn portable<$($declared)*>($($arg: $ty),*) -> $r $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,popcnt")]
            pub(super) fn avx2<$($declared)*>($($arg: $ty),*) -> $r {
                portable::<$($used)*>($($arg),*)
            }
        }

        fn $name<$($declared)*>($($arg: $ty),*) -> $r {
            #[cfg(target_arch = "x86_64")]
            if mcvr_volume::SimdLevel::detect() >= mcvr_volume::SimdLevel::Avx2 {
                // SAFETY: `detect` names only what the processor has.
                return unsafe { $name::avx2::<$($used)*>($($arg),*) };
            }
            $name::portable::<$($used)*>($($arg),*)
        }
    };
}

mod histogram;
mod ramp;
#[cfg(target_arch = "x86_64")]
mod ramp_avx2;
mod wide;

use super::{DensityMap, Transfer};

/// Sums over the voxels, before the negative policy.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tally {
    pub(super) positive: u64,
    pub(super) negative: u64,
    pub(super) dropped: f64,
    pub(super) sum: f64,
    pub(super) max: f64,
    /// Smallest positive weight, 0 when there is none.
    pub(super) min: f64,
    pub(super) bad: u64,
}

impl Tally {
    /// Adds `count` voxels of weight `w`.
    fn add(&mut self, w: f64, count: u64) {
        if w > 0.0 && w.is_finite() {
            self.positive += count;
            self.sum += w * count as f64;
            self.max = self.max.max(w);
            self.min = smaller(self.min, w);
        } else if !w.is_finite() {
            self.bad += count;
        } else if w < 0.0 {
            self.negative += count;
            self.dropped -= w * count as f64;
        }
    }

    fn join(mut self, o: Tally) -> Tally {
        self.positive += o.positive;
        self.negative += o.negative;
        self.dropped += o.dropped;
        self.sum += o.sum;
        self.max = self.max.max(o.max);
        self.min = smaller(self.min, o.min);
        self.bad += o.bad;
        self
    }
}

/// The smaller of two minima of which 0 stands for none.
fn smaller(a: f64, b: f64) -> f64 {
    if a == 0.0 || (b > 0.0 && b < a) { b } else { a }
}

/// Weights per ordinal (8- and 16-bit voxels) or none, and the sums.
pub(super) fn scan<T: Voxel>(volume: &Volume, map: &DensityMap, voxels: &[T]) -> (Vec<f64>, Tally) {
    let (slope, intercept) = (volume.slope(), volume.intercept());
    let Some(cardinality) = T::TYPE.cardinality() else {
        // Maps without a branch are vectorised.
        let plain = map.emphasis.is_none() && map.gains.is_none();
        let tally = match map.transfer {
            Transfer::Identity if plain => wide::tally(voxels, |s| slope * s + intercept),
            Transfer::Linear { slope: a, intercept: b } if plain => {
                wide::tally(voxels, |s| a * (slope * s + intercept) + b)
            }
            _ => wide::tally(voxels, |s| map.raw_weight(slope * s + intercept)),
        };
        return (Vec::new(), tally);
    };
    let table = raw_weights::<T>(volume, map, cardinality);
    let tally = ramp::tally(voxels, &table).unwrap_or_else(|| histogram::tally(voxels, &table));
    (table, tally)
}

/// Weight per ordinal, before the negative policy.
fn raw_weights<T: Voxel>(volume: &Volume, map: &DensityMap, cardinality: usize) -> Vec<f64> {
    let (slope, intercept) = (volume.slope(), volume.intercept());
    let first = if T::TYPE.name().starts_with('i') { cardinality as f64 / 2.0 } else { 0.0 };
    (0..cardinality).map(|i| map.raw_weight(slope * (i as f64 - first) + intercept)).collect()
}

impl DensityMap {
    /// What [`Density::table`](crate::Density::table) of a volume will be, without reading a voxel: the weight per ordinal of 8- and 16-bit
    /// voxels, nothing for wider ones and for moved weights, which are wider.
    pub fn table(&self, volume: &Volume) -> Vec<f64> {
        fn of<T: Voxel>(volume: &Volume, map: &DensityMap, _: &[T]) -> Vec<f64> {
            let cardinality = T::TYPE.cardinality().filter(|_| !map.concentrate).unwrap_or(0);
            let weights = raw_weights::<T>(volume, map, cardinality).into_iter();
            weights.map(|w| if w > 0.0 { w } else { 0.0 }).collect()
        }
        with_voxels!(volume.voxels(), v => of(volume, self, v))
    }
}

/// Number and sum of the positive weights below a bound.
pub(super) fn below<T: Voxel>(volume: &Volume, map: &DensityMap, voxels: &[T], bound: f64) -> (u64, f64) {
    let faint = |w: f64| if w < bound { w.max(0.0) } else { 0.0 };
    let (slope, intercept) = (volume.slope(), volume.intercept());
    let tally = match T::TYPE.cardinality() {
        None => wide::tally(voxels, |s| faint(map.raw_weight(slope * s + intercept))),
        Some(_) => {
            let table: Vec<f64> = scan::<T>(volume, map, &[]).0.into_iter().map(faint).collect();
            histogram::tally(voxels, &table)
        }
    };
    (tally.positive, tally.sum)
}
