//! `mcvr cost` from outside.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn cost(folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mcvr"));
    command.current_dir(folder).args(["--threads", "2", "--quiet", "cost"]).args(args);
    command.output().expect("the program starts")
}

fn summary(folder: &Path, out: &str) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join(out).join("summary.json")).unwrap()).unwrap()
}

const SMALL: [&str; 8] = ["--size", "36x24", "--samples", "2^10,2^12,2^14", "--repeats", "2", "--tolerance", "1e-3"];

#[test]
fn every_method_is_measured_on_both_numbers_of_threads_and_gives_the_same_images() {
    let folder = tempfile::tempdir().unwrap();
    let args = [&["phantom:lobster@24", "-o", "run", "--tolerances", "0.1"], &SMALL[..]].concat();
    let out = cost(folder.path(), &args);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let found = summary(folder.path(), "run");
    let points = found["points"].as_array().unwrap();
    let names = [
        "mc",
        "stratified",
        "qmc",
        "march-2",
        "march",
        "march-0p5",
        "exact",
        "qmc-cloud",
        "mc-quicksort",
        "adaptive",
        "adaptive-comb-2",
    ];
    for name in names {
        for threads in [1, 2] {
            let mine = points.iter().filter(|p| p["method"] == name && p["threads"] == threads && p["size"] == "36x24");
            assert!(mine.clone().count() >= 1, "{name} on {threads}");
            for p in mine {
                let seconds = |clock: &str| p[clock]["median"].as_f64().unwrap();
                assert!(p["error"].as_f64().unwrap() > 0.0 && seconds("complete") > 0.0, "{p}");
                assert!(seconds("view") > 0.0 && seconds("view") <= seconds("complete"), "{p}");
            }
        }
    }
    // What any number of threads gives is one image.
    let [images, different] = [0, 1].map(|i| found["compared"][i].as_u64().unwrap());
    assert!(images >= 2 * names.len() as u64 && different == 0, "{images} {different}");
    // The half-size images are timed and judge nobody.
    assert!(points.iter().any(|p| p["size"] == "18x12" && p["error"].is_null()));
    assert!(found["reaches"].as_array().unwrap().iter().any(|r| r["fastest"][0] == true));
    // The same command measures nothing more.
    let log = || std::fs::read(folder.path().join("run/records.jsonl")).unwrap();
    let before = log();
    assert!(cost(folder.path(), &args).status.success());
    assert_eq!(log(), before);
    // Another view does not mix with it.
    let other = cost(folder.path(), &[&args[..], &["--view", "10,10"]].concat());
    let words = String::from_utf8_lossy(&other.stderr).into_owned();
    assert!(other.status.code() == Some(1) && words.contains("something else"), "{words}");
    assert_eq!(log(), before);
}

#[test]
fn sizes_of_a_phantom_give_a_map() {
    let folder = tempfile::tempdir().unwrap();
    let sizes = ["phantom:lobster", "--sizes", "12,24", "--methods", "mc,march", "--steps", "1", "-o", "run"];
    let out = cost(folder.path(), &[&sizes[..], &SMALL[..]].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let found = summary(folder.path(), "run");
    let judged = found["subjects"].as_array().unwrap().iter().filter(|s| !s["truth"].is_null());
    let voxels: Vec<u64> = judged.map(|s| s["voxels"].as_u64().unwrap()).collect();
    assert_eq!(voxels, [12 * 12 * 12, 24 * 24 * 24]);
    for file in ["crossover_map-image-2.svg", "crossover_map-view-2.svg", "truth-phantom-lobster-12.npy", "report.html"]
    {
        assert!(folder.path().join("run").join(file).is_file(), "{file}");
    }
}

#[test]
fn what_cannot_be_measured_is_said_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    for (args, words) in [
        (&["x.nrrd", "--sizes", "8"][..], "only a phantom"),
        (&["phantom:lobster@8", "--sizes", "8"], "has a size already"),
        (&["phantom:lobster@8", "--tolerances", "2"], "not below 1"),
        (&["phantom:lobster@8", "--targets", "0"], "--targets"),
        (&["phantom:lobster@8", "--steps=-1"], "--steps"),
        (&["phantom:lobster@8", "--longest", "inf"], "--longest"),
        (&["phantom:lobster@8", "--repeats", "0"], "repeats"),
        (&["phantom:lobster@8", "--shade", "--methods", "qmc,cloud"], "leave out cloud"),
        (&["phantom:lobster@8", "--shade", "--methods", "rays"], "leave out rays"),
        (&["phantom:lobster@8", "--kernel", "box", "--methods", "footprint"], "kernel tent"),
        (&["phantom:lobster@8", "--kernel", "box", "--methods", "adaptive"], "leave out adaptive"),
        (&["phantom:lobster@8", "--shade", "--methods", "qmc,adaptive"], "leave out adaptive"),
        (&["phantom:lobster@8", "--samples", "2^63"], "samples"),
    ] {
        let out = cost(folder.path(), &[args, &["-o", "run"]].concat());
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.code() == Some(1) && said.contains(words), "{args:?}: {said}");
        assert!(!folder.path().join("run").exists(), "{args:?}");
    }
    // A scene with effects is measured without the methods that know none.
    let shaded = ["phantom:lobster@8", "--shade", "--size", "8x8", "--samples", "2^4", "--longest", "0.001"];
    let lit = cost(folder.path(), &[&shaded[..], &["--repeats", "2", "-o", "lit"]].concat());
    assert!(lit.status.success(), "{}", String::from_utf8_lossy(&lit.stderr));
    let measured = summary(folder.path(), "lit");
    let of = |name: &str| measured["points"].as_array().unwrap().iter().filter(|p| p["method"] == name).count();
    assert!(of("mc") > 0 && of("comb-4") > 0);
    assert!(["rays", "adaptive", "adaptive-comb-4", "footprint", "qmc-cloud"].iter().all(|name| of(name) == 0));
    let unknown = cost(folder.path(), &["phantom:lobster@8", "--methods", "radon", "-o", "run"]);
    assert_eq!(unknown.status.code(), Some(2));
}
