//! Probabilities and masses against exact rational arithmetic.

use mcvr::sampling::{Distribution, VoxelOrder};
use num_rational::BigRational;
use proptest::prelude::*;

use crate::scenes::*;

fn exact(v: f64) -> BigRational {
    BigRational::from_float(v).unwrap()
}

fn whole(n: u64) -> BigRational {
    BigRational::from_integer(n.into())
}

fn two_to(k: i32) -> BigRational {
    exact(2f64.powi(k))
}

/// A small scan: every voxel of it is found by some sixty bisections.
fn small() -> impl Strategy<Value = Scan> {
    scan().prop_map(|s| Scan { dims: s.dims.map(|n| n.div_ceil(2)), ..s })
}

fn order() -> impl Strategy<Value = VoxelOrder> {
    prop::sample::select(VoxelOrder::ALL.map(|(_, order)| order).to_vec())
}

proptest! {
    #![proptest_config(config(96))]

    /// Whole weights are drawn with exactly their probability: `units / total = w / Σ w`.
    ///
    /// Others with `units = ⌊w s + 1/2⌋`, `s ≈ 2^62 / Σw`. The product and the sum round to 2^-53 each and the floor to 1/2:
    /// `units = w s (1 + 2 · 2^-53) + 1/2` at worst, so the total is off by `n/2 + 2^-52 s Σw`, and a probability by at most
    /// `(1/2 + p n/2) / total + 2 · 2^-52 p`, up to terms of second order, for which 2^-100 is added. (The rounding of s is common
    /// to all and cancels.)
    #[test]
    fn every_voxel_has_its_exact_probability(scan in small(), order in order()) {
        let density = scan.density();
        let d = Distribution::new(&density, order).unwrap();
        let n = density.volume().grid().len();
        let weights: Vec<BigRational> = (0..n).map(|i| exact(density.weight(i))).collect();
        let sum: BigRational = weights.iter().sum();
        let total = whole(d.total());
        let mut drawn = vec![0; n];
        units(&d).into_iter().for_each(|(voxel, units)| drawn[voxel] = units);
        for (w, units) in weights.iter().zip(drawn) {
            let p = w / &sum;
            let q = whole(units) / &total;
            let off = if p > q { &p - &q } else { q - &p };
            if scan.stored.is_whole() {
                prop_assert_eq!(off, whole(0));
            } else {
                let bound = (two_to(-1) + &p * whole(n as u64) * two_to(-1)) / &total + &p * two_to(-51) + two_to(-100);
                prop_assert!(off <= bound, "{} units of {}", units, d.total());
                prop_assert!(units == 0 || *w > whole(0), "a voxel of weight 0 is drawn");
            }
        }
    }

    /// The mass is `V Σ w` to rounding: a sum of n numbers of one sign in any grouping is off by at most `(n - 1) 2^-53` of itself,
    /// weights by table add one product each, and the volume and its product four roundings more (determinant apart:
    /// nine products and sums of numbers at most 1, 12 · 2^-53 absolute, and it is ±1).
    #[test]
    fn the_mass_is_the_exact_sum(scan in small()) {
        let density = scan.density();
        let grid = density.volume().grid();
        let values = scan.values();
        // The positive values themselves: the identity map's weights, found without the library.
        let sum: BigRational = values.iter().filter(|v| **v > 0.0).map(|v| exact(*v)).sum();
        let cell: BigRational = scan.spacing.iter().map(|h| exact(*h)).product();
        let mass = sum * cell;
        let found = exact(density.mass());
        let off = if found > mass { &found - &mass } else { &mass - &found };
        prop_assert!(off <= mass * whole(grid.len() as u64 + 20) * two_to(-53));
        prop_assert_eq!(density.report().positive, values.iter().filter(|v| **v > 0.0).count() as u64);
    }
}
