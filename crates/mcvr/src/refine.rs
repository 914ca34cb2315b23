//! An image with its error, by any method that has replicates.

use std::ops::ControlFlow;
use std::time::Instant;

use mcvr_harness::PhaseSeconds;
use mcvr_mc::{OrderStatistics, Stratified};
use mcvr_qmc::{Scramble, SobolSequence};
use mcvr_refine::{Bars, Goal, Limits, Look, Plan, RefineError, Refined, Snapshot, Source, Stop, dyadic_runs, steps};
use mcvr_sampling::rng::{Purpose, hash};
use mcvr_sampling::{Distribution, PointStream, RenderOptions, Replicates};
use mcvr_scene::{Density, Watch};
use serde::Serialize;
use serde_json::json;

use crate::Method;
use crate::make::{Made, MakeError, Scenery, check_finite};
use crate::request::Request;

/// How an image is to be refined. The request's own number of samples plays no part: [`Limits`] has it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Refinement {
    /// Replicates: 8, 16, 32 or 64.
    pub replicates: u32,
    /// The error that is enough.
    pub goal: Goal,
    /// When to stop at the latest.
    pub limits: Limits,
    /// Whether passes at most double the samples, for those who want to watch.
    pub doubling: bool,
}

impl Refinement {
    /// Replicates where no number is asked for.
    pub const REPLICATES: u32 = 8;

    /// Most samples where no number is asked for. The looks up to there share the risk, so more would widen every bound.
    pub const SAMPLES: u64 = 1 << 36;

    /// Refuses what has no replicates, or replicates that are all alike, and unusable numbers.
    ///
    /// # Errors
    /// [`RefineError::Value`].
    pub fn check(&self, request: &Request) -> Result<(), RefineError> {
        let refuse = |what, value: String, problem| Err(RefineError::Value { what, value, problem });
        self.goal.check()?;
        match request.method {
            Method::Qmc if request.scramble == Scramble::None => refuse(
                "the scramble",
                request.scramble.name().into(),
                "it makes all replicates alike, so their error cannot be seen; use linear or owen",
            ),
            Method::Qmc | Method::Stratified | Method::Mc => Ok(()),
            Method::Exact => refuse(
                "the method",
                "exact".into(),
                "it has no replicates to measure an error from; it keeps --tolerance by itself. Others: qmc, stratified, mc",
            ),
            other => refuse(
                "the method",
                other.to_string(),
                "it has no replicates to measure an error from; use qmc, stratified or mc",
            ),
        }
    }
}

impl Default for Refinement {
    fn default() -> Self {
        Self {
            replicates: Self::REPLICATES,
            goal: Goal::default(),
            limits: Limits { samples: Self::SAMPLES, seconds: None },
            doubling: false,
        }
    }
}

/// A refined image and what it took.
#[derive(Clone, Debug)]
pub struct MadeRefined {
    /// The image; its `error` is the replicates' estimate of the relative RMSE.
    pub made: Made,
    /// Error bars of the image, or of each channel of a coloured one.
    pub bars: Vec<Bars>,
    /// Every look at the image.
    pub looks: Vec<Look>,
    /// Why work ended.
    pub stop: Stop,
}

/// The replicates' points. Replicate r of a seed is keyed by a hash of both, so seeds share no replicate.
struct Points<'a> {
    request: &'a Request,
    sequences: Vec<SobolSequence>,
}

impl<'a> Points<'a> {
    fn new(request: &'a Request, replicates: u32) -> Self {
        let sequence = |r: u32| SobolSequence::new(key(request.seed, &[u64::from(r)]), request.scramble);
        let sequences = match request.method {
            Method::Qmc => (0..replicates).map(sequence).collect(),
            _ => vec![],
        };
        Self { request, sequences }
    }
}

fn key(seed: u64, words: &[u64]) -> u64 {
    hash(&[&[seed, Purpose::Replicate as u64], words].concat())
}

impl Source for Points<'_> {
    fn points(&self, replicate: usize, from: u64, to: u64) -> Vec<Box<dyn PointStream>> {
        if let Some(sequence) = self.sequences.get(replicate) {
            let run = |(first, samples)| Box::new(sequence.run(first, samples)) as Box<dyn PointStream>;
            return dyadic_runs(from, to).into_iter().map(run).collect();
        }
        let independent = |(first, samples)| {
            let seed = key(self.request.seed, &[replicate as u64, first]);
            match self.request.method {
                Method::Stratified => Box::new(Stratified::new(samples, seed)) as Box<dyn PointStream>,
                _ => Box::new(OrderStatistics::new(samples, seed)),
            }
        };
        steps(from, to).into_iter().map(independent).collect()
    }
}

/// Refines an image until its error is what the refinement asks for, or a limit; `on_look` is called after every pass and may
/// stop the work. The same request and refinement give the same image bit for bit on any number of threads, unless time
/// stops them; then a refinement to the number of samples reached, without a goal, gives the same image.
///
/// # Errors
/// As [`make`](crate::make); [`MakeError::Refine`] for methods without replicates and unusable numbers.
pub fn refine(
    scenery: &Scenery,
    request: &Request,
    refinement: &Refinement,
    watch: &Watch<'_>,
    on_look: &mut dyn FnMut(&Look, &Snapshot<'_, '_>) -> ControlFlow<()>,
) -> Result<MadeRefined, MakeError> {
    let start = Instant::now();
    refinement.check(request)?;
    let density = Density::new(&scenery.volume, scenery.map.clone())?;
    let camera = &scenery.camera;
    let look = scenery.effects.look(density.volume().grid(), camera)?;
    let order = request.order.resolve(camera, density.volume().grid());
    let distribution = if request.cull {
        Distribution::in_view(&density, order, camera, request.kernel)?
    } else {
        Distribution::new(&density, order)?
    };
    let distribution_seconds = start.elapsed().as_secs_f64();
    let options = RenderOptions { estimand: request.estimand, kernel: request.kernel, ..RenderOptions::default() };
    let mut replicates = Replicates::new(&distribution, camera, &look, &options, refinement.replicates as usize)?;
    let source = Points::new(request, refinement.replicates);
    let Refinement { goal, limits, doubling, .. } = *refinement;
    let plan = Plan { goal, limits, doubling, start };
    let Refined { picture, looks, stop, seconds } =
        mcvr_refine::refine(&mut replicates, &source, &plan, watch, on_look)?;
    for image in picture.colour.iter().flatten().chain([&picture.image]) {
        check_finite(image)?;
    }
    let counters = replicates.counters();
    let made = Made {
        clipped: (distribution.near_mass()
            + distribution.mass() * counters.clipped as f64 / counters.samples.max(1) as f64)
            / density.mass(),
        samples: looks.last().map_or(0, |l| l.samples),
        counters: json!({
            "distribution": distribution.counters(),
            "render": replicates.work(),
            "order": order,
            "precision": replicates.precision(),
        }),
        error: looks.last().and_then(|l| l.estimate.error),
        choice: None,
        image: picture.image,
        colour: picture.colour,
        seconds: PhaseSeconds {
            distribution: distribution_seconds,
            sampling: seconds.sampling,
            projection: seconds.projection,
            complete: start.elapsed().as_secs_f64(),
        },
        mass: *density.report(),
    };
    Ok(MadeRefined { made, bars: picture.bars, looks, stop })
}
