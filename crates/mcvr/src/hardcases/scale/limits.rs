//! The largest that is accepted, and one beyond.

use std::io::Read;
use std::time::Duration;

use mcvr_scene::film::Film;
use mcvr_scene::{Camera, DensityMap, Extent, View, Watch};
use mcvr_volume::{Grid, Phantom};

use super::program::{Place, start};
use super::{Bound, Case, CaseError, Context, Cost, Finding, MIB, case};
use crate::{Method, Request, Scenery, make, plan};

pub(super) const CASES: &[Case] = &[
    case(
        "one-beyond-the-limits",
        Cost::Quick,
        "a size that no memory holds is asked of the system, or wraps to a small one that is then overrun",
        "samples, voxels, pixels and a method's own budget: refused one beyond, in words, in no time",
        one_beyond,
    ),
    case(
        "plans-at-the-limit",
        Cost::Quick,
        "a forecast for 2^40 samples overflows and promises less work than there is",
        "every forecast of every method at 2^40 samples and 2^30 pixels lies between its exact ends",
        plans_at_the_limit,
    ),
    case(
        "converge-beyond-the-limit",
        Cost::Quick,
        "a ladder of sample counts fails after hours, at its last rung",
        "exit 1 before the truth is cast, the number named, no folder made",
        converge_beyond,
    ),
    case(
        "image-of-16384-squared",
        Cost::Large,
        "32-bit sizes overflow, or the image is copied until memory is full",
        "2^28 pixels hold every sample that fell on them, in 16 bytes a pixel and 24 MiB",
        image_of_16384,
    ),
];

fn scenery(extent: Extent) -> Result<Scenery, CaseError> {
    let volume = Phantom::parse("lobster@16")?.generate()?;
    let camera = Camera::look(&View::default(), volume.grid(), extent)?;
    Ok(Scenery::new(volume, DensityMap::default(), camera))
}

/// Exact: eleven requests one beyond a limit, each of which must be refused by an error that has the limit in it, and five at the limit, which
/// must not be refused (nothing is allocated for a size alone).
fn one_beyond(_: &Context) -> Result<Finding, CaseError> {
    let small = scenery(Extent::new(4, 4)?)?;
    let samples = |method: Method, samples: u64| {
        let request = Request { method, samples, ..Request::default() };
        make(&small, &request, &Watch::default()).err().map(|e| e.to_string())
    };
    let pixels = |w, h| Extent::new(w, h).err().map(|e| e.to_string());
    let voxels = |dims| Grid::with_spacing(dims, [1.0; 3]).err().map(|e| e.to_string());
    let beyond = [
        (samples(Method::Mc, (1 << 40) + 1), "2^40"),
        (samples(Method::Stratified, (1 << 40) + 1), "2^40"),
        (samples(Method::Qmc, u64::MAX), "2^40"),
        (samples(Method::McBinary, 0), "at least 1"),
        (samples(Method::McQuicksort, Method::QUICKSORT_LIMIT + 1), "at most 1073741824"),
        (samples(Method::McLinear, Method::LINEAR_LIMIT + 1), "at most 16384"),
        (pixels(1 << 30, 2), "2^30"),
        (pixels(32769, 32768), "2^30"),
        (pixels(usize::MAX, usize::MAX), "2^30"),
        (voxels([1 << 20, 1 << 20, 2]), "2^40"),
        (voxels([usize::MAX, usize::MAX, usize::MAX]), "2^40"),
    ];
    let within = [
        pixels(1 << 30, 1),
        pixels(32768, 32768),
        voxels([1 << 40, 1, 1]),
        voxels([1 << 20, 1 << 20, 1]),
        pixels(1, 1),
    ];
    let of = (beyond.len() + within.len()) as u64;
    let bad = |(error, limit): &&(Option<String>, &str)| !error.as_ref().is_some_and(|e| e.contains(limit));
    let wrong: Vec<_> = beyond.iter().filter(bad).map(|(error, limit)| format!("{limit}: {error:?}")).collect();
    let refused = within.iter().flatten().count();
    let detail = if wrong.is_empty() { "2^40 samples and voxels, 2^30 pixels".into() } else { wrong.join("; ") };
    Ok(Finding::wrong((wrong.len() + refused) as u64, of, "requests").with(detail))
}

/// Exact: at each method's largest budget, and 2^30 pixels, no forecast is upside down, samples are forecast to the last one, and the bytes are
/// those of the pixels at least (16 each) and no more than 2^43: 2^30 pixels of 8 bytes for each of up to 1024 workers.
fn plans_at_the_limit(_: &Context) -> Result<Finding, CaseError> {
    let scenery = scenery(Extent::new(32768, 32768)?)?;
    let (mut wrong, mut of) = (0u64, 0u64);
    for method in Method::ALL.into_iter().filter(|m| m.samples_volume()) {
        let samples = match method {
            Method::McQuicksort => Method::QUICKSORT_LIMIT,
            Method::McLinear => Method::LINEAR_LIMIT,
            _ => 1 << 40,
        };
        let request = Request { method, samples, ..Request::default() };
        let plan = plan::plan(&scenery, &request, &Film::default())?;
        for forecast in plan.forecasts() {
            of += 1;
            wrong += u64::from(forecast.at_most.is_some_and(|most| most < forecast.at_least));
            if forecast.counter == "render.samples" {
                wrong += u64::from(forecast.at_most != Some(samples));
            }
        }
        of += 1;
        wrong += u64::from(!((16 << 30)..=1 << 43).contains(&plan.bytes));
    }
    Ok(Finding::wrong(wrong, of, "forecasts").with("2^40 samples onto 2^30 pixels, by every sampling method"))
}

/// Exact: three ladders, one of them of ray counts, whose sum no integer of 64 bits holds.
fn converge_beyond(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let ladders = [
        ("mc,qmc", "2^38..2^41", "8", "2^40"),
        ("march", "9223372036854775808,9223372036854775807", "8", "2^63"),
        ("mc", "2^40", "4294967295", "1048576"),
    ];
    let mut wrong = vec![];
    for (methods, samples, replicates, limit) in ladders {
        let arguments = [
            "converge",
            "phantom:lobster@24",
            "--methods",
            methods,
            "--samples",
            samples,
            "--replicates",
            replicates,
            "--series",
            "none",
            "--size",
            "16x16",
            "--tolerance",
            "1e-2",
            "-o",
            "run",
        ];
        let ended = place.run(arguments)?;
        if !ended.failed_with(1, &[limit]) || place.path("run/records.csv").exists() {
            wrong.push(format!("{samples}: {}", ended.last_words()));
        }
    }
    Ok(Finding::wrong(wrong.len() as u64, 3, "ladders").with(wrong.join("; ")))
}

/// Sums take 8 bytes a pixel and values 8 more while one becomes the other; the file is written from the values through a buffer. 24 MiB are for what
/// does not grow, as for a mapped volume. The same bound is enforced as a limit to writable memory. That every sample is there is a
/// condition: the pixels times M must add up to the samples inside, to less than half a sample (each value is rounded to
/// 2^-53 of itself, so 10⁶ of them to 10⁻¹⁰ of a sample).
fn image_of_16384(context: &Context) -> Result<Finding, CaseError> {
    let place = Place::new(context)?;
    let (pixels, samples) = (1u64 << 28, 1u64 << 20);
    let bound = 16 * pixels + 24 * MIB;
    let script = format!("ulimit -d {} || exit 77; exec \"$@\"", bound / 1024);
    let arguments = [
        "render",
        "phantom:lobster@32",
        "--samples",
        "2^20",
        "--size",
        "16384x16384",
        "--estimand",
        "count",
        "--quiet",
        "--threads",
        "2",
        "-o",
        "a.npy",
        "--json",
        "a.json",
    ];
    let ended = start(place.shell(&script, arguments))?.wait(Duration::from_secs(300))?;
    if ended.code() == Some(77) || ended.err.contains("No space left") || short_of_memory(&ended.err, bound) {
        return Err(CaseError::Impossible(format!("no room: {}", ended.last_words())));
    }
    if !ended.status.success() {
        return Err(ended.last_words().into());
    }
    let record: serde_json::Value = serde_json::from_slice(&std::fs::read(place.path("a.json"))?)?;
    let inside = record["counters"]["render"]["inside"].as_u64().ok_or("no count of samples inside")?;
    let file = std::fs::File::open(place.path("a.npy"))?;
    let header = file.metadata()?.len().checked_sub(8 * pixels).ok_or("the file is too short")?;
    let mut file = std::io::BufReader::with_capacity(1 << 20, file);
    std::io::copy(&mut file.by_ref().take(header), &mut std::io::sink())?;
    let (mut sum, mut bytes) = (0.0, vec![0u8; 1 << 20]);
    for _ in 0..(8 * pixels) >> 20 {
        file.read_exact(&mut bytes)?;
        sum += bytes.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).sum::<f64>();
    }
    if (sum * samples as f64 - inside as f64).abs() >= 0.5 {
        return Err(format!("{} samples in the pixels, {inside} inside", sum * samples as f64).into());
    }
    let detail = format!("all {inside} samples inside are in the pixels");
    Ok(Finding::new(ended.anonymous()?, "bytes", Bound::AtMost(bound as f64)).with(detail))
}

/// Whether a refusal was for want of memory on this machine, not for the limit that the case sets.
fn short_of_memory(said: &str, limit: u64) -> bool {
    let free = said.split("memory and ").nth(1).and_then(|rest| rest.split(' ').next()?.parse::<u64>().ok());
    free.is_some_and(|free| free + 64 * MIB < limit)
}
