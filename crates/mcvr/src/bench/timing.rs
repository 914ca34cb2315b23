//! Seconds of stages, measured so that their ratios mean something: one thread, one run of each stage in turn, round after
//! round, so that whatever else the machine does falls on all of them alike; and by the time that the thread was on a processor,
//! for on a busy machine a stage longer than a time slice always waits and a shorter one need not (measured: ratios off by 4).

use std::collections::BTreeMap;

use mcvr_scene::Watch;

use super::{BenchError, Prepared};

/// Rounds of a pass.
pub const ROUNDS: usize = 9;
/// Most passes before a stage is called slower; a new baseline takes as many.
pub const PASSES: usize = 3;

/// Runs work on one thread, parallel loops included.
///
/// # Errors
/// [`BenchError::Setup`] when the thread cannot be started.
pub fn on_one_thread<R: Send>(work: impl FnOnce() -> R + Send) -> Result<R, BenchError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    Ok(pool.map_err(|e| BenchError::Setup(format!("a thread: {e}")))?.install(work))
}

/// One pass: seconds of a run of each stage, the least of all rounds. What else runs on a machine only ever adds time.
/// `watch` hears of every run.
///
/// # Errors
/// What a stage said, or [`BenchError::Cancelled`].
pub fn measure(
    stages: &mut [(String, Prepared)],
    rounds: usize,
    watch: &Watch<'_>,
) -> Result<BTreeMap<String, f64>, BenchError> {
    on_one_thread(|| {
        let mut least = vec![f64::INFINITY; stages.len()];
        for round in 0..rounds {
            let forward = 0..stages.len();
            // Every other round backwards: no stage always follows the same one.
            let order: Vec<usize> = if round % 2 == 0 { forward.collect() } else { forward.rev().collect() };
            for i in order {
                if watch.cancelled() {
                    return Err(BenchError::Cancelled);
                }
                let start = clock();
                stages[i].1.run()?;
                least[i] = least[i].min(clock() - start);
                watch.advance(1);
            }
        }
        Ok(stages.iter().map(|(name, _)| name.clone()).zip(least).collect())
    })?
}

/// Seconds that this thread has been on a processor.
#[cfg(unix)]
fn clock() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Wall time, where the system has no such clock.
#[cfg(not(unix))]
fn clock() -> f64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START.get_or_init(std::time::Instant::now).elapsed().as_secs_f64()
}

/// The middle of several passes, stage by stage: the seconds of a new baseline.
pub fn middle(passes: &[BTreeMap<String, f64>]) -> BTreeMap<String, f64> {
    let of = |name: &String| {
        let mut values: Vec<f64> = passes.iter().filter_map(|p| p.get(name).copied()).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).map(|v| (name.clone(), *v))
    };
    passes.first().map(|p| p.keys().filter_map(of).collect()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_of_the_rounds_is_kept_and_every_round_is_run() {
        let runs = std::sync::Arc::new(std::sync::atomic::AtomicU64::new(0));
        let counted = runs.clone();
        let slow = Prepared::new(1, 1, move || {
            // The first run takes longest, as cold caches make it.
            let first = counted.fetch_add(1, std::sync::atomic::Ordering::Relaxed) == 0;
            let steps = if first { 20_000_000u64 } else { 1 };
            Ok((0..steps).fold(1, |sum, i| std::hint::black_box(sum ^ i)))
        });
        let seconds = measure(&mut [("slow".into(), slow)], 3, &Watch::default()).unwrap();
        assert_eq!(runs.load(std::sync::atomic::Ordering::Relaxed), 3);
        assert!(seconds["slow"] < 1e-3, "{seconds:?}");
    }

    #[test]
    fn a_baseline_takes_the_middle_of_its_passes() {
        let pass = |v: f64| BTreeMap::from([("a".to_owned(), v)]);
        assert_eq!(middle(&[pass(3.0), pass(1.0), pass(2.0)])["a"], 2.0);
        assert!(middle(&[]).is_empty());
    }

    #[test]
    fn a_stop_is_heeded() {
        let cancel = std::sync::atomic::AtomicBool::new(true);
        let watch = Watch { progress: None, cancel: Some(&cancel) };
        let stage = ("a".to_owned(), Prepared::new(1, 1, || Ok(1)));
        assert!(measure(&mut [stage], 3, &watch).unwrap_err().is_cancelled());
    }
}
