//! Polynomials with rational coefficients, and a kernel's field along a ray as one per cell: all exact.

use mcvr::scene::Kernel;
use num_rational::BigRational;

pub type Q = BigRational;

pub fn q(v: f64) -> Q {
    Q::from_float(v).unwrap()
}

fn ratio(a: i64, b: i64) -> Q {
    Q::new(a.into(), b.into())
}

/// By rising powers.
#[derive(Clone)]
struct Polynomial(Vec<Q>);

impl Polynomial {
    fn times(&self, other: &Self) -> Self {
        let mut out = vec![q(0.0); self.0.len() + other.0.len() - 1];
        for (i, a) in self.0.iter().enumerate() {
            for (j, b) in other.0.iter().enumerate() {
                out[i + j] += a * b;
            }
        }
        Self(out)
    }

    fn plus(&self, other: &Self) -> Self {
        let at = |p: &Self, i: usize| p.0.get(i).cloned().unwrap_or_else(|| q(0.0));
        Self((0..self.0.len().max(other.0.len())).map(|i| at(self, i) + at(other, i)).collect())
    }

    fn scaled(&self, by: &Q) -> Self {
        Self(self.0.iter().map(|c| c * by).collect())
    }

    /// This polynomial of another.
    fn of(&self, inner: &Self) -> Self {
        let zero = Self(vec![q(0.0)]);
        self.0.iter().rev().fold(zero, |sum, c| sum.times(inner).plus(&Self(vec![c.clone()])))
    }

    fn integral(&self, from: &Q, to: &Q) -> Q {
        let (mut a, mut b, mut sum) = (from.clone(), to.clone(), q(0.0));
        for (n, c) in self.0.iter().enumerate() {
            sum += c * (&b - &a) * ratio(1, n as i64 + 1);
            a *= from;
            b *= to;
        }
        sum
    }
}

/// The kernel of |x| = y where y is about `near`, as a polynomial in y; `None` outside its support.
fn kernel(kernel: Kernel, near: &Q) -> Option<Polynomial> {
    let below = |limit: i64| *near < ratio(limit, 2);
    let c = |coefficients: &[(i64, i64)]| Some(Polynomial(coefficients.iter().map(|(a, b)| ratio(*a, *b)).collect()));
    match kernel {
        Kernel::Box if below(1) => c(&[(1, 1)]),
        Kernel::Tent if below(2) => c(&[(1, 1), (-1, 1)]),
        Kernel::Bspline3 if below(2) => c(&[(2, 3), (0, 1), (-1, 1), (1, 2)]),
        Kernel::Bspline3 if below(4) => c(&[(8, 6), (-12, 6), (6, 6), (-1, 6)]),
        _ => None,
    }
}

/// A ray `o + t d` in voxels, from `start` on where there is one, its integrand times `t²` where `squared`.
#[derive(Debug)]
pub struct ExactRay {
    pub o: [Q; 3],
    pub d: [Q; 3],
    pub start: Option<Q>,
    pub squared: bool,
}

/// `∫ Σ w K(o + t d − i) dt` along a ray.
pub fn line_integral(k: Kernel, dims: [usize; 3], weights: &[Q], ray: &ExactRay) -> Q {
    let ExactRay { o, d, start, squared } = ray;
    let zero = q(0.0);
    let abs = |v: Q| if v < zero { -v } else { v };
    // Where the field may change its polynomial, in half voxels: on faces for box, at centres for the others.
    let odd = i64::from(k == Kernel::Box);
    let halves = |a: usize| (-2 - odd..=dims[a] as i64 + 2).map(move |i| 2 * i + odd);
    let mut ends: Vec<Q> = (0..3)
        .filter(|&a| d[a] != zero)
        .flat_map(|a| halves(a).map(move |h| (a, h)))
        .map(|(a, h)| (ratio(h, 2) - &o[a]) / &d[a])
        .chain(start.clone())
        .filter(|t| start.as_ref().is_none_or(|s| t >= s))
        .collect();
    ends.sort();
    ends.dedup();
    let mut sum = zero.clone();
    for pair in ends.windows(2) {
        let (from, to) = (&pair[0], &pair[1]);
        let middle = (from + to) * ratio(1, 2);
        // Voxels in reach on each axis, with their kernels as polynomials of t.
        let reach: [Vec<(usize, Polynomial)>; 3] = std::array::from_fn(|a| {
            let at = &o[a] + &d[a] * &middle;
            let each = |i: usize| {
                let x = &at - Q::from_integer(i.into());
                let sign = ratio(if x < zero { -1 } else { 1 }, 1);
                let y = Polynomial(vec![(&o[a] - Q::from_integer(i.into())) * &sign, &d[a] * &sign]);
                kernel(k, &abs(x)).map(|p| (i, p.of(&y)))
            };
            (0..dims[a]).filter_map(each).collect()
        });
        let [xs, ys, zs] = &reach;
        let one = if *squared { Polynomial([0.0, 0.0, 1.0].map(q).to_vec()) } else { Polynomial(vec![q(1.0)]) };
        for (z, pz) in zs {
            let mut plane = Polynomial(vec![zero.clone()]);
            for (y, py) in ys {
                let mut row = Polynomial(vec![zero.clone()]);
                for (x, px) in xs {
                    row = row.plus(&px.scaled(&weights[x + dims[0] * (y + dims[1] * z)]));
                }
                plane = plane.plus(&row.times(py));
            }
            sum += plane.times(pz).times(&one).integral(from, to);
        }
    }
    sum
}

/// The nearest double.
pub fn to_f64(v: &Q) -> f64 {
    num_traits::ToPrimitive::to_f64(v).unwrap()
}
