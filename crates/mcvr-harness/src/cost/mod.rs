//! What accuracy costs in time, method against method: every budget timed on one thread and on all, the work that is
//! done once apart from the work of each view, and from that the time to an error, the points where methods overtake
//! each other, and a model of the time.
//!
//! [`CostRun::open`] claims a folder, [`CostRun::measure`] measures one [`Subject`] after another, and
//! [`CostRun::finish`] writes tables, plots and reports.

mod map;
mod measure;
mod model;
mod models;
mod output;
mod peers;
mod plots;
mod points;
mod reach;
mod report;
mod summary;
mod tables;

use std::path::PathBuf;

use mcvr_scene::{Estimand, Kernel};
use serde::Serialize;

use crate::{Method, Truth};

pub(crate) use report::READING;
pub(crate) use tables::time_to_error_of;

pub use measure::CostRun;
pub use model::CostModel;
pub use peers::{PEERS_RECORD, PeerPoint, read_peers};
pub use points::Point;
pub use reach::{By, Crossing, Reach};
pub use report::cost_lines;
pub use summary::{BreakEven, CostSummary, Meeting, MethodInfo, ReachRow, SizeCrossing, SubjectInfo};

/// Relative errors that the tables ask for when nothing else is said: 30, 10, 3, 1 and 0.3 %.
pub const TARGETS: [f64; 5] = [0.3, 0.1, 0.03, 0.01, 0.003];

/// Numbers of views of one volume that totals are given for.
pub const VIEWS: [u64; 4] = [1, 10, 100, 1000];

/// How to measure and where to put it.
#[derive(Clone, Debug)]
pub struct CostOptions {
    /// Independent repeats of each image; at least 1.
    pub repeats: u32,
    /// Seed of the run; see [`replicate_seed`](crate::converge::replicate_seed).
    pub seed: u64,
    /// A method's budget is not raised further once a view takes longer, what is done once for a volume apart, s.
    pub longest: f64,
    /// Relative errors that the tables ask for.
    pub targets: Vec<f64>,
    /// Folder of all results; made if absent, resumed if it holds the same run.
    pub out: PathBuf,
    /// What is measured, and where.
    pub meta: CostMeta,
}

/// What all subjects of a run share, printed beside the results.
#[derive(Clone, Debug, Serialize)]
pub struct CostMeta {
    /// What is measured, in few words: the input, or the phantom whose sizes are compared.
    pub title: String,
    /// The camera in words.
    pub view: String,
    /// Width x height in pixels of the images whose error is measured.
    pub size: String,
    /// Reconstruction kernel.
    pub kernel: Kernel,
    /// What a pixel means.
    pub estimand: Estimand,
    /// Anything else that decides the images, in words: density map, effects, voxel order, scramble.
    pub scene: String,
    /// Numbers of threads that were measured, ascending.
    pub threads: Vec<usize>,
    /// Processor, cores and memory; see [`machine`](crate::machine()).
    pub machine: String,
    /// Source revision of the program; see [`git_commit`](crate::git_commit).
    pub commit: Option<String>,
    /// The command that repeats this run.
    pub command: String,
}

/// One volume, seen once.
#[derive(Clone, Copy)]
pub struct Subject<'a> {
    /// Name of the volume, or of the volume at this size.
    pub dataset: &'a str,
    /// Voxels of the volume.
    pub voxels: u64,
    /// What all methods converge to. Without it the images are timed only: that is what the model of the time needs of a
    /// second image size.
    pub truth: Option<&'a Truth>,
    /// Width x height of the images.
    pub size: mcvr_scene::Extent,
    /// Who takes part.
    pub entrants: &'a [Entrant<'a>],
    /// Whether pictures of some images are kept.
    pub pictures: bool,
}

/// A method on a number of threads.
#[derive(Clone)]
pub struct Entrant<'a> {
    /// The method; its name tells it from the others on the same number of threads.
    pub method: &'a dyn Method,
    /// Threads that it uses.
    pub threads: usize,
    /// Budgets to measure, ascending.
    pub ladder: Vec<u64>,
    /// How often [`PhaseSeconds::distribution`](crate::PhaseSeconds) is paid at most for many views of one volume: once,
    /// or once for each direction of view that needs its own.
    pub preparations: u64,
    /// Whether its error curve is drawn for single images.
    pub plotted: bool,
}
