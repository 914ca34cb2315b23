//! Adaptive integration along a line by nested rules of 3, 7 and 15 points.
//!
//! Gauss's three points, Kronrod's seven that contain them (degree 11), Patterson's fifteen that contain those (degree
//! 23): T. Patterson, *The optimum addition of points to quadrature formulae*, Mathematics of Computation 22, 1968. The
//! difference of two rules estimates the error of the better one, amply.
//!
//! Except by accident: refinement *selects* pieces whose estimate is small, and near a kink or a jump two rules can agree
//! on a wrong result. So the estimate is the larger of the difference and an odd null rule, as in
//! [`cubature`](crate::cubature). A kink between an end and the outermost point would still go unseen; integrands tell
//! the kinks they know, which are then cut out first.

/// Points evaluated at once: whole vectors, whatever their width.
pub(crate) const LANES: usize = 8;

/// Kronrod's seven points; the eighth lane has weight 0.
const SEVEN: [f64; LANES] = [
    -0.960_491_268_708_020_3,
    -0.774_596_669_241_483_4,
    -0.434_243_749_346_802_6,
    0.0,
    0.434_243_749_346_802_6,
    0.774_596_669_241_483_4,
    0.960_491_268_708_020_3,
    0.0,
];
const THREE_WEIGHTS: [f64; LANES] = [0.0, 5.0 / 9.0, 0.0, 8.0 / 9.0, 0.0, 5.0 / 9.0, 0.0, 0.0];
const SEVEN_WEIGHTS: [f64; LANES] = [
    0.104_656_226_026_467_27,
    0.268_488_089_868_333_44,
    0.401_397_414_775_962_2,
    0.450_916_538_658_474_14,
    0.401_397_414_775_962_2,
    0.268_488_089_868_333_44,
    0.104_656_226_026_467_27,
    0.0,
];
/// Weights of the same seven points among the fifteen, and the eight points that come in.
const FIFTEEN_OLD: [f64; LANES] = [
    0.051_603_282_997_079_74,
    0.134_415_255_243_784_22,
    0.200_628_529_376_989_02,
    0.225_510_499_798_206_7,
    0.200_628_529_376_989_02,
    0.134_415_255_243_784_22,
    0.051_603_282_997_079_74,
    0.0,
];
const EIGHT: [f64; LANES] = [
    -0.993_831_963_212_755,
    -0.888_459_232_872_257,
    -0.621_102_946_737_226_4,
    -0.223_386_686_428_966_9,
    0.223_386_686_428_966_9,
    0.621_102_946_737_226_4,
    0.888_459_232_872_257,
    0.993_831_963_212_755,
];
const EIGHT_WEIGHTS: [f64; LANES] = [
    0.017_001_719_629_940_26,
    0.092_927_195_315_124_54,
    0.171_511_909_136_391_4,
    0.219_156_858_401_587_5,
    0.219_156_858_401_587_5,
    0.171_511_909_136_391_4,
    0.092_927_195_315_124_54,
    0.017_001_719_629_940_26,
];

/// Odd null rules of the fourth degree on the seven points and of the twelfth on the fifteen, of the same norms as
/// the differences of the rules.
const ODD_SEVEN: [f64; LANES] = [
    -0.198_417_263_059_628_9,
    0.438_915_142_462_158_1,
    -0.344_055_979_909_577_1,
    0.0,
    0.344_055_979_909_577_1,
    -0.438_915_142_462_158_1,
    0.198_417_263_059_628_9,
    0.0,
];
const ODD_OLD: [f64; LANES] = [
    0.193_830_950_863_022_6,
    0.201_449_173_097_630_23,
    0.104_063_648_858_361_26,
    0.0,
    -0.104_063_648_858_361_26,
    -0.201_449_173_097_630_23,
    -0.193_830_950_863_022_6,
    0.0,
];
const ODD_NEW: [f64; LANES] = [
    -0.079_755_590_152_477_61,
    -0.224_836_059_976_716_3,
    -0.155_894_764_466_106_43,
    -0.051_729_840_975_339_36,
    0.051_729_840_975_339_36,
    0.155_894_764_466_106_43,
    0.224_836_059_976_716_3,
    0.079_755_590_152_477_61,
];

/// Narrowest interval: below it a jump is taken as it comes, its error reported.
const NARROWEST: f64 = 1.0 / (1u64 << 30) as f64;
/// Relative size of an error that is nothing but rounding.
const ROUNDING: f64 = 1e-14;

/// What is integrated over `x`.
pub(crate) trait Along<const C: usize> {
    /// Values at some points.
    fn at(&self, x: &[f64; LANES]) -> [[f64; LANES]; C];

    /// A place between `a` and `b` where the integrand has a kink, if one is known.
    fn kink(&self, a: f64, b: f64) -> Option<f64>;
}

/// Sums and error estimates on the way along a ray.
pub(crate) struct Tally<const C: usize> {
    pub sum: [f64; C],
    pub error: [f64; C],
    /// Points at which the integrand was evaluated.
    pub points: u64,
}

#[inline(always)]
fn dot<const C: usize>(weights: &[f64; LANES], values: &[[f64; LANES]; C]) -> [f64; C] {
    values.map(|v| v.iter().zip(weights).map(|(v, w)| v * w).sum())
}

#[inline(always)]
fn largest<const C: usize>(v: [f64; C]) -> f64 {
    v.into_iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// How good an integral must be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Aim {
    /// The integrand is a polynomial of this degree: one rule is exact.
    Polynomial(u32),
    /// The errors of all pieces together should not exceed this (in the integral's unit), as far as the ray has got.
    Error(f64),
}

/// Adds `scale ∫ f dx` over [a, b].
#[inline(always)]
pub(crate) fn integrate<const C: usize, F: Along<C>>(
    f: &F,
    (a, b): (f64, f64),
    scale: f64,
    aim: Aim,
    tally: &mut Tally<C>,
) {
    let budget = match aim {
        Aim::Error(budget) => budget,
        Aim::Polynomial(_) => f64::INFINITY,
    };
    // A tolerance that has been used up must not keep the rest of the ray from ending.
    let least = 1e-3 * (budget - largest(tally.error)).max(1e-3 * budget);
    // Left to right; the pieces still to be done wait on the stack. Each is a part of the one below.
    let mut waiting = [0.0; 64];
    let mut depth = 1;
    waiting[0] = b;
    let mut from = a;
    while depth > 0 {
        let to = waiting[depth - 1];
        // Known kinks are cut out before the rules can overlook them.
        if let (Aim::Error(_), Some(kink), true) = (aim, f.kink(from, to), depth < waiting.len()) {
            waiting[depth] = kink;
            depth += 1;
            continue;
        }
        let (m, h) = (0.5 * (from + to), 0.5 * (to - from));
        let place = |x: &[f64; LANES]| x.map(|x| m + h * x);
        let weigh = |v: [f64; C]| v.map(|v| v * (h * scale));
        let first = f.at(&place(&SEVEN));
        tally.points += 7;
        let mut value = weigh(dot(&SEVEN_WEIGHTS, &first));
        let mut error = [0.0; C];
        let narrow = to - from <= NARROWEST || depth == waiting.len();
        let done = match aim {
            Aim::Polynomial(degree) => {
                if degree > 11 {
                    let (old, new) = (dot(&FIFTEEN_OLD, &first), dot(&EIGHT_WEIGHTS, &f.at(&place(&EIGHT))));
                    tally.points += 8;
                    value = weigh(std::array::from_fn(|c| old[c] + new[c]));
                }
                true
            }
            Aim::Error(_) => {
                let allowed = (0.5 * (budget - largest(tally.error))).max(least);
                let (coarse, odd) = (weigh(dot(&THREE_WEIGHTS, &first)), weigh(dot(&ODD_SEVEN, &first)));
                error = std::array::from_fn(|c| (value[c] - coarse[c]).abs().max(odd[c].abs()));
                let mut good = largest(error) <= allowed.max(ROUNDING * largest(value));
                if !good {
                    let second = f.at(&place(&EIGHT));
                    tally.points += 8;
                    let both = |old, new| -> [f64; C] {
                        let (old, new) = (dot(old, &first), dot(new, &second));
                        weigh(std::array::from_fn(|c| old[c] + new[c]))
                    };
                    let (fine, odd) = (both(&FIFTEEN_OLD, &EIGHT_WEIGHTS), both(&ODD_OLD, &ODD_NEW));
                    error = std::array::from_fn(|c| (fine[c] - value[c]).abs().max(odd[c].abs()));
                    value = fine;
                    good = largest(error) <= allowed.max(ROUNDING * largest(value));
                }
                good || narrow
            }
        };
        if done {
            for c in 0..C {
                tally.sum[c] += value[c];
                tally.error[c] += error[c];
            }
            from = to;
            depth -= 1;
        } else {
            waiting[depth] = m;
            depth += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Function<F>(F, Option<f64>);

    impl<F: Fn(f64) -> f64> Along<1> for Function<F> {
        fn at(&self, x: &[f64; LANES]) -> [[f64; LANES]; 1] {
            [x.map(&self.0)]
        }

        fn kink(&self, a: f64, b: f64) -> Option<f64> {
            self.1.filter(|k| a < *k && *k < b)
        }
    }

    fn run(f: impl Fn(f64) -> f64, kink: Option<f64>, aim: Aim) -> Tally<1> {
        let mut tally = Tally { sum: [0.0], error: [0.0], points: 0 };
        integrate(&Function(f, kink), (-1.0, 1.0), 1.0, aim, &mut tally);
        tally
    }

    #[test]
    fn the_rules_have_their_degrees() {
        for degree in 0..=23u32 {
            let exact = if degree % 2 == 0 { 2.0 / f64::from(degree + 1) } else { 0.0 };
            let t = run(|x| x.powi(degree as i32), None, Aim::Polynomial(degree));
            assert!((t.sum[0] - exact).abs() < 1e-15, "degree {degree}: {}", t.sum[0] - exact);
            assert_eq!((t.points, t.error[0]), (if degree > 11 { 15 } else { 7 }, 0.0));
        }
        // Not by accident: one degree more is missed.
        let t = run(|x| x.powi(12), None, Aim::Polynomial(11));
        assert!((t.sum[0] - 2.0 / 13.0).abs() > 1e-5);
        let t = run(|x| x.powi(24), None, Aim::Polynomial(23));
        assert!((t.sum[0] - 2.0 / 25.0).abs() > 1e-9);
    }

    #[test]
    fn the_error_estimate_bounds_the_error_and_meets_the_aim() {
        for tolerance in [1e-2, 1e-4, 1e-6, 1e-8] {
            for n in 1..400 {
                let k = f64::from(n) / 200.0 - 1.0 + 0.0003;
                let check = |what: &str, t: Tally<1>, exact: f64| {
                    let e = (t.sum[0] - exact).abs();
                    assert!(e <= t.error[0] + 1e-10 && t.error[0] <= tolerance, "{what} {k}: {e} {}", t.error[0]);
                };
                let (kink, jump) = (|x: f64| (x - k).max(0.0), |x: f64| f64::from(u8::from(x > k)));
                check("kink", run(kink, Some(k), Aim::Error(tolerance)), 0.5 * (1.0 - k).powi(2));
                check("jump", run(jump, Some(k), Aim::Error(tolerance)), 1.0 - k);
                let peak = 100.0 * (((1.0 - k) * 100.0).atan() + ((1.0 + k) * 100.0).atan());
                check("peak", run(|x| 1.0 / ((x - k).powi(2) + 1e-4), None, Aim::Error(tolerance)), peak);
            }
        }
    }

    #[test]
    fn a_known_kink_saves_the_halving() {
        let blind = run(|x| (x - 0.2).max(0.0), None, Aim::Error(1e-9));
        let told = run(|x| (x - 0.2).max(0.0), Some(0.2), Aim::Error(1e-9));
        assert!(told.points <= 45 && blind.points > 3 * told.points, "{} {}", told.points, blind.points);
        assert!((told.sum[0] - 0.32).abs() < 1e-14);
    }
}
