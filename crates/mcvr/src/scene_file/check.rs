//! Keys that contradict each other, and values that no key accepts.

use mcvr_refine::Goal;
use mcvr_scene::effects::LightPosition;
use mcvr_scene::{Estimand, Extent, SceneError};

use super::{CameraSection, PixelSection, SceneFile};

/// A step on the way to a key.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Step {
    Key(String),
    Index(usize),
}

/// What is wrong, and the key whose line is to be named.
#[derive(Debug)]
pub(super) struct Finding {
    pub(super) place: Vec<Step>,
    pub(super) problem: String,
}

/// A finding at a dotted path.
fn finding(place: &str, problem: impl Into<String>) -> Finding {
    Finding { place: place.split('.').map(|k| Step::Key(k.into())).collect(), problem: problem.into() }
}

/// Checks what can be said without the volume.
pub(super) fn check(scene: &SceneFile) -> Result<(), Finding> {
    if let Some(density) = &scene.density {
        density.check().map_err(|e| located("density", &e, "density.transfer"))?;
    }
    if let Some([width, height]) = scene.image.size {
        Extent::new(width, height).map_err(|e| finding("image.size", format!("image.size: {e}")))?;
    }
    if let Some(tone) = scene.tone {
        let [low, high] = tone.window;
        if !((0.0..high).contains(&low) && high <= 100.0) {
            let problem = format!("tone.window takes two percentiles with 0 <= low < high <= 100, got {low}, {high}");
            return Err(finding("tone.window", problem));
        }
    }
    cameras(&scene.cameras)?;
    error(scene)?;
    effects(scene)?;
    film(scene)
}

/// The finding of a scene error: its message starts with the key, below a section.
fn located(section: &str, error: &SceneError, otherwise: &str) -> Finding {
    let problem = error.to_string();
    let said = problem.split_once(": ").map_or(&problem[..], |(_, said)| said);
    let key = said.split([' ', ':', ',']).next().unwrap_or("");
    let known = ["emphasis", "light", "depth-cue", "depth-colour", "unlisted"];
    let place = match key.split('.').next() {
        Some(first) if known.contains(&first) => format!("{section}.{key}"),
        _ => otherwise.to_owned(),
    };
    finding(&place, problem)
}

fn cameras(cameras: &[CameraSection]) -> Result<(), Finding> {
    for (i, camera) in cameras.iter().enumerate() {
        let at = |key: &str, problem: String| {
            Err(Finding { place: vec![Step::Key("camera".into()), Step::Index(i), Step::Key(key.into())], problem })
        };
        let others = [
            ("view", camera.view.is_some()),
            ("distance", camera.distance.is_some()),
            ("fov", camera.fov.is_some()),
            ("parallel", camera.parallel.is_some()),
        ];
        if let Some((other, _)) = others.iter().find(|(_, given)| camera.matrix.is_some() && *given) {
            let problem =
                format!("camera.matrix and camera.{other} contradict each other: the matrix is the whole camera");
            return at(other, problem);
        }
        let positive = [("distance", camera.distance), ("near", camera.near)];
        if let Some((key, Some(v))) = positive.iter().find(|(_, v)| v.is_some_and(|v| !(v.is_finite() && v > 0.0))) {
            return at(key, format!("camera.{key} must be positive, in mm; got {v}"));
        }
        if let Some(fov) = camera.fov.filter(|f| !(*f > 0.0 && *f < 180.0)) {
            return at("fov", format!("camera.fov must lie between 0 and 180 degrees, got {fov}"));
        }
        if let Some(view) = camera.view.filter(|v| v.iter().any(|a| !a.is_finite())) {
            return at("view", format!("camera.view takes two finite angles in degrees, got {}, {}", view[0], view[1]));
        }
        if let Some(name) = &camera.name {
            let good = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
            if name.is_empty() || name.len() > 64 || !name.chars().all(good) {
                let problem =
                    format!("camera.name becomes part of file names: up to 64 letters, digits, - and _; got {name:?}");
                return at("name", problem);
            }
        }
        let label = |i: usize| cameras[i].label(i);
        if let Some(first) = (0..i).find(|first| label(*first) == label(i)) {
            let problem = format!("cameras {} and {} are both called {:?}", first + 1, i + 1, label(i));
            return at("name", problem);
        }
    }
    Ok(())
}

fn error(scene: &SceneFile) -> Result<(), Finding> {
    let section = &scene.error;
    let one =
        |key: &str, goal: Goal| goal.check().map_err(|e| finding(&format!("error.{key}"), format!("error.{key}: {e}")));
    one("rmse", Goal { error: section.rmse, ..Goal::default() })?;
    one("pixel", Goal { pixel: section.pixel.as_ref().map(PixelSection::goal), ..Goal::default() })?;
    let confidence = section.confidence.unwrap_or(Goal::default().confidence);
    one("confidence", Goal { confidence, ..Goal::default() })?;
    if let Some(time) = section.time.filter(|t| !(t.is_finite() && *t > 0.0)) {
        return Err(finding("error.time", format!("error.time must be positive, in seconds; got {time}")));
    }
    match section.replicates {
        None | Some(8 | 16 | 32 | 64) => Ok(()),
        Some(n) => {
            Err(finding("error.replicates", format!("error.replicates is {n}: 8, 16, 32 or 64 give an error bar")))
        }
    }
}

fn effects(scene: &SceneFile) -> Result<(), Finding> {
    let Some(effects) = &scene.effects else { return Ok(()) };
    effects.check().map_err(|e| {
        located("effects", &e, if effects.materials.is_empty() { "effects" } else { "effects.materials" })
    })?;
    let lit = [("shading", effects.shading.is_some()), ("depth-cue", effects.depth_cue.is_some())];
    let at_eye = matches!(effects.light.position, LightPosition::Eye);
    let parallel = scene.cameras.iter().any(|c| c.parallel == Some(true));
    match lit.iter().find(|(_, on)| *on && at_eye && parallel) {
        None => Ok(()),
        Some((key, _)) => Err(finding(
            &format!("effects.{key}"),
            format!(
                "effects.{key} and camera.parallel contradict each other while the light is at the eye, which a parallel \
                 camera has not; give effects.light.position as world = [x, y, z] or around = {{ azimuth, elevation }}"
            ),
        )),
    }
}

fn film(scene: &SceneFile) -> Result<(), Finding> {
    let Some(film) = scene.film else { return Ok(()) };
    film.check().map_err(|e| {
        let key = if e.to_string().contains("noise-seed") { "film.noise-seed" } else { "film.photons" };
        finding(key, e.to_string())
    })?;
    if !film.is_transmission() {
        return Ok(());
    }
    let key = if film.transmission.is_some() { "film.transmission" } else { "film.photons" };
    if scene.image.estimand == Some(Estimand::Count) {
        let problem = format!(
            "{key} and image.estimand = \"count\" contradict each other: a transmission is exp(-line); use estimand = \"line\""
        );
        return Err(finding(key, problem));
    }
    let Some(effects) = scene.effects.as_ref().and_then(|e| e.first()) else { return Ok(()) };
    Err(finding(
        key,
        format!("{key} and effects.{effects} contradict each other: a transmission is exp(-line) of the plain X-ray"),
    ))
}
