//! `mcvr project`

use std::path::PathBuf;
use std::time::Instant;

use mcvr::sampling::{ProjectOptions, Rendered, SamplingError, project_cloud};
use mcvr::scene::film::{self, ImageFormat, Tone};
use mcvr::scene::{Estimand, Watch};
use mcvr::{CameraSection, read_cloud};
use serde_json::{Value, json};

use super::args::{ToneArgs, ViewArgs};
use super::render::{check_image_memory, write_json};
use super::sample::about;
use super::setup::camera;
use super::{Interrupted, outputs, progress};

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr sample phantom:lobster -n 2^22 -o lobster.mcvr\n  \
    mcvr project lobster.mcvr --view 30,60 -o lobster.png\n  \
    mcvr project lobster.mcvr --view=-90,0 --estimand count -o side.npy --json side.json\n\n\
    The image is that of `mcvr render --no-cull` with the cloud's options, bit for bit, where the record's precision is\n\
    f32. Where a view needs 64-bit arithmetic, the cloud's points keep their 32 bits. A compact cloud (`mcvr sample --compact`)\n\
    gives the image of its points, each moved by at most 1/2048 of a voxel along an axis.")]
pub struct Args {
    /// Point cloud that `mcvr sample` wrote (.mcvr)
    #[arg(value_name = "CLOUD")]
    cloud: PathBuf,
    /// Image file, repeatable: .png (toned), .exr, .tiff, .npy (linear values)
    #[arg(long = "output", short, value_name = "FILE", required = true)]
    outputs: Vec<PathBuf>,
    /// Write what was done as JSON; - for standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// What a pixel means: line (mean line integral) or count (share of samples) [default: line]
    #[arg(long)]
    estimand: Option<Estimand>,
    #[command(flatten)]
    view: ViewArgs,
    #[command(flatten)]
    tone: ToneArgs,
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    let start = Instant::now();
    let formats: Vec<ImageFormat> =
        args.outputs.iter().map(|p| ImageFormat::of(p, args.tone.deep)).collect::<Result<_, _>>()?;
    outputs::check(args.outputs.iter().chain(&args.json), &[Some(&args.cloud), args.view.matrix.as_deref()])?;
    let cloud = read_cloud(&args.cloud)?;
    let load = start.elapsed().as_secs_f64();
    let (camera, view) = camera(&args.view, &CameraSection::default(), None, cloud.grid())?;
    check_image_memory(camera.extent(), 1, &formats)?;
    let estimand = args.estimand.unwrap_or_default();
    let cancel = progress::interrupt_flag();
    let bar = progress::bar(cloud.samples(), quiet);
    let advance = |n: u64| bar.inc(n);
    let watch = Watch { progress: Some(&advance), cancel: Some(&cancel) };
    let made = project_cloud(&cloud, &camera, &ProjectOptions { estimand, ..ProjectOptions::default() }, &watch);
    bar.finish_and_clear();
    let Rendered { image, counters, seconds, precision, .. } = match made {
        Err(SamplingError::Cancelled) => return Err(anyhow::Error::new(Interrupted)),
        other => other?,
    };
    let tone = tone(&args.tone);
    for (path, format) in args.outputs.iter().zip(&formats) {
        film::write(&image, path, *format, &tone)?;
    }
    let clipped = counters.clipped as f64 / counters.samples as f64;
    if clipped > 0.0 {
        say!("mcvr: note: the near plane at {} mm cut {:.3} % of the mass", camera.near(), 100.0 * clipped);
    }
    if let Some(path) = &args.json {
        let mut record = about(&cloud);
        record["estimand"] = json!(estimand);
        record["unit"] = json!(estimand.unit());
        record["precision"] = json!(precision);
        record["counters"] = json!({ "render": counters });
        record["clipped_share"] = json!(clipped);
        record["camera"] = json!({
            "world_to_pixel": camera.world_to_pixel(), "width": camera.extent().width,
            "height": camera.extent().height, "parallel": camera.is_parallel(),
            "near": if camera.is_parallel() { Value::Null } else { json!(camera.near()) }, "view": view,
        });
        record["seconds"] =
            json!({ "load": load, "projection": seconds.total, "total": start.elapsed().as_secs_f64() });
        record["outputs"] = json!(outputs::names(&args.outputs));
        write_json(path, &record)?;
    }
    if !quiet {
        say!("{} points projected in {:.4} s, estimand {estimand}; {view}", cloud.samples(), seconds.total);
    }
    Ok(())
}

/// The tone of flags and defaults.
pub fn tone(args: &ToneArgs) -> Tone {
    let base = Tone::default();
    Tone { curve: args.tone.unwrap_or(base.curve), invert: args.invert, window: args.window.unwrap_or(base.window) }
}
