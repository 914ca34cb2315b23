//! From values at points of an image to means over its pixels, without another ray.
//!
//! The mean of a smooth function over a cell differs from its value at the cell's centre by its curvature, and the neighbours'
//! values tell the curvature: `mean = v + δ²v/24 - 17 δ⁴v/5760 + ...` along each axis, with `δ²` the second difference. Finite-volume
//! methods turn point values into cell averages so (P. Buchmüller and C. Helzel, *Improved accuracy of high-order WENO finite volume
//! methods on Cartesian grids*, J. Sci. Comput. 61, 2014). For the mean of the centres of `n` parts of a cell the factors are
//! `1/(24 n²)` and `-(1/(288 n²) - 1/(1920 n⁴))`: the series of `sinc(f/n)` in the response of the second difference.
//!
//! What it leaves is the image's roughness below a pixel. No value is invented where the image ends: rays are cast through a
//! [margin](MARGIN) around it.

use mcvr_scene::{Camera, Image, SceneError};

/// Pixels beyond the image on each side whose values the formula reads.
pub(crate) const MARGIN: usize = 2;

/// Factors on the value itself and on both neighbours at one and two pixels, for means of `n` centres.
fn stencil(n: f64) -> [f64; 3] {
    let second = 1.0 / (24.0 * n * n);
    let fourth = -(1.0 / (288.0 * n * n) - 1.0 / (1920.0 * n.powi(4)));
    // δ² = (1, -2, 1) and δ⁴ = (1, -4, 6, -4, 1).
    [1.0 - 2.0 * second + 6.0 * fourth, second - 4.0 * fourth, fourth]
}

/// Means over the camera's pixels, from values at `n` by `n` centres a pixel of the camera [with a margin](Camera::with_margin).
///
/// # Errors
/// [`SceneError::Image`] when the image is not the camera's with a margin.
pub(crate) fn over_pixels(wide: &Image, camera: &Camera, n: u32) -> Result<Image, SceneError> {
    let extent = camera.extent();
    let (width, height) = (extent.width, extent.height);
    let across = width + 2 * MARGIN;
    if wide.extent().width != across || wide.extent().height != height + 2 * MARGIN {
        return Err(SceneError::Image(format!("{} pixels are not {extent} with a margin", wide.extent())));
    }
    let [c0, c1, c2] = stencil(f64::from(n));
    let values = wide.values();
    // Along y first, a row at a time.
    let mut column = vec![0.0; across];
    let mut out = Vec::with_capacity(extent.pixels());
    for y in 0..height {
        let row = |dy: usize| &values[across * (y + dy)..][..across];
        let (a, b, c, d, e) = (row(0), row(1), row(2), row(3), row(4));
        for (x, v) in column.iter_mut().enumerate() {
            *v = c0 * c[x] + c1 * (b[x] + d[x]) + c2 * (a[x] + e[x]);
        }
        out.extend(column.windows(5).map(|v| c0 * v[2] + c1 * (v[1] + v[3]) + c2 * (v[0] + v[4])));
    }
    Image::from_values(extent, out)
}

/// By what factor averaging lowers errors that are independent from pixel to pixel, for `n` by `n` rays a pixel.
pub(crate) fn noise(n: u32) -> f64 {
    let [c0, c1, c2] = stencil(f64::from(n));
    c0 * c0 + 2.0 * (c1 * c1 + c2 * c2)
}

/// Mean squares, over a square of values, of the first two terms of the difference between mean and value: those of second and of
/// fourth differences, along both axes.
pub(crate) fn bends(values: &[f64], side: usize) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for line in 0..side {
        for (first, step) in [(line * side, 1), (line, side)] {
            let v = |n: usize| values[first + n * step];
            for n in 1..side - 1 {
                sums[0] += ((v(n - 1) - 2.0 * v(n) + v(n + 1)) / 24.0).powi(2);
            }
            for n in 2..side - 2 {
                let fourth = v(n - 2) - 4.0 * v(n - 1) + 6.0 * v(n) - 4.0 * v(n + 1) + v(n + 2);
                sums[1] += (fourth * 17.0 / 5760.0).powi(2);
            }
        }
    }
    [sums[0] / (side * (side - 2)) as f64, sums[1] / (side * (side - 4)) as f64]
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
