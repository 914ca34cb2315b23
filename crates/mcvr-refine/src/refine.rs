//! The loop: draw a pass, look, decide.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use mcvr_sampling::{PhaseSeconds, PointStream, ReplicatePoints, Replicates, SamplingError};
use mcvr_scene::Watch;
use serde::Serialize;

use crate::contrasts::{MOST, quadratic_mean};
use crate::{Contrasts, Estimate, Goal, Limits, Picture, RefineError, Schedule, Stop, bound};

/// Where the points of the replicates come from.
pub trait Source: Sync {
    /// The points `from..to` of a replicate, as one or several streams. They must not depend on where earlier passes ended, as
    /// long as these ended at looks of a [`Schedule`]: see [`steps`](crate::steps) and [`dyadic_runs`](crate::dyadic_runs).
    fn points(&self, replicate: usize, from: u64, to: u64) -> Vec<Box<dyn PointStream>>;
}

/// One look at the image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Look {
    /// Number of the pass that it follows, from 1.
    pub pass: u32,
    /// Samples of all replicates together.
    pub samples: u64,
    /// Seconds from the start, without those that callers spent on looks.
    pub seconds: f64,
    /// What the replicates say.
    pub estimate: Estimate,
}

/// The image after a pass: developed when it is asked for.
pub struct Snapshot<'a, 'b> {
    replicates: &'a Replicates<'b>,
    samples: u64,
    confidence: f64,
}

impl Snapshot<'_, '_> {
    /// The picture with its error bars.
    pub fn picture(&self) -> Picture {
        Picture::of(self.replicates, self.samples, self.confidence)
    }
}

/// An image that was refined.
#[derive(Clone, Debug)]
pub struct Refined {
    /// The picture with its error bars.
    pub picture: Picture,
    /// All looks; the picture belongs to the last.
    pub looks: Vec<Look>,
    /// Why it ended.
    pub stop: Stop,
    /// Wall time of drawing and projecting; `total` is that of the passes alone.
    pub seconds: PhaseSeconds,
}

/// How fast a pass may outgrow all that came before it, while no look has come near to the goal.
const LEAP: u64 = 16;

/// Passes that take longer than this, in seconds, can be stopped in the middle.
const LONG: f64 = 0.2;

/// From this growth on it can be cheaper to draw all points again, in fewer runs: each run walks through the whole volume.
const REDRAW: u64 = 8;

/// Share of the time left that a pass is planned to take.
const MARGIN: f64 = 0.95;

/// What to refine to, and how.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// The error that is enough; without one, work goes on to a limit.
    pub goal: Goal,
    /// When to stop at the latest.
    pub limits: Limits,
    /// Passes at most double the samples, for those who want to watch.
    pub doubling: bool,
    /// When the work began, distribution and all.
    pub start: Instant,
}

/// Refines replicates, which must be without samples, until the goal is reached or a limit; without a goal, until a limit. Calls
/// `on_look` after every pass, and stops when it breaks.
///
/// Looks are taken at points of a preset [`Schedule`] up to the most samples; each of its looks, whether taken or not, is given
/// the same share of the risk `1 - confidence` (Bonferroni), so the bounds of all looks hold together with the confidence
/// asked for. Without a goal there is nothing to stop early for, and a look has all of the risk.
///
/// # Errors
/// [`RefineError::Value`] for unusable numbers; [`SamplingError::Cancelled`] when stopped before the first look. Later stops end
/// the work with [`Stop::Interrupted`] and the picture of the last finished pass.
pub fn refine(
    replicates: &mut Replicates<'_>,
    source: &dyn Source,
    plan: &Plan,
    watch: &Watch<'_>,
    on_look: &mut dyn FnMut(&Look, &Snapshot<'_, '_>) -> ControlFlow<()>,
) -> Result<Refined, RefineError> {
    let Plan { goal, limits, doubling, start } = plan;
    let number = replicates.number();
    let schedule = check(goal, limits, number)?;
    let risk = match goal.errors() {
        0 => 1.0 - goal.confidence,
        errors => (1.0 - goal.confidence) / (errors * schedule.looks()) as f64,
    };
    let hurried = goal.errors() > 0 || limits.seconds.is_some();
    let mut looks: Vec<Look> = vec![];
    let mut seconds = PhaseSeconds::default();
    // What callers take for their looks, for writing files perhaps, is not the image's time.
    let mut aside = Duration::ZERO;
    let mut at = 0;
    let mut to = match hurried || *doubling {
        // A quarter of a sample a pixel: enough to see how far away the goal is.
        true => {
            let few = replicates.camera().extent().pixels() as u64 / (4 * number as u64);
            schedule.at_least(few.next_power_of_two())
        }
        false => schedule.last(),
    };
    let stop = loop {
        // A short pass is finished whatever comes; before a long one the picture is kept.
        let long = looks.last().is_none_or(|last| (to - at) as f64 * last.seconds > LONG * at as f64);
        let kept = (long && at > 0 && watch.cancel.is_some()).then(|| Picture::of(replicates, at, goal.confidence));
        let watch = Watch { cancel: watch.cancel.filter(|_| long), ..*watch };
        let begun = Instant::now();
        let mut from = at;
        let mut next = points(source, number, at, to);
        if at > 0 && to >= REDRAW * at {
            let all = points(source, number, 0, to);
            if all.len() < next.len() {
                replicates.clear();
                (from, next) = (0, all);
            }
        }
        match replicates.add(&next, &watch) {
            Ok(spent) => {
                seconds.sampling += spent.sampling;
                seconds.projection += spent.projection;
                seconds.total += spent.total;
            }
            Err(e) => match (e, kept) {
                (SamplingError::Cancelled, Some(picture)) => {
                    return Ok(Refined { picture, looks, stop: Stop::Interrupted, seconds });
                }
                (e, _) => return Err(e.into()),
            },
        }
        let look = Look {
            pass: looks.len() as u32 + 1,
            samples: to * number as u64,
            seconds: start.elapsed().saturating_sub(aside).as_secs_f64(),
            estimate: estimate(replicates, to, goal, risk),
        };
        looks.push(look);
        let rate = begun.elapsed().as_secs_f64() / (to - from) as f64;
        let snapshot = Snapshot { replicates, samples: to, confidence: goal.confidence };
        let shown = Instant::now();
        let broken = on_look(&look, &snapshot).is_break();
        aside += shown.elapsed();
        at = to;
        let excess = goal.excess(&look.estimate);
        if excess.is_some_and(|e| e <= 1.0) {
            break Stop::Reached;
        }
        if at >= schedule.last() {
            break Stop::Samples;
        }
        if broken || watch.cancelled() {
            break Stop::Interrupted;
        }
        to = match excess {
            Some(_) => schedule.at_least(wanted(&looks, number, goal)),
            None if hurried => schedule.at_least(at.saturating_mul(LEAP)),
            None => schedule.last(),
        };
        to = if *doubling { to.min(schedule.at_least(2 * at)) } else { to }.max(schedule.after(at));
        if let Some(limit) = limits.seconds {
            let left = (limit - start.elapsed().saturating_sub(aside).as_secs_f64()).max(0.0);
            to = schedule.at_most((at + (left * MARGIN / rate) as u64).min(to));
            if to <= at {
                break Stop::Time;
            }
        }
    };
    let picture = Picture::of(replicates, at, goal.confidence);
    Ok(Refined { picture, looks, stop, seconds })
}

/// The schedule of looks, if the numbers are good.
fn check(goal: &Goal, limits: &Limits, number: usize) -> Result<Schedule, RefineError> {
    goal.check()?;
    if !(8..=MOST).contains(&number) || !number.is_power_of_two() {
        let (what, problem) = ("the number of replicates", "expected 8, 16, 32 or 64");
        return Err(RefineError::Value { what, value: number.to_string(), problem });
    }
    let most = limits.samples / number as u64;
    if most == 0 {
        let (what, problem) = ("the number of samples", "expected at least one a replicate");
        return Err(RefineError::Value { what, value: limits.samples.to_string(), problem });
    }
    if let Some(seconds) = limits.seconds.filter(|s| !(s.is_finite() && *s > 0.0)) {
        let (what, problem) = ("the time", "expected a positive number of seconds");
        return Err(RefineError::Value { what, value: seconds.to_string(), problem });
    }
    Ok(Schedule::new(most))
}

fn points(source: &dyn Source, number: usize, from: u64, to: u64) -> Vec<ReplicatePoints> {
    let of = |replicate| {
        source.points(replicate, from, to).into_iter().map(move |stream| ReplicatePoints { replicate, stream })
    };
    (0..number).flat_map(of).collect()
}

fn estimate(replicates: &Replicates<'_>, samples: u64, goal: &Goal, risk: f64) -> Estimate {
    let contrasts = Contrasts::of(replicates, samples, goal.pixel.map(|p| p.share));
    let known = |figures: &[f64]| {
        let some = contrasts.mean != 0.0 && !figures.is_empty();
        some.then(|| (quadratic_mean(figures), bound(figures, risk)))
    };
    let (image, pixel) = (known(&contrasts.rms), known(&contrasts.quantiles));
    let black = replicates.sees_nothing();
    Estimate {
        mean: contrasts.mean,
        error: image.map(|i| i.0),
        // A black image of nothing is exact.
        bound: image.map(|i| i.1).or(black.then_some(0.0)),
        pixel_error: pixel.map(|p| p.0),
        pixel_bound: pixel.map(|p| p.1).or((black && goal.pixel.is_some()).then_some(0.0)),
    }
}

/// Samples of a replicate that the error should need: by the slope of the last two looks, between that of independent samples
/// and that of the best net, from the estimate; its bound is wider while samples are few than it will be.
fn wanted(looks: &[Look], number: usize, goal: &Goal) -> u64 {
    /// How far a bound usually is above its estimate when the goal is near.
    const USUAL: f64 = 1.04;
    let Some(last) = looks.last() else { return 1 };
    let slope = match looks {
        [.., before, last] => match (before.estimate.error, last.estimate.error) {
            (Some(e0), Some(e1)) => (e0 / e1).ln() / (last.samples as f64 / before.samples as f64).ln(),
            _ => 0.5,
        },
        _ => 0.5,
    };
    // A slope of no meaning (NaN) becomes the lower limit.
    let slope = if slope > 0.5 { slope.min(0.75) } else { 0.5 };
    let over = |asked: Option<f64>, known: Option<f64>| asked.zip(known).map(|(a, k)| USUAL * k / a);
    let e = &last.estimate;
    let ahead = [over(goal.error, e.error), over(goal.pixel.map(|p| p.error), e.pixel_error)];
    let excess = ahead.into_iter().flatten().reduce(f64::max).unwrap_or(f64::INFINITY);
    (last.samples as f64 / number as f64 * excess.powf(1.0 / slope).clamp(1.0, LEAP as f64)) as u64
}
