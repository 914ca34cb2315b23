//! Films and effects from outside: the bias of a transmission as stated, names of outputs, flags against files.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use std::path::Path;
use std::process::{Command, Output};

use mcvr::scene::film::{read, transmission, transmission_bias};
use mcvr::scene::{Camera, DensityMap, Extent, Transfer, View, Watch};
use mcvr::{Method, Request, Scenery, make, volume};
use serde_json::Value;

#[test]
fn the_bias_of_a_transmission_is_what_is_stated() {
    let loaded = volume::load("phantom:box@16", None).unwrap().volume;
    let grid = loaded.grid().clone();
    let camera =
        Camera::look(&View { parallel: true, ..View::default() }, &grid, Extent::new(16, 16).unwrap()).unwrap();
    let transfer = Transfer::Linear { slope: 6e-5, intercept: 0.0 };
    let scenery = Scenery::new(loaded, DensityMap { transfer, ..DensityMap::default() }, camera.clone());
    let image = |method, samples, seed| {
        make(&scenery, &Request { method, samples, seed, ..Request::default() }, &Watch::default()).unwrap()
    };
    let exact = image(Method::Exact, 1, 1);
    let truth = transmission(&exact.image).mean();
    let (samples, replicates) = (4000, 400u32);
    let films: Vec<f64> =
        (0..replicates).map(|r| transmission(&image(Method::Mc, samples, u64::from(r)).image).mean() - truth).collect();
    let n = f64::from(replicates);
    let mean = films.iter().sum::<f64>() / n;
    let error = (films.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt();
    let stated = transmission_bias(&exact.image, &camera, &grid, exact.mass.mass, samples);
    // Terms of third order: a sample weighs w in line, so the next term is below w/3 of the bias.
    let slack = stated.mean * stated.sample_weight + 5.0 * error;
    assert!(mean > 10.0 * error, "the test sees the bias: {mean:.2e} of {error:.2e}");
    assert!((mean - stated.mean).abs() < slack, "measured {mean:.3e} ± {error:.1e}, stated {:.3e}", stated.mean);
    assert!(stated.max > stated.mean && stated.max < 0.2 * stated.sample_weight, "x exp(-x) is at most 1/e");
}

fn mcvr(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mcvr")).current_dir(folder).args(args).output().expect("the program starts")
}

fn ok(folder: &Path, args: &[&str]) -> Output {
    let out = mcvr(folder, args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    out
}

fn refused(folder: &Path, args: &[&str]) -> String {
    let out = mcvr(folder, args);
    assert!(!out.status.success(), "{args:?}");
    String::from_utf8(out.stderr).unwrap()
}

const SMALL: [&str; 8] = ["render", "phantom:box@16", "--size", "20x10", "-n", "2^12", "--json", "-"];

fn record(folder: &Path, args: &[&str]) -> Value {
    serde_json::from_slice(&ok(folder, &[&SMALL[..], args].concat()).stdout).unwrap()
}

#[test]
fn a_film_is_developed_and_its_bias_is_in_the_record() {
    let folder = tempfile::tempdir().unwrap();
    let map = ["--map", "linear:6e-5,0"];
    let line = record(folder.path(), &[&map[..], &["-o", "line.npy"]].concat());
    assert!(line.get("film").is_none());
    let film = record(folder.path(), &[&map[..], &["--transmission", "-o", "film.npy"]].concat());
    assert_eq!(film["unit"], "transmission");
    let bias = &film["film"]["bias"];
    assert!(0.0 < bias["mean"].as_f64().unwrap() && bias["mean"].as_f64() < bias["max"].as_f64(), "{bias}");
    let image = |name: &str| read(&folder.path().join(name)).unwrap();
    assert_eq!(image("film.npy"), transmission(&image("line.npy")));
    let noisy = record(folder.path(), &[&map[..], &["--photons", "1e3", "--seed", "7", "-o", "noisy.npy"]].concat());
    assert_eq!((&noisy["film"]["photons"], &noisy["film"]["noise_seed"]), (&1e3.into(), &7.into()));
    assert!(image("noisy.npy").values().iter().all(|v| ((v * 1e3).round() - v * 1e3).abs() < 1e-9));
    assert_ne!(image("noisy.npy"), image("film.npy"));
    let exact = record(folder.path(), &[&map[..], &["--photons", "9", "--method", "exact", "-o", "e.npy"]].concat());
    assert!(exact["film"]["bias"].is_null(), "rays have no sampling noise");
    // Weights that are no attenuations make a black film, and that is said.
    let black = ok(folder.path(), &[&SMALL[..], &["--transmission", "-o", "black.npy"]].concat());
    assert!(String::from_utf8_lossy(&black.stderr).contains("film is black"));
}

#[test]
fn films_that_mean_nothing_are_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    for (flags, word) in [
        (&["--transmission", "--estimand", "count"][..], "--estimand line"),
        (&["--photons", "0"], "between 1 and 1e15"),
        (&["--photons", "1e4", "--shade"], "effects.shading"),
        (&["--noise-seed", "3"], "film.photons"),
        (&["--shade", "--parallel"], "parallel"),
        (&["--unlisted", "#ffffff"], "materials"),
        (&["--depth-cue", "0"], "depth-cue"),
        (&["--material", "9..3=#ffffff"], "below"),
    ] {
        let message = refused(folder.path(), &[&SMALL[..], flags, &["-o", "a.npy"]].concat());
        assert!(message.contains(word), "{flags:?}: {message}");
        assert!(!folder.path().join("a.npy").exists());
    }
}

#[test]
fn several_cameras_write_an_image_each_and_flags_win() {
    let folder = tempfile::tempdir().unwrap();
    let scene = "[volume]\ninput = \"phantom:lobster@24\"\n[image]\nsize = [20, 10]\n[sampling]\nsamples = 4096\n\
                 [[camera]]\nview = [0, 0]\n[[camera]]\nname = \"top\"\nview = [0, 90]\n[effects]\nshading = {}\n\
                 depth-cue = { minimum = 9.0 }\n";
    std::fs::write(folder.path().join("s.toml"), scene).unwrap();
    let run = |args: &[&str]| -> Value {
        let all = [&["render", "--scene", "s.toml", "--json", "-", "-o", "a.npy"][..], args].concat();
        serde_json::from_slice(&ok(folder.path(), &all).stdout).unwrap()
    };
    let exists = |name: &str| folder.path().join(name).exists();
    let both = run(&["-o", "a.png"]);
    assert_eq!(both["images"][1]["camera"]["name"], "top");
    assert_eq!(both["images"][0]["effects"]["depth-cue"]["minimum"], 9.0);
    assert!(["a-1.npy", "a-top.npy", "a-1.png", "a-top.png"].iter().all(|n| exists(n)) && !exists("a.npy"));
    let top = run(&["--camera", "top", "--depth-cue", "5", "--shade", "two"]);
    assert_eq!(top["camera"]["world_to_pixel"], both["images"][1]["camera"]["world_to_pixel"]);
    assert_eq!(top["effects"]["depth-cue"]["minimum"], 5.0);
    assert_eq!(top["effects"]["shading"]["sides"], "two");
    assert!(exists("a.npy"), "one camera needs no number");
    let flag = run(&["--view", "0,90"]);
    assert_eq!(flag["camera"]["world_to_pixel"], top["camera"]["world_to_pixel"]);
    let message = refused(folder.path(), &["render", "--scene", "s.toml", "--camera", "tip", "-o", "b.npy"]);
    assert!(message.contains("1, top"), "{message}");
    let message = refused(folder.path(), &["converge", "--scene", "s.toml", "-o", "c"]);
    assert!(message.contains("--camera") && message.contains("1, top"), "{message}");
}
