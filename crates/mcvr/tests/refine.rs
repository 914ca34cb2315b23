//! Images that know their error: passes and direct runs are one image, error bars hold the truth as often as they say, the
//! stopping rule keeps its word. (The 1000-repeat tables are made by `examples/error_bars`; here is what every change must keep.)
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use common::agreement::{Truth, agreement, nothing_strays};
use common::*;
use mcvr::qmc::Scramble;
use mcvr::refinement::{Goal, Limits, Picture, PixelGoal, Plan, Source, Stop};
use mcvr::sampling::{Distribution, PointStream, RenderOptions, Replicates, VoxelOrder};
use mcvr::scene::effects::{Effects, Light, LightPosition, Material, Shading, Sides};
use mcvr::scene::{Estimand, Image, Kernel, View, Watch};
use mcvr::{MadeRefined, Method, Refinement, Request, Scenery, refine};
use statrs::distribution::{Binomial, DiscreteCDF};

const METHODS: [Method; 3] = [Method::Qmc, Method::Stratified, Method::Mc];

fn refined(scenery: &Scenery, request: &Request, refinement: &Refinement) -> MadeRefined {
    refine(scenery, request, refinement, &Watch::default(), &mut |_, _| ControlFlow::Continue(())).unwrap()
}

/// So many samples in all, no goal.
fn direct(samples: u64) -> Refinement {
    Refinement { limits: Limits { samples, seconds: None }, ..Refinement::default() }
}

fn to_error(error: f64) -> Refinement {
    Refinement { goal: Goal { error: Some(error), ..Goal::default() }, ..Refinement::default() }
}

fn rmse(image: &Image, truth: &Image) -> f64 {
    let squares = image.values().iter().zip(truth.values()).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    (squares / truth.values().len() as f64).sqrt() / truth.mean()
}

/// Shaded by a white and by a tinted light (one sum for three channels), and with colours by isovalue (three sums).
fn effects() -> [(&'static str, Effects); 3] {
    let position = LightPosition::Around { azimuth: 100.0, elevation: 25.0, distance: Some(25.0) };
    let light = |colour: &str| Light { position, colour: colour.parse().unwrap(), intensity: 1.5 };
    let shading = Some(Shading { sides: Sides::Two });
    let bone = Material { name: None, from: Some(180.0), to: None, colour: "#ff8000".parse().unwrap(), weight: 2.0 };
    [
        ("shaded", Effects { light: light("#ffffff"), shading, ..Effects::default() }),
        ("tinted", Effects { light: light("#ff8040"), shading, ..Effects::default() }),
        ("materials", Effects { materials: vec![bone], ..Effects::default() }),
    ]
}

#[test]
fn stopping_at_any_pass_gives_what_a_direct_run_gives() {
    let mut scenes = vec![("plain", speckled_scene(&pinhole()))];
    scenes.extend(effects().map(|(name, e)| (name, speckled_scene(&pinhole()).with_effects(e))));
    for ((name, scenery), method) in scenes.iter().flat_map(|s| METHODS.map(|m| (s, m))) {
        for estimand in Estimand::ALL {
            let request = Request { method, estimand, ..Request::default() };
            let watched = Refinement { doubling: true, ..direct(8 * 20_000) };
            let mut passes: Vec<(u64, Picture)> = vec![];
            let last = refine(scenery, &request, &watched, &Watch::default(), &mut |look, snapshot| {
                passes.push((look.samples, snapshot.picture()));
                ControlFlow::Continue(())
            })
            .unwrap();
            assert!(passes.len() >= 5, "{name} {method}: {} passes", passes.len());
            assert_eq!(last.made.image, passes.last().unwrap().1.image);
            for (samples, picture) in &passes {
                let run = refined(scenery, &request, &direct(*samples));
                assert_eq!(run.made.samples, *samples);
                assert_eq!(run.looks.len(), 1);
                assert_eq!(run.made.image, picture.image, "{name} {method} {estimand} {samples}");
                assert_eq!(run.made.colour, picture.colour, "{name} {method} {estimand} {samples}");
                assert_eq!(run.bars, picture.bars, "{name} {method} {estimand} {samples}");
            }
            // And what the plain loop makes of as many samples is the same image within both errors.
            let plain = made(scenery, &Request { samples: 1 << 18, ..request });
            let distance = rmse(&last.made.image, &plain.image);
            let error = last.looks.last().unwrap().estimate.error.unwrap();
            assert!(distance < 3.0 * error, "{name} {method} {estimand}: {distance} {error}");
            assert_eq!(last.made.colour.is_some(), plain.colour.is_some(), "{name}");
        }
    }
}

#[test]
fn one_and_four_threads_give_the_same_image_bars_and_looks() {
    let scenery = speckled_scene(&pinhole());
    for method in METHODS {
        let request = Request { method, ..Request::default() };
        let [one, four] = [1, 4].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| refined(&scenery, &request, &to_error(0.03)))
        });
        assert_eq!(one.made.image, four.made.image, "{method}");
        assert_eq!(one.bars, four.bars, "{method}");
        assert_eq!(one.made.counters, four.made.counters, "{method}");
        let figures = |m: &MadeRefined| m.looks.iter().map(|l| (l.samples, l.estimate)).collect::<Vec<_>>();
        assert_eq!(figures(&one), figures(&four), "{method}");
    }
}

/// The image, over seeds, against the exact one; and the estimated error against the actual one.
#[test]
fn refined_images_are_unbiased_and_so_are_the_squares_of_their_errors() {
    let scenery = speckled_scene(&pinhole());
    for estimand in Estimand::ALL {
        let reference = exact(&scenery, Kernel::Tent, estimand, 1e-6, 8);
        let share = exact(&scenery, Kernel::Tent, Estimand::Count, 1e-3, 4).image;
        let truth = Truth { image: reference.image, error: reference.error.image, share };
        for method in METHODS {
            let (seeds, samples) = (64, 1u64 << 15);
            let request = |seed| Request { method, estimand, seed, ..Request::default() };
            let made: Vec<MadeRefined> = (0..seeds).map(|s| refined(&scenery, &request(s), &direct(samples))).collect();
            let images: Vec<Image> = made.iter().map(|m| m.made.image.clone()).collect();
            let label = format!("refined {method} {estimand}");
            nothing_strays(&label, &truth, &images);
            agreement(label.clone(), &truth, &images, samples).hold();
            // The ratio of the mean squares, with its error by the spread over seeds; five of those.
            let squares: Vec<[f64; 2]> = made
                .iter()
                .map(|m| [m.looks[0].estimate.error.unwrap().powi(2), rmse(&m.made.image, &truth.image).powi(2)])
                .collect();
            let mean = |i: usize| squares.iter().map(|s| s[i]).sum::<f64>() / seeds as f64;
            let (estimated, actual) = (mean(0), mean(1));
            let spread = squares.iter().map(|s| (s[0] / estimated - s[1] / actual).powi(2)).sum::<f64>();
            let error = (spread / (seeds - 1) as f64 / seeds as f64).sqrt();
            assert!((estimated / actual - 1.0).abs() < 5.0 * error, "{label}: {estimated} {actual} ± {error}");
            assert!(error < 0.1, "{label}: {error}");
        }
    }
}

/// Independent samples: -1/2. A sequence beats that; a sampler stuck on repeated points would stand still.
#[test]
fn errors_fall_as_fast_as_they_should() {
    let scenery = speckled_scene(&pinhole());
    for (method, slopes) in [(Method::Mc, -0.53..-0.47), (Method::Qmc, -0.8..-0.55)] {
        let error = |samples: u64| {
            let squares: f64 = (0..8)
                .map(|seed| {
                    let run = refined(&scenery, &Request { method, seed, ..Request::default() }, &direct(samples));
                    run.looks[0].estimate.error.unwrap().powi(2)
                })
                .sum();
            (squares / 8.0).sqrt()
        };
        let slope = (error(1 << 21) / error(1 << 15)).ln() / 64f64.ln();
        assert!(slopes.contains(&slope), "{method}: {slope}");
    }
}

#[test]
fn intervals_hold_the_truth_as_often_as_they_say() {
    let scenery = speckled_scene(&pinhole());
    let truth = exact(&scenery, Kernel::Tent, Estimand::Line, 1e-6, 8).image;
    let mut seen: Vec<usize> = (0..truth.values().len()).filter(|&p| truth.values()[p] > 0.0).collect();
    seen.sort_by(|&a, &b| truth.values()[a].total_cmp(&truth.values()[b]));
    let third = seen.len() / 3;
    for method in [Method::Qmc, Method::Mc] {
        let repeats = 300;
        let mut shares = [const { vec![] }; 2];
        for seed in 0..repeats {
            let run = refined(&scenery, &Request { method, seed: 1000 + seed, ..Request::default() }, &direct(1 << 17));
            for (shares, stratum) in shares.iter_mut().zip([&seen[..third], &seen[seen.len() - third..]]) {
                let bars = &run.bars[0];
                let held = stratum
                    .iter()
                    .filter(|&&p| (bars.low.values()[p]..=bars.high.values()[p]).contains(&truth.values()[p]));
                shares.push(held.count() as f64 / stratum.len() as f64);
            }
        }
        for (name, shares) in ["dark", "bright"].into_iter().zip(shares) {
            let mean = shares.iter().sum::<f64>() / repeats as f64;
            let spread = shares.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (repeats - 1) as f64;
            // The band, and four standard errors of these repeats.
            let slack = 0.014 + 4.0 * (spread / repeats as f64).sqrt();
            assert!((mean - 0.95).abs() < slack, "{method} {name}: {mean} ± {slack}");
        }
    }
}

/// With 95 % confidence, more than the failures that a binomial count exceeds with probability 1e-4 are too many.
#[test]
fn the_error_that_is_asked_for_is_met() {
    let scenery = speckled_scene(&pinhole());
    let truth = exact(&scenery, Kernel::Tent, Estimand::Line, 1e-6, 8).image;
    let repeats = 150;
    let allowed = Binomial::new(0.05, repeats).unwrap().inverse_cdf(1.0 - 1e-4);
    for method in [Method::Qmc, Method::Mc] {
        for (refinement, actual) in [
            (to_error(0.04), &(|image: &Image| rmse(image, &truth) <= 0.04) as &dyn Fn(&Image) -> bool),
            (
                Refinement {
                    goal: Goal { pixel: Some(PixelGoal { error: 0.08, share: 0.9 }), ..Goal::default() },
                    ..Refinement::default()
                },
                &|image| {
                    let pairs = image.values().iter().zip(truth.values());
                    let good = pairs.filter(|(a, b)| (*a - *b).abs() <= 0.08 * truth.mean()).count();
                    good as f64 >= 0.9 * truth.values().len() as f64
                },
            ),
        ] {
            let mut failures = 0;
            for seed in 0..repeats {
                let run = refined(&scenery, &Request { method, seed, ..Request::default() }, &refinement);
                assert_eq!(run.stop, Stop::Reached);
                failures += u64::from(!actual(&run.made.image));
            }
            assert!(failures <= allowed, "{method} {:?}: {failures} of {repeats} missed", refinement.goal);
        }
    }
}

#[test]
fn pixels_without_samples_are_flagged_and_bounded() {
    let scenery = speckled_scene(&pinhole());
    let truth = exact(&scenery, Kernel::Tent, Estimand::Line, 1e-6, 8).image;
    let (mut empty, mut within) = (0, 0);
    for seed in 0..40 {
        let run = refined(&scenery, &Request { method: Method::Mc, seed, ..Request::default() }, &direct(1 << 10));
        let bars = &run.bars[0];
        let mut flagged = 0;
        for p in 0..truth.values().len() {
            let none = run.made.image.values()[p] == 0.0;
            assert_eq!(bars.unresolved.values()[p] == 1.0, none);
            assert!(bars.error.values()[p] > 0.0 && bars.high.values()[p] > 0.0);
            flagged += u64::from(none);
            if none && truth.values()[p] > 0.0 {
                assert_eq!(bars.low.values()[p], 0.0);
                empty += 1;
                within += u64::from(truth.values()[p] <= bars.high.values()[p]);
            }
        }
        assert_eq!(flagged, bars.unresolved_pixels);
    }
    assert!(empty > 100 && within as f64 > 0.95 * empty as f64, "{within} of {empty}");
}

#[test]
fn a_camera_that_sees_nothing_is_black_and_exact() {
    let mut scenery = speckled_scene(&pinhole());
    let away = View { fov: Some(1.0), ..pinhole() };
    let mut camera = speckled_scene(&away).camera;
    // The same narrow camera, turned to look past the volume: a shift of its principal point by many images.
    let mut matrix = camera.world_to_pixel();
    let [across, _, depth] = &mut matrix;
    across.iter_mut().zip(depth).for_each(|(a, d)| *a += 1e4 * *d);
    camera = mcvr::scene::Camera::from_matrix(matrix, camera.extent(), scenery.volume.grid(), None).unwrap();
    scenery.camera = camera;
    let run = refined(&scenery, &Request::default(), &to_error(0.01));
    assert_eq!(run.stop, Stop::Reached);
    assert!(run.made.image.values().iter().all(|v| *v == 0.0));
    assert_eq!(run.bars[0].unresolved_pixels, 0);
}

#[test]
fn time_and_callers_stop_the_work_and_what_is_finished_is_a_direct_run() {
    let scenery = speckled_scene(&pinhole());
    let request = Request::default();
    let hasty = Refinement { limits: Limits { samples: 1 << 30, seconds: Some(1e-6) }, ..Refinement::default() };
    let run = refined(&scenery, &request, &hasty);
    assert_eq!(run.stop, Stop::Time);
    assert_eq!(run.made.image, refined(&scenery, &request, &direct(run.made.samples)).made.image);

    let mut looks = 0;
    let run = refine(&scenery, &request, &to_error(1e-5), &Watch::default(), &mut |_, _| {
        looks += 1;
        if looks == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })
    .unwrap();
    assert_eq!((run.stop, run.looks.len()), (Stop::Interrupted, 3));
    assert_eq!(run.made.image, refined(&scenery, &request, &direct(run.made.samples)).made.image);
}

#[test]
fn what_callers_take_for_their_looks_is_not_the_images_time() {
    let scenery = speckled_scene(&pinhole());
    let nap = Duration::from_millis(10);
    let watched = Refinement { doubling: true, ..direct(1 << 16) };
    let start = Instant::now();
    let run = refine(&scenery, &Request::default(), &watched, &Watch::default(), &mut |_, _| {
        std::thread::sleep(nap);
        ControlFlow::Continue(())
    })
    .unwrap();
    // All naps but the last come before the last look; a nap is never shorter than it says.
    let naps = nap * (run.looks.len() as u32 - 1);
    assert!(run.looks.len() >= 3);
    assert!(run.looks.last().unwrap().seconds <= (start.elapsed() - naps).as_secs_f64());
}

/// The points of one replicate are those of its number.
struct Streams;

impl Source for Streams {
    fn points(&self, replicate: usize, from: u64, to: u64) -> Vec<Box<dyn PointStream>> {
        let sequence = mcvr::qmc::SobolSequence::new(replicate as u64, Scramble::default());
        let runs = mcvr::refinement::dyadic_runs(from, to).into_iter();
        runs.map(|(first, samples)| Box::new(sequence.run(first, samples)) as Box<dyn PointStream>).collect()
    }
}

/// A pass that is stopped in its middle leaves the picture of the pass before.
#[test]
fn stopped_in_the_middle_of_a_long_pass_the_last_finished_one_is_kept() {
    let scenery = speckled_scene(&pinhole());
    let density = density(&scenery);
    let distribution = Distribution::new(&density, VoxelOrder::Raster).unwrap();
    let look = Effects::default().look(scenery.volume.grid(), &scenery.camera).unwrap();
    let run = |samples: u64, stop_after: u64| {
        let options = RenderOptions::default();
        let mut replicates = Replicates::new(&distribution, &scenery.camera, &look, &options, 8).unwrap();
        let plan = Plan {
            goal: Goal::default(),
            limits: Limits { samples, seconds: None },
            doubling: true,
            // As if the first pass had taken long: all passes count as long.
            start: Instant::now().checked_sub(Duration::from_secs(1000)).unwrap(),
        };
        let (drawn, cancel) = (AtomicU64::new(0), AtomicBool::new(false));
        let count = |n: u64| {
            if drawn.fetch_add(n, Ordering::SeqCst) + n > stop_after {
                cancel.store(true, Ordering::SeqCst);
            }
        };
        let watch = Watch { progress: Some(&count), cancel: Some(&cancel) };
        let mut seen = vec![];
        let out = mcvr::refinement::refine(&mut replicates, &Streams, &plan, &watch, &mut |look, snapshot| {
            seen.push((look.samples, snapshot.picture()));
            ControlFlow::Continue(())
        });
        (out, seen)
    };
    let (whole, seen) = run(1 << 18, u64::MAX);
    assert_eq!(whole.unwrap().stop, Stop::Samples);
    let (stopped, _) = run(1 << 18, seen[2].0 + 5000);
    let stopped = stopped.unwrap();
    assert_eq!((stopped.stop, stopped.looks.len()), (Stop::Interrupted, 3));
    assert_eq!(stopped.picture, seen[2].1);
    // Before the first look there is nothing to keep.
    assert!(run(1 << 18, 1).0.is_err());
}

#[test]
fn unusable_numbers_are_refused_by_name() {
    let scenery = speckled_scene(&pinhole());
    let refuse = |request: &Request, refinement: &Refinement| {
        refine(&scenery, request, refinement, &Watch::default(), &mut |_, _| ControlFlow::Continue(()))
            .unwrap_err()
            .to_string()
    };
    let base = Refinement::default();
    let cases = [
        (Request { method: Method::Exact, ..Request::default() }, base, "exact"),
        (Request { scramble: Scramble::None, ..Request::default() }, base, "alike"),
        (Request::default(), Refinement { replicates: 7, ..direct(1 << 20) }, "7"),
        (Request::default(), direct(7), "at least one a replicate"),
        (Request::default(), to_error(0.0), "the error is 0"),
        (Request::default(), to_error(f64::NAN), "NaN"),
        (
            Request::default(),
            Refinement { goal: Goal { confidence: 1.0, ..Goal::default() }, ..base },
            "the confidence is 1",
        ),
    ];
    for (request, refinement, words) in cases {
        let said = refuse(&request, &refinement);
        assert!(said.contains(words), "{said}");
    }
}
