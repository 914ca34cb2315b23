//! The passes of the effects, and those left out.

use mcvr_scene::Look;

use super::{Forecast, LeftOut, Pass, grouped};

/// How often each counter of an effect counts for one sample in the image.
pub(super) fn per_sample(look: &Look) -> [(&'static str, u64); 5] {
    let on = |effect: bool| u64::from(effect);
    [
        ("gradients", on(look.shading.is_some())),
        ("gradient_reads", 32 * on(look.shading.is_some())),
        ("depth_cues", on(look.cue_minimum.is_some())),
        ("voxel_colours", on(look.palette.is_some())),
        ("depth_colours", on(look.ramp.is_some())),
    ]
}

/// Adds a pass for each effect that the look has, and says of the others why they are absent. `inside` is the number of
/// samples in the image, to which alone effects are applied.
pub(super) fn effects(
    look: &Look,
    inside: (u64, u64),
    voxels: u64,
    passes: &mut Vec<Pass>,
    left_out: &mut Vec<LeftOut>,
) {
    let each = per_sample(look);
    let mut effect = |on: bool, name: &'static str, key: &str, why: String, reads: &str, counters: &[&str]| {
        let work = each.iter().filter(|(counter, _)| counters.contains(counter));
        let work =
            work.map(|(c, each)| Forecast::between(&format!("render.{c}"), each * inside.0, each * inside.1)).collect();
        if on {
            passes.push(Pass { name, why, reads: reads.to_owned(), holds: 0, work });
        } else {
            left_out.push(LeftOut { name, why: format!("no {key}"), work });
        }
    };
    effect(
        look.shading.is_some(),
        "shade",
        "effects.shading",
        look.shading.map_or_else(String::new, |s| format!("effects.shading, {s:?}-sided").to_lowercase()),
        "32 voxels around each sample in the image",
        &["gradients", "gradient_reads"],
    );
    effect(
        look.cue_minimum.is_some(),
        "depth cue",
        "effects.depth-cue",
        look.cue_minimum.map_or_else(String::new, |m| format!("effects.depth-cue, at least {m:.4} mm from the light")),
        "positions",
        &["depth_cues"],
    );
    effect(
        look.palette.is_some(),
        "materials",
        "effects.materials",
        "effects.materials".to_owned(),
        "the drawn voxel of each sample in the image",
        &["voxel_colours"],
    );
    effect(
        look.ramp.is_some(),
        "depth colour",
        "effects.depth-colour",
        look.ramp
            .as_ref()
            .map_or_else(String::new, |r| format!("effects.depth-colour, {:.4}..{:.4} mm", r.range()[0], r.range()[1])),
        "positions",
        &["depth_colours"],
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
