//! Cross sections over thin structures: found in the fine image alone, measured alike in every image.

use mcvr::scene::{Extent, Image};

/// Samples per pixel along a profile.
const FINE: f64 = 4.0;
/// Scale of the derivatives by which ridges are found, in fine voxels.
const SCALE: f64 = 1.5;
/// Widest structure that counts as thin, full width at half maximum in fine voxels.
const THIN: f64 = 6.0;
/// Largest slope of the background: difference of both sides as a share of the contrast.
const UNEVEN: f64 = 0.5;
/// Least distance between sections, in fine voxels.
const APART: f64 = 4.0;
/// Most sections of an image.
const MOST: usize = 400;

/// What a scan's structures are like.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// How far a profile reaches to each side, in fine voxels: structures must be alone that far.
    pub reach: f64,
    /// Faintest structure that counts: contrast as a share of the image's largest value.
    pub faintest: f64,
}

/// A line across a structure, in pixels: middle, unit normal, where on it the background is read, how far it reaches.
#[derive(Clone, Copy, Debug)]
pub struct Section {
    pub at: [f64; 2],
    pub normal: [f64; 2],
    pub sides: [f64; 2],
    pub reach: f64,
}

/// What a section shows.
#[derive(Clone, Copy, Debug)]
pub struct Measure {
    /// Peak above the straight line between both sides.
    pub contrast: f64,
    /// Full width at half of that, in pixels.
    pub width: f64,
    /// Where the middle between the two halves lies along the normal, in pixels from the section's middle.
    pub shift: f64,
}

/// The image at a point by bilinear interpolation; 0 outside.
fn at(image: &Image, x: f64, y: f64) -> f64 {
    let Extent { width, height } = image.extent();
    let (x, y) = (x - 0.5, y - 0.5);
    let (i, j) = (x.floor(), y.floor());
    if i < 0.0 || j < 0.0 || i as usize + 1 >= width || j as usize + 1 >= height {
        return 0.0;
    }
    let (fx, fy) = (x - i, y - j);
    let v = |a: usize, b: usize| image.get(i as usize + a, j as usize + b);
    (v(0, 0) * (1.0 - fx) + v(1, 0) * fx) * (1.0 - fy) + (v(0, 1) * (1.0 - fx) + v(1, 1) * fx) * fy
}

/// The profile at whole numbers of `1 / FINE` pixel from `-n` to `n`.
fn profile(image: &Image, section: &Section, n: i64) -> Vec<f64> {
    (-n..=n)
        .map(|s| {
            let s = s as f64 / FINE;
            at(image, section.at[0] + s * section.normal[0], section.at[1] + s * section.normal[1])
        })
        .collect()
}

/// Measures a section; `None` when there is no peak or it never falls to its half within the profile.
/// `voxel` is the fine voxel in pixels.
pub fn measure(image: &Image, section: &Section, voxel: f64) -> Option<Measure> {
    let n = (section.reach * FINE) as i64;
    let p = profile(image, section, n);
    let index = |s: f64| s * FINE + n as f64;
    // The background: means over half a voxel around both sides, and the line between them.
    let side = |s: f64| {
        let (c, r) = (index(s).round() as i64, (0.25 * voxel * FINE).ceil() as i64);
        let range = (c - r).max(0) as usize..=((c + r).max(0) as usize).min(p.len() - 1);
        p[range.clone()].iter().sum::<f64>() / range.count() as f64
    };
    let [left, right] = section.sides;
    let (a, b) = (side(left), side(right));
    let above = |k: usize| {
        let s = (k as f64 - n as f64) / FINE;
        p[k] - (a + (b - a) * (s - left) / (right - left))
    };
    let near = (2.0 * voxel * FINE) as i64;
    let middle = (n - near) as usize..=(n + near) as usize;
    let peak = middle.max_by(|&j, &k| above(j).total_cmp(&above(k)))?;
    if peak == 0 || peak + 1 >= p.len() || above(peak) <= 0.0 {
        return None;
    }
    let c = above(peak);
    let half = 0.5 * c;
    let crossing = |step: i64| {
        let mut k = peak as i64;
        loop {
            let next = k + step;
            if next < 0 || next as usize >= p.len() {
                return None;
            }
            let (u, v) = (above(k as usize), above(next as usize));
            if v <= half {
                return Some((k - peak as i64).abs() as f64 + (u - half) / (u - v));
            }
            k = next;
        }
    };
    // The middle between the halves: the peak itself is flat, and bilinear reading draws it to pixel centres.
    let (before, after) = (crossing(-1)?, crossing(1)?);
    let middle = peak as f64 - n as f64 + 0.5 * (after - before);
    Some(Measure { contrast: c, width: (before + after) / FINE, shift: middle / FINE })
}

/// The image convolved with a Gaussian of standard deviation `sigma` pixels.
fn blurred(image: &Image, sigma: f64) -> Image {
    let Extent { width, height } = image.extent();
    let reach = (4.0 * sigma).ceil() as i64;
    let mut taps: Vec<f64> = (-reach..=reach).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let sum: f64 = taps.iter().sum();
    taps.iter_mut().for_each(|t| *t /= sum);
    let pass = |from: &Image, dx: i64, dy: i64| {
        let mut to = Image::zeros(from.extent());
        for y in 0..height {
            for x in 0..width {
                let value = |(i, t): (i64, &f64)| {
                    let (u, v) = (x as i64 + dx * i, y as i64 + dy * i);
                    let inside = (0..width as i64).contains(&u) && (0..height as i64).contains(&v);
                    if inside { t * from.get(u as usize, v as usize) } else { 0.0 }
                };
                to.values_mut()[x + width * y] = (-reach..=reach).zip(&taps).map(value).sum();
            }
        }
        to
    };
    pass(&pass(image, 1, 0), 0, 1)
}

/// Strength of the ridge at a pixel and the section across it, if there is one.
fn ridge(smooth: &Image, x: usize, y: usize) -> Option<(f64, Section)> {
    let v = |dx: i64, dy: i64| smooth.get((x as i64 + dx) as usize, (y as i64 + dy) as usize);
    let (gx, gy) = (0.5 * (v(1, 0) - v(-1, 0)), 0.5 * (v(0, 1) - v(0, -1)));
    let (xx, yy) = (v(1, 0) - 2.0 * v(0, 0) + v(-1, 0), v(0, 1) - 2.0 * v(0, 0) + v(0, -1));
    let xy = 0.25 * (v(1, 1) - v(-1, 1) - v(1, -1) + v(-1, -1));
    // The Hessian's eigenvalues; the sharper bend must point down and be far sharper than the other.
    let (mean, spread) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
    let (sharp, flat) = (mean - spread, mean + spread);
    if sharp >= 0.0 || flat.abs() > 0.25 * sharp.abs() {
        return None;
    }
    // Two forms of the eigenvector, of which the longer is the sound one.
    let (p, q) = ([xy, sharp - xx], [sharp - yy, xy]);
    let n = if p[0].hypot(p[1]) > q[0].hypot(q[1]) { p } else { q };
    let length = n[0].hypot(n[1]);
    let n = [n[0] / length, n[1] / length];
    let t = -(gx * n[0] + gy * n[1]) / sharp;
    let at = [x as f64 + 0.5 + t * n[0], y as f64 + 0.5 + t * n[1]];
    (length > 0.0 && t.abs() <= 0.71).then_some((-sharp, Section { at, normal: n, sides: [0.0; 2], reach: 0.0 }))
}

/// The section with its sides at the lowest points of both flanks, if the structure is thin, clear and alone.
fn isolated(image: &Image, section: Section, voxel: f64, faintest: f64) -> Option<Section> {
    let n = (section.reach * FINE) as i64;
    let p = profile(image, &section, n);
    let lowest = |range: std::ops::Range<usize>| range.min_by(|&a, &b| p[a].total_cmp(&p[b]));
    let (a, b) = (lowest(0..n as usize)?, lowest(n as usize + 1..p.len())?);
    let sides = [a, b].map(|k| (k as f64 - n as f64) / FINE);
    let section = Section { sides, ..section };
    let found = measure(image, &section, voxel)?;
    let line = |k: usize| p[a] + (p[b] - p[a]) * (k as f64 - a as f64) / (b as f64 - a as f64);
    // Alone: outside its own width nothing between the sides rises to half of it.
    let alone = (a..=b).all(|k| {
        let s = (k as f64 - n as f64) / FINE - found.shift;
        s.abs() <= found.width || p[k] - line(k) < 0.5 * found.contrast
    });
    let even = (p[a] - p[b]).abs() <= UNEVEN * found.contrast;
    let thin = found.width <= THIN * voxel && found.shift.abs() <= voxel;
    (alone && even && thin && found.contrast >= faintest).then_some(section)
}

/// Sections over isolated thin structures of an image: ridge points by strength, not too near each other.
pub fn find(image: &Image, voxel: f64, look: Look) -> Vec<Section> {
    let smooth = blurred(image, SCALE * voxel);
    let Extent { width, height } = image.extent();
    let border = (look.reach * voxel).ceil() as usize + 2;
    let faintest = look.faintest * image.max();
    let mut ridges = vec![];
    for y in border..height.saturating_sub(border) {
        for x in border..width.saturating_sub(border) {
            ridges.extend(ridge(&smooth, x, y));
        }
    }
    ridges.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut chosen: Vec<Section> = vec![];
    for (_, section) in ridges {
        let near = |c: &Section| (c.at[0] - section.at[0]).hypot(c.at[1] - section.at[1]) < APART * voxel;
        if chosen.len() < MOST && !chosen.iter().any(near) {
            chosen.extend(isolated(image, Section { reach: look.reach * voxel, ..section }, voxel, faintest));
        }
    }
    chosen
}

/// The rules above, for the report.
pub fn rules() -> String {
    format!(
        "Sections are found in the fine reference alone: ridge points (Hessian at a scale of {SCALE} fine voxels, the \
         sharper curvature downwards and at least 4 times the other), strongest first, at least {APART} fine voxels \
         apart, at most {MOST}; kept where the profile across shows one bump, at most {THIN} fine voxels wide, with nothing \
         else of half its height beside it and a background that differs by at most {} % of the contrast between both \
         sides. The profile's reach and the least contrast are given with each scan. The background is read at the \
         fine profile's lowest point on each side, the same two places in every image.",
        100.0 * UNEVEN
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A straight ridge with a Gaussian profile over a sloping background, and its unit normal.
    fn gaussian(sigma: f64, degrees: f64) -> (Image, [f64; 2]) {
        let mut image = Image::zeros(Extent { width: 120, height: 120 });
        let (sin, cos) = degrees.to_radians().sin_cos();
        for (n, v) in image.values_mut().iter_mut().enumerate() {
            let (x, y) = ((n % 120) as f64 + 0.5 - 60.3, (n / 120) as f64 + 0.5 - 59.6);
            let d = x * cos + y * sin;
            *v = 7.0 * (-0.5 * (d / sigma).powi(2)).exp() + 3.0 + 0.01 * d;
        }
        (image, [cos, sin])
    }

    #[test]
    fn a_gaussian_ridge_has_its_contrast_width_and_place() {
        for (sigma, degrees) in [(2.0, 20.0), (3.5, 77.0), (2.7, 135.0)] {
            let (image, normal) = gaussian(sigma, degrees);
            // The section is set a pixel aside; bilinear reading adds a variance of at most 1/4 pixel² to sigma².
            let at = [60.3 - normal[0], 59.6 - normal[1]];
            let m = measure(&image, &Section { at, normal, sides: [-18.0, 18.0], reach: 20.0 }, 2.0).expect("a peak");
            let widest = (8.0 * 2f64.ln() * (sigma * sigma + 0.25)).sqrt();
            let width = (8.0 * 2f64.ln()).sqrt() * sigma;
            assert!(m.width > 0.995 * width && m.width < 1.005 * widest, "{} {width} {widest}", m.width);
            assert!(m.contrast < 7.01 && m.contrast > 6.95 * sigma / (sigma * sigma + 0.25).sqrt(), "{}", m.contrast);
            assert!((m.shift - 1.0).abs() < 0.1, "{}", m.shift);
        }
    }

    #[test]
    fn sections_lie_on_a_lone_thin_ridge_and_not_on_a_broad_one() {
        let (image, normal) = gaussian(2.0, 20.0);
        let sections = find(&image, 2.0, Look { reach: 10.0, faintest: 0.02 });
        assert!(sections.len() > 4, "{}", sections.len());
        for s in sections {
            let d = (s.at[0] - 60.3) * normal[0] + (s.at[1] - 59.6) * normal[1];
            let along = s.normal[0] * normal[0] + s.normal[1] * normal[1];
            assert!(d.abs() < 0.2 && along.abs() > 0.99, "{d} {along}");
        }
        assert!(find(&gaussian(6.0, 20.0).0, 2.0, Look { reach: 10.0, faintest: 0.02 }).is_empty());
    }
}
