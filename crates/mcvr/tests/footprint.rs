//! Footprints as a method: library, command line, plan and measurements.
#![allow(clippy::unwrap_used, reason = "tests fail so")]

mod common;

use std::process::{Command, Output};

use common::{made, scene_of};
use mcvr::footprint::{FootprintOptions, predicted_error};
use mcvr::scene::effects::{Shading, Sides};
use mcvr::scene::{Density, DensityMap, Effects, Estimand, Kernel, View, Watch};
use mcvr::{Method, Request, Scenery, make, plan};

fn lobster() -> Scenery {
    let volume = mcvr::volume::load("phantom:lobster@48", None).unwrap().volume;
    scene_of(volume, DensityMap::default(), &View::default())
}

fn mcvr(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mcvr")).args(args).output().unwrap()
}

fn error(image: &mcvr::scene::Image, truth: &mcvr::scene::Image) -> f64 {
    let sum: f64 = image.values().iter().zip(truth.values()).map(|(a, b)| (a - b) * (a - b)).sum();
    (sum / truth.values().len() as f64).sqrt() / truth.mean()
}

#[test]
fn the_image_is_the_exact_one_but_for_its_bias() {
    let scenery = lobster();
    let density = Density::new(&scenery.volume, scenery.map.clone()).unwrap();
    let stated = predicted_error(&density, &scenery.camera, &FootprintOptions::default());
    assert!((1e-5..3e-3).contains(&stated), "{stated}");
    for estimand in Estimand::ALL {
        let request = Request { method: Method::Footprint, estimand, ..Request::default() };
        let image = made(&scenery, &request);
        let truth = made(&scenery, &Request { method: Method::Exact, ..request });
        let off = error(&image.image, &truth.image);
        assert!(off < 2.0 * stated + 1e-4, "{estimand}: {off} of {stated}");
        let mut wrong = truth.image.clone();
        wrong.values_mut().iter_mut().for_each(|v| *v *= 1.01);
        assert!(error(&image.image, &wrong) > 2.0 * stated + 1e-4, "{estimand}: the check is blind");
        assert_eq!(image.counters["footprint"]["footprints"], density.report().positive);
        assert_eq!(image.samples, density.report().positive);
        // Neither budget nor seed play a part.
        let again = made(&scenery, &Request { samples: 1 << 12, seed: 7, ..request });
        assert_eq!(again.image, image.image);
    }
}

#[test]
fn plans_hold() {
    for view in [View::default(), View { fov: Some(4.0), ..View::default() }] {
        let volume = mcvr::volume::load("phantom:vessels@40", None).unwrap().volume;
        let scenery = scene_of(volume, DensityMap::default(), &view);
        let request = Request { method: Method::Footprint, ..Request::default() };
        let plan = plan::plan(&scenery, &request, &Default::default()).unwrap();
        let verdicts = plan.verify(&made(&scenery, &request).counters);
        assert!(verdicts.len() >= 3 && verdicts.iter().all(|v| v.holds()), "{verdicts:?}");
    }
}

#[test]
fn effects_and_kernels_are_refused() {
    let request = Request { method: Method::Footprint, ..Request::default() };
    let effects = Effects { shading: Some(Shading { sides: Sides::One }), ..Effects::default() };
    let shaded = lobster().with_effects(effects);
    let words = |scenery: &Scenery, request: &Request| {
        let made = make(scenery, request, &Watch::default()).unwrap_err().to_string();
        let planned = plan::plan(scenery, request, &Default::default()).unwrap_err().to_string();
        assert_eq!(made, planned);
        made
    };
    assert!(words(&shaded, &request).contains("no effects along the ray"));
    assert!(words(&lobster(), &Request { kernel: Kernel::Box, ..request }).contains("not of 'box'"));
}

#[test]
fn the_command_line_makes_it_alike_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut images = vec![];
    for threads in ["1", "4"] {
        let (out, json) = (file(&format!("{threads}.npy")), file(&format!("{threads}.json")));
        let args = ["render", "phantom:lobster@64", "--method", "footprint", "--size", "90x80", "--threads", threads];
        let output = mcvr(&[&args[..], &["-o", &out, "--json", &json]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(String::from_utf8_lossy(&output.stderr).contains("footprints, kernel tent"), "{output:?}");
        let record: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        let counters = &record["counters"]["footprint"];
        let count = |name: &str| counters[name].as_u64().unwrap();
        assert!(count("voxels_visited") > count("footprints") && count("pixels_touched") >= 16 * count("footprints"));
        assert_eq!(record["method"], "footprint");
        images.push(std::fs::read(&out).unwrap());
    }
    assert!(images[0] == images[1]);
}

#[test]
fn what_cannot_be_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").to_str().unwrap().to_owned();
    let scene = ["phantom:lobster@24", "--size", "20x20", "-o", &out];
    let refused = |args: &[&str], words: &str| {
        let output = mcvr(&[args, &scene[..]].concat());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(words), "{args:?}: {said}");
    };
    refused(&["converge", "--methods", "qmc,footprint"], "no budget to vary");
    refused(&["cost", "--methods", "rays,footprint", "--kernel", "box"], "kernel tent");
    let cloud = format!("{out}.mcvr");
    let output = mcvr(&["sample", "phantom:lobster@24", "--method", "footprint", "-o", &cloud]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("adds whole voxels"), "{output:?}");
    let output =
        mcvr(&[&["cost", "--methods", "footprint,rays", "--repeats", "2", "--longest", "0.01"], &scene[..]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
