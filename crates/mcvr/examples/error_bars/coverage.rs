//! How often the 95 % intervals of pixels hold the truth.

use mcvr::scene::Estimand;
use mcvr::{Method, Request};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::curve::{Curve, Subject};
use crate::records::Records;
use crate::scenes::{self, FOV, INSIDE, Scene};
use crate::statistics::{Figure, ratio};
use crate::strata::{STRATA, by_samples, strata};
use crate::tally::{Coverage, Pixels, Repeat, count, coverage};
use crate::truths::truth;
use crate::{Options, Outcome};

pub const PART: &str = "coverage";
/// Of the exact images, relative to the mean pixel.
pub const TOLERANCE: f64 = 1e-4;
/// Repeats that one thread does in a row.
const CHUNK: u64 = 20;

#[derive(Debug, Serialize, Deserialize)]
pub struct Row {
    pub scene: String,
    pub method: String,
    pub estimand: String,
    pub replicates: u32,
    pub side: usize,
    /// Full angle of the image, degrees.
    pub fov: f64,
    /// Samples of all replicates together.
    pub samples: u64,
    pub repeats: u64,
    /// The truth's own RMS error over the mean pixel, by its own estimate.
    pub truth_error: f64,
    /// Relative RMSE of the images, root mean square over the repeats.
    pub error: f64,
    pub strata: Vec<Coverage>,
    pub by_samples: Vec<Coverage>,
    /// Mean of the images' estimates of their squared relative RMSE over the mean of that.
    pub squares: Option<Figure>,
    /// Largest deviation of a pixel's mean from the truth in standard errors, and the number of pixels judged.
    pub worst: (f64, usize),
    /// Error over samples.
    pub curve: Option<Curve>,
}

/// One setting.
struct Setting {
    method: Method,
    estimand: Estimand,
    replicates: u32,
    samples: u64,
    fov: f64,
    /// Whether the slope is measured too.
    slope: bool,
}

fn settings(quick: bool, scan: bool) -> (usize, Vec<Setting>) {
    use Estimand::{Count, Line};
    use Method::{Mc, Qmc, Stratified};
    let (side, dense, sparse) = if quick { (16, 1 << 15, 1 << 13) } else { (48, 1 << 18, 1 << 15) };
    let of = |method, estimand, replicates| {
        let slope = estimand == Line && replicates == 8;
        Setting { method, estimand, replicates, samples: dense, fov: INSIDE, slope }
    };
    let thin = |method| Setting { samples: sparse, fov: FOV, slope: false, ..of(method, Line, 8) };
    let (mc, qmc) = (of(Mc, Line, 8), [of(Qmc, Line, 8), of(Qmc, Count, 8), of(Qmc, Line, 16)]);
    // Of the scan, whose images take longer, a part.
    let more = if scan { vec![] } else { vec![of(Mc, Count, 8), of(Stratified, Line, 8)] };
    (side, [mc].into_iter().chain(more).chain(qmc).chain([thin(Mc), thin(Qmc)]).collect())
}

pub fn measure(options: &Options) -> Outcome<()> {
    let mut records = Records::open(options, PART)?;
    for scene in scenes::both(options)? {
        let (side, settings) = settings(options.quick, scene.name == "lobster");
        for s in &settings {
            let key = format!(
                "{}, {}, {}, R {}, {side}x{side}, {} degrees, {} samples, {} repeats",
                scene.name, s.method, s.estimand, s.replicates, s.fov, s.samples, options.repeats
            );
            records.row(options, PART, &key, || row(options, &scene, side, s))?;
        }
    }
    Ok(())
}

fn row(options: &Options, scene: &Scene, side: usize, setting: &Setting) -> Outcome<Row> {
    let Setting { method, estimand, replicates, samples, fov, slope } = *setting;
    let scenery = scene.scenery(side, Some(fov))?;
    let truth_of = |estimand| truth(&options.out, &scenery, estimand, TOLERANCE);
    let (truth, shares) = (truth_of(estimand)?, truth_of(Estimand::Count)?);
    let request = Request { method, estimand, ..Request::default() };
    let subject = Subject { scenery: &scenery, truth: &truth, request, replicates };
    // Which samples come into the picture does not depend on the seed but by chance: one image tells how many.
    let first = subject.image(0, samples)?;
    let inside = first.made.counters["render"]["inside"].as_f64().ok_or("no count of samples inside the image")?;
    let expected: Vec<f64> = shares.image.values().iter().map(|v| v / shares.image.sum() * inside).collect();
    let (strata, classes) = (strata(&truth.image), by_samples(&expected));
    let split = strata.len();
    let groups: Vec<_> = strata.into_iter().chain(classes).collect();
    let chunk = |c: u64| -> Outcome<(Vec<Repeat>, Pixels)> {
        let mut pixels = Pixels::new(expected.len());
        let seeds = c * CHUNK + 1..=((c + 1) * CHUNK).min(options.repeats);
        let repeats = seeds.map(|seed| count(&subject.image(seed, samples)?, &truth, &groups, &mut pixels));
        Ok((repeats.collect::<Outcome<_>>()?, pixels))
    };
    let chunks: Vec<_> = (0..options.repeats.div_ceil(CHUNK)).into_par_iter().map(chunk).collect::<Outcome<_>>()?;
    let (mut repeats, mut sums) = (vec![], Pixels::new(expected.len()));
    for (some, pixels) in chunks {
        repeats.extend(some);
        sums.add(&pixels);
    }
    let covered = groups.iter().enumerate().map(|(n, group)| coverage(group, n, &repeats, &sums, &expected, &truth));
    let mut covered: Vec<Coverage> = covered.collect::<Option<_>>().ok_or("a stratum has no pixel")?;
    let by_samples = covered.split_off(split);
    let seeds = (options.repeats / 10).max(10);
    let curve = slope.then(|| Curve::of(&subject, samples, seeds, |image| truth.distance(image))).transpose()?;
    let n = repeats.len() as f64;
    Ok(Row {
        scene: scene.name.into(),
        method: method.to_string(),
        estimand: estimand.to_string(),
        replicates,
        side,
        fov,
        samples,
        repeats: options.repeats,
        truth_error: truth.own_error,
        error: (repeats.iter().map(|r| r.squares.1).sum::<f64>() / n).sqrt(),
        strata: covered,
        by_samples,
        squares: ratio(repeats.iter().map(|r| r.squares)),
        worst: sums.worst(&expected, &truth, n),
        curve,
    })
}

/// The strata are in every row.
pub fn of<'a>(row: &'a Row, stratum: &str) -> Option<&'a Coverage> {
    debug_assert!(STRATA.contains(&stratum));
    row.strata.iter().find(|s| s.name == stratum)
}
