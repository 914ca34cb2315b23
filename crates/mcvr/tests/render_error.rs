//! `mcvr render` with an error asked for, from outside: what it says, writes, refuses.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use std::path::Path;
use std::process::{Command, Output};

use mcvr::scene::film;
use serde_json::Value;

fn mcvr(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mcvr")).current_dir(folder).args(args).output().expect("the program starts")
}

const SCENE: [&str; 4] = ["render", "phantom:lobster@32", "--size", "40x30"];

fn render(folder: &Path, args: &[&str]) -> (Value, String) {
    let out = mcvr(folder, &[&SCENE[..], args, &["--json", "-"]].concat());
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success(), "{args:?}: {said}");
    (serde_json::from_slice(&out.stdout).unwrap(), said)
}

#[test]
fn an_error_that_is_asked_for_is_reached_stated_and_true() {
    let folder = tempfile::tempdir().unwrap();
    let (record, said) = render(folder.path(), &["--error", "3%", "-o", "a.exr", "-o", "a.npy"]);
    let error = &record["error"];
    let figure = |key: &str| error[key].as_f64().unwrap();
    assert_eq!(error["stop"], "reached");
    assert!(figure("relative_rmse") <= figure("relative_rmse_bound") && figure("relative_rmse_bound") <= 0.03);
    assert_eq!(record["samples"], error["looks"].as_array().unwrap().last().unwrap()["samples"]);
    assert!(said.contains("error (RMS over the mean pixel)") && said.contains("95 % confidence"), "{said}");
    render(folder.path(), &["--method", "exact", "--tolerance", "1e-4", "-o", "truth.npy"]);
    let [image, truth] = ["a.npy", "truth.npy"].map(|n| film::read(&folder.path().join(n)).unwrap());
    let apart = image.difference(&truth).unwrap();
    let rmse = (apart.values().iter().map(|v| v * v).sum::<f64>() / apart.values().len() as f64).sqrt();
    assert!(rmse / truth.mean() <= 0.03, "{}", rmse / truth.mean());

    // The file has its error bars with it.
    let layers = film::read_layers(&folder.path().join("a.exr")).unwrap();
    let layer = |name: &str| layers[name].values();
    for p in 0..truth.values().len() {
        assert!(layer("low.Y")[p] <= layer("R")[p] && layer("R")[p] <= layer("high.Y")[p]);
        assert!(layer("stderr.Y")[p] > 0.0);
        assert_eq!(layer("unresolved.Y")[p] == 1.0, layer("R")[p] == 0.0);
    }
}

#[test]
fn pixels_time_samples_and_replicates_can_be_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let (record, said) = render(folder.path(), &["--error-pixel", "10%,90%", "-o", "a.png"]);
    assert!(record["error"]["pixel_error_bound"].as_f64().unwrap() <= 0.1 && said.contains("90.0 % of the pixels"));
    let (record, _) = render(folder.path(), &["--time", "50ms", "-o", "b.png"]);
    assert_eq!(record["error"]["stop"], "time");
    let (record, _) = render(folder.path(), &["--replicates", "16", "-n", "2^16", "-o", "c.npy"]);
    assert_eq!((&record["samples"], &record["error"]["replicates"]), (&(1 << 16).into(), &16.into()));
    // Too few samples for the error: the image is written, and the warning says so.
    let (record, said) = render(folder.path(), &["--error", "0.1%", "-n", "2^15", "-o", "d.png"]);
    assert_eq!(record["error"]["stop"], "samples");
    assert!(said.contains("not reached") && folder.path().join("d.png").exists(), "{said}");
}

#[test]
fn error_maps_hold_the_standard_error_and_the_interval() {
    let folder = tempfile::tempdir().unwrap();
    let maps = ["--error-map", "e.npy", "--error-map", "e.exr", "--error-map", "e.png"];
    let (record, _) = render(folder.path(), &[&["-n", "2^14", "-o", "a.npy"], &maps[..]].concat());
    assert_eq!(record["error"]["maps"].as_array().unwrap().len(), 3);
    let bytes = std::fs::read(folder.path().join("e.npy")).unwrap();
    let head = String::from_utf8_lossy(&bytes[..128]).into_owned();
    assert!(head.contains("(4, 30, 40"), "{head}");
    let layers = film::read_layers(&folder.path().join("e.exr")).unwrap();
    let unresolved = layers["unresolved.Y"].values().iter().filter(|v| **v == 1.0).count() as u64;
    assert_eq!(record["error"]["unresolved_pixels"], unresolved);
    assert!(unresolved > 0, "a phantom with air around it");
}

#[test]
fn a_progressive_folder_holds_every_pass_as_a_direct_run_makes_it() {
    let folder = tempfile::tempdir().unwrap();
    render(folder.path(), &["--progressive", "passes", "-n", "2^16", "-o", "a.npy"]);
    let text = std::fs::read_to_string(folder.path().join("passes/progress.json")).unwrap();
    let progress: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(progress["stopped"], "samples");
    let passes = progress["passes"].as_array().unwrap();
    assert!(passes.len() >= 4);
    let mut before = f64::INFINITY;
    for pass in passes {
        let error = pass["error"].as_f64().unwrap();
        assert!(error < before, "each pass refines the last");
        before = error;
        let samples = pass["samples"].to_string();
        render(folder.path(), &["--replicates", "8", "-n", &samples, "-o", "direct.npy"]);
        let file = pass["files"].as_array().unwrap().iter().find_map(|f| f.as_str().filter(|f| f.ends_with("npy")));
        let [one, other] = [folder.path().join("passes").join(file.unwrap()), folder.path().join("direct.npy")]
            .map(|p| std::fs::read(p).unwrap());
        assert!(one == other, "pass of {samples} samples");
    }
    // A folder of another run is not written into.
    let out = mcvr(folder.path(), &[&SCENE[..], &["--progressive", "passes", "-o", "b.png"]].concat());
    assert_eq!(out.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&out.stderr).contains("new or empty folder"));
}

#[test]
fn what_cannot_be_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let cases: [(&[&str], i32, &str); 8] = [
        (&["--error", "0"], 2, "no share"),
        (&["--error", "1%", "--replicates", "7"], 2, "8, 16, 32 or 64"),
        (&["--error", "1%", "--method", "march"], 1, "no replicates"),
        (&["--error", "1%", "--method", "exact"], 1, "--tolerance"),
        (&["--error", "1%", "--scramble", "none"], 1, "alike"),
        (&["--error-pixel", "1%,100%"], 1, "share"),
        (&["--confidence", "99%"], 1, "--error"),
        (&["--time", "soon"], 2, "no time"),
    ];
    for (args, code, words) in cases {
        let out = mcvr(folder.path(), &[&SCENE[..], args, &["-o", "a.png"]].concat());
        let said = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(code), "{args:?}: {said}");
        assert!(said.contains(words), "{args:?}: {said}");
        assert!(!folder.path().join("a.png").exists());
    }
}

#[test]
fn a_scene_can_ask_for_an_error_and_flags_win() {
    let folder = tempfile::tempdir().unwrap();
    let text = "[volume]\ninput = \"phantom:lobster@32\"\n[image]\nsize = [40, 30]\n[error]\nrmse = 0.05\n";
    std::fs::write(folder.path().join("s.toml"), text).unwrap();
    for (flags, asked) in [(&[][..], 0.05), (&["--error", "10%"], 0.1)] {
        let out = mcvr(folder.path(), &[&["render", "s.toml", "-o", "a.png", "--json", "-"], flags].concat());
        let record: Value = serde_json::from_slice(&out.stdout).unwrap();
        assert_eq!((&record["error"]["goal"]["error"], &record["error"]["stop"]), (&asked.into(), &"reached".into()));
    }
    let out = mcvr(folder.path(), &["plan", "s.toml"]);
    assert!(String::from_utf8_lossy(&out.stderr).contains("not forecast"));
}

#[test]
fn a_film_has_error_bars_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let map = ["--map", "linear:2e-5,0", "--transmission"];
    render(folder.path(), &[&["-n", "2^16", "--replicates", "8", "-o", "a.exr"], &map[..]].concat());
    let layers = film::read_layers(&folder.path().join("a.exr")).unwrap();
    for p in 0..layers["R"].values().len() {
        let [low, value, high] = ["low.Y", "R", "high.Y"].map(|l| layers[l].values()[p]);
        assert!(low <= value && value <= high && high <= 1.0, "{low} {value} {high}");
    }
}
