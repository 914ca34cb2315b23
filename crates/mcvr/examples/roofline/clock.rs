//! Interleaved runs and their clocks.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry::Vacant;
use std::time::Instant;

use serde::Serialize;

use crate::{Entry, Outcome};

/// What was measured of one entry, nanoseconds per unit of work: least, median, most of the rounds.
#[derive(Serialize)]
pub struct Row {
    pub name: String,
    pub unit: &'static str,
    pub threads: usize,
    /// Processor time of all threads together.
    pub cpu_ns: [f64; 3],
    pub wall_ns: [f64; 3],
    /// The row that bounds this one, and how many of its units a unit of this one takes.
    pub limit: Option<&'static str>,
    pub limit_units: f64,
}

/// Seconds that all threads of this process have been on a processor.
#[cfg(unix)]
fn processor() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Wall time, where the system has no such clock.
#[cfg(not(unix))]
fn processor() -> f64 {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_secs_f64()
}

fn middle(values: &mut [f64]) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [values[0], values[values.len() / 2], values[values.len() - 1]]
}

/// Runs each entry once unmeasured, then in rounds.
pub fn measure(mut entries: Vec<Entry<'_>>, rounds: usize) -> Outcome<Vec<Row>> {
    let mut pools = BTreeMap::new();
    for e in &entries {
        if let Vacant(room) = pools.entry(e.threads) {
            room.insert(rayon::ThreadPoolBuilder::new().num_threads(e.threads).build()?);
        }
    }
    let mut times = vec![(vec![], vec![]); entries.len()];
    for round in 0..=rounds {
        let forward = 0..entries.len();
        let order: Vec<usize> = if round % 2 == 0 { forward.collect() } else { forward.rev().collect() };
        for i in order {
            let entry = &mut entries[i];
            let (wall, cpu) = (Instant::now(), processor());
            let units = pools[&entry.threads].install(|| (entry.work)())?.max(1) as f64;
            let (cpu, wall) = (processor() - cpu, wall.elapsed().as_secs_f64());
            if round > 0 {
                times[i].0.push(cpu * 1e9 / units);
                times[i].1.push(wall * 1e9 / units);
            }
        }
    }
    let rows = entries.into_iter().zip(times).map(|(e, (mut cpu, mut wall))| Row {
        name: e.name,
        unit: e.unit,
        threads: e.threads,
        cpu_ns: middle(&mut cpu),
        wall_ns: middle(&mut wall),
        limit: e.limit.map(|l| l.0),
        limit_units: e.limit.map_or(0.0, |l| l.1),
    });
    Ok(rows.collect())
}
