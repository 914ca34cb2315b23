//! The report's figures beside ray casting of the same.

use std::time::Instant;

use mcvr::raycast::ReferenceOptions;
use mcvr::scene::effects::{DepthColour, DepthCue, Shading, Sides, Unlisted};
use mcvr::scene::film::{self, Tone};
use mcvr::scene::{Camera, DensityMap, Effects, Estimand, Extent, Image, Kernel, Watch};
use mcvr::volume::{Grid, Volume};
use mcvr::{Method, Request, Scenery, make};
use serde_json::{Value, json};

use crate::scenes::{self, HEAD, LOBSTER, material};
use crate::truths::truth;
use crate::{Options, Outcome};

/// Pixels of a panel's side.
const SIDE: usize = 400;
/// White pixels between panels.
const GAP: usize = 4;
/// Levels of a channel above black: few, so that noisy files stay small.
const LEVELS: f64 = 17.0;
/// Tolerance of the ray-cast panels and how often a pixel may be halved: fine for the eye, not for figures.
const TOLERANCE: f64 = 0.2;
const DEPTH: u32 = 1;
/// The surface of the lobster alone: isovalues between those of the resin and those of the meat.
pub const SURFACE: [[f64; 2]; 4] = [[26.0, 0.0], [40.0, 20.0], [60.0, 20.0], [75.0, 0.0]];

type Panel = [Image; 3];

fn panel(made: mcvr::Made) -> Panel {
    made.colour.unwrap_or_else(|| [made.image.clone(), made.image.clone(), made.image])
}

fn drawn(scenery: &Scenery, method: Method, samples: u64) -> Outcome<Panel> {
    Ok(panel(make(scenery, &Request { method, samples, ..Request::default() }, &Watch::default())?))
}

/// The channels of a ray-cast image, from disk if it was cast before.
fn cast(options: &Options, label: &str, scenery: &Scenery) -> Outcome<Panel> {
    let reference =
        ReferenceOptions { estimand: Estimand::Line, kernel: Kernel::Tent, tolerance: TOLERANCE, max_depth: DEPTH };
    let start = Instant::now();
    let stacked = truth(&options.out.join("truths"), label, scenery, &reference)?.image;
    println!("{label}: cast in {:.1} s", start.elapsed().as_secs_f64());
    let extent = scenery.camera.extent();
    let of = |c: usize| {
        let from = if stacked.values().len() > extent.pixels() { c * extent.pixels() } else { 0 };
        Image::from_values(extent, stacked.values()[from..from + extent.pixels()].to_vec())
    };
    Ok([of(0)?, of(1)?, of(2)?])
}

/// Panels in rows, each row under the tone of its last panel (the ray caster's) with a window of its own.
fn write(options: &Options, name: &str, rows: &[Vec<Panel>]) -> Outcome<()> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let extent = rows[0][0][0].extent();
    let (w, h) = (extent.width, extent.height);
    let (width, height) = (columns * (w + GAP) - GAP, rows.len() * (h + GAP) - GAP);
    let mut pixels = vec![[255u8; 3]; width * height];
    let tone = Tone { window: [0.0, 99.7], ..Tone::default() };
    for (r, row) in rows.iter().enumerate() {
        let Some(last) = row.last() else { continue };
        let [_, top] = tone.limits(&film::largest(last));
        for (c, panel) in row.iter().enumerate() {
            for n in 0..w * h {
                let rgb: [f64; 3] = std::array::from_fn(|k| (panel[k].values()[n] / top).max(0.0));
                // As the library's tone: too bright pixels keep their hue. A square root brightens the dark, as displays expect.
                let over = rgb.iter().copied().fold(1.0, f64::max);
                let levels = rgb.map(|v| ((v / over).sqrt() * LEVELS).round() as u8 * (255 / LEVELS as u8));
                pixels[(r * (h + GAP) + n / w) * width + c * (w + GAP) + n % w] = levels;
            }
        }
    }
    Ok(film::write_rgb8(Extent::new(width, height)?, &pixels, &options.out.join(name))?)
}

fn lobster(volume: &Volume, map: DensityMap, effects: Effects) -> Outcome<Scenery> {
    let camera = scenes::camera(volume, scenes::VIEW, Some(18.0), SIDE)?;
    Ok(Scenery::new(volume.clone(), map, camera).with_effects(effects))
}

/// The image turned by half a turn: the head's slices run from top to bottom.
fn upside_down(camera: &Camera, grid: &Grid) -> Outcome<Camera> {
    let mut m = camera.world_to_pixel();
    let extent = camera.extent();
    let depth = m[2];
    for (row, side) in m.iter_mut().zip([extent.width, extent.height]) {
        row.iter_mut().zip(depth).for_each(|(v, z)| *v = side as f64 * z - *v);
    }
    Ok(Camera::from_matrix(m, extent, grid, Some(camera.near()))?)
}

/// Fewest samples of the fine panels: their noise is below what eyes see.
const FINE: u64 = 1 << 24;

pub fn all(options: &Options) -> Outcome<Value> {
    let volume = LOBSTER.load(&options.data)?;
    let surface = || scenes::piecewise(&SURFACE, None);
    let no_resin = || scenes::piecewise(&scenes::NO_RESIN, None);
    let fine = if options.quick { 1 << 20 } else { FINE };

    let plain = lobster(&volume, no_resin(), Effects::default())?;
    let row = vec![
        drawn(&plain, Method::Mc, 1_000_000)?,
        drawn(&plain, Method::Qmc, fine)?,
        cast(options, "figure 2", &plain)?,
    ];
    write(options, "figure-2.png", &[row])?;

    let light = scenes::around(LIGHT[0], LIGHT[1], Some(LIGHT[2]));
    let shading = Effects { light, shading: Some(Shading { sides: Sides::One }), ..Effects::default() };
    let both = Effects { depth_cue: Some(DepthCue { minimum: Some(20.0) }), ..shading.clone() };
    let mut rows = vec![];
    for (label, effects) in [("figure 3 shading", shading), ("figure 3 shading + depth cue", both)] {
        let scenery = lobster(&volume, surface(), effects)?;
        rows.push(vec![
            drawn(&scenery, Method::Mc, 1_000_000)?,
            drawn(&scenery, Method::Qmc, fine)?,
            cast(options, label, &scenery)?,
        ]);
    }
    write(options, "figure-3.png", &rows)?;

    // The lobster's own depths, not those of the whole block, so that all hues are used.
    let depth = volume.grid().diameter() * 2.0;
    let depth_colour = Some(DepthColour { range: Some([depth - 75.0, depth + 75.0]), stops: None });
    let scenery = lobster(&volume, no_resin(), Effects { depth_colour, ..Effects::default() })?;
    let row = vec![
        drawn(&scenery, Method::Mc, 1_000_000)?,
        drawn(&scenery, Method::Qmc, fine)?,
        cast(options, "figure 4", &scenery)?,
    ];
    write(options, "figure-4.png", &[row])?;

    let materials =
        vec![material("shell", 35.0, Some(75.0), "#ff6a00", 1.0)?, material("meat", 75.0, None, "#ffffff", 0.35)?];
    let effects = Effects { materials, unlisted: Some(Unlisted::default()), ..Effects::default() };
    let scenery = lobster(&volume, DensityMap::default(), effects)?;
    let row = vec![drawn(&scenery, Method::Qmc, fine)?, cast(options, "materials lobster", &scenery)?];
    write(options, "materials-lobster.png", &[row])?;

    let volume = HEAD.load(&options.data)?;
    let materials = vec![
        material("skin", 550.0, Some(900.0), "#ff9060", 2.0)?,
        material("brain", 1000.0, Some(1130.0), "#4080ff", 0.2)?,
        material("bone", 1400.0, None, "#ffffff", 0.5)?,
    ];
    let effects = Effects { materials, unlisted: Some(Unlisted::default()), ..Effects::default() };
    let camera = upside_down(&scenes::camera(&volume, [-60.0, -10.0], Some(22.0), SIDE)?, volume.grid())?;
    let scenery = Scenery::new(volume, DensityMap::default(), camera).with_effects(effects);
    let row = vec![drawn(&scenery, Method::Qmc, fine)?, cast(options, "materials head", &scenery)?];
    write(options, "materials-head.png", &[row])?;

    Ok(json!({ "fine": fine, "tolerance": TOLERANCE, "depth": DEPTH, "light": LIGHT, "surface": SURFACE }))
}

/// The light of Figure 3: degrees around and above the volume's centre, and millimetres from it. A little beside the eye.
const LIGHT: [f64; 3] = [-40.0, 55.0, 200.0];
