//! Whether images that stop at an error have it.

use std::ops::ControlFlow;

use mcvr::refinement::{Goal, Look, PixelGoal, Stop};
use mcvr::scene::{Estimand, Image, Watch};
use mcvr::{Method, Refinement, Request, refine};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::curve::{Curve, Subject};
use crate::records::Records;
use crate::scenes::{self, FOV, Scene};
use crate::statistics::{Figure, clopper_pearson, enough, mean};
use crate::truths::{Truth, truth};
use crate::{Options, Outcome};

pub const PART: &str = "stopping";
/// Of the exact images, relative to the mean pixel.
pub const TOLERANCE: f64 = 2e-4;

/// A share of the repeats.
#[derive(Debug, Serialize, Deserialize)]
pub struct Share {
    pub value: f64,
    /// Clopper and Pearson's 95 % interval.
    pub interval: [f64; 2],
}

impl Share {
    pub fn of(hits: u64, trials: u64) -> Outcome<Self> {
        Ok(Self { value: hits as f64 / trials as f64, interval: clopper_pearson(hits, trials, 0.95)? })
    }
}

/// What a rule does.
#[derive(Debug, Serialize, Deserialize)]
pub struct Rule {
    /// Repeats whose actual error is at most the target.
    pub met: Share,
    pub samples: Figure,
    /// Mean samples over those that would just have been enough.
    pub overshoot: Option<f64>,
    /// Number of looks.
    pub looks: f64,
    /// Actual error over the target, mean and largest.
    pub achieved: [f64; 2],
}

#[derive(Debug, Serialize, Deserialize)]
pub struct Row {
    pub scene: String,
    pub method: String,
    pub side: usize,
    pub target: f64,
    /// Share of the pixels that are to keep the target; `None` when the target is the image's RMSE.
    pub share: Option<f64>,
    pub confidence: f64,
    pub repeats: u64,
    pub truth_error: f64,
    /// Samples at which the error, root mean square over the curve's seeds, is the target.
    pub enough: Option<f64>,
    pub curve: Curve,
    /// The rule of `refine`.
    pub rule: Rule,
    /// Mean of its last bound over the actual error.
    pub bound: Figure,
    /// Stopping at the first of the same looks whose estimate is at most the target.
    pub naive: Rule,
}

/// One setting: method, side, target, share of pixels, confidence.
type Setting = (Method, usize, f64, Option<f64>, f64);

fn settings(quick: bool, scan: bool) -> Vec<Setting> {
    use Method::{Mc, Qmc};
    if quick {
        return vec![(Qmc, 16, 0.1, None, 0.95), (Mc, 16, 0.1, Some(0.95), 0.8)];
    }
    if scan {
        return vec![
            (Mc, 32, 0.1, None, 0.95),
            (Qmc, 32, 0.1, None, 0.95),
            (Qmc, 32, 0.05, None, 0.95),
            (Qmc, 32, 0.05, Some(0.95), 0.95),
            (Qmc, 64, 0.1, None, 0.95),
        ];
    }
    vec![
        (Mc, 32, 0.1, None, 0.95),
        (Mc, 32, 0.05, None, 0.95),
        (Qmc, 32, 0.1, None, 0.95),
        (Qmc, 32, 0.05, None, 0.95),
        (Qmc, 32, 0.02, None, 0.95),
        (Mc, 64, 0.1, None, 0.95),
        (Qmc, 64, 0.1, None, 0.95),
        (Qmc, 64, 0.05, None, 0.95),
        (Mc, 32, 0.1, None, 0.8),
        (Qmc, 32, 0.1, None, 0.8),
        (Qmc, 32, 0.05, None, 0.8),
        (Mc, 32, 0.1, Some(0.95), 0.95),
        (Qmc, 32, 0.1, Some(0.95), 0.95),
        (Qmc, 32, 0.05, Some(0.95), 0.95),
        (Qmc, 32, 0.05, Some(0.95), 0.8),
    ]
}

pub fn measure(options: &Options) -> Outcome<()> {
    let mut records = Records::open(options, PART)?;
    for scene in scenes::both(options)? {
        for setting in settings(options.quick, scene.name == "lobster") {
            let (method, side, target, share, confidence) = setting;
            let asked = share.map_or(String::new(), |s| format!(" of {} % of the pixels", 100.0 * s));
            let key = format!(
                "{}, {method}, {side}x{side}, {} %{asked}, confidence {} %, {} repeats",
                scene.name,
                100.0 * target,
                100.0 * confidence,
                options.repeats
            );
            records.row(options, PART, &key, || row(options, &scene, setting))?;
        }
    }
    Ok(())
}

/// Where a rule stopped.
struct Stopped {
    look: Look,
    error: f64,
}

/// What is asked of an image: its relative RMSE, or the error that a share of its pixels keeps.
pub fn asked(truth: &Truth, share: Option<f64>, image: &Image) -> f64 {
    share.map_or_else(|| truth.distance(image), |s| truth.quantile(image, s))
}

fn row(options: &Options, scene: &Scene, (method, side, target, share, confidence): Setting) -> Outcome<Row> {
    let scenery = scene.scenery(side, Some(FOV))?;
    let truth = truth(&options.out, &scenery, Estimand::Line, TOLERANCE)?;
    let request = Request { method, ..Request::default() };
    let goal = Goal {
        error: share.is_none().then_some(target),
        pixel: share.map(|share| PixelGoal { error: target, share }),
        confidence,
    };
    let refinement = Refinement { goal, ..Refinement::default() };
    let estimate = |look: &Look| if share.is_some() { look.estimate.pixel_error } else { look.estimate.error };
    let bound = |look: &Look| if share.is_some() { look.estimate.pixel_bound } else { look.estimate.bound };
    let repeat = |seed: u64| -> Outcome<[Stopped; 2]> {
        let (mut naive, request) = (None, Request { seed, ..request });
        let made = refine(&scenery, &request, &refinement, &Watch::default(), &mut |look, snapshot| {
            if naive.is_none() && estimate(look).is_some_and(|e| e <= target) {
                naive = Some(Stopped { look: *look, error: asked(&truth, share, &snapshot.picture().image) });
            }
            ControlFlow::Continue(())
        })?;
        if made.stop != Stop::Reached {
            return Err(format!("seed {seed} stopped without its goal: {:?}", made.stop).into());
        }
        let look = *made.looks.last().ok_or("an image that was never looked at")?;
        let rule = Stopped { look, error: asked(&truth, share, &made.made.image) };
        Ok([rule, naive.ok_or("a bound below its estimate")?])
    };
    let all: Vec<[Stopped; 2]> = (1..=options.repeats).into_par_iter().map(repeat).collect::<Outcome<_>>()?;
    let most = all.iter().map(|[rule, _]| rule.look.samples).max().unwrap_or(1);
    let subject = Subject { scenery: &scenery, truth: &truth, request, replicates: refinement.replicates };
    let seeds = (options.repeats / 20).max(10);
    let curve = Curve::of(&subject, most.next_power_of_two(), seeds, |image| asked(&truth, share, image))?;
    let enough = enough(&curve.points(), target);
    let rule = |n: usize| -> Outcome<Rule> {
        let of = || all.iter().map(|stopped| &stopped[n]);
        let samples = mean(of().map(|s| s.look.samples as f64));
        let met = of().filter(|s| s.error <= target).count() as u64;
        Ok(Rule {
            met: Share::of(met, options.repeats)?,
            samples,
            overshoot: enough.map(|e| samples.value / e),
            looks: mean(of().map(|s| f64::from(s.look.pass))).value,
            achieved: [mean(of().map(|s| s.error)).value, of().map(|s| s.error).fold(0.0, f64::max)]
                .map(|e| e / target),
        })
    };
    let bounds = all.iter().map(|[rule, _]| bound(&rule.look).unwrap_or(f64::NAN) / rule.error);
    Ok(Row {
        scene: scene.name.into(),
        method: method.to_string(),
        side,
        target,
        share,
        confidence,
        repeats: options.repeats,
        truth_error: truth.own_error,
        enough,
        rule: rule(0)?,
        bound: mean(bounds),
        naive: rule(1)?,
        curve,
    })
}
