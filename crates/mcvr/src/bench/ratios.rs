//! Which stages became slower, from times alone, on a machine that others use.
//!
//! Let `q` be a stage's seconds over its baseline's. A faster machine, or a neighbour, changes all `q`, though not equally: a
//! neighbour that reads much memory slows what reads memory. So a stage is judged by pairs: it is slower only if its `q` is
//! more than 25 % above that of *every* steady stage. Steady are the anchors, which no change of the program touches and
//! which differ in what they need of a machine, and the stages within 25 % of them.
//!
//! - A stage that slowed down by less than 1.25 against all others is never flagged; one by more than 1.25² = 1.56 always,
//!   as no steady stage is more than 1.25 above the slowest anchor. Between the two it depends on the others.
//! - A change that slows half the stages, or all, is seen as well: the anchors stay.
//! - Measured again, it must come out the same in every pass.
//! - Where the anchors themselves moved apart by more than [`ANCHORS_AGREE`], the machine is too busy to tell, and the pass
//!   says so.

use std::collections::BTreeMap;

use super::ANCHOR;
use super::report::{Check, Line, Section, Verdict};

/// Largest share by which a pair's ratio may move.
pub const TIME_TOLERANCE: f64 = 0.25;
/// Largest ratio of two anchors' changes at which a pass counts. A memory-bound load beside it slows the streaming anchor so.
pub const ANCHORS_AGREE: f64 = 1.6;

/// A pass held to the baseline.
#[derive(Clone, Debug)]
pub struct Pass {
    /// Each stage's seconds over its baseline's, relative to the anchors' geometric mean.
    pub moved: BTreeMap<String, f64>,
    /// Stages slower than every steady one.
    pub slower: Vec<String>,
    /// Stages faster than every steady one.
    pub faster: Vec<String>,
    /// The largest ratio of two anchors' changes.
    pub anchors: f64,
}

impl Pass {
    /// Compares the stages that both have; `None` without an anchor.
    pub fn of(baseline: &BTreeMap<String, f64>, now: &BTreeMap<String, f64>) -> Option<Self> {
        let both = now.iter().filter_map(|(name, s)| Some((name.clone(), s / baseline.get(name)?)));
        let q: BTreeMap<String, f64> = both.filter(|(_, q)| q.is_finite() && *q > 0.0).collect();
        let anchors: Vec<f64> = q.iter().filter(|(name, _)| name.starts_with(ANCHOR)).map(|(_, q)| *q).collect();
        if anchors.is_empty() {
            return None;
        }
        let bound = 1.0 + TIME_TOLERANCE;
        let (least, most) = ends(anchors.iter().copied());
        let steady = |name: &str, q: f64| name.starts_with(ANCHOR) || (least / bound..=most * bound).contains(&q);
        let beyond = |slower: bool| {
            let all_agree = |(name, own): &(&String, &f64)| {
                let others = q.iter().filter(|(other, q)| other != name && steady(other, **q));
                let pair = |q: f64| if slower { **own > q * bound } else { **own * bound < q };
                !name.starts_with(ANCHOR) && others.map(|(_, q)| *q).all(pair)
            };
            q.iter().filter(all_agree).map(|(name, _)| name.clone()).collect()
        };
        let unit = (anchors.iter().map(|q| q.ln()).sum::<f64>() / anchors.len() as f64).exp();
        let moved = q.iter().map(|(name, q)| (name.clone(), q / unit)).collect();
        Some(Self { moved, slower: beyond(true), faster: beyond(false), anchors: most / least })
    }

    /// Whether the machine was quiet enough to judge by.
    pub fn counts(&self) -> bool {
        self.anchors <= ANCHORS_AGREE
    }

    /// Whether another pass is needed: a stage looks slower, or the machine was too busy to tell.
    pub fn is_doubtful(&self) -> bool {
        !self.counts() || !self.slower.is_empty()
    }
}

fn ends(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, 0.0), |(low, high), v| (low.min(v), high.max(v)))
}

/// The verdict of all passes: slower is what every pass that counts calls so, of two at least.
pub fn judge_times(baseline: &BTreeMap<String, f64>, passes: &[BTreeMap<String, f64>]) -> Section {
    let mut section = Section::new(Check::Time);
    let judged: Vec<Pass> = passes.iter().filter_map(|now| Pass::of(baseline, now)).collect();
    if judged.is_empty() && !baseline.is_empty() {
        section.problem("the baseline has no anchors; accept a new one".into());
    }
    let counting: Vec<&Pass> = judged.iter().filter(|p| p.counts()).collect();
    section.judged = counting.iter().any(|p| p.slower.is_empty()) || counting.len() >= 2;
    if !section.judged && !judged.is_empty() {
        let worst = judged.iter().map(|p| p.anchors).fold(0.0, f64::max);
        section.notice(format!(
            "times are not judged: in {} passes the reference loads moved against each other by up to {worst:.2}, so something \
             else uses this machine; run again when it is quiet",
            judged.len()
        ));
    }
    let now = super::timing::middle(passes);
    let always =
        |of: fn(&Pass) -> &Vec<String>, name: &String| section.judged && counting.iter().all(|p| of(p).contains(name));
    let mut lines = Vec::new();
    for (name, seconds) in &now {
        let moved: Vec<f64> = judged.iter().filter_map(|p| p.moved.get(name).copied()).collect();
        let verdict = match baseline.get(name) {
            None => Verdict::New,
            Some(_) if !section.judged => Verdict::NotJudged,
            Some(_) if always(|p| &p.slower, name) => Verdict::Worse,
            Some(_) if always(|p| &p.faster, name) => Verdict::Better,
            Some(_) => Verdict::Same,
        };
        let note = match verdict {
            Verdict::Worse => {
                format!("slower than every steady stage by over 25 % in {} of {0} passes", counting.len())
            }
            Verdict::Better => "faster than every steady stage by over 25 %".into(),
            _ => String::new(),
        };
        let (low, high) = ends(moved.iter().copied());
        let change = match moved.len() {
            0 => String::new(),
            1 => format!("×{low:.2}"),
            _ => format!("×{low:.2} to ×{high:.2}"),
        };
        let show = |s: f64| format!("{:.3} ms", 1e3 * s);
        let before = baseline.get(name).map_or(String::new(), |s| show(*s));
        lines.push(Line { name: name.clone(), baseline: before, now: show(*seconds), change, verdict, note });
    }
    section.lines.extend(lines);
    if let Some(last) = judged.last() {
        section.notice(format!(
            "×1 is the anchors' geometric mean; they moved by up to {:.2} against each other; seconds are not judged",
            last.anchors
        ));
    }
    section
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 8] = ["anchor/integer", "anchor/vector", "anchor/stream", "anchor/scatter", "a", "b", "c", "d"];

    fn times(values: [f64; 8]) -> BTreeMap<String, f64> {
        NAMES.iter().map(|n| (*n).to_owned()).zip(values).collect()
    }

    fn baseline() -> BTreeMap<String, f64> {
        times([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
    }

    fn scaled(factors: [f64; 8]) -> BTreeMap<String, f64> {
        let mut all = baseline();
        all.iter_mut().for_each(|(name, s)| *s *= factors[NAMES.iter().position(|n| n == name).unwrap()]);
        all
    }

    fn slower(factors: [f64; 8]) -> Vec<String> {
        Pass::of(&baseline(), &scaled(factors)).unwrap().slower
    }

    #[test]
    fn a_machine_of_another_speed_is_no_regression() {
        assert!(slower([3.0; 8]).is_empty());
        assert!(slower([0.2; 8]).is_empty());
    }

    #[test]
    fn a_stage_of_twice_the_time_is_named_and_only_that() {
        assert_eq!(slower([1.0, 1.1, 0.95, 1.0, 1.05, 2.0, 1.1, 0.9]), ["b"]);
        // On a machine half as fast as well.
        assert_eq!(slower([2.0, 2.2, 1.9, 2.0, 2.1, 4.0, 2.2, 1.8]), ["b"]);
    }

    #[test]
    fn a_change_to_half_the_stages_or_all_is_seen() {
        assert_eq!(slower([1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 1.0, 1.0]), ["a", "b"]);
        assert_eq!(slower([1.0, 1.0, 1.0, 1.0, 2.0, 1.9, 2.1, 1.8]), ["a", "b", "c", "d"]);
    }

    #[test]
    fn one_steady_pair_that_disagrees_clears_a_stage() {
        // 1.3 is above all but the streaming anchor, which a neighbour slowed down.
        assert!(slower([1.0, 1.0, 1.1, 1.0, 1.3, 1.0, 1.0, 1.0]).is_empty());
        assert_eq!(slower([1.0, 1.0, 1.0, 1.0, 1.3, 1.0, 1.0, 1.0]), ["a"]);
    }

    #[test]
    fn the_edge_of_the_tolerance() {
        assert!(slower([1.0, 1.0, 1.0, 1.0, 1.25, 1.0, 1.0, 1.0]).is_empty());
        assert_eq!(slower([1.0, 1.0, 1.0, 1.0, 1.2501, 1.0, 1.0, 1.0]), ["a"]);
        // Beyond 1.25² nothing steady can hide it.
        assert_eq!(slower([1.0, 1.0, 1.0, 1.0, 1.5626, 1.25, 1.25, 1.25]), ["a"]);
        assert!(slower([1.0, 1.0, 1.0, 1.0, 1.56, 1.25, 1.25, 1.25]).is_empty());
    }

    #[test]
    fn every_pass_must_agree_and_one_is_not_enough() {
        let slow = scaled([1.0, 1.0, 1.0, 1.0, 2.0, 1.0, 1.0, 1.0]);
        let verdict = |passes: &[BTreeMap<String, f64>]| {
            let section = judge_times(&baseline(), passes);
            (section.judged, section.lines.iter().find(|l| l.name == "a").unwrap().verdict)
        };
        assert_eq!(verdict(&[slow.clone(), slow.clone(), slow.clone()]), (true, Verdict::Worse));
        assert_eq!(verdict(&[slow.clone(), baseline(), slow.clone()]), (true, Verdict::Same));
        assert_eq!(verdict(std::slice::from_ref(&slow)), (false, Verdict::NotJudged));
    }

    #[test]
    fn a_busy_machine_is_not_judged_and_says_so() {
        let busy = scaled([1.0, 1.0, 1.7, 1.0, 2.0, 1.0, 1.0, 1.0]);
        let section = judge_times(&baseline(), &[busy.clone(), busy.clone(), busy]);
        assert!(!section.judged && section.failures() == 0);
        assert!(section.notices.iter().any(|n| n.contains("something else uses this machine")), "{section:?}");
    }

    #[test]
    fn a_stage_that_sped_up_is_no_failure() {
        let fast = scaled([1.0, 1.0, 1.0, 1.0, 0.5, 1.0, 1.0, 1.0]);
        let section = judge_times(&baseline(), &[fast]);
        let line = section.lines.iter().find(|l| l.name == "a").unwrap();
        assert_eq!((line.verdict, section.failures()), (Verdict::Better, 0));
    }
}
