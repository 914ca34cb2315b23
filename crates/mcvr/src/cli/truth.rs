//! The ray-cast truth of a measurement: read back from the folder of an earlier part of the run if it is the same, else cast.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use mcvr::harness::{self, Truth};
use mcvr::scene::{Watch, film};
use mcvr::{Method, Request, make};
use serde_json::{Value, json};

use super::render::write_json;
use super::setup::Setup;
use super::{Interrupted, progress};

/// The scan's name without its folder.
pub fn dataset(setup: &Setup) -> String {
    Path::new(&setup.input).file_name().map_or(setup.input.clone(), |n| n.to_string_lossy().into_owned())
}

/// The reference image, kept in `folder` as `stem.npy` and `stem.json`. Nothing is written before `confirm` has accepted it.
pub fn truth(
    setup: &Setup,
    mass: f64,
    (folder, stem): (&Path, &str),
    confirm: &dyn Fn(&Truth) -> anyhow::Result<()>,
    cancel: &AtomicBool,
    quiet: bool,
) -> anyhow::Result<Truth> {
    let (record, image) = (folder.join(format!("{stem}.json")), folder.join(format!("{stem}.npy")));
    let tolerance = setup.request.tolerance;
    let mut key = json!({
        "geometry": setup.geometry(), "map": setup.scenery.map, "mass": mass, "tolerance": tolerance,
        "kernel": setup.request.kernel, "estimand": setup.request.estimand, "version": env!("CARGO_PKG_VERSION"),
    });
    // The same scan in another folder has the same truth, and results name no folder of this machine.
    key["geometry"]["volume"]["input"] = json!(dataset(setup));
    if !setup.scenery.effects.is_plain() {
        key["effects"] = json!(setup.scenery.effects);
    }
    if let Some(truth) = stored_truth(&record, &image, &key) {
        confirm(&truth)?;
        return Ok(truth);
    }
    let camera = &setup.scenery.camera;
    let bar = progress::bar(camera.extent().height as u64, quiet);
    bar.set_message("ray casting the truth");
    let advance = |n: u64| bar.inc(n);
    let watch = Watch { progress: Some(&advance), cancel: Some(cancel) };
    let made = make(&setup.scenery, &Request { method: Method::Exact, ..setup.request }, &watch);
    bar.finish_and_clear();
    let made = match made {
        Err(e) if e.is_cancelled() => return Err(anyhow::Error::new(Interrupted)),
        other => other?,
    };
    let rel_error_estimate = made.error.context("the reference states no error")?;
    let seconds = made.seconds.projection;
    let truth = Truth { image: made.measurable()?.into_owned(), rel_error_estimate, seconds };
    confirm(&truth)?;
    film::write(&truth.image, &image, film::ImageFormat::Npy, &film::Tone::default())?;
    write_json(
        &record,
        &json!({
            "key": key, "sha256": harness::sha256(&truth.image), "rel_error_estimate": rel_error_estimate, "seconds": seconds,
            "depth_limited_pixels": made.counters["depth_limited"], "counters": made.counters["reference"],
        }),
    )?;
    Ok(truth)
}

fn stored_truth(record: &Path, image: &Path, key: &Value) -> Option<Truth> {
    let stored: Value = serde_json::from_str(&std::fs::read_to_string(record).ok()?).ok()?;
    if stored["key"] != *key {
        return None;
    }
    // A run that was killed between the two files left them of different truths.
    let image = film::read(image).ok().filter(|i| stored["sha256"] == harness::sha256(i))?;
    Some(Truth {
        image,
        rel_error_estimate: stored["rel_error_estimate"].as_f64()?,
        seconds: stored["seconds"].as_f64()?,
    })
}
