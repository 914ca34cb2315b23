//! What follows from the records.

use mcvr::sampling::VoxelOrder;

use crate::entrants::{Entrant, MC, NET, Points, entrants};
use crate::records::{Circumstances, Key, Record};

/// Powers of two of the tables.
pub const TABLE: [u32; 3] = [18, 22, 26];
/// The error of the tables of samples.
pub const TARGET: f64 = 0.02;

/// A scan from a view.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    pub scan: String,
    pub view: String,
    pub described: String,
    pub angles: [f64; 2],
    pub depth_axis: String,
    pub drawable: u64,
}

pub struct Figures<'a> {
    records: &'a [Record],
    pub places: Vec<Place>,
    pub methods: Vec<Entrant>,
    /// [`TABLE`], or what a quick run has.
    pub levels: Vec<u32>,
}

/// Samples that an error takes, and whether that lies beyond the largest measured number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Needed {
    pub samples: f64,
    pub extrapolated: bool,
}

pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    (n > 0).then(|| 0.5 * (values[(n - 1) / 2] + values[n / 2]))
}

/// Geometric mean.
pub fn geometric(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let logs: Vec<f64> = values.into_iter().map(f64::ln).collect();
    (!logs.is_empty()).then(|| (logs.iter().sum::<f64>() / logs.len() as f64).exp())
}

/// Where a polyline of (log2 samples, log2 error), rising in samples, reaches an error; beyond its end its last piece goes on.
pub fn reach(points: &[(f64, f64)], error: f64) -> Option<Needed> {
    let last = points.windows(2).last()?;
    let inside = points.windows(2).find(|w| w[0].1 >= error && w[1].1 <= error);
    let (a, b) = inside.map_or((last[0], last[1]), |w| (w[0], w[1]));
    let extrapolated = inside.is_none();
    // Beyond its beginning, or flat, there is nothing to say.
    if b.1 >= a.1 || extrapolated && error > b.1 {
        return None;
    }
    Some(Needed { samples: 2f64.powf(a.0 + (b.0 - a.0) * (error - a.1) / (b.1 - a.1)), extrapolated })
}

impl<'a> Figures<'a> {
    pub fn of(records: &'a [Record]) -> Self {
        let places = records.iter().filter_map(|r| match r {
            Record::Scene { scan, view, described, angles, depth_axis, drawable, .. } => Some(Place {
                scan: scan.clone(),
                view: view.clone(),
                described: described.clone(),
                angles: *angles,
                depth_axis: depth_axis.clone(),
                drawable: *drawable,
            }),
            _ => None,
        });
        let mut figures = Self { records, places: places.collect(), methods: entrants(), levels: TABLE.to_vec() };
        let measured = |l: &u32| records.iter().any(|r| matches!(r, Record::Error { key, .. } if key.level == *l));
        if !figures.levels.iter().any(measured) {
            figures.levels = (10..18).filter(measured).collect();
        }
        figures
    }

    /// The record of this, and of the net where a method is the net in this place.
    fn find(&self, place: &Place, method: &str, level: u32, timed: bool) -> Option<&'a Record> {
        let inner = format!("{} inner", place.depth_axis);
        let exchanged = |m: &Entrant| m.name == method && matches!(m.points, Points::Exchanged(_));
        let same = method == inner || timed && self.methods.iter().any(exchanged);
        let key = Key {
            scan: place.scan.clone(),
            view: place.view.clone(),
            method: if same { NET.into() } else { method.into() },
            level,
        };
        self.records.iter().rev().find(|r| match r {
            Record::Error { key: k, .. } => !timed && *k == key,
            Record::Time { key: k, .. } => timed && *k == key,
            _ => false,
        })
    }

    /// RMSE over the mean pixel and its standard error. Of several passes it is that of the last image.
    pub fn error(&self, place: &Place, method: &str, level: u32) -> Option<(f64, f64)> {
        let method = match method {
            "passes" => "sequence",
            "restarts" => NET,
            other => other,
        };
        match self.find(place, method, level, false)? {
            Record::Error { rel_rmse, standard_error, .. } => Some((*rel_rmse, *standard_error)),
            _ => None,
        }
    }

    /// Median of the seconds of an image.
    pub fn seconds(&self, place: &Place, method: &str, level: u32) -> Option<f64> {
        match self.find(place, method, level, true)? {
            Record::Time { seconds, .. } => median(seconds.clone()),
            _ => None,
        }
    }

    /// Error × √seconds: what is left when the number of samples is free and errors fall as its root.
    pub fn cost(&self, place: &Place, method: &str, level: u32) -> Option<f64> {
        Some(self.error(place, method, level)?.0 * self.seconds(place, method, level)?.sqrt())
    }

    /// Measured errors of a method, rising in samples.
    fn curve(&self, place: &Place, method: &str) -> Vec<(f64, f64)> {
        (10..=30).filter_map(|level| Some((f64::from(level), self.error(place, method, level)?.0.log2()))).collect()
    }

    /// Slope of the last two measured errors.
    pub fn slope(&self, place: &Place, method: &str) -> Option<f64> {
        let curve = self.curve(place, method);
        curve.windows(2).last().map(|w| (w[1].1 - w[0].1) / (w[1].0 - w[0].0))
    }

    /// Samples that independent sampling needs: its slope is exactly -1/2, so that all measured errors tell one constant.
    pub fn mc_needs(&self, place: &Place, error: f64) -> Option<f64> {
        let constant = geometric(self.curve(place, MC).iter().map(|(l, e)| 2f64.powf(e + 0.5 * l)))?;
        Some((constant / error).powi(2))
    }

    pub fn needs(&self, place: &Place, method: &str, error: f64) -> Option<Needed> {
        reach(&self.curve(place, method), error.log2())
    }

    /// The low-discrepancy method that reaches an error with the fewest samples; of equals the first. Those whose measured
    /// errors reach it come before those that would have to go on.
    pub fn best(&self, place: &Place, error: f64) -> Option<(&'static str, Needed)> {
        let all = self.methods.iter().filter(|m| m.is_qmc() && m.order_in(place));
        let needs = all.filter_map(|m| Some((m.name, self.needs(place, m.name, error)?)));
        needs.min_by(|a, b| {
            let measured = a.1.extrapolated.cmp(&b.1.extrapolated);
            measured.then(a.1.samples.total_cmp(&b.1.samples))
        })
    }

    /// Checks against the truth.
    pub fn biases(&self) -> impl Iterator<Item = (&'a Key, [f64; 4])> {
        self.records.iter().filter_map(|r| match r {
            Record::Bias { key, ratio, standard_error, truth_ratio, truth_error } => {
                Some((key, [*ratio, *standard_error, *truth_ratio, *truth_error]))
            }
            _ => None,
        })
    }

    /// Where errors and times were measured, without repetition.
    pub fn circumstances(&self, timed: bool) -> Vec<&'a Circumstances> {
        let mut all: Vec<&Circumstances> = vec![];
        for record in self.records {
            let (Record::Error { circumstances, .. } | Record::Time { circumstances, .. }) = record else { continue };
            if record.is_time() == timed && !all.contains(&circumstances) {
                all.push(circumstances);
            }
        }
        all
    }
}

impl Entrant {
    /// False for the name under which the net itself would be listed twice.
    fn order_in(&self, place: &Place) -> bool {
        self.order == VoxelOrder::Depth || self.name != format!("{} inner", place.depth_axis)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_reached_between_points_and_beyond_the_last() {
        let points = [(18.0, -1.0), (22.0, -3.0), (26.0, -6.0)];
        let at = |error| reach(&points, error);
        assert_eq!(at(-2.0), Some(Needed { samples: 2f64.powi(20), extrapolated: false }));
        assert_eq!(at(-6.0), Some(Needed { samples: 2f64.powi(26), extrapolated: false }));
        assert_eq!(at(-7.5), Some(Needed { samples: 2f64.powi(28), extrapolated: true }));
        assert_eq!((at(0.0), reach(&points[..1], -2.0)), (None, None));
        assert_eq!(reach(&[(18.0, -1.0), (20.0, -1.0)], -2.0), None);
    }

    #[test]
    fn medians_and_geometric_means() {
        assert_eq!((median(vec![3.0, 1.0, 2.0]), median(vec![4.0, 1.0]), median(vec![])), (Some(2.0), Some(2.5), None));
        assert!((geometric([1.0, 4.0]).unwrap() - 2.0).abs() < 1e-12 && geometric([]).is_none());
    }
}
