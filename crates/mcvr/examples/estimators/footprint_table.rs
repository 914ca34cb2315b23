//! The profiles of footprints: the projection of a tent onto each axis of the image, averaged over pixels, by width and by offset
//! below a pixel.

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

/// Reach of a shape and its nodes: three equal tents with a variance of 1/3 reach to 2.45.
const REACH: f32 = 2.5;
const NODES: usize = 320;

/// Points that stand for a tent while others are added to it.
const POINTS: usize = 12;

/// Integral of a tent of half width 1 from minus infinity.
fn tent_integral(x: f32) -> f32 {
    let beyond = 1.0 - x.abs().min(1.0);
    let tail = 0.5 * beyond * beyond;
    if x < 0.0 { tail } else { 1.0 - tail }
}

/// Integral from minus infinity of the sum of three tents of these half widths, scaled to a variance of 1/3: the projection of a
/// voxel's tent onto an axis of the image.
fn shape(steps: [f32; 3]) -> Vec<f32> {
    let scale = (0.5 * steps.iter().map(|s| s * s).sum::<f32>()).sqrt().max(1e-30);
    let mut widths = steps.map(|s| s.abs() / scale);
    widths.sort_by(f32::total_cmp);
    // Places of equal shares of a tent, with its variance.
    let mut points = [0f32; POINTS];
    for (n, p) in points.iter_mut().enumerate() {
        let u = (n as f32 + 0.5) / POINTS as f32;
        *p = if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).sqrt() };
    }
    let variance = points.iter().map(|p| p * p).sum::<f32>() / POINTS as f32;
    let stretch = (1.0 / 6.0 / variance).sqrt();
    let mut shifts = vec![];
    for (p, q) in points.iter().flat_map(|p| points.iter().map(move |q| (p, q))) {
        shifts.push(stretch * (p * widths[0] + q * widths[1]) / widths[2]);
    }
    let node = |n: usize| (n as f32 / NODES as f32 * 2.0 - 1.0) * REACH / widths[2];
    let sum = |x: f32| shifts.iter().map(|s| tent_integral(x - s)).sum::<f32>() / shifts.len() as f32;
    (0..=NODES).map(|n| sum(node(n))).collect()
}

/// The integral up to `x`.
fn integral(shape: &[f32], x: f32) -> f32 {
    let at = ((x / REACH + 1.0) * 0.5 * NODES as f32).clamp(0.0, NODES as f32 - 0.01);
    let (n, f) = (at as usize, at.fract());
    shape[n] + f * (shape[n + 1] - shape[n])
}

impl<const N: usize> Profiles<N> {
    /// For knot distances from the least to the most, and for a voxel's steps along the image's axes x and y in its middle; the rows for y
    /// follow those for x.
    pub fn new([least, most]: [f32; 2], steps: [[f32; 3]; 2], fineness: Fineness) -> Self {
        let Fineness { offsets, widths } = fineness;
        let step = ((most - least) / (widths - 1) as f32).max(1e-6);
        let mut rows = Vec::with_capacity(2 * widths * offsets);
        let shapes = steps.map(shape);
        for n in 0..2 * widths * offsets {
            let (shape, w, o) = (&shapes[n / (widths * offsets)], n / offsets % widths, n % offsets);
            let knot = least + step * w as f32;
            let f = (o as f32 + 0.5) / offsets as f32;
            let edge = |n: usize| integral(shape, (n as f32 - N as f32 / 2.0 + 0.5 - f) / knot);
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
