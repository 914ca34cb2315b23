//! `mcvr sample`

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::bail;
use mcvr::qmc::Scramble;
use mcvr::sampling::{Cloud, Compact, Counters, VoxelOrder};
use mcvr::scene::{Kernel, Watch};
use mcvr::{draw_cloud, write_cloud, write_ply};
use serde_json::{Value, json};

use super::args::{BudgetArgs, DensityArgs, MethodArgs, ToneArgs, ViewArgs, VolumeArgs};
use super::effect_args::EffectArgs;
use super::render::write_json;
use super::setup::{Setup, scene_file, setup};
use super::{Interrupted, outputs, process, progress};

/// How points are drawn.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct DrawArgs {
    #[command(flatten)]
    budget: BudgetArgs,
    /// Reconstruction kernel: box, tent, bspline3, shell [default: tent]
    #[arg(long, help_heading = "Method")]
    kernel: Option<Kernel>,
    /// Key of all randomness; the same seed gives the same points on any number of threads [default: 1]
    #[arg(long, help_heading = "Method")]
    seed: Option<u64>,
    /// Order of the voxels for qmc and stratified: raster, hilbert, y, z [default: raster]
    #[arg(long, help_heading = "Method")]
    order: Option<VoxelOrder>,
    /// Randomisation of the net: linear, owen, nested, shift, none [default: linear]
    #[arg(long, help_heading = "Method")]
    scramble: Option<Scramble>,
    /// Scene file; flags win over it
    #[arg(long, value_name = "FILE.toml", help_heading = "Method")]
    scene: Option<PathBuf>,
    #[command(flatten)]
    density: DensityArgs,
}

impl DrawArgs {
    /// The scene file.
    pub fn scene(&self) -> Option<&Path> {
        self.scene.as_deref()
    }
}

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr sample phantom:lobster -n 2^22 -o lobster.mcvr\n  \
    mcvr sample head.nrrd -n 2^26 --compact -o head.mcvr     half the bytes, and quicker to project\n  \
    mcvr sample head.nrrd --method mc -n 1e6 -o head.ply     for MeshLab, CloudCompare, Blender, Open3D\n\n\
    A cloud takes 12 bytes a point, a compact one 6: its points are sorted by place, and moved by at most 1/2048 of a voxel\n\
    along an axis (1/8192 where points are many), next to a kernel that spreads them over a voxel or more. `mcvr project` reads .mcvr files; PLY is written only. `mcvr render` with the same\n\
    options, the same --order and --no-cull makes the image that `mcvr project` makes of the cloud, bit for bit,\n\
    wherever `mcvr render --json` reports precision f32.")]
pub struct Args {
    #[command(flatten)]
    volume: VolumeArgs,
    /// Point cloud file, repeatable: .mcvr (to be projected), .ply (world mm, for other programs)
    #[arg(long = "output", short, value_name = "FILE", required = true)]
    outputs: Vec<PathBuf>,
    /// Points of .mcvr files in 6 bytes instead of 12, each moved by at most 1/2048 of a voxel along an axis; PLY is not changed
    #[arg(long)]
    compact: bool,
    /// Write what was done as JSON; - for standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    #[command(flatten)]
    draw: DrawArgs,
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    let start = Instant::now();
    for path in &args.outputs {
        if !(ends(path, "mcvr") || ends(path, "ply")) {
            bail!("{}: unknown ending of a point cloud; use .mcvr or .ply", path.display());
        }
    }
    let inputs = [args.draw.scene(), args.volume.file()];
    outputs::check(args.outputs.iter().chain(&args.json), &inputs)?;
    let (setup, mut cloud, counters) = draw(&args.volume, &args.draw, quiet)?;
    let (tables, clouds): (Vec<&PathBuf>, Vec<&PathBuf>) = args.outputs.iter().partition(|p| ends(p, "ply"));
    for path in tables {
        write_ply(&cloud, path)?;
    }
    if args.compact {
        // The words, and a brick's number for each point while they are sorted.
        let bytes = (Compact::BYTES_PER_POINT + 4) * cloud.samples();
        process::check_memory(bytes, &format!("a compact cloud of {} points", cloud.samples()))?;
        cloud = cloud.compacted()?;
    }
    for path in clouds {
        write_cloud(&cloud, path)?;
    }
    if let Some(path) = &args.json {
        let mut record = about(&cloud);
        record["input"] = json!(setup.input);
        record["counters"] = json!(counters);
        record["seconds"] = json!({ "load": setup.load_seconds, "total": start.elapsed().as_secs_f64() });
        record["outputs"] = json!(outputs::names(&args.outputs));
        write_json(path, &record)?;
    }
    if !quiet {
        say!(
            "{} points ({} MB), kernel {}, {} seed {}, in {:.3} s",
            cloud.samples(),
            cloud.bytes() / 1_000_000,
            cloud.kernel(),
            cloud.provenance().method,
            cloud.provenance().seed,
            start.elapsed().as_secs_f64()
        );
    }
    Ok(())
}

/// Loads the volume and draws its cloud with a progress bar.
pub fn draw(volume: &VolumeArgs, args: &DrawArgs, quiet: bool) -> anyhow::Result<(Setup, Cloud, Counters)> {
    let method = MethodArgs {
        kernel: args.kernel,
        seed: args.seed,
        scramble: args.scramble,
        scene: args.scene.clone(),
        ..MethodArgs::default()
    };
    let mut setup = setup(
        volume,
        &args.density,
        &ViewArgs::default(),
        &method,
        &args.budget,
        &ToneArgs::default(),
        &EffectArgs::default(),
    )?;
    let effects = &setup.scenery.effects;
    if effects.shading.is_some() || effects.depth_cue.is_some() || effects.depth_colour.is_some() {
        say!("mcvr: note: points keep the weights of the scene's materials and none of its other effects");
    }
    setup.request.order = args.order.or(scene_file(volume, &method)?.0.sampling.order).unwrap_or(VoxelOrder::Raster);
    let samples = setup.request.samples;
    let bytes = samples.saturating_mul(Cloud::BYTES_PER_POINT);
    process::check_memory(bytes, &format!("a cloud of {samples} points"))?;
    for note in &setup.notes {
        say!("mcvr: note: {note}");
    }
    let cancel = progress::interrupt_flag();
    let bar = progress::bar(samples, quiet);
    let advance = |n: u64| bar.inc(n);
    let watch = Watch { progress: Some(&advance), cancel: Some(&cancel) };
    let drawn = draw_cloud(&setup.scenery.volume, &setup.scenery.map, &setup.request, &watch);
    bar.finish_and_clear();
    match drawn {
        Err(e) if e.is_cancelled() => Err(anyhow::Error::new(Interrupted)),
        other => other.map(|(cloud, counters)| (setup, cloud, counters)).map_err(Into::into),
    }
}

/// A cloud as JSON records have it.
pub fn about(cloud: &Cloud) -> Value {
    let grid = cloud.grid();
    let compact = cloud.compact().map(|c| json!({ "side": c.side(), "bricks": c.bricks().len(), "error": c.error() }));
    json!({
        "samples": cloud.samples(), "mass": cloud.mass(), "kernel": cloud.kernel(), "points": cloud.provenance(),
        "compact": compact, "bytes": cloud.bytes(),
        "volume": {
            "dims": grid.dims(), "origin": grid.origin().to_array(), "spacing": grid.spacing().to_array(),
            "direction": grid.direction().transpose().to_cols_array_2d(),
        },
    })
}

/// Whether a path has an ending, in any case.
pub fn ends(path: &Path, ending: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending))
}
