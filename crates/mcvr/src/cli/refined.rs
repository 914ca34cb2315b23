//! `mcvr render` with an error asked for: the arguments, the refinement, what is said and recorded about it.

use std::ops::ControlFlow;

use anyhow::bail;
use clap::Args;
use mcvr::refinement::{Bars, Goal, Limits, Look, PixelGoal, Snapshot, Stop};
use mcvr::scene::Watch;
use mcvr::{MadeRefined, Method, PixelSection, Refinement, refine};
use serde_json::{Value, json};

use super::numbers;
use super::setup::Setup;
use super::{Interrupted, process, progress};

/// What error is enough, and how it is known.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Error")]
pub struct ErrorArgs {
    /// Draw samples until the image's RMSE is at most this share of its mean pixel, such as 1%
    #[arg(long, value_name = "ERROR", value_parser = numbers::share)]
    pub error: Option<f64>,
    /// Draw samples until a share of the pixels [default: 95%] is within this error of the truth, as a share of the mean
    /// pixel, such as 5% or 5%,99%
    #[arg(long, value_name = "ERROR[,SHARE]", value_parser = pixel_goal)]
    pub error_pixel: Option<PixelGoal>,
    /// Probability with which the error asked for is met; also that of the pixels' intervals [default: 95%]
    #[arg(long, value_name = "SHARE", value_parser = numbers::share)]
    pub confidence: Option<f64>,
    /// Draw as many samples as fit into this time, such as 2s, 500ms or 1m, and state the error
    #[arg(long, value_name = "TIME", value_parser = numbers::seconds)]
    pub time: Option<f64>,
    /// Independent replicates that the error is measured from: 8, 16, 32 or 64 [default: 8 where an error is asked for,
    /// else none]
    #[arg(long, value_name = "R", value_parser = replicates)]
    pub replicates: Option<u32>,
}

fn pixel_goal(text: &str) -> Result<PixelGoal, String> {
    let (error, share) = text.split_once(',').unwrap_or((text, "95%"));
    Ok(PixelGoal { error: numbers::share(error)?, share: numbers::share(share)? })
}

fn replicates(text: &str) -> Result<u32, String> {
    match text.parse() {
        Ok(n @ (8 | 16 | 32 | 64)) => Ok(n),
        _ => Err(format!("'{text}' replicates: 8, 16, 32 or 64 give an error bar")),
    }
}

impl ErrorArgs {
    /// The error that `--method auto` is to reach, where one is asked for.
    pub fn target(&self, setup: &Setup) -> Option<f64> {
        self.error.or(setup.error.rmse)
    }

    /// The refinement that is asked for, if any is: by these arguments, or by the scene. `wanted` says that something else needs it,
    /// and `doubling` that someone watches it pass by pass.
    pub fn refinement(&self, setup: &Setup, wanted: bool, doubling: bool) -> anyhow::Result<Option<Refinement>> {
        let scene = &setup.error;
        let confidence = self.confidence.or(scene.confidence);
        let time = self.time.or(scene.time);
        let replicates = self.replicates.or(scene.replicates);
        let goal = Goal {
            error: self.error.or(scene.rmse),
            pixel: self.error_pixel.or(scene.pixel.as_ref().map(PixelSection::goal)),
            confidence: confidence.unwrap_or(Goal::default().confidence),
        };
        if setup.request.method == Method::Auto {
            let other = goal.pixel.is_some() || time.is_some() || replicates.is_some() || wanted;
            if other || confidence.is_some() {
                bail!(
                    "--method auto reaches an --error by a prediction and has no replicates: --error-pixel, --confidence, --time, \
                     --replicates, --error-map, --progressive and --preview are for qmc, stratified and mc"
                );
            }
            return Ok(None);
        }
        let asked = goal.errors() > 0 || time.is_some() || replicates.is_some() || wanted;
        if !asked {
            if confidence.is_some() {
                bail!("--confidence is that of an error: give --error, --error-pixel, --time or --replicates with it");
            }
            return Ok(None);
        }
        let open = goal.errors() > 0 || time.is_some();
        let replicates = replicates.unwrap_or(Refinement::REPLICATES);
        let samples = setup.samples.unwrap_or(if open { Refinement::SAMPLES } else { setup.request.samples });
        if samples < u64::from(replicates) {
            bail!("--samples {samples}: at least one for each of the {replicates} replicates");
        }
        let limits = Limits { samples, seconds: time };
        let refinement = Refinement { replicates, goal, limits, doubling };
        refinement.check(&setup.request)?;
        Ok(Some(refinement))
    }
}

/// What is known of the error of an image.
pub struct Known {
    pub bars: Vec<Bars>,
    pub looks: Vec<Look>,
    pub stop: Stop,
}

/// Refuses replicates that will not fit into memory: 8 bytes a pixel, channel and replicate, and the error bars.
pub fn check_memory(setup: &Setup, refinement: &Refinement) -> anyhow::Result<()> {
    for view in &setup.views {
        let channels = setup.scenery.effects.look(setup.scenery.volume.grid(), &view.camera)?.channels() as u64;
        let extent = view.camera.extent();
        let bytes = 8 * extent.pixels() as u64 * channels * (u64::from(refinement.replicates) + 6);
        let what = format!("{} replicates of {extent} pixels and their error bars", refinement.replicates);
        process::check_memory(bytes, &what)?;
    }
    Ok(())
}

/// Refines the image, with a progress bar; `on_look` sees every pass.
pub fn run(
    setup: &Setup,
    refinement: &Refinement,
    quiet: bool,
    mut on_look: impl FnMut(&Look, &Snapshot<'_, '_>, &indicatif::ProgressBar) -> anyhow::Result<()>,
) -> anyhow::Result<MadeRefined> {
    let cancel = progress::interrupt_flag();
    let open = refinement.goal.errors() > 0 || refinement.limits.seconds.is_some();
    let bar = if open { progress::spinner(quiet) } else { progress::bar(refinement.limits.samples, quiet) };
    let advance = |n: u64| bar.inc(n);
    let mut failure = None;
    let outcome = refine(
        &setup.scenery,
        &setup.request,
        refinement,
        &Watch { progress: Some(&advance), cancel: Some(&cancel) },
        &mut |look, snapshot| {
            bar.set_message(message(look));
            match on_look(look, snapshot, &bar) {
                Ok(()) => ControlFlow::Continue(()),
                Err(e) => {
                    failure = Some(e);
                    ControlFlow::Break(())
                }
            }
        },
    );
    bar.finish_and_clear();
    match (failure, outcome) {
        (Some(e), _) => Err(e),
        (None, Err(e)) if e.is_cancelled() => Err(anyhow::Error::new(Interrupted)),
        (None, outcome) => Ok(outcome?),
    }
}

fn message(look: &Look) -> String {
    look.estimate.error.map_or_else(String::new, |e| format!("error {:.2} %", 100.0 * e))
}

/// The error as the JSON record has it.
pub fn record(refinement: &Refinement, made: &Known) -> Value {
    let last = made.looks.last();
    json!({
        "replicates": refinement.replicates,
        "goal": refinement.goal,
        "limits": refinement.limits,
        "stop": made.stop,
        "relative_rmse": last.and_then(|l| l.estimate.error),
        "relative_rmse_bound": last.and_then(|l| l.estimate.bound.filter(|b| b.is_finite())),
        "pixel_error": last.and_then(|l| l.estimate.pixel_error),
        "pixel_error_bound": last.and_then(|l| l.estimate.pixel_bound.filter(|b| b.is_finite())),
        "mean_pixel": last.map(|l| l.estimate.mean),
        "unresolved_pixels": made.bars.iter().map(|b| b.unresolved_pixels).sum::<u64>(),
        "looks": made.looks,
    })
}

/// What is said about the error.
pub fn summarise(refinement: &Refinement, made: &Known) {
    let Some(last) = made.looks.last() else { return };
    let confidence = 100.0 * refinement.goal.confidence;
    let percent = mcvr::harness::format::percent;
    let figure = |what: &str, error: Option<f64>, bound: Option<f64>| {
        if let Some(error) = error {
            let bound = bound
                .filter(|b| b.is_finite())
                .map_or("no bound known".into(), |b| format!("at most {} with {confidence} % confidence", percent(b)));
            say!("{what}: {}, {bound} ({} replicates)", percent(error), refinement.replicates);
        }
    };
    let e = &last.estimate;
    figure("error (RMS over the mean pixel)", e.error, e.bound);
    if let Some(goal) = refinement.goal.pixel {
        figure(&format!("error that {} of the pixels keep", percent(goal.share)), e.pixel_error, e.pixel_bound);
    }
    let unresolved: u64 = made.bars.iter().map(|b| b.unresolved_pixels).sum();
    if unresolved > 0 {
        let pixels: u64 = made.bars.iter().map(|b| b.high.extent().pixels() as u64).sum();
        say!(
            "{unresolved} of {pixels} pixels have no sample: air, or at most {} of the mean pixel with {confidence} % confidence",
            percent(unresolved_bound(made) / e.mean)
        );
    }
    match made.stop {
        Stop::Samples if refinement.goal.errors() > 0 => {
            say!("mcvr: warning: the error asked for is not reached with {} samples", last.samples);
        }
        Stop::Time if refinement.goal.errors() > 0 => {
            say!("mcvr: warning: the error asked for is not reached in the time given");
        }
        Stop::Interrupted => say!("mcvr: stopped after pass {}: the image of {} samples", last.pass, last.samples),
        _ => {}
    }
}

/// Largest upper end among the unresolved pixels.
fn unresolved_bound(made: &Known) -> f64 {
    let of = |b: &Bars| {
        let ends = b.high.values().iter().zip(b.unresolved.values());
        ends.filter(|(_, u)| **u > 0.0).map(|(h, _)| *h).fold(0.0, f64::max)
    };
    made.bars.iter().map(of).fold(0.0, f64::max)
}
