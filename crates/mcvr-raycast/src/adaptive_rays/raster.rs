//! Values at the rays of one distance, known at some places and told from coarser ones elsewhere.

use mcvr_volume::{SimdLevel, vectorised};
use rayon::prelude::*;

use crate::average::basis;
use crate::packet::{LANES, SIDE, Seen, Square};

/// Rows of values.
pub(super) struct Raster {
    pub across: usize,
    pub values: Vec<f64>,
    /// For every square of values, the variance of each of its rays.
    noise: Vec<f64>,
}

/// Rows that are made together.
const BAND: usize = 16;

/// Values around the 2 by 2 of a candidate from which its bend is told: three on every side.
const PATCH: usize = 8;

vectorised! {
    /// A row of values at twice the distance's places along the row, from five rows of values around it.
    fn finer_row(rows: [&[f64]; 5], down: [f64; 5], along: [[f64; 5]; 2], column: &mut [f64], out: &mut [f64]) = finer_row_body
}

#[inline(always)]
fn finer_row_body(rows: [&[f64]; 5], down: [f64; 5], along: [[f64; 5]; 2], column: &mut [f64], out: &mut [f64]) {
    let across = column.len() - 4;
    let [a, b, c, d, e] = rows.map(|r| &r[..across]);
    let inner = &mut column[2..across + 2];
    for x in 0..across {
        inner[x] = down[2] * c[x] + (down[1] * b[x] + down[3] * d[x]) + (down[0] * a[x] + down[4] * e[x]);
    }
    let out = &mut out[..2 * across];
    let v = &column[..across + 4];
    for x in 0..across {
        for (n, t) in along.iter().enumerate() {
            out[2 * x + n] = t[2] * v[x + 2] + (t[1] * v[x + 1] + t[3] * v[x + 3]) + (t[0] * v[x] + t[4] * v[x + 4]);
        }
    }
}

vectorised! {
    /// Sum over the middle 2 by 2 of a patch of the squares of fourth differences along both axes, each averaged over a neighbourhood of 3 by 3.
    fn bend_of_patch(patch: &[[f64; PATCH]; PATCH]) -> f64 = bend_of_patch_body
}

#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "vector code wants plain loops")]
fn bend_of_patch_body(patch: &[[f64; PATCH]; PATCH]) -> f64 {
    // Those that meet each of the 4 by 4 values around the middle among the four neighbourhoods.
    const SHARES: [f64; 4] = [1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, 1.0 / 3.0];
    let mut sum = [0.0; 4];
    for y in 0..4 {
        for x in 0..4 {
            let (row, column) = (&patch[y + 2], x + 2);
            let along =
                row[column - 2] - 4.0 * row[column - 1] + 6.0 * row[column] - 4.0 * row[column + 1] + row[column + 2];
            let down = patch[y][column] - 4.0 * patch[y + 1][column] + 6.0 * patch[y + 2][column]
                - 4.0 * patch[y + 3][column]
                + patch[y + 4][column];
            sum[x] += SHARES[y] * (along * along + down * down);
        }
    }
    (SHARES[0] * sum[0] + SHARES[1] * sum[1]) + (SHARES[2] * sum[2] + SHARES[3] * sum[3])
}

impl Raster {
    pub fn zeros([across, down]: [usize; 2]) -> Self {
        Self { across, values: vec![0.0; across * down], noise: vec![0.0; across / SIDE * (down / SIDE)] }
    }

    fn down(&self) -> usize {
        self.values.len() / self.across.max(1)
    }

    /// Values at half the distance: those of the polynomials through five values along each axis. Beyond the rim there is 0.
    pub fn finer(&self) -> Self {
        let (across, down) = (self.across, self.down());
        let along = [basis(-0.25), basis(0.25)];
        let mut out = Self::zeros([2 * across, 2 * down]);
        let (level, none) = (SimdLevel::detect(), vec![0.0; across]);
        out.values.par_chunks_mut(BAND * 2 * across).enumerate().for_each(|(band, rows)| {
            let mut column = vec![0.0; across + 4];
            for (n, out) in rows.chunks_exact_mut(2 * across).enumerate() {
                let y = band * BAND + n;
                let from = |by: usize| {
                    let at = (y / 2 + by).checked_sub(2).filter(|at| *at < down);
                    at.map_or(&none[..], |at| &self.values[at * across..][..across])
                };
                let rows = [from(0), from(1), from(2), from(3), from(4)];
                // Most of many images is dark.
                if rows.iter().all(|r| r.iter().all(|v| *v == 0.0)) {
                    continue;
                }
                finer_row(level, rows, along[y % 2], along, &mut column, out);
            }
        });
        let (stride, coarse) = (2 * across / SIDE, across / SIDE);
        if stride > 0 {
            for (y, row) in out.noise.chunks_exact_mut(stride).enumerate() {
                let from = &self.noise[y / 2 * coarse..][..coarse];
                row.chunks_exact_mut(2).zip(from).for_each(|(out, noise)| out.fill(*noise));
            }
        }
        out
    }

    /// Sum of squared fourth differences, along both axes, at the 2 by 2 values of a square of half the distance, and around them.
    pub fn bend(&self, level: SimdLevel, at: Square) -> f64 {
        let mut patch = [[0.0; PATCH]; PATCH];
        let [x, y] = at.map(|v| 2 * v as usize);
        let (left, right) = (3usize.saturating_sub(x), PATCH.min(self.across + 3 - x));
        for (n, row) in patch.iter_mut().enumerate() {
            if let Some(from) =
                (y + n).checked_sub(3).and_then(|y| self.values.get(y * self.across..)?.get(..self.across))
            {
                row[left..right].copy_from_slice(&from[x + left - 3..x + right - 3]);
            }
        }
        bend_of_patch(level, &patch)
    }

    /// Variance of rays around a square of half the distance: mean over 3 by 3 squares.
    pub fn noise_around(&self, at: Square) -> f64 {
        let [x, y] = at.map(|v| v as usize / 2);
        let stride = self.across / SIDE;
        let rows = y.saturating_sub(1)..(y + 2).min(self.noise.len() / stride);
        let columns = x.saturating_sub(1)..(x + 2).min(stride);
        rows.map(|y| self.noise[y * stride..][columns.clone()].iter().sum::<f64>()).sum::<f64>() / 9.0
    }

    /// Multiplies all variances.
    pub fn scale_noise(&mut self, by: f64) {
        self.noise.iter_mut().for_each(|v| *v *= by);
    }

    /// The same of the rays at a square.
    pub fn noise_at(&self, [x, y]: Square) -> f64 {
        self.noise[y as usize * (self.across / SIDE) + x as usize]
    }

    /// Sum of the second differences along both axes; 0 at the rim.
    pub fn curvature(&self, x: usize, y: usize) -> f64 {
        if x == 0 || y == 0 || x + 1 >= self.across || y + 1 >= self.down() {
            return 0.0;
        }
        let at = |x: usize, y: usize| self.values[y * self.across + x];
        (at(x - 1, y) + at(x + 1, y)) + (at(x, y - 1) + at(x, y + 1)) - 4.0 * at(x, y)
    }

    /// Puts in place what a square's rays saw.
    pub fn put(&mut self, at: Square, Seen { values, noise }: &Seen) {
        let stride = self.across / SIDE;
        self.noise[at[1] as usize * stride + at[0] as usize] = *noise;
        let [x, y] = at.map(|v| SIDE * v as usize);
        for (n, row) in values.chunks_exact(SIDE).enumerate() {
            self.values[(y + n) * self.across + x..][..SIDE].copy_from_slice(row);
        }
    }

    /// A square's values.
    pub fn square(&self, at: Square) -> [f64; LANES] {
        let [x, y] = at.map(|v| SIDE * v as usize);
        let mut values = [0.0; LANES];
        for (n, row) in values.chunks_exact_mut(SIDE).enumerate() {
            row.copy_from_slice(&self.values[(y + n) * self.across + x..][..SIDE]);
        }
        values
    }

    /// Their sum.
    pub fn sum_of_square(&self, at: Square) -> f64 {
        self.square(at).iter().sum()
    }

    /// Sum of the squared differences between a square's values and those that are in place.
    pub fn difference(&self, at: Square, values: &[f64; LANES]) -> f64 {
        let [x, y] = at.map(|v| SIDE * v as usize);
        let rows = values.chunks_exact(SIDE).enumerate();
        let row = |(n, row): (usize, &[f64])| {
            let own = &self.values[(y + n) * self.across + x..][..SIDE];
            own.iter().zip(row).map(|(a, b)| (a - b) * (a - b)).sum::<f64>()
        };
        rows.map(row).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raster(side: usize, value: impl Fn(f64, f64) -> f64) -> Raster {
        let values = (0..side * side).map(|n| value((n % side) as f64, (n / side) as f64)).collect();
        Raster { values, ..Raster::zeros([side; 2]) }
    }

    #[test]
    fn polynomials_are_told_exactly_between_values_and_do_not_bend() {
        let value = |x: f64, y: f64| 3.0 + x - 0.2 * x * y + 1e-2 * x.powi(3) * y.powi(3);
        let coarse = raster(24, value);
        let fine = coarse.finer();
        for y in 8..40 {
            for x in 8..40 {
                let told = fine.values[y * 48 + x];
                let is = value((x as f64 + 0.5) / 2.0 - 0.5, (y as f64 + 0.5) / 2.0 - 0.5);
                assert!((told - is).abs() < 1e-9 * is.abs().max(1.0), "{x},{y}: {told} {is}");
            }
        }
        for level in SimdLevel::available() {
            assert!(coarse.bend(level, [5, 6]) < 1e-15);
        }
        // Second differences of a cubic in each.
        assert!((raster(9, |x, y| x * x + 2.0 * y * y).curvature(4, 4) - 6.0).abs() < 1e-12);
        assert_eq!(coarse.curvature(0, 3), 0.0);
    }

    /// The sum over a neighbourhood of squares, by its definition, at the rim too.
    #[test]
    fn bends_are_those_of_the_neighbourhood() {
        let all = raster(12, |x, y| ((x * 7.0 + y * 13.0) % 5.0) - 2.0);
        let at = |x: isize, y: isize| {
            let inside = |v: isize| (0..12).contains(&v);
            if inside(x) && inside(y) { all.values[(y * 12 + x) as usize] } else { 0.0 }
        };
        let square = |x: isize, y: isize| {
            let d = |f: &dyn Fn(isize) -> f64| (f(-2) - 4.0 * f(-1) + 6.0 * f(0) - 4.0 * f(1) + f(2)).powi(2);
            d(&|n| at(x + n, y)) + d(&|n| at(x, y + n))
        };
        for candidate in [[0, 0], [2, 3], [5, 5], [0, 5]] {
            let [x, y] = candidate.map(|v: u32| 2 * v as isize);
            let mut sum = 0.0;
            for (px, py) in [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)] {
                for n in 0..9 {
                    sum += square(px + n % 3 - 1, py + n / 3 - 1) / 9.0;
                }
            }
            let told: Vec<f64> = SimdLevel::available().into_iter().map(|l| all.bend(l, candidate)).collect();
            assert!(told.iter().all(|v| v.to_bits() == told[0].to_bits()));
            assert!((told[0] - sum).abs() < 1e-9 * sum, "{candidate:?}: {} {sum}", told[0]);
        }
    }

    #[test]
    fn squares_are_put_where_they_are_read() {
        let mut all = raster(16, |x, y| x + 100.0 * y);
        let values = std::array::from_fn(|l| -(l as f64));
        assert_eq!(all.square([1, 2])[5], 5.0 + 900.0);
        let before: f64 = all.square([1, 2]).iter().zip(values).map(|(a, b)| (a - b) * (a - b)).sum();
        assert_eq!(all.difference([1, 2], &values), before);
        all.put([1, 2], &Seen { values, noise: 18.0 });
        assert_eq!(all.square([1, 2]), values);
        assert_eq!(all.sum_of_square([1, 2]), -120.0);
        assert_eq!((all.noise_at([1, 2]), all.noise_at([2, 1])), (18.0, 0.0));
        // The squares of half the distance in a square, and those beside it.
        assert_eq!([[3, 4], [1, 7], [4, 2]].map(|at| all.noise_around(at)), [2.0; 3]);
        assert_eq!(all.noise_around([6, 4]), 0.0);
        let fine = all.finer();
        assert_eq!([[2, 4], [3, 5], [4, 4]].map(|at| fine.noise_at(at)), [18.0, 18.0, 0.0]);
    }
}
