//! The choice of a rank-1 lattice by the spectral test.
//!
//! A lattice of M points is `({k z_1/M}, {k z_2/M}, ...)`. With `z_1 = 1` it is sorted as it stands. Korobov's form
//! `z = (1, a, a², a³)` leaves one number to choose. The *spectral test* judges it: all points lie on parallel
//! hyperplanes, and the farthest apart of these are one over the shortest vector of the dual lattice
//! `{h : h·z ≡ 0 mod M}` apart. The shorter that vector, the more the points miss (Coveyou and MacPherson 1967; Knuth,
//! *The Art of Computer Programming*, vol. 2, section 3.3.4).

use mcvr_sampling::rng::mix;

/// Multipliers that are looked at for each number of points.
const CANDIDATES: u64 = 4096;

/// `(1, a, a², a³) mod M`.
pub(crate) fn korobov(multiplier: u64, samples: u64) -> [u64; 4] {
    let m = u128::from(samples);
    let mut z = [1 % m; 4];
    for j in 1..4 {
        z[j] = z[j - 1] * u128::from(multiplier) % m;
    }
    z.map(|z| z as u64)
}

/// The multiplier of largest [`merit`] among [`CANDIDATES`] pseudo-random ones, the first of equals, and its merit.
pub(crate) fn search(samples: u64) -> (u64, f64) {
    let mut best = (1, 0.0);
    for n in 0..CANDIDATES {
        let multiplier = mix(n.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(samples)) % samples;
        if coprime(multiplier, samples) {
            let merit = at_least(best.1, multiplier, samples);
            if merit > best.1 {
                best = (multiplier, merit);
            }
        }
    }
    best
}

fn coprime(mut a: u64, mut b: u64) -> bool {
    while b > 0 {
        (a, b) = (b, a % b);
    }
    a == 1
}

/// How good the lattice of a multiplier is, from 0 to 1: the shortest vector of the dual lattice over the length that
/// Hermite's constant allows it at best, the least of that over all projections onto two or more of the four coordinates
/// (Lemieux and L'Ecuyer, *Variance Reduction via Lattice Rules*, Management Science 46, 2000). A multiplier that has a
/// factor in common with the number of points is not allowed: its projections have fewer points.
pub fn merit(multiplier: u64, samples: u64) -> f64 {
    if coprime(multiplier, samples) { at_least(0.0, multiplier, samples) } else { 0.0 }
}

/// As [`merit`], but ends where that is seen to be less than `least`. Korobov's lattices project onto coordinates i, j, ... as
/// onto 1, j - i + 1, ..., so that projections with the first coordinate stand for all.
fn at_least(least: f64, multiplier: u64, samples: u64) -> f64 {
    /// Other coordinates of a projection, those that are cheap to judge first.
    const PROJECTIONS: [&[usize]; 7] = [&[1], &[2], &[3], &[1, 2], &[1, 3], &[2, 3], &[1, 2, 3]];
    /// Hermite's constants of 2, 3 and 4 dimensions: squares of the longest shortest vectors of lattices of determinant 1.
    const HERMITE: [f64; 3] = [1.154_700_538_379_251_5, 1.259_921_049_894_873_2, std::f64::consts::SQRT_2];
    let z = korobov(multiplier, samples);
    let mut worst: f64 = 1.0;
    for others in PROJECTIONS {
        let dimension = others.len() + 1;
        let best = HERMITE[dimension - 2].sqrt() * (samples as f64).powf(1.0 / dimension as f64);
        let shortest = dual(&z, others, samples)[0];
        worst = worst.min((dot(&shortest, &shortest) as f64).sqrt() / best);
        if worst < least {
            break;
        }
    }
    worst
}

type Vector = [i128; 4];

/// A reduced basis of the dual lattice of the projection onto the first and some `others` of the coordinates.
fn dual(z: &[u64; 4], others: &[usize], samples: u64) -> Vec<Vector> {
    let mut basis = vec![[0; 4]; others.len() + 1];
    basis[0][0] = i128::from(samples);
    for (b, &j) in basis[1..].iter_mut().zip(others) {
        b[0] = -i128::from(z[j]);
        b[j] = 1;
    }
    reduce(&mut basis);
    basis
}

fn dot(a: &Vector, b: &Vector) -> i128 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Makes a basis of at most four vectors as short as can be, the shortest vector of the lattice first: the greedy algorithm
/// of Nguyen and Stehlé (*Low-dimensional lattice basis reduction revisited*, 2009), which is exact up to four dimensions.
fn reduce(basis: &mut [Vector]) {
    if basis.len() < 2 {
        return;
    }
    loop {
        basis.sort_by_key(|b| dot(b, b));
        let Some((last, others)) = basis.split_last_mut() else { return };
        reduce(others);
        *last = remainder(others, last);
        if others.last().is_none_or(|o| dot(last, last) >= dot(o, o)) {
            return;
        }
    }
}

/// A vector less the nearest one of the lattice of a reduced basis of at most three. That has coefficients next to those
/// of the projection, rounded: in a reduced basis of up to three dimensions the Voronoi cell reaches no farther than 1.
fn remainder(basis: &[Vector], vector: &Vector) -> Vector {
    let centre = projection(basis, vector);
    let less = |coefficients: &[i128]| {
        let mut rest = *vector;
        for (b, c) in basis.iter().zip(coefficients) {
            rest.iter_mut().zip(b).for_each(|(r, b)| *r -= c * b);
        }
        rest
    };
    let around = (0..3usize.pow(basis.len() as u32)).map(|n| {
        let step = |i: usize| (n / 3usize.pow(i as u32) % 3) as i128 - 1;
        less(&(0..basis.len()).map(|i| centre[i] + step(i)).collect::<Vec<_>>())
    });
    around.chain([*vector]).min_by_key(|r| dot(r, r)).unwrap_or(*vector)
}

/// Coefficients of the projection of a vector onto the span of a basis, rounded: the normal equations by elimination.
fn projection(basis: &[Vector], vector: &Vector) -> [i128; 3] {
    let n = basis.len().min(3);
    let mut rows = [[0.0f64; 4]; 3];
    for i in 0..n {
        for j in 0..n {
            rows[i][j] = dot(&basis[i], &basis[j]) as f64;
        }
        rows[i][3] = dot(&basis[i], vector) as f64;
    }
    for i in 0..n {
        for j in 0..n {
            if i != j {
                let factor = rows[j][i] / rows[i][i];
                (i..4).for_each(|c| rows[j][c] -= factor * rows[i][c]);
            }
        }
    }
    std::array::from_fn(|i| if i < n { (rows[i][3] / rows[i][i]).round() as i128 } else { 0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Square of the shortest vector by trying all that are not longer than M^(1/2): every dual lattice here has one.
    fn brute_force(z: &[u64], samples: u64) -> i128 {
        let reach = 2 * (samples as f64).sqrt() as i128 + 1;
        let mut least = i128::MAX;
        let mut visit = |h: [i128; 4]| {
            let sum: i128 = h.iter().zip(z).map(|(h, z)| h * i128::from(*z)).sum();
            if h != [0; 4] && sum.rem_euclid(i128::from(samples)) == 0 {
                least = least.min(dot(&h, &h));
            }
        };
        // In more dimensions the shortest vector is shorter still.
        let reaches = [[0, 0], [12, 0], [12, 8]][z.len() - 2];
        for a in 0..=reach {
            for b in -reach..=reach {
                for c in -reaches[0]..=reaches[0] {
                    for d in -reaches[1]..=reaches[1] {
                        visit([a, b, c, d]);
                    }
                }
            }
        }
        least
    }

    #[test]
    fn the_shortest_vector_is_the_shortest() {
        for samples in [61u64, 128, 360] {
            for multiplier in (1..samples).step_by(7).filter(|a| coprime(*a, samples)) {
                let z = korobov(multiplier, samples);
                for dimension in 2..=4 {
                    let basis = dual(&z, &[1, 2, 3][..dimension - 1], samples);
                    let found = dot(&basis[0], &basis[0]);
                    assert_eq!(found, brute_force(&z[..dimension], samples), "{multiplier} of {samples}, {dimension}");
                    for b in &basis {
                        let sum: i128 = b.iter().zip(z).map(|(b, z)| b * i128::from(z)).sum();
                        assert_eq!(sum.rem_euclid(i128::from(samples)), 0, "in the dual lattice");
                    }
                }
            }
        }
    }

    /// RANDU, 65539 modulo 2^31, is bad because `9 - 6 a + a² = (a - 3)² = 2^32`: a vector of square length 118, which is the
    /// shortest of three dimensions in Knuth's table of section 3.3.4, as 116 is of four.
    #[test]
    fn the_famous_planes_of_randu_are_found() {
        let z = korobov(65539, 1 << 31);
        for (others, square) in [(&[1, 2][..], 118), (&[1, 2, 3], 116)] {
            let shortest = dual(&z, others, 1 << 31)[0];
            assert_eq!(dot(&shortest, &shortest), square, "{others:?} {shortest:?}");
        }
    }

    #[test]
    fn a_bad_multiplier_has_little_merit_and_common_factors_none() {
        assert!(merit(1, 1 << 20) < 2e-3 && merit(1025, 1 << 20) < 0.05);
        assert_eq!((merit(1024, 1 << 20), merit(6, 9)), (0.0, 0.0));
        assert!(merit(85477, 1 << 20) > 0.73);
    }
}
