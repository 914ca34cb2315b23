//! "Shading doubles the time."

use mcvr_scene::Effects;
use mcvr_scene::effects::Shading;

use super::bench::{Job, complete, per_view, ratio, spread};
use super::{Bench, Claim, ClaimError, Figure, Finding, MILLION, Unit, Verdict};
use crate::Method;

/// What counts as doubling.
pub const DOUBLE: std::ops::RangeInclusive<f64> = 1.5..=2.5;

pub(super) const CLAIM: Claim = Claim {
    name: "shading",
    quote: "shading doubles the time",
    tested: "images of 10^6 samples with Lambert shading over plain ones, mc and qmc, one thread and all; complete, and per view \
             without the distribution",
    criterion: "mc on one thread, as in the report: holds if the complete image takes 1.5 to 2.5 times as long; in part if only \
                the view does, the distribution ready",
    measure,
};

/// The verdict on how many times longer a shaded image takes: complete, and per view.
pub fn judge(complete: f64, per_view: f64) -> Verdict {
    Verdict::ladder(&[complete, per_view], DOUBLE.contains(&complete), DOUBLE.contains(&per_view))
}

fn measure(bench: &Bench<'_>) -> Result<Finding, ClaimError> {
    let effects = Effects { shading: Some(Shading::default()), ..Effects::default() };
    let shaded = bench.scenery.clone().with_effects(effects);
    let all_threads = rayon::current_num_threads();
    let mut kinds = vec![(Method::Mc, true), (Method::Qmc, true)];
    if all_threads > 1 {
        kinds.extend([(Method::Mc, false), (Method::Qmc, false)]);
    }
    let jobs: Vec<_> = kinds
        .iter()
        .flat_map(|&(method, one)| {
            let request = bench.with(method, MILLION);
            [bench.scenery, &shaded].map(|scenery| Job { scenery, request, one })
        })
        .collect();
    let rounds = bench.rounds(&jobs, bench.options.repeats)?;
    let (mut figures, mut deciding) = (vec![], None);
    for ((method, one), pair) in kinds.iter().zip(rounds.chunks(2)) {
        let threads = if *one { "one thread".to_owned() } else { format!("{all_threads} threads") };
        let (all, view) = (ratio(&pair[1], &pair[0], complete), ratio(&pair[1], &pair[0], per_view));
        figures.extend([
            Figure::spread(format!("complete, {method}, {threads}"), all, Unit::Ratio),
            Figure::spread(format!("per view, {method}, {threads}"), view, Unit::Ratio),
        ]);
        if *method == Method::Mc {
            figures.push(Figure::spread(
                format!("plain {method}, {threads}"),
                spread(&pair[0], complete),
                Unit::Seconds,
            ));
            figures.push(Figure::spread(
                format!("shaded {method}, {threads}"),
                spread(&pair[1], complete),
                Unit::Seconds,
            ));
        }
        deciding = deciding.or(Some((all, view)));
    }
    let Some((all, view)) = deciding else {
        return Err(ClaimError::NotTestable("no method was measured".into()));
    };
    let ends = [judge(all.min, view.min), judge(all.max, view.max)];
    let note = "A gradient is computed where a sample fell and none is kept; the distribution is the same.";
    Ok(Finding::new(judge(all.median, view.median), &ends, figures, note))
}
