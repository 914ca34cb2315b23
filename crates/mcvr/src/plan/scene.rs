//! The plan of a whole scene.

use mcvr_footprint::FootprintError;
use mcvr_scene::film::Film;
use mcvr_scene::{Extent, Look, Watch};
use serde_json::json;

use super::effects::per_sample;
use super::sampled::{draws, sampled, weight_bytes};
use super::{Forecast, LeftOut, Pass, Plan, film_pass, grouped};
use crate::request::footprint_options;
use crate::{MakeError, Method, Request, Scenery};

/// Plans the image that [`make`](crate::make()) will make, without reading a voxel.
///
/// # Errors
/// [`MakeError`] for what [`make`](crate::make()) refuses as well, as far as it shows without reading voxels.
pub fn plan(scenery: &Scenery, request: &Request, film: &Film) -> Result<Plan, MakeError> {
    crate::request::check(request)?;
    film.check()?;
    let grid = scenery.volume.grid();
    let look = scenery.effects.look(grid, &scenery.camera)?;
    let (mut passes, mut left_out) = (vec![], vec![]);
    passes.push(Pass {
        name: "volume",
        why: format!("volume.input = {}", scenery.volume.name()),
        reads: format!("{} voxels of type {}", grouped(grid.len() as u64), scenery.volume.voxel_type()),
        // Mapped pages can be given back; they count as held all the same.
        holds: scenery.volume.bytes() as u64,
        work: vec![],
    });
    passes.push(Pass {
        name: "weights",
        why: weights_why(scenery),
        reads: "each voxel once, for the mass".to_owned(),
        holds: weight_bytes(scenery),
        work: vec![],
    });
    if request.method == Method::Footprint {
        passes.push(footprint(scenery, request, &look)?);
    } else if request.method.samples_volume() {
        sampled(scenery, request, &look, &mut passes, &mut left_out)?;
    } else {
        cast(scenery, request, &look, &mut passes);
    }
    let pixels = scenery.camera.extent().pixels() as u64;
    match film_pass(film, pixels) {
        Some(pass) => passes.push(pass),
        None => {
            left_out.push(LeftOut { name: "film", why: "no film.transmission, no film.photons".into(), work: vec![] })
        }
    }
    let bytes = passes.iter().map(|p| p.holds).sum();
    Ok(Plan { passes, left_out, bytes })
}

fn weights_why(scenery: &Scenery) -> String {
    let map = &scenery.map;
    let mut why = format!("density.transfer = {}", json!(map.transfer).to_string().replace('"', ""));
    if let Some(e) = map.emphasis {
        why += &format!(", emphasis x{} from {}", e.gain, e.threshold);
    }
    if map.concentrate {
        why += ", density.concentrate";
    }
    if map.gains.is_some() {
        why += ", weights of effects.materials";
    }
    why
}

/// Passes of an image made of rays. Every counter of the ray casters is named; what a ray meets only the voxels and, for
/// the exact method, the tolerance decide.
fn cast(scenery: &Scenery, request: &Request, look: &Look, passes: &mut Vec<Pass>) {
    let pixels = scenery.camera.extent().pixels() as u64;
    let march = request.method != Method::Exact;
    let exact = request.method == Method::Rays;
    let prefix = if march { "march" } else { "reference" };
    let each = if march {
        u64::from(crate::request::rays_per_pixel(request.samples, &scenery.camera, request.jitter))
    } else {
        0
    };
    // Adaptive rays: at most all of the finest distance, and of those before.
    let adaptive = request.adaptive.is_some();
    let finest = 4 * u64::from(mcvr_raycast::AdaptiveOptions::RAYS_LIMIT) / 3 + 2;
    // Means over pixels need the rays of a margin of two pixels.
    let averages = matches!(request.method, Method::Rays | Method::Comb) && !request.jitter && look.is_plain();
    let block = if averages { crate::request::block(request.samples, &scenery.camera) } else { 1 };
    let across = |pixels: usize| pixels.div_ceil(block as usize) as u64 + 4;
    let Extent { width, height } = scenery.camera.extent();
    let cast = if averages { across(width) * across(height) } else { pixels };
    let mut work = match (adaptive, march) {
        (true, _) => vec![],
        (_, true) => vec![Forecast::exact("rays_per_pixel", each)],
        _ => vec![Forecast::between("depth_limited", 0, pixels)],
    };
    if block > 1 && !adaptive {
        work.push(Forecast::exact("pixels_per_ray", u64::from(block * block)));
    }
    let counters = json!(mcvr_raycast::Counters::default());
    for counter in counters.as_object().into_iter().flatten().map(|(name, _)| name) {
        let name = format!("{prefix}.{counter}");
        work.push(match (march, &counter[..]) {
            (true, "rays") if adaptive => {
                // The margin is 16 pixels, and whole squares of as many are cast.
                let across = |pixels: usize| (pixels.next_multiple_of(16) + 32) as u64;
                Forecast::between(&name, 0, finest.saturating_mul(across(width) * across(height)))
            }
            (true, "rays") => Forecast::between(&name, 0, each.saturating_mul(cast)),
            // A march knows no cells, and packets leap over bricks a tile at a time, uncounted.
            (true, "cells") if exact => Forecast::from(&name, 0),
            (true, "empty_bricks") if exact => Forecast::from(&name, 0),
            (true, "cells" | "empty_bricks") => Forecast::exact(&name, 0),
            (_, "gradients") if look.shading.is_none() => Forecast::exact(&name, 0),
            (_, "colours") if look.palette.is_none() && look.ramp.is_none() => Forecast::exact(&name, 0),
            _ => Forecast::from(&name, 0),
        });
    }
    passes.push(Pass {
        name: if march { "march" } else { "cast" },
        why: format!("sampling.method = {}", request.method),
        reads: "voxels along rays".to_owned(),
        holds: 16 * pixels * look.channels() as u64,
        work,
    });
}

/// The pass of an image made of footprints: which voxels have weight, only the voxels say.
fn footprint(scenery: &Scenery, request: &Request, look: &Look) -> Result<Pass, MakeError> {
    if !look.is_plain() {
        return Err(FootprintError::Effects.into());
    }
    let grid = scenery.volume.grid();
    let options = footprint_options(request);
    options.check(grid)?;
    let voxels = grid.len() as u64;
    let most = voxels.saturating_mul(mcvr_footprint::footprints_of_a_voxel(grid, &options));
    let pixels = scenery.camera.extent().pixels() as u64;
    Ok(Pass {
        name: "footprints",
        why: format!("sampling.method = {}", request.method),
        reads: "voxels of occupied bricks".to_owned(),
        holds: 8 * pixels * look.channels() as u64 + mcvr_footprint::sums_bytes(&scenery.camera),
        work: vec![
            Forecast::between("footprint.voxels_visited", 0, voxels),
            Forecast::between("footprint.footprints", 0, most),
            Forecast::from("footprint.pixels_touched", 0),
        ],
    })
}

impl Plan {
    /// Draws the points, as a plain count without the effects, and so turns the ranges that depend on the draws into numbers. Rays and
    /// footprints have no draws; their plans stay as they are.
    ///
    /// # Errors
    /// As [`make`](crate::make()).
    pub fn draw(&mut self, scenery: &Scenery, request: &Request, watch: &Watch<'_>) -> Result<(), MakeError> {
        if !request.method.samples_volume() {
            return Ok(());
        }
        let mut counters = draws(scenery, request, watch)?;
        let inside = counters["render"]["inside"].as_u64().unwrap_or(0);
        let samples = counters["render"]["samples"].as_u64().unwrap_or(0);
        let line = request.estimand == mcvr_scene::Estimand::Line;
        let look = scenery.effects.look(scenery.volume.grid(), &scenery.camera)?;
        // What the bare image did not do follows from the samples in it.
        let render = &mut counters["render"];
        render["line_weights"] = json!(if line { samples } else { 0 });
        for (counter, each) in per_sample(&look) {
            render[counter] = json!(each * inside);
        }
        self.narrow(&counters);
        Ok(())
    }
}
