//! One image to 5, 2 and 1 %, seed after seed, with its time.

use std::ops::ControlFlow;
use std::time::Instant;

use mcvr::refinement::{Goal, Stop};
use mcvr::scene::{Estimand, Watch};
use mcvr::{Method, Refinement, Request, refine};
use serde::{Deserialize, Serialize};

use crate::records::Records;
use crate::scenes::{self, Scene};
use crate::statistics::{Figure, mean};
use crate::stopping::Share;
use crate::truths::truth;
use crate::{Options, Outcome};

pub const PART: &str = "seeds";
/// Of the exact image, relative to the mean pixel.
pub const TOLERANCE: f64 = 1e-4;

#[derive(Debug, Serialize, Deserialize)]
pub struct Row {
    pub scene: String,
    pub method: String,
    pub side: usize,
    pub target: f64,
    pub seeds: u64,
    pub truth_error: f64,
    pub met: Share,
    pub samples: Figure,
    /// Median, least and most seconds of a whole image, the distribution included, the loading of the scan not.
    pub seconds: [f64; 3],
    /// Mean and worst actual relative RMSE.
    pub achieved: [f64; 2],
    /// Mean bound over actual error.
    pub bound: Figure,
    pub looks: f64,
}

pub fn measure(options: &Options) -> Outcome<()> {
    let mut records = Records::open(options, PART)?;
    let scene = scenes::one(options)?;
    let seeds = if options.quick { 3 } else { (options.repeats / 10).max(3) };
    let (side, targets): (usize, &[f64]) = if options.quick { (32, &[0.1]) } else { (400, &[0.05, 0.02, 0.01]) };
    for &target in targets {
        let key = format!("{}, qmc, {side}x{side}, {} %, {seeds} seeds", scene.name, 100.0 * target);
        records.row(options, PART, &key, || row(options, &scene, side, target, seeds))?;
    }
    Ok(())
}

fn row(options: &Options, scene: &Scene, side: usize, target: f64, seeds: u64) -> Outcome<Row> {
    let scenery = scene.scenery(side, None)?;
    let truth = truth(&options.out, &scenery, Estimand::Line, TOLERANCE)?;
    let refinement = Refinement { goal: Goal { error: Some(target), ..Goal::default() }, ..Refinement::default() };
    let (mut samples, mut seconds, mut errors, mut bounds, mut looks) = (vec![], vec![], vec![], vec![], vec![]);
    // One after the other, each on all threads: they are timed. Seed 0 warms up.
    for seed in 0..=seeds {
        let start = Instant::now();
        let request = Request { method: Method::Qmc, seed, ..Request::default() };
        let made = refine(&scenery, &request, &refinement, &Watch::default(), &mut |_, _| ControlFlow::Continue(()))?;
        let spent = start.elapsed().as_secs_f64();
        let last = made.looks.last().ok_or("an image that was never looked at")?;
        if made.stop != Stop::Reached {
            return Err(format!("seed {seed} stopped without its goal: {:?}", made.stop).into());
        }
        if seed == 0 {
            continue;
        }
        let error = truth.distance(&made.made.image);
        samples.push(last.samples as f64);
        seconds.push(spent);
        errors.push(error);
        bounds.push(last.estimate.bound.unwrap_or(f64::NAN) / error);
        looks.push(made.looks.len() as f64);
    }
    seconds.sort_by(f64::total_cmp);
    let met = errors.iter().filter(|e| **e <= target).count() as u64;
    Ok(Row {
        scene: scene.name.into(),
        method: Method::Qmc.to_string(),
        side,
        target,
        seeds,
        truth_error: truth.own_error,
        met: Share::of(met, seeds)?,
        samples: mean(samples.iter().copied()),
        seconds: [seconds[seconds.len() / 2], seconds[0], seconds[seconds.len() - 1]],
        achieved: [mean(errors.iter().copied()).value, errors.iter().copied().fold(0.0, f64::max)],
        bound: mean(bounds.iter().copied()),
        looks: mean(looks.iter().copied()).value,
    })
}
