//! "QMC converges slightly faster but preprocesses longer."

use mcvr_harness::fit::ErrorsAt;
use mcvr_harness::{SlopeFit, Spread};
use mcvr_sampling::VoxelOrder;

use super::bench::{Job, complete, distribution, ratio, spread};
use super::{Bench, Claim, ClaimError, Figure, Finding, MILLION, Unit, Verdict};
use crate::{Method, Request};

/// How many times longer QMC's distribution must take to count as longer: less is lost in the noise of a clock.
pub const LONGER: f64 = 1.1;

const LOGS: std::ops::RangeInclusive<u32> = 14..=22;
/// Budget at which errors and times are compared.
const LAST: u64 = 1 << 22;
/// Most samples of a direct run at equal error.
const DIRECT: f64 = (1u64 << 28) as f64;

pub(super) const CLAIM: Claim = Claim {
    name: "qmc",
    quote: "QMC converges slightly faster but preprocesses longer",
    tested: "mc and qmc at 2^14 to 2^22 samples against the ray-cast truth: exponents of the error; time of the distribution in \
             each voxel order over mc's in raster order; time until the error that qmc has at 2^22",
    criterion: "holds if qmc's exponent is lower than mc's with 95 % intervals apart, and the distribution in the order that \
                qmc uses here takes at least 1.1 times as long as mc's in raster order; in part if one of the two",
    measure,
};

/// The verdict on the upper end of qmc's exponent and the lower end of mc's, and on the time of qmc's distribution over mc's.
pub fn judge(qmc_high: f64, mc_low: f64, preprocessing: f64) -> Verdict {
    let (faster, longer) = (qmc_high < mc_low, preprocessing >= LONGER);
    Verdict::ladder(&[qmc_high, mc_low, preprocessing], faster && longer, faster || longer)
}

/// Errors at every budget, the first replicate's first.
fn errors(bench: &Bench<'_>, method: Method) -> Result<Vec<ErrorsAt>, ClaimError> {
    LOGS.map(|log| {
        bench.say(&format!("errors, {method} at 2^{log}"));
        let samples = 1 << log;
        Ok(ErrorsAt { samples, errors: bench.errors(&bench.with(method, samples))? })
    })
    .collect()
}

fn measure(bench: &Bench<'_>) -> Result<Finding, ClaimError> {
    let floor = bench.truth()?.rel_error_estimate;
    let fit = |errors: &[ErrorsAt]| {
        let too_few = || ClaimError::NotTestable("fewer than three errors are above ten times the truth's own".into());
        SlopeFit::of(errors, floor).filter(|f| f.points > 2).ok_or_else(too_few)
    };
    let (mc, qmc) = (errors(bench, Method::Mc)?, errors(bench, Method::Qmc)?);
    let (mc_fit, qmc_fit) = (fit(&mc)?, fit(&qmc)?);
    let pairs = mc.iter().zip(&qmc).next_back().into_iter();
    let apart = Spread::of(pairs.flat_map(|(m, q)| q.errors.iter().zip(&m.errors).map(|(q, m)| q / m)).collect());
    // M^(-1/2): an error k times smaller takes k² times the samples.
    let needed = LAST as f64 / apart.median.powi(2);

    let scenery = bench.scenery;
    let at =
        |method, order, samples| Job { scenery, request: Request { order, ..bench.with(method, samples) }, one: false };
    let resolved = |order: VoxelOrder| order.resolve(&scenery.camera, scenery.volume.grid());
    let orders = [VoxelOrder::Raster, VoxelOrder::Depth, VoxelOrder::Hilbert];
    let mut jobs = vec![at(Method::Mc, VoxelOrder::Raster, MILLION), at(Method::Qmc, bench.request.order, MILLION)];
    jobs.extend(orders.map(|order| at(Method::Qmc, order, MILLION)));
    jobs.push(at(Method::Qmc, bench.request.order, LAST));
    let direct = needed <= DIRECT;
    jobs.extend(direct.then(|| at(Method::Mc, VoxelOrder::Raster, needed.ceil() as u64)));
    let rounds = bench.rounds(&jobs, bench.options.repeats)?;

    let longer = ratio(&rounds[1], &rounds[0], distribution);
    let order = resolved(bench.request.order).name();
    let mut figures = vec![
        Figure::exponent("exponent of M in the error, mc", &mc_fit),
        Figure::exponent("qmc", &qmc_fit),
        Figure::spread(format!("distribution, qmc in order {order} over mc in raster order"), longer, Unit::Ratio),
        Figure::spread("error of qmc over mc at 2^22", apart, Unit::Ratio),
        Figure::spread("distribution, mc in raster order", spread(&rounds[0], distribution), Unit::Seconds),
    ];
    for (i, order) in orders.iter().enumerate() {
        let name = match resolved(*order) {
            same if same == *order => format!("distribution, qmc in order {}", order.name()),
            stands_for => format!("distribution, qmc in order {} (here {})", order.name(), stands_for.name()),
        };
        figures.push(Figure::spread(name, spread(&rounds[2 + i], distribution), Unit::Seconds));
    }
    figures.push(Figure::spread("complete, qmc at 2^22", spread(&rounds[5], complete), Unit::Seconds));
    figures.push(Figure::plain("samples of mc with qmc's error at 2^22, by M^(-1/2)", needed, Unit::Samples));
    if direct {
        figures.push(Figure::spread("their complete time", spread(&rounds[6], complete), Unit::Seconds));
        figures.push(Figure::spread("that over qmc's", ratio(&rounds[6], &rounds[5], complete), Unit::Ratio));
    }
    let (high, low) = (qmc_fit.high.unwrap_or(f64::NAN), mc_fit.low.unwrap_or(f64::NAN));
    let ends = [judge(high, low, longer.min), judge(high, low, longer.max)];
    let note = "Here preprocessing is the distribution alone: the net comes out sorted, so that nothing else is prepared. qmc's exponent \
                lies between −1/2 and −2/3 and grows steeper with M, once its strata are smaller than a pixel.";
    Ok(Finding::new(judge(high, low, longer.median), &ends, figures, note))
}
