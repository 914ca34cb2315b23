//! The passes of the effects, and those left out.

use mcvr_scene::Look;

use super::{Forecast, LeftOut, Pass, grouped};

/// Adds a pass for each effect that the look has, and says of the others why they are absent. `inside` is the number of
/// samples in the image, to which alone effects are applied.
pub(super) fn effects(
    look: &Look,
    inside: (u64, u64),
    voxels: u64,
    passes: &mut Vec<Pass>,
    left_out: &mut Vec<LeftOut>,
) {
    let per_sample = |counter: &str, each: u64| Forecast::between(counter, each * inside.0, each * inside.1);
    let mut effect = |on: bool, name: &'static str, key: &str, why: String, reads: &str, work: Vec<(&str, u64)>| {
        if on {
            let work = work.iter().map(|(counter, each)| per_sample(counter, *each)).collect();
            passes.push(Pass { name, why, reads: reads.to_owned(), holds: 0, work });
        } else {
            let work = work.iter().map(|(counter, _)| Forecast::exact(counter, 0)).collect();
            left_out.push(LeftOut { name, why: format!("no {key}"), work });
        }
    };
    effect(
        look.shading.is_some(),
        "shade",
        "effects.shading",
        look.shading.map_or_else(String::new, |s| format!("effects.shading, {s:?}-sided").to_lowercase()),
        "32 voxels around each sample in the image",
        vec![("render.gradients", 1), ("render.gradient_reads", 32)],
    );
    effect(
        look.cue_minimum.is_some(),
        "depth cue",
        "effects.depth-cue",
        look.cue_minimum.map_or_else(String::new, |m| format!("effects.depth-cue, at least {m:.4} mm from the light")),
        "positions",
        vec![("render.depth_cues", 1)],
    );
    effect(
        look.palette.is_some(),
        "materials",
        "effects.materials",
        "effects.materials".to_owned(),
        "the drawn voxel of each sample in the image",
        vec![("render.voxel_colours", 1)],
    );
    effect(
        look.ramp.is_some(),
        "depth colour",
        "effects.depth-colour",
        look.ramp
            .as_ref()
            .map_or_else(String::new, |r| format!("effects.depth-colour, {:.4}..{:.4} mm", r.range()[0], r.range()[1])),
        "positions",
        vec![("render.depth_colours", 1)],
    );
    left_out.push(LeftOut {
        name: "gradient field",
        why: if look.shading.is_some() {
            format!(
                "gradients are interpolated at samples from the voxels; a field would hold {} bytes",
                grouped(12 * voxels)
            )
        } else {
            "no effects.shading".to_owned()
        },
        work: vec![Forecast::exact("render.gradient_field", 0)],
    });
    if look.is_coloured() && look.channels() == 1 {
        left_out.push(LeftOut {
            name: "three channels",
            why: "only the light is coloured: its colour multiplies the finished image".to_owned(),
            work: vec![],
        });
    } else if !look.is_coloured() {
        let why = "neither materials nor depth colour nor a coloured light".to_owned();
        left_out.push(LeftOut { name: "three channels", why, work: vec![] });
    }
}
