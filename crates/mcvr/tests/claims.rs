//! The claims: verdicts at the edges of their criteria, and the program from outside.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use std::collections::HashSet;
use std::path::Path;
use std::process::{Command, Output};

use mcvr::claims::Verdict::{DoesNotHold, Holds, HoldsInPart, NotTestable};
use mcvr::claims::{CATALOGUE, convergence, data_size, faster, linear, qmc, shading, sorting, thin};
use serde_json::Value;

const NAN: f64 = f64::NAN;

#[test]
fn data_size_is_judged_by_both_exponents() {
    use data_size::{INDEPENDENT, judge};
    assert_eq!(judge(INDEPENDENT, INDEPENDENT), Holds);
    assert_eq!(judge(INDEPENDENT.next_up(), INDEPENDENT), HoldsInPart);
    assert_eq!(judge(1.0, INDEPENDENT.next_up()), DoesNotHold);
    assert_eq!(judge(0.0, INDEPENDENT.next_up()), DoesNotHold);
    assert_eq!(judge(NAN, 0.0), NotTestable);
}

#[test]
fn linear_cost_is_judged_by_exponents_and_fixed_cost() {
    use linear::{FIXED, judge};
    assert_eq!(judge(0.95, 1.05, FIXED), Holds);
    assert_eq!(judge(0.95, 1.05, FIXED.next_up()), HoldsInPart);
    assert_eq!(judge(0.85, 1.05, 0.0), HoldsInPart);
    assert_eq!(judge(1.0, 0.85, 0.0), DoesNotHold);
    assert_eq!(judge(1.0, 1.15, 0.0), DoesNotHold);
    assert_eq!(judge(1.0, 1.0, NAN), NotTestable);
}

#[test]
fn sorting_is_judged_against_both_searches() {
    use sorting::{HOURS_TO_SECONDS, OWN_GAIN, judge};
    assert_eq!(judge(HOURS_TO_SECONDS, OWN_GAIN), Holds);
    assert_eq!(judge(HOURS_TO_SECONDS, OWN_GAIN.next_down()), HoldsInPart);
    assert_eq!(judge(HOURS_TO_SECONDS.next_down(), OWN_GAIN), DoesNotHold);
    assert_eq!(judge(f64::INFINITY, OWN_GAIN), NotTestable);
}

#[test]
fn convergence_is_judged_by_the_number_and_then_by_the_eye() {
    use convergence::{CONVERGED, SEEN, judge};
    assert_eq!(judge(CONVERGED, 1.0), Holds);
    assert_eq!(judge(CONVERGED.next_up(), SEEN), HoldsInPart);
    assert_eq!(judge(CONVERGED.next_up(), SEEN.next_up()), DoesNotHold);
    assert_eq!(judge(NAN, 0.0), NotTestable);
}

#[test]
fn faster_is_judged_at_equal_error_and_then_at_equal_size() {
    use faster::{DRAMATIC, judge};
    assert_eq!(judge(DRAMATIC, 0.0), Holds);
    assert_eq!(judge(DRAMATIC.next_down(), DRAMATIC), HoldsInPart);
    assert_eq!(judge(DRAMATIC.next_down(), DRAMATIC.next_down()), DoesNotHold);
    assert_eq!(judge(DRAMATIC, NAN), NotTestable);
}

#[test]
fn thin_structures_are_judged_in_all_and_at_equal_brightness() {
    use thin::{WEAK, judge};
    assert_eq!(judge(WEAK, WEAK), Holds);
    assert_eq!(judge(WEAK, WEAK.next_down()), HoldsInPart);
    assert_eq!(judge(WEAK.next_down(), WEAK), DoesNotHold);
    assert_eq!(judge(WEAK.next_down(), NAN), DoesNotHold);
    assert_eq!((judge(WEAK, NAN), judge(NAN, 1.0)), (NotTestable, NotTestable));
}

#[test]
fn qmc_is_judged_by_intervals_that_lie_apart_and_by_its_distribution() {
    use qmc::{LONGER, judge};
    assert_eq!(judge(-0.52, -0.51, LONGER), Holds);
    assert_eq!(judge(-0.52, -0.51, LONGER.next_down()), HoldsInPart);
    assert_eq!(judge(-0.51, -0.51, LONGER), HoldsInPart);
    assert_eq!(judge(-0.5, -0.51, LONGER.next_down()), DoesNotHold);
    assert_eq!(judge(NAN, -0.5, LONGER), NotTestable);
}

#[test]
fn shading_is_judged_by_the_complete_image_and_then_by_the_view() {
    use shading::judge;
    assert_eq!((judge(1.5, 9.0), judge(2.5, 9.0)), (Holds, Holds));
    assert_eq!((judge(1.49, 1.5), judge(2.51, 2.5)), (HoldsInPart, HoldsInPart));
    assert_eq!((judge(1.49, 1.49), judge(2.51, 2.51)), (DoesNotHold, DoesNotHold));
    assert_eq!(judge(2.0, NAN), NotTestable);
}

#[test]
fn every_claim_says_how_it_is_tested_and_judged() {
    let names: HashSet<&str> = CATALOGUE.iter().map(|c| c.name).collect();
    assert_eq!(names.len(), CATALOGUE.len());
    for claim in &CATALOGUE {
        assert!(claim.tested.len() > 20 && claim.criterion.contains("holds if"), "{}", claim.name);
    }
}

fn mcvr(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mcvr")).current_dir(folder).args(args).output().expect("the program starts")
}

/// The claims of a small scene; they take seconds.
fn claims(folder: &Path, args: &[&str]) -> Output {
    let small =
        ["claims", "--size", "48x48", "--repeats", "1", "--sizes", "16,24,32", "--tolerance", "1e-4", "--quiet"];
    mcvr(folder, &[&small[..], args].concat())
}

#[test]
fn a_small_phantom_gives_all_eight_rows_with_a_verdict_and_figures() {
    let folder = tempfile::tempdir().unwrap();
    let out = claims(folder.path(), &["phantom:vessels@32", "--json", "-o", "claims.json"]);
    assert!(out.status.success() && out.stdout.is_empty(), "{}", String::from_utf8_lossy(&out.stderr));
    let record: Value = serde_json::from_slice(&std::fs::read(folder.path().join("claims.json")).unwrap()).unwrap();
    let rows = record["claims"].as_array().unwrap();
    let names: Vec<&str> = rows.iter().map(|r| r["claim"]["name"].as_str().unwrap()).collect();
    assert_eq!(names, CATALOGUE.iter().map(|c| c.name).collect::<Vec<_>>());
    for row in rows {
        let finding = &row["outcome"]["finding"];
        let verdict = finding["verdict"].as_str().unwrap();
        assert!(["holds", "holds-in-part", "does-not-hold", "not-testable"].contains(&verdict), "{row}");
        // A verdict rests on figures, or says why there are none.
        let figures = finding["figures"].as_array().unwrap();
        assert!(!figures.is_empty() || verdict == "not-testable", "{row}");
        assert!(figures.iter().all(|f| f["value"].is_f64()), "{row}");
        assert!(!finding["note"].as_str().unwrap().is_empty(), "{row}");
    }
    for key in ["machine", "threads", "view", "width", "kernel", "estimand", "repeats", "seed"] {
        assert!(!record["about"][key].is_null(), "{key}");
    }
    assert!(record["about"].as_object().unwrap().contains_key("commit"));
}

#[test]
fn markdown_has_a_row_for_each_claim_that_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["phantom:lobster@24", "--only", "shading", "--only", "data-size", "--markdown"];
    let out = claims(folder.path(), &args);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = String::from_utf8(out.stdout).unwrap();
    let rows: Vec<&str> = text.lines().filter(|l| l.starts_with("| “")).collect();
    assert_eq!(rows.len(), 2, "{text}");
    assert!(rows[0].contains("independent of the data size") && rows[1].contains("shading doubles"), "{text}");
}

#[test]
fn a_kernel_that_rays_cannot_integrate_makes_claims_untestable_and_not_failed() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["phantom:lobster@16", "--kernel", "shell", "--only", "convergence,faster,data-size", "--json"];
    let out = claims(folder.path(), &args);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let record: Value = serde_json::from_slice(&out.stdout).unwrap();
    for row in record["claims"].as_array().unwrap() {
        let (name, verdict) = (&row["claim"]["name"], &row["outcome"]["finding"]["verdict"]);
        assert_eq!(verdict == "not-testable", name != "data-size", "{row}");
    }
}

#[test]
fn wrong_names_sizes_and_outputs_are_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    for (args, status, word) in [
        (&["claims", "--only", "sort"][..], 2, "unknown claim 'sort'"),
        (&["claims", "--sizes", "9000"], 1, "--sizes: 9000"),
        (&["claims", "--repeats", "0"], 2, "--repeats"),
        (&["claims", "-o", "no/such/folder/x.md"], 1, "no/such/folder"),
        (&["claims", "no-such-file.nrrd"], 1, "no-such-file.nrrd"),
    ] {
        let out = mcvr(folder.path(), args);
        let text = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.code() == Some(status) && text.contains(word), "{args:?}: {text}");
    }
    let list = mcvr(folder.path(), &["claims", "--list"]);
    assert_eq!(String::from_utf8_lossy(&list.stdout).matches("verdict:").count(), 8);
}
