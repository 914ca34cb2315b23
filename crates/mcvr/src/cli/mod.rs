//! Command line: arguments in, one line of error and a hint out.

/// Says something on standard error. Where nobody listens any more (`2>&1 | head -1`), the work goes on.
macro_rules! say {
    ($($text:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), $($text)*);
    }};
}

mod args;
mod bench;
mod bench_checks;
mod choice_text;
mod claims;
mod claims_text;
mod compare;
mod converge;
mod cost;
mod effect_args;
mod export;
mod hardcases;
mod history;
mod info;
mod numbers;
mod orbit;
mod outputs;
mod plan;
mod plan_text;
// Until `render` calls them.
mod preview;
mod process;
mod progress;
mod progressive;
mod project;
mod radiograph;
mod refined;
mod render;
mod sample;
mod schema;
mod setup;
mod truth;
mod watching;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// X-ray images of 3-D scans by Monte Carlo, with their error and their cost.
///
/// Without a command: measures Monte Carlo, stratified, quasi-Monte Carlo and ray casting on an embedded phantom
/// in about a minute and writes a report to ./mcvr-out/demo.
#[derive(Parser)]
#[command(
    name = "mcvr",
    version,
    about,
    long_about,
    after_help = "Examples:\n  \
    mcvr                                             a measured tour on a phantom\n  \
    mcvr render phantom:lobster -o lobster.png       an X-ray of a phantom\n  \
    mcvr render head.nrrd --samples 2^24 -o head.exr linear values, 16 million samples\n  \
    mcvr orbit phantom:lobster -o turntable.png      an animation from one point cloud\n  \
    mcvr plan examples/shaded.toml                   the passes of a scene, and what they take\n  \
    mcvr info scan.nii.gz                            what is in a file\n  \
    mcvr converge lobster.mha -o results             error and time against the sample count\n  \
    mcvr cost lobster.mha -o cost                    which method reaches which error in how many seconds\n\n\
    Exit status: 0 done, 1 failed, 2 wrong usage, 130 interrupted."
)]
struct Cli {
    /// Threads to use [default: all processors]
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print nothing but errors
    #[arg(long, short, global = true)]
    quiet: bool,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// Make one image
    Render(Box<render::Args>),
    /// Say what an image will take, pass by pass, without making it
    Plan(Box<plan::Args>),
    /// Draw a point cloud, to be projected from any view
    Sample(Box<sample::Args>),
    /// Make an image of a point cloud
    Project(Box<project::Args>),
    /// Make a turntable of a volume or a point cloud
    Orbit(Box<orbit::Args>),
    /// Measure methods against the ray-cast truth over sample counts
    Converge(Box<converge::Args>),
    /// Measure what accuracy costs in time: error against seconds, method against method
    Cost(Box<cost::Args>),
    /// Compare two images: errors, bias, a signed difference image
    Compare(compare::Args),
    /// Write a scan, a camera and the truth for other programs
    Export(Box<export::Args>),
    /// Describe a volume file
    Info(info::Args),
    /// Pose the hard cases: where such programs break, measured beside its bound
    Hardcases(hardcases::Args),
    /// Test the claims of the report that this program follows, each with a verdict and its figures
    Claims(Box<claims::Args>),
    /// Hold this program to the committed baseline: accuracy, work, instructions, time
    Bench(bench::Args),
    /// Show recorded results over time
    History(history::Args),
    /// Print the JSON Schema of scene files
    Schema(schema::Args),
}

/// Interrupted by the user; what was finished is kept.
#[derive(Debug)]
struct Interrupted;

impl std::fmt::Display for Interrupted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("interrupted")
    }
}

impl std::error::Error for Interrupted {}

/// Parses, runs, reports.
pub fn run() -> ExitCode {
    let cli = Cli::parse();
    mcvr::keep_freed_memory();
    // Made here in any case: a pool that makes itself panics where it cannot.
    let threads = cli.threads.map_or(0, usize::from);
    if let Err(e) = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global() {
        let number = if threads == 0 { "as many threads as processors".into() } else { format!("{threads} threads") };
        say!("mcvr: cannot start {number}: {e}; --threads asks for fewer");
        return ExitCode::FAILURE;
    }
    let outcome = match cli.command {
        None => converge::demo(cli.quiet),
        Some(Command::Render(args)) => render::run(&args, cli.quiet),
        Some(Command::Plan(args)) => plan::run(&args, cli.quiet),
        Some(Command::Sample(args)) => sample::run(&args, cli.quiet),
        Some(Command::Project(args)) => project::run(&args, cli.quiet),
        Some(Command::Orbit(args)) => orbit::run(&args, cli.quiet),
        Some(Command::Converge(args)) => converge::run(&args, cli.quiet),
        Some(Command::Cost(args)) => cost::run(&args, cli.quiet),
        Some(Command::Compare(args)) => compare::run(&args),
        Some(Command::Export(args)) => export::run(&args, cli.quiet),
        Some(Command::Info(args)) => info::run(&args),
        Some(Command::Hardcases(args)) => hardcases::run(&args, cli.quiet),
        Some(Command::Claims(args)) => claims::run(&args, cli.quiet),
        Some(Command::Bench(args)) => bench::run(&args, cli.quiet),
        Some(Command::History(args)) => history::run(&args),
        Some(Command::Schema(args)) => schema::run(&args),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) if e.is::<Interrupted>() => {
            say!("mcvr: interrupted");
            ExitCode::from(130)
        }
        // A reader that has seen enough (`mcvr info x | head -1`) is no failure.
        Err(e)
            if e.chain().any(|c| {
                c.downcast_ref::<std::io::Error>().is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
            }) =>
        {
            ExitCode::SUCCESS
        }
        Err(e) => {
            say!("mcvr: {}", describe(&e));
            ExitCode::FAILURE
        }
    }
}

/// The error and its causes on one line; a cause that its error already quotes is not repeated.
fn describe(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(ToString::to_string) {
        let cause = cause.trim_end();
        if text.is_empty() {
            text = cause.to_owned();
        } else if !text.contains(cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}
