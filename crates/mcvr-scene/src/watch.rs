//! How long work is watched and stopped from outside.

use std::sync::atomic::{AtomicBool, Ordering};

/// Progress and cancellation of one piece of work; the default watches nothing.
#[derive(Clone, Copy, Default)]
pub struct Watch<'a> {
    /// Called now and then, from any thread, with the units finished since the last call.
    pub progress: Option<&'a (dyn Fn(u64) + Sync)>,
    /// Work stops soon after this turns true.
    pub cancel: Option<&'a AtomicBool>,
}

impl Watch<'_> {
    /// Reports `units` more finished.
    pub fn advance(&self, units: u64) {
        if let Some(f) = self.progress {
            f(units);
        }
    }

    /// True once the work should stop.
    pub fn cancelled(&self) -> bool {
        self.cancel.is_some_and(|c| c.load(Ordering::Relaxed))
    }
}
