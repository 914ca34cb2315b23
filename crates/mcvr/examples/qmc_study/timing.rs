//! Seconds of an image: the points, whatever a method makes for them, and the render call. The distribution apart.

use std::time::Instant;

use crate::entrants::entrants;
use crate::records::{Circumstances, Key, Log, Record};
use crate::scans::Scene;
use crate::{Options, Outcome};

/// Rounds in which all methods take turns, by the power of two.
fn rounds(level: u32) -> usize {
    match level {
        0..=18 => 9,
        19..=22 => 5,
        _ => 3,
    }
}

/// Measures what the log does not hold yet, few samples first.
pub fn measure(options: &Options, scene: &Scene<'_>, log: &mut Log) -> Outcome<()> {
    let entrants = entrants();
    let own = |e: &crate::entrants::Entrant| match &options.levels {
        Some(levels) if !e.timed(options.quick).is_empty() => levels.clone(),
        _ => e.timed(options.quick).to_vec(),
    };
    let mut levels: Vec<u32> = entrants.iter().flat_map(own).collect();
    levels.sort_unstable();
    levels.dedup();
    let mut warm = false;
    for level in levels {
        let key = |method: &str| Key {
            scan: scene.scan.name.into(),
            view: scene.view.0.into(),
            method: method.into(),
            level,
        };
        let there =
            |method: &str| log.records().iter().any(|r| matches!(r, Record::Time { key: k, .. } if *k == key(method)));
        let due: Vec<_> = entrants
            .iter()
            .filter(|e| own(e).contains(&level) && !e.is_default(scene.depth) && !there(e.name))
            .collect();
        let mut seconds = vec![vec![]; due.len()];
        // The first round of all is not counted.
        for round in 0..rounds(level) + usize::from(!warm) {
            for (entrant, seconds) in due.iter().zip(&mut seconds) {
                let start = Instant::now();
                entrant.image(scene, level, entrant.seed(level, round))?;
                if warm || round > 0 {
                    seconds.push(start.elapsed().as_secs_f64());
                }
            }
        }
        warm |= !due.is_empty();
        for (entrant, seconds) in due.iter().zip(seconds) {
            println!("{}, 2^{level}, {}: {seconds:.4?} s", scene.label(), entrant.name);
            let (_, distribution) = scene.distribution(entrant.order)?;
            let circumstances = Circumstances::now(options.quick);
            log.append(Record::Time { key: key(entrant.name), seconds, distribution, circumstances })?;
        }
    }
    Ok(())
}
