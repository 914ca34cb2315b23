//! `mcvr export`: a scan, a camera and the truth in the form that other programs read.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use glam::DVec3;
use mcvr::raycast::{Counters, Integrator};
use mcvr::scene::{Camera, Density, Estimand, Image, Kernel, film};
use mcvr::volume::{Grid, Volume, write_metaimage};
use mcvr::{Detector, harness};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::args::{BudgetArgs, DensityArgs, MethodArgs, ToneArgs, ViewArgs, VolumeArgs};
use super::effect_args::EffectArgs;
use super::render::write_json;
use super::setup::{Setup, setup};
use super::truth::{dataset, truth};
use super::{outputs, process, progress};

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr export scan.nii.gz -o exported                        the weights and the camera\n  \
    mcvr export lobster.mha --view 30,60 --truth -o exported   and the images that a program should come to\n  \
    mcvr export chest.mha --map hounsfield --distance 1000 --size 512x512 -o exported\n\n\
    DIR/volume.mha: the weights after the density map (negative ones are 0), 32-bit floats, x fastest, in world mm, with one\n\
    voxel of 0 added on every side, so that programs that end the field at the outermost voxels show the same scan.\n\
    DIR/geometry.json: source, detector centre, axes, pixel pitch (mm) and size; row 0 is the top of the image.\n\
    With --truth also images in weight units times mm, .npy (height, width), 64-bit floats:\n\
    truth.npy (mean over each pixel's area), centre-tent.npy and centre-box.npy (one ray through each pixel's centre,\n\
    exact along it, through the trilinear and the nearest-neighbour field).\n\
    scripts/peers renders the exported scan with RTK, plastimatch and VTK and compares them.")]
pub struct Args {
    #[command(flatten)]
    volume: VolumeArgs,
    /// Folder for the files; made if absent, files of an earlier export are replaced
    #[arg(long = "output", short, value_name = "DIR", required = true)]
    out: PathBuf,
    /// Cast the truth as well: the mean over each pixel, and the centre rays of both fields
    #[arg(long)]
    truth: bool,
    #[command(flatten)]
    method: MethodArgs,
    #[command(flatten)]
    view: ViewArgs,
    #[command(flatten)]
    density: DensityArgs,
}

/// The description's name in the folder. It is written last: where it stands, all it names is whole.
const DESCRIPTION: &str = "geometry.json";
const VOLUME: &str = "volume.mha";
/// Voxels of weight 0 on every side of the exported grid. mcvr's field fades to 0 over half a kernel beyond the outermost
/// voxels; other programs end theirs at those voxels' centres, and with this margin all see the same field.
const MARGIN: usize = 1;
/// Stem of the truth over each pixel's area.
const TRUTH: &str = "truth";

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    let (budget, tone, effects) = (BudgetArgs::default(), ToneArgs::default(), EffectArgs::default());
    let setup = setup(&args.volume, &args.density, &args.view, &args.method, &budget, &tone, &effects)?;
    setup.check_one_camera("export")?;
    check(&setup)?;
    let grid = setup.scenery.volume.grid();
    // The margin is to lie in front of the detector as well.
    let support = setup.request.kernel.support().max(1.0 + MARGIN as f64);
    let detector = Detector::of(&setup.scenery.camera, grid, support)?;
    let grid = padded(grid)?;
    process::check_memory(4 * grid.len() as u64, &format!("{} weights as 32-bit floats", grid.len()))?;
    for note in setup.notes.iter().filter(|_| !quiet) {
        say!("mcvr: note: {note}");
    }
    let density = Density::new(&setup.scenery.volume, setup.scenery.map.clone())?;
    remark(&density);
    let weights = weights(&density, grid.clone())?;
    claim(args)?;
    write_metaimage(&weights, &args.out.join(VOLUME))?;
    drop(weights);
    let truths = if args.truth { truths(&setup, &density, &args.out, quiet)? } else { json!({}) };
    let description = json!({
        "format": "mcvr export",
        "format_version": 1,
        "volume": {
            "file": VOLUME, "type": "float32", "axis_order": "x fastest", "unit": "weight per mm of path",
            "margin": MARGIN, "dims": grid.dims(), "spacing": grid.spacing().to_array(), "origin": grid.origin().to_array(),
            "direction": grid.direction().transpose().to_cols_array_2d(),
        },
        "camera": {
            "source_mm": detector.source.to_array(),
            "detector_centre_mm": detector.centre.to_array(),
            "column_axis": detector.column_axis.to_array(),
            "row_axis": detector.row_axis.to_array(),
            "pixel_pitch_mm": detector.pitch,
            "size": detector.size,
            "source_detector_mm": detector.source_distance,
            "source_centre_mm": detector.centre_depth,
            "principal_point_px": detector.principal_point,
        },
        "truth": truths,
        "subject": subject(&setup, density.mass()),
        "versions": { "mcvr": env!("CARGO_PKG_VERSION"), "commit": harness::git_commit() },
    });
    write_json(&args.out.join(DESCRIPTION), &description)?;
    if !quiet {
        say!("{}: {VOLUME}, {DESCRIPTION}{}", args.out.display(), if args.truth { " and the truths" } else { "" });
    }
    Ok(())
}

/// What a peers' record must agree with, as `mcvr export` writes it and `mcvr cost --peers` compares it.
pub fn subject(setup: &Setup, mass: f64) -> Value {
    let geometry = setup.geometry();
    let of = |part: &str, keys: &[&str]| -> Value {
        keys.iter().map(|&key| (key.to_owned(), geometry[part][key].clone())).collect::<serde_json::Map<_, _>>().into()
    };
    json!({
        "dataset": dataset(setup),
        "volume": of("volume", &["dims", "spacing", "origin", "direction"]),
        "camera": of("camera", &["world_to_pixel", "width", "height"]),
        "mass": mass,
        "kernel": setup.request.kernel,
        "estimand": setup.request.estimand,
    })
}

/// Refuses what other programs do not show.
fn check(setup: &Setup) -> anyhow::Result<()> {
    if setup.request.estimand != Estimand::Line {
        bail!(
            "--estimand {}: other programs integrate along lines; leave it out, or ask for line",
            setup.request.estimand
        );
    }
    if setup.request.kernel == Kernel::Shell {
        bail!("--kernel shell: it has no exact truth; ask for tent, box or bspline3");
    }
    if !setup.scenery.effects.is_plain() {
        bail!("the scene has effects, and an export holds the plain X-ray; leave them out of the scene");
    }
    Ok(())
}

/// Says what the density map dropped.
fn remark(density: &Density) {
    let report = density.report();
    if report.negative > 0 {
        say!(
            "mcvr: warning: {} of {} voxels had a negative weight and are written as 0; their sum of {:.6e} is {:.1} % of what \
             remains",
            report.negative,
            report.voxels,
            report.dropped,
            100.0 * report.dropped / report.weight_sum
        );
    }
}

/// The weights as 32-bit floats on the volume's grid.
fn weights(density: &Density, padded: Grid) -> anyhow::Result<Volume> {
    let (volume, largest) = (density.volume(), density.report().max_weight);
    if largest > f64::from(f32::MAX) {
        bail!("the largest weight, {largest:e}, exceeds 32-bit floats; scale the weights down (--map linear:SLOPE,0)");
    }
    if largest as f32 == 0.0 {
        bail!("the largest weight, {largest:e}, is 0 as a 32-bit float; scale the weights up (--map linear:SLOPE,0)");
    }
    let [columns, rows, slices] = volume.grid().dims();
    let [width, height, _] = padded.dims();
    let mut weights = vec![0f32; padded.len()];
    weights.par_chunks_mut(width * height).skip(MARGIN).take(slices).enumerate().for_each(|(k, slice)| {
        for j in 0..rows {
            let from = (k * rows + j) * columns;
            let to = (j + MARGIN) * width + MARGIN;
            for (i, weight) in slice[to..to + columns].iter_mut().enumerate() {
                *weight = density.weight(from + i) as f32;
            }
        }
    });
    Ok(Volume::from_vec(padded, weights, volume.name())?)
}

/// The grid with a margin of zeros on every side.
fn padded(grid: &Grid) -> anyhow::Result<Grid> {
    let dims = grid.dims().map(|n| n + 2 * MARGIN);
    let origin = grid.index_to_world().transform_point3(DVec3::splat(-(MARGIN as f64)));
    Ok(Grid::new(dims, grid.spacing(), origin, grid.direction())?)
}

/// Makes the folder, and takes away the description of an earlier export, which the new files would belie.
fn claim(args: &Args) -> anyhow::Result<()> {
    let out = &args.out;
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let description = out.join(DESCRIPTION);
    let inputs = [args.volume.file(), args.method.scene.as_deref(), args.view.matrix.as_deref()];
    outputs::check([&out.join(VOLUME), &description], &inputs)?;
    match std::fs::remove_file(&description) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(e).with_context(|| description.display().to_string()),
        _ => Ok(()),
    }
}

/// Casts the truths and writes them; gives what the description says of them.
fn truths(setup: &Setup, density: &Density, out: &Path, quiet: bool) -> anyhow::Result<Value> {
    let area = truth(setup, density.mass(), (out, TRUTH), &|_| Ok(()), &progress::interrupt_flag(), quiet)?;
    let mut said = json!({ "area": {
        "file": format!("{TRUTH}.npy"), "kernel": setup.request.kernel, "rel_error_estimate": area.rel_error_estimate,
        "mean": area.image.mean(), "sha256": harness::sha256(&area.image),
    }});
    for kernel in [Kernel::Tent, Kernel::Box] {
        let name = format!("centre-{kernel}");
        let file = format!("{name}.npy");
        let image = centre_rays(density, &setup.scenery.camera, kernel)?;
        film::write(&image, &out.join(&file), film::ImageFormat::Npy, &film::Tone::default())?;
        said[&name] = json!({ "file": file, "kernel": kernel, "mean": image.mean() });
    }
    Ok(said)
}

/// One ray through each pixel's centre, exact along it.
fn centre_rays(density: &Density, camera: &Camera, kernel: Kernel) -> anyhow::Result<Image> {
    let integrator = Integrator::new(density, kernel)?;
    let rays = integrator.view(camera, Estimand::Line);
    let (extent, mut image) = (camera.extent(), Image::zeros(camera.extent()));
    image.values_mut().par_chunks_mut(extent.width).enumerate().for_each(|(row, values)| {
        let mut counters = Counters::default();
        for (column, value) in values.iter_mut().enumerate() {
            *value = rays.integrate(column as f64 + 0.5, row as f64 + 0.5, &mut counters);
        }
    });
    Ok(image)
}
