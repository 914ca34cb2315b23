//! All repeats of one budget together.

use serde::Serialize;

use super::reach::Step;
use crate::summary::{mean, standard_error};
use crate::{Record, Spread};

/// All repeats of one method at one budget, on one number of threads.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Name of the volume.
    pub dataset: String,
    /// Width x height in pixels.
    pub size: String,
    /// The method's identifier.
    pub method: String,
    /// Threads.
    pub threads: usize,
    /// The budget, in the method's unit.
    pub budget: u64,
    /// Repeats measured.
    pub repeats: usize,
    /// Root mean square over the repeats of the relative RMSE; `None` where only the time was measured.
    pub error: Option<f64>,
    /// Standard error of `error` over the repeats.
    pub error_se: Option<f64>,
    /// True below ten times the truth's own error, where nothing is drawn and nothing is read off.
    pub below_floor: bool,
    /// Time that is needed once for a volume, s: distribution, and for a cloud the drawing of its points.
    pub prepare: Spread,
    /// Time of each view, s.
    pub view: Spread,
    /// Of that: choosing voxels and offsets, s.
    pub sampling: Spread,
    /// Of that: projection and film; for ray casters the rays, s.
    pub rendering: Spread,
    /// Time of one image with everything, s.
    pub complete: Spread,
}

impl Point {
    /// Joins the records of one budget; `None` without any.
    fn of(records: &[&Record]) -> Option<Self> {
        let first = records.first()?;
        let spread = |of: &dyn Fn(&Record) -> f64| Spread::of(records.iter().map(|r| of(r)).collect());
        let squares: Vec<f64> = records.iter().filter_map(|r| r.rel_rmse).map(|e| e * e).collect();
        let error = (!squares.is_empty()).then(|| mean(&squares).sqrt());
        let error_se =
            error.and_then(|e| standard_error(&squares).map(|se| if e > 0.0 { se / (2.0 * e) } else { 0.0 }));
        Some(Self {
            dataset: first.dataset.clone(),
            size: first.size.clone(),
            method: first.method.clone(),
            threads: first.threads,
            budget: first.samples,
            repeats: records.len(),
            error,
            error_se,
            below_floor: error.is_some_and(|e| e < super::summary::floor(first.reference_error)),
            prepare: spread(&|r| r.seconds.distribution),
            view: spread(&|r| r.seconds.complete - r.seconds.distribution),
            sampling: spread(&|r| r.seconds.sampling),
            rendering: spread(&|r| r.seconds.projection),
            complete: spread(&|r| r.seconds.complete),
        })
    }

    /// The point as a step of a ladder.
    pub(crate) fn step(&self) -> Option<Step> {
        let error = self.error.filter(|&e| e > 0.0)?;
        Some(Step { budget: self.budget as f64, error, prepare: self.prepare.median, view: self.view.median })
    }
}

/// Points of all groups of records, in the order in which the groups first appear, budgets ascending within a group.
pub(crate) fn points(records: &[Record]) -> Vec<Point> {
    let group = |r: &Record| (r.dataset.clone(), r.size.clone(), r.threads, r.method.clone());
    let mut groups = Vec::new();
    for record in records {
        let group = group(record);
        if !groups.contains(&group) {
            groups.push(group);
        }
    }
    let mut points = Vec::new();
    for wanted in groups {
        let mine: Vec<&Record> = records.iter().filter(|r| group(r) == wanted).collect();
        let mut budgets: Vec<u64> = mine.iter().map(|r| r.samples).collect();
        budgets.sort_unstable();
        budgets.dedup();
        for budget in budgets {
            let same: Vec<&Record> = mine.iter().copied().filter(|r| r.samples == budget).collect();
            points.extend(Point::of(&same));
        }
    }
    points
}
