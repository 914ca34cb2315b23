//! Regression benchmarks: named [`Stage`]s of the program and [`accuracy`] cases, measured and held to a committed
//! [`Baseline`].
//!
//! Four checks, from the strictest to the loosest:
//!
//! | check | what is compared | tolerance |
//! |---|---|---|
//! | accuracy | SHA-256 of every image, and its RMSE against the ray-cast truth | none: bit for bit |
//! | work | every work counter of every image | none |
//! | instructions | instructions of each stage, counted by callgrind | 2 % |
//! | time | ratios of the stages' times to each other, within one run | 25 %, all pairs agreeing |
//!
//! Absolute seconds are recorded and never judged: they say more about the machine than about the program.

pub mod accuracy;
mod anchors;
mod baseline;
mod callgrind;
mod diagnosis;
mod error;
mod judge;
mod ratios;
mod record;
mod report;
mod scenes;
mod stage;
mod stages;
mod timing;

pub use baseline::{AccuracyBaseline, Baseline, InstructionBaseline, StageInstructions, TimeBaseline};
pub use callgrind::{Counted, count, valgrind_version};
pub use error::BenchError;
pub use judge::{AccuracyRun, judge_accuracy, judge_instructions, judge_work};
pub use ratios::{ANCHORS_AGREE, Pass, TIME_TOLERANCE, judge_times};
pub use record::{HistoryRecord, Provenance};
pub use report::{Check, Line, Report, Section, Verdict};
pub use stage::{Prepared, Stage};
pub use stages::{ANCHOR, stages};
pub use timing::{PASSES, ROUNDS, measure, middle, on_one_thread};

/// What compiled this program: compiler, profile, target and flags.
pub const COMPILER: &str = env!("MCVR_COMPILER");

/// Largest share by which a stage's instructions may move. Counts repeat to some parts in 10^5.
pub const INSTRUCTION_TOLERANCE: f64 = 0.02;

/// True for a build whose speed means something.
pub fn is_optimised() -> bool {
    !cfg!(debug_assertions)
}
