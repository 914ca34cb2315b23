//! The shapes of footprints, tabulated.

use crate::footprint::{Footprint, Projection};

/// Offsets below a pixel of the separable footprint, and its widths.
const OFFSETS: usize = 64;
const WIDTHS: usize = 64;

/// Points along each axis that stand for a tent while its projection is tabulated.
const POINTS: usize = 8;

/// Rows of profiles by width and offset.
pub struct Separable<const N: usize> {
    profiles: Vec<[f32; N]>,
    projection: Projection,
    /// Least width and widths a pixel.
    least: f32,
    per: f32,
}

/// Integral of the cubic B-spline from minus infinity to `x`.
fn spline_integral(x: f32) -> f32 {
    let y = x.abs().min(2.0);
    let half = if y < 1.0 {
        y * (2.0 / 3.0 - y * y * (1.0 / 3.0 - y / 8.0))
    } else {
        0.5 - (2.0 - y).powi(4) / 24.0
    };
    0.5 + half.copysign(x)
}

/// Knot distances of the cubic B-splines along x and y that have the variance of the tent: `3 Σ d²/6`.
#[inline(always)]
fn widths(projection: &Projection, at: [f32; 3]) -> [f32; 2] {
    let mut sums = [0f32; 2];
    for axis in 0..3 {
        let [x, y] = projection.step(axis, at);
        sums[0] += 0.5 * x * x;
        sums[1] += 0.5 * y * y;
    }
    [sums[0].sqrt(), sums[1].sqrt()]
}

impl<const N: usize> Separable<N> {
    pub fn new(projection: Projection, dims: [usize; 3]) -> Self {
        let range = projection.range(dims);
        let mut span = [f32::INFINITY, f32::NEG_INFINITY];
        for corner in 0..8 {
            let at = [0, 1, 2].map(|a| range[a][corner >> a & 1]);
            for w in widths(&projection, at) {
                span = [span[0].min(w), span[1].max(w)];
            }
        }
        let step = ((span[1] - span[0]) / (WIDTHS - 1) as f32).max(1e-6);
        let mut profiles = Vec::with_capacity(WIDTHS * OFFSETS);
        for w in 0..WIDTHS {
            let knot = span[0] + step * w as f32;
            for o in 0..OFFSETS {
                let f = (o as f32 + 0.5) / OFFSETS as f32;
                let edge = |n: usize| spline_integral((n as f32 - N as f32 / 2.0 + 0.5 - f) / knot);
                let mut row = [0.0; N];
                for (n, v) in row.iter_mut().enumerate() {
                    *v = edge(n + 1) - edge(n);
                }
                // What lies beyond the last pixels is shared out.
                let sum: f32 = row.iter().sum();
                row.iter_mut().for_each(|v| *v /= sum);
                profiles.push(row);
            }
        }
        Self { profiles, projection, least: span[0], per: 1.0 / step }
    }

    #[inline(always)]
    fn profile(&self, width: f32, fraction: f32) -> [f32; N] {
        let w = ((width - self.least) * self.per + 0.5).clamp(0.0, (WIDTHS - 1) as f32) as usize;
        let o = ((fraction * OFFSETS as f32) as usize).min(OFFSETS - 1);
        self.profiles[w * OFFSETS + o]
    }
}

impl<const N: usize> Footprint<N> for Separable<N> {
    #[inline(always)]
    fn add(&mut self, image: &mut [f32], width: usize, at: [f32; 3], fraction: [f32; 2], amount: f32) {
        let [wide, high] = widths(&self.projection, at);
        let (across, down) = (self.profile(wide, fraction[0]), self.profile(high, fraction[1]));
        for (n, d) in down.into_iter().enumerate() {
            let row = &mut image[n * width..][..N];
            for m in 0..N {
                row[m] += amount * d * across[m];
            }
        }
    }
}

/// Tables of projected tents by place in the view, made when they are first wanted.
pub struct Tables<const N: usize> {
    projection: Projection,
    bins: [usize; 3],
    /// Least coordinate and bins per unit, of x, y and depth.
    scale: [[f32; 2]; 3],
    offsets: usize,
    tables: Vec<Option<Box<[f32]>>>,
}

impl<const N: usize> Tables<N> {
    pub fn new(projection: Projection, dims: [usize; 3], bins: [usize; 3], offsets: usize) -> Self {
        let range = projection.range(dims);
        let scale = [0, 1, 2].map(|a| {
            let [low, high] = range[a];
            [low, bins[a] as f32 / (high - low).max(1e-6)]
        });
        let mut tables = vec![];
        tables.resize_with(bins.iter().product(), || None);
        Self { projection, bins, scale, offsets, tables }
    }

    /// The projection of a tent around a place, averaged over pixels: by offset along y, offset along x, row and column.
    fn table(&self, at: [f32; 3]) -> Box<[f32]> {
        let s = self.offsets;
        let half = s * (N / 2 + 1);
        let side = 2 * half + 2;
        let steps = [0, 1, 2].map(|axis| self.projection.step(axis, at));
        // Places of equal shares of a tent; with what sharing points out to nodes adds, their variance is the tent's.
        let mut points = [0f32; POINTS];
        for (n, p) in points.iter_mut().enumerate() {
            let u = (n as f32 + 0.5) / POINTS as f32;
            *p = if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).sqrt() };
        }
        let variance = points.iter().map(|p| p * p).sum::<f32>() / POINTS as f32;
        let own: f32 = steps.iter().flatten().map(|d| d * d).sum::<f32>() / 12.0;
        let nodes = 1.0 / (6.0 * (s * s) as f32);
        let shrink = ((1.0 / 6.0) / variance * (1.0 - nodes / own).max(0.0)).sqrt();
        let mut fine = vec![0f32; side * side];
        let share = 1.0 / POINTS.pow(3) as f32;
        for n in 0..POINTS.pow(3) {
            let t = [n % POINTS, n / POINTS % POINTS, n / POINTS / POINTS].map(|i| points[i] * shrink);
            let place = [0, 1].map(|c| (t[0] * steps[0][c] + t[1] * steps[1][c] + t[2] * steps[2][c]) * s as f32);
            let [x, y] = place.map(|v| (v + half as f32).clamp(0.0, (2 * half) as f32 - 0.01));
            let (i, j) = (x as usize, y as usize);
            let (fx, fy) = (x - i as f32, y - j as f32);
            for (di, dj, w) in
                [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
            {
                fine[(j + dj) * side + i + di] += share * w;
            }
        }
        // Sums up to and without a node, in place.
        let mut sums = vec![0f32; (side + 1) * (side + 1)];
        for j in 0..side {
            let mut row = 0.0;
            for i in 0..side {
                row += fine[j * side + i];
                sums[(j + 1) * (side + 1) + i + 1] = sums[j * (side + 1) + i + 1] + row;
            }
        }
        // Node of the lower edge of pixel n under offset o; pixels reach from half a pixel before their centres.
        let edge = |n: usize, o: usize| (half + s * (n + 1)) as i64 - (s * N / 2) as i64 - (s / 2) as i64 - o as i64;
        let sum = |i: i64, j: i64| {
            let clip = |v: i64| v.clamp(0, side as i64) as usize;
            sums[clip(j) * (side + 1) + clip(i)]
        };
        let mut out = Vec::with_capacity(s * s * N * N);
        for (oy, ox) in (0..s).flat_map(|oy| (0..s).map(move |ox| (oy, ox))) {
            let start = out.len();
            for (m, n) in (0..N).flat_map(|m| (0..N).map(move |n| (m, n))) {
                let [a, b] = [edge(n, ox), edge(m, oy)];
                let [c, d] = [edge(n + 1, ox), edge(m + 1, oy)];
                out.push(sum(c, d) - sum(a, d) - sum(c, b) + sum(a, b));
            }
            let all: f32 = out[start..].iter().sum();
            out[start..].iter_mut().for_each(|v| *v /= all.max(1e-6));
        }
        out.into_boxed_slice()
    }
}

impl<const N: usize> Footprint<N> for Tables<N> {
    #[inline(always)]
    fn add(&mut self, image: &mut [f32], width: usize, at: [f32; 3], fraction: [f32; 2], amount: f32) {
        let mut bin = [0usize; 3];
        for a in 0..3 {
            let [low, per] = self.scale[a];
            bin[a] = (((at[a] - low) * per) as usize).min(self.bins[a] - 1);
        }
        let which = bin[0] + self.bins[0] * (bin[1] + self.bins[1] * bin[2]);
        if self.tables[which].is_none() {
            let centre = [0, 1, 2].map(|a| self.scale[a][0] + (bin[a] as f32 + 0.5) / self.scale[a][1]);
            self.tables[which] = Some(self.table(centre));
        }
        let Some(table) = &self.tables[which] else { return };
        let s = self.offsets;
        let [ox, oy] = fraction.map(|f| ((f * s as f32) as usize).min(s - 1));
        let shape = &table[(oy * s + ox) * N * N..][..N * N];
        for n in 0..N {
            let row = &mut image[n * width..][..N];
            for m in 0..N {
                row[m] += amount * shape[n * N + m];
            }
        }
    }
}
