//! Time of an image with each effect, relative to the plain image by the same method and kernel.

use std::time::Instant;

use mcvr::scene::Watch;
use mcvr::{Request, make};
use serde_json::{Value, json};

use crate::scenes::{self, KERNELS, LOBSTER, METHODS};
use crate::{Options, Outcome};

/// Pixels of a side.
const SIDE: usize = 128;
/// Timed rounds, after one that is not.
const ROUNDS: usize = 5;

pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    match n {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

/// Runs on a pool of its own.
pub fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Outcome<T> {
    Ok(rayon::ThreadPoolBuilder::new().num_threads(threads).build()?.install(work))
}

/// One thread, and all if there are more.
pub fn thread_counts() -> Vec<usize> {
    let mut counts = vec![1, rayon::current_num_threads()];
    counts.dedup();
    counts
}

pub fn effects(options: &Options) -> Outcome<Value> {
    let volume = LOBSTER.load(&options.data)?;
    let level = if options.quick { 18 } else { 22 };
    let effects = scenes::effects()?;
    let sceneries: Vec<_> = effects.iter().map(|e| scenes::scenery(&volume, e, SIDE)).collect::<Outcome<_>>()?;
    let mut rows = vec![];
    for threads in thread_counts() {
        for kernel in KERNELS {
            for method in METHODS {
                let times = on_threads(threads, || -> Outcome<Vec<Vec<f64>>> {
                    let mut times = vec![vec![]; sceneries.len()];
                    for round in 0..=ROUNDS {
                        for (scenery, times) in sceneries.iter().zip(&mut times) {
                            let request = Request { method, kernel, samples: 1 << level, ..Request::default() };
                            let start = Instant::now();
                            make(scenery, &request, &Watch::default())?;
                            if round > 0 {
                                times.push(start.elapsed().as_secs_f64());
                            }
                        }
                    }
                    Ok(times)
                })??;
                let medians: Vec<f64> = times.into_iter().map(median).collect();
                for (effect, seconds) in effects.iter().zip(&medians) {
                    rows.push(json!({
                        "threads": threads, "kernel": kernel, "method": method, "effect": effect.name, "seconds": seconds,
                        "ratio": seconds / medians[0],
                    }));
                }
                println!("{threads} threads, {kernel}, {method}: {medians:.3?} s");
            }
        }
    }
    Ok(json!({ "rows": rows, "side": SIDE, "level": level, "rounds": ROUNDS }))
}
