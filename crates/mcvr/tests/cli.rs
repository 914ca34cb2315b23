//! The program from outside: files, JSON, exit codes, messages.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use std::path::Path;
use std::process::{Command, Output};

use mcvr::scene::film;

fn mcvr(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mcvr")).current_dir(folder).args(args).output().expect("the program starts")
}

fn ok(folder: &Path, args: &[&str]) -> Output {
    let out = mcvr(folder, args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    out
}

fn json(bytes: &[u8]) -> serde_json::Value {
    serde_json::from_slice(bytes).expect("valid JSON")
}

#[test]
fn a_render_writes_every_format_and_says_what_it_did() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["render", "phantom:lobster@32", "--size", "40x30", "-n", "2^14", "--json", "-", "-o", "a.png"];
    let all = [&args[..], &["-o", "a.npy", "-o", "a.exr", "-o", "a.tiff"]].concat();
    let record = json(&ok(folder.path(), &all).stdout);
    assert_eq!(record["samples"], 1 << 14);
    assert_eq!(record["camera"]["world_to_pixel"].as_array().unwrap().len(), 3);
    assert_eq!(record["volume"]["spacing"], serde_json::json!([8.0, 8.0, 8.0]));
    let counters = &record["counters"]["render"];
    let count = |key: &str| counters[key].as_u64().unwrap();
    assert_eq!(count("inside") + count("outside") + count("clipped"), count("samples"));
    for phase in ["load", "distribution", "sampling", "projection", "write", "total"] {
        assert!(record["seconds"][phase].as_f64().unwrap() >= 0.0, "{phase}");
    }
    let linear = film::read(&folder.path().join("a.npy")).unwrap();
    assert_eq!((linear.extent().width, linear.extent().height), (40, 30));
    for name in ["a.exr", "a.tiff"] {
        let other = film::read(&folder.path().join(name)).unwrap();
        let apart = linear.difference(&other).unwrap();
        assert!(apart.max() <= 1e-6 * linear.max(), "{name}");
    }
    assert!(folder.path().join("a.png").metadata().unwrap().len() > 100);
}

#[test]
fn the_world_to_pixel_matrix_of_a_record_gives_the_same_image_again() {
    let folder = tempfile::tempdir().unwrap();
    let common = ["phantom:lobster@32", "--size", "40x30", "-n", "2^14", "--quiet"];
    let record = json(&ok(folder.path(), &[&["render"], &common[..], &["--json", "-", "-o", "a.npy"]].concat()).stdout);
    let rows = record["camera"]["world_to_pixel"].as_array().unwrap();
    let text: Vec<String> = rows
        .iter()
        .map(|r| {
            r.as_array().unwrap().iter().map(|v| (2.0 * v.as_f64().unwrap()).to_string()).collect::<Vec<_>>().join(" ")
        })
        .collect();
    std::fs::write(folder.path().join("m.txt"), format!("# doubled\n{}\n", text.join("\n"))).unwrap();
    ok(folder.path(), &[&["render"], &common[..], &["--matrix", "m.txt", "-o", "b.npy"]].concat());
    let read = |name: &str| film::read(&folder.path().join(name)).unwrap();
    let apart = read("a.npy").difference(&read("b.npy")).unwrap();
    // The same matrix up to rounding: at most a few samples may change their pixel.
    let moved: f64 = apart.values().iter().map(|d| d.abs()).sum();
    assert!(moved < 1e-3 * read("a.npy").sum(), "{moved}");
}

#[test]
fn threads_do_not_change_a_byte() {
    let folder = tempfile::tempdir().unwrap();
    for (threads, name) in [("1", "a.npy"), ("2", "b.npy"), ("16", "c.npy")] {
        let args =
            ["render", "phantom:vessels@48", "--size", "50x50", "-n", "100000", "--threads", threads, "-o", name];
        ok(folder.path(), &args);
    }
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(bytes("a.npy"), bytes("b.npy"));
    assert_eq!(bytes("a.npy"), bytes("c.npy"));
}

#[test]
fn a_scene_file_says_what_flags_say_and_flags_win() {
    let folder = tempfile::tempdir().unwrap();
    let scene = "[volume]\ninput = \"phantom:box@16\"\n[image]\nsize = [20, 10]\nkernel = \"box\"\nestimand = \"count\"\n\
                 [camera]\nview = [10.0, 5.0]\n[sampling]\nmethod = \"stratified\"\nsamples = 5000\nseed = 9\n";
    std::fs::write(folder.path().join("s.toml"), scene).unwrap();
    let record = json(&ok(folder.path(), &["render", "--scene", "s.toml", "-o", "a.npy", "--json", "-"]).stdout);
    assert_eq!(
        (&record["method"], &record["samples"], &record["seed"]),
        (&"stratified".into(), &5000.into(), &9.into())
    );
    ok(
        folder.path(),
        &[
            "render",
            "phantom:box@16",
            "--size",
            "20x10",
            "--kernel",
            "box",
            "--estimand",
            "count",
            "--view",
            "10,5",
            "--method",
            "stratified",
            "-n",
            "5000",
            "--seed",
            "9",
            "-o",
            "b.npy",
        ],
    );
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(bytes("a.npy"), bytes("b.npy"));
    let record =
        json(&ok(folder.path(), &["render", "--scene", "s.toml", "--seed", "3", "-o", "a.npy", "--json", "-"]).stdout);
    assert_eq!(record["seed"], 3);
}

#[test]
fn what_cannot_be_done_is_one_line_with_exit_status_1_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bad.toml"), "[image]\nsizes = [1, 2]\n").unwrap();
    std::fs::write(folder.path().join("zero.raw"), [0u8; 27]).unwrap();
    let cases: [(&[&str], &str); 11] = [
        (&["render", "missing.nrrd", "-o", "a.png"], "missing.nrrd"),
        (&["render", "lobster", "-o", "a.png"], "phantom:lobster"),
        (&["render", "phantom:lobstr", "-o", "a.png"], "lobster"),
        (&["render", "phantom:box@8", "-o", "a.jpg"], ".png, .exr"),
        (&["render", "phantom:box@8", "-o", "none/a.png"], "none"),
        (&["render", "--scene", "bad.toml", "-o", "a.png"], "line 2"),
        (&["render", "zero.raw", "--dims", "3,3,3", "--type", "u8", "-o", "a.png"], "nothing can be drawn"),
        (&["render", "phantom:box@8", "-n", "2^50", "--method", "mc", "-o", "a.png"], "at most 2^40"),
        (&["render", "phantom:box@8", "-n", "2^50", "--method", "mc-quicksort", "-o", "a.png"], "at most 2^40"),
        (&["render", "phantom:box@8", "-n", "2^36", "--method", "mc-quicksort", "-o", "a.png"], "use mc"),
        (&["render", "phantom:box@8", "--method", "exact", "--kernel", "shell", "-o", "a.png"], "shell"),
    ];
    for (args, expected) in cases {
        let out = mcvr(folder.path(), args);
        let text = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(1), "{args:?}: {text}");
        assert!(text.contains(expected), "{args:?}: {text}");
        assert!(!folder.path().join("a.png").exists());
    }
    for args in [
        &["render", "phantom:box"][..],
        &["render", "phantom:box", "-n", "0", "-o", "a.png"],
        &["--threads", "0"],
        &["fly"],
    ] {
        assert_eq!(mcvr(folder.path(), args).status.code(), Some(2), "{args:?}");
    }
}

#[test]
fn a_wrong_raw_size_says_what_would_fit() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.raw"), [7u8; 2 * 4 * 5 * 6]).unwrap();
    let out = mcvr(folder.path(), &["info", "a.raw", "--dims", "4,5,6", "--type", "u8"]);
    let text = String::from_utf8_lossy(&out.stderr);
    assert!(!out.status.success() && text.contains("240") && text.contains("u16"), "{text}");
    let out = ok(folder.path(), &["info", "a.raw", "--dims", "4,5,6", "--type", "u16"]);
    assert!(String::from_utf8_lossy(&out.stdout).contains("4 x 5 x 6"));
}

#[test]
fn a_comparison_of_an_image_with_itself_is_zero_and_with_another_is_not() {
    let folder = tempfile::tempdir().unwrap();
    for (seed, name) in [("1", "a.npy"), ("2", "b.npy")] {
        ok(folder.path(), &["render", "phantom:box@16", "--size", "20x20", "-n", "4096", "--seed", seed, "-o", name]);
    }
    let rmse = |a: &str, b: &str| {
        json(&ok(folder.path(), &["compare", a, b, "--json", "-"]).stdout)["comparison"]["rel_rmse"].as_f64().unwrap()
    };
    assert_eq!(rmse("a.npy", "a.npy"), 0.0);
    assert!(rmse("a.npy", "b.npy") > 0.01);
    ok(folder.path(), &["compare", "a.npy", "b.npy", "--difference", "d.png"]);
    assert!(folder.path().join("d.png").exists());
}

#[test]
fn a_run_is_complete_after_it_was_resumed_and_repeats_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let run = |samples: &str| {
        ok(
            folder.path(),
            &[
                "converge",
                "phantom:box@12",
                "--size",
                "16x16",
                "--replicates",
                "3",
                "--series",
                "none",
                "--methods",
                "mc,qmc",
                "--samples",
                samples,
                "-o",
                "out",
            ],
        );
        std::fs::read_to_string(folder.path().join("out/records.jsonl")).unwrap()
    };
    let first = run("2^8..2^10");
    let second = run("2^8..2^12");
    assert_eq!((first.lines().count(), second.lines().count()), (3 * 2 * 3, 5 * 2 * 3));
    assert!(second.starts_with(&first));
    for name in ["report.html", "report.md", "records.csv", "error_vs_time.svg", "error_vs_samples.svg", "summary.json"]
    {
        assert!(folder.path().join("out").join(name).metadata().unwrap().len() > 0, "{name}");
    }
    let other =
        mcvr(folder.path(), &["converge", "phantom:ramp@12", "--size", "16x16", "--samples", "2^8", "-o", "out"]);
    assert!(!other.status.success(), "another volume must not join the run");
}

#[test]
fn a_plan_names_passes_and_their_keys_and_takes_what_render_takes() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "[volume]\ninput = \"phantom:box@16\"\n[image]\nsize = [20, 10]\n[sampling]\nsamples = 5000\n\
                 [effects]\nshading = { sides = \"two\" }\n[[camera]]\nname = \"a\"\n\
                 [[camera]]\nname = \"b\"\nview = [90.0, 0.0]\nfov = 2.0\n";
    std::fs::write(at.join("s.toml"), scene).unwrap();
    let text = String::from_utf8(ok(at, &["plan", "s.toml", "--draw", "--run"]).stdout).unwrap();
    for word in
        ["camera a", "camera b", "effects.shading, two-sided", "no effects.materials", "render.gradients", "KiB"]
    {
        assert!(text.contains(word), "no '{word}' in:\n{text}");
    }
    assert!(text.contains("as forecast") && !text.contains("within") && !text.contains("WRONG"), "all drawn:\n{text}");
    assert!(text.lines().all(|l| l.chars().count() <= 120), "{text}");
    let one = json(&ok(at, &["plan", "--scene", "s.toml", "--camera", "b", "-n", "6000", "--json", "-"]).stdout);
    let plans = one["plans"].as_array().unwrap();
    assert_eq!((plans.len(), &plans[0]["camera"]["name"]), (1, &"b".into()));
    assert_eq!((&plans[0]["request"]["samples"], &plans[0]["verdicts"]), (&6000.into(), &serde_json::Value::Null));
    assert!(ok(at, &["plan", "s.toml", "--quiet"]).stdout.is_empty());

    // The same scene in both places.
    ok(at, &["render", "s.toml", "--camera", "a", "-o", "a.npy"]);
    ok(at, &["render", "--scene", "s.toml", "--camera", "a", "-o", "b.npy"]);
    assert_eq!(std::fs::read(at.join("a.npy")).unwrap(), std::fs::read(at.join("b.npy")).unwrap());
    for (args, words) in [
        (&["plan", "s.toml", "--scene", "t.toml"][..], "two scenes"),
        (&["plan", "none.toml"], "none.toml"),
        (&["plan", "phantom:box@8", "--camera", "a"], "no scene file"),
        (&["plan", "phantom:box@8", "-n", "2^36", "--method", "mc-quicksort"], "use mc"),
        (&["plan", "s.toml", "--camera", "a", "--photons", "100"], "shading"),
    ] {
        let out = mcvr(at, args);
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.code() == Some(1) && said.contains(words), "{args:?}: {said}");
    }
}

#[test]
fn without_culling_a_zoomed_image_is_that_of_a_cloud_by_flag_and_by_scene() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let draw = ["phantom:lobster@32", "-n", "2^14", "--order", "hilbert"];
    let view = ["--view", "20,50", "--fov", "7", "--size", "30x20"];
    ok(at, &[&["sample"], &draw[..], &["-o", "c.mcvr"]].concat());
    ok(at, &[&["project", "c.mcvr", "-o", "cloud.npy"], &view[..]].concat());
    ok(at, &[&["render"], &draw[..], &view, &["--no-cull", "-o", "flag.npy"]].concat());
    std::fs::write(at.join("s.toml"), "[sampling]\ncull = false\n").unwrap();
    ok(at, &[&["render"], &draw[..], &view, &["--scene", "s.toml", "-o", "scene.npy"]].concat());
    let culled = ok(at, &[&["render"], &draw[..], &view, &["--json", "-", "-o", "culled.npy"]].concat());
    assert!(json(&culled.stdout)["counters"]["distribution"]["bricks_beside"].as_u64().unwrap() > 0);
    let bytes = |name: &str| std::fs::read(at.join(name)).unwrap();
    assert_eq!(bytes("cloud.npy"), bytes("flag.npy"));
    assert_eq!(bytes("cloud.npy"), bytes("scene.npy"));
    assert_ne!(bytes("cloud.npy"), bytes("culled.npy"));
}

#[test]
fn hard_cases_are_listed_posed_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let list = String::from_utf8(ok(folder.path(), &["hardcases", "--list", "--all"]).stdout).unwrap();
    assert!(list.lines().count() >= 80 && list.contains("all-zero"), "{list}");
    let record = json(&ok(folder.path(), &["hardcases", "--json", "all-zero"]).stdout);
    assert_eq!(record["cases"][0]["outcome"]["verdict"], "pass");
    ok(folder.path(), &["hardcases", "--markdown", "--group", "distributions", "all-zero", "-o", "t.md"]);
    let table = std::fs::read_to_string(folder.path().join("t.md")).unwrap();
    assert!(table.contains("| all-zero |") && table.contains("| pass |"), "{table}");
    let none = mcvr(folder.path(), &["hardcases", "no-such-case"]);
    assert_eq!(none.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&none.stderr).contains("no case matches"));
}
