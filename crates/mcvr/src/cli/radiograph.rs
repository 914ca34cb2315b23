//! The film of a rendered image: transmission, noise, and what is said about them.

use anyhow::bail;
use mcvr::Made;
use mcvr::refinement::Bars;
use mcvr::scene::film::{Film, FilmBias, transmission_bias};
use mcvr::scene::{Estimand, Image};
use serde_json::{Value, json};

use super::setup::Setup;

/// Optical depth from which hardly a photon passes, e^-20 = 2e-9 of them.
const BLACK: f64 = 20.0;

/// Refuses a transmission of anything but the plain line integral, before the work.
pub fn check(film: &Film, setup: &Setup) -> anyhow::Result<()> {
    film.check()?;
    if !film.is_transmission() {
        return Ok(());
    }
    if setup.request.estimand != Estimand::Line {
        bail!(
            "--transmission and --photons (film.transmission, film.photons) need --estimand line: they show exp(-line)"
        );
    }
    if let Some(effect) = setup.scenery.effects.first() {
        bail!("film: a transmission is exp(-line) of the plain X-ray; leave out effects.{effect}");
    }
    Ok(())
}

/// A developed film.
pub struct Radiograph {
    pub image: Image,
    /// For methods that sample.
    pub bias: Option<FilmBias>,
}

/// Develops the film of an image, if a transmission is asked for.
pub fn develop(film: &Film, setup: &Setup, made: &Made) -> anyhow::Result<Option<Radiograph>> {
    if !film.is_transmission() {
        return Ok(None);
    }
    let image = film.develop(&made.image, setup.request.seed)?;
    let scenery = &setup.scenery;
    let bias = setup.request.method.samples_volume().then(|| {
        let grid = scenery.volume.grid();
        transmission_bias(&made.image, &scenery.camera, grid, made.mass.mass, made.samples)
    });
    let depths: Vec<f64> = made.image.values().iter().copied().filter(|v| *v > 0.0).collect();
    let mean = depths.iter().sum::<f64>() / depths.len().max(1) as f64;
    if mean > BLACK {
        say!(
            "mcvr: warning: the film is black: the mean optical depth of what is hit is {mean:.3e}. Weights must be \
             attenuations per mm: --map hounsfield:60keV for Hounsfield units, or linear:SLOPE,INTERCEPT."
        );
    }
    Ok(Some(Radiograph { image, bias }))
}

/// Error bars of the transmission `exp(-line)` from those of the line integral: ends exchanged, the standard error by its slope.
/// Photon noise is not in them.
pub fn bars(line: &Bars, image: &Image) -> Bars {
    let transmission = |image: &Image| {
        let mut image = image.clone();
        image.values_mut().iter_mut().for_each(|v| *v = (-*v).exp());
        image
    };
    let mut error = transmission(image);
    error.values_mut().iter_mut().zip(line.error.values()).for_each(|(t, e)| *t *= e);
    Bars { error, low: transmission(&line.high), high: transmission(&line.low), ..line.clone() }
}

/// The film as JSON records have it.
pub fn record(film: &Film, radiograph: &Radiograph, seed: u64) -> Value {
    json!({
        "transmission": true,
        "photons": film.photons,
        "noise_seed": film.photons.map(|_| film.noise_seed.unwrap_or(seed)),
        "bias": radiograph.bias,
    })
}

/// What is said about the film.
pub fn summarise(film: &Film, radiograph: &Radiograph) {
    let noise = film.photons.map_or("no photon noise".into(), |n| format!("noise of {n:e} photons a pixel"));
    say!("film: transmission, mean {:.4}, {noise}", radiograph.image.mean());
    if let Some(bias) = radiograph.bias {
        say!(
            "film: sampling noise brightens it (exp is convex) by {:.2e} on average and {:.2e} at most, as 1/samples; \
             an estimate for independent samples, an upper bound for stratified ones and nets",
            bias.mean,
            bias.max
        );
    }
}
