//! `mcvr render`

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::bail;
use mcvr::scene::film::{self, ImageFormat};
use mcvr::scene::{Transfer, Watch};
use mcvr::{Made, Method, make};
use serde_json::{Value, json};

use super::args::{ImageArgs, ToneArgs};
use super::setup::{Setup, Viewpoint, image_setup};
use super::{Interrupted, process, progress, radiograph};

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr render phantom:lobster -o lobster.png\n  \
    mcvr render scan.nii.gz --view 0,90 --samples 2^24 --estimand line -o scan.exr --json scan.json\n  \
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
    tone: ToneArgs,
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    let start = Instant::now();
    // Everything that can be wrong with the outputs is found before the work.
    let formats: Vec<ImageFormat> =
        args.outputs.iter().map(|p| ImageFormat::of(p, args.tone.deep)).collect::<Result<_, _>>()?;
    for folder in args.outputs.iter().chain(&args.json).filter_map(|p| p.parent()) {
        if !folder.as_os_str().is_empty() && !folder.is_dir() {
            bail!("{}: no such folder for the output", folder.display());
        }
    }
    let mut setup = image_setup(&args.image, &args.tone)?;
    let film = args.image.film.join(setup.film);
    setup.check_effects()?;
    radiograph::check(&film, &setup)?;
    for note in &setup.notes {
        eprintln!("mcvr: note: {note}");
    }
    let views = std::mem::take(&mut setup.views);
    let mut records = vec![];
    for Viewpoint { camera, label, words } in &views {
        let begin = if records.is_empty() { start } else { Instant::now() };
        let one = views.len() == 1;
        let outputs: Vec<PathBuf> =
            args.outputs.iter().map(|p| if one { p.clone() } else { labelled(p, label) }).collect();
        setup.scenery.camera = camera.clone();
        setup.view.clone_from(words);
        let made = render(&setup, quiet)?;
        let film_made = radiograph::develop(&film, &setup, &made)?;
        let writing = Instant::now();
        for (path, format) in outputs.iter().zip(&formats) {
            match (&film_made, &made.colour) {
                (Some(r), _) => film::write(&r.image, path, *format, &setup.tone)?,
                (None, Some(channels)) => film::write_colour(channels, path, *format, &setup.tone)?,
                (None, None) => film::write(&made.image, path, *format, &setup.tone)?,
            }
        }
        let seconds = [writing.elapsed().as_secs_f64(), begin.elapsed().as_secs_f64()];
        let mut record = record(&setup, &made, &outputs, seconds);
        if let Some(r) = &film_made {
            record["unit"] = json!("transmission");
            record["film"] = radiograph::record(&film, r, setup.request.seed);
        }
        if !one {
            record["camera"]["name"] = json!(label);
        }
        records.push(record);
        if !quiet {
            summarise(&setup, &made, &outputs);
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

/// `out.png` of the camera `front`: `out-front.png`.
fn labelled(path: &Path, label: &str) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{label}.{ending}"))
}

/// Makes the image with a progress bar; warns of mass that the density map dropped or the near plane cut.
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
        eprintln!(
            "mcvr: note: {samples} is no power of two, so the net is uneven at its end (at 10^6 the error was measured within \
             5 % of what a power of two would leave); {} or {} samples are evenest",
            samples.next_power_of_two() / 2,
            samples.next_power_of_two()
        );
    }
    if made.mass.negative > 0 {
        let share = 100.0 * made.mass.dropped / made.mass.weight_sum;
        let hint = match setup.scenery.map.transfer {
            Transfer::Identity => " For Hounsfield units use --map hounsfield.",
            _ => "",
        };
        eprintln!(
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
        eprintln!(
            "mcvr: note: the near plane at {} mm cut {:.3} % of the mass",
            setup.scenery.camera.near(),
            100.0 * clipped
        );
    }
    Ok(made)
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
        "outputs": outputs,
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
        std::io::stdout().write_all(text.as_bytes())?;
        return Ok(());
    }
    Ok(film::write_whole(path, |out| out.write_all(text.as_bytes()))?)
}

fn summarise(setup: &Setup, made: &Made, outputs: &[PathBuf]) {
    let s = &made.seconds;
    let names: Vec<String> = outputs.iter().map(|p| p.display().to_string()).collect();
    let unit = if setup.request.method.samples_volume() { "samples" } else { "rays" };
    eprintln!(
        "{}: {} {} {unit}, kernel {}, estimand {} ({}), seed {}",
        names.join(", "),
        setup.request.method,
        made.samples,
        setup.request.kernel,
        setup.request.estimand,
        setup.request.estimand.unit(),
        setup.request.seed
    );
    eprintln!(
        "{:.4} s: distribution {:.4}, sampling {:.4}, projection {:.4} ({} threads; loading {:.3} s before)",
        s.complete,
        s.distribution,
        s.sampling,
        s.projection,
        rayon::current_num_threads(),
        setup.load_seconds
    );
    if let Some(error) = made.error {
        eprintln!("own error estimate: {error:.2e} of the mean pixel (RMS)");
    }
}
