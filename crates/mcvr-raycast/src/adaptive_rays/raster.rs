//! Values at the rays of one distance, known at some places and told from coarser ones elsewhere.

use std::ops::Range;

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

/// Rows of values from which the bends of a square are told: three beyond it on every side.
const ROWS: usize = SIDE + 6;

/// Values of each row: as many, and two more for whole vectors.
const COLUMNS: usize = ROWS + 2;

/// Bends that are told at once along a row.
const WIDE: usize = 8;

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
    /// For each quarter of a square the sum over its 2 by 2 values of the squares of fourth differences along both axes, each averaged over a
    /// neighbourhood of 3 by 3.
    fn bends_of_rows(rows: &[&[f64; COLUMNS]; ROWS]) -> [f64; 4] = bends_of_rows_body
}

#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "vector code wants plain loops")]
fn bends_of_rows_body(rows: &[&[f64; COLUMNS]; ROWS]) -> [f64; 4] {
    // Those that meet each of the 4 by 4 values around a quarter among the four neighbourhoods.
    const SHARES: [f64; 4] = [1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, 1.0 / 3.0];
    let mut sums = [[0.0; WIDE]; 2];
    for y in 0..SIDE + 2 {
        let [a, b, c, d, e] = [rows[y], rows[y + 1], rows[y + 2], rows[y + 3], rows[y + 4]];
        let mut squares = [0.0; WIDE];
        for x in 0..WIDE {
            let along = c[x] - 4.0 * c[x + 1] + 6.0 * c[x + 2] - 4.0 * c[x + 3] + c[x + 4];
            let down = a[x + 2] - 4.0 * b[x + 2] + 6.0 * c[x + 2] - 4.0 * d[x + 2] + e[x + 2];
            squares[x] = along * along + down * down;
        }
        // The lower quarters begin two values further down.
        for (n, sums) in sums.iter_mut().enumerate() {
            if (2 * n..2 * n + 4).contains(&y) {
                for x in 0..WIDE {
                    sums[x] += SHARES[y - 2 * n] * squares[x];
                }
            }
        }
    }
    let of = |n: usize| {
        let v = &sums[n / 2][2 * (n % 2)..][..4];
        (SHARES[0] * v[0] + SHARES[1] * v[1]) + (SHARES[2] * v[2] + SHARES[3] * v[3])
    };
    [of(0), of(1), of(2), of(3)]
}

/// Where a row has other values than 0.
fn lit(row: &[f64]) -> Range<usize> {
    let from = row.iter().position(|v| *v != 0.0).unwrap_or(row.len());
    from..row.iter().rposition(|v| *v != 0.0).map_or(from, |last| last + 1)
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
        // Most of many images is dark.
        let lit: Vec<Range<usize>> = self.values.chunks_exact(across.max(1)).map(lit).collect();
        out.values.par_chunks_mut(BAND * 2 * across).enumerate().for_each(|(band, rows)| {
            let mut column = vec![0.0; across + 4];
            for (n, out) in rows.chunks_exact_mut(2 * across).enumerate() {
                let y = band * BAND + n;
                let around = (y / 2).saturating_sub(2)..(y / 2 + 3).min(down);
                let spans = lit[around].iter().filter(|r| !r.is_empty()).cloned();
                let Some(span) = spans.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)) else { continue };
                // A value reaches two places along the row.
                let span = span.start.saturating_sub(2)..(span.end + 2).min(across);
                let from = |by: usize| {
                    let at = (y / 2 + by).checked_sub(2).filter(|at| *at < down);
                    at.map_or(&none[..], |at| &self.values[at * across..][..across])
                };
                let rows = [from(0), from(1), from(2), from(3), from(4)].map(|r| &r[span.clone()]);
                let (column, out) = (&mut column[..span.len() + 4], &mut out[2 * span.start..2 * span.end]);
                column[span.len() + 2..].fill(0.0);
                finer_row(level, rows, along[y % 2], along, column, out);
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

    /// Sums of squared fourth differences, along both axes, at and around the 2 by 2 values of the quarters of a square: the squares of half the
    /// distance, row by row.
    pub fn bends(&self, level: SimdLevel, at: Square) -> [f64; 4] {
        let [x, y] = at.map(|v| SIDE * v as usize);
        let inside = x >= 3 && x + COLUMNS <= self.across + 3 && y >= 3 && y + ROWS <= self.down() + 3;
        if !inside {
            return self.bends_at_rim(level, [x, y]);
        }
        let from = &self.values[(y - 3) * self.across + x - 3..];
        let mut rows = [&[0.0; COLUMNS]; ROWS];
        for (n, row) in rows.iter_mut().enumerate() {
            if let Some(values) = from[n * self.across..].first_chunk() {
                *row = values;
            }
        }
        bends_of_rows(level, &rows)
    }

    /// The same where a part of the values around is missing.
    fn bends_at_rim(&self, level: SimdLevel, [x, y]: [usize; 2]) -> [f64; 4] {
        let mut patch = [[0.0; COLUMNS]; ROWS];
        let (left, right) = (3usize.saturating_sub(x), COLUMNS.min(self.across + 3 - x));
        for (n, row) in patch.iter_mut().enumerate() {
            if let Some(from) =
                (y + n).checked_sub(3).and_then(|y| self.values.get(y * self.across..)?.get(..self.across))
            {
                row[left..right].copy_from_slice(&from[x + left - 3..x + right - 3]);
            }
        }
        bends_of_rows(level, &patch.each_ref())
    }

    /// Variance of rays around a square: mean over 3 by 3 squares.
    pub fn noise_around(&self, at: Square) -> f64 {
        let [x, y] = at.map(|v| v as usize);
        let stride = self.across / SIDE;
        let (first, last) = (x.saturating_sub(1), (x + 2).min(stride));
        let mut sum = 0.0;
        for row in y.saturating_sub(1)..(y + 2).min(self.noise.len() / stride) {
            for noise in &self.noise[row * stride + first..row * stride + last] {
                sum += noise;
            }
        }
        sum / 9.0
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

    /// The values at a square of half the distance, as [`Self::finer`] tells them.
    pub fn between(&self, at: Square) -> [f64; LANES] {
        let [left, top] = at.map(|v| SIDE / 2 * v as usize);
        let along = [basis(-0.25), basis(0.25)];
        let value = |x: usize, y: usize| {
            let (x, y) = (x.checked_sub(2)?, y.checked_sub(2)?);
            self.values.get(y * self.across..)?.get(..self.across)?.get(x).copied()
        };
        let mut values = [0.0; LANES];
        for (y, row) in values.chunks_exact_mut(SIDE).enumerate() {
            // The columns that the row's values are told from.
            let t = &along[y % 2];
            let column: [f64; SIDE / 2 + 4] = std::array::from_fn(|x| {
                let v: [f64; 5] = std::array::from_fn(|n| value(left + x, top + y / 2 + n).unwrap_or(0.0));
                t[2] * v[2] + (t[1] * v[1] + t[3] * v[3]) + (t[0] * v[0] + t[4] * v[4])
            });
            for (x, out) in row.iter_mut().enumerate() {
                let (t, v) = (&along[x % 2], &column[x / 2..]);
                *out = t[2] * v[2] + (t[1] * v[1] + t[3] * v[3]) + (t[0] * v[0] + t[4] * v[4]);
            }
        }
        values
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
        for at in [[0, 0], [3, 5], [11, 11], [0, 11]] {
            assert_eq!(coarse.between(at), fine.square(at), "{at:?}");
        }
        for y in 8..40 {
            for x in 8..40 {
                let told = fine.values[y * 48 + x];
                let is = value((x as f64 + 0.5) / 2.0 - 0.5, (y as f64 + 0.5) / 2.0 - 0.5);
                assert!((told - is).abs() < 1e-9 * is.abs().max(1.0), "{x},{y}: {told} {is}");
            }
        }
        for level in SimdLevel::available() {
            assert!(coarse.bends(level, [2, 3]).iter().all(|b| *b < 1e-15));
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
            let quarter = (candidate[1] % 2 * 2 + candidate[0] % 2) as usize;
            let of = |level| all.bends(level, candidate.map(|v| v / 2))[quarter];
            let told: Vec<f64> = SimdLevel::available().into_iter().map(of).collect();
            assert!(told.iter().all(|v| v.to_bits() == told[0].to_bits()));
            assert!((told[0] - sum).abs() < 1e-9 * sum, "{candidate:?}: {} {sum}", told[0]);
        }
    }

    #[test]
    fn squares_are_put_where_they_are_read() {
        let mut all = raster(16, |x, y| x + 100.0 * y);
        let values = std::array::from_fn(|l| -(l as f64));
        assert_eq!(all.square([1, 2])[5], 5.0 + 900.0);
        all.put([1, 2], &Seen { values, noise: 18.0 });
        assert_eq!(all.square([1, 2]), values);
        assert_eq!(all.sum_of_square([1, 2]), -120.0);
        assert_eq!((all.noise_at([1, 2]), all.noise_at([2, 1])), (18.0, 0.0));
        // The square, and those beside it.
        assert_eq!([[1, 2], [0, 3], [2, 1]].map(|at| all.noise_around(at)), [2.0; 3]);
        assert_eq!(all.noise_around([3, 2]), 0.0);
        let fine = all.finer();
        assert_eq!([[2, 4], [3, 5], [4, 4]].map(|at| fine.noise_at(at)), [18.0, 18.0, 0.0]);
    }
}
