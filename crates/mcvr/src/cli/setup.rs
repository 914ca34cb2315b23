//! From arguments and a scene file to a scenery and a request.

use std::path::Path;
use std::time::Instant;

use anyhow::bail;
use mcvr::scene::film::{Film, Tone};
use mcvr::scene::{Camera, DensityMap, Extent, View};
use mcvr::volume::{FileFormat, Grid, RawOptions};
use mcvr::{Adaptive, CameraSection, ErrorSection, Method, Request, SceneFile, Scenery};
use serde_json::{Value, json};

use super::args::{BudgetArgs, DensityArgs, ImageArgs, MethodArgs, ToneArgs, ViewArgs, VolumeArgs};
use super::effect_args::EffectArgs;
use super::sample::ends;

/// Everything that a command needs to make images.
pub struct Setup {
    pub scenery: Scenery,
    pub request: Request,
    pub tone: Tone,
    pub format: FileFormat,
    pub notes: Vec<String>,
    /// Name of the input as given.
    pub input: String,
    pub load_seconds: f64,
    /// The view in words.
    pub view: String,
    /// The scene's cameras, at least one; the scenery has the first.
    pub views: Vec<Viewpoint>,
    /// The scene's film.
    pub film: Film,
    /// The error that the scene asks for.
    pub error: ErrorSection,
    /// Samples, where they were given.
    pub samples: Option<u64>,
}

/// A camera of a scene.
#[derive(Clone)]
pub struct Viewpoint {
    pub camera: Camera,
    /// Name or number.
    pub label: String,
    /// In words.
    pub words: String,
}

/// The scene file that was asked for, as --scene or in the volume's place, or an empty one; and the volume's arguments
/// without it.
pub fn scene_file(volume: &VolumeArgs, method: &MethodArgs) -> anyhow::Result<(SceneFile, VolumeArgs)> {
    let mut volume = volume.clone();
    let mut path = method.scene.clone();
    if volume.input.as_deref().is_some_and(|i| ends(Path::new(i), "toml")) {
        let positional = volume.input.take().unwrap_or_default();
        if let Some(other) = &path {
            bail!("{positional} and --scene {} are two scenes; give one of them", other.display());
        }
        path = Some(positional.into());
    }
    Ok((path.as_deref().map(SceneFile::read).transpose()?.unwrap_or_default(), volume))
}

/// The setup of all that decides an image.
pub fn image_setup(args: &ImageArgs, tone: &ToneArgs) -> anyhow::Result<Setup> {
    setup(&args.volume, &args.density, &args.view, &args.method, &args.budget, tone, &args.effects)
}

/// Loads the volume and joins arguments, scene and defaults, in this order of precedence.
pub fn setup(
    volume: &VolumeArgs,
    density: &DensityArgs,
    view: &ViewArgs,
    method: &MethodArgs,
    budget: &BudgetArgs,
    tone: &ToneArgs,
    effects: &EffectArgs,
) -> anyhow::Result<Setup> {
    let (scene, volume) = scene_file(volume, method)?;
    let (input, options) = volume_options(&volume, &scene);
    let Some(input) = input else {
        bail!("no volume: give a file or phantom:NAME (see `mcvr info --phantoms`), or a scene file with volume.input")
    };
    let start = Instant::now();
    let loaded = mcvr::volume::load(&input, Some(&options)).map_err(|e| hinted(e, &input))?;
    let load_seconds = start.elapsed().as_secs_f64();

    let base = scene.density.clone().unwrap_or_default();
    let map = DensityMap {
        transfer: density.map.clone().unwrap_or(base.transfer),
        emphasis: density.emphasis().or(base.emphasis),
        negative: density.negative.unwrap_or(base.negative),
        concentrate: density.concentrate || base.concentrate,
        gains: None,
    };
    let views = views(view, method.camera.as_deref(), &scene, loaded.volume.grid())?;
    let Some(Viewpoint { camera, words: view, .. }) = views.first().cloned() else { bail!("no camera") };
    let defaults = Request::default();
    let (image, sampling) = (&scene.image, &scene.sampling);
    let samples = budget.samples.or(sampling.samples);
    let request = Request {
        method: budget.method.or(sampling.method).unwrap_or_default(),
        samples: samples.unwrap_or(1 << 22),
        seed: method.seed.or(sampling.seed).unwrap_or(defaults.seed),
        kernel: method.kernel.or(image.kernel).unwrap_or_default(),
        estimand: method.estimand.or(image.estimand).unwrap_or_default(),
        order: method.order.or(sampling.order).unwrap_or_default(),
        scramble: method.scramble.or(sampling.scramble).unwrap_or_default(),
        step: method.step.or(sampling.step).unwrap_or(defaults.step),
        error: defaults.error,
        jitter: method.jitter || sampling.jitter.unwrap_or(defaults.jitter),
        adaptive: method.adaptive.or(sampling.adaptive).map(Adaptive::leaving),
        cull: !method.no_cull && sampling.cull.unwrap_or(defaults.cull),
        tolerance: method.tolerance.or(sampling.tolerance).unwrap_or(defaults.tolerance),
    };
    if request.method == Method::Auto {
        let by_scene = sampling.method == Some(Method::Auto);
        let given = [
            ("samples", budget.samples.is_some() || by_scene && sampling.samples.is_some()),
            ("jitter", method.jitter || by_scene && sampling.jitter.is_some()),
            ("rays", method.adaptive.is_some() || by_scene && sampling.adaptive.is_some()),
            ("step", method.step.is_some() || by_scene && sampling.step.is_some()),
        ];
        if let Some((name, _)) = given.iter().find(|(_, given)| *given) {
            bail!(
                "--method auto chooses the {name} itself: leave {name} out, or name a method; --error says what auto is to reach"
            );
        }
    }
    if request.adaptive.is_some() {
        if ![Method::Comb, Method::Rays, Method::Auto].contains(&request.method) {
            bail!(
                "--adaptive says where rays are cast, and {} casts none so: use --method comb or rays",
                request.method
            );
        }
        if samples.is_some() {
            bail!("--adaptive casts as many rays as the image needs: leave samples out, or leave --adaptive out");
        }
        if request.jitter {
            bail!("--adaptive tells the image between rays on a grid: leave --jitter out, or leave --adaptive out");
        }
    }
    let base = scene.tone.unwrap_or_default();
    let tone = Tone {
        curve: tone.tone.unwrap_or(base.curve),
        invert: tone.invert || base.invert,
        window: tone.window.unwrap_or(base.window),
    };
    let film = scene.film.unwrap_or_default();
    let effects = effects.join(scene.effects.unwrap_or_default());
    effects.check()?;
    let scenery = Scenery::new(loaded.volume, map, camera).with_effects(effects);
    let (format, notes) = (loaded.format, loaded.notes);
    let error = scene.error;
    Ok(Setup { scenery, request, tone, format, notes, input, load_seconds, view, views, film, error, samples })
}

/// Input and raw geometry from flags and scene.
pub fn volume_options(args: &VolumeArgs, scene: &SceneFile) -> (Option<String>, RawOptions) {
    let file = &scene.volume;
    let options = RawOptions {
        dims: args.dims.or(file.dims),
        voxel_type: args.voxel_type.or(file.voxel_type),
        endian: args.endian.or(file.endian),
        spacing: args.spacing.or(file.spacing),
        skip: args.skip.or(file.skip).unwrap_or(0),
    };
    (args.input.clone().or_else(|| file.input.clone()), options)
}

/// An error about a missing file, with the hint that phantoms exist.
fn hinted(error: mcvr::volume::VolumeError, input: &str) -> anyhow::Error {
    let name = input.split('@').next().unwrap_or(input);
    let phantom = mcvr::volume::Phantom::names().any(|(n, _)| n == name) && !Path::new(input).exists();
    if phantom { anyhow::anyhow!("{error}; did you mean phantom:{input}?") } else { anyhow::Error::new(error) }
}

/// The cameras of flags, scene and defaults: those of the scene, or the one that is picked. A view or a matrix among the
/// flags stands for them all.
fn views(args: &ViewArgs, pick: Option<&str>, scene: &SceneFile, grid: &Grid) -> anyhow::Result<Vec<Viewpoint>> {
    let all: Vec<(String, CameraSection)> =
        scene.cameras.iter().enumerate().map(|(i, c)| (c.label(i), c.clone())).collect();
    let labels = || all.iter().map(|(l, _)| l.clone()).collect::<Vec<_>>().join(", ");
    let chosen = match pick {
        Some(pick) if all.is_empty() => bail!("--camera {pick}: no scene file with cameras is given"),
        Some(pick) => {
            let number = pick.parse::<usize>().ok().and_then(|n| n.checked_sub(1));
            let found = all.iter().find(|(label, _)| label == pick).or_else(|| all.get(number?));
            let Some(found) = found else { bail!("--camera {pick}: the scene's cameras are {}", labels()) };
            vec![found.clone()]
        }
        None if all.is_empty() || (all.len() > 1 && (args.view.is_some() || args.matrix.is_some())) => {
            vec![("1".into(), CameraSection::default())]
        }
        None => all,
    };
    chosen
        .into_iter()
        .map(|(label, section)| {
            let (camera, words) = camera(args, &section, scene.image.size, grid)?;
            Ok(Viewpoint { camera, label, words })
        })
        .collect()
}

/// The camera of flags, a section and defaults, and the view in words.
pub fn camera(
    args: &ViewArgs,
    file: &CameraSection,
    size: Option<[usize; 2]>,
    grid: &Grid,
) -> anyhow::Result<(Camera, String)> {
    let extent = match (args.size, size) {
        (Some(size), _) => size,
        (None, Some([w, h])) => Extent::new(w, h)?,
        (None, None) => Extent::new(400, 400)?,
    };
    let near = args.near.or(file.near);
    let angles_given = args.view.is_some() || args.distance.is_some() || args.fov.is_some() || args.parallel;
    let matrix = match &args.matrix {
        Some(path) => Some(mcvr::read_matrix(path)?),
        None if angles_given => None,
        None => file.matrix,
    };
    if let Some(matrix) = matrix {
        let source = args.matrix.as_ref().map_or("scene".into(), |p| p.display().to_string());
        return Ok((Camera::from_matrix(matrix, extent, grid, near)?, format!("matrix from {source}")));
    }
    let defaults = View::default();
    let [azimuth, elevation] = args.view.or(file.view).unwrap_or([defaults.azimuth, defaults.elevation]);
    let view = View {
        azimuth,
        elevation,
        distance: args.distance.or(file.distance),
        fov: args.fov.or(file.fov),
        parallel: args.parallel || file.parallel.unwrap_or(false),
        near,
    };
    let distance = view.distance.map_or("two diameters".into(), |d| format!("{d} mm"));
    let kind = if view.parallel { "parallel" } else { "pinhole" };
    let fov = view.fov.map_or(String::new(), |f| format!(", field of view {f}°"));
    Ok((
        Camera::look(&view, grid, extent)?,
        format!("{kind}, azimuth {azimuth}°, elevation {elevation}°, {distance} away{fov}"),
    ))
}

impl Setup {
    /// Refuses scenes of several cameras, which a measurement cannot have.
    pub fn check_one_camera(&self, command: &str) -> anyhow::Result<()> {
        if self.views.len() > 1 {
            let labels: Vec<&str> = self.views.iter().map(|v| v.label.as_str()).collect();
            bail!("{command} measures one camera, and the scene has {}: choose with --camera", labels.join(", "));
        }
        Ok(())
    }

    /// Refuses effects that a camera cannot have, before the work.
    pub fn check_effects(&self) -> anyhow::Result<()> {
        for view in &self.views {
            self.scenery.effects.look(self.scenery.volume.grid(), &view.camera)?;
        }
        Ok(())
    }

    /// The geometry as the JSON record has it.
    pub fn geometry(&self) -> Value {
        let (volume, camera) = (&self.scenery.volume, &self.scenery.camera);
        let grid = volume.grid();
        let direction = grid.direction().transpose().to_cols_array_2d();
        json!({
            "volume": {
                "input": self.input,
                "format": self.format.to_string(),
                "dims": grid.dims(),
                "type": volume.voxel_type().name(),
                "slope": volume.slope(),
                "intercept": volume.intercept(),
                "origin": grid.origin().to_array(),
                "spacing": grid.spacing().to_array(),
                "direction": direction,
                "notes": self.notes,
            },
            "camera": {
                "world_to_pixel": camera.world_to_pixel(),
                "width": camera.extent().width,
                "height": camera.extent().height,
                "parallel": camera.is_parallel(),
                "near": if camera.is_parallel() { Value::Null } else { json!(camera.near()) },
                "view": self.view,
            },
        })
    }
}
