//! Very many samples in memory that does not grow with them.

use std::time::Duration;

use mcvr_mc::OrderStatistics;
use mcvr_sampling::{BLOCK, PointBlock, PointStream};

use super::program::{Place, start};
use super::{Bound, Case, CaseError, Context, Cost, Finding, MIB, case};

pub(super) const CASES: &[Case] = &[
    case(
        "samples-in-constant-memory",
        Cost::Quick,
        "samples are gathered before they are counted: 8 bytes each are 64 MiB for 2^23",
        "2^23 samples take no more memory than 2^20 but for 8 bytes a block of 2048, and 4 MiB",
        |context| growth(context, 1 << 20, 1 << 23, Duration::from_secs(60)),
    ),
    case(
        "a-billion-samples",
        Cost::Large,
        "samples are gathered before they are counted: 8 bytes each are 8 GB",
        "10⁹ samples take no more memory than 10⁶ but for 8 bytes a block of 2048, and 4 MiB",
        |context| growth(context, 1_000_000, 1_000_000_000, Duration::from_secs(600)),
    ),
    case(
        "sorted-draws-in-constant-memory",
        Cost::Quick,
        "drawing in rising order keeps a sum for every block: gigabytes from 2^39 samples on",
        "2^33 draws keep at most 4 MiB, rise from block to block and lie where order statistics lie",
        sorted_draws,
    ),
];

/// Growth of the program's peak memory from few samples to many, the larger of `mc` and `qmc`. Only the running sums of `mc` grow: 8
/// bytes a block. The 4 MiB are for what two runs of one program differ by without any reason in the samples: each of two workers
/// faults in its stack (at most 2 MiB) as deep as its share of the work takes it.
fn growth(context: &Context, few: u64, many: u64, patience: Duration) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let peak = |method: &str, samples: u64| -> Result<u64, CaseError> {
        let samples = samples.to_string();
        let arguments = [
            "render",
            "phantom:lobster@32",
            "--method",
            method,
            "--samples",
            &samples,
            "--size",
            "64x64",
            "--quiet",
            "--threads",
            "2",
            "-o",
            "a.npy",
            "--json",
            "a.json",
        ];
        let ended = start(place.command(arguments))?.wait(patience)?;
        if !ended.status.success() {
            return Err(ended.last_words().into());
        }
        let record: serde_json::Value = serde_json::from_slice(&std::fs::read(place.path("a.json"))?)?;
        let peak = record["peak_memory_bytes"].as_u64();
        peak.ok_or_else(|| CaseError::Impossible("this system does not tell a process's peak memory".into()))
    };
    let mut worst = 0u64;
    for method in ["mc", "qmc"] {
        worst = worst.max(peak(method, many)?.saturating_sub(peak(method, few)?));
    }
    let bound = 8 * many.div_ceil(BLOCK as u64) + 4 * MIB;
    let detail = format!("M = {few} against {many}; 8 bytes a sample would be {} MiB", 8 * many / MIB);
    Ok(Finding::new(worst as f64, "bytes more", Bound::AtMost(bound as f64)).with(detail))
}

/// Exact for the order, the total and the bytes kept. The first target of block b, k = 2048 b of M = 2^33, is an order statistic: its mean is
/// k/M of the total and its deviation below √(p(1−p)/M); 6 of those, and one unit of rounding, are exceeded with a probability of
/// 2·10⁻⁹ each, 4·10⁻⁷ for 200 blocks (seed fixed).
fn sorted_draws(_: &Context) -> Result<Finding, CaseError> {
    let (samples, total) = (1u64 << 33, 1u64 << 62);
    let stream = OrderStatistics::new(samples, 20);
    let blocks = samples / BLOCK as u64;
    let draw = |block: u64| {
        let mut out = PointBlock::default();
        out.resize(BLOCK);
        stream.fill(block, total, &mut out);
        out.targets
    };
    let (mut wrong, mut of) = (u64::from(OrderStatistics::bytes(samples) > 4 * MIB), 1);
    // A stride that visits every remainder of the blocks between kept sums.
    for block in (0..200).map(|i| i * (blocks / 200) + i % 16) {
        let (targets, next) = (draw(block), draw(block + 1));
        wrong += u64::from(targets.windows(2).any(|w| w[0] > w[1]) || targets[BLOCK - 1] > next[0] || next[0] >= total);
        let p = (block * BLOCK as u64) as f64 / samples as f64;
        let off = (targets[0] as f64 / total as f64 - p).abs();
        // The first target of all has a deviation of about 1/M.
        let deviation = (p * (1.0 - p) / samples as f64).sqrt().max(1.0 / samples as f64);
        wrong += u64::from(off > 6.0 * deviation + 1.0 / samples as f64 && block > 0);
        of += 2;
    }
    let detail = format!("2^33 draws, {} bytes kept", OrderStatistics::bytes(samples));
    Ok(Finding::wrong(wrong, of, "checks of 200 blocks").with(detail))
}
