//! `mcvr export`: what another program reads is the scan and the camera that this one sees; and peers' records in `mcvr cost`.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use std::path::Path;
use std::process::{Command, Output};

use glam::{DMat3, DVec3};
use mcvr::scene::film;
use mcvr::volume::{Grid, Volume, load, write_nrrd};
use serde_json::{Value, json};

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
    assert!(!out.status.success(), "{args:?} was accepted");
    String::from_utf8_lossy(&out.stderr).into_owned()
}

fn description(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("geometry.json")).unwrap()).unwrap()
}

fn vector(value: &Value) -> DVec3 {
    let number = |i: usize| value[i].as_f64().unwrap();
    DVec3::new(number(0), number(1), number(2))
}

/// A turned, shifted scan with three different spacings, negative isovalues, and density up to its borders.
fn turned(folder: &Path) {
    let direction = DMat3::from_rotation_z(0.4) * DMat3::from_rotation_y(-0.9);
    let grid = Grid::new([9, 7, 5], DVec3::new(1.0, 2.0, 3.5), DVec3::new(-4.0, 30.0, 7.0), direction).unwrap();
    let voxels: Vec<i16> = (0..9 * 7 * 5).map(|i| (i * 7919 % 211) as i16 - 20).collect();
    write_nrrd(&Volume::from_vec(grid, voxels, "turned").unwrap(), &folder.join("scan.nrrd")).unwrap();
}

/// The trilinear field of the exported file at a world point; 0 outside the outermost voxel centres, as other programs have it.
fn trilinear(volume: &Volume, at: DVec3) -> f64 {
    let index = volume.grid().world_to_index().transform_point3(at).to_array();
    let dims = volume.grid().dims();
    if (0..3).any(|a| index[a] < 0.0 || index[a] > (dims[a] - 1) as f64) {
        return 0.0;
    }
    let low = index.map(|v| v.floor() as usize);
    (0..8usize)
        .map(|corner| {
            let one = |a: usize| corner >> a & 1;
            let share = |a: usize| {
                let t = index[a] - low[a] as f64;
                if one(a) == 1 { t } else { 1.0 - t }
            };
            let voxel: [usize; 3] = std::array::from_fn(|a| (low[a] + one(a)).min(dims[a] - 1));
            (0..3).map(share).product::<f64>() * volume.isovalue(volume.grid().linear(voxel))
        })
        .sum()
}

#[test]
fn rays_of_the_description_through_the_exported_file_give_the_centre_rays() {
    let folder = tempfile::tempdir().unwrap();
    turned(folder.path());
    ok(folder.path(), &["export", "scan.nrrd", "--size", "24x18", "--view", "50,-25", "--truth", "-q", "-o", "out"]);
    let out = folder.path().join("out");
    let said = description(&out);
    let (camera, volume) = (&said["camera"], load(out.join("volume.mha").to_str().unwrap(), None).unwrap().volume);
    assert_eq!(json!(volume.grid().dims()), json!([11, 9, 7]));
    assert_eq!(said["volume"]["dims"], json!([11, 9, 7]));
    assert_eq!(said["subject"]["volume"]["dims"], json!([9, 7, 5]));
    let image = film::read(&out.join("centre-tent.npy")).unwrap();
    let source = vector(&camera["source_mm"]);
    let number = |name: &str, i: usize| camera[name][i].as_f64().unwrap();
    for (i, j) in [(12, 9), (9, 6), (14, 11), (11, 12), (0, 0)] {
        let along = |n: usize, size: f64, pitch: f64| (n as f64 + 0.5 - size / 2.0) * pitch;
        let pixel = vector(&camera["detector_centre_mm"])
            + vector(&camera["column_axis"]) * along(i, number("size", 0), number("pixel_pitch_mm", 0))
            + vector(&camera["row_axis"]) * along(j, number("size", 1), number("pixel_pitch_mm", 1));
        let (steps, way) = (40_000, pixel - source);
        let at = |s: usize| source + way * ((s as f64 + 0.5) / steps as f64);
        let sum: f64 = (0..steps).map(|s| trilinear(&volume, at(s))).sum();
        let integral = sum * way.length() / steps as f64;
        // The midpoint rule on a piecewise cubic with steps of some 1/500 of a voxel, and weights as 32-bit floats.
        assert!((integral - image.get(i, j)).abs() < 1e-4 * image.mean(), "{i},{j}: {integral} {}", image.get(i, j));
    }
    assert!(image.get(12, 9) > image.mean() && image.get(0, 0) == 0.0);
}

#[test]
fn the_exported_file_under_the_same_camera_has_the_same_truth() {
    let folder = tempfile::tempdir().unwrap();
    turned(folder.path());
    ok(folder.path(), &["export", "scan.nrrd", "--size", "20x20", "--truth", "-q", "-o", "out"]);
    let said = description(&folder.path().join("out"));
    let rows = said["subject"]["camera"]["world_to_pixel"].as_array().unwrap();
    let text: Vec<String> =
        rows.iter().map(|r| r.as_array().unwrap().iter().map(Value::to_string).collect::<Vec<_>>().join(" ")).collect();
    std::fs::write(folder.path().join("m.txt"), text.join("\n")).unwrap();
    let again = [
        "render",
        "out/volume.mha",
        "--matrix",
        "m.txt",
        "--size",
        "20x20",
        "--method",
        "exact",
        "-q",
        "-o",
        "again.npy",
    ];
    ok(folder.path(), &again);
    let read = |name: &str| film::read(&folder.path().join(name)).unwrap();
    let (truth, again) = (read("out/truth.npy"), read("again.npy"));
    let apart = truth.difference(&again).unwrap();
    let worst = apart.values().iter().fold(0.0f64, |m, d| m.max(d.abs()));
    // Each is held to 1e-4 of the mean pixel.
    assert!(worst < 2e-4 * truth.mean(), "{worst} {}", truth.mean());
    let mean = said["truth"]["area"]["mean"].as_f64().unwrap();
    assert!((mean / truth.mean() - 1.0).abs() < 1e-12);
}

#[test]
fn what_cannot_be_exported_is_refused_and_nothing_is_described() {
    let folder = tempfile::tempdir().unwrap();
    let phantom = ["export", "phantom:lobster@16", "--size", "8x8", "-q", "-o", "out"];
    for (more, words) in [
        (&["--parallel"][..], "--parallel"),
        (&["--estimand", "count"], "line"),
        (&["--kernel", "shell"], "shell"),
        (&["--distance", "20"], "near plane"),
        (&["--map", "linear:1e40,0"], "32-bit"),
        (&["--map", "linear:1e-60,0"], "32-bit"),
    ] {
        let message = refused(folder.path(), &[&phantom[..], more].concat());
        assert!(message.contains(words) && !message.contains("panicked"), "{more:?}: {message}");
        assert!(!folder.path().join("out/geometry.json").exists(), "{more:?}");
    }
    ok(folder.path(), &phantom);
    assert!(folder.path().join("out/geometry.json").exists() && !folder.path().join("out/truth.npy").exists());
    let itself = refused(folder.path(), &["export", "out/volume.mha", "-q", "-o", "out"]);
    assert!(itself.contains("input"), "{itself}");
    assert!(folder.path().join("out/geometry.json").exists());
}

#[test]
fn repeats_are_timed_and_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["render", "phantom:lobster@16", "--size", "16x16", "-n", "2^12", "-q", "--json", "-"];
    let once: Value =
        serde_json::from_slice(&ok(folder.path(), &[&args[..], &["-o", "a.npy"]].concat()).stdout).unwrap();
    assert!(once["seconds"]["repeats"].is_null());
    let more = ok(folder.path(), &[&args[..], &["-o", "b.npy", "--repeats", "3"]].concat());
    let more: Value = serde_json::from_slice(&more.stdout).unwrap();
    let times = more["seconds"]["repeats"]["complete"].as_array().unwrap();
    assert!(times.len() == 3 && times.iter().all(|t| t.as_f64().unwrap() > 0.0));
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(bytes("a.npy"), bytes("b.npy"));
    assert!(
        refused(folder.path(), &["render", "phantom:lobster@16", "-o", "c.npy", "--repeats", "2"]).contains("--json")
    );
}

/// A line as scripts/peers/compare.py writes it.
fn line(subject: &Value) -> Value {
    json!({
        "record": "mcvr peers 1", "case": "lobster", "subject": subject, "group": "RTK", "system": "RTK Joseph", "version": "9.9",
        "setting": "1x1 rays", "threads": 1, "seconds": { "median": 1e-9, "min": 5e-10, "max": 2e-9, "all": [1e-9] },
        "cpu": { "median": 1e-9, "min": 1e-9, "max": 1e-9, "all": [1e-9] }, "views": 1, "in_rounds": true, "error": 0.02,
        "own_error": 0.001, "own_field": "centre-tent", "truth_error": 1e-5, "chosen": null, "machine": "a machine", "when": "now",
    })
}

#[test]
fn a_cost_report_shows_other_systems_of_the_same_view_and_refuses_stale_ones() {
    let folder = tempfile::tempdir().unwrap();
    let scan = ["phantom:lobster@16", "--size", "12x12"];
    ok(folder.path(), &[&["export"], &scan[..], &["-q", "-o", "exported"]].concat());
    let subject = &description(&folder.path().join("exported"))["subject"];
    std::fs::write(folder.path().join("peers.jsonl"), format!("{}\n", line(subject))).unwrap();
    let cost = |scan: &[&str], out: &str| {
        let how = [
            "--methods",
            "mc",
            "--samples",
            "2^10",
            "--repeats",
            "1",
            "--threads",
            "1",
            "--peers",
            "peers.jsonl",
            "-o",
            out,
        ];
        [&["cost"], scan, &how].concat().iter().map(|s| (*s).to_owned()).collect::<Vec<_>>()
    };
    let words = |args: &[String]| args.iter().map(String::as_str).collect::<Vec<_>>().join("\u{1f}");
    let run = |scan: &[&str], out: &str| {
        let joined = words(&cost(scan, out));
        mcvr(folder.path(), &joined.split('\u{1f}').collect::<Vec<_>>())
    };
    let done = run(&scan, "cost");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let report = std::fs::read_to_string(folder.path().join("cost/report.md")).unwrap();
    assert!(report.contains("RTK Joseph 9.9, 1 thread") && report.contains("Other systems"), "{report}");
    assert!(
        String::from_utf8_lossy(&done.stdout).contains("10 %: RTK Joseph"),
        "{}",
        String::from_utf8_lossy(&done.stdout)
    );
    for (scan, field) in [
        (&["phantom:lobster@16", "--size", "12x12", "--view", "31,20"][..], "camera.world_to_pixel"),
        (&["phantom:lobster@16", "--size", "13x12"], "camera."),
        (&["phantom:lobster@16", "--size", "12x12", "--kernel", "box"], "kernel"),
        (&["phantom:lobster@16", "--size", "12x12", "--map", "linear:2,0"], "mass"),
        (&["phantom:lobster@17", "--size", "12x12"], "lobster@16"),
    ] {
        let done = run(scan, "stale");
        let message = String::from_utf8_lossy(&done.stderr);
        assert!(
            !done.status.success() && message.contains("peers.jsonl") && message.contains(field),
            "{scan:?}: {message}"
        );
        assert!(!folder.path().join("stale").exists(), "{scan:?}");
    }
}
