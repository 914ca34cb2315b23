//! The regression benchmarks from outside, and the committed baseline held to this build.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use mcvr::bench::{
    AccuracyBaseline, AccuracyRun, Baseline, HistoryRecord, accuracy, judge_accuracy, judge_work, stages,
};
use mcvr::scene::Watch;

fn mcvr(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mcvr")).current_dir(folder).args(args).output().expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn committed() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../bench-results/baseline")
}

/// Cheap cases of every method, two kernels, both estimands, two effects.
fn some_cases() -> Vec<accuracy::Case> {
    let wanted = |name: &str| {
        name.contains("/tent/line/plain") || name.contains("/bspline3/count/plain") || name.ends_with("/line/shading")
    };
    accuracy::cases().unwrap().into_iter().filter(|c| wanted(&c.name)).collect()
}

#[test]
fn this_build_makes_the_images_of_the_committed_baseline() {
    let baseline: AccuracyBaseline = Baseline::read(&Baseline::at(&committed()).accuracy_file()).unwrap().unwrap();
    let run = AccuracyRun::new(some_cases(), &baseline.cases, &Watch::default()).unwrap();
    assert!(run.figures.len() > 12);
    for section in [judge_accuracy(&baseline.cases, ["", ""], &run, false), judge_work(&baseline.cases, &run)] {
        let moved: Vec<_> = section.lines.iter().filter(|l| l.verdict.fails()).collect();
        // `mc` takes logarithms of the system's library, which may round differently elsewhere.
        let moved: Vec<_> = moved.into_iter().filter(|l| !l.name.starts_with("mc/")).collect();
        assert!(moved.is_empty(), "accept a new baseline knowingly (mcvr bench --accept): {moved:#?}");
        assert!(section.lines.iter().all(|l| baseline.cases.contains_key(l.name.split(' ').next().unwrap())));
    }
}

#[test]
fn every_case_and_stage_is_in_the_committed_baseline_and_no_other() {
    let accuracy: AccuracyBaseline = Baseline::read(&Baseline::at(&committed()).accuracy_file()).unwrap().unwrap();
    let names: Vec<String> = accuracy::cases().unwrap().into_iter().map(|c| c.name).collect();
    assert!(names.iter().all(|n| accuracy.cases.contains_key(n)) && names.len() == accuracy.cases.len());
    let file = Baseline::at(&committed()).instructions_file();
    let counts: mcvr::bench::InstructionBaseline = Baseline::read(&file).unwrap().unwrap();
    let names: Vec<String> = stages().unwrap().into_iter().map(|s| s.name).collect();
    let names: Vec<&String> = names.iter().filter(|n| !n.starts_with(mcvr::bench::ANCHOR)).collect();
    assert!(names.iter().all(|n| counts.stages.contains_key(*n)) && names.len() == counts.stages.len());
}

#[test]
fn a_changed_image_fails_by_name_and_accepting_it_passes() {
    let folder = tempfile::tempdir().unwrap();
    let bench = |more: &[&str]| {
        let args = ["bench", "--skip", "time,instructions", "--baseline", "b", "--only", "qmc/tent/count/plain"];
        mcvr(folder.path(), &[&args[..], more].concat())
    };
    let out = bench(&[]);
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stdout).contains("there is no baseline") && text(&out.stdout).contains("--accept"), "{out:?}");
    assert!(bench(&["--accept"]).status.success());
    let out = bench(&[]);
    assert!(out.status.success() && text(&out.stdout).contains("no regression (accuracy, work)"), "{out:?}");
    // Another seed's image, as far as the baseline knows.
    let file = folder.path().join("b/accuracy.json");
    let mut baseline: AccuracyBaseline = Baseline::read(&file).unwrap().unwrap();
    let figure = baseline.cases.get_mut("qmc/tent/count/plain").unwrap();
    figure.sha256 = "0".repeat(64);
    figure.error = figure.error.map(|e| e * 1.01);
    figure.counters.insert("render.inside".into(), 1.into());
    Baseline::write(&file, &baseline).unwrap();
    let out = bench(&["--json"]);
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stderr).contains("--accept"), "{out:?}");
    let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let sections = report["report"]["sections"].as_array().unwrap();
    assert!(sections[0]["lines"][0]["note"].as_str().unwrap().contains("unbiased"), "{sections:#?}");
    assert_eq!(sections[1]["lines"][0]["name"], "qmc/tent/count/plain render.inside");
    assert_eq!(sections[1]["lines"][0]["baseline"], "1");
    let markdown = text(&bench(&["--markdown"]).stdout);
    assert!(markdown.contains("| qmc/tent/count/plain |") && markdown.contains("REGRESSED"), "{markdown}");
    assert!(bench(&["--accept"]).status.success() && bench(&[]).status.success());
}

#[test]
fn a_broken_baseline_is_named_and_accepting_all_replaces_it() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("b")).unwrap();
    std::fs::write(folder.path().join("b/accuracy.json"), "{").unwrap();
    let args = ["bench", "--skip", "time,instructions", "--baseline", "b", "--only", "qmc/box/count/plain"];
    let out = mcvr(folder.path(), &args);
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stderr).contains("accuracy.json") && text(&out.stderr).contains("--accept"), "{out:?}");
}

#[test]
fn wrong_usage_says_what_there_is() {
    let folder = tempfile::tempdir().unwrap();
    let fails = |args: &[&str], code: i32, says: &str| {
        let out = mcvr(folder.path(), args);
        assert_eq!(out.status.code(), Some(code), "{args:?}");
        assert!(text(&out.stderr).contains(says), "{args:?}: {}", text(&out.stderr));
    };
    fails(&["bench", "--only", "nonsense"], 1, "--list");
    fails(&["bench", "--skip", "work"], 2, "accuracy");
    fails(&["bench", "--once", "nonsense"], 1, "--list");
    fails(&["history", "nowhere"], 1, "nowhere");
    fails(&["history", "."], 1, "mcvr bench --record");
    fails(&["history", ".", "-o", "x.png"], 1, ".svg");
}

#[test]
fn recorded_runs_are_listed_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["bench", "--skip", "time,instructions", "--baseline", "b", "--accept", "--only", "qmc/box/count/plain"];
    let out = mcvr(folder.path(), &[&args[..], &["--record", "history"]].concat());
    assert!(out.status.success(), "{out:?}");
    let file = std::fs::read_dir(folder.path().join("history")).unwrap().next().unwrap().unwrap().path();
    let record: HistoryRecord = Baseline::read(&file).unwrap().unwrap();
    assert!(record.metrics["error/qmc/box/count/plain"] > 0.0);
    assert_eq!(file.file_name().unwrap().to_str().unwrap(), record.file_name());
    let out = mcvr(folder.path(), &["history", ".", "--metric", "error qmc"]);
    assert!(text(&out.stdout).contains("error/qmc/box/count/plain"), "{out:?}");
    assert!(mcvr(folder.path(), &["history", ".", "-o", "h.svg", "--json", "h.json"]).status.success());
    let svg = std::fs::read_to_string(folder.path().join("h.svg")).unwrap();
    assert!(svg.contains("error/qmc/box/count/plain") && svg.contains(&record.provenance.commit));
    let json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("h.json")).unwrap()).unwrap();
    assert_eq!(json["courses"][0]["points"].as_array().unwrap().len(), 1);
    let out = mcvr(folder.path(), &["history", ".", "--metric", "absent"]);
    assert_eq!(out.status.code(), Some(1));
}

#[test]
fn stages_and_cases_are_listed() {
    let out = mcvr(Path::new("."), &["bench", "--list", "--only", "render/tent", "exact/tent/line"]);
    let text = text(&out.stdout);
    assert!(text.contains("stage     render/tent-line") && text.contains("accuracy  exact/tent/line/plain"), "{text}");
    assert!(!text.contains("draw/"), "{text}");
}

#[test]
fn the_examples_of_the_help_are_accepted() {
    let help = text(&mcvr(Path::new("."), &["bench", "--help"]).stdout);
    let examples = help.lines().filter_map(|l| l.trim().strip_prefix("mcvr ")).filter(|l| l.starts_with("bench"));
    let mut tried = 0;
    for example in examples.filter(|l| !l.contains("--markdown")) {
        // What follows two spaces says what the example is for.
        let command = example.split("  ").next().unwrap();
        let mut args: Vec<&str> = command.split(' ').collect();
        args.retain(|a| *a != "--list");
        args.push("--list");
        let out = mcvr(Path::new("."), &args);
        assert!(out.status.success() && !out.stdout.is_empty(), "{args:?}: {}", text(&out.stderr));
        tried += 1;
    }
    assert!(tried >= 5, "{help}");
}
