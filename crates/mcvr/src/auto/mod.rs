//! The method and the budget for an error, chosen by the program.
//!
//! [`choose`] casts the rays of some lines of pixels ([`Pilot`]), so that it knows how the scan's depth and the pixels' areas
//! resist rays, and compares what every candidate would take for the error that is asked for by a cost model in nanoseconds. Work is
//! counted, never timed: the choice is the same on every machine and for any number of threads.

mod candidates;
mod costs;

use mcvr_raycast::Pilot;
use mcvr_refine::Goal;
use mcvr_scene::{Density, Kernel, Watch};
use serde::Serialize;

use crate::{Adaptive, MakeError, Method, Request, Scenery};
use candidates::candidates;
use costs::Costs;

/// A way to the error asked for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Candidate {
    /// By which method.
    pub method: Method,
    /// Samples, or rays in all.
    pub samples: u64,
    /// Distance of samples along rays, in units of the smallest voxel spacing; 0 where there is none.
    pub step: f64,
    /// Rays where the image needs them.
    pub adaptive: Option<Adaptive>,
    /// The RMSE over the mean pixel that is expected.
    pub error: f64,
    /// Seconds on one thread that are expected, from the weights in memory to the finished image.
    pub seconds: f64,
}

/// What was chosen, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Choice {
    /// The error that was asked for.
    pub target: f64,
    /// The cheapest that is expected to reach it, or, where none does, the most accurate.
    pub chosen: Candidate,
    /// The best of every other method, cheapest first.
    pub runners_up: Vec<Candidate>,
    /// What was looked at; `None` where rays are not cast in packets.
    pub pilot: Option<Pilot>,
    /// Whether the chosen one is expected to reach the error.
    pub reaches: bool,
}

/// Tiles in which a pilot looks at a line of pixels: more where the image itself will take longer.
fn tiles(error: f64) -> usize {
    match error {
        e if e >= 0.05 => 32,
        e if e >= 0.005 => 48,
        _ => 80,
    }
}

/// Chooses how to reach an error (RMSE over the mean pixel) at the request's kernel and estimand.
///
/// # Errors
/// [`MakeError`] when the scene is unusable or `watch` cancels.
pub fn choose(density: &Density, scenery: &Scenery, request: &Request, watch: &Watch<'_>) -> Result<Choice, MakeError> {
    Goal { error: Some(request.error), ..Goal::default() }.check()?;
    let camera = &scenery.camera;
    let plain = scenery.effects.look(density.volume().grid(), camera)?.is_plain();
    let pilot = if plain && request.kernel == Kernel::Tent {
        let sight = (tiles(request.error), candidates::MARGIN * request.error);
        Pilot::look(density, camera, request.estimand, sight, request.seed, watch)?
    } else {
        None
    };
    let mut all = candidates(density, camera, request.estimand, pilot.as_ref(), request.error);
    all.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    // Settings between those tried are solved for the error itself, but for rounding.
    let reaches = |c: &Candidate| c.error <= request.error * (1.0 + 1e-9);
    let reaching = all.iter().position(reaches);
    let most_accurate = || (0..all.len()).min_by(|a, b| all[*a].error.total_cmp(&all[*b].error));
    let best = reaching.or_else(most_accurate).unwrap_or(0);
    let chosen = all.remove(best);
    let mut runners_up: Vec<Candidate> = vec![];
    for c in all.into_iter().filter(|c| reaches(c) && c.method != chosen.method) {
        if runners_up.iter().all(|r| r.method != c.method) {
            runners_up.push(c);
        }
    }
    Ok(Choice { target: request.error, reaches: reaching.is_some(), chosen, runners_up, pilot })
}

impl Choice {
    /// The request that makes the chosen image.
    pub fn request(&self, request: &Request) -> Request {
        let Candidate { method, samples, step, adaptive, .. } = self.chosen;
        let step = if step > 0.0 { step } else { request.step };
        Request { method, samples, step, adaptive, jitter: false, ..*request }
    }
}
