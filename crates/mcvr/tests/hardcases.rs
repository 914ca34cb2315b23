//! The catalogue of hard cases, posed as `mcvr hardcases` poses it.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use std::collections::HashSet;

use mcvr::hardcases::{Context, Cost, Group, Verdict, catalogue};

/// Poses every quick case of a group. Cases that this machine cannot pose are named, and never all of a group.
fn pose(group: Group) {
    let context = Context::new(Some(env!("CARGO_BIN_EXE_mcvr").into())).unwrap();
    let (mut passed, mut failed) = (0, vec![]);
    for case in catalogue().filter(|c| c.group == group && c.cost == Cost::Quick) {
        let outcome = case.run(&context);
        match outcome.verdict {
            Verdict::Pass => passed += 1,
            Verdict::Skip => eprintln!("{}: skipped: {}", case.name, outcome.error.unwrap_or_default()),
            Verdict::Fail => failed.push(format!("{}: {:?} {:?}", case.name, outcome.finding, outcome.error)),
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
    assert!(passed > 0, "no case of {} was posed", group.name());
}

#[test]
fn distributions() {
    pose(Group::Distributions);
}

#[test]
fn sequences() {
    pose(Group::Sequences);
}

#[test]
fn geometry() {
    pose(Group::Geometry);
}

#[test]
fn effects() {
    pose(Group::Effects);
}

#[test]
fn scale() {
    pose(Group::Scale);
}

#[test]
fn measures() {
    pose(Group::Measures);
}

#[test]
fn files() {
    pose(Group::Files);
}

#[test]
fn running() {
    pose(Group::Running);
}

#[test]
fn names_are_unique_and_every_case_says_what_breaks_and_what_is_asserted() {
    let mut names = HashSet::new();
    for case in catalogue() {
        assert!(names.insert(case.name), "{} twice", case.name);
        let kebab = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        assert!(case.name.chars().all(kebab), "{}", case.name);
        assert!(case.breaks.len() > 10 && case.asserts.len() > 10, "{}", case.name);
    }
}
