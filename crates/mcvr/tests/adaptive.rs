//! Adaptive rays as a choice of the user and of the program.
#![allow(clippy::unwrap_used, reason = "tests fail so")]

mod common;

use std::process::{Command, Output};

use common::{exact, made};
use mcvr::harness::Comparison;
use mcvr::scene::effects::DepthCue;
use mcvr::scene::{Camera, DensityMap, Effects, Estimand, Extent, Kernel, View, Watch};
use mcvr::{Adaptive, Method, Request, Scenery, make};

fn lobster() -> Scenery {
    let volume = mcvr::volume::load("phantom:lobster@64", None).unwrap().volume;
    let camera = Camera::look(&View::default(), volume.grid(), Extent::new(150, 120).unwrap()).unwrap();
    Scenery::new(volume, DensityMap::default(), camera)
}

fn mcvr(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mcvr")).args(args).output().unwrap()
}

#[test]
fn combs_and_rays_leave_what_was_asked() {
    let scenery = lobster();
    for estimand in Estimand::ALL {
        let truth = exact(&scenery, Kernel::Tent, estimand, 2e-4, 6).image;
        for (method, step, left) in [(Method::Rays, 1.0, 0.02), (Method::Rays, 1.0, 0.003), (Method::Comb, 0.5, 0.02)] {
            let adaptive = Some(Adaptive::leaving(left));
            let image = made(&scenery, &Request { method, step, adaptive, estimand, ..Request::default() });
            let error = Comparison::of(&image.image, &truth).unwrap().rel_rmse.unwrap();
            let said = image.counters["adaptive"]["left"].as_f64().unwrap();
            let levels = image.counters["adaptive"]["levels"].as_array().unwrap();
            let rays: u64 = levels.iter().map(|l| l["rays"].as_u64().unwrap()).sum();
            eprintln!("{method} {estimand} {left}: {error} says {said}, {levels:?}");
            assert!(said <= left && error < 1.5 * left + if method == Method::Comb { 0.01 } else { 0.0 });
            assert_eq!((rays, rays), (image.samples, image.counters["march"]["rays"].as_u64().unwrap()));
            assert_eq!(levels[0]["pitch"], 4.0);
        }
    }
}

/// What was chosen, asked for by hand, is the same image.
#[test]
fn the_choice_can_be_repeated() {
    let scenery = lobster();
    let mut adaptive = 0;
    for error in [0.1, 0.03, 0.01, 0.003] {
        let auto = Request { method: Method::Auto, error, ..Request::default() };
        let chosen = made(&scenery, &auto);
        let request = chosen.choice.as_ref().unwrap().request(&auto);
        adaptive += u32::from(request.adaptive.is_some());
        assert_eq!(made(&scenery, &request).image, chosen.image, "{error}: {request:?}");
    }
    assert!(adaptive >= 2, "{adaptive} of 4 by adaptive rays");
}

#[test]
fn plans_hold() {
    let scenery = lobster();
    for method in [Method::Comb, Method::Rays] {
        let request = Request { method, adaptive: Some(Adaptive::leaving(0.01)), ..Request::default() };
        let plan = mcvr::plan::plan(&scenery, &request, &Default::default()).unwrap();
        let verdicts = plan.verify(&made(&scenery, &request).counters);
        assert!(verdicts.len() >= 6 && verdicts.iter().all(|v| v.holds()), "{verdicts:?}");
    }
}

#[test]
fn what_cannot_be_adaptive_is_refused() {
    let scenery = lobster();
    let base = Request { method: Method::Comb, adaptive: Some(Adaptive::leaving(0.01)), ..Request::default() };
    let effects = Effects { depth_cue: Some(DepthCue::default()), ..Effects::default() };
    let lit = scenery.clone().with_effects(effects);
    for (scenery, request) in [
        (&scenery, Request { kernel: Kernel::Box, ..base }),
        (&scenery, Request { method: Method::March, ..base }),
        (&scenery, Request { jitter: true, ..base }),
        (&lit, base),
    ] {
        let error = make(scenery, &request, &Watch::default()).unwrap_err().to_string();
        assert!(error.contains("kernel 'tent', without jitter"), "{error}");
    }
    let refused = |args: &[&str], why: &str| {
        let output = mcvr(&[&["render", "phantom:lobster@24", "--adaptive", "1%"], args].concat());
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() != Some(0) && text.contains(why), "{args:?}: {text}");
    };
    refused(&["-o", "never.npy"], "use --method comb or rays");
    refused(&["-o", "never.npy", "--method", "comb", "-n", "1e5"], "leave samples out");
    refused(&["-o", "never.npy", "--method", "comb", "--jitter"], "leave --jitter out");
    refused(&["-o", "never.npy", "--method", "auto", "--error", "1%"], "auto chooses the rays itself");
    assert!(!std::path::Path::new("never.npy").exists());
}

#[test]
fn the_command_line_and_the_scene_file_ask_for_them() {
    let folder = std::env::temp_dir().join(format!("mcvr-adaptive-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let scene = "volume.input = \"phantom:lobster@48\"\n[sampling]\nmethod = \"comb\"\nstep = 2.0\nadaptive = 0.02\n";
    std::fs::write(file("scene.toml"), scene).unwrap();
    let by_flags =
        ["render", "phantom:lobster@48", "--method", "comb", "--step", "2", "--adaptive", "2%", "--size", "90x80"];
    let (a, b, json) = (file("a.npy"), file("b.npy"), file("a.json"));
    let output = mcvr(&[&by_flags[..], &["-o", &a, "--json", &json, "--threads", "1"]].concat());
    assert!(output.status.success(), "{output:?}");
    let output = mcvr(&["render", &file("scene.toml"), "--size", "90x80", "-o", &b, "--threads", "2"]);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(std::fs::read(&a).unwrap(), std::fs::read(&b).unwrap());
    let record: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert!(record["counters"]["adaptive"]["left"].as_f64().unwrap() <= 0.02);
    std::fs::remove_dir_all(&folder).unwrap();
}
