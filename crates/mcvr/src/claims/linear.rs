//! "Cost grows linearly with M."

use mcvr_harness::PhaseSeconds;

use super::bench::{Rounds, complete, distribution, exponent, spread};
use super::{Bench, Claim, ClaimError, Figure, Finding, MILLION, Unit, Verdict};
use crate::Method;

/// How far from 1 an exponent may be and count as linear.
pub const TOLERANCE: f64 = 0.1;
/// Largest share of a complete image at a million samples that may not depend on M.
pub const FIXED: f64 = 0.1;

const LOGS: std::ops::RangeInclusive<u32> = 16..=24;
/// Where the upper half of them begins.
const UPPER: u32 = 20;

pub(super) const CLAIM: Claim = Claim {
    name: "linear-cost",
    quote: "cost grows linearly with M",
    tested: "mc and qmc at 2^16 to 2^24 samples: exponent of the median time without the distribution; cost of one more sample \
             between 2^22 and 2^24, and what it leaves of a complete image of 10^6",
    criterion: "mc: holds if the exponent is within 0.1 of 1 over all M and over the upper half (from 2^20) and at 10^6 \
                at most 10 % of the complete image is fixed cost; in part if only the upper half is within 0.1 of 1",
    measure,
};

/// The verdict on the exponents over all M and over the upper half, and on the fixed share of a complete image at 10^6.
pub fn judge(exponent: f64, upper: f64, fixed: f64) -> Verdict {
    let linear = |e: f64| (e - 1.0).abs() <= TOLERANCE;
    Verdict::ladder(&[exponent, upper, fixed], linear(exponent) && linear(upper) && fixed <= FIXED, linear(upper))
}

fn drawn(seconds: &PhaseSeconds) -> f64 {
    complete(seconds) - distribution(seconds)
}

/// Seconds that one more sample takes, round by round, between two budgets.
fn marginal(rounds: [&Rounds; 2], samples: [u64; 2]) -> Vec<f64> {
    let more = (samples[1] - samples[0]) as f64;
    rounds[0].iter().zip(rounds[1]).map(|(a, b)| (drawn(b) - drawn(a)) / more).collect()
}

fn measure(bench: &Bench<'_>) -> Result<Finding, ClaimError> {
    let counts: Vec<u64> = LOGS.map(|log| 1 << log).chain([MILLION]).collect();
    let methods = [Method::Mc, Method::Qmc];
    let jobs: Vec<_> = methods.iter().flat_map(|&m| counts.iter().map(move |&n| bench.job(bench.with(m, n)))).collect();
    let rounds = bench.rounds(&jobs, bench.options.repeats)?;
    let mut figures = vec![];
    let mut judged = vec![];
    for (method, rounds) in methods.iter().zip(rounds.chunks(counts.len())) {
        let powers = || counts.iter().zip(rounds).filter(|(n, _)| n.is_power_of_two());
        let fit =
            |from: u64| exponent(powers().filter(|(n, _)| **n >= from).map(|(n, r)| (*n, spread(r, drawn).median)));
        let (all, upper) = (fit(0)?, fit(1 << UPPER)?);
        let (last, million) = (LOGS.count() - 1, &rounds[LOGS.count()]);
        let more = marginal([&rounds[last - 2], &rounds[last]], [counts[last - 2], counts[last]]);
        let shares = more.iter().zip(million).map(|(more, at)| 1.0 - more * MILLION as f64 / complete(at));
        let fixed = mcvr_harness::Spread::of(shares.collect());
        let more = mcvr_harness::Spread::of(more);
        let first = figures.is_empty();
        figures.extend([
            Figure::exponent(format!("exponent of M, {method}"), &all),
            Figure::exponent(format!("from 2^{UPPER}, {method}"), &upper),
            Figure::spread(format!("fixed cost of a complete image at 10^6, {method}"), fixed, Unit::Share),
            Figure::spread(format!("one more sample, {method}"), more, Unit::Seconds),
            Figure::exponent(format!("exponent from 2^22 to 2^24, {method}"), &fit(1 << 22)?),
        ]);
        figures.extend([0, last - 4, last].map(|at| {
            let name = format!("time without the distribution, 2^{}, {method}", counts[at].ilog2());
            Figure::spread(name, spread(&rounds[at], drawn), Unit::Seconds)
        }));
        if first {
            let end = |f: &mcvr_harness::SlopeFit| [f.low.unwrap_or(f.slope), f.high.unwrap_or(f.slope)];
            let ([a, b], [c, d]) = (end(&all), end(&upper));
            judged = vec![judge(all.slope, upper.slope, fixed.median), judge(a, c, fixed.min), judge(b, d, fixed.max)];
        }
    }
    let note = "Fixed is what does not depend on M: mostly the distribution, which reads every voxel, then the image itself. An \
                exponent below 1 means that twice the samples take less than twice the time: samples in one brick of voxels \
                share the work of unpacking it, and the more samples there are, the more share it.";
    Ok(Finding::new(judged[0], &judged[1..], figures, note))
}
