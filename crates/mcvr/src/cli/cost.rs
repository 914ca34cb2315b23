//! `mcvr cost`: which method reaches which error in how many seconds.

use std::io::Write;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};
use mcvr::harness::cost::{CostMeta, CostOptions, CostRun, Entrant, Subject, cost_lines, read_peers};
use mcvr::harness::{self, RunWatch, Truth};
use mcvr::raycast::{RaycastError, serves_adaptive_rays};
use mcvr::sampling::check_samples;
use mcvr::scene::{Camera, Density, Extent, Kernel};
use mcvr::{Contestant, Method, Scenery, Timed};
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::args::{BudgetArgs, DensityArgs, MethodArgs, ToneArgs, ViewArgs, VolumeArgs};
use super::converge::{command, scene_words, truth_size};
use super::effect_args::EffectArgs;
use super::export::subject;
use super::setup::{Setup, setup};
use super::truth::{dataset, truth};
use super::{Interrupted, numbers, outputs, process, progress};

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr cost lobster.mha --view 30,60 -o cost\n  \
    mcvr cost lobster.mha --view 30,60 --peers peers.jsonl -o cost       with RTK, plastimatch and VTK beside (scripts/peers)\n  \
    mcvr cost phantom:lobster --sizes 64,128,256,512 --methods mc,qmc,march --repeats 3 -o sizes\n\n\
    The report is OUT/report.html (and report.md): time to each error with the quickest marked, on one thread and on all;\n\
    totals for many views; where methods overtake each other; a model of the time. With --sizes also a map of the quickest\n\
    method by volume size and error. Ctrl-C keeps what is finished; the same command resumes.")]
pub struct Args {
    #[command(flatten)]
    volume: VolumeArgs,
    /// Folder for records, plots, images and the report; an unfinished run in it is resumed
    #[arg(long = "output", short, value_name = "DIR", required = true)]
    out: PathBuf,
    /// Phantoms: measure this one at each of these sizes (voxels along the longest axis)
    #[arg(long, value_name = "LIST", value_delimiter = ',', help_heading = "Volume")]
    sizes: Vec<usize>,
    /// Methods: mc, mc-quicksort, mc-binary, mc-linear, stratified, qmc, cloud (kept points, projected), rays, comb, march,
    /// adaptive (rays and combs where the image needs them), footprint, auto (whatever is chosen for each error), exact [default: all
    /// but mc-binary and mc-linear; rays, adaptive, cloud and footprint where there are no effects, adaptive and footprint for tent]
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = entry, help_heading = "Method")]
    methods: Option<Vec<Entry>>,
    /// Sample counts, tried from small to large until an image takes too long
    #[arg(
        long,
        value_name = "LIST",
        default_value = "2^10,2^12,2^14,2^16,2^18,2^20,2^22,2^24,2^26,2^28,2^30",
        help_heading = "Method"
    )]
    samples: String,
    /// March: steps in voxels, each with 1, 4, 9 and 16 rays a pixel
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "2,1,0.5", help_heading = "Method")]
    steps: Vec<f64>,
    /// Comb: distances of samples in voxels, each with 1, 4 and 9 rays a pixel, with one ray for 4, 9 and 16 pixels, and adaptive
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "8,4,2", help_heading = "Method")]
    combs: Vec<f64>,
    /// Exact: tolerances
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "0.1,0.01,0.001", help_heading = "Method")]
    tolerances: Vec<f64>,
    /// Independent repeats of each image
    #[arg(long, value_name = "R", default_value_t = 5, help_heading = "Method")]
    repeats: u32,
    /// Budgets are not raised further once a view takes longer than this, in seconds (sums over the volume apart)
    #[arg(long, value_name = "S", default_value_t = 1.0, help_heading = "Method")]
    longest: f64,
    /// Errors to reach, in percent of the mean pixel
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "30,10,3,1,0.3", help_heading = "Method")]
    targets: Vec<f64>,
    /// Show other systems beside the methods: a record that scripts/peers/compare.py measured on the same scan, view and size
    #[arg(long, value_name = "FILE", conflicts_with = "sizes")]
    peers: Option<PathBuf>,
    #[command(flatten)]
    method: MethodArgs,
    #[command(flatten)]
    view: ViewArgs,
    #[command(flatten)]
    density: DensityArgs,
    #[command(flatten)]
    effects: EffectArgs,
}

/// A word of `--methods`; the march stands for all its steps.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Entry {
    Sampler(Method),
    Cloud,
    Rays,
    Comb,
    Adaptive,
    Footprint,
    March,
    Auto,
    Exact,
}

fn entry(text: &str) -> Result<Entry, String> {
    match text {
        "cloud" | "qmc-cloud" => Ok(Entry::Cloud),
        "march" => Ok(Entry::March),
        "rays" => Ok(Entry::Rays),
        "comb" => Ok(Entry::Comb),
        "adaptive" => Ok(Entry::Adaptive),
        "footprint" => Ok(Entry::Footprint),
        "auto" => Ok(Entry::Auto),
        "exact" => Ok(Entry::Exact),
        other => other.parse().map(Entry::Sampler).map_err(|e| format!("{e}, cloud")),
    }
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    let samples = numbers::counts(&args.samples).map_err(anyhow::Error::msg).context("--samples")?;
    check(args, &samples)?;
    let inputs = inputs(args)?;
    let cancel = progress::interrupt_flag();
    let lanes = lanes()?;
    let pools: Vec<ThreadPool> = lanes
        .iter()
        .map(|&n| ThreadPoolBuilder::new().num_threads(n).build().with_context(|| format!("cannot start {n} threads")))
        .collect::<anyhow::Result<_>>()?;
    let mut run: Option<CostRun> = None;
    let mut complete = true;
    for input in &inputs {
        let volume = VolumeArgs { input: Some(input.clone()), ..args.volume.clone() };
        let setup = subject_setup(args, if args.sizes.is_empty() { &args.volume } else { &volume })?;
        let density = Density::new(&setup.scenery.volume, setup.scenery.map.clone())?;
        let packets = serves_adaptive_rays(&density);
        if !packets && args.methods.as_ref().is_some_and(|m| m.contains(&Entry::Adaptive)) {
            bail!("--methods: {}; leave out adaptive", RaycastError::Packets);
        }
        // Read before the folder is claimed: a record of something else stops the run at once.
        let peers = args.peers.as_ref().map(|path| read_peers(path, &subject(&setup, density.mass()))).transpose()?;
        let cost = match &mut run {
            Some(run) => run,
            None => run.insert(CostRun::open(options(args, &setup, &density, &lanes)?)?),
        };
        cost.show_peers(peers.unwrap_or_default());
        for note in setup.notes.iter().filter(|_| !quiet) {
            say!("mcvr: note: {note}");
        }
        let name = dataset(&setup);
        let stem = if args.sizes.is_empty() { "truth".to_owned() } else { format!("truth-{}", input_slug(&name)) };
        let truth = truth(&setup, density.mass(), (&args.out, &stem), &|_| Ok(()), &cancel, quiet);
        let truth = match truth {
            Err(e) if e.is::<Interrupted>() => {
                complete = false;
                break;
            }
            other => other?,
        };
        complete = measure(cost, args, (&setup, packets), &name, &truth, &samples, &pools, &cancel, quiet)?;
        if !complete {
            break;
        }
    }
    let Some(run) = run else { bail!("nothing to measure") };
    let summary = run.finish()?;
    if !complete {
        say!("mcvr: finished records are kept in {}; the same command resumes", args.out.display());
        return Err(anyhow::Error::new(Interrupted));
    }
    if !quiet {
        let mut out = outputs::stdout();
        writeln!(out, "Report: {}", args.out.join("report.html").display())?;
        for line in cost_lines(&summary) {
            writeln!(out, "  {line}")?;
        }
    }
    Ok(())
}

/// Refuses what cannot be measured, before anything is read or written.
fn check(args: &Args, samples: &[u64]) -> anyhow::Result<()> {
    let methods = args.methods.as_deref().unwrap_or(&METHODS);
    if methods.iter().any(|m| matches!(m, Entry::Sampler(_) | Entry::Cloud)) {
        samples.iter().try_for_each(|&m| check_samples(m))?;
    }
    let positive = |option: &str, values: &[f64]| match values.iter().find(|v| !(**v > 0.0 && v.is_finite())) {
        Some(v) => bail!("{option}: {v} is not a positive number"),
        None => Ok(()),
    };
    positive("--steps", &args.steps)?;
    positive("--combs", &args.combs)?;
    positive("--targets", &args.targets)?;
    positive("--longest", &[args.longest])?;
    positive("--tolerances", &args.tolerances)?;
    if let Some(t) = args.tolerances.iter().find(|t| **t >= 1.0) {
        bail!("--tolerances: {t} is not below 1; 0.01 is one per cent of the mean pixel");
    }
    Ok(())
}

/// The volumes: the one given, or the phantom at each size.
fn inputs(args: &Args) -> anyhow::Result<Vec<String>> {
    let input = args.volume.input.clone().unwrap_or_default();
    if args.sizes.is_empty() {
        return Ok(vec![input]);
    }
    let Some(name) = input.strip_prefix("phantom:") else {
        bail!("--sizes: only a phantom has several sizes, and '{input}' is none; try phantom:lobster")
    };
    if name.contains('@') {
        bail!("--sizes: {input} has a size already; give phantom:{}", name.split('@').next().unwrap_or(name));
    }
    let mut sizes = args.sizes.clone();
    sizes.sort_unstable();
    sizes.dedup();
    Ok(sizes.into_iter().map(|n| format!("{input}@{n}")).collect())
}

/// One thread, and as many as the program may use.
fn lanes() -> anyhow::Result<Vec<usize>> {
    let all = rayon::current_num_threads();
    Ok(if all > 1 { vec![1, all] } else { vec![1] })
}

fn subject_setup(args: &Args, volume: &VolumeArgs) -> anyhow::Result<Setup> {
    let setup = setup(
        volume,
        &args.density,
        &args.view,
        &args.method,
        &BudgetArgs::default(),
        &ToneArgs::default(),
        &args.effects,
    )?;
    setup.check_one_camera("cost")?;
    setup.check_effects()?;
    let asked = |entry| args.methods.as_ref().is_some_and(|m| m.contains(&entry));
    if !setup.scenery.effects.is_plain() && asked(Entry::Cloud) {
        bail!("--methods: a cloud holds positions only and shows the plain X-ray; leave out cloud, or the effects");
    }
    if asked(Entry::Rays) && !serves(Entry::Rays, &setup) {
        bail!("--methods: exact rays know no effects; leave out rays, or the effects");
    }
    if asked(Entry::Adaptive) && !serves(Entry::Adaptive, &setup) {
        bail!(
            "--methods: adaptive rays make plain X-rays of kernel tent; leave out adaptive, or the effects and --kernel"
        );
    }
    if asked(Entry::Footprint) && !serves(Entry::Footprint, &setup) {
        bail!(
            "--methods: footprint makes plain X-rays of kernel tent; leave out footprint, or the effects and --kernel"
        );
    }
    let size = truth_size(&setup)?;
    process::check_memory(40 * size.pixels() as u64, &format!("comparing images of {size} pixels"))?;
    Ok(setup)
}

fn options(args: &Args, setup: &Setup, density: &Density, lanes: &[usize]) -> anyhow::Result<CostOptions> {
    let (title, scene) = if args.sizes.is_empty() {
        (dataset(setup), scene_words(setup, density))
    } else {
        // The mass is that of one size only.
        let words = scene_words(setup, density);
        let rest = words.split_once("; ").map_or("", |(_, rest)| rest);
        (args.volume.input.clone().unwrap_or_default(), format!("{:?}; {rest}", setup.scenery.map.transfer))
    };
    Ok(CostOptions {
        repeats: args.repeats,
        seed: setup.request.seed,
        longest: args.longest,
        targets: args.targets.iter().map(|t| t / 100.0).collect(),
        out: args.out.clone(),
        meta: CostMeta {
            title,
            view: setup.view.clone(),
            size: setup.scenery.camera.extent().to_string(),
            kernel: setup.request.kernel,
            estimand: setup.request.estimand,
            scene,
            threads: lanes.to_vec(),
            machine: harness::machine(),
            commit: harness::git_commit(),
            command: command(),
        },
    })
}

/// The methods of a run that names none, where they serve the scene.
const METHODS: [Entry; 12] = [
    Entry::Sampler(Method::Mc),
    Entry::Sampler(Method::Stratified),
    Entry::Sampler(Method::Qmc),
    Entry::Rays,
    Entry::Comb,
    Entry::Adaptive,
    Entry::Footprint,
    Entry::March,
    Entry::Auto,
    Entry::Exact,
    Entry::Cloud,
    Entry::Sampler(Method::McQuicksort),
];

/// Whether a method makes images of the scene.
fn serves(entry: Entry, setup: &Setup) -> bool {
    let plain = setup.scenery.effects.is_plain();
    match entry {
        Entry::Cloud | Entry::Rays => plain,
        Entry::Adaptive => plain && setup.request.kernel == Kernel::Tent,
        Entry::Footprint => plain && Method::Footprint.knows(setup.request.kernel),
        _ => true,
    }
}

/// The contestants of the options, in their order; `packets` where adaptive rays serve the density.
fn contestants(args: &Args, setup: &Setup, packets: bool) -> Vec<Contestant> {
    let entries = match &args.methods {
        Some(asked) => asked.clone(),
        None => METHODS.into_iter().filter(|e| serves(*e, setup) && (packets || *e != Entry::Adaptive)).collect(),
    };
    entries
        .iter()
        .flat_map(|entry| match entry {
            Entry::Sampler(method) => vec![Contestant::Sampler(*method)],
            Entry::Cloud => vec![Contestant::Cloud],
            Entry::Exact => vec![Contestant::Exact],
            Entry::Rays => vec![Contestant::Rays],
            Entry::Footprint => vec![Contestant::Footprint],
            Entry::Auto => vec![Contestant::Auto],
            Entry::Comb => args.combs.iter().map(|&s| Contestant::Comb(s)).collect(),
            Entry::Adaptive => {
                let combs = args.combs.iter().map(|&s| Some(s));
                combs.chain([None]).map(Contestant::Adaptive).collect()
            }
            Entry::March => args.steps.iter().map(|&s| Contestant::March(s)).collect(),
        })
        .collect()
}

/// Budgets of a contestant for images of so many pixels.
fn ladder(args: &Args, setup: &Setup, contestant: Contestant, samples: &[u64], pixels: u64) -> Vec<u64> {
    // One ray for 4 by 4, 3 by 3 and 2 by 2 pixels, where these are averaged.
    let blocks = if setup.scenery.effects.is_plain() && !setup.request.jitter { &[16, 9, 4][..] } else { &[] };
    let mut budgets: Vec<u64> = match contestant {
        Contestant::Sampler(_) | Contestant::Cloud => {
            samples.iter().copied().filter(|&m| m <= contestant.most()).collect()
        }
        Contestant::March(_) => [1, 4, 9, 16].iter().map(|rays| rays * pixels).collect(),
        Contestant::Rays | Contestant::Comb(_) => {
            let rays = [1, 4, 9].iter().map(|rays| rays * pixels);
            blocks.iter().map(|of| pixels.div_ceil(*of)).chain(rays).collect()
        }
        Contestant::Footprint => vec![1],
        Contestant::Auto | Contestant::Adaptive(_) => {
            args.targets.iter().map(|percent| (100.0 / percent).round() as u64).collect()
        }
        Contestant::Exact => args.tolerances.iter().map(|t| (1.0 / t).round() as u64).collect(),
    };
    budgets.sort_unstable();
    budgets.dedup();
    budgets
}

#[expect(clippy::too_many_arguments, reason = "one call; a struct for it would say no more")]
fn measure(
    run: &mut CostRun,
    args: &Args,
    (setup, packets): (&Setup, bool),
    name: &str,
    truth: &Truth,
    samples: &[u64],
    pools: &[ThreadPool],
    cancel: &AtomicBool,
    quiet: bool,
) -> anyhow::Result<bool> {
    let voxels = setup.scenery.volume.grid().dims().iter().map(|&n| n as u64).product();
    let (size, half) = (setup.scenery.camera.extent(), half_size(setup)?);
    let bar = progress::bar(1, quiet);
    let report = |done: u64, total: u64, next: &str| {
        bar.set_length(total);
        bar.set_position(done);
        bar.set_message(next.to_owned());
    };
    let watch = RunWatch { cancel, progress: &report };
    // A second image size, for the model of the time: few budgets, no truth.
    let few: Vec<u64> = samples.iter().copied().filter(|m| [1 << 14, 1 << 18, 1 << 22].contains(m)).collect();
    let mut complete = true;
    for (scenery, truth, samples) in [(&setup.scenery, Some(truth), samples), (&half, None, &few[..])] {
        let extent = scenery.camera.extent();
        if !complete || (truth.is_none() && (samples.is_empty() || extent == size)) {
            break;
        }
        let timed: Vec<(Contestant, usize, Timed<'_>)> = pools
            .iter()
            .flat_map(|pool| contestants(args, setup, packets).into_iter().map(move |c| (c, pool)))
            .filter(|(c, _)| {
                truth.is_some() || !matches!(c, Contestant::Exact | Contestant::Auto | Contestant::Adaptive(_))
            })
            .map(|(c, pool)| (c, pool.current_num_threads(), Timed::new(c, scenery, setup.request, pool, Some(cancel))))
            .collect();
        let entrants: Vec<Entrant<'_>> = timed
            .iter()
            .map(|(contestant, threads, method)| Entrant {
                method,
                threads: *threads,
                ladder: ladder(args, setup, *contestant, samples, extent.pixels() as u64),
                preparations: contestant.preparations(setup.request.order),
                plotted: !matches!(contestant, Contestant::Cloud | Contestant::Sampler(Method::McQuicksort)),
            })
            .collect();
        let size = truth.map_or(Ok(extent), |_| truth_size(setup))?;
        let pictures = truth.is_some() && args.sizes.is_empty();
        let subject = Subject { dataset: name, voxels, truth, size, entrants: &entrants, pictures };
        complete = run.measure(&subject, watch)?;
    }
    bar.finish_and_clear();
    Ok(complete)
}

/// The same view in half the pixels along each edge.
fn half_size(setup: &Setup) -> anyhow::Result<Scenery> {
    let camera = &setup.scenery.camera;
    let (from, to) =
        (camera.extent(), Extent::new((camera.extent().width / 2).max(1), (camera.extent().height / 2).max(1))?);
    let mut matrix = camera.world_to_pixel();
    for (row, scale) in [(0, to.width as f64 / from.width as f64), (1, to.height as f64 / from.height as f64)] {
        matrix[row].iter_mut().for_each(|v| *v *= scale);
    }
    let near = (!camera.is_parallel()).then(|| camera.near());
    let camera = Camera::from_matrix(matrix, to, setup.scenery.volume.grid(), near)?;
    Ok(Scenery { camera, ..setup.scenery.clone() })
}

/// Letters, digits and dashes of a name.
fn input_slug(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_are_read() {
        assert_eq!(entry("march"), Ok(Entry::March));
        assert_eq!(entry("cloud"), Ok(Entry::Cloud));
        assert_eq!(entry("mc-quicksort"), Ok(Entry::Sampler(Method::McQuicksort)));
        assert!(entry("raster").unwrap_err().contains("cloud"));
    }
}
