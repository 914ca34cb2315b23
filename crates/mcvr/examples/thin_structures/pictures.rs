//! Pictures to look at beside the figures.

use std::path::Path;

use mcvr::scene::film::{self, Tone};
use mcvr::scene::{Extent, Image};

use crate::Outcome;
use crate::ridges::Section;

/// The kernels shown, after the fine reference.
pub const TILES: [&str; 6] = ["box", "shell", "hermite", "tent", "bspline3", "concentrated tent"];
/// Side of a tile in pixels, before it is doubled.
const TILE: usize = 110;

/// The window of one tile that holds the most sections.
fn densest(extent: Extent, sections: &[Section]) -> [usize; 2] {
    let half = TILE / 2;
    let inside = |x: f64, y: f64| {
        let near = |s: &&Section| (s.at[0] - x).abs() < half as f64 && (s.at[1] - y).abs() < half as f64;
        sections.iter().filter(near).count()
    };
    let best = sections.iter().max_by_key(|s| inside(s.at[0], s.at[1]));
    let [x, y] = best.map_or([0.0; 2], |s| s.at);
    let clamp = |v: f64, n: usize| (v as usize).saturating_sub(half).min(n.saturating_sub(TILE));
    [clamp(x, extent.width), clamp(y, extent.height)]
}

/// The same window of every image, side by side, pixels doubled, under the first image's tone.
pub fn tiles(images: &[Image], sections: &[Section], path: &Path) -> Outcome<()> {
    let Some(first) = images.first() else { return Ok(()) };
    let extent = first.extent();
    let [x0, y0] = densest(extent, sections);
    let (side, gap) = (2 * TILE, 4);
    let width = images.len() * (side + gap) - gap;
    let mut out = Image::from_values(Extent::new(width, side)?, vec![1.0; width * side])?;
    let crop = |image: &Image| {
        let mut window = Image::zeros(Extent { width: TILE, height: TILE });
        for (n, v) in window.values_mut().iter_mut().enumerate() {
            let (x, y) = (x0 + n % TILE, y0 + n / TILE);
            *v = if x < extent.width && y < extent.height { image.get(x, y) } else { 0.0 };
        }
        window
    };
    let tone = Tone::default();
    let limits = tone.limits(&crop(first));
    for (t, image) in images.iter().enumerate() {
        let grey = tone.apply(&crop(image), limits);
        for y in 0..side {
            for x in 0..side {
                out.values_mut()[y * width + t * (side + gap) + x] = grey[y / 2 * TILE + x / 2];
            }
        }
    }
    Ok(film::write_within(&out, path, film::ImageFormat::Png8, &tone, [0.0, 1.0])?)
}

/// The reference at half its size with the sections marked.
pub fn marked(truth: &Image, sections: &[Section], path: &Path) -> Outcome<()> {
    let extent = Extent::new(truth.extent().width / 2, truth.extent().height / 2)?;
    let tone = Tone::default();
    let grey = tone.apply(truth, tone.limits(truth));
    let mut pixels: Vec<[u8; 3]> = (0..extent.pixels())
        .map(|n| {
            let at = 2 * (n % extent.width) + 2 * (n / extent.width) * truth.extent().width;
            // Few levels, so that the file stays small.
            [((grey[at] * 31.0).round() * 255.0 / 31.0) as u8; 3]
        })
        .collect();
    for section in sections {
        for s in section.sides[0] as i64..=section.sides[1] as i64 {
            let p: [f64; 2] = std::array::from_fn(|a| 0.5 * (section.at[a] + s as f64 * section.normal[a]));
            let (x, y) = (p[0] as usize, p[1] as usize);
            if x < extent.width && y < extent.height {
                pixels[y * extent.width + x] = [255, 64, 32];
            }
        }
    }
    Ok(film::write_rgb8(extent, &pixels, path)?)
}
