//! Processor time of estimators that take turns, and their errors.

use std::collections::BTreeMap;

use mcvr::scene::Image;
use serde::Serialize;

use crate::{Entry, Outcome, Preparation};

/// Seconds that this process has been on a processor.
#[cfg(unix)]
pub fn processor() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Wall time, where the system has no such clock.
#[cfg(not(unix))]
pub fn processor() -> f64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START.get_or_init(std::time::Instant::now).elapsed().as_secs_f64()
}

/// Runs on a pool of one thread.
pub fn one_thread<T: Send>(work: impl FnOnce() -> T + Send) -> Outcome<T> {
    Ok(rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(work))
}

/// One setting of an estimator, measured.
#[derive(Serialize)]
pub struct Row {
    pub family: &'static str,
    pub setting: String,
    /// Least processor time of an image.
    pub seconds: f64,
    /// Processor time of what it needs to have before.
    pub prepared: f64,
    /// RMSE over the mean pixel, over all rounds.
    pub error: f64,
    pub work: u64,
}

/// What was measured on one scene.
#[derive(Serialize)]
pub struct Times {
    pub preparations: BTreeMap<&'static str, f64>,
    pub rows: Vec<Row>,
}

/// Runs everything in rounds, every other round backwards, after one that only warms up. Preparations are run twice.
pub fn measure(
    preparations: &mut [Preparation<'_>],
    entries: &mut [Entry<'_>],
    rounds: usize,
    truth: &Image,
) -> Outcome<Times> {
    let mut prepared = BTreeMap::new();
    for _ in 0..2 {
        for p in preparations.iter_mut() {
            let start = processor();
            (p.work)()?;
            let seconds = processor() - start;
            prepared.entry(p.name).and_modify(|s: &mut f64| *s = s.min(seconds)).or_insert(seconds);
        }
    }
    let mut least = vec![f64::INFINITY; entries.len()];
    let mut squares = vec![0.0; entries.len()];
    let mut work = vec![0; entries.len()];
    for round in 0..=rounds {
        let forward = 0..entries.len();
        let order: Vec<usize> = if round % 2 == 0 { forward.collect() } else { forward.rev().collect() };
        for i in order {
            let start = processor();
            let made = (entries[i].work)(round as u64 + 1)?;
            let seconds = processor() - start;
            if round > 0 {
                least[i] = least[i].min(seconds);
                squares[i] += error(&made.image, truth).powi(2) / rounds as f64;
                work[i] = made.work;
            }
        }
    }
    let rows = entries.iter().enumerate().map(|(i, e)| Row {
        family: e.family,
        setting: e.setting.clone(),
        seconds: least[i],
        prepared: e.needs.iter().filter_map(|n| prepared.get(n)).sum(),
        error: squares[i].sqrt(),
        work: work[i],
    });
    Ok(Times { rows: rows.collect(), preparations: prepared })
}

/// RMSE over the mean pixel of the truth.
pub fn error(image: &Image, truth: &Image) -> f64 {
    let n = truth.values().len() as f64;
    let sum: f64 = image.values().iter().zip(truth.values()).map(|(a, b)| (a - b) * (a - b)).sum();
    (sum / n).sqrt() / truth.mean()
}
