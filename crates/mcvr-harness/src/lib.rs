//! What accuracy costs in time: runs image-making [`Method`]s against a ray-cast [`Truth`] over a range of sample
//! counts and replicates, and turns the measurements into records, fits, plots and a report.
//!
//! The harness knows nothing about how images are made. [`converge()`] is the entry point; everything it writes goes
//! into one folder, from which an interrupted run resumes. Terms follow METHOD sections 4, 6 and 7.

mod chart;
mod claim;
pub mod compare;
pub mod converge;
pub mod cost;
mod error;
pub mod fit;
mod folder;
pub mod format;
pub mod history;
pub mod history_plot;
mod html;
mod images;
mod machine;
mod markdown;
mod method;
pub mod metrics;
mod output;
pub mod panels;
pub mod plot;
pub mod record;
mod report;
pub mod summary;

pub use claim::Claim;
pub use compare::{FileComparison, compare_files};
pub use converge::{ConvergeOptions, RunMeta, RunWatch, Truth, converge};
pub use error::HarnessError;
pub use fit::SlopeFit;
pub use folder::sha256;
pub use images::{SeriesImage, difference_scale, write_difference};
pub use machine::{git_commit, machine};
pub use method::{Method, MethodError, PhaseSeconds, Rendered};
pub use metrics::Comparison;
pub use record::{Record, RecordKey};
pub use report::key_lines;
pub use summary::{MethodSummary, Ratio, Row, RunSummary, Spread, TruthSummary};
