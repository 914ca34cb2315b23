//! Passes of the sampling methods.

use mcvr_sampling::{BLOCK, Distribution, block_count};
use mcvr_scene::{Camera, Estimand, Kernel, Look};
use mcvr_volume::Grid;

use super::{Forecast, LeftOut, Pass, effects::effects, grouped};
use crate::{MakeError, Method, Request, Scenery};

/// Voxels of a brick.
const BRICK: u64 = 256;

/// What is certain of all samples of the grid, whatever the voxels: that they lie beyond the near plane, and that they fall
/// into the image.
fn certain_of_all(grid: &Grid, camera: &Camera, kernel: Kernel) -> (bool, bool) {
    // Half a pixel, and a millionth of the depth, for the projection's rounding.
    let (w, h) = (camera.extent().width as f64 - 0.5, camera.extent().height as f64 - 0.5);
    let corners = grid.corners(kernel.support()).map(|corner| camera.project(corner));
    let furthest = corners.iter().map(|(_, _, z)| z.abs()).fold(0.0, f64::max);
    let ahead = camera.is_parallel() || corners.iter().all(|(_, _, z)| *z > camera.near() + 1e-6 * furthest);
    let within = corners.iter().all(|(px, py, _)| *px >= 0.5 && *px <= w && *py >= 0.5 && *py <= h);
    (ahead, ahead && within)
}

/// Passes of an image made of samples.
pub(super) fn sampled(
    scenery: &Scenery,
    request: &Request,
    look: &Look,
    passes: &mut Vec<Pass>,
    left_out: &mut Vec<LeftOut>,
) -> Result<(), MakeError> {
    let Scenery { volume, map, camera, .. } = scenery;
    let Request { method, samples, kernel, estimand, .. } = *request;
    let grid = volume.grid();
    let order = request.order.resolve(camera, grid);
    let (survey, seen) = Distribution::survey(volume, map, order, request.cull.then_some((camera, kernel)))?;
    let bricks = survey.bricks - survey.bricks_beside - survey.bricks_near;
    passes.push(Pass {
        name: "distribution",
        why: format!("sampling.method = {method}"),
        reads: format!("{} voxels of {}", grouped(survey.voxels_read), grouped(grid.len() as u64)),
        holds: survey.bytes,
        work: vec![
            Forecast::exact("distribution.voxels_read", survey.voxels_read),
            Forecast::exact("distribution.bricks", survey.bricks),
            Forecast::between("distribution.empty_bricks", 0, bricks),
            Forecast::exact("distribution.bricks_beside", survey.bricks_beside),
            Forecast::exact("distribution.bricks_near", survey.bricks_near),
            Forecast::exact("distribution.bytes", survey.bytes),
        ],
    });
    left_out.push(culled(request, &survey));

    // With everything culled nothing is drawn at all; whether the rest has weight only the voxels know.
    let drawn = if bricks == 0 { 0 } else { samples };
    let certain = survey.bricks_beside + survey.bricks_near == 0;
    let fewest = if certain { drawn } else { 0 };
    let most = match method {
        Method::McBinary => drawn,
        Method::McLinear => drawn.saturating_mul(survey.bricks),
        // Targets rise: a brick is decoded once, and once more for each block that begins inside it.
        _ => drawn.min((bricks + block_count(samples)).saturating_sub(1)),
    };
    let voxels = match method {
        Method::McBinary => drawn.saturating_mul(BRICK),
        Method::McLinear => drawn.saturating_mul(grid.len() as u64),
        _ => most.saturating_mul(BRICK).min(seen + block_count(samples).saturating_mul(BRICK)),
    };
    passes.push(Pass {
        name: "draw",
        why: format!("sampling.samples = {samples}, method = {method}, seed = {}", request.seed),
        reads: format!("the bricks that samples fall into, of {}", grouped(bricks)),
        holds: stream_bytes(method, samples),
        work: vec![
            Forecast::between("render.samples", fewest, drawn),
            Forecast::between("render.bricks_decoded", fewest.min(1), most),
            Forecast::between("render.voxels_read", fewest.min(1), voxels),
        ],
    });

    let (ahead, within) = certain_of_all(grid, camera, kernel);
    let inside = if certain && within { (drawn, drawn) } else { (0, drawn) };
    let rest = drawn - inside.0;
    let line = estimand == Estimand::Line;
    let weights = Forecast::between("render.line_weights", if line { fewest } else { 0 }, if line { drawn } else { 0 });
    let mut work = vec![
        Forecast::between("render.inside", inside.0, inside.1),
        Forecast::between("render.outside", 0, rest),
        Forecast::between("render.clipped", 0, if ahead { 0 } else { rest }),
    ];
    if line {
        work.push(weights);
    } else {
        let why = "image.estimand = count".to_owned();
        left_out.push(LeftOut { name: "line weights", why, work: vec![weights] });
    }
    passes.push(Pass {
        name: "project",
        why: format!("image.kernel = {kernel}, estimand = {estimand}"),
        reads: "samples in blocks of 2048".to_owned(),
        holds: 0,
        work,
    });
    effects(look, inside, grid.len() as u64, passes, left_out);
    let pixels = camera.extent().pixels() as u64;
    let slots = look.channels() as u64 * pixels + 2;
    let entry = if line || !look.is_plain() { 8 } else { 4 };
    let workers = (rayon::current_num_threads() as u64).min(block_count(samples));
    let images = if look.is_coloured() { 4 } else { 1 };
    passes.push(Pass {
        name: "accumulate",
        why: format!("image.size = {}, {} channel(s)", camera.extent(), look.channels()),
        reads: "pixels and amounts of each block".to_owned(),
        // Sums per worker while they are small, one set for all, the finished images, and blocks.
        holds: slots * (8 + entry * workers) + 8 * images * pixels + workers * (BLOCK as u64) * 160,
        work: vec![],
    });
    Ok(())
}

fn culled(request: &Request, survey: &mcvr_sampling::DistributionCounters) -> LeftOut {
    LeftOut {
        name: "unseen bricks",
        why: if request.cull {
            format!(
                "{} of {} bricks lie beside the image, {} in front of the near plane",
                grouped(survey.bricks_beside),
                grouped(survey.bricks),
                grouped(survey.bricks_near)
            )
        } else {
            "sampling.cull = false: none, so that the points are those of a cloud".to_owned()
        },
        work: vec![],
    }
}

/// Bytes that a method's stream keeps.
fn stream_bytes(method: Method, samples: u64) -> u64 {
    match method {
        Method::McQuicksort => 8 * samples,
        // Running sums of Gamma variates.
        Method::Mc => mcvr_mc::OrderStatistics::bytes(samples),
        _ => 0,
    }
}

/// Bytes of what weights are looked up in: a table, or the voxels of moved weights.
pub(super) fn weight_bytes(scenery: &Scenery) -> u64 {
    if scenery.map.concentrate {
        return 4 * scenery.volume.grid().len() as u64;
    }
    scenery.volume.voxel_type().cardinality().map_or(0, |n| 8 * n as u64)
}

/// The counters of the draws alone: points are drawn, found and projected, nothing else.
pub(super) fn draws(
    scenery: &Scenery,
    request: &Request,
    watch: &mcvr_scene::Watch<'_>,
) -> Result<serde_json::Value, MakeError> {
    let Scenery { volume, map, camera, .. } = scenery;
    let bare = Scenery::new(volume.clone(), map.clone(), camera.clone());
    let count = Request { estimand: Estimand::Count, ..*request };
    Ok(crate::make(&bare, &count, watch)?.counters)
}
