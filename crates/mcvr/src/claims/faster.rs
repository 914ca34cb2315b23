//! "Dramatically faster than ray casting."

use super::bench::{complete, ratio, spread};
use super::{Bench, Claim, ClaimError, Figure, Finding, MILLION, Unit, Verdict};
use crate::{Method, Request};

/// How many times quicker is dramatic: an order of magnitude.
pub const DRAMATIC: f64 = 10.0;

/// Steps of the ray march in voxels, coarser and coarser.
const STEPS: [f64; 7] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];
/// Tolerance of exact ray casting at its loosest here.
const LOOSE: f64 = 0.1;
/// Budget that gives the cost of one more sample.
const MANY: u64 = 1 << 24;

pub(super) const CLAIM: Claim = Claim {
    name: "faster",
    quote: "dramatically faster than ray casting",
    tested: "complete images: mc at 10^6 against the ray march with one ray a pixel (one-voxel step, and the coarsest of 1 to 64 \
             voxels that is no worse than mc), exact ray casting at tolerance 0.1, and mc at the march's error",
    criterion: "holds if at mc's own error the ray march takes at least 10 times as long; in part if only the march with a \
                one-voxel step does, an image of the same size but with less error",
    measure,
};

/// The verdict on how many times longer than mc the ray march takes at equal error, and at a one-voxel step.
pub fn judge(equal_error: f64, equal_size: f64) -> Verdict {
    Verdict::ladder(&[equal_error, equal_size], equal_error >= DRAMATIC, equal_size >= DRAMATIC)
}

fn measure(bench: &Bench<'_>) -> Result<Finding, ClaimError> {
    bench.truth()?;
    bench.say("errors of mc and of ray marches");
    let mc = bench.with(Method::Mc, MILLION);
    let error = bench.error_of(&bench.make(&mc)?)?;
    let marched = bench.error_of(&bench.make(&bench.one_ray(1.0))?)?;
    let (mut step, mut coarse) = (1.0, marched);
    for next in STEPS.into_iter().skip(1) {
        let worse = bench.error_of(&bench.make(&bench.one_ray(next))?)?;
        if worse > error {
            break;
        }
        (step, coarse) = (next, worse);
    }
    let exact = Request { tolerance: LOOSE, ..bench.with(Method::Exact, 1) };
    let jobs = [mc, bench.one_ray(1.0), bench.one_ray(step), bench.with(Method::Mc, MANY)].map(|r| bench.job(r));
    let rounds = bench.rounds(&jobs, bench.options.repeats)?;
    // Not in turn with the quick ones: it takes a hundred times as long, and its ratio is far from any limit.
    let exact_error = bench.make(&exact)?.error.unwrap_or(f64::NAN);
    let exact_rounds = bench.rounds(&[bench.job(exact)], bench.options.repeats.min(2))?;
    let equal_error = ratio(&rounds[2], &rounds[0], complete);
    let equal_size = ratio(&rounds[1], &rounds[0], complete);
    // M^(-1/2), and what one more sample costs between 10^6 and MANY.
    let needed = MILLION as f64 * (error / marched).powi(2);
    let seconds = |at: usize| spread(&rounds[at], complete);
    let (few, many) = (seconds(0), seconds(3));
    let more = (many.median - few.median) / (MANY - MILLION) as f64;
    let long = few.median + more * (needed - MILLION as f64);
    let march = seconds(1);
    let figures = vec![
        Figure::spread(format!("march of equal error (step of {step} voxels) over mc"), equal_error, Unit::Ratio),
        Figure::spread("march with a one-voxel step over mc, equal size", equal_size, Unit::Ratio),
        Figure::spread("mc at 10^6", few, Unit::Seconds),
        Figure::plain("its error", error, Unit::Share),
        Figure::spread("march, one-voxel step", march, Unit::Seconds),
        Figure::plain("its error", marched, Unit::Share),
        Figure::spread(format!("march, step of {step} voxels"), seconds(2), Unit::Seconds),
        Figure::plain("its error", coarse, Unit::Share),
        Figure::spread("exact, tolerance 0.1", spread(&exact_rounds[0], complete), Unit::Seconds),
        Figure::plain("its error, by its own estimate", exact_error, Unit::Share),
        Figure::plain("samples that mc needs for the march's error, by M^(-1/2)", needed, Unit::Samples),
        Figure::plain("their time (extrapolated from 10^6 and 2^24)", long, Unit::Seconds),
        Figure::plain("that over the march's", long / march.median, Unit::Ratio),
    ];
    let ends = [judge(equal_error.min, equal_size.min), judge(equal_error.max, equal_size.max)];
    let note = if marched > error {
        "At this view mc at 10^6 has less error than the march with a one-voxel step, so no march of equal error is coarser."
    } else {
        "The march has the error of its step and of one ray through the middle of a pixel; mc has noise."
    };
    Ok(Finding::new(judge(equal_error.median, equal_size.median), &ends, figures, note))
}
