//! Images that must not change: every method by kernel and estimand, every effect, and the truths themselves.
//!
//! Small images of a small phantom: what is held here is that the program's arithmetic is what it was, bit for bit. That it is
//! *right* is for the tests of unbiasedness and convergence.

use std::collections::BTreeMap;

use mcvr_harness::{Comparison, sha256};
use mcvr_qmc::Scramble;
use mcvr_sampling::VoxelOrder;
use mcvr_scene::{Camera, DensityMap, Effects, Emphasis, Estimand, Extent, Image, Kernel, View, Watch};
use mcvr_volume::Volume;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::BenchError;
use super::scenes::effects;
use crate::{Method, Request, Scenery, make};

/// Samples of an image: some blocks and a short one.
const SAMPLES: u64 = 20_000;
/// Samples of a linear search, half a volume each.
const LINEAR_SAMPLES: u64 = 2_500;
/// Tolerance of the truths.
const TOLERANCE: f64 = 5e-3;
/// Pixels of an image.
const SIZE: [usize; 2] = [32, 24];
const SEPARABLE: [Kernel; 3] = [Kernel::Box, Kernel::Tent, Kernel::Bspline3];

/// One image by name: `method/kernel/estimand/effect`.
#[derive(Clone, Debug)]
pub struct Case {
    /// Name of the case.
    pub name: String,
    /// How the image is made.
    pub request: Request,
    pub(super) effect: String,
}

/// What is kept of an image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// SHA-256 of its size and values.
    pub sha256: String,
    /// Its mean pixel.
    pub mean: f64,
    /// RMSE against the truth over the truth's mean; of a truth its own estimate. `None` for a kernel that no ray caster knows.
    pub error: Option<f64>,
    /// Mean signed difference from the truth over the truth's mean.
    pub bias: Option<f64>,
    /// Work counters, nested names joined by points.
    pub counters: BTreeMap<String, Value>,
}

/// Every case. Truths come first.
///
/// # Errors
/// [`BenchError::Setup`] when an effect cannot be made.
pub fn cases() -> Result<Vec<Case>, BenchError> {
    let mut all = vec![];
    let effects: Vec<String> = effects()?.into_iter().map(|e| e.0.to_owned()).chain(["emphasis".to_owned()]).collect();
    let mut add = |label: &str, request: Request, effect: &str| {
        let Request { kernel, estimand, .. } = request;
        all.push(Case { name: format!("{label}/{kernel}/{estimand}/{effect}"), request, effect: effect.to_owned() });
    };
    let with = |method: Method, kernel: Kernel, estimand: Estimand| {
        let samples = match method {
            Method::McLinear => LINEAR_SAMPLES,
            Method::March => 4 * (SIZE[0] * SIZE[1]) as u64,
            _ => SAMPLES,
        };
        Request { method, kernel, estimand, samples, seed: 2026, tolerance: TOLERANCE, ..Request::default() }
    };
    let combinations = || Kernel::ALL.into_iter().flat_map(|k| Estimand::ALL.map(move |e| (k, e)));
    let sampled = [Method::Mc, Method::Stratified, Method::Qmc, Method::March];
    for method in [Method::Exact].into_iter().chain(Method::ALL.into_iter().filter(|m| *m != Method::Exact)) {
        for (kernel, estimand) in combinations().filter(|c| method.knows(c.0)) {
            add(method.name(), with(method, kernel, estimand), "plain");
        }
        for effect in effects.iter().filter(|_| method == Method::Exact || sampled.contains(&method)) {
            add(method.name(), with(method, Kernel::Tent, Estimand::Line), effect);
        }
    }
    for (kernel, estimand) in [(Kernel::Bspline3, Estimand::Line), (Kernel::Tent, Estimand::Count)] {
        for method in [Method::Exact, Method::Qmc] {
            add(method.name(), with(method, kernel, estimand), "materials");
        }
    }
    let net = with(Method::Qmc, Kernel::Tent, Estimand::Line);
    for scramble in [Scramble::Owen, Scramble::Shift] {
        add(&format!("qmc-{}", scramble.name()), Request { scramble, ..net }, "plain");
    }
    for order in [VoxelOrder::Raster, VoxelOrder::Hilbert, VoxelOrder::YInnermost, VoxelOrder::ZInnermost] {
        add(&format!("qmc-{}", order.name()), Request { order, ..net }, "plain");
    }
    Ok(all)
}

/// Makes the cases' images; keeps the truths that several share.
pub struct Studio {
    volume: Volume,
    camera: Camera,
    effects: BTreeMap<String, Effects>,
    truths: BTreeMap<String, Truth>,
}

/// A reference image, its own relative error and its work.
#[derive(Clone, Debug)]
pub(super) struct Truth {
    pub image: Image,
    pub error: f64,
    counters: Value,
}

impl Studio {
    /// A lobster of 32³ voxels, seen by a pinhole close by: `count` and `line` differ, borders cut.
    ///
    /// # Errors
    /// When the scene cannot be made.
    pub fn new() -> Result<Self, BenchError> {
        let volume = mcvr_volume::load("phantom:lobster@32", None)?.volume;
        let distance = Some(1.2 * volume.grid().diameter());
        let view = View { azimuth: 31.0, elevation: 47.0, distance, ..View::default() };
        let camera = Camera::look(&view, volume.grid(), Extent::new(SIZE[0], SIZE[1])?)?;
        let effects = effects()?.into_iter().map(|(name, e)| (name.to_owned(), e)).collect();
        Ok(Self { volume, camera, effects, truths: BTreeMap::new() })
    }

    /// The scene of a case.
    pub(super) fn scenery(&self, case: &Case) -> Scenery {
        let emphasis = (case.effect == "emphasis").then_some(Emphasis { threshold: 110.0, gain: 4.0 });
        let map = DensityMap { emphasis, ..DensityMap::default() };
        let effects = self.effects.get(&case.effect).cloned().unwrap_or_default();
        Scenery::new(self.volume.clone(), map, self.camera.clone()).with_effects(effects)
    }

    /// The truth of a case; `None` for a kernel that no ray caster knows.
    pub(super) fn truth(&mut self, case: &Case, watch: &Watch<'_>) -> Result<Option<&Truth>, BenchError> {
        let Request { kernel, estimand, .. } = case.request;
        if !SEPARABLE.contains(&kernel) {
            return Ok(None);
        }
        let key = format!("{kernel}/{estimand}/{}", case.effect);
        if !self.truths.contains_key(&key) {
            let request = Request { method: Method::Exact, ..case.request };
            let made = make(&self.scenery(case), &request, watch)?;
            let image = made.measurable()?.into_owned();
            self.truths.insert(key.clone(), Truth { image, error: made.error.unwrap_or(0.0), counters: made.counters });
        }
        Ok(self.truths.get(&key))
    }

    /// Makes the image of a case and takes its figures.
    ///
    /// # Errors
    /// What [`make`] says, and [`BenchError::Cancelled`].
    pub fn figure(&mut self, case: &Case, watch: &Watch<'_>) -> Result<Figure, BenchError> {
        let truth = self.truth(case, watch)?.cloned();
        if let Some(truth) = truth.as_ref().filter(|_| case.request.method == Method::Exact) {
            return Ok(Figure::of(&truth.image, Some(truth.error), None, &truth.counters));
        }
        let made = make(&self.scenery(case), &case.request, watch)?;
        let image = made.measurable()?.into_owned();
        let compared = truth.map(|t| compare(&image, &t.image)).transpose()?;
        let (error, bias) = compared.map_or((None, None), |c| (c.rel_rmse, c.bias));
        Ok(Figure::of(&image, error, bias, &made.counters))
    }
}

impl Figure {
    fn of(image: &Image, error: Option<f64>, bias: Option<f64>, work: &Value) -> Self {
        let mut counters = BTreeMap::new();
        flatten("", work, &mut counters);
        Self { sha256: sha256(image), mean: image.mean(), error, bias, counters }
    }
}

impl std::fmt::Debug for Studio {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Studio").field("truths", &self.truths.len()).finish_non_exhaustive()
    }
}

pub(super) fn compare(image: &Image, truth: &Image) -> Result<Comparison, BenchError> {
    Comparison::of(image, truth).map_err(|e| BenchError::Setup(e.to_string()))
}

/// `{"a": {"b": 1}}` as `a.b = 1`.
fn flatten(prefix: &str, value: &Value, into: &mut BTreeMap<String, Value>) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
                flatten(&name, value, into);
            }
        }
        leaf => {
            into.insert(prefix.to_owned(), leaf.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_are_flattened_by_name() {
        let mut flat = BTreeMap::new();
        flatten("", &serde_json::json!({"a": {"b": 1, "c": {"d": "x"}}, "e": 2}), &mut flat);
        assert_eq!(flat.keys().collect::<Vec<_>>(), ["a.b", "a.c.d", "e"]);
    }

    #[test]
    fn every_method_meets_every_kernel_and_estimand_it_knows() {
        let cases = cases().unwrap();
        let names: std::collections::HashSet<&str> = cases.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names.len(), cases.len());
        for method in Method::ALL {
            for kernel in Kernel::ALL.into_iter().filter(|k| method.knows(*k)) {
                for estimand in Estimand::ALL {
                    assert!(names.contains(format!("{method}/{kernel}/{estimand}/plain").as_str()));
                }
            }
        }
        assert!(names.contains("qmc/tent/line/shading") && names.contains("exact/tent/line/all"));
    }
}
