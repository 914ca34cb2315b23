//! Methods in the form in which the harness measures them.

use std::sync::atomic::AtomicBool;

use mcvr_harness::{MethodError, Rendered};
use mcvr_scene::Watch;

use crate::{Method, Request, Scenery, make};

/// A method applied to a scenery, for [`mcvr_harness::converge()`].
#[derive(Clone, Copy, Debug)]
pub struct Measured<'a> {
    scenery: &'a Scenery,
    request: Request,
    cancel: Option<&'a AtomicBool>,
}

impl<'a> Measured<'a> {
    /// The request's budget and seed are replaced by those of each measurement.
    pub fn new(scenery: &'a Scenery, request: Request, cancel: Option<&'a AtomicBool>) -> Self {
        Self { scenery, request, cancel }
    }
}

impl mcvr_harness::Method for Measured<'_> {
    fn name(&self) -> &str {
        self.request.method.name()
    }

    fn label(&self) -> &str {
        self.request.method.label()
    }

    fn expected_slope(&self) -> Option<f64> {
        self.request.method.expected_slope()
    }

    fn render(&self, samples: u64, seed: u64) -> Result<Rendered, MethodError> {
        let request = Request { samples, seed, ..self.request };
        let made = make(self.scenery, &request, &Watch { progress: None, cancel: self.cancel })?;
        let image = made.measurable()?.into_owned();
        Ok(Rendered { image, seconds: made.seconds, counters: made.counters })
    }

    fn budget_unit(&self) -> &'static str {
        self.request.method.unit()
    }

    /// What casts rays takes a square number of rays a pixel and takes part only where doubling the budget has bought
    /// more of them, up to 25: there its step's bias has long been reached. The linear search stops where it
    /// takes minutes.
    fn accepts(&self, samples: u64) -> bool {
        let pixels = self.scenery.camera.extent().pixels() as u64;
        let side = |rays: u64| (rays / pixels).isqrt();
        match self.request.method {
            Method::March | Method::Rays | Method::Comb => {
                (1..=5).contains(&side(samples)) && side(samples) > side(samples / 2)
            }
            Method::McLinear => samples <= 1 << 10,
            _ => true,
        }
    }
}
