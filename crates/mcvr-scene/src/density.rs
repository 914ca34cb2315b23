//! From isovalues to weights: the density map applied to a volume, and the mass that results.

use mcvr_volume::{Volume, Voxel, with_voxels};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::SceneError;
use crate::effects::Gains;

/// Voxels summed as one unit: sums do not depend on the number of threads.
const CHUNK: usize = 1 << 16;

/// How an isovalue becomes a weight (before emphasis).
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Transfer {
    /// The weight is the isovalue.
    #[default]
    Identity,
    /// `slope * isovalue + intercept`.
    Linear {
        /// Weight per isovalue.
        slope: f64,
        /// Weight of isovalue 0.
        intercept: f64,
    },
    /// Straight lines between (isovalue, weight) points, constant outside the first and the last.
    Piecewise(Vec<[f64; 2]>),
    /// Hounsfield units to linear attenuation per mm: `mu_water * (1 + HU / 1000)`.
    Hounsfield {
        /// Attenuation of water per mm at the photon energy meant.
        mu_water: f64,
    },
}

/// The report's improvement 2: isovalues from a threshold on count more, so that a faint halo dims.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Emphasis {
    /// Smallest isovalue that is emphasised.
    pub threshold: f64,
    /// Factor on the weight of emphasised isovalues.
    pub gain: f64,
}

/// What happens to voxels whose weight comes out negative.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NegativePolicy {
    /// They become 0; [`MassReport`] says how many and how much mass that drops.
    #[default]
    Clamp,
    /// They are an error.
    Refuse,
}

/// The density map `W` of METHOD section 1.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DensityMap {
    /// Isovalue to weight.
    pub transfer: Transfer,
    /// Extra weight above a threshold.
    pub emphasis: Option<Emphasis>,
    /// What to do with negative weights.
    pub negative: NegativePolicy,
    /// Factors by isovalue, as [materials](crate::Effects::gains) ask for them; scene files do not write them here.
    #[serde(skip_deserializing, skip_serializing_if = "Option::is_none")]
    pub gains: Option<Gains>,
}

impl DensityMap {
    /// Checks the parameters.
    ///
    /// # Errors
    /// [`SceneError::Density`] when one is not finite or points are not in rising order.
    pub fn check(&self) -> Result<(), SceneError> {
        let fail = |m: String| Err(SceneError::Density(m));
        match &self.transfer {
            Transfer::Identity => {}
            Transfer::Linear { slope, intercept } if slope.is_finite() && intercept.is_finite() => {}
            Transfer::Linear { slope, intercept } => {
                return fail(format!("slope and intercept must be finite, got {slope} and {intercept}"));
            }
            Transfer::Hounsfield { mu_water } if mu_water.is_finite() && *mu_water > 0.0 => {}
            Transfer::Hounsfield { mu_water } => {
                return fail(format!("the attenuation of water must be positive per mm, got {mu_water}"));
            }
            Transfer::Piecewise(points) => {
                if points.is_empty() || points.iter().flatten().any(|v| !v.is_finite()) {
                    return fail("piecewise points must be finite, and at least one".into());
                }
                if let Some(w) = points.windows(2).find(|w| w[0][0] >= w[1][0]) {
                    return fail(format!("piecewise isovalues must rise, but {} follows {}", w[1][0], w[0][0]));
                }
            }
        }
        match self.emphasis {
            Some(e) if !e.threshold.is_finite() || !e.gain.is_finite() || e.gain < 0.0 => fail(format!(
                "emphasis needs a finite threshold and a gain of at least 0, got {} and {}",
                e.threshold, e.gain
            )),
            _ => Ok(()),
        }
    }

    /// Weight of an isovalue before the negative policy.
    pub fn raw_weight(&self, isovalue: f64) -> f64 {
        let w = match &self.transfer {
            Transfer::Identity => isovalue,
            Transfer::Linear { slope, intercept } => slope * isovalue + intercept,
            Transfer::Hounsfield { mu_water } => mu_water * (1.0 + isovalue / 1000.0),
            Transfer::Piecewise(points) => piecewise(points, isovalue),
        };
        let w = match self.emphasis {
            Some(e) if isovalue >= e.threshold => w * e.gain,
            _ => w,
        };
        match &self.gains {
            Some(g) => w * g.at(isovalue),
            None => w,
        }
    }
}

fn piecewise(points: &[[f64; 2]], v: f64) -> f64 {
    let after = points.partition_point(|p| p[0] <= v);
    match (after.checked_sub(1).map(|i| points[i]), points.get(after)) {
        (Some([v0, w0]), Some([v1, w1])) => w0 + (w1 - w0) * (v - v0) / (v1 - v0),
        (Some([_, w]), None) | (None, Some(&[_, w])) => w,
        (None, None) => f64::NAN,
    }
}

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
    /// `F`: weight sum times the voxel's volume (weight units × mm³).
    pub mass: f64,
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
}

impl Density {
    /// Applies a map to a volume. Reads every voxel once.
    ///
    /// # Errors
    /// [`SceneError::Density`] when a parameter is unusable, a weight is NaN or infinite (with count and first
    /// position), a weight is negative and the policy refuses it, or nothing is left to draw.
    pub fn new(volume: &Volume, map: DensityMap) -> Result<Self, SceneError> {
        map.check()?;
        let iso = |stored: f64| volume.slope() * stored + volume.intercept();
        let (table, tally) = with_voxels!(volume.voxels(), v => scan(v, |s| map.raw_weight(iso(s))));
        if tally.bad > 0 {
            let [i, j, k] = volume.grid().unravel(tally.first_bad);
            return Err(SceneError::Density(format!(
                "{} voxels of '{}' have a weight that is not finite (first at {i},{j},{k}: isovalue {}); \
                 clean the volume or map those isovalues elsewhere",
                tally.bad,
                volume.name(),
                volume.isovalue(tally.first_bad)
            )));
        }
        if tally.negative > 0 && map.negative == NegativePolicy::Refuse {
            let [i, j, k] = volume.grid().unravel(tally.first_negative);
            return Err(SceneError::Density(format!(
                "{} voxels of '{}' have a negative weight (first at {i},{j},{k}: isovalue {}); use a map that keeps \
                 weights positive (for Hounsfield units: hounsfield) or let them be clamped to 0",
                tally.negative,
                volume.name(),
                volume.isovalue(tally.first_negative)
            )));
        }
        if tally.sum <= 0.0 || !tally.sum.is_finite() {
            return Err(SceneError::Density(format!(
                "'{}' has no usable mass: {} of {} voxels have a positive weight, their sum is {}; nothing can be drawn",
                volume.name(),
                tally.positive,
                volume.grid().len(),
                tally.sum
            )));
        }
        let report = MassReport {
            voxels: volume.grid().len() as u64,
            positive: tally.positive,
            negative: tally.negative,
            dropped: tally.dropped,
            weight_sum: tally.sum,
            max_weight: tally.max,
            mass: tally.sum * volume.grid().voxel_volume(),
        };
        let table = table.into_iter().map(|w| if w > 0.0 { w } else { 0.0 }).collect();
        Ok(Self { volume: volume.clone(), map, table, report })
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

/// Sums over the voxels, before the negative policy.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    positive: u64,
    negative: u64,
    dropped: f64,
    sum: f64,
    max: f64,
    bad: u64,
    first_bad: usize,
    first_negative: usize,
}

impl Tally {
    /// Adds `count` voxels of weight `w`, the first of them at linear index `at`.
    fn add(&mut self, w: f64, count: u64, at: usize) {
        if w > 0.0 && w.is_finite() {
            self.positive += count;
            self.sum += w * count as f64;
            self.max = self.max.max(w);
        } else if !w.is_finite() {
            self.first_bad = if self.bad == 0 { at } else { self.first_bad.min(at) };
            self.bad += count;
        } else if w < 0.0 {
            self.first_negative = if self.negative == 0 { at } else { self.first_negative.min(at) };
            self.negative += count;
            self.dropped -= w * count as f64;
        }
    }

    fn join(mut self, o: Tally) -> Tally {
        self.first_bad = if self.bad == 0 { o.first_bad } else { self.first_bad };
        self.first_negative = if self.negative == 0 { o.first_negative } else { self.first_negative };
        self.positive += o.positive;
        self.negative += o.negative;
        self.dropped += o.dropped;
        self.sum += o.sum;
        self.max = self.max.max(o.max);
        self.bad += o.bad;
        self
    }
}

/// Weights per ordinal (8- and 16-bit voxels: via a histogram) or none, and the sums. Chunks are fixed and
/// joined pairwise in order, so the error of the sum grows with the logarithm of the number of chunks.
fn scan<T: Voxel>(voxels: &[T], weight: impl Fn(f64) -> f64 + Sync) -> (Vec<f64>, Tally) {
    let Some(cardinality) = T::TYPE.cardinality() else {
        let chunks: Vec<Tally> = voxels
            .par_chunks(CHUNK)
            .enumerate()
            .map(|(c, chunk)| {
                let mut tally = Tally::default();
                for (i, v) in chunk.iter().enumerate() {
                    tally.add(weight(v.to_f64()), 1, c * CHUNK + i);
                }
                tally
            })
            .collect();
        return (Vec::new(), pairwise(&chunks));
    };
    let counts = histogram(voxels, cardinality);
    let mut table = vec![0.0; cardinality];
    let offset = if T::TYPE.name().starts_with('i') { cardinality as f64 / 2.0 } else { 0.0 };
    let mut tally = Tally::default();
    for (i, w) in table.iter_mut().enumerate() {
        *w = weight(i as f64 - offset);
        if counts[i] > 0 {
            // Positions are wanted only for the messages: look them up when there is something to report.
            let find = || voxels.iter().position(|v| v.ordinal() == Some(i)).unwrap_or(0);
            let at = if w.is_finite() && *w >= 0.0 { 0 } else { find() };
            tally.add(*w, counts[i], at);
        }
    }
    (table, tally)
}

fn pairwise(tallies: &[Tally]) -> Tally {
    match tallies {
        [] => Tally::default(),
        [one] => *one,
        _ => {
            let (a, b) = tallies.split_at(tallies.len() / 2);
            pairwise(a).join(pairwise(b))
        }
    }
}

/// How often each ordinal occurs.
fn histogram<T: Voxel>(voxels: &[T], cardinality: usize) -> Vec<u64> {
    let parts = rayon::current_num_threads().max(1);
    let chunk = voxels.len().div_ceil(parts).max(CHUNK);
    voxels
        .par_chunks(chunk)
        .map(|chunk| {
            // Four tables so that runs of equal values do not wait for one counter.
            let mut counts = vec![0u64; 4 * cardinality];
            for (i, v) in chunk.iter().enumerate() {
                if let Some(o) = v.ordinal() {
                    counts[(i & 3) * cardinality + o] += 1;
                }
            }
            (0..cardinality).map(|o| (0..4).map(|t| counts[t * cardinality + o]).sum()).collect()
        })
        .reduce(
            || vec![0u64; cardinality],
            |mut a: Vec<u64>, b| {
                a.iter_mut().zip(&b).for_each(|(a, b)| *a += b);
                a
            },
        )
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
        let map = DensityMap { transfer: Transfer::Hounsfield { mu_water: 0.02 }, ..DensityMap::default() };
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
