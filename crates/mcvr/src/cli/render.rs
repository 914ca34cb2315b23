//! `mcvr render`

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use mcvr::scene::film::{self, ImageFormat};
use mcvr::scene::{Extent, Transfer, Watch};
use mcvr::{Made, Method, make};
use serde_json::{Value, json};

use super::args::{ImageArgs, ToneArgs};
use super::refined::{self, ErrorArgs};
use super::setup::{Setup, Viewpoint, image_setup};
use super::{Interrupted, outputs, process, progress, radiograph};

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr render phantom:lobster -o lobster.png\n  \
    mcvr render scan.nii.gz --view 0,90 --samples 2^24 --estimand line -o scan.exr --json scan.json\n  \
    mcvr render scan.nii.gz --error 2% -o scan.exr       as many samples as 2 % needs; error bars in the file\n  \
    mcvr render scan.nii.gz --time 2s -o scan.png        what two seconds give, and how wrong it is\n  \
    mcvr render head.raw --dims 256,256,113 --type u16 --endian be --spacing 1,1,2 --emphasis 1200,8 -o head.png\n  \
    mcvr render chest.mha --map hounsfield:60keV --photons 1e4 -o radiograph.png --deep\n  \
    mcvr render head.nrrd --shade --depth-cue --light around:60,30 -o shaded.png\n  \
    mcvr render head.nrrd --material 300..=#ffffff*2:bone --material=-200..300=#c04030:tissue -o materials.png\n  \
    mcvr render examples/two-cameras.toml -o out.png    one image a camera: out-front.png, out-side.png\n  \
    mcvr render phantom:vessels --method exact --size 256x256 -o truth.npy")]
pub struct Args {
    #[command(flatten)]
    image: ImageArgs,
    /// Image file, repeatable: .png (toned), .exr, .tiff, .npy (linear values)
    #[arg(long = "output", short, value_name = "FILE", required = true)]
    outputs: Vec<PathBuf>,
    /// Write what was done, with geometry, times and counters, as JSON; - for standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    #[command(flatten)]
    error: ErrorArgs,
    #[command(flatten)]
    tone: ToneArgs,
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    let start = Instant::now();
    // Everything that can be wrong with the outputs is found before the work.
    let formats: Vec<ImageFormat> =
        args.outputs.iter().map(|p| ImageFormat::of(p, args.tone.deep)).collect::<Result<_, _>>()?;
    outputs::check(args.outputs.iter().chain(&args.json), &args.image.inputs())?;
    let mut setup = image_setup(&args.image, &args.tone)?;
    let film = args.image.film.join(setup.film);
    setup.check_effects()?;
    radiograph::check(&film, &setup)?;
    for note in &setup.notes {
        say!("mcvr: note: {note}");
    }
    let views = std::mem::take(&mut setup.views);
    for view in &views {
        if views.len() > 1 {
            let outputs: Vec<PathBuf> = args.outputs.iter().map(|p| labelled(p, &view.label)).collect();
            outputs::check(&outputs, &args.image.inputs())?;
        }
        let channels = setup.scenery.effects.look(setup.scenery.volume.grid(), &view.camera)?.channels();
        check_image_memory(view.camera.extent(), channels, &formats)?;
    }
    let refinement = args.error.refinement(&setup, args.image.budget.samples, false)?;
    if let Some(refinement) = &refinement {
        refined::check_memory(&setup, refinement)?;
    }
    let samples = setup.request.samples;
    // More than the method's own limit is refused for that.
    if setup.request.method == Method::McQuicksort && samples <= Method::QUICKSORT_LIMIT {
        process::check_memory(8 * samples, &format!("sorting {samples} samples"))?;
    }
    let mut records = vec![];
    for Viewpoint { camera, label, words } in &views {
        let begin = if records.is_empty() { start } else { Instant::now() };
        let one = views.len() == 1;
        let outputs: Vec<PathBuf> =
            args.outputs.iter().map(|p| if one { p.clone() } else { labelled(p, label) }).collect();
        setup.scenery.camera = camera.clone();
        setup.view.clone_from(words);
        let refined = refinement.as_ref().map(|r| refined::run(&setup, r, quiet, |_, _, _| Ok(()))).transpose()?;
        let plain = if refined.is_none() { Some(render(&setup, quiet)?) } else { None };
        let Some(made) = refined.as_ref().map(|r| &r.made).or(plain.as_ref()) else { continue };
        remark(&setup, made);
        let film_made = radiograph::develop(&film, &setup, made)?;
        let writing = Instant::now();
        for (path, format) in outputs.iter().zip(&formats) {
            match (&film_made, &made.colour) {
                (Some(r), _) => film::write(&r.image, path, *format, &setup.tone)?,
                (None, Some(channels)) => film::write_colour(channels, path, *format, &setup.tone)?,
                (None, None) => film::write(&made.image, path, *format, &setup.tone)?,
            }
        }
        let seconds = [writing.elapsed().as_secs_f64(), begin.elapsed().as_secs_f64()];
        let mut record = record(&setup, made, &outputs, seconds);
        if let Some((refinement, refined)) = refinement.as_ref().zip(refined.as_ref()) {
            record["error"] = refined::record(refinement, refined);
        }
        if let Some(r) = &film_made {
            record["unit"] = json!("transmission");
            record["film"] = radiograph::record(&film, r, setup.request.seed);
        }
        if !one {
            record["camera"]["name"] = json!(label);
        }
        records.push(record);
        if !quiet {
            summarise(&setup, made, &outputs);
            if let Some((refinement, refined)) = refinement.as_ref().zip(refined.as_ref()) {
                refined::summarise(refinement, refined);
            }
            if let Some(r) = &film_made {
                radiograph::summarise(&film, r);
            }
        }
    }
    if let Some(path) = &args.json {
        let record = match records.len() {
            1 => records.remove(0),
            _ => json!({ "images": records, "versions": { "mcvr": env!("CARGO_PKG_VERSION"), "record": 1 } }),
        };
        write_json(path, &record)?;
    }
    Ok(())
}

/// Refuses an image that will not fit into memory, sums and writing included. A pixel takes 8 bytes as a sum, 8 as a value
/// and, once the sums are gone, in each channel: 8 for its tone and 2 as a PNG, or 12 as floats and as many for the encoder.
pub fn check_image_memory(extent: Extent, channels: usize, formats: &[ImageFormat]) -> anyhow::Result<()> {
    let written = |format: &ImageFormat| match format {
        ImageFormat::Npy => 8,
        ImageFormat::Png8 | ImageFormat::Png16 => 8 + 8 + 2,
        ImageFormat::Exr | ImageFormat::Tiff => 12 + 12,
    };
    let pixel = (8 + formats.iter().map(written).max().unwrap_or(8)) * channels as u64;
    process::check_memory(extent.pixels() as u64 * pixel, &format!("an image of {extent} pixels"))
}

/// `out.png` of the camera `front`: `out-front.png`.
fn labelled(path: &Path, label: &str) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{label}."));
    name.push(path.extension().unwrap_or_default());
    path.with_file_name(name)
}

/// Makes the image with a progress bar.
fn render(setup: &Setup, quiet: bool) -> anyhow::Result<Made> {
    let cancel = progress::interrupt_flag();
    let total = match setup.request.method {
        Method::March | Method::Exact => setup.scenery.camera.extent().height as u64,
        _ => setup.request.samples,
    };
    let bar = progress::bar(total, quiet);
    let advance = |n: u64| bar.inc(n);
    let outcome = make(&setup.scenery, &setup.request, &Watch { progress: Some(&advance), cancel: Some(&cancel) });
    bar.finish_and_clear();
    let made = match outcome {
        Err(e) if e.is_cancelled() => return Err(anyhow::Error::new(Interrupted)),
        other => other?,
    };
    let (method, samples) = (setup.request.method, setup.request.samples);
    if method == Method::Qmc && !samples.is_power_of_two() && !quiet {
        say!(
            "mcvr: note: {samples} is no power of two, so the net is uneven at its end (at 10^6 the error was measured within \
             5 % of what a power of two would leave); {} or {} samples are evenest",
            samples.next_power_of_two() / 2,
            samples.next_power_of_two()
        );
    }
    Ok(made)
}

/// Warns of mass that the density map dropped or the near plane cut, and of a tolerance that was missed.
fn remark(setup: &Setup, made: &Made) {
    let method = setup.request.method;
    if made.mass.negative > 0 {
        let share = 100.0 * made.mass.dropped / made.mass.weight_sum;
        let hint = match setup.scenery.map.transfer {
            Transfer::Identity => " For Hounsfield units use --map hounsfield.",
            _ => "",
        };
        say!(
            "mcvr: warning: {} voxels ({:.2} %) had a negative weight and count as 0; their sum of {:.6e} is {share:.1} % of \
             what remains.{hint}",
            made.mass.negative,
            100.0 * made.mass.negative as f64 / made.mass.voxels as f64,
            made.mass.dropped
        );
    }
    if made.mass.faint > 0 && method.samples_volume() {
        eprintln!(
            "mcvr: note: {} voxels weigh so little beside the others that no sample falls on them; their sum of {:.2e} is {:.1e} \
             of the whole",
            made.mass.faint,
            made.mass.faint_sum,
            made.mass.faint_sum / made.mass.weight_sum
        );
    }
    let clipped = made.clipped;
    if clipped > 0.0 {
        say!(
            "mcvr: note: the near plane at {} mm cut {:.3} % of the mass",
            setup.scenery.camera.near(),
            100.0 * clipped
        );
    }
    let tolerance = setup.request.tolerance;
    if let Some(error) = made.error.filter(|e| method == Method::Exact && *e > tolerance) {
        eprintln!(
            "mcvr: warning: the tolerance of {tolerance:e} was not met: {} pixels were subdivided to the limit, and the own \
             error estimate is {error:.2e}",
            made.counters["depth_limited"]
        );
    }
}

fn record(setup: &Setup, made: &Made, outputs: &[PathBuf], [write, total]: [f64; 2]) -> Value {
    let r = &setup.request;
    let s = &made.seconds;
    let mut record = json!({
        "method": r.method,
        "estimand": r.estimand,
        "unit": r.estimand.unit(),
        "kernel": r.kernel,
        "samples": made.samples,
        "seed": r.seed,
        "order": r.order,
        "scramble": r.scramble,
        "cull": r.cull,
        "mass": made.mass.mass,
        "density": { "map": setup.scenery.map, "report": made.mass },
        "clipped_share": made.clipped,
        "error_estimate": made.error,
        "seconds": {
            "load": setup.load_seconds, "distribution": s.distribution, "sampling": s.sampling,
            "projection": s.projection, "complete": s.complete, "write": write, "total": total,
        },
        "counters": made.counters,
        "threads": rayon::current_num_threads(),
        "peak_memory_bytes": process::peak_memory(),
        "outputs": outputs::names(outputs),
        "versions": { "mcvr": env!("CARGO_PKG_VERSION"), "record": 1 },
    });
    if !setup.scenery.effects.is_plain() {
        record["effects"] = json!(setup.scenery.effects);
    }
    if let (Value::Object(to), Value::Object(from)) = (&mut record, setup.geometry()) {
        to.extend(from);
    }
    record
}

/// Writes JSON to a file (beside, then renamed) or to standard output.
pub fn write_json(path: &Path, value: &Value) -> anyhow::Result<()> {
    let mut text = serde_json::to_string_pretty(value)?;
    text.push('\n');
    if path == Path::new("-") {
        return Ok(outputs::stdout().write_all(text.as_bytes())?);
    }
    Ok(film::write_whole(path, |out| out.write_all(text.as_bytes()))?)
}

fn summarise(setup: &Setup, made: &Made, outputs: &[PathBuf]) {
    let s = &made.seconds;
    let names: Vec<String> = outputs.iter().map(|p| p.display().to_string()).collect();
    let unit = if setup.request.method.samples_volume() { "samples" } else { "rays" };
    say!(
        "{}: {} {} {unit}, kernel {}, estimand {} ({}), seed {}",
        names.join(", "),
        setup.request.method,
        made.samples,
        setup.request.kernel,
        setup.request.estimand,
        setup.request.estimand.unit(),
        setup.request.seed
    );
    say!(
        "{:.4} s: distribution {:.4}, sampling {:.4}, projection {:.4} ({} threads; loading {:.3} s before)",
        s.complete,
        s.distribution,
        s.sampling,
        s.projection,
        rayon::current_num_threads(),
        setup.load_seconds
    );
    if let Some(error) = made.error.filter(|_| setup.request.method == Method::Exact) {
        say!("own error estimate: {error:.2e} of the mean pixel (RMS)");
    }
}
