//! The one interface between the harness and whatever makes images.
//!
//! It is narrow on purpose: a name, a budget and a seed go in; an image, its times and free-form counters
//! come out. The harness therefore treats every method alike and cannot favour one, and a method knows
//! nothing about replicates, truths or files.

use mcvr_scene::Image;
use serde::{Deserialize, Serialize};

/// Why a method could not make an image.
pub type MethodError = Box<dyn std::error::Error + Send + Sync>;

/// One way to make an image at a budget.
pub trait Method: Sync {
    /// Stable identifier such as `mc`, `stratified`, `qmc` or `march`: used in records, in file names and to
    /// resume, so it holds only ASCII letters, digits, `-` and `_`.
    fn name(&self) -> &str;

    /// Name for people, used in plots and tables.
    fn label(&self) -> &str;

    /// Exponent that theory predicts for the RMSE against the budget (METHOD section 4); `None` without one.
    fn expected_slope(&self) -> Option<f64>;

    /// One image from `samples` samples; for ray methods whatever [`Method::budget_unit`] says. The same seed
    /// must give the same image, and different seeds independent errors.
    ///
    /// # Errors
    /// Whatever kept the image from being made; the harness stops and keeps what was finished before.
    fn render(&self, samples: u64, seed: u64) -> Result<Rendered, MethodError>;

    /// What one unit of the budget is.
    fn budget_unit(&self) -> &'static str {
        "samples"
    }

    /// False for budgets that make no sense for this method, for example a linear search at large M.
    fn accepts(&self, samples: u64) -> bool {
        let _ = samples;
        true
    }
}

/// What a method hands back.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// The image, in the unit of the truth.
    pub image: Image,
    /// Wall-clock time of this one image.
    pub seconds: PhaseSeconds,
    /// Anything worth keeping beside the times, such as samples outside the image or threads used; a JSON
    /// object, or `null`.
    pub counters: serde_json::Value,
}

/// Wall-clock seconds of one image by phase. Phases that a method does not have are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhaseSeconds {
    /// Building the distribution (sums over voxels) or an equivalent structure, s.
    pub distribution: f64,
    /// Choosing voxels and offsets, s.
    pub sampling: f64,
    /// Projecting points and adding them to the film, s; the report's "rendering".
    pub projection: f64,
    /// The whole image from the volume in memory to linear pixel values, s: at least the sum of the others.
    pub complete: f64,
}
