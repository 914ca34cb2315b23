//! At how many samples an image may be looked at, and in which runs they are drawn.

/// Samples of a replicate at the first look.
pub const FIRST: u64 = 1 << 10;

/// Numbers of samples of one replicate at which the image may be looked at: [`FIRST`], and four to each doubling
/// (4, 5, 6, 7, 8, 10, 12, 14, 16, ... times a power of two), up to the last. Known before the first sample, so that each look can be
/// given its share of the risk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    last: u64,
}

impl Schedule {
    /// The schedule that ends at `last` samples of a replicate, wherever that is.
    pub fn new(last: u64) -> Self {
        Self { last: last.max(1) }
    }

    /// Last number of samples.
    pub fn last(self) -> u64 {
        self.last
    }

    /// The first look at or after `samples`.
    pub fn at_least(self, samples: u64) -> u64 {
        let step = step_below(samples.max(FIRST));
        (samples.max(FIRST).div_ceil(step) * step).min(self.last)
    }

    /// The last look at or before `samples`; 0 when there is none.
    pub fn at_most(self, samples: u64) -> u64 {
        match samples {
            _ if samples >= self.last => self.last,
            _ if samples < FIRST => 0,
            _ => samples / step_below(samples) * step_below(samples),
        }
    }

    /// The look after the one at `samples`.
    pub fn after(self, samples: u64) -> u64 {
        self.at_least(samples + 1)
    }

    /// Number of looks.
    pub fn looks(self) -> u64 {
        let mut looks = 1;
        let mut at = self.at_least(0);
        while at < self.last {
            at = self.after(at);
            looks += 1;
        }
        looks
    }
}

/// A quarter of the power of two at or below.
fn step_below(samples: u64) -> u64 {
    (1 << samples.ilog2()) / 4
}

/// The interval cut at every look between: the runs in which independent samples are drawn, so that an image stopped at a look
/// and a direct run to it draw the same.
pub fn steps(from: u64, to: u64) -> Vec<(u64, u64)> {
    let all = Schedule::new(to);
    let mut runs = vec![];
    let mut at = from;
    while at < to {
        let next = all.after(at);
        runs.push((at, next - at));
        at = next;
    }
    runs
}

/// The interval cut into the fewest runs (first, length) of a power of two that start at a multiple of their length: the runs
/// in which a digital sequence comes sorted. However it is cut, the points are the same.
pub fn dyadic_runs(from: u64, to: u64) -> Vec<(u64, u64)> {
    let mut runs = vec![];
    let mut at = from;
    while at < to {
        let fits = 1 << (to - at).ilog2();
        let aligned = if at == 0 { fits } else { 1 << at.trailing_zeros() };
        let length = aligned.min(fits);
        runs.push((at, length));
        at += length;
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_looks_to_each_doubling_and_one_at_the_end() {
        let s = Schedule::new(10_000);
        let mut at = s.at_least(0);
        let mut looks = vec![at];
        while at < s.last() {
            at = s.after(at);
            looks.push(at);
        }
        assert_eq!(looks, [1024, 1280, 1536, 1792, 2048, 2560, 3072, 3584, 4096, 5120, 6144, 7168, 8192, 10_000]);
        assert_eq!(s.looks(), looks.len() as u64);
        assert_eq!(Schedule::new(5).at_least(0), 5);
        assert_eq!(Schedule::new(5).looks(), 1);
        assert_eq!(s.at_least(2049), 2560);
        assert_eq!([1000, 1024, 2559, 9999, 10_001].map(|n| s.at_most(n)), [0, 1024, 2048, 8192, 10_000]);
        assert_eq!(s.at_least(1 << 40), 10_000);
    }

    fn covers(runs: &[(u64, u64)], from: u64, to: u64) -> bool {
        runs.iter().try_fold(from, |at, &(first, length)| (first == at && length > 0).then_some(at + length))
            == Some(to)
    }

    #[test]
    fn runs_cover_the_interval_and_meet_at_every_look() {
        for (from, to) in [(0, 1), (0, 1024), (1024, 8192), (5120, 7000), (0, 123_457)] {
            assert!(covers(&steps(from, to), from, to) && covers(&dyadic_runs(from, to), from, to));
            for (first, length) in dyadic_runs(from, to) {
                assert!(length.is_power_of_two() && first % length == 0);
            }
        }
        // Passes, one after the other, are the steps of the whole.
        let parts: Vec<_> =
            [(0, 1280), (1280, 5120), (5120, 8192)].into_iter().flat_map(|(a, b)| steps(a, b)).collect();
        assert_eq!(parts, steps(0, 8192));
        assert_eq!(dyadic_runs(0, 8192), [(0, 8192)]);
        assert_eq!(dyadic_runs(5120, 8192), [(5120, 1024), (6144, 2048)]);
    }
}
