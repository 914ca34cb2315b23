//! From values at points of an image to means over its pixels, without another ray.
//!
//! The mean of a smooth function over a cell differs from its value at the cell's centre by its curvature, and the neighbours'
//! values tell the curvature: `mean = v + δ²v/24 - 17 δ⁴v/5760 + ...` along each axis, with `δ²` the second difference. Finite-volume
//! methods turn point values into cell averages so (P. Buchmüller and C. Helzel, *Improved accuracy of high-order WENO finite volume
//! methods on Cartesian grids*, J. Sci. Comput. 61, 2014). For the mean of the centres of `n` parts of a cell the factors are
//! `1/(24 n²)` and `-(1/(288 n²) - 1/(1920 n⁴))`: the series of `sinc(f/n)` in the response of the second difference.
//!
//! Where an image is smooth at the scale of several pixels, one ray may serve a block of them: their means are those of the polynomial
//! through the ray's value and its neighbours'.
//!
//! What is left is the image's roughness below a pixel, or a block. No value is invented where the image ends: rays are cast through a
//! [margin](MARGIN) around it.

use mcvr_scene::{Camera, Extent, Image, SceneError};
use mcvr_volume::{SimdLevel, vectorised};
use rayon::prelude::*;

/// Values beyond the image on each side that the formulas read.
pub(crate) const MARGIN: usize = 2;

/// Factors on the value itself and on both neighbours at one and two pixels, for means of `n` centres.
fn stencil(n: f64) -> [f64; 3] {
    let second = 1.0 / (24.0 * n * n);
    let fourth = -(1.0 / (288.0 * n * n) - 1.0 / (1920.0 * n.powi(4)));
    // δ² = (1, -2, 1) and δ⁴ = (1, -4, 6, -4, 1).
    [1.0 - 2.0 * second + 6.0 * fourth, second - 4.0 * fourth, fourth]
}

/// How values become means over pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rays {
    /// A grid of so many by so many rays in every pixel.
    Grid(u32),
    /// One ray for a block of so many by so many pixels.
    Block(u32),
}

impl Rays {
    /// Pixels along the side of a block.
    pub fn block(self) -> u32 {
        if let Rays::Block(side) = self { side } else { 1 }
    }

    /// Factors on a value and its neighbours along an axis, for every pixel along the side of a block.
    pub fn taps(self) -> Vec<[f64; 5]> {
        match self {
            Rays::Block(side) if side > 1 => (0..side).map(|n| part(n, side)).collect(),
            Rays::Grid(_) | Rays::Block(_) => {
                let [c0, c1, c2] = stencil(if let Rays::Grid(n) = self { f64::from(n) } else { 1.0 });
                vec![[c2, c1, c0, c1, c2]]
            }
        }
    }
}

/// Means of the polynomial of degree 4 through five values, at -2 to 2, over part `n` of `of` parts of [-1/2, 1/2].
fn part(n: u32, of: u32) -> [f64; 5] {
    let width = 1.0 / f64::from(of);
    let middle = (f64::from(n) + 0.5) * width - 0.5;
    // Gauss' formula of three points: exact for degree 5.
    let away = 0.6f64.sqrt() * 0.5 * width;
    let [before, at, after] = [middle - away, middle, middle + away].map(basis);
    std::array::from_fn(|i| (5.0 * (before[i] + after[i]) + 8.0 * at[i]) / 18.0)
}

/// Rows of blocks that are made together.
const BAND: usize = 16;

/// Means over the camera's pixels times `scale`, from values of the camera [in blocks with a margin](Camera::in_blocks).
///
/// # Errors
/// [`SceneError::Image`] when the image is not the camera's with a margin.
pub(crate) fn over_pixels(wide: &Image, camera: &Camera, rays: Rays, scale: f64) -> Result<Image, SceneError> {
    let extent = camera.extent();
    let side = rays.block() as usize;
    let across = extent.width.div_ceil(side) + 2 * MARGIN;
    if wide.extent().width != across || wide.extent().height != extent.height.div_ceil(side) + 2 * MARGIN {
        return Err(SceneError::Image(format!("{} pixels are not {extent} with a margin", wide.extent())));
    }
    Ok(means((wide.values(), across), extent, rays, scale))
}

/// The same from rows of values, `across` in each, that begin [`MARGIN`] values before those of the image's first pixel, and reach at least
/// as far beyond the last.
pub(crate) fn means((values, across): (&[f64], usize), extent: Extent, rays: Rays, scale: f64) -> Image {
    let (side, taps) = (rays.block() as usize, rays.taps());
    let level = SimdLevel::detect();
    let mut image = Image::zeros(extent);
    image.values_mut().par_chunks_mut(BAND * side * extent.width).enumerate().for_each(|(band, rows)| {
        // Along y first, a row at a time.
        let mut column = vec![0.0; across];
        for (y, out) in rows.chunks_mut(extent.width).enumerate() {
            let first = band * BAND + y / side;
            let row = |dy: usize| &values[across * (first + dy)..][..across];
            let rows = [row(0), row(1), row(2), row(3), row(4)];
            means_of_row(level, rows, taps[y % side].map(|t| t * scale), &taps, &mut column, out);
        }
    });
    image
}

vectorised! {
    /// A row of means from five rows of values: `down` along y, then `taps` along x, one set for each pixel of a block.
    fn means_of_row(rows: [&[f64]; 5], down: [f64; 5], taps: &[[f64; 5]], column: &mut [f64], out: &mut [f64]) = means_of_row_body
}

#[inline(always)]
fn means_of_row_body(rows: [&[f64]; 5], down: [f64; 5], taps: &[[f64; 5]], column: &mut [f64], out: &mut [f64]) {
    let across = column.len();
    let [a, b, c, d, e] = rows.map(|r| &r[..across]);
    let t = down;
    for x in 0..across {
        column[x] = t[2] * c[x] + t[1] * b[x] + t[3] * d[x] + (t[0] * a[x] + t[4] * e[x]);
    }
    // Loops over as many as are known become vector code.
    let side = taps.len();
    match side {
        1 => along::<1>(taps, column, out),
        2 => along::<2>(taps, column, out),
        4 => along::<4>(taps, column, out),
        _ => {
            for x in 0..out.len() {
                out[x] = mean_at(&taps[x % side], &column[x / side..][..5]);
            }
        }
    }
}

#[inline(always)]
fn mean_at(t: &[f64; 5], v: &[f64]) -> f64 {
    t[2] * v[2] + t[1] * v[1] + t[3] * v[3] + (t[0] * v[0] + t[4] * v[4])
}

#[inline(always)]
fn along<const SIDE: usize>(taps: &[[f64; 5]], column: &[f64], out: &mut [f64]) {
    let whole = out.len() / SIDE;
    let (v, taps) = (&column[..whole + 4], &taps[..SIDE]);
    let inner = &mut out[..whole * SIDE];
    for x in 0..whole {
        for n in 0..SIDE {
            let t = &taps[n];
            inner[x * SIDE + n] = t[2] * v[x + 2] + t[1] * v[x + 1] + t[3] * v[x + 3] + (t[0] * v[x] + t[4] * v[x + 4]);
        }
    }
    // Of the last block the image may have a part.
    for x in whole * SIDE..out.len() {
        out[x] = mean_at(&taps[x % SIDE], &column[whole..][..5]);
    }
}

/// Factors on five values, at -2 to 2, for the polynomial of degree 4 through them at `x`.
pub(crate) fn basis(x: f64) -> [f64; 5] {
    let of = |i: usize| (0..5).filter(move |m| *m != i).map(move |m| (x + 2.0 - m as f64) / (i as f64 - m as f64));
    std::array::from_fn(|i| of(i).product())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Polynomials of degree 5 have their means exactly.
    #[test]
    fn the_stencil_gives_means_of_polynomials() {
        for n in 1..4u32 {
            let [c0, c1, c2] = stencil(f64::from(n));
            for degree in 0..6 {
                let value = |x: f64| {
                    let part = |k: u32| (x + (f64::from(k) + 0.5) / f64::from(n) - 0.5).powi(degree);
                    (0..n).map(part).sum::<f64>() / f64::from(n)
                };
                let got = c0 * value(0.0) + c1 * (value(-1.0) + value(1.0)) + c2 * (value(-2.0) + value(2.0));
                let k = f64::from(degree + 1);
                let mean = (0.5f64.powf(k) - (-0.5f64).powi(degree + 1)) / k;
                assert!((got - mean).abs() < 1e-14, "{n} centres, degree {degree}: {got} {mean}");
            }
        }
    }
}
