//! "Sorting turns hours into seconds."

use mcvr_harness::Spread;

use super::bench::{Job, complete, distribution, per_view, ratio, spread};
use super::{Bench, Claim, ClaimError, Figure, Finding, MILLION, Unit, Verdict};
use crate::Method;

/// How many times quicker sorting must be than a linear search: an hour against seconds is three orders of magnitude.
pub const HOURS_TO_SECONDS: f64 = 1000.0;
/// How many times quicker it must be than the same unsorted points with a binary search, for the gain to be sorting's own.
pub const OWN_GAIN: f64 = 10.0;

/// Samples that the linear search is measured at; each walks half the volume on average, give or take 0.29 of it, so that the mean
/// of this many is good to 5 %.
const LINEAR: u64 = 1 << 7;

pub(super) const CLAIM: Claim = Claim {
    name: "sorting",
    quote: "sorting turns hours into seconds",
    tested: "complete images of 10^6 samples on one thread: quicksort and one walk, binary search without a sort, drawing in \
             order; the linear search measured at 2^7 samples and extrapolated to 10^6",
    criterion: "holds if quicksort is at least 1000 times quicker than the linear search (hours to seconds) and at least 10 \
                times quicker than a binary search of the unsorted points (so that the gain is sorting's own); in part if \
                only the first",
    measure,
};

/// The verdict on how many times longer a linear and a binary search take than quicksort and one walk.
pub fn judge(linear: f64, binary: f64) -> Verdict {
    let hours = linear >= HOURS_TO_SECONDS;
    Verdict::ladder(&[linear, binary], hours && binary >= OWN_GAIN, hours)
}

fn measure(bench: &Bench<'_>) -> Result<Finding, ClaimError> {
    let methods = [Method::McLinear, Method::McBinary, Method::McQuicksort, Method::Mc];
    let job = |m| Job { one: true, ..bench.job(bench.with(m, if m == Method::McLinear { LINEAR } else { MILLION })) };
    let rounds = bench.rounds(&methods.map(job), bench.options.repeats)?;
    let [linear, binary, sorted, drawn] = [&rounds[0], &rounds[1], &rounds[2], &rounds[3]];
    let each: Vec<f64> = linear.iter().map(|s| per_view(s) / LINEAR as f64).collect();
    let totals: Vec<f64> = linear.iter().zip(&each).map(|(s, each)| distribution(s) + each * MILLION as f64).collect();
    let over = Spread::of(totals.iter().zip(sorted).map(|(t, s)| t / complete(s)).collect());
    let over_binary = ratio(binary, sorted, complete);
    let figures = vec![
        Figure::spread("linear search over quicksort", over, Unit::Ratio),
        Figure::spread("binary search over quicksort", over_binary, Unit::Ratio),
        Figure::spread("linear search, a sample", Spread::of(each), Unit::Seconds),
        Figure::spread("linear search, 10^6 (extrapolated)", Spread::of(totals), Unit::Seconds),
        Figure::spread("binary search, 10^6", spread(binary, complete), Unit::Seconds),
        Figure::spread("quicksort and one walk, 10^6", spread(sorted, complete), Unit::Seconds),
        Figure::spread("drawn in order (mc), 10^6", spread(drawn, complete), Unit::Seconds),
    ];
    let ends = [judge(over.min, over_binary.min), judge(over.max, over_binary.max)];
    let note = "A binary search needs no sort and also ends the hours; drawing in order needs neither.";
    Ok(Finding::new(judge(over.median, over_binary.median), &ends, figures, note))
}
