//! `mcvr orbit`

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, bail};
use mcvr::sampling::{Cloud, ProjectOptions, SamplingError, project_cloud};
use mcvr::scene::film::{self, GIF_RATE_LIMIT, ImageFormat};
use mcvr::scene::{Camera, Estimand, Extent, View, Watch};
use mcvr::{is_cloud, read_cloud, volume};

use super::args::{ToneArgs, VolumeArgs};
use super::sample::{DrawArgs, draw, ends};
use super::{Interrupted, outputs, process, progress, project};

/// Most bytes of frames that are kept for an animation.
const ANIMATION_LIMIT: u64 = 1 << 32;

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr orbit phantom:lobster -o frames                 frames/0000.png to frames/0035.png\n  \
    mcvr orbit head.nrrd --frames 90 --rate 30 -o head.png   an animated PNG\n  \
    mcvr orbit lobster.mcvr --elevation 0 --tone log -o lobster.gif\n\n\
    Points are drawn once and projected for every frame. The first frame sets the tone's limits for all.\n\
    INPUT may be a point cloud (.mcvr); its points are as they are, and options that draw points play no part.")]
pub struct Args {
    #[command(flatten)]
    volume: VolumeArgs,
    /// Folder for numbered PNG files (made if missing), or an animation where it ends in .png or .gif
    #[arg(long, short, value_name = "FOLDER|FILE.png|FILE.gif")]
    output: PathBuf,
    /// Frames in a full turn
    #[arg(long, default_value_t = 36, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000), help_heading = "View")]
    frames: u32,
    /// Frames per second of an animation; at most 50 in a GIF
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u16).range(1..=1000), help_heading = "View")]
    rate: u16,
    /// Degrees of the eye above the x-y plane
    #[arg(long, default_value_t = 20.0, value_name = "DEGREES", allow_hyphen_values = true, help_heading = "View")]
    elevation: f64,
    /// Azimuth of the first frame in degrees
    #[arg(long, default_value_t = 30.0, value_name = "DEGREES", allow_hyphen_values = true, help_heading = "View")]
    azimuth: f64,
    /// Millimetres from the eye to the volume's centre [default: two diameters]
    #[arg(long, value_name = "MM", help_heading = "View")]
    distance: Option<f64>,
    /// Degrees across the image's shorter side [default: the whole volume]
    #[arg(long, value_name = "DEGREES", help_heading = "View")]
    fov: Option<f64>,
    /// Parallel rays
    #[arg(long, help_heading = "View")]
    parallel: bool,
    /// Smallest depth in mm that counts [default: a thousandth of the diameter]
    #[arg(long, value_name = "MM", help_heading = "View")]
    near: Option<f64>,
    /// Image size in pixels [default: 400x400]
    #[arg(long, value_name = "WxH", help_heading = "View")]
    size: Option<Extent>,
    /// What a pixel means: line (mean line integral) or count (share of samples) [default: line]
    #[arg(long, help_heading = "Method")]
    estimand: Option<Estimand>,
    #[command(flatten)]
    draw: DrawArgs,
    #[command(flatten)]
    tone: ToneArgs,
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    let start = Instant::now();
    let gif = ends(&args.output, "gif");
    let animation = gif || ends(&args.output, "png");
    if !animation && args.output.extension().is_some() && !args.output.is_dir() {
        bail!("{}: name a folder, or a file that ends in .png or .gif for an animation", args.output.display());
    }
    if animation && args.tone.deep {
        bail!("--deep: an animation is written with 8 bits; name a folder for frames of 16");
    }
    if gif && args.rate > GIF_RATE_LIMIT {
        bail!("--rate {}: a GIF has at most {GIF_RATE_LIMIT} frames a second; use .png for an animated PNG", args.rate);
    }
    let extent = args.size.map_or_else(|| Extent::new(400, 400), Ok)?;
    if gif && extent.width.max(extent.height) > usize::from(u16::MAX) {
        bail!("--size {extent}: a GIF has sides up to 65535; use .png for an animated PNG");
    }
    if animation && extent.pixels() as u64 * u64::from(args.frames) > ANIMATION_LIMIT {
        bail!("{} frames of {extent} exceed 2^32 pixels, all kept until the end; name a folder", args.frames);
    }
    if animation {
        outputs::check([&args.output], &[args.volume.file(), args.draw.scene()])?;
    } else {
        // A folder is made where its parent is one, like a file.
        let first = if args.output.is_dir() { args.output.join("0000.png") } else { args.output.clone() };
        volume::check_writable(&first).with_context(|| first.display().to_string())?;
    }
    let kept = if animation { extent.pixels() as u64 * u64::from(args.frames) } else { 0 };
    process::check_memory(kept + 26 * extent.pixels() as u64, &format!("{} frames of {extent} pixels", args.frames))?;
    // An unusable view is refused before the points are drawn, where the input is a cloud already.
    let input = args.volume.input.as_deref().map(Path::new).filter(|p| is_cloud(p));
    let cloud = match input {
        Some(path) => read_cloud(path)?,
        None => draw(&args.volume, &args.draw, quiet)?.1,
    };
    cameras(args, &cloud).next().transpose()?;
    if !animation && !args.output.is_dir() {
        std::fs::create_dir(&args.output).with_context(|| format!("{}", args.output.display()))?;
    }
    let done = turn(args, &cloud, animation, quiet)?;
    if !quiet {
        say!(
            "{}: {done} frames of {} points in {:.3} s",
            args.output.display(),
            cloud.samples(),
            start.elapsed().as_secs_f64()
        );
    }
    if done < args.frames { Err(anyhow::Error::new(Interrupted)) } else { Ok(()) }
}

/// The cameras of the frames.
fn cameras<'a>(args: &'a Args, cloud: &'a Cloud) -> impl Iterator<Item = anyhow::Result<Camera>> + 'a {
    (0..args.frames).map(|frame| {
        let view = View {
            azimuth: args.azimuth + 360.0 * f64::from(frame) / f64::from(args.frames),
            elevation: args.elevation,
            distance: args.distance,
            fov: args.fov,
            parallel: args.parallel,
            near: args.near,
        };
        let extent = args.size.map_or_else(|| Extent::new(400, 400), Ok)?;
        Ok(Camera::look(&view, cloud.grid(), extent)?)
    })
}

/// Projects and writes the frames; Ctrl-C keeps those that are finished. Gives their number.
fn turn(args: &Args, cloud: &Cloud, animation: bool, quiet: bool) -> anyhow::Result<u32> {
    let cancel = progress::interrupt_flag();
    let bar = progress::bar(u64::from(args.frames), quiet);
    let watch = Watch { progress: None, cancel: Some(&cancel) };
    let options = ProjectOptions { estimand: args.estimand.unwrap_or_default(), ..ProjectOptions::default() };
    let format = if args.tone.deep { ImageFormat::Png16 } else { ImageFormat::Png8 };
    let tone = project::tone(&args.tone);
    let mut limits = None;
    let mut frames: Vec<Vec<u8>> = vec![];
    let mut extent = None;
    let mut done = 0;
    for (number, camera) in cameras(args, cloud).enumerate() {
        let camera = camera?;
        let image = match project_cloud(cloud, &camera, &options, &watch) {
            Err(SamplingError::Cancelled) => break,
            other => other?.image,
        };
        let limits = *limits.get_or_insert_with(|| tone.limits(&image));
        if animation {
            frames.push(tone.apply(&image, limits).into_iter().map(|g| (g * 255.0).round() as u8).collect());
            extent = Some(camera.extent());
        } else {
            film::write_within(&image, &args.output.join(format!("{number:04}.png")), format, &tone, limits)?;
        }
        done += 1;
        bar.inc(1);
    }
    bar.finish_and_clear();
    if let Some(extent) = extent {
        let write = if ends(&args.output, "gif") { film::write_gif } else { film::write_animation };
        write(&frames, extent, &args.output, args.rate)?;
    }
    Ok(done)
}
