//! Methods as they enter a measurement of cost: on a number of threads of their own, with more settings than a
//! [`Method`] has.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use mcvr_harness::{MethodError, PhaseSeconds, Rendered};
use mcvr_sampling::{ProjectOptions, VoxelOrder, project_cloud};
use mcvr_scene::Watch;
use rayon::ThreadPool;

use crate::{Adaptive, Method, Request, Scenery, draw_cloud, make};

/// What enters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Contestant {
    /// A sampling method; the budget counts samples.
    Sampler(Method),
    /// A kept cloud of the Sobol net, projected; the budget counts points. Drawing them is done once for all views.
    Cloud,
    /// The ray march with this step in voxels; the budget counts rays.
    March(f64),
    /// A few rays a pixel, exact in depth; the budget counts rays.
    Rays,
    /// Combs of samples this many voxels apart; the budget counts rays.
    Comb(f64),
    /// Rays where the image needs them, exact in depth or by combs of samples this many voxels apart; the budget is 1 over the error that may be
    /// left between them.
    Adaptive(Option<f64>),
    /// Footprints of all voxels; the budget is 1 and plays no part.
    Footprint,
    /// Whatever the program chooses; the budget is 1 over the error asked for.
    Auto,
    /// Exact ray casting; the budget is 1 over the tolerance.
    Exact,
}

/// A contestant applied to a scenery on a pool of threads, for [`mcvr_harness::cost`].
#[derive(Clone, Debug)]
pub struct Timed<'a> {
    contestant: Contestant,
    scenery: &'a Scenery,
    request: Request,
    pool: &'a ThreadPool,
    cancel: Option<&'a AtomicBool>,
    name: String,
    label: String,
}

impl Contestant {
    /// Stable name: `mc`, `qmc`, `qmc-cloud`, `march`, `march-0p5`, `rays`, `comb-4`, `adaptive`, `adaptive-comb-4`, `footprint`, `auto`, `exact`.
    pub fn name(self) -> String {
        match self {
            Contestant::Sampler(method) => method.name().to_owned(),
            Contestant::Cloud => "qmc-cloud".to_owned(),
            Contestant::March(1.0) => "march".to_owned(),
            Contestant::March(step) => format!("march-{}", step.to_string().replace('.', "p")),
            Contestant::Rays => "rays".to_owned(),
            Contestant::Comb(step) => format!("comb-{}", step.to_string().replace('.', "p")),
            Contestant::Adaptive(None) => "adaptive".to_owned(),
            Contestant::Adaptive(Some(step)) => format!("adaptive-comb-{}", step.to_string().replace('.', "p")),
            Contestant::Footprint => Method::Footprint.name().to_owned(),
            Contestant::Auto => "auto".to_owned(),
            Contestant::Exact => "exact".to_owned(),
        }
    }

    /// Name for people.
    pub fn label(self) -> String {
        match self {
            Contestant::Sampler(method) => method.label().to_owned(),
            Contestant::Cloud => "quasi-Monte Carlo, kept cloud".to_owned(),
            Contestant::March(step) => format!("ray march, {step}-voxel step"),
            Contestant::Rays => Method::Rays.label().to_owned(),
            Contestant::Comb(step) => format!("comb, {step} voxels apart"),
            Contestant::Adaptive(None) => "adaptive rays".to_owned(),
            Contestant::Adaptive(Some(step)) => format!("adaptive comb, {step} voxels apart"),
            Contestant::Footprint => Method::Footprint.label().to_owned(),
            Contestant::Auto => Method::Auto.label().to_owned(),
            Contestant::Exact => Method::Exact.label().to_owned(),
        }
    }

    /// How often many views of one volume pay the preparation at most: an order that follows the view has one of three
    /// innermost axes.
    pub fn preparations(self, order: VoxelOrder) -> u64 {
        match self {
            Contestant::Sampler(Method::Qmc | Method::Stratified) if order == VoxelOrder::Depth => 3,
            _ => 1,
        }
    }

    /// Largest budget that is worth measuring: where memory or patience ends.
    pub fn most(self) -> u64 {
        match self {
            Contestant::Sampler(Method::McLinear) => 1 << 10,
            Contestant::Sampler(Method::McBinary) => 1 << 22,
            Contestant::Sampler(Method::McQuicksort) | Contestant::Cloud => 1 << 26,
            _ => 1 << 40,
        }
    }
}

impl<'a> Timed<'a> {
    /// Budget, seed, method, step and tolerance of the request are replaced by the measurement's.
    pub fn new(
        contestant: Contestant,
        scenery: &'a Scenery,
        request: Request,
        pool: &'a ThreadPool,
        cancel: Option<&'a AtomicBool>,
    ) -> Self {
        Self { contestant, scenery, request, pool, cancel, name: contestant.name(), label: contestant.label() }
    }

    fn image(&self, request: &Request) -> Result<Rendered, MethodError> {
        let made = make(self.scenery, request, &Watch { progress: None, cancel: self.cancel })?;
        let image = made.measurable()?.into_owned();
        Ok(Rendered { image, seconds: made.seconds, counters: made.counters })
    }

    /// Draws and projects. What a further view would not pay again counts as the preparation.
    fn cloud(&self, request: &Request) -> Result<Rendered, MethodError> {
        let watch = Watch { progress: None, cancel: self.cancel };
        let Scenery { volume, map, camera, .. } = self.scenery;
        let request = Request { method: Method::Qmc, order: VoxelOrder::Raster, ..*request };
        let start = Instant::now();
        let (cloud, _) = draw_cloud(volume, map, &request, &watch)?;
        let distribution = start.elapsed().as_secs_f64();
        let options = ProjectOptions { estimand: request.estimand, ..ProjectOptions::default() };
        let projected = project_cloud(&cloud, camera, &options, &watch)?;
        let complete = start.elapsed().as_secs_f64();
        let seconds = PhaseSeconds { distribution, sampling: 0.0, projection: complete - distribution, complete };
        Ok(Rendered { image: projected.image, seconds, counters: serde_json::json!(projected.counters) })
    }
}

impl mcvr_harness::Method for Timed<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn label(&self) -> &str {
        &self.label
    }

    fn expected_slope(&self) -> Option<f64> {
        match self.contestant {
            Contestant::Sampler(method) => method.expected_slope(),
            Contestant::Cloud => Method::Qmc.expected_slope(),
            Contestant::March(_)
            | Contestant::Rays
            | Contestant::Comb(_)
            | Contestant::Adaptive(_)
            | Contestant::Footprint
            | Contestant::Auto
            | Contestant::Exact => None,
        }
    }

    fn render(&self, samples: u64, seed: u64) -> Result<Rendered, MethodError> {
        let request = Request { samples, seed, ..self.request };
        self.pool.install(|| match self.contestant {
            Contestant::Sampler(method) => self.image(&Request { method, ..request }),
            Contestant::March(step) => self.image(&Request { method: Method::March, step, ..request }),
            Contestant::Rays => self.image(&Request { method: Method::Rays, ..request }),
            Contestant::Comb(step) => self.image(&Request { method: Method::Comb, step, ..request }),
            Contestant::Adaptive(comb) => {
                let adaptive = Some(Adaptive::leaving(1.0 / samples as f64));
                let method = if comb.is_some() { Method::Comb } else { Method::Rays };
                self.image(&Request { method, step: comb.unwrap_or(request.step), adaptive, ..request })
            }
            Contestant::Footprint => self.image(&Request { method: Method::Footprint, ..request }),
            Contestant::Auto => self.image(&Request { method: Method::Auto, error: 1.0 / samples as f64, ..request }),
            Contestant::Exact => {
                self.image(&Request { method: Method::Exact, tolerance: 1.0 / samples as f64, ..request })
            }
            Contestant::Cloud => self.cloud(&request),
        })
    }

    fn budget_unit(&self) -> &'static str {
        match self.contestant {
            Contestant::Sampler(_) | Contestant::Cloud => "samples",
            Contestant::March(_) | Contestant::Rays | Contestant::Comb(_) => "rays",
            Contestant::Footprint => "images",
            Contestant::Auto | Contestant::Adaptive(_) => "1/error",
            Contestant::Exact => "1/tolerance",
        }
    }
}
