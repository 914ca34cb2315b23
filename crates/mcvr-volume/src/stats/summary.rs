//! Range, mean, counts and histogram of a volume's isovalues.

use rayon::prelude::*;
use serde::Serialize;

use crate::{Volume, Voxel};

/// Number of bins of [`Summary::histogram`].
pub const HISTOGRAM_BINS: usize = 64;

/// Voxels that are summed at a time: fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 1 << 16;

/// Statistics of the isovalues of a volume. Values that are NaN or infinite are counted and otherwise left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Number of voxels.
    pub count: u64,
    /// Smallest finite isovalue; NaN when there is none.
    pub min: f64,
    /// Largest finite isovalue; NaN when there is none.
    pub max: f64,
    /// Mean of the finite isovalues; NaN when there is none. Exact for integer voxels (slope 1) while their sum stays
    /// below 2^53, else an `f64` sum of sums over 65,536 voxels.
    pub mean: f64,
    /// Number of isovalues that are exactly 0.
    pub zeros: u64,
    /// Number of negative finite isovalues.
    pub negatives: u64,
    /// Number of NaNs.
    pub nan: u64,
    /// Number of infinite values of either sign.
    pub infinite: u64,
    /// Counts of finite isovalues in 64 bins of equal width from `min` to `max`; each bin holds its lower edge, the last
    /// one `max` as well. When `min` equals `max`, everything is in the first.
    pub histogram: Vec<u64>,
}

impl Summary {
    /// Computes the statistics, in parallel; the same result, bit for bit, on any number of threads.
    pub fn of(volume: &Volume) -> Self {
        let (slope, intercept) = (volume.slope(), volume.intercept());
        with_voxels!(volume.voxels(), v => summarise(v, slope, intercept))
    }

    /// Share of voxels whose isovalue is exactly 0, from 0 to 1.
    pub fn zero_share(&self) -> f64 {
        self.zeros as f64 / self.count as f64
    }

    /// Share of voxels whose isovalue is negative, from 0 to 1.
    pub fn negative_share(&self) -> f64 {
        self.negatives as f64 / self.count as f64
    }

    /// Lower edge of histogram bin `b`; `bin_edge(HISTOGRAM_BINS)` is `max`.
    pub fn bin_edge(&self, b: usize) -> f64 {
        let t = b as f64 / HISTOGRAM_BINS as f64;
        // Not min + t * (max - min), whose difference may overflow.
        self.min * (1.0 - t) + self.max * t
    }
}

/// Sums over one chunk.
struct Part {
    min: f64,
    max: f64,
    sum: f64,
    zeros: u64,
    negatives: u64,
    nan: u64,
    infinite: u64,
}

fn part<T: Voxel>(chunk: &[T], slope: f64, intercept: f64) -> Part {
    let mut p =
        Part { min: f64::INFINITY, max: f64::NEG_INFINITY, sum: 0.0, zeros: 0, negatives: 0, nan: 0, infinite: 0 };
    for v in chunk {
        let x = slope * v.to_f64() + intercept;
        if !x.is_finite() {
            p.nan += u64::from(x.is_nan());
            p.infinite += u64::from(x.is_infinite());
            continue;
        }
        p.min = p.min.min(x);
        p.max = p.max.max(x);
        p.sum += x;
        p.zeros += u64::from(x == 0.0);
        p.negatives += u64::from(x < 0.0);
    }
    p
}

fn summarise<T: Voxel>(voxels: &[T], slope: f64, intercept: f64) -> Summary {
    let parts: Vec<Part> = voxels.par_chunks(CHUNK).map(|c| part(c, slope, intercept)).collect();
    let nan: u64 = parts.iter().map(|p| p.nan).sum();
    let infinite: u64 = parts.iter().map(|p| p.infinite).sum();
    let finite = voxels.len() as u64 - nan - infinite;
    let (mut min, mut max) = (f64::NAN, f64::NAN);
    for p in &parts {
        if p.min <= p.max {
            min = min.min(p.min);
            max = max.max(p.max);
        }
    }
    let sum: f64 = parts.iter().map(|p| p.sum).sum();
    Summary {
        count: voxels.len() as u64,
        min,
        max,
        mean: if finite == 0 { f64::NAN } else { sum / finite as f64 },
        zeros: parts.iter().map(|p| p.zeros).sum(),
        negatives: parts.iter().map(|p| p.negatives).sum(),
        nan,
        infinite,
        histogram: histogram(voxels, slope, intercept, min, max),
    }
}

fn histogram<T: Voxel>(voxels: &[T], slope: f64, intercept: f64, min: f64, max: f64) -> Vec<u64> {
    // Halves, because the difference of two finite values may overflow.
    let half_range = max / 2.0 - min / 2.0;
    let scale = if half_range > 0.0 { HISTOGRAM_BINS as f64 / half_range } else { 0.0 };
    let count = |chunk: &[T]| {
        let mut bins = vec![0u64; HISTOGRAM_BINS];
        for v in chunk {
            let x = slope * v.to_f64() + intercept;
            if x.is_finite() {
                let b = ((x / 2.0 - min / 2.0) * scale) as usize;
                bins[b.min(HISTOGRAM_BINS - 1)] += 1;
            }
        }
        bins
    };
    voxels.par_chunks(CHUNK).map(count).reduce(
        || vec![0u64; HISTOGRAM_BINS],
        |mut a, b| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
            a
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Grid;

    fn volume<T: Voxel>(voxels: Vec<T>) -> Volume {
        Volume::from_vec(Grid::with_spacing([voxels.len(), 1, 1], [1.0; 3]).unwrap(), voxels, "test").unwrap()
    }

    #[test]
    fn nan_and_infinity_are_counted_and_left_out() {
        let s = Summary::of(&volume(vec![f32::NAN, 1.0, f32::INFINITY, -3.0, 0.0, f32::NEG_INFINITY]));
        assert_eq!((s.count, s.nan, s.infinite, s.zeros, s.negatives), (6, 1, 2, 1, 1));
        assert_eq!((s.min, s.max), (-3.0, 1.0));
        assert!((s.mean + 2.0 / 3.0).abs() < 1e-15);
        assert_eq!(s.histogram.iter().sum::<u64>(), 3);
    }

    #[test]
    fn slope_and_intercept_apply() {
        let s = Summary::of(&volume(vec![0i16, 100, 200]).with_rescale(-2.0, 100.0).unwrap());
        assert_eq!((s.min, s.max, s.mean, s.zeros, s.negatives), (-300.0, 100.0, -100.0, 0, 2));
    }

    #[test]
    fn the_histogram_counts_each_byte_value_in_its_bin() {
        let s = Summary::of(&volume((0..=255u8).collect()));
        assert_eq!(s.histogram.iter().sum::<u64>(), 256);
        assert!(s.histogram.iter().all(|&n| (3..=5).contains(&n)));
        assert_eq!((s.bin_edge(0), s.bin_edge(HISTOGRAM_BINS)), (0.0, 255.0));
    }

    #[test]
    fn a_field_without_a_finite_value_or_with_one_value_has_a_summary() {
        let s = Summary::of(&volume(vec![f64::NAN; 3]));
        assert!(s.min.is_nan() && s.max.is_nan() && s.mean.is_nan());
        assert_eq!(s.histogram.iter().sum::<u64>(), 0);
        assert_eq!(Summary::of(&volume(vec![7u8; 5])).histogram[0], 5);
        let s = Summary::of(&volume(vec![f64::MAX, f64::MIN]));
        assert_eq!((s.histogram[0], s.histogram[HISTOGRAM_BINS - 1]), (1, 1));
    }

    #[test]
    fn results_do_not_depend_on_the_number_of_threads() {
        let v = volume((0..300_000u32).map(|i| (i.wrapping_mul(2_654_435_761) as f32).sin()).collect());
        let on = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| Summary::of(&v));
        assert_eq!(on(1), on(5));
    }
}
