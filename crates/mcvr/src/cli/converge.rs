//! `mcvr converge`, and the tour that runs without a command.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, bail};
use mcvr::harness::{self, Claim, ConvergeOptions, RunMeta, RunSummary, RunWatch, Truth};
use mcvr::sampling::check_samples;
use mcvr::scene::{Density, Extent};
use mcvr::{Measured, Method, Request};
use serde_json::json;

use super::args::{BudgetArgs, DensityArgs, MethodArgs, ToneArgs, ViewArgs, VolumeArgs};
use super::effect_args::EffectArgs;
use super::setup::{Setup, setup};
use super::truth::{dataset, truth};
use super::{Interrupted, numbers, outputs, process, progress};

#[derive(clap::Args, Default)]
#[command(after_help = "Examples:\n  \
    mcvr converge phantom:lobster -o results\n  \
    mcvr converge lobster.mha --methods mc,qmc --samples 2^10..2^24 --replicates 8 --view 30,60 -o results\n\n\
    Ctrl-C keeps what is finished; the same command resumes. The report is OUT/report.html.")]
pub struct Args {
    #[command(flatten)]
    volume: VolumeArgs,
    /// Folder for records, plots, images and the report; an unfinished run in it is resumed
    #[arg(long = "output", short, value_name = "DIR", required = true)]
    out: PathBuf,
    /// Methods to measure
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        default_value = "mc,stratified,qmc,march",
        help_heading = "Method"
    )]
    methods: Vec<Method>,
    /// Sample counts: a list, or a range that doubles
    #[arg(long, value_name = "LIST", default_value = "2^10..2^22", help_heading = "Method")]
    samples: String,
    /// Independent repeats at each sample count
    #[arg(long, value_name = "R", default_value_t = 8, help_heading = "Method")]
    replicates: u32,
    /// Sample counts of the image series; `none` for no images
    #[arg(
        long,
        value_name = "LIST",
        default_value = "31250,62500,125000,250000,500000,1000000",
        help_heading = "Method"
    )]
    series: String,
    #[command(flatten)]
    method: MethodArgs,
    #[command(flatten)]
    view: ViewArgs,
    #[command(flatten)]
    density: DensityArgs,
    #[command(flatten)]
    effects: EffectArgs,
}

/// The tour: a phantom, four methods, about a minute.
pub fn demo(quiet: bool) -> anyhow::Result<()> {
    let args = Args {
        volume: VolumeArgs { input: Some("phantom:lobster@160x172x40".into()), ..VolumeArgs::default() },
        out: PathBuf::from("mcvr-out/demo"),
        methods: vec![Method::Mc, Method::Stratified, Method::Qmc, Method::March],
        samples: "2^10..2^23".into(),
        replicates: 8,
        series: "31250,62500,125000,250000,500000,1000000".into(),
        view: ViewArgs { view: Some([30.0, 60.0]), size: "300x300".parse().ok(), ..ViewArgs::default() },
        ..Args::default()
    };
    if !quiet {
        say!("Measuring Monte Carlo, stratified, quasi-Monte Carlo and a ray march on an embedded phantom.");
    }
    run(&args, quiet)
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    let samples = numbers::counts(&args.samples).map_err(anyhow::Error::msg).context("--samples")?;
    let series = match args.series.as_str() {
        "none" => vec![],
        list => numbers::counts(list).map_err(anyhow::Error::msg).context("--series")?,
    };
    if args.methods.iter().any(|m| m.samples_volume()) {
        samples.iter().chain(&series).try_for_each(|&m| check_samples(m))?;
    }
    if args.methods.contains(&Method::Exact) {
        bail!("--methods: exact is the truth that the others are measured against");
    }
    if args.methods.contains(&Method::Footprint) {
        bail!(
            "--methods: footprint adds all voxels and has no budget to vary; `mcvr cost --methods footprint` measures its one image"
        );
    }
    if args.methods.contains(&Method::Auto) {
        bail!(
            "--methods: auto has no budget of its own to vary; `mcvr cost --methods auto` measures it error by error"
        );
    }
    let setup = setup(
        &args.volume,
        &args.density,
        &args.view,
        &args.method,
        &BudgetArgs::default(),
        &ToneArgs::default(),
        &args.effects,
    )?;
    setup.check_one_camera("converge")?;
    setup.check_effects()?;
    if setup.film.is_transmission() && !quiet {
        say!("mcvr: note: the line integral is measured; the scene's film plays no part");
    }
    for note in setup.notes.iter().filter(|_| !quiet) {
        say!("mcvr: note: {note}");
    }
    let (cancel, truth_size) = (progress::interrupt_flag(), truth_size(&setup)?);
    // Truth, image, difference and what is written of them.
    process::check_memory(40 * truth_size.pixels() as u64, &format!("comparing images of {truth_size} pixels"))?;
    let density = Density::new(&setup.scenery.volume, setup.scenery.map.clone())?;
    let requests = args.methods.iter().map(|&method| Request { method, ..setup.request });
    let methods: Vec<Measured<'_>> = requests.map(|r| Measured::new(&setup.scenery, r, Some(&*cancel))).collect();
    let methods: Vec<&dyn harness::Method> = methods.iter().map(|m| m as _).collect();
    let options = ConvergeOptions {
        samples,
        replicates: args.replicates,
        seed: setup.request.seed,
        series,
        out: args.out.clone(),
        meta: meta(&setup, &density),
    };
    options.check(&methods)?;
    let claim = Claim::lay(&options, truth_size)?;
    let confirm = |truth: &Truth| Ok(claim.confirm(&options, truth)?);
    let truth = truth(&setup, density.mass(), (&options.out, "truth"), &confirm, &cancel, quiet)?;
    let summary = measure(claim, &methods, &truth, &options, &cancel, quiet)?;
    if cancel.load(Ordering::Relaxed) {
        say!("mcvr: finished records are kept in {}; the same command resumes", args.out.display());
        return Err(anyhow::Error::new(Interrupted));
    }
    if !quiet {
        let mut out = outputs::stdout();
        writeln!(out, "Report: {}", args.out.join("report.html").display())?;
        for line in harness::key_lines(&summary) {
            writeln!(out, "  {line}")?;
        }
    }
    Ok(())
}

/// Size of the truth: the image, or three channels of a coloured one, one below the other.
pub fn truth_size(setup: &Setup) -> anyhow::Result<Extent> {
    let camera = &setup.scenery.camera;
    let channels = setup.scenery.effects.look(setup.scenery.volume.grid(), camera)?.channels();
    Ok(Extent::new(camera.extent().width, camera.extent().height * channels)?)
}

fn measure(
    claim: Claim,
    methods: &[&dyn harness::Method],
    truth: &Truth,
    options: &ConvergeOptions,
    cancel: &AtomicBool,
    quiet: bool,
) -> anyhow::Result<RunSummary> {
    let bar = progress::bar(1, quiet);
    let report = |done: u64, total: u64, next: &str| {
        bar.set_length(total);
        bar.set_position(done);
        bar.set_message(next.to_owned());
    };
    let outcome = claim.converge(methods, truth, options, RunWatch { cancel, progress: &report });
    bar.finish_and_clear();
    Ok(outcome?)
}

fn meta(setup: &Setup, density: &Density) -> RunMeta {
    RunMeta {
        dataset: dataset(setup),
        view: setup.view.clone(),
        kernel: setup.request.kernel,
        estimand: setup.request.estimand,
        density: scene_words(setup, density),
        threads: rayon::current_num_threads(),
        machine: harness::machine(),
        commit: harness::git_commit(),
        command: command(),
    }
}

/// Everything about the images that has no field of its own, in words.
pub fn scene_words(setup: &Setup, density: &Density) -> String {
    let mass = density.report();
    let clamped = match mass.negative {
        0 => String::new(),
        n => format!("; {n} negative voxels count as 0, dropping {:.4e}", mass.dropped),
    };
    let effects = match setup.scenery.effects.is_plain() {
        true => String::new(),
        false => format!("; effects {}", json!(setup.scenery.effects)),
    };
    let order = setup.request.order.resolve(&setup.scenery.camera, setup.scenery.volume.grid());
    format!(
        "{:?}, mass {:.6e}; voxel order {}, scramble {}{clamped}{effects}",
        setup.scenery.map.transfer,
        mass.mass,
        order.name(),
        setup.request.scramble.name()
    )
}

/// The command line as given, paths of folders left out.
pub fn command() -> String {
    let mut words = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).map(|word| {
        match Path::new(&word).file_name() {
            Some(name) if word.starts_with('/') => name.to_string_lossy().into_owned(),
            _ => word,
        }
    });
    std::iter::once("mcvr".to_owned()).chain(&mut words).collect::<Vec<_>>().join(" ")
}
