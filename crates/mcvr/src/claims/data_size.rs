//! "Image time is independent of the data size."

use super::bench::{complete, exponent, per_view, spread};
use super::sizes::at_sizes;
use super::{Bench, Claim, ClaimError, Figure, Finding, Unit, Verdict};
use crate::{Method, Request};

/// Largest exponent of the number of voxels that counts as independence: at this one a thousand times the voxels double
/// the time (1000^0.1 = 2).
pub const INDEPENDENT: f64 = 0.1;

pub(super) const CLAIM: Claim = Claim {
    name: "data-size",
    quote: "image time is independent of the data size",
    tested: "the same volume at several sizes, 2^20 and 2^22 samples; exponent of the median time against the number of voxels",
    criterion: "mc at 2^20: holds if the exponent of the complete image's time is at most 0.1 (a thousand times the voxels \
                double the time); in part if only that of the time per view is, the distribution ready",
    measure,
};

/// The verdict on the exponents of the complete image's time and of the time per view.
pub fn judge(complete: f64, per_view: f64) -> Verdict {
    let (all, view) = (complete <= INDEPENDENT, per_view <= INDEPENDENT);
    Verdict::ladder(&[complete, per_view], all && view, view)
}

fn measure(bench: &Bench<'_>) -> Result<Finding, ClaimError> {
    let (sceneries, left_out) = at_sizes(bench)?;
    let voxels: Vec<u64> = sceneries.iter().map(|s| s.volume.grid().len() as u64).collect();
    if voxels.len() < 3 {
        return Err(ClaimError::NotTestable(format!("{} sizes fit: an exponent needs three", voxels.len())));
    }
    let requests = [(Method::Mc, 20), (Method::Mc, 22), (Method::Qmc, 20), (Method::Qmc, 22)];
    let mut kinds: Vec<Request> = requests.iter().map(|&(method, log)| bench.with(method, 1 << log)).collect();
    // A kernel without a density cannot be marched through.
    let marched = bench.request.kernel != mcvr_scene::Kernel::Shell;
    kinds.extend(marched.then(|| bench.one_ray(1.0)));
    let jobs: Vec<_> = sceneries
        .iter()
        .flat_map(|scenery| kinds.iter().map(move |&request| super::bench::Job { scenery, request, one: false }))
        .collect();
    let rounds = bench.rounds(&jobs, bench.options.repeats)?;
    let of = |kind: usize, clock: fn(&_) -> f64| {
        let medians = (0..voxels.len()).map(|v| spread(&rounds[v * kinds.len() + kind], clock).median);
        exponent(voxels.iter().copied().zip(medians))
    };
    let (all, view) = (of(0, complete)?, of(0, per_view)?);
    let mut figures = vec![
        Figure::exponent("exponent of voxels, complete image, mc 2^20", &all),
        Figure::exponent("per view, mc 2^20", &view),
    ];
    for (kind, (method, log)) in requests.iter().enumerate().skip(1) {
        figures.push(Figure::exponent(format!("complete, {method} 2^{log}"), &of(kind, complete)?));
        figures.push(Figure::exponent(format!("per view, {method} 2^{log}"), &of(kind, per_view)?));
    }
    if marched {
        figures.push(Figure::exponent("ray march, step of one voxel, complete", &of(4, complete)?));
    }
    for (which, at) in [("smallest", 0), ("largest", voxels.len() - 1)] {
        let [x, y, z] = sceneries[at].volume.grid().dims();
        let times = &rounds[at * kinds.len()];
        let name = |clock| format!("{clock}, mc 2^20, {which} ({x}×{y}×{z})");
        figures.push(Figure::spread(name("complete"), spread(times, complete), Unit::Seconds));
        figures.push(Figure::spread(name("per view"), spread(times, per_view), Unit::Seconds));
    }
    let ends = [judge(all.low.unwrap_or(all.slope), view.low.unwrap_or(view.slope)), {
        judge(all.high.unwrap_or(all.slope), view.high.unwrap_or(view.slope))
    }];
    let mut note =
        "The distribution reads every voxel once, so a first image cannot be independent of them; a view with the \
                    distribution ready unpacks each brick of 256 voxels that a sample falls in: as long as there are more \
                    samples than bricks, more voxels are more bricks to unpack."
            .to_owned();
    if !left_out.is_empty() {
        note += &format!(" Left out for lack of memory: {}.", left_out.join(", "));
    }
    Ok(Finding::new(judge(all.slope, view.slope), &ends, figures, note))
}
