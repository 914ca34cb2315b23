//! How long a method takes to an error: read off its measured points, never below what the truth can judge.

use serde::Serialize;

/// One measured budget of a method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Step {
    /// The budget, in the method's unit.
    pub(crate) budget: f64,
    /// Relative RMSE.
    pub(crate) error: f64,
    /// Median seconds that are needed once, however many views follow.
    pub(crate) prepare: f64,
    /// Median seconds of each view.
    pub(crate) view: f64,
}

/// The points of one method, budgets ascending.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Ladder {
    pub(crate) steps: Vec<Step>,
    /// True for samplers, whose budget takes any value and whose error falls with it: between two points the error and the
    /// times follow power laws. Ray casters have the settings that were measured and none between.
    pub(crate) continuous: bool,
    /// How often the preparation is paid at most, however many views follow.
    pub(crate) preparations: u64,
}

/// What it takes to reach an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Reach {
    /// The budget, in the method's unit.
    pub budget: f64,
    /// Seconds needed once.
    pub prepare: f64,
    /// Seconds of each view.
    pub view: f64,
    /// The error there: what was asked for, or less where a ray caster's cheapest sufficient setting does better.
    pub error: f64,
    /// Where it comes from.
    pub by: By,
}

/// Where a [`Reach`] comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum By {
    /// Between two measured points, or at one.
    Measured,
    /// The cheapest measured point is better than what was asked for.
    Cheapest,
    /// Beyond the last measured point, along the slope of the last ones.
    Extrapolated,
}

impl Reach {
    /// Seconds for so many views, the preparation paid at most `preparations` times.
    pub fn total(&self, views: u64, preparations: u64) -> f64 {
        views.min(preparations) as f64 * self.prepare + views as f64 * self.view
    }
}

/// How far a curve is continued beyond its last point: in time, at most so many times.
const EXTRAPOLATION: f64 = 1000.0;

impl Ladder {
    /// The cheapest way to an error, by the time of a complete first image. `None` where the method does not get there.
    /// Errors below `floor`, ten times the truth's own, are judged by nobody: `None` as well.
    pub(crate) fn reach(&self, error: f64, floor: f64) -> Option<Reach> {
        if error < floor || self.steps.is_empty() {
            return None;
        }
        if self.continuous { self.along(error) } else { self.cheapest(error) }
    }

    /// The quickest point that is good enough.
    fn cheapest(&self, error: f64) -> Option<Reach> {
        let good = self.steps.iter().filter(|s| s.error <= error);
        let best = good.min_by(|a, b| (a.prepare + a.view).total_cmp(&(b.prepare + b.view)))?;
        let quickest = self.steps.iter().all(|s| s.prepare + s.view >= best.prepare + best.view);
        Some(best.reach(if quickest { By::Cheapest } else { By::Measured }))
    }

    /// The crossing of the curve with the error, points joined by power laws.
    fn along(&self, error: f64) -> Option<Reach> {
        let first = self.steps.first()?;
        if first.error <= error {
            return Some(first.reach(By::Cheapest));
        }
        let pair = self.steps.windows(2).find(|w| w[0].error > error && w[1].error <= error);
        if let Some([a, b]) = pair {
            let t = (a.error / error).ln() / (a.error / b.error).ln();
            let between = |x: f64, y: f64| if x > 0.0 && y > 0.0 { x * (y / x).powf(t) } else { x + t * (y - x) };
            return Some(Reach {
                budget: between(a.budget, b.budget),
                prepare: between(a.prepare, b.prepare),
                view: between(a.view, b.view),
                error,
                by: By::Measured,
            });
        }
        self.beyond(error)
    }

    /// Continues the last points: the error by the slope over the last factor of 16 in the budget or more, the time in
    /// proportion to the budget.
    fn beyond(&self, error: f64) -> Option<Reach> {
        let last = self.steps.last()?;
        let before = self.steps.iter().rev().find(|s| s.budget * 16.0 <= last.budget)?;
        let slope = (last.error / before.error).ln() / (last.budget / before.budget).ln();
        if slope >= -0.1 {
            return None;
        }
        let factor = (error / last.error).powf(1.0 / slope);
        (factor <= EXTRAPOLATION).then_some(Reach {
            budget: last.budget * factor,
            prepare: last.prepare,
            view: last.view * factor,
            error,
            by: By::Extrapolated,
        })
    }
}

impl Step {
    fn reach(&self, by: By) -> Reach {
        Reach { budget: self.budget, prepare: self.prepare, view: self.view, error: self.error, by }
    }
}

/// Where one method overtakes another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Crossing {
    /// The relative error at which the two take the same time for one image.
    pub error: f64,
    /// The budget of the first method there.
    pub budget: f64,
    /// The time there, s.
    pub seconds: f64,
    /// True when the first method is the faster one for larger errors (cruder images).
    pub first_for_larger: bool,
}

/// Fineness of the search: factor between errors that are looked at.
const FINENESS: f64 = 1.01;

/// All errors, largest first, at which the faster of two methods changes, for one image with everything included. Only
/// measured parts of the curves count.
pub(crate) fn crossings(a: &Ladder, b: &Ladder, floor: f64) -> Vec<Crossing> {
    let mut found = Vec::new();
    let mut last: Option<bool> = None;
    let highest = [a, b].iter().flat_map(|l| &l.steps).map(|s| s.error).fold(0.0, f64::max);
    let lowest = [a, b].iter().flat_map(|l| &l.steps).map(|s| s.error).fold(f64::INFINITY, f64::min).max(floor);
    if !(lowest > 0.0 && highest.is_finite()) {
        return found;
    }
    let mut error = highest;
    while error >= lowest {
        let measured = |l: &Ladder| l.reach(error, floor).filter(|r| r.by != By::Extrapolated);
        let (x, y) = (measured(a), measured(b));
        let first_wins = match (x, y) {
            (Some(x), Some(y)) => Some(x.total(1, 1) < y.total(1, 1)),
            _ => None,
        };
        if let (Some(before), Some(now), Some(x)) = (last, first_wins, x)
            && before != now
        {
            found.push(Crossing { error, budget: x.budget, seconds: x.total(1, 1), first_for_larger: before });
        }
        last = first_wins.or(last);
        error /= FINENESS;
    }
    found
}

/// The number of views from which the first way is the cheaper one in total, or `None` where it never is. `Some(1)`: from the first.
pub(crate) fn break_even(a: (&Reach, u64), b: (&Reach, u64)) -> Option<u64> {
    let cheaper = |views: u64| a.0.total(views, a.1) < b.0.total(views, b.1);
    let limit = 1 << 40;
    // Totals are straight lines in the number of views from the largest number of preparations on.
    (1..=a.1.max(b.1).min(64)).find(|&v| cheaper(v)).or_else(|| {
        let start = a.1.max(b.1);
        let (fixed, each) = (b.0.total(start, b.1) - a.0.total(start, a.1), a.0.view - b.0.view);
        // a(start + k) - b(start + k) = -fixed + k · each < 0
        (each < 0.0).then(|| start + (fixed / each).max(0.0) as u64 + 1).filter(|&v| v < limit && cheaper(v))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampler(constant: f64, slope: f64, prepare: f64, ns: f64) -> Ladder {
        let step = |m: i32| {
            let budget = 2f64.powi(m);
            Step { budget, error: constant * budget.powf(slope), prepare, view: budget * ns * 1e-9 }
        };
        Ladder { steps: (10..=26).step_by(2).map(step).collect(), continuous: true, preparations: 1 }
    }

    fn rays(points: &[(f64, f64)]) -> Ladder {
        let steps = points.iter().enumerate().map(|(i, &(error, view))| Step {
            budget: (i + 1) as f64,
            error,
            prepare: 0.0,
            view,
        });
        Ladder { steps: steps.collect(), continuous: false, preparations: 1 }
    }

    #[test]
    fn a_power_law_is_read_off_exactly() {
        let ladder = sampler(400.0, -0.5, 0.01, 5.0);
        // 400 M^-0.5 = 0.3 at M = 1,777,777.8, between two points.
        let at = ladder.reach(0.3, 0.0).unwrap();
        let budget = (400.0f64 / 0.3).powi(2);
        assert!((at.budget / budget - 1.0).abs() < 1e-12 && (at.view / (budget * 5e-9) - 1.0).abs() < 1e-12);
        assert_eq!((at.by, at.prepare), (By::Measured, 0.01));
        // Beyond the last point, 400 · 2^-13 = 4.9 %: continued, and said so.
        let far = ladder.reach(0.01, 0.0).unwrap();
        assert!(far.by == By::Extrapolated && (far.budget / 40_000f64.powi(2) - 1.0).abs() < 1e-9);
        // A thousand times the last time is the end; so is the truth's own error.
        assert_eq!(ladder.reach(1e-4, 0.0), None);
        assert_eq!(ladder.reach(0.3, 0.31), None);
        assert_eq!(ladder.reach(100.0, 0.0).unwrap().by, By::Cheapest);
    }

    #[test]
    fn a_curve_that_has_stopped_falling_is_not_continued() {
        let mut ladder = sampler(400.0, -0.5, 0.0, 5.0);
        ladder.steps.iter_mut().for_each(|s| s.error = s.error.max(0.2));
        assert_eq!(ladder.reach(0.1, 0.0), None);
        assert!(ladder.reach(0.2, 0.0).is_some());
    }

    #[test]
    fn ray_casters_have_no_settings_between() {
        let march = rays(&[(0.05, 0.02), (0.02, 0.08), (0.021, 0.05), (0.004, 0.3)]);
        let at = |e| march.reach(e, 0.0).map(|r| (r.view, r.by));
        assert_eq!(at(0.5), Some((0.02, By::Cheapest)));
        assert_eq!(at(0.03), Some((0.05, By::Measured)));
        assert_eq!(at(0.02), Some((0.08, By::Measured)));
        assert_eq!(at(0.003), None);
    }

    #[test]
    fn crossings_lie_where_the_times_are_equal() {
        // The march's quickest image, 5 %, takes 20 ms; the sampler has 4 million samples by then: 20 % error.
        let (mc, march) = (sampler(400.0, -0.5, 0.0, 5.0), rays(&[(0.05, 0.02), (0.004, 0.3)]));
        let found = crossings(&mc, &march, 0.0);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!((found[0].error / 0.2 - 1.0).abs() < 0.02 && found[0].first_for_larger);
        assert!((found[0].seconds / 0.02 - 1.0).abs() < 0.03 && (found[0].budget / 4e6 - 1.0).abs() < 0.03);
        let reverse = crossings(&march, &mc, 0.0);
        assert!(reverse.len() == 1 && !reverse[0].first_for_larger);
        assert_eq!(crossings(&mc, &mc, 0.0), vec![]);
        // Where the truth cannot judge, nothing crosses.
        assert_eq!(crossings(&mc, &march, 0.25), vec![]);
    }

    #[test]
    fn views_break_even_where_the_lines_meet() {
        let reach = |prepare, view| Reach { budget: 1.0, prepare, view, error: 0.1, by: By::Measured };
        let (cloud, march) = (reach(1.0, 0.01), reach(0.0, 0.03));
        // 1 + 0.01 V < 0.03 V from V = 51 on.
        let v = break_even((&cloud, 1), (&march, 1)).unwrap();
        assert!((50..=51).contains(&v), "{v}");
        assert!(cloud.total(v, 1) < march.total(v, 1) && cloud.total(v - 1, 1) >= march.total(v - 1, 1) - 1e-12);
        assert_eq!(break_even((&march, 1), (&cloud, 1)), Some(1));
        assert_eq!(break_even((&reach(1.0, 0.04), 1), (&march, 1)), None);
        assert_eq!(reach(1.0, 0.5).total(10, 3), 8.0);
    }
}
