//! Other systems beside the methods.

use std::path::{Path, PathBuf};

use mcvr_harness::RunWatch;
use mcvr_harness::cost::{CostRun, PEERS_RECORD, Subject, cost_lines, read_peers};

use super::{NEVER, entrants, options, sampler, truth};

/// A record's line of a peer on this view.
fn peer(system: &str, seconds: f64, error: f64, in_rounds: bool) -> serde_json::Value {
    serde_json::json!({
        "record": PEERS_RECORD, "subject": subject_of("blob", 1.0), "system": system, "version": "1.2", "setting": "plain",
        "threads": 2, "seconds": { "median": seconds, "min": seconds * 0.9, "max": seconds * 1.2 }, "views": 5,
        "in_rounds": in_rounds, "error": error, "own_error": 0.5 * error, "own_field": "centre-tent", "machine": "a machine",
    })
}

fn subject_of(dataset: &str, corner: f64) -> serde_json::Value {
    serde_json::json!({ "dataset": dataset, "camera": { "world_to_pixel": [[corner, 0.0], [0.0, 1.0]], "width": 48 }, "mass": 3.5 })
}

fn record(folder: &Path, lines: &[serde_json::Value]) -> PathBuf {
    let path = folder.join("peers.jsonl");
    std::fs::write(&path, lines.iter().map(|l| format!("{l}\n")).collect::<String>()).unwrap();
    path
}

#[test]
fn other_systems_stand_in_plot_and_table_and_take_the_mark_where_they_are_quicker() {
    let folder = tempfile::tempdir().unwrap();
    // The sampler takes 11.6 ms to 1 % and 10.2 ms to 3 %.
    let mut own = peer("mcvr auto", 1e-5, 0.001, true);
    own["own_field"] = serde_json::Value::Null;
    let lines = [
        peer("RTK Joseph", 0.005, 0.02, true),
        peer("RTK Joseph", 0.1, 0.009, true),
        peer("VTK", 0.05, 0.008, true),
        peer("VTK", 1e-4, 0.002, false),
        own,
    ];
    let peers = read_peers(&record(folder.path(), &lines), &subject_of("blob", 1.0)).unwrap();
    assert_eq!(peers.len(), 3, "settings that were only tried, and the program itself, are left out");
    let (truth, mc) = (truth(), sampler("mc"));
    let (out, list) = (folder.path().join("cost"), [&mc]);
    let entrants = entrants(&list);
    let mut run = CostRun::open(options(&out)).unwrap();
    run.show_peers(peers);
    let watch = RunWatch { cancel: &NEVER, progress: &|_, _, _| {} };
    let size = truth.image.extent();
    let subject =
        Subject { dataset: "blob", voxels: 1000, truth: Some(&truth), size, entrants: &entrants, pictures: false };
    assert!(run.measure(&subject, watch).unwrap());
    let summary = run.finish().unwrap();
    let report = std::fs::read_to_string(out.join("report.md")).unwrap();
    let row = |start: &str| {
        let line = report
            .lines()
            .find(|l| l.starts_with(&format!("| {start}")))
            .unwrap_or_else(|| panic!("{start}: {report}"));
        line.split('|').map(|c| c.trim().to_owned()).collect::<Vec<_>>()
    };
    // Errors 30, 10, 3, 1 and 0.3 %: RTK is quicker down to 3 %, and 0.3 % is below what the truth can judge.
    let (rtk, mc) = (row("RTK Joseph 1.2, 2 threads"), row("mc"));
    assert!(rtk[2].contains('★') && rtk[4].contains('★') && !rtk[5].contains('★') && rtk[6] == "–", "{rtk:?}");
    assert!(rtk[5].contains("100 ms"), "{rtk:?}");
    assert!(!mc[2].contains('★') && !mc[4].contains('★') && mc[5].contains('★'), "{mc:?}");
    assert_eq!(row("VTK 1.2, 2 threads")[5], "50.0 ms");
    let lines = cost_lines(&summary).join(" ");
    assert!(lines.contains("to 3 %: RTK Joseph, 5.00 ms") && !lines.contains("1 %: RTK"), "{lines}");
    let plots =
        ["error_vs_time.svg", "error_vs_time-1-thread.svg"].map(|p| std::fs::read_to_string(out.join(p)).unwrap());
    assert!(plots[0].contains("RTK Joseph 1.2, 2 threads") && plots[0].contains("VTK 1.2"));
    assert!(!plots[1].contains("RTK"), "measured on two threads only");
}

#[test]
fn a_record_of_something_else_is_refused_with_the_field_that_differs() {
    let folder = tempfile::tempdir().unwrap();
    let good = peer("RTK", 0.1, 0.01, true);
    let read = |line: &serde_json::Value, subject: &serde_json::Value| {
        read_peers(&record(folder.path(), std::slice::from_ref(line)), subject)
    };
    // Rounding on the way through text is not another camera.
    assert_eq!(read(&good, &subject_of("blob", 1.0 + 1e-12)).unwrap().len(), 1);
    let with = |field: &str, value: serde_json::Value| {
        let mut line = good.clone();
        line[field] = value;
        line
    };
    let json = |v: f64| serde_json::json!(v);
    for (line, subject, words) in [
        (good.clone(), subject_of("blob", 1.01), "camera.world_to_pixel[0][0] is 1.0 there and 1.01 here"),
        (good.clone(), subject_of("lobster", 1.0), "no other system's views of lobster; it is of blob"),
        (with("record", "mcvr peers 2".into()), subject_of("blob", 1.0), "line 1: record is \"mcvr peers 2\""),
        (with("error", json(-0.1)), subject_of("blob", 1.0), "error is -0.1"),
        (with("error", serde_json::Value::Null), subject_of("blob", 1.0), "line 1"),
        (
            with("seconds", serde_json::json!({ "median": 1.0, "min": 2.0, "max": 3.0 })),
            subject_of("blob", 1.0),
            "seconds.median 1",
        ),
        (with("in_rounds", false.into()), subject_of("blob", 1.0), "no other system's views"),
    ] {
        let message = read(&line, &subject).unwrap_err().to_string();
        assert!(message.contains(words) && message.contains("peers.jsonl"), "{words}: {message}");
    }
    let mut wider = subject_of("blob", 1.0);
    wider["camera"]["height"] = 40.into();
    assert!(read(&good, &wider).unwrap_err().to_string().contains("camera.height is null there and 40 here"));
    std::fs::write(folder.path().join("peers.jsonl"), "{\"record\":").unwrap();
    assert!(read_peers(&folder.path().join("peers.jsonl"), &wider).unwrap_err().to_string().contains("line 1"));
    assert!(read_peers(&folder.path().join("absent.jsonl"), &wider).is_err());
}
