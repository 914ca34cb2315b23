//! Images that know their error: replicates, error bars, a stopping rule, progressive refinement.
//!
//! [`refine`] draws R independent replicates of an image (scrambles of a sequence, or streams of random numbers) in passes that
//! each refine the last, looks at their spread, and stops when the error that was asked for is reached with the confidence
//! that was asked for. The picture so far, its error and its time can be had after every pass, and stopping there leaves
//! exactly the image that a direct run of so many samples makes.
//!
//! What is known without a ground truth, and how:
//!
//! | figure | from | source |
//! |---|---|---|
//! | a pixel's standard error and confidence interval ([`Bars`]) | the replicates' spread, Student's t with R - 1 degrees of freedom | METHOD section 6; L'Ecuyer, Nakayama, Owen, Tuffin 2023 |
//! | the image's relative RMSE and an upper bound ([`Estimate`]) | the replicates' R - 1 orthogonal contrasts | balanced half-samples, McCarthy 1969 |
//! | that looking often does not spoil the confidence | a preset [`Schedule`] of looks that share the risk equally | Bonferroni's inequality |

mod bars;
mod contrasts;
mod error;
mod goal;
mod picture;
mod refine;
mod schedule;

pub use bars::{Bars, PixelInterval, interval};
pub use contrasts::{Contrasts, MOST, bound};
pub use error::RefineError;
pub use goal::{Estimate, Goal, Limits, PixelGoal, Stop};
pub use picture::Picture;
pub use refine::{Look, Plan, Refined, Snapshot, Source, refine};
pub use schedule::{FIRST, Schedule, dyadic_runs, steps};
