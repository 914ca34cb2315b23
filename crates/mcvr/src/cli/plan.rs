//! `mcvr plan`

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::bail;
use mcvr::auto::{Choice, choose};
use mcvr::plan::{Plan, Verdict, plan};
use mcvr::scene::film::Film;
use mcvr::scene::{Density, Watch};
use mcvr::{ErrorSection, Made, MakeError, Method, make};
use serde_json::{Value, json};

use super::args::{ImageArgs, ToneArgs};
use super::plan_text::{describe, table};
use super::render::write_json;
use super::setup::{Setup, Viewpoint, image_setup};
use super::{Interrupted, choice_text, numbers, outputs, process, progress, radiograph};

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr plan examples/everything.toml                  what will run, for every camera, and why\n  \
    mcvr plan examples/shaded.toml --draw               how often, exactly: draws the points, makes no image\n  \
    mcvr plan examples/shaded.toml --run                makes the image and holds its counters to the forecast\n  \
    mcvr plan head.nrrd --shade --distance 90 -n 2^24   for flags as `mcvr render` takes them\n  \
    mcvr plan head.nrrd --method auto --error 1%         what would be chosen, what it should take, and the runners-up\n  \
    mcvr plan scene.toml --json - | jq '.plans[].bytes'\n\n\
    Without --draw, --run and --method auto no voxel is read: what the voxels decide is forecast as a range.\n\
    Exit status: 1 where --run counts something that the plan did not forecast.")]
pub struct Args {
    /// Draw the points, so that ranges become numbers
    #[arg(long)]
    draw: bool,
    /// Make the image too (without writing it), and compare what was counted with what was forecast
    #[arg(long)]
    run: bool,
    /// For --method auto: the error to reach, as a share of the mean pixel, such as 1% [default: 1%]
    #[arg(long, value_name = "ERROR", value_parser = numbers::share)]
    error: Option<f64>,
    /// Write the plans as JSON; - for standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    #[command(flatten)]
    image: ImageArgs,
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    outputs::check(&args.json, &args.image.inputs())?;
    let mut setup = image_setup(&args.image, &ToneArgs::default())?;
    let film = args.image.film.join(setup.film);
    setup.check_effects()?;
    radiograph::check(&film, &setup)?;
    for note in setup.notes.iter().filter(|_| !quiet) {
        say!("mcvr: note: {note}");
    }
    if setup.error != ErrorSection::default() && !quiet {
        say!(
            "mcvr: note: how many samples the scene's error takes is not forecast; this is the plan of one image of {} samples",
            setup.request.samples
        );
    }
    let text = !quiet && args.json.as_deref() != Some(Path::new("-"));
    let views = std::mem::take(&mut setup.views);
    let (mut records, mut broken) = (vec![], vec![]);
    let asked = setup.request;
    for (i, view) in views.iter().enumerate() {
        setup.scenery.camera = view.camera.clone();
        setup.view.clone_from(&view.words);
        setup.request = asked;
        let choice = chosen(args, &mut setup, quiet)?;
        let made = one(args, &setup, &film, quiet)?;
        if text {
            let mut out = outputs::stdout();
            if i > 0 {
                writeln!(out)?;
            }
            if let Some(choice) = &choice {
                writeln!(out, "{}", choice_text::table(choice))?;
            }
            let name = (views.len() > 1).then_some(&view.label[..]);
            write!(out, "{}", describe(&setup, name, &made.plan))?;
            if let Some((_, verdicts)) = &made.outcome {
                write!(out, "\n{}", table(verdicts))?;
            }
        }
        let wrong = made.outcome.iter().flat_map(|(_, v)| v).filter(|v| !v.holds());
        broken.extend(wrong.map(|v| format!("camera {}: {}", view.label, said(v))));
        let mut record = record(&setup, view, &made);
        if let Some(choice) = choice {
            record["choice"] = json!(choice);
        }
        records.push(record);
    }
    if let Some(path) = &args.json {
        let versions = json!({ "mcvr": env!("CARGO_PKG_VERSION"), "record": 1 });
        write_json(
            path,
            &json!({ "plans": records, "peak_memory_bytes": process::peak_memory(), "versions": versions }),
        )?;
    }
    if broken.is_empty() {
        return Ok(());
    }
    bail!(
        "the plan was wrong about {} of what was counted ({}); please report this with the scene file: the image is not at \
         fault, its forecast is",
        if broken.len() == 1 { "one item".into() } else { format!("{} items", broken.len()) },
        broken.join("; ")
    )
}

/// Chooses for `--method auto`: the setup's request becomes the chosen one.
fn chosen(args: &Args, setup: &mut Setup, quiet: bool) -> anyhow::Result<Option<Choice>> {
    if setup.request.method != Method::Auto {
        return Ok(None);
    }
    setup.request.error = args.error.or(setup.error.rmse).unwrap_or(setup.request.error);
    let choice = watched(setup, quiet, "looking", |watch| {
        let density = Density::new(&setup.scenery.volume, setup.scenery.map.clone())?;
        choose(&density, &setup.scenery, &setup.request, watch)
    })?;
    setup.request = choice.request(&setup.request);
    Ok(Some(choice))
}

/// A plan, and what became of it.
struct Planned {
    plan: Plan,
    drawn: bool,
    outcome: Option<(Made, Vec<Verdict>)>,
}

/// The plan of the setup's camera; drawn and run where asked for.
fn one(args: &Args, setup: &Setup, film: &Film, quiet: bool) -> anyhow::Result<Planned> {
    let (scenery, request) = (&setup.scenery, &setup.request);
    let mut plan = plan(scenery, request, film)?;
    let drawn = args.draw && request.method.samples_volume();
    if args.draw && !drawn && !quiet {
        say!("mcvr: note: --draw: {} draws no points; its ranges stay", request.method);
    }
    if drawn {
        watched(setup, quiet, "drawing", |watch| plan.draw(scenery, request, watch))?;
    }
    let outcome = match args.run {
        false => None,
        true => {
            process::check_memory(plan.bytes, "the image by this plan")?;
            let made = watched(setup, quiet, "rendering", |watch| make(scenery, request, watch))?;
            let verdicts = plan.verify(&made.counters);
            Some((made, verdicts))
        }
    };
    Ok(Planned { plan, drawn, outcome })
}

/// Runs work on an image under a progress bar and Ctrl-C.
fn watched<T>(
    setup: &Setup,
    quiet: bool,
    what: &'static str,
    work: impl FnOnce(&Watch<'_>) -> Result<T, MakeError>,
) -> anyhow::Result<T> {
    let cancel = progress::interrupt_flag();
    let total = match setup.request.method {
        m if !m.samples_volume() => setup.scenery.camera.extent().height as u64,
        _ => setup.request.samples,
    };
    let bar = progress::bar(total, quiet);
    bar.set_message(what);
    let advance = |n: u64| bar.inc(n);
    let outcome = work(&Watch { progress: Some(&advance), cancel: Some(&cancel) });
    bar.finish_and_clear();
    match outcome {
        Err(e) if e.is_cancelled() => Err(anyhow::Error::new(Interrupted)),
        other => Ok(other?),
    }
}

/// A broken forecast in words.
fn said(verdict: &Verdict) -> String {
    let counted = verdict.counted.map_or("was not counted".into(), |n| format!("was {n}"));
    match &verdict.forecast {
        Some(forecast) => format!("{} {counted}, forecast {forecast}", verdict.counter),
        None => format!("{} {counted}, and the plan does not know it", verdict.counter),
    }
}

fn record(setup: &Setup, view: &Viewpoint, made: &Planned) -> Value {
    let r = &setup.request;
    let mut record = json!(made.plan);
    record["camera"] =
        json!({ "name": view.label, "view": view.words, "size": setup.scenery.camera.extent().to_string() });
    record["input"] = json!(setup.input);
    record["request"] = json!({
        "method": r.method, "samples": r.samples, "seed": r.seed, "kernel": r.kernel, "estimand": r.estimand,
        "order": r.order, "scramble": r.scramble, "cull": r.cull, "step": r.step, "adaptive": r.adaptive, "tolerance": r.tolerance,
    });
    record["drawn"] = json!(made.drawn);
    if let Some((image, verdicts)) = &made.outcome {
        let with_outcome = |v: &Verdict| {
            let mut verdict = json!(v);
            verdict["holds"] = json!(v.holds());
            verdict
        };
        record["verdicts"] = verdicts.iter().map(with_outcome).collect();
        record["holds"] = json!(verdicts.iter().all(Verdict::holds));
        record["seconds"] = json!(image.seconds.complete);
    }
    record
}
