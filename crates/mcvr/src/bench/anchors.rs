//! Anchors: loads that no change of the program can touch, one for each thing that a neighbour on the machine can take
//! away. They move with the machine and never with the program, so they say which of two stages that moved apart did it.

use super::stage::{Prepared, Stage};
use super::stages::ANCHOR;

/// Words of the vector anchor: in the first cache.
const VECTOR: usize = 4096;
/// Words of the streaming anchor: 32 MiB, beyond the caches of most.
const STREAM: usize = 1 << 22;
/// Counters of the scattering anchor: 1 MiB, an image.
const SCATTER: usize = 1 << 17;

pub(super) fn stages() -> Vec<Stage> {
    let stage =
        |name: &str, prepare: fn() -> Prepared| Stage::new(format!("{ANCHOR}{name}"), "step", move || Ok(prepare()));
    vec![stage("integer", integer), stage("vector", vector), stage("stream", stream), stage("scatter", scatter)]
}

/// SplitMix64 (Steele, Lea and Flood 2014).
fn mix(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A chain of multiplications, each of which waits for the last.
fn integer() -> Prepared {
    const STEPS: u64 = 600_000;
    Prepared::new(STEPS, 1, || {
        let mut state = 1;
        Ok((0..STEPS).fold(1u64, |sum, _| {
            state ^= sum;
            mix(&mut state)
        }))
    })
}

/// Independent `f32` operations that keep the vector units busy.
fn vector() -> Prepared {
    let mut values: Vec<f32> = (0..VECTOR).map(|i| i as f32 / VECTOR as f32).collect();
    Prepared::new(VECTOR as u64, 2400, move || {
        for v in &mut values {
            *v = (*v * 0.998 + 0.25).sqrt() * 0.75;
        }
        Ok(u64::from(values[VECTOR / 2].to_bits()))
    })
}

/// A sum over more memory than the caches hold.
fn stream() -> Prepared {
    let words: Vec<u64> = (0..STREAM as u64).collect();
    Prepared::new(STREAM as u64, 1, move || Ok(words.iter().fold(0u64, |sum, w| sum.wrapping_add(*w))))
}

/// Counting at random places, as samples are added to an image.
fn scatter() -> Prepared {
    const STEPS: u64 = 1_200_000;
    let mut counters = vec![0u64; SCATTER];
    Prepared::new(STEPS, 1, move || {
        let mut state = 7;
        for _ in 0..STEPS {
            counters[mix(&mut state) as usize % SCATTER] += 1;
        }
        Ok(counters[1])
    })
}
