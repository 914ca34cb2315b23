//! Where a march's rays pass through a pixel.

use rand::Rng;
use rand_pcg::Pcg64Dxsm;

/// Points in the unit square, one per ray.
pub(crate) struct Pattern {
    columns: u32,
    rows: u32,
    jitter: bool,
}

impl Pattern {
    /// Strata in the most nearly square arrangement: `columns × rows = rays` with `columns ≥ rows`. Centres of
    /// the strata are used for square numbers unless `jitter` asks for random points; other numbers above 1 are
    /// always jittered, since a lopsided grid of centres would favour one direction.
    pub fn new(rays: u32, jitter: bool) -> Self {
        let rows = (1..=rays.isqrt()).rev().find(|r| rays.is_multiple_of(*r)).unwrap_or(1);
        let columns = rays / rows;
        Self { columns, rows, jitter: jitter || columns != rows }
    }

    /// Calls `f` with each point, stratum by stratum.
    pub fn for_each(&self, random: &mut Pcg64Dxsm, mut f: impl FnMut(f64, f64)) {
        let mut within = || if self.jitter { unit(random.next_u64()) } else { 0.5 };
        for r in 0..self.rows {
            for c in 0..self.columns {
                let (x, y) = (within(), within());
                f((f64::from(c) + x) / f64::from(self.columns), (f64::from(r) + y) / f64::from(self.rows));
            }
        }
    }
}

/// The random numbers of one image row: keyed by seed and row, never by thread.
pub(crate) fn random_of_row(seed: u64, row: usize) -> Pcg64Dxsm {
    Pcg64Dxsm::new(u128::from(seed), row as u128)
}

/// The top 52 bits as the middle of their interval of width 2^-52: in (0, 1), exactly.
fn unit(bits: u64) -> f64 {
    ((bits >> 12) as f64 + 0.5) * (0.5f64).powi(52)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(rays: u32, jitter: bool) -> Vec<(f64, f64)> {
        let mut all = vec![];
        Pattern::new(rays, jitter).for_each(&mut random_of_row(1, 2), |x, y| all.push((x, y)));
        all
    }

    #[test]
    fn one_ray_is_the_centre_and_square_numbers_are_a_grid_of_centres() {
        assert_eq!(points(1, false), [(0.5, 0.5)]);
        assert_eq!(points(4, false), [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]);
    }

    #[test]
    fn jittered_points_hold_one_per_stratum() {
        for (rays, columns, rows) in [(1, 1, 1), (2, 2, 1), (6, 3, 2), (7, 7, 1), (16, 4, 4)] {
            let all = points(rays, true);
            let mut strata: Vec<_> =
                all.iter().map(|p| ((p.0 * f64::from(columns)) as u32, (p.1 * f64::from(rows)) as u32)).collect();
            strata.sort_unstable();
            strata.dedup();
            assert_eq!((all.len(), strata.len()), (rays as usize, rays as usize));
        }
    }
}
