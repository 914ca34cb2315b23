//! From isovalues to weights: the density map applied to a volume, and the mass that results.

mod attenuation;
mod hounsfield;
mod map;
mod occupancy;
mod power;
mod tally;

use std::sync::{Arc, OnceLock};

use mcvr_volume::{Volume, Voxel, with_voxels};
use serde::Serialize;

use crate::SceneError;

pub use attenuation::Substance;
pub use hounsfield::Hounsfield;
pub use map::{DensityMap, Emphasis, NegativePolicy, Transfer};
pub use occupancy::Occupancy;
pub(crate) use power::exponent;
pub use power::power_of_two;
use tally::{below, scan};

/// What the density map made of a volume.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize)]
pub struct MassReport {
    /// Number of voxels.
    pub voxels: u64,
    /// Voxels of positive weight: those that can be drawn.
    pub positive: u64,
    /// Voxels whose weight came out negative and was set to 0.
    pub negative: u64,
    /// Sum of the absolute weights of those (weight units).
    pub dropped: f64,
    /// Sum of the weights that remain (weight units).
    pub weight_sum: f64,
    /// Largest weight.
    pub max_weight: f64,
    /// Smallest positive weight.
    pub min_weight: f64,
    /// Voxels whose positive weight is less than half a [unit](MassReport::unit_exponent), 2^-62 of the sum or less: samplers
    /// never draw them. Ray casting has them.
    pub faint: u64,
    /// Sum of those weights (weight units).
    pub faint_sum: f64,
    /// `F`: weight sum times the voxel's volume (weight units × mm³).
    pub mass: f64,
}

impl MassReport {
    /// Samplers sum weights as whole multiples of two to this power: between 2^61 and 2^62 of them make the whole.
    pub fn unit_exponent(&self) -> i32 {
        exponent(self.weight_sum) - 61
    }
}

/// A way to turn stored voxels of type `T` into weights; compiled once per type, free of branches on the map.
pub trait WeightFn<T>: Copy + Send + Sync {
    /// Weight (≥ 0) of a stored value.
    fn weight(self, stored: T) -> f64;
}

/// Weights by look-up or by calculation, for any voxel type.
#[derive(Clone, Copy)]
pub struct WeightLookup<'a>(&'a Density);

impl<T: Voxel> WeightFn<T> for WeightLookup<'_> {
    #[inline(always)]
    fn weight(self, stored: T) -> f64 {
        match stored.ordinal() {
            // The table has one entry per ordinal of the volume's own type.
            Some(i) => self.0.table[i],
            None => self.0.weight_of(self.0.volume.slope() * stored.to_f64() + self.0.volume.intercept()),
        }
    }
}

/// A volume seen through a density map: the field's weights `w_i`.
#[derive(Clone, Debug)]
pub struct Density {
    volume: Volume,
    map: DensityMap,
    /// Weight per ordinal for 8- and 16-bit voxels, empty otherwise.
    table: Vec<f64>,
    report: MassReport,
    /// Made when it is first asked for, once for all copies.
    occupancy: Arc<OnceLock<Occupancy>>,
    /// The same of [`Density::equal_voxels`].
    equal_voxels: Arc<OnceLock<f64>>,
}

impl Density {
    /// Applies a map to a volume. Reads every voxel once. With `concentrate`, [`Density::volume`] and [`Density::map`] are those of
    /// the moved weights.
    ///
    /// # Errors
    /// [`SceneError::Density`] when a parameter is unusable, a weight is NaN or infinite (with count and first
    /// position), a weight is negative and the policy refuses it, or nothing is left to draw.
    pub fn new(volume: &Volume, map: DensityMap) -> Result<Self, SceneError> {
        map.check()?;
        if map.concentrate {
            let plain = Self::new(volume, DensityMap { concentrate: false, ..map })?;
            let moved = plain.concentrated().map_err(|e| SceneError::Density(e.to_string()))?;
            return Self::new(&moved, DensityMap::default());
        }
        let (table, tally) = with_voxels!(volume.voxels(), v => scan(volume, &map, v));
        // Positions are wanted only for the messages: they are looked up when there is something to report.
        let first = |wanted: fn(f64) -> bool| {
            (0..volume.grid().len()).find(|&i| wanted(map.raw_weight(volume.isovalue(i)))).unwrap_or(0)
        };
        if tally.bad > 0 {
            let at = first(|w| !w.is_finite());
            let [i, j, k] = volume.grid().unravel(at);
            return Err(SceneError::Density(format!(
                "{} voxels of '{}' have a weight that is not finite (first at {i},{j},{k}: isovalue {}); \
                 clean the volume or map those isovalues elsewhere",
                tally.bad,
                volume.name(),
                volume.isovalue(at)
            )));
        }
        if tally.negative > 0 && map.negative == NegativePolicy::Refuse {
            let at = first(|w| w < 0.0);
            let [i, j, k] = volume.grid().unravel(at);
            return Err(SceneError::Density(format!(
                "{} voxels of '{}' have a negative weight (first at {i},{j},{k}: isovalue {}); use a map that keeps \
                 weights positive (for Hounsfield units: hounsfield) or let them be clamped to 0",
                tally.negative,
                volume.name(),
                volume.isovalue(at)
            )));
        }
        let mass = tally.sum * volume.grid().voxel_volume();
        if mass.is_infinite() || (mass == 0.0 && tally.sum > 0.0) {
            return Err(SceneError::Density(format!(
                "the weights of '{}' sum to {:e}, which times the voxel's volume of {:e} mm3 is {mass:e}: beyond what 64-bit \
                 numbers hold; scale the weights (linear: slope)",
                volume.name(),
                tally.sum,
                volume.grid().voxel_volume()
            )));
        }
        if tally.sum <= 0.0 {
            return Err(SceneError::Density(format!(
                "'{}' has no usable mass: {} of {} voxels have a positive weight, their sum is {}; nothing can be drawn",
                volume.name(),
                tally.positive,
                volume.grid().len(),
                tally.sum
            )));
        }
        let mut report = MassReport {
            voxels: volume.grid().len() as u64,
            positive: tally.positive,
            negative: tally.negative,
            dropped: tally.dropped,
            weight_sum: tally.sum,
            max_weight: tally.max,
            min_weight: tally.min,
            faint: 0,
            faint_sum: 0.0,
            mass,
        };
        // Half a unit below the smallest number is 0: then nothing is faint.
        let half = power_of_two(report.unit_exponent() - 1);
        if tally.min < half {
            (report.faint, report.faint_sum) = with_voxels!(volume.voxels(), v => below(volume, &map, v, half));
        }
        let table = table.into_iter().map(|w| if w > 0.0 { w } else { 0.0 }).collect();
        Ok(Self { volume: volume.clone(), map, table, report, occupancy: Arc::default(), equal_voxels: Arc::default() })
    }

    /// The volume.
    pub fn volume(&self) -> &Volume {
        &self.volume
    }

    /// The map.
    pub fn map(&self) -> &DensityMap {
        &self.map
    }

    /// Counts and sums.
    pub fn report(&self) -> &MassReport {
        &self.report
    }

    /// Total mass `F` (weight units × mm³).
    pub fn mass(&self) -> f64 {
        self.report.mass
    }

    /// Weight per ordinal (see [`Voxel::ordinal`]) for 8- and 16-bit voxels.
    pub fn table(&self) -> Option<&[f64]> {
        (!self.table.is_empty()).then_some(&self.table[..])
    }

    /// Which bricks of 8³ voxels hold any weight. The first call, on this density or a copy of it, reads every voxel once, in
    /// parallel; later calls cost nothing.
    pub fn occupancy(&self) -> &Occupancy {
        self.occupancy.get_or_init(|| Occupancy::of(self))
    }

    /// How many voxels of equal weight would share the whole as these do: `(Σ w)² / Σ w²`, told by 64 bricks of those that hold any weight (by
    /// all where there are fewer). The first call, on this density or a copy of it, reads them.
    pub fn equal_voxels(&self) -> f64 {
        *self.equal_voxels.get_or_init(|| {
            let bricks: Vec<[usize; 3]> = self.occupancy().all().collect();
            let number = bricks.len().min(64);
            let dims = self.volume.grid().dims();
            let (mut sum, mut squares) = (0.0, 0.0);
            for n in 0..number {
                let from = bricks[n * bricks.len() / number].map(|b| b * Occupancy::SIDE);
                let end: [usize; 3] = std::array::from_fn(|a| (from[a] + Occupancy::SIDE).min(dims[a]));
                for (z, y) in (from[2]..end[2]).flat_map(|z| (from[1]..end[1]).map(move |y| (z, y))) {
                    let row = self.volume.grid().linear([from[0], y, z]);
                    for w in (row..row + end[0] - from[0]).map(|i| self.weight(i) / self.report.max_weight) {
                        sum += w;
                        squares += w * w;
                    }
                }
            }
            let least = self.report.weight_sum / self.report.max_weight;
            if squares > 0.0 {
                (least * sum / squares).clamp(least, (self.report.positive as f64).max(least))
            } else {
                least
            }
        })
    }

    /// Weight (≥ 0) of an isovalue.
    #[inline]
    pub fn weight_of(&self, isovalue: f64) -> f64 {
        let w = self.map.raw_weight(isovalue);
        if w > 0.0 { w } else { 0.0 }
    }

    /// Weight (≥ 0) of the voxel at a linear index.
    ///
    /// # Panics
    /// When the index is out of range.
    pub fn weight(&self, linear: usize) -> f64 {
        with_voxels!(self.volume.voxels(), v => self.lookup().weight(v[linear]))
    }

    /// The weight function in the form that generic loops use.
    pub fn lookup(&self) -> WeightLookup<'_> {
        WeightLookup(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr_volume::Grid;

    fn volume<T: Voxel>(v: Vec<T>) -> Volume {
        let grid = Grid::with_spacing([v.len(), 1, 1], [2.0, 1.0, 1.0]).unwrap();
        Volume::from_vec(grid, v, "test").unwrap()
    }

    #[test]
    fn equal_voxels_are_the_participation_ratio() {
        let of = |voxels: Vec<u8>| Density::new(&volume(voxels), DensityMap::default()).unwrap().equal_voxels();
        // 32² / 80 of eight of each.
        let mixed = [[1, 3].repeat(4), vec![0; 30], [3, 1].repeat(4)].concat();
        assert!((of(mixed) - 12.8).abs() < 1e-12);
        assert!((of([vec![0; 17], vec![5; 9]].concat()) - 9.0).abs() < 1e-12);
    }

    #[test]
    fn mass_is_the_sum_of_weights_times_the_voxel_volume() {
        let d = Density::new(&volume(vec![0u8, 3, 250]), DensityMap::default()).unwrap();
        assert_eq!((d.mass(), d.report().positive), (506.0, 2));
        assert_eq!(d.weight(2), 250.0);
    }

    #[test]
    fn negative_weights_are_counted_and_their_mass_stated_or_refused() {
        let v = volume(vec![-1000i16, -5, 7, 100]);
        let d = Density::new(&v, DensityMap::default()).unwrap();
        assert_eq!((d.report().negative, d.report().dropped, d.report().weight_sum), (2, 1005.0, 107.0));
        let refuse = DensityMap { negative: NegativePolicy::Refuse, ..DensityMap::default() };
        let message = Density::new(&v, refuse).unwrap_err().to_string();
        assert!(message.contains("2 voxels") && message.contains("0,0,0"), "{message}");
    }

    #[test]
    fn hounsfield_air_weighs_nothing_and_water_its_attenuation() {
        let map =
            DensityMap { transfer: Transfer::Hounsfield(Hounsfield::of_water(0.02).unwrap()), ..DensityMap::default() };
        let d = Density::new(&volume(vec![-1000i16, 0, 1000]), map).unwrap();
        assert_eq!([d.weight(0), d.weight(1), d.weight(2)], [0.0, 0.02, 0.04]);
    }

    #[test]
    fn emphasis_multiplies_from_the_threshold_on() {
        let map = DensityMap { emphasis: Some(Emphasis { threshold: 10.0, gain: 4.0 }), ..DensityMap::default() };
        let d = Density::new(&volume(vec![9u8, 10, 11]), map).unwrap();
        assert_eq!([d.weight(0), d.weight(1), d.weight(2)], [9.0, 40.0, 44.0]);
    }

    #[test]
    fn piecewise_interpolates_inside_and_is_constant_outside() {
        let map = DensityMap { transfer: Transfer::Piecewise(vec![[10.0, 1.0], [20.0, 3.0]]), ..DensityMap::default() };
        let at = |v: f64| map.raw_weight(v);
        assert_eq!([at(0.0), at(10.0), at(15.0), at(20.0), at(99.0)], [1.0, 1.0, 2.0, 3.0, 3.0]);
    }

    #[test]
    fn an_empty_or_infinite_field_is_an_error_that_says_where() {
        assert!(Density::new(&volume(vec![0u8; 5]), DensityMap::default()).is_err());
        let message =
            Density::new(&volume(vec![1f32, f32::NAN, f32::INFINITY]), DensityMap::default()).unwrap_err().to_string();
        assert!(message.contains("2 voxels") && message.contains("1,0,0"), "{message}");
    }

    #[test]
    fn signed_and_unsigned_tables_agree_with_direct_evaluation() {
        let d = Density::new(
            &volume(vec![-128i8, -1, 0, 1, 127]),
            DensityMap { transfer: Transfer::Linear { slope: 2.0, intercept: 300.0 }, ..DensityMap::default() },
        )
        .unwrap();
        for i in 0..5 {
            assert_eq!(d.weight(i), d.weight_of(d.volume().isovalue(i)));
        }
    }
}
