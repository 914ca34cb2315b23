//! The profiles of footprints: cubic B-splines averaged over pixels, by width and by offset below a pixel.

/// Offsets below a pixel, and widths.
#[derive(Clone, Copy)]
pub struct Fineness {
    pub offsets: usize,
    pub widths: usize,
}

/// Profiles of `N` pixels by width and offset.
pub struct Profiles<const N: usize> {
    pub rows: Vec<[f32; N]>,
    /// Least width, and widths a pixel.
    pub least: f32,
    pub per: f32,
}

/// Integral of the cubic B-spline from minus infinity to `x`.
fn spline_integral(x: f32) -> f32 {
    let y = x.abs().min(2.0);
    let half = if y < 1.0 { y * (2.0 / 3.0 - y * y * (1.0 / 3.0 - y / 8.0)) } else { 0.5 - (2.0 - y).powi(4) / 24.0 };
    0.5 + half.copysign(x)
}

impl<const N: usize> Profiles<N> {
    /// For knot distances from the least to the most.
    pub fn new([least, most]: [f32; 2], fineness: Fineness) -> Self {
        let Fineness { offsets, widths } = fineness;
        let step = ((most - least) / (widths - 1) as f32).max(1e-6);
        let mut rows = Vec::with_capacity(widths * offsets);
        for (w, o) in (0..widths).flat_map(|w| (0..offsets).map(move |o| (w, o))) {
            let knot = least + step * w as f32;
            let f = (o as f32 + 0.5) / offsets as f32;
            let edge = |n: usize| spline_integral((n as f32 - N as f32 / 2.0 + 0.5 - f) / knot);
            let mut row = [0.0; N];
            let mut before = edge(0);
            for (n, v) in row.iter_mut().enumerate() {
                let after = edge(n + 1);
                *v = after - before;
                before = after;
            }
            // What lies beyond the last pixels is shared out.
            let sum: f32 = row.iter().sum();
            row.iter_mut().for_each(|v| *v /= sum);
            rows.push(row);
        }
        Self { rows, least, per: 1.0 / step }
    }
}
