//! The method and the budget for an error, chosen by the program.
//!
//! [`choose`] casts the first rays of an image, one for 4 by 4 pixels, and compares some of them with finer ones ([`Pilot`]), so that it knows how
//! the scan's depth and the pixels' areas resist rays. It compares what every candidate would take for the error that is asked for by a
//! cost model in nanoseconds. Work is counted, never timed: the choice is the same on every machine and for any number of threads. An
//! image of adaptive rays goes on from those of the look. Footprints whose error is not known well enough, but which would take far less
//! time, are made and checked on some of their pixels.

mod candidates;
mod costs;

use std::cell::{Cell, RefCell};

use mcvr_footprint::{FootprintError, LookFootprints, footprints_with_look};
use mcvr_raycast::{AdaptiveImage, Comb, Glance, LookOptions, Pilot, SpotCheck, look_and_cast, spot_check};
use mcvr_refine::Goal;
use mcvr_scene::{Density, Kernel, Look, Watch};
use serde::Serialize;

use crate::request::footprint_options;
use crate::{Adaptive, MakeError, Method, Request, Scenery};
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
    /// What was looked at; `None` where rays are not cast in packets, or cannot be sooner than footprints.
    pub pilot: Option<Pilot>,
    /// What a glance told after which it was not looked.
    pub glance: Option<Glance>,
    /// What footprints were found to err that were made on trial; chosen where that is little enough.
    pub checked: Option<SpotCheck>,
    /// Whether the chosen one is expected to reach the error.
    pub reaches: bool,
}

/// An image that was made on the way to a choice.
pub(crate) enum Already {
    /// By adaptive rays that went on from the look.
    Rays(AdaptiveImage),
    /// By footprints that passed their check.
    Footprints(LookFootprints),
}

/// Voxels along the side of a volume for which the first rays' distances are meant; they fall with the root of smaller ones.
const USUAL: f64 = 100.0;

/// Share of the error that single rays are to have: a distance that is a little too small costs little, one too large the first rays.
const WANTED: f64 = 0.55;

/// How to look: the first rays' distance, and its noise on phantoms, are what usually serves the error, and distances are compared on more squares, with better ones
/// taken for true, where the image itself will take longer.
fn look(density: &Density, request: &Request) -> LookOptions<'static> {
    let (step, noise, others, truth, squares): (f64, _, &[f64], _, _) = match request.error {
        e if e >= 0.05 => (5.0, 0.12, &[], Some(0.4), 16),
        e if e >= 0.02 => (3.0, 0.07, &[], Some(0.3), 24),
        e if e >= 0.005 => (2.0, 0.06, &[0.5, 2.0], None, 24),
        _ => (1.0, 0.04, &[2.0], None, 32),
    };
    // Sums of fewer samples err more.
    let dims = density.volume().grid().dims();
    let side = dims.iter().map(|n| *n as f64).product::<f64>().cbrt();
    let first = Comb { step: step * (side / USUAL).sqrt().min(1.0), noise };
    let wanted = WANTED * request.error;
    LookOptions { wanted, first, others, truth, squares, estimand: request.estimand, seed: request.seed }
}

/// Chooses how to reach an error (RMSE over the mean pixel) at the request's kernel and estimand.
///
/// # Errors
/// [`MakeError`] when the scene is unusable or `watch` cancels.
pub fn choose(density: &Density, scenery: &Scenery, request: &Request, watch: &Watch<'_>) -> Result<Choice, MakeError> {
    Ok(choose_and_cast(density, scenery, request, false, watch)?.0)
}

/// The same, with the image where it was made on the way; adaptive rays are cast at once, when they are chosen and `cast` says so.
pub(crate) fn choose_and_cast(
    density: &Density,
    scenery: &Scenery,
    request: &Request,
    cast: bool,
    watch: &Watch<'_>,
) -> Result<(Choice, Option<Already>), MakeError> {
    Goal { error: Some(request.error), ..Goal::default() }.check()?;
    let (camera, target) = (&scenery.camera, request.error);
    let effects = scenery.effects.look(density.volume().grid(), camera)?;
    let plain = effects.is_plain() && request.kernel == Kernel::Tent;
    let others = candidates::without_look(density, camera, request.estimand, plain, target);
    let options = look(density, request);
    // Where footprints are done before rays could be, there is nothing to look for.
    let sooner = |glance: Option<&Glance>| {
        let first = glance.map_or(options.first.step, |g| g.first);
        let least = candidates::least(density, camera, glance, first, target);
        others.iter().any(|c| reaches(c, target) && c.seconds < least)
    };
    if !plain || sooner(None) {
        return Ok((best(others, target, None), None));
    }
    let (choice, trial, glanced) = (RefCell::new(None), RefCell::new(None), Cell::new(None));
    let judge = |pilot: &Pilot| {
        let mut all = others.clone();
        all.extend(candidates::adaptive_rays(density, camera, pilot, target));
        let made = best(all, target, Some(pilot.clone()));
        if !effects.is_coloured() {
            let worth = candidates::worth_a_trial(density.volume(), pilot, &others, &made.chosen, target);
            *trial.borrow_mut() = worth.cloned();
        }
        let adaptive = made.chosen.adaptive.filter(|_| cast && trial.borrow().is_none());
        let options = adaptive.map(|a| a.options(&made.request(request)));
        *choice.borrow_mut() = Some(made);
        options
    };
    let begin = |glance: &Glance| {
        glanced.set(Some(*glance));
        !sooner(Some(glance))
    };
    let looked = look_and_cast(density, camera, &options, &begin, &judge, watch)?;
    let image = looked.and_then(|(_, image)| image).map(Already::Rays);
    let mut choice = choice.take().unwrap_or_else(|| Choice { glance: glanced.get(), ..best(others, target, None) });
    match trial.take() {
        None => Ok((choice, image)),
        Some(candidate) => {
            let image = choice.try_footprints(candidate, (density, scenery, &effects), request, watch)?;
            Ok((choice, image.map(Already::Footprints)))
        }
    }
}

/// Whether a candidate is expected to reach an error; settings between those tried are solved for the error itself, but for rounding.
fn reaches(candidate: &Candidate, error: f64) -> bool {
    candidate.error <= error * (1.0 + 1e-9)
}

/// The cheapest candidate that is expected to reach an error, and the best of the others.
fn best(mut all: Vec<Candidate>, target: f64, pilot: Option<Pilot>) -> Choice {
    all.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    let reaching = all.iter().position(|c| reaches(c, target));
    let most_accurate = || (0..all.len()).min_by(|a, b| all[*a].error.total_cmp(&all[*b].error));
    let best = reaching.or_else(most_accurate).unwrap_or(0);
    let chosen = all.remove(best);
    let mut runners_up: Vec<Candidate> = vec![];
    for c in all.into_iter().filter(|c| reaches(c, target) && c.method != chosen.method) {
        if runners_up.iter().all(|r| r.method != c.method) {
            runners_up.push(c);
        }
    }
    Choice { target, reaches: reaching.is_some(), chosen, runners_up, pilot, glance: None, checked: None }
}

impl Choice {
    /// Makes footprints and checks some of their pixels: chosen when they err little enough.
    fn try_footprints(
        &mut self,
        candidate: Candidate,
        (density, scenery, look): (&Density, &Scenery, &Look),
        request: &Request,
        watch: &Watch<'_>,
    ) -> Result<Option<LookFootprints>, MakeError> {
        let of = Self { chosen: candidate.clone(), ..self.clone() }.request(request);
        // They may be made in vain, and what is made after them has the same rows again.
        let quiet = Watch { progress: None, ..*watch };
        let made = match footprints_with_look(density, &scenery.camera, look, &footprint_options(&of), &quiet) {
            Ok(made) => made,
            Err(e @ FootprintError::Cancelled) => return Err(e.into()),
            // Rays need no memory for sums: what fails on trial is not tried.
            Err(_) => return Ok(None),
        };
        let (estimand, seed) = (request.estimand, request.seed);
        let checked =
            spot_check(density, &scenery.camera, estimand, &made.channels[0], candidates::CHECKED, seed, &quiet)?;
        self.checked = checked;
        let Some(check) = checked.filter(|c| c.error <= candidates::PASSES * self.target) else { return Ok(None) };
        let chosen = Candidate { error: check.error, ..candidate };
        let second = std::mem::replace(&mut self.chosen, chosen);
        self.runners_up.retain(|c| c.method != Method::Footprint);
        if second.method != Method::Footprint {
            self.runners_up.insert(0, second);
        }
        self.reaches = true;
        watch.advance(scenery.camera.extent().height as u64);
        Ok(Some(made))
    }

    /// The request that makes the chosen image.
    pub fn request(&self, request: &Request) -> Request {
        let Candidate { method, samples, step, adaptive, .. } = self.chosen;
        let step = if step > 0.0 { step } else { request.step };
        Request { method, samples, step, adaptive, jitter: false, ..*request }
    }
}
