//! The check against the truth, so that no method wins by being wrong.

use mcvr::raycast::{ReferenceOptions, reference};
use mcvr::scene::{Image, Watch};

use crate::entrants::OPTIONS;
use crate::errors::{Spread, jackknife};
use crate::records::{Key, Record};
use crate::scans::{Scene, VIEWS};
use crate::{Options, Outcome};

/// Where it is made: one view of one scan, at one number of samples.
const SCAN: &str = "lobster";
const LEVEL: u32 = 22;
const QUICK_LEVEL: u32 = 12;
/// Error that is asked of the truth, over its mean pixel: a tenth of the least error there is to check.
const TOLERANCE: f64 = 1e-2;
/// A squared bias so many standard errors above the truth's own squared error is one: with 16 replicates a false alarm has
/// probability 1e-5 by Student's t.
pub const LIMIT: f64 = 6.0;

pub struct Check {
    pub level: u32,
    truth: Image,
    /// RMSE of the truth over its mean, by its own estimate.
    error: f64,
}

impl Check {
    /// The truth, if this is the scene and not all has been checked.
    pub fn due(options: &Options, scene: &Scene<'_>, records: &[Record]) -> Outcome<Option<Self>> {
        let here = (scene.scan.name == SCAN || options.quick) && scene.view.0 == VIEWS[1];
        let level = if options.quick { QUICK_LEVEL } else { LEVEL };
        let measured = |r: &Record| matches!(r, Record::Error { key, .. } if key.scan == scene.scan.name && key.view == scene.view.0 && key.level == level);
        // Each method is checked when its error is measured.
        let methods = crate::entrants::entrants();
        let open =
            methods.iter().filter(|e| e.levels(options.quick).contains(&level) && !e.is_default(scene.depth)).count();
        let asked = options.levels.as_ref().is_none_or(|levels| levels.contains(&level));
        if !here || !asked || records.iter().filter(|r| measured(r)).count() >= open {
            return Ok(None);
        }
        let start = std::time::Instant::now();
        let cast = ReferenceOptions {
            estimand: OPTIONS.estimand,
            kernel: OPTIONS.kernel,
            tolerance: TOLERANCE,
            ..ReferenceOptions::default()
        };
        let made = reference(scene.density, &scene.camera, &cast, &Watch::default())?;
        let error = made.error.rel_rmse_estimate;
        println!("{}: truth good to {:.2} %, {:.1} s", scene.label(), 100.0 * error, start.elapsed().as_secs_f64());
        Ok(Some(Self { level, truth: made.image, error }))
    }

    /// The mean image of R replicates differs from the truth by the bias and by an error of variance V/R: the mean square of
    /// the difference less V/R is an unbiased estimate of the squared bias.
    pub fn bias(&self, key: Key, images: &[Image]) -> Record {
        let squared = |without: Option<usize>| {
            let used: Vec<&Image> =
                images.iter().enumerate().filter(|(i, _)| Some(*i) != without).map(|(_, image)| image).collect();
            let n = used.len() as f64;
            let of = |p: usize| used.iter().map(|i| i.values()[p]).sum::<f64>() / n;
            let truth = self.truth.values();
            let square = truth.iter().enumerate().map(|(p, t)| (of(p) - t).powi(2)).sum::<f64>() / truth.len() as f64;
            square - Spread::of(images, without).variance / n
        };
        let variance = Spread::of(images, None).variance;
        Record::Bias {
            key,
            ratio: squared(None) / variance,
            standard_error: jackknife(images.len(), |r| squared(Some(r))) / variance,
            truth_ratio: (self.error * self.truth.mean()).powi(2) / variance,
            truth_error: self.error,
        }
    }
}
