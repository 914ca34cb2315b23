//! `mcvr claims`

use std::io::Write;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use anyhow::bail;
use mcvr::claims::{Bench, CATALOGUE, Claim, Options};
use mcvr::scene::film;
use mcvr::scene::{DensityMap, Effects};
use mcvr::{Request, Scenery};

use super::args::{BudgetArgs, DensityArgs, MethodArgs, ToneArgs, ViewArgs, VolumeArgs};
use super::claims_text::{self, Tested};
use super::effect_args::EffectArgs;
use super::setup::{Setup, setup};
use super::{Interrupted, numbers, outputs, process, progress};

/// What the truth may be off, unless asked otherwise: claims are judged by errors of 1 % and more.
const TOLERANCE: f64 = 1e-3;

/// Tests the claims of Law and Blythe's report on a volume, each by a criterion that was fixed beforehand.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    mcvr claims                                  all claims on a phantom: two to three minutes on two cores\n  \
    mcvr claims lobster.mha --view 30,60         on a scan; other sizes are copies of it by nearest neighbours\n  \
    mcvr claims --only sorting --only shading    some of them\n  \
    mcvr claims --list                           what is claimed, how it is tested and judged\n  \
    mcvr claims head.nrrd --markdown -o claims.md\n\n\
    The truth of thin structures takes minutes; --tolerance 1e-2 is quicker and fine enough for most claims.\n\
    Times differ between machines and runs; a verdict is marked uncertain where the spread of its figures\n    \
    reaches across a limit of its criterion.\n\
    Exit status: 0 all tested, whatever the verdicts, 1 a measurement failed, 130 interrupted.")]
pub struct Args {
    #[command(flatten)]
    volume: VolumeArgs,
    /// Only this claim, by name; repeatable
    #[arg(long, value_name = "NAME", value_delimiter = ',', value_parser = claim)]
    only: Vec<&'static str>,
    /// Print the claims with their criteria without testing them
    #[arg(long)]
    list: bool,
    /// How often everything that is timed is repeated
    #[arg(long, value_name = "R", default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Longest sides, in voxels, of the volumes that data-size compares: a list, or a range that doubles [default:
    /// 64,96,128,192,256,384,512]
    #[arg(long, value_name = "LIST")]
    sizes: Option<String>,
    /// Volumes of 768 and 1024 voxels along the longest side too: gigabytes of memory, minutes
    #[arg(long)]
    large: bool,
    /// Print the table as Markdown
    #[arg(long, conflicts_with_all = ["json", "list"])]
    markdown: bool,
    /// Print everything as JSON
    #[arg(long, conflicts_with = "list")]
    json: bool,
    /// Write the table to a file instead
    #[arg(long = "output", short, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    method: MethodArgs,
    #[command(flatten)]
    view: ViewArgs,
    #[command(flatten)]
    density: DensityArgs,
}

fn claim(name: &str) -> Result<&'static str, String> {
    let names: Vec<&str> = CATALOGUE.iter().map(|c| c.name).collect();
    names
        .iter()
        .find(|n| **n == name)
        .copied()
        .ok_or_else(|| format!("unknown claim '{name}'; one of {}", names.join(", ")))
}

pub fn run(args: &Args, quiet: bool) -> anyhow::Result<()> {
    outputs::check(&args.out, &[args.volume.file(), args.method.scene.as_deref(), args.view.matrix.as_deref()])?;
    let claims: Vec<&Claim> =
        CATALOGUE.iter().filter(|c| args.only.is_empty() || args.only.contains(&c.name)).collect();
    if args.list {
        return put(args, &claims_text::list(&claims));
    }
    let options = Options { repeats: args.repeats, sizes: sizes(args)?, free_memory: process::free_memory() };
    let setup = plain_setup(args, quiet)?;
    let tested = test(&claims, &setup, &options, quiet)?;
    let about = claims_text::about(&setup, &options);
    if tested.len() < claims.len() {
        // What is finished is kept, but not in the place of a whole table.
        if !tested.is_empty() {
            write!(outputs::stdout(), "{}", claims_text::plain(&tested, &about))?;
        }
        return Err(anyhow::Error::new(Interrupted));
    }
    let text = match (args.json, args.markdown) {
        (true, _) => claims_text::json(&tested, &about)?,
        (_, true) => claims_text::markdown(&tested, &about),
        _ => claims_text::plain(&tested, &about),
    };
    put(args, &text)?;
    match tested.iter().filter(|(_, o)| o.error.is_some()).count() {
        0 => Ok(()),
        n => bail!("{n} of {} claims could not be measured", tested.len()),
    }
}

fn sizes(args: &Args) -> anyhow::Result<Vec<usize>> {
    let mut sizes = match &args.sizes {
        None => Options::SIZES.to_vec(),
        Some(list) => {
            let counts = numbers::counts(list).map_err(|e| anyhow::anyhow!("--sizes: {e}"))?;
            counts.into_iter().map(|n| n as usize).collect()
        }
    };
    if args.large {
        sizes.extend(Options::LARGE);
    }
    sizes.sort_unstable();
    sizes.dedup();
    if let Some(size) = sizes.iter().find(|s| **s > 1 << 13) {
        bail!("--sizes: {size} voxels along a side are too many; at most {}", 1 << 13);
    }
    Ok(sizes)
}

/// The scene without its effects, of the default phantom where no volume is named.
fn plain_setup(args: &Args, quiet: bool) -> anyhow::Result<Setup> {
    let mut volume = args.volume.clone();
    if volume.input.is_none() && args.method.scene.is_none() {
        volume.input = Some("phantom:lobster@256".into());
    }
    let (effects, tone, budget) = (EffectArgs::default(), ToneArgs::default(), BudgetArgs::default());
    let mut setup = setup(&volume, &args.density, &args.view, &args.method, &budget, &tone, &effects)?;
    setup.check_one_camera("claims")?;
    let mut notes = std::mem::take(&mut setup.notes);
    if !setup.scenery.effects.is_plain() {
        notes.push("the claims are about plain X-rays; the scene's effects play no part".into());
    }
    notes.iter().filter(|_| !quiet).for_each(|note| say!("mcvr: note: {note}"));
    if args.method.tolerance.is_none() && setup.request.tolerance == Request::default().tolerance {
        setup.request.tolerance = TOLERANCE;
    }
    let Scenery { volume, map, camera, .. } = setup.scenery;
    let map = DensityMap { gains: None, ..map };
    setup.scenery = Scenery { volume, map, camera, effects: Effects::default() };
    Ok(setup)
}

/// Tests one claim after another; Ctrl-C ends within the one in progress, which then has no outcome.
fn test<'a>(claims: &[&'a Claim], setup: &Setup, options: &Options, quiet: bool) -> anyhow::Result<Vec<Tested<'a>>> {
    let cancel = progress::interrupt_flag();
    let bar = progress::bar(claims.len() as u64, quiet);
    let current = std::cell::Cell::new("");
    let say = |what: &str| bar.set_message(format!("{}: {what}", current.get()));
    let bench = Bench::new(&setup.scenery, setup.request, &setup.input, options, &cancel, &say)?;
    let mut tested = Vec::with_capacity(claims.len());
    for claim in claims {
        current.set(claim.name);
        let outcome = if cancel.load(Ordering::Relaxed) { None } else { claim.test(&bench) };
        let Some(outcome) = outcome else { break };
        tested.push((*claim, outcome));
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(tested)
}

fn put(args: &Args, text: &str) -> anyhow::Result<()> {
    match args.out.as_deref().filter(|path| *path != std::path::Path::new("-")) {
        None => Ok(outputs::stdout().write_all(text.as_bytes())?),
        Some(path) => Ok(film::write_whole(path, |out| out.write_all(text.as_bytes()))?),
    }
}
