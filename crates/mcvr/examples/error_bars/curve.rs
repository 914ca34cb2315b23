//! Error over samples: what is asked of an image, and how many samples that takes.

use std::ops::ControlFlow;

use mcvr::refinement::{Goal, Limits};
use mcvr::scene::{Image, Watch};
use mcvr::{MadeRefined, Refinement, Request, Scenery, refine};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::Outcome;
use crate::statistics::{Figure, ratio, slope};
use crate::truths::{Truth, rms};

/// Seeds of curves begin here, apart from those of the repeats.
const SEEDS: u64 = 1 << 32;

/// An image in the making and its truth.
#[derive(Clone, Copy)]
pub struct Subject<'a> {
    pub scenery: &'a Scenery,
    pub truth: &'a Truth,
    pub request: Request,
    pub replicates: u32,
}

impl Subject<'_> {
    /// The image of one seed at a number of samples, without a goal.
    pub fn image(&self, seed: u64, samples: u64) -> Outcome<MadeRefined> {
        let (replicates, limits) = (self.replicates, Limits { samples, seconds: None });
        let refinement = Refinement { replicates, limits, ..Refinement::default() };
        let request = Request { seed, ..self.request };
        Ok(refine(self.scenery, &request, &refinement, &Watch::default(), &mut |_, _| ControlFlow::Continue(()))?)
    }
}

/// One number of samples.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Level {
    pub samples: u64,
    /// Root mean square over the seeds of the error that was asked about, over the mean pixel.
    pub error: f64,
    /// Mean of the image's own estimate of its squared relative RMSE over the mean of the square itself.
    pub estimate: Option<Figure>,
}

/// Errors at every doubling of the samples.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Curve {
    pub seeds: u64,
    pub levels: Vec<Level>,
    /// Of log error over log samples, all levels.
    pub slope: Option<Figure>,
}

impl Curve {
    /// From images that double their samples from the first look up to `most`; `ask` says what is asked of an image.
    pub fn of(subject: &Subject<'_>, most: u64, seeds: u64, ask: impl Fn(&Image) -> f64 + Sync) -> Outcome<Self> {
        let one = |n: u64| -> Outcome<Vec<(u64, f64, f64, f64)>> {
            let limits = Limits { samples: most, seconds: None };
            let refinement =
                Refinement { replicates: subject.replicates, goal: Goal::default(), limits, doubling: true };
            let request = Request { seed: SEEDS + n, ..subject.request };
            let mut looks = vec![];
            refine(subject.scenery, &request, &refinement, &Watch::default(), &mut |look, snapshot| {
                let image = snapshot.picture().image;
                let estimate = look.estimate.error.unwrap_or(f64::NAN);
                looks.push((look.samples, ask(&image), estimate, subject.truth.distance(&image)));
                ControlFlow::Continue(())
            })?;
            Ok(looks)
        };
        let all: Vec<_> = (0..seeds).into_par_iter().map(one).collect::<Outcome<_>>()?;
        let samples: Vec<u64> = all.first().map_or(vec![], |looks| looks.iter().map(|l| l.0).collect());
        let level = |(at, &samples): (usize, &u64)| Level {
            samples,
            error: rms(all.iter().map(|looks| looks[at].1)),
            estimate: ratio(all.iter().map(|looks| (looks[at].2.powi(2), looks[at].3.powi(2)))),
        };
        let levels = samples.iter().enumerate().map(level).collect();
        let errors: Vec<Vec<f64>> = all.iter().map(|looks| looks.iter().map(|l| l.1).collect()).collect();
        let samples: Vec<f64> = samples.iter().map(|&m| m as f64).collect();
        Ok(Self { seeds, levels, slope: slope(&samples, &errors) })
    }

    /// Samples and errors.
    pub fn points(&self) -> Vec<(f64, f64)> {
        self.levels.iter().map(|l| (l.samples as f64, l.error)).collect()
    }
}
