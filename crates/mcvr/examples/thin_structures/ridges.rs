//! Cross sections over thin structures: found in the fine image alone, measured alike in every image.

use mcvr::scene::{Extent, Image};

/// Samples per pixel along a profile.
const FINE: f64 = 4.0;
/// How far a profile reaches to each side, in fine voxels.
const REACH: f64 = 10.0;
/// Scale of the derivatives by which ridges are found, in fine voxels.
const SCALE: f64 = 1.5;
/// Widest structure that counts as thin, full width at half maximum in fine voxels.
const THIN: f64 = 6.0;
/// Faintest structure that counts: contrast as a share of the image's largest value.
const FAINT: f64 = 0.02;
/// Largest slope of the background: difference of both sides as a share of the contrast.
const UNEVEN: f64 = 0.5;
/// Least distance between sections, in fine voxels.
const APART: f64 = 4.0;
/// Most sections of an image.
const MOST: usize = 400;

/// A line across a structure, in pixels: middle, unit normal, and where on it the background is read.
#[derive(Clone, Copy, Debug)]
pub struct Section {
    pub at: [f64; 2],
    pub normal: [f64; 2],
    pub sides: [f64; 2],
}

/// What a section shows.
#[derive(Clone, Copy, Debug)]
pub struct Measure {
    /// Peak above the straight line between both sides.
    pub contrast: f64,
    /// Full width at half of that, in pixels.
    pub width: f64,
    /// Where the peak lies along the normal, in pixels from the middle.
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
    let n = (REACH * voxel * FINE) as i64;
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
    // The peak's position by a parabola; its height is the sample's.
    let (l, c, r) = (above(peak - 1), above(peak), above(peak + 1));
    let bend = l - 2.0 * c + r;
    let shift = if bend < 0.0 { 0.5 * (l - r) / bend } else { 0.0 };
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
    let width = (crossing(-1)? + crossing(1)?) / FINE;
    Some(Measure { contrast: c, width, shift: (peak as f64 - n as f64 + shift) / FINE })
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
    (length > 0.0 && t.abs() <= 0.71).then_some((-sharp, Section { at, normal: n, sides: [0.0; 2] }))
}

/// The section with its sides at the lowest points of both flanks, if the structure is thin, clear and alone.
fn isolated(image: &Image, section: Section, voxel: f64, faintest: f64) -> Option<Section> {
    let n = (REACH * voxel * FINE) as i64;
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
pub fn find(image: &Image, voxel: f64) -> Vec<Section> {
    let smooth = blurred(image, SCALE * voxel);
    let Extent { width, height } = image.extent();
    let border = (REACH * voxel).ceil() as usize + 2;
    let faintest = FAINT * image.max();
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
            chosen.extend(isolated(image, section, voxel, faintest));
        }
    }
    chosen
}

/// The rules above, for the report.
pub fn rules() -> String {
    format!(
        "Sections are found in the fine reference alone: ridge points (Hessian at a scale of {SCALE} fine voxels, the \
         sharper curvature downwards and at least 4 times the other), strongest first, at least {APART} fine voxels \
         apart, at most {MOST}; kept where the profile across (±{REACH} fine voxels) shows one bump of at least {} % of \
         the image's maximum, at most {THIN} fine voxels wide, nothing else of half its height beside it, and a background \
         that differs by at most {} % of the contrast between both sides. The background is read at the fine \
         profile's lowest point on each side, the same two places in every image.",
        100.0 * FAINT,
        100.0 * UNEVEN
    )
}
