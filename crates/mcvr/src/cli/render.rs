//! `mcvr render`

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::bail;
use mcvr::refinement::{Bars, Stop};
use mcvr::scene::film::{self, ErrorBars, ImageFormat};
use mcvr::scene::{Density, Extent, Transfer, Watch};
use mcvr::{Made, MadeRefined, Method, Refinement, make_first, make_of};
use serde_json::{Value, json};

use super::args::{ImageArgs, ToneArgs};
use super::radiograph::Radiograph;
use super::refined::{self, ErrorArgs, Known};
use super::setup::{Setup, Viewpoint, image_setup};
use super::watching::{self, WatchArgs, Watching};
use super::{Interrupted, choice_text, outputs, process, progress, radiograph};

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr render phantom:lobster -o lobster.png\n  \
    mcvr render scan.nii.gz --view 0,90 --samples 2^24 --estimand line -o scan.exr --json scan.json\n  \
    mcvr render scan.nii.gz --error 2% -o scan.exr       as many samples as 2 % needs; error bars in the file\n  \
    mcvr render scan.nii.gz --method auto --error 1% -o scan.exr    the quickest way to 1 % (see mcvr plan for the choice)\n  \
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
    /// Image file, repeatable: .png (toned), .exr, .tiff, .npy (linear values); where an error is asked for, an .exr also holds
    /// the layers stderr, low, high and unresolved
    #[arg(long = "output", short, value_name = "FILE", required = true)]
    outputs: Vec<PathBuf>,
    /// Write what was done, with geometry, times and counters, as JSON; - for standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Make the image N more times and put the seconds of each into the JSON record: what a further image of the volume takes,
    /// whose weights are summed and whose empty bricks are known
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), requires = "json")]
    repeats: Option<u32>,
    #[command(flatten)]
    error: ErrorArgs,
    /// Write the standard error of every pixel, its confidence interval and the unresolved pixels: .npy (4, height, width),
    /// .exr (layers); .png and .tiff show the standard error alone
    #[arg(long = "error-map", value_name = "FILE", help_heading = "Error")]
    error_maps: Vec<PathBuf>,
    #[command(flatten)]
    watch: WatchArgs,
    #[command(flatten)]
    tone: ToneArgs,
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    let start = Instant::now();
    if args.repeats.is_some() && args.watch.any() {
        bail!("--repeats times one image, which cannot be watched as it refines; give one of the two");
    }
    // Everything that can be wrong with the outputs is found before the work.
    let format = |p: &PathBuf| ImageFormat::of(p, args.tone.deep);
    let formats: Vec<ImageFormat> = args.outputs.iter().map(format).collect::<Result<_, _>>()?;
    let map_formats: Vec<ImageFormat> = args.error_maps.iter().map(format).collect::<Result<_, _>>()?;
    let files: Vec<&PathBuf> = args.outputs.iter().chain(&args.error_maps).collect();
    outputs::check(files.iter().copied().chain(&args.json), &args.image.inputs())?;
    let mut setup = image_setup(&args.image, &args.tone)?;
    let film = args.image.film.join(setup.film);
    setup.check_effects()?;
    radiograph::check(&film, &setup)?;
    for note in &setup.notes {
        say!("mcvr: note: {note}");
    }
    let views = setup.views.clone();
    let one = views.len() == 1;
    for view in &views {
        if !one {
            let files: Vec<PathBuf> = files.iter().map(|p| labelled(p, &view.label)).collect();
            outputs::check(&files, &args.image.inputs())?;
        }
        let channels = setup.scenery.effects.look(setup.scenery.volume.grid(), &view.camera)?.channels();
        check_image_memory(view.camera.extent(), channels, &[&formats[..], &map_formats].concat())?;
    }
    let watched = args.watch.any() || !args.error_maps.is_empty();
    setup.request.error = args.error.target(&setup).unwrap_or(setup.request.error);
    let refinement = args.error.refinement(&setup, watched, args.watch.any())?;
    if let Some(refinement) = &refinement {
        refined::check_memory(&setup, refinement)?;
    }
    let samples = setup.request.samples;
    // More than the method's own limit is refused for that.
    if setup.request.method == Method::McQuicksort && samples <= Method::QUICKSORT_LIMIT {
        process::check_memory(8 * samples, &format!("sorting {samples} samples"))?;
    }
    let mut records = vec![];
    let mut interrupted = false;
    let mut density = None;
    for view in &views {
        let begin = if records.is_empty() { start } else { Instant::now() };
        let named = |p: &PathBuf| if one { p.clone() } else { labelled(p, &view.label) };
        let outputs: Vec<PathBuf> = args.outputs.iter().map(named).collect();
        setup.scenery.camera = view.camera.clone();
        setup.view.clone_from(&view.words);
        let mut drawing = |quiet| match &refinement {
            None => Ok(Drawn { made: render(&setup, &mut density, quiet)?, error: None }),
            Some(refinement) => refine(args, &setup, refinement, (view, one), &formats, quiet),
        };
        let drawn = drawing(quiet)?;
        let again = || Ok(drawing(true)?.made.seconds.complete);
        let repeats = args.repeats.map(|n| process::repeated(n, again)).transpose()?;
        let made = &drawn.made;
        remark(&setup, made);
        let film_made = radiograph::develop(&film, &setup, made)?;
        let writing = Instant::now();
        let bars = drawn.bars(film_made.as_ref());
        let bars: Vec<ErrorBars<'_>> = bars.iter().map(watching::layers).collect();
        let confidence = refinement.as_ref().map_or(0.0, |r| r.goal.confidence);
        let channels = match (&film_made, &made.colour) {
            (Some(r), _) => std::slice::from_ref(&r.image),
            (None, Some(channels)) => &channels[..],
            (None, None) => std::slice::from_ref(&made.image),
        };
        for (path, format) in outputs.iter().zip(&formats) {
            match (&bars[..], channels) {
                ([], [r, g, b]) => {
                    film::write_colour(&[r.clone(), g.clone(), b.clone()], path, *format, &setup.tone)?;
                }
                ([], _) => film::write(&channels[0], path, *format, &setup.tone)?,
                (bars, _) => film::write_with_error(channels, bars, confidence, path, *format, &setup.tone)?,
            }
        }
        let maps: Vec<PathBuf> = args.error_maps.iter().map(named).collect();
        for (path, format) in maps.iter().zip(&map_formats) {
            film::write_error(&bars, confidence, path, *format, &setup.tone)?;
        }
        let seconds = [writing.elapsed().as_secs_f64(), begin.elapsed().as_secs_f64()];
        let mut record = record(&setup, made, &outputs, seconds);
        if let Some(repeats) = repeats {
            record["seconds"]["repeats"] = repeats;
        }
        if let Some((refinement, error)) = refinement.as_ref().zip(drawn.error.as_ref()) {
            record["error"] = refined::record(refinement, error);
            record["error"]["maps"] = json!(outputs::names(&maps));
        }
        if let Some(r) = &film_made {
            record["unit"] = json!("transmission");
            record["film"] = radiograph::record(&film, r, setup.request.seed);
        }
        if !one {
            record["camera"]["name"] = json!(view.label);
        }
        records.push(record);
        if !quiet {
            summarise(&setup, made, &outputs);
            if let Some((refinement, error)) = refinement.as_ref().zip(drawn.error.as_ref()) {
                refined::summarise(refinement, error);
            }
            if let Some(r) = &film_made {
                radiograph::summarise(&film, r);
            }
        }
        if drawn.error.is_some_and(|e| e.stop == Stop::Interrupted) {
            interrupted = true;
            break;
        }
    }
    if let Some(path) = &args.json {
        let record = match records.len() {
            1 => records.remove(0),
            _ => json!({ "images": records, "versions": { "mcvr": env!("CARGO_PKG_VERSION"), "record": 1 } }),
        };
        write_json(path, &record)?;
    }
    if interrupted { Err(anyhow::Error::new(Interrupted)) } else { Ok(()) }
}

/// An image, and what is known of its error.
struct Drawn {
    made: Made,
    error: Option<Known>,
}

impl Drawn {
    /// Error bars of the image, or of its film.
    fn bars(&self, film: Option<&Radiograph>) -> Vec<Bars> {
        let Some(error) = &self.error else { return vec![] };
        match film {
            Some(_) => error.bars.iter().map(|b| radiograph::bars(b, &self.made.image)).collect(),
            None => error.bars.clone(),
        }
    }
}

/// Refines the image of a view, the only `one` or not.
fn refine(
    args: &Args,
    setup: &Setup,
    refinement: &Refinement,
    (view, one): (&Viewpoint, bool),
    formats: &[ImageFormat],
    quiet: bool,
) -> anyhow::Result<Drawn> {
    let request = json!({ "method": setup.request.method, "estimand": setup.request.estimand, "kernel": setup.request.kernel,
        "seed": setup.request.seed, "refinement": refinement, "input": setup.input, "view": setup.view });
    let label = (!one).then_some(view.label.as_str());
    let confidence = refinement.goal.confidence;
    let mut watching = Watching::new(&args.watch, label, formats, setup.tone, confidence, request, quiet)?;
    let made = refined::run(setup, refinement, quiet, |look, snapshot, bar| watching.look(look, snapshot, bar))?;
    let MadeRefined { made, bars, looks, stop } = made;
    watching.stop(stop)?;
    Ok(Drawn { made, error: Some(Known { bars, looks, stop }) })
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

/// Makes the image with a progress bar, of the weights that an image before has left, or of new ones.
fn render(setup: &Setup, density: &mut Option<Density>, quiet: bool) -> anyhow::Result<Made> {
    let cancel = progress::interrupt_flag();
    let total = match setup.request.method {
        m if !m.samples_volume() => setup.scenery.camera.extent().height as u64,
        _ => setup.request.samples,
    };
    let bar = progress::bar(total, quiet);
    let advance = |n: u64| bar.inc(n);
    let watch = Watch { progress: Some(&advance), cancel: Some(&cancel) };
    let outcome = match density {
        Some(density) => make_of(density, &setup.scenery, &setup.request, &watch),
        None => make_first(&setup.scenery, &setup.request, &watch).map(|(made, new)| {
            *density = Some(new);
            made
        }),
    };
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
    if let Some(choice) = &made.choice {
        record["choice"] = json!(choice);
    }
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
    let method = made.choice.as_ref().map_or(setup.request.method, |c| c.chosen.method);
    let unit = method.unit();
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
    if let Some(choice) = &made.choice {
        choice_text::say(choice);
    }
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
