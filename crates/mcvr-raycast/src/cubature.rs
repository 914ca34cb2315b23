//! Adaptive integration over a pixel's square, with an error estimate.
//!
//! Every square is evaluated by two nested product rules of degree 3: Simpson's on 3×3 points, and the fine one on the
//! square's quarters, 5×5 points. How far they differ estimates the fine value's error. The square with the largest
//! estimate is quartered until the estimates sum to less than the tolerance. For an integrand with four derivatives
//! the difference overstates the fine rule's error some fifteen times.
//!
//! Why the estimate is taken line by line, as absolute values, together with a second null rule: refinement *selects*
//! squares whose estimate is small. Where the initial errors are far above the tolerance, the squares that pass at
//! once are those in which two contributions to one difference happened to cancel, and their estimates understate
//! the error. Contributions that may not cancel one another, from ten lines, leave no room for such luck. The
//! second rule is for lines that are all alike: voxel faces seen edge-on, parallel to the pixels. (J. Berntsen and
//! T. Espelid, *Error estimation in automatic quadrature routines*, ACM TOMS 17, 1991, use several null rules likewise.)
//!
//! An integrand may have several channels; they share the squares, and each must meet the tolerance.
//!
//! Why a closed rule, when Gauss points would be fewer: line integrals have kinks, and with `box` jumps, where voxel
//! faces are seen edge-on. An open rule has gaps along the square's border; a kink in a gap goes unseen by the coarse
//! and by the fine rule, which then agree exactly on a wrong result. A closed rule sees every one of them.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// How a square's points are placed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Rule {
    /// On the border: for integrands that are continuous over the image (`tent`, `bspline3`).
    Continuous,
    /// The outermost points a hair inside the square, so that a jump exactly on the border belongs to the right
    /// side (`box`). Quarters then cannot take over their parent's values.
    Jumps,
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Largest error estimate of the pixel (in the integrand's unit).
    pub tolerance: f64,
    /// The pixel starts as 4^base squares.
    pub base: u32,
    /// Squares of side 2^-depth are not quartered further.
    pub depth: u32,
    /// How the squares' estimates add up.
    pub total: Total,
}

/// How the estimates of a pixel's squares make up the pixel's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Total {
    /// Their sum: a bound, whatever their signs.
    Sum,
    /// [`SPREAD`] times the root of the sum of their squares, when that is less: for integrands whose errors have
    /// independent signs, as kinks and cusps scattered over the pixel leave them. Squares that the depth limit leaves
    /// unresolved count with their sum all the same: they may follow one jump, with one sign.
    Spread,
}

/// Standard errors that [`Total::Spread`] allows for.
const SPREAD: f64 = 2.0;

/// A pixel's mean with its error estimate, by channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PixelMean<const C: usize> {
    pub value: [f64; C],
    pub error: [f64; C],
    /// The depth limit stopped the refinement above the tolerance.
    pub limited: bool,
}

#[derive(Clone, Copy)]
struct Square<const C: usize> {
    x: f64,
    y: f64,
    depth: u32,
    /// Mean by the fine rule.
    fine: [f64; C],
    error: [f64; C],
    /// The integrand at the 5×5 points, row by row.
    values: [[f64; C]; 25],
}

impl<const C: usize> Square<C> {
    fn side(&self) -> f64 {
        (0.5f64).powi(self.depth as i32)
    }

    fn area(&self) -> f64 {
        (0.25f64).powi(self.depth as i32)
    }

    /// Share of the pixel's error: that of the worst channel.
    fn worst(&self) -> f64 {
        largest(self.error) * self.area()
    }
}

/// The largest of some errors (at least 0).
fn largest<const C: usize>(errors: [f64; C]) -> f64 {
    errors.into_iter().fold(0.0, f64::max)
}

/// Estimates of a pixel's squares, by channel.
#[derive(Clone, Copy)]
struct Estimates<const C: usize> {
    sum: [f64; C],
    /// Sum of the squares of those that can still be quartered, and sum of the others.
    squares: [f64; C],
    stuck: [f64; C],
}

impl<const C: usize> Estimates<C> {
    fn new(all: &[Square<C>], limits: Limits) -> Self {
        let mut estimates = Self { sum: [0.0; C], squares: [0.0; C], stuck: [0.0; C] };
        all.iter().for_each(|s| estimates.add(s, limits));
        estimates
    }

    fn add(&mut self, s: &Square<C>, limits: Limits) {
        for c in 0..C {
            let e = s.error[c] * s.area();
            self.sum[c] += e;
            if s.depth < limits.depth {
                self.squares[c] += e * e;
            } else {
                self.stuck[c] += e;
            }
        }
    }

    /// Takes out a square that is being quartered.
    fn remove(&mut self, s: &Square<C>) {
        for c in 0..C {
            let e = s.error[c] * s.area();
            self.sum[c] -= e;
            self.squares[c] -= e * e;
        }
    }

    fn total(&self, total: Total) -> [f64; C] {
        match total {
            Total::Sum => self.sum,
            Total::Spread => std::array::from_fn(|c| {
                // Updates leave rounding behind, which may go below 0.
                self.sum[c].min(SPREAD * self.squares[c].max(0.0).sqrt() + self.stuck[c])
            }),
        }
    }
}

/// `Σ of(square) area`, by channel.
fn sum<const C: usize>(squares: &[Square<C>], of: impl Fn(&Square<C>) -> [f64; C]) -> [f64; C] {
    std::array::from_fn(|c| squares.iter().map(|s| of(s)[c] * s.area()).sum())
}

/// Entry of the queue: largest error first, then the older square, so that the order is the same every time.
#[derive(PartialEq)]
struct Worst {
    error: f64,
    index: usize,
}

impl Eq for Worst {}

impl Ord for Worst {
    fn cmp(&self, other: &Self) -> Ordering {
        self.error.total_cmp(&other.error).then(other.index.cmp(&self.index))
    }
}

impl PartialOrd for Worst {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Reusable memory.
pub(crate) struct Scratch<const C: usize> {
    squares: Vec<Square<C>>,
    queue: BinaryHeap<Worst>,
}

impl<const C: usize> Default for Scratch<C> {
    fn default() -> Self {
        Self { squares: Vec::new(), queue: BinaryHeap::new() }
    }
}

const FINE: [f64; 5] = [1.0 / 12.0, 4.0 / 12.0, 2.0 / 12.0, 4.0 / 12.0, 1.0 / 12.0];
/// Share of the odd null rule in the estimate.
const ODD: f64 = 0.03;

/// Error estimate of Simpson's fine rule on one line of five values: how far it is from the coarse rule on three
/// (their difference is the fourth difference over 12), or an odd null rule of the third order, whichever is larger.
fn doubt(v: impl Fn(usize) -> f64) -> f64 {
    let even = (v(0) - 4.0 * v(1) + 6.0 * v(2) - 4.0 * v(3) + v(4)) / 12.0;
    let odd = ODD * (v(4) - 2.0 * v(3) + 2.0 * v(1) - v(0));
    even.abs().max(odd.abs())
}

impl Rule {
    /// Evaluates a square of side 2^-depth with its lowest corner at (x, y). `parent` gives the square of which
    /// it is the quarter `q` (x first).
    fn assess<const C: usize>(
        self,
        f: &mut impl FnMut(f64, f64) -> [f64; C],
        (x, y, depth): (f64, f64, u32),
        parent: Option<(&Square<C>, usize)>,
    ) -> Square<C> {
        let mut s = Square { x, y, depth, fine: [0.0; C], error: [0.0; C], values: [[0.0; C]; 25] };
        let side = s.side();
        let inset = if self == Rule::Jumps { 1e-9 } else { 0.0 };
        let shared = if self == Rule::Jumps { None } else { parent };
        let at = |o: f64, i: usize| o + side * (i as f64 * 0.25).clamp(inset, 1.0 - inset);
        for (j, wy) in FINE.iter().enumerate() {
            for (i, wx) in FINE.iter().enumerate() {
                let even = i % 2 == 0 && j % 2 == 0;
                let v = match shared {
                    Some((p, q)) if even => p.values[5 * (j / 2 + 2 * (q >> 1)) + i / 2 + 2 * (q & 1)],
                    _ => f(at(x, i), at(y, j)),
                };
                s.values[5 * j + i] = v;
                for (fine, v) in s.fine.iter_mut().zip(v) {
                    *fine += wx * wy * v;
                }
            }
        }
        for (n, w) in FINE.iter().enumerate() {
            for (c, error) in s.error.iter_mut().enumerate() {
                *error += w * (doubt(|i| s.values[5 * n + i][c]) + doubt(|i| s.values[5 * i + n][c]));
            }
        }
        s
    }

    /// Mean of `f` over the pixel [x, x+1) × [y, y+1).
    pub fn pixel_mean<const C: usize>(
        self,
        mut f: impl FnMut(f64, f64) -> [f64; C],
        (x, y): (f64, f64),
        limits: Limits,
        scratch: &mut Scratch<C>,
    ) -> PixelMean<C> {
        let Scratch { squares, queue } = scratch;
        squares.clear();
        queue.clear();
        let n = 1usize << limits.base;
        let side = 1.0 / n as f64;
        for j in 0..n {
            for i in 0..n {
                squares.push(self.assess(&mut f, (x + i as f64 * side, y + j as f64 * side, limits.base), None));
            }
        }
        let mut estimates = Estimates::new(squares, limits);
        let mut limited = false;
        if largest(estimates.total(limits.total)) > limits.tolerance {
            queue.extend(squares.iter().enumerate().map(|(index, s)| Worst { error: s.worst(), index }));
            while largest(estimates.total(limits.total)) > limits.tolerance {
                let Some(Worst { index, .. }) = queue.pop() else {
                    limited = true;
                    break;
                };
                let parent = squares[index];
                if parent.depth >= limits.depth {
                    continue;
                }
                estimates.remove(&parent);
                let half = 0.5 * parent.side();
                for q in 0..4 {
                    let (cx, cy) = (parent.x + half * (q & 1) as f64, parent.y + half * (q >> 1) as f64);
                    let child = self.assess(&mut f, (cx, cy, parent.depth + 1), Some((&parent, q)));
                    estimates.add(&child, limits);
                    let error = child.worst();
                    // The first quarter takes the parent's place, the others go to the end.
                    let at = if q == 0 { index } else { squares.len() };
                    if q == 0 {
                        squares[index] = child
                    } else {
                        squares.push(child)
                    }
                    queue.push(Worst { error, index: at });
                }
            }
        }
        PixelMean {
            value: sum(squares, |s| s.fine),
            error: Estimates::new(squares, limits).total(limits.total),
            limited,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { tolerance: 1e-6, base: 0, depth: 9, total: Total::Sum };

    /// A mean of one channel.
    #[derive(Debug)]
    struct Mean {
        value: f64,
        error: f64,
        limited: bool,
    }

    fn within(rule: Rule, limits: Limits, mut f: impl FnMut(f64, f64) -> f64) -> Mean {
        let m = rule.pixel_mean(|x, y| [f(x, y)], (3.0, 5.0), limits, &mut Scratch::default());
        Mean { value: m.value[0], error: m.error[0], limited: m.limited }
    }

    fn mean(rule: Rule, f: impl Fn(f64, f64) -> f64) -> (Mean, u32) {
        let mut calls = 0;
        let counted = |x, y| {
            calls += 1;
            f(x, y)
        };
        let result = within(rule, LIMITS, counted);
        (result, calls)
    }

    #[test]
    fn every_channel_meets_the_tolerance() {
        let peak = |x: f64, y: f64, k: f64| (-k * ((x - 3.3).powi(2) + (y - 5.6).powi(2))).exp();
        let f = |x: f64, y: f64| [1.0, peak(x, y, 40.0), (x - 3.17).max(0.0)];
        let m = Rule::Continuous.pixel_mean(f, (3.0, 5.0), LIMITS, &mut Scratch::default());
        let alone = mean(Rule::Continuous, |x, y| peak(x, y, 40.0)).0;
        assert!((m.value[0] - 1.0).abs() < 1e-14 && m.error[0] == 0.0, "{m:?}");
        assert!((m.value[1] - alone.value).abs() <= alone.error + m.error[1], "{m:?} {alone:?}");
        assert!((m.value[2] - 0.83f64.powi(2) / 2.0).abs() <= m.error[2] + 1e-9, "{m:?}");
        assert!(m.error.iter().all(|e| *e <= 1e-6) && !m.limited, "{m:?}");
    }

    #[test]
    fn cubics_are_integrated_exactly_and_quadratics_without_refinement() {
        for rule in [Rule::Continuous, Rule::Jumps] {
            // The inset moves the outermost points by a billionth.
            let (m, _) = mean(rule, |x, y| 1.0 + (x - 3.0).powi(3) * (y - 5.0).powi(3));
            assert!((m.value - 1.0625).abs() < 1e-8 && m.error <= 1e-6, "{m:?}");
            let (m, calls) = mean(rule, |x, y| 1.0 + (x - 3.0).powi(2) * (y - 5.0).powi(2));
            assert!((m.value - 10.0 / 9.0).abs() < 1e-8 && m.error < 1e-8, "{m:?}");
            assert_eq!(calls, 25);
        }
    }

    #[test]
    fn the_estimate_bounds_the_error_of_a_smooth_peak_and_of_a_kink() {
        for rule in [Rule::Continuous, Rule::Jumps] {
            let peak = |x: f64, y: f64| (-40.0 * ((x - 3.3).powi(2) + (y - 5.6).powi(2))).exp();
            let fine = within(rule, Limits { base: 6, ..LIMITS }, peak);
            let (m, _) = mean(rule, peak);
            assert!((m.value - fine.value).abs() <= m.error && m.error <= 1e-6, "{m:?} {fine:?}");
            for n in 1..100 {
                let k = f64::from(n) / 100.0;
                let (m, _) = mean(rule, |x, _| (x - 3.0 - k).max(0.0));
                assert!((m.value - (1.0 - k).powi(2) / 2.0).abs() <= m.error + 1e-9, "kink at {k}: {m:?}");
                assert!(m.error <= 1e-6);
            }
        }
    }

    #[test]
    fn a_jump_is_seen_wherever_it_is() {
        let (mut error, mut estimate) = (0.0, 0.0);
        for n in 1..200 {
            let edge = f64::from(n) / 200.0;
            let limits = Limits { depth: 5, ..LIMITS };
            let jump = |x: f64, _: f64| f64::from(u8::from(x - 3.0 >= edge));
            let m = within(Rule::Jumps, limits, jump);
            let e = m.value - (1.0 - edge);
            // Both rules can be off to the same side, so that the estimate of one jump is up to half too small.
            assert!(e.abs() <= 2.0 * m.error + 1e-8, "jump at {edge}: {m:?}");
            error += e * e;
            estimate += m.error * m.error;
        }
        assert!(error < estimate, "root mean squares {} and {}", error.sqrt(), estimate.sqrt());
    }

    #[test]
    fn a_jump_on_the_border_of_a_square_costs_nothing() {
        for edge in [0.0, 0.25, 0.5, 1.0] {
            let (m, _) = mean(Rule::Jumps, |x, _| f64::from(u8::from(x - 3.0 >= edge)));
            assert!((m.value - (1.0 - edge)).abs() < 1e-12 && m.error < 1e-12, "{m:?}");
        }
    }

    #[test]
    fn the_depth_limit_is_reported() {
        let (m, _) = mean(Rule::Jumps, |x, _| f64::from(u8::from(x >= 3.3)));
        assert!(m.limited && m.error > LIMITS.tolerance && m.error < 1e-3, "{m:?}");
    }
}
