use super::super::accuracy::cases;
use super::*;
use serde_json::json;

fn figure(sha256: &str, error: f64, inside: u64) -> Figure {
    let counters = BTreeMap::from([("render.inside".to_owned(), json!(inside)), ("order".to_owned(), json!("z"))]);
    Figure { sha256: sha256.into(), mean: 1.0, error: Some(error), bias: Some(0.0), counters }
}

/// A run of the first cases with the given figures.
fn run(figures: &[Figure]) -> AccuracyRun {
    AccuracyRun { figures: cases().unwrap().into_iter().zip(figures.iter().cloned()).collect(), notes: BTreeMap::new() }
}

fn counts(stages: &[(&str, u64)]) -> BTreeMap<String, Counted> {
    let of = |n: u64| Counted { instructions: n, functions: BTreeMap::from([("f".to_owned(), n / 2)]) };
    stages.iter().map(|(name, n)| ((*name).to_owned(), of(*n))).collect()
}

fn recorded(stages: &[(&str, u64)]) -> BTreeMap<String, StageInstructions> {
    let of = |c: Counted| StageInstructions { instructions: c.instructions, functions: c.functions };
    counts(stages).into_iter().map(|(name, c)| (name, of(c))).collect()
}

fn verdicts(section: &Section) -> Vec<Verdict> {
    section.lines.iter().map(|l| l.verdict).collect()
}

#[test]
fn an_image_must_be_the_same_bit_for_bit_and_so_must_its_error() {
    let now = run(&[figure("a", 0.1, 5), figure("b", 0.2, 6)]);
    let same = now.by_name();
    assert_eq!(judge_accuracy(&same, ["m", "m"], &now, false).failures(), 0);
    for changed in [figure("x", 0.1, 5), figure("a", 0.1f64.next_up(), 5)] {
        let section = judge_accuracy(&same, ["m", "m"], &run(&[changed, figure("b", 0.2, 6)]), false);
        assert_eq!(verdicts(&section), [Verdict::Worse, Verdict::Same]);
    }
    // Counters are another check.
    let section = judge_accuracy(&same, ["m", "m"], &run(&[figure("a", 0.1, 7), figure("b", 0.2, 6)]), false);
    assert_eq!(section.failures(), 0);
}

#[test]
fn a_case_that_is_new_is_noted_and_one_that_is_gone_fails() {
    let now = run(&[figure("a", 0.1, 5)]);
    let mut baseline = now.by_name();
    assert_eq!(verdicts(&judge_accuracy(&BTreeMap::new(), ["m", "m"], &now, true)), [Verdict::New]);
    baseline.insert("gone/tent/line/plain".into(), figure("g", 0.1, 5));
    assert_eq!(judge_accuracy(&baseline, ["m", "m"], &now, false).failures(), 0, "not all cases were asked for");
    let section = judge_accuracy(&baseline, ["m", "m"], &now, true);
    assert_eq!(verdicts(&section), [Verdict::Same, Verdict::Gone]);
    assert_eq!(section.failures(), 1);
}

#[test]
fn only_mc_on_another_machine_is_explained_and_still_fails() {
    let mc = cases().unwrap().into_iter().find(|c| c.name == "mc/tent/line/plain").unwrap();
    let baseline = BTreeMap::from([(mc.name.clone(), figure("a", 0.1, 5))]);
    let notes = BTreeMap::from([(mc.name.clone(), "other rounding".to_owned())]);
    let run = AccuracyRun { figures: vec![(mc, figure("b", 0.1, 5))], notes };
    let [same, other] = ["here", "there"].map(|m| judge_accuracy(&baseline, [m, "here"], &run, false));
    assert_eq!((same.failures(), other.failures()), (1, 1));
    assert!(same.notices.is_empty() && other.notices[0].contains("logarithms"));
}

#[test]
fn the_counter_that_moved_is_named_with_from_and_to() {
    let baseline = run(&[figure("a", 0.1, 1000)]).by_name();
    let section = judge_work(&baseline, &run(&[figure("a", 0.1, 1010)]));
    let line = &section.lines[0];
    assert!(line.name.ends_with(" render.inside"), "{line:?}");
    assert_eq!((line.baseline.as_str(), line.now.as_str(), line.change.as_str()), ("1000", "1010", "+1.000 %"));
    assert_eq!(section.failures(), 1);
    assert_eq!(judge_work(&baseline, &run(&[figure("z", 0.3, 1000)])).failures(), 0);
}

#[test]
fn a_counter_that_vanished_fails_and_one_that_is_new_does_not() {
    let baseline = run(&[figure("a", 0.1, 5)]).by_name();
    let mut fewer = figure("a", 0.1, 5);
    fewer.counters.remove("order");
    assert_eq!(judge_work(&baseline, &run(&[fewer])).failures(), 1);
    let mut more = figure("a", 0.1, 5);
    more.counters.insert("render.more".into(), json!(1));
    assert_eq!(verdicts(&judge_work(&baseline, &run(&[more]))), [Verdict::New]);
}

#[test]
fn instructions_may_move_by_two_percent_and_no_more() {
    let baseline = recorded(&[("a", 1_000_000), ("b", 1_000_000), ("c", 1_000_000), ("d", 1_000_000)]);
    let now = counts(&[("a", 1_020_000), ("b", 1_020_001), ("c", 980_000), ("d", 979_999)]);
    let section = judge_instructions(&baseline, &now, true, true);
    assert_eq!(verdicts(&section), [Verdict::Same, Verdict::Worse, Verdict::Same, Verdict::Better]);
    assert_eq!(section.failures(), 1);
    assert_eq!(section.lines[1].change, "+2.00 %");
    assert_eq!(section.lines[1].note, "f +10000", "the function that moved is named");
}

#[test]
fn another_compiler_is_reported_and_not_judged() {
    let section = judge_instructions(&recorded(&[("a", 100)]), &counts(&[("a", 200)]), false, true);
    assert!(!section.judged && section.failures() == 0);
    assert_eq!(verdicts(&section), [Verdict::NotJudged]);
    assert_eq!(section.lines[0].change, "+100.00 %");
}

#[test]
fn a_stage_that_is_gone_fails_even_under_another_compiler() {
    let section = judge_instructions(&recorded(&[("a", 100), ("b", 1)]), &counts(&[("a", 100), ("n", 5)]), false, true);
    assert_eq!(verdicts(&section), [Verdict::NotJudged, Verdict::New, Verdict::Gone]);
    assert_eq!(section.failures(), 1);
}
