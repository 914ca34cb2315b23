//! Plans are held to what is counted: every forecast, of every method, from every kind of view.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use std::collections::BTreeSet;

use common::{SAMPLERS, made, scene_of, skewed, speckled_scene};
use mcvr::plan::{Plan, plan};
use mcvr::sampling::VoxelOrder;
use mcvr::scene::effects::{Colour, DepthColour, DepthCue, LightPosition, Material, Shading, Sides};
use mcvr::scene::film::Film;
use mcvr::scene::{Camera, DensityMap, Effects, Estimand, Extent, Kernel, View, Watch};
use mcvr::volume::{Grid, Volume};
use mcvr::{Made, Method, Request, Scenery};

/// The plan of a plain film.
fn planned(scenery: &Scenery, request: &Request) -> Plan {
    plan(scenery, request, &Film::default()).unwrap()
}

/// The count of a counter.
fn count(made: &Made, path: &str) -> u64 {
    path.split('.').fold(&made.counters, |v, key| &v[key]).as_u64().unwrap_or_else(|| panic!("{path}: no such counter"))
}

/// Holds a plan to an image, before and after the draw. Gives the image.
fn hold(name: &str, scenery: &Scenery, request: &Request) -> Made {
    let mut plan = planned(scenery, request);
    let made = made(scenery, request);
    for verdict in plan.verify(&made.counters) {
        assert!(verdict.holds(), "{name}: {verdict:?}");
    }
    plan.draw(scenery, request, &Watch::default()).unwrap();
    for verdict in plan.verify(&made.counters) {
        assert!(verdict.holds(), "{name}, drawn: {verdict:?}");
        assert!(verdict.forecast.unwrap().is_exact(), "{name}, drawn: {} is still a range", verdict.counter);
    }
    made
}

/// 28 800 voxels: a solid ball off the middle, something faint around it, and nothing at one end.
fn ball() -> Volume {
    let grid = Grid::with_spacing([40, 36, 20], [1.0, 1.1, 1.7]).unwrap();
    let voxels = (0..grid.len())
        .map(|i| {
            let [x, y, z] = grid.unravel(i).map(|v| v as f64);
            let r = (x - 22.0).powi(2) + (y - 17.0).powi(2) + (1.7 * (z - 9.0)).powi(2);
            match (r < 150.0, z < 14.0) {
                (true, _) => 100 + (i % 90) as u8,
                (false, true) => 20 + (i % 7) as u8,
                _ => 0,
            }
        })
        .collect::<Vec<u8>>();
    Volume::from_vec(grid, voxels, "ball").unwrap()
}

/// Whole, close up, from inside with and without a near plane, parallel, and beside the volume.
fn views(volume: &Volume) -> Vec<(&'static str, Camera)> {
    let extent = Extent::new(64, 48).unwrap();
    let grid = volume.grid();
    let look = |view: View| Camera::look(&view, grid, extent).unwrap();
    let base = View::default();
    let d = grid.diameter();
    let inside = look(View { distance: Some(0.05 * d), fov: Some(40.0), ..base });
    vec![
        ("whole", look(base)),
        ("close-up", look(View { distance: Some(d), fov: Some(6.0), ..base })),
        ("inside", inside),
        (
            "near plane",
            look(View { distance: Some(0.2 * d), fov: Some(50.0), near: Some(0.25 * d), azimuth: 0.0, ..base }),
        ),
        ("parallel", look(View { parallel: true, ..base })),
        ("parallel close-up", look(View { parallel: true, fov: Some(5.0), azimuth: 90.0, elevation: 0.0, ..base })),
        ("beside", Camera::from_matrix(shifted(look(base).world_to_pixel()), extent, grid, None).unwrap()),
    ]
}

/// The matrix of a camera whose image lies far beside what it shows.
fn shifted(mut rows: [[f64; 4]; 3]) -> [[f64; 4]; 3] {
    let [across, _, depth] = &mut rows;
    across.iter_mut().zip(depth).for_each(|(a, d)| *a += 1e4 * *d);
    rows
}

/// Every effect at once.
fn all_effects() -> Effects {
    let colour: Colour = "#ff8000".parse().unwrap();
    let mut effects = Effects {
        shading: Some(Shading { sides: Sides::Two }),
        depth_cue: Some(DepthCue { minimum: Some(5.0) }),
        depth_colour: Some(DepthColour::default()),
        materials: vec![Material { name: None, from: Some(50.0), to: None, colour, weight: 2.0 }],
        ..Effects::default()
    };
    effects.light.position = LightPosition::World([90.0, -40.0, 70.0]);
    effects
}

fn samples(method: Method) -> u64 {
    if method == Method::McLinear { 1 << 8 } else { 3 << 12 }
}

#[test]
fn every_forecast_of_every_sampler_holds_from_every_view() {
    let volume = ball();
    for (name, camera) in views(&volume) {
        for effects in [Effects::default(), all_effects()] {
            let scenery =
                Scenery::new(volume.clone(), DensityMap::default(), camera.clone()).with_effects(effects.clone());
            for method in SAMPLERS {
                for (cull, estimand) in [(true, Estimand::Line), (true, Estimand::Count), (false, Estimand::Line)] {
                    let request = Request { method, samples: samples(method), cull, estimand, ..Request::default() };
                    let name = format!("{name}, {method}, {estimand}, cull {cull}, plain {}", effects.is_plain());
                    hold(&name, &scenery, &request);
                }
            }
        }
    }
}

#[test]
fn every_forecast_holds_for_every_kernel_and_order_of_a_volume_of_three_bricks() {
    for kernel in Kernel::ALL {
        for order in common::orders() {
            for view in [View::default(), common::pinhole(), View { fov: Some(2.0), ..View::default() }] {
                let scenery = speckled_scene(&view);
                let request = Request { samples: 5000, kernel, order, ..Request::default() };
                hold(&format!("{kernel} {order:?} {view:?}"), &scenery, &request);
            }
        }
    }
}

#[test]
fn every_example_is_planned_as_it_is_made() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    let mut seen = 0;
    for path in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if path.extension().is_none_or(|e| e != "toml") {
            continue;
        }
        let out = std::process::Command::new(env!("CARGO_BIN_EXE_mcvr"))
            .args(["plan", "--run", "--samples", "2^14", "--size", "64x64", "--json", "-"])
            .arg(&path)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.success(), "{}: {said}", path.display());
        let record: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        let cameras = mcvr::SceneFile::read(&path).unwrap().cameras.len().max(1);
        let plans = record["plans"].as_array().unwrap();
        assert_eq!(plans.len(), cameras, "{}", path.display());
        for plan in plans {
            assert_eq!(plan["holds"], true, "{}", path.display());
            assert!(plan["verdicts"].as_array().unwrap().len() >= 19, "{}: {plan}", path.display());
        }
        seen += 1;
    }
    assert!(seen >= 11, "{seen}");
}

/// The names of a counter's tree.
fn names(made: &Made, tree: &str) -> BTreeSet<String> {
    made.counters[tree].as_object().unwrap().keys().cloned().collect()
}

#[test]
fn ray_casters_count_what_their_plans_name_and_nothing_else() {
    let known =
        ["cells", "colours", "empty_bricks", "evaluations", "gradients", "rays", "voxel_reads"].map(String::from);
    for (method, tree) in [(Method::Exact, "reference"), (Method::March, "march")] {
        for (name, view) in [("whole", View::default()), ("close-up", View { fov: Some(3.0), ..View::default() })] {
            let scenery = speckled_scene(&view);
            let request = Request { method, samples: 5000, ..Request::default() };
            let mut plan = planned(&scenery, &request);
            let before = plan.clone();
            plan.draw(&scenery, &request, &Watch::default()).unwrap();
            assert_eq!(plan, before, "rays are not drawn");
            let made = made(&scenery, &request);
            for verdict in plan.verify(&made.counters) {
                assert!(verdict.holds(), "{method} {name}: {verdict:?}");
            }
            assert_eq!(names(&made, tree), BTreeSet::from(known.clone()), "a new counter needs a forecast");
        }
    }
}

/// The ball seen whole, with effects.
fn whole(effects: Effects) -> Scenery {
    scene_of(ball(), DensityMap::default(), &View::default()).with_effects(effects)
}

#[test]
fn only_what_is_asked_for_is_paid_for() {
    let request = Request { samples: 1 << 14, ..Request::default() };
    let m = request.samples;
    let tally = |effects: Effects, request: Request| {
        let scenery = whole(effects);
        let forecasts = planned(&scenery, &request);
        let made = hold("paid for", &scenery, &request);
        move |counter: &str| {
            let path = format!("render.{counter}");
            let forecast = forecasts.forecasts().find(|f| f.counter == path).unwrap();
            assert!(forecast.is_exact(), "the whole volume is in view, so no draw decides {counter}");
            count(&made, &path)
        }
    };
    let effects = ["gradients", "gradient_reads", "gradient_field", "depth_cues", "voxel_colours", "depth_colours"];
    let of = |count: &dyn Fn(&str) -> u64| effects.map(count);

    let plain = tally(Effects::default(), request);
    assert_eq!(of(&plain), [0; 6]);
    assert_eq!((plain("inside"), plain("line_weights")), (m, m));

    let shading = Some(Shading { sides: Sides::One });
    let mut shaded = Effects { shading, ..Effects::default() };
    shaded.light.position = LightPosition::World([90.0, -40.0, 70.0]);
    assert_eq!(of(&tally(shaded, request)), [m, 32 * m, 0, 0, 0, 0]);

    let cued = Effects { depth_cue: Some(DepthCue { minimum: None }), ..Effects::default() };
    assert_eq!(of(&tally(cued, request)), [0, 0, 0, m, 0, 0]);

    let materials = Effects { materials: all_effects().materials, ..Effects::default() };
    assert_eq!(of(&tally(materials, request)), [0, 0, 0, 0, m, 0]);

    let by_depth = Effects { depth_colour: Some(DepthColour::default()), ..Effects::default() };
    assert_eq!(of(&tally(by_depth, request)), [0, 0, 0, 0, 0, m]);

    let shares = tally(Effects::default(), Request { estimand: Estimand::Count, ..request });
    assert_eq!(shares("line_weights"), 0);
}

#[test]
fn bricks_beside_the_image_are_neither_summed_nor_decoded() {
    let volume = ball();
    let camera = views(&volume).remove(1).1;
    let scenery = Scenery::new(volume, DensityMap::default(), camera);
    let far = Scenery { camera: views(&scenery.volume).pop().unwrap().1, ..scenery.clone() };
    let request = Request { samples: 1 << 14, ..Request::default() };
    let unseen = hold("beside", &far, &request);
    assert_eq!(["distribution.voxels_read", "render.samples", "render.voxels_read"].map(|c| count(&unseen, c)), [0; 3]);
    assert!(planned(&far, &request).forecasts().all(mcvr::plan::Forecast::is_exact), "known before any draw");
    for method in [Method::Mc, Method::McQuicksort, Method::McBinary, Method::Stratified, Method::Qmc] {
        let request = Request { method, samples: 1 << 14, order: VoxelOrder::Hilbert, ..Request::default() };
        let made = hold("close-up", &scenery, &request);
        let (bricks, beside) = (count(&made, "distribution.bricks"), count(&made, "distribution.bricks_beside"));
        let empty = count(&made, "distribution.empty_bricks");
        assert!(beside > bricks / 5, "{beside} of {bricks}");
        let seen = bricks - beside - empty;
        let summed = count(&made, "distribution.voxels_read");
        assert!(summed <= 256 * (bricks - beside), "{method}: {summed} voxels of {} bricks", bricks - beside);
        // Blocks that begin inside a brick decode it again.
        let most = if method == Method::McBinary { request.samples } else { seen + request.samples / 2048 - 1 };
        let decoded = count(&made, "render.bricks_decoded");
        assert!(decoded <= most && decoded > 0, "{method}: {decoded} bricks decoded of {seen} seen");
        let whole = mcvr::make(&scenery, &Request { cull: false, ..request }, &Watch::default()).unwrap();
        assert_eq!((count(&whole, "distribution.bricks_beside"), count(&whole, "distribution.bricks")), (0, bricks));
        let (with, without) = (count(&made, "render.inside"), count(&whole, "render.inside"));
        assert!(5 * with > 6 * without, "{method}: {with} samples in the image with culling, {without} without");
    }
}

/// The linear search must leave out the same bricks as the others: same points, same image.
#[test]
fn all_searches_find_the_same_voxels_where_bricks_are_left_out() {
    let volume = ball();
    for (name, camera) in views(&volume) {
        let scenery = Scenery::new(volume.clone(), DensityMap::default(), camera);
        let image = |method| made(&scenery, &Request { method, samples: 1 << 10, ..Request::default() }).image;
        assert_eq!(image(Method::McLinear), image(Method::McBinary), "{name}");
    }
}

#[test]
fn a_verdict_fails_for_a_wrong_an_unknown_and_a_missing_counter() {
    let scenery = whole(Effects::default());
    let request = Request { samples: 1 << 12, ..Request::default() };
    let plan = planned(&scenery, &request);
    let right = made(&scenery, &request).counters;
    let broken = |counters: &serde_json::Value| -> Vec<String> {
        plan.verify(counters).into_iter().filter(|v| !v.holds()).map(|v| v.counter).collect()
    };
    assert!(broken(&right).is_empty());
    let mut wrong = right.clone();
    wrong["render"]["gradients"] = 1.into();
    wrong["render"]["wishes"] = 0.into();
    wrong["distribution"].as_object_mut().unwrap().remove("bricks");
    assert_eq!(broken(&wrong), ["render.gradients", "render.wishes", "distribution.bricks"]);
}

/// Resident bytes of a mapped file, as the system has them.
#[cfg(target_os = "linux")]
fn resident(name: &str) -> u64 {
    let maps = std::fs::read_to_string("/proc/self/smaps").unwrap();
    let mut lines = maps.lines().skip_while(|l| !l.ends_with(name));
    assert!(lines.next().is_some(), "{name} is not mapped");
    let rss = lines.find_map(|l| l.strip_prefix("Rss:")).unwrap();
    1024 * rss.trim().trim_end_matches("kB").trim().parse::<u64>().unwrap()
}

/// A plan touches no page of a mapped volume; making the image does.
#[cfg(target_os = "linux")]
#[test]
fn a_plan_reads_no_voxel() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("unread-by-plans.raw");
    let n = 256;
    std::fs::write(&path, vec![77u8; n * n * n]).unwrap();
    let options = mcvr::volume::RawOptions {
        dims: Some([n; 3]),
        voxel_type: Some(mcvr::volume::VoxelType::U8),
        ..Default::default()
    };
    let volume = mcvr::volume::load(path.to_str().unwrap(), Some(&options)).unwrap().volume;
    assert!(volume.voxels().is_mapped());
    let scenery = scene_of(volume, DensityMap::default(), &View { fov: Some(5.0), ..View::default() });
    let plain = scenery.clone();
    let scenery = scenery.with_effects(all_effects());
    let loaded = resident("unread-by-plans.raw");
    assert!(loaded < (n * n * n) as u64 / 4, "{loaded} bytes are read already");
    for method in Method::ALL {
        // Footprints are of plain images.
        let scenery = if method == Method::Footprint { &plain } else { &scenery };
        planned(scenery, &Request { method, samples: 1 << 12, ..Request::default() });
    }
    assert_eq!(resident("unread-by-plans.raw"), loaded);
    made(&scenery, &Request { samples: 1 << 12, ..Request::default() });
    assert!(resident("unread-by-plans.raw") > loaded + (n * n * n) as u64 / 2, "the test can fail");
}

#[test]
fn without_culling_a_zoomed_render_is_the_projection_of_a_cloud() {
    use mcvr::sampling::{ProjectOptions, project_cloud};
    let volume = ball();
    for (name, camera) in views(&volume) {
        let scenery = Scenery::new(volume.clone(), DensityMap::default(), camera);
        for method in [Method::Mc, Method::Stratified, Method::Qmc] {
            let request =
                Request { method, samples: 1 << 14, order: VoxelOrder::Hilbert, cull: false, ..Request::default() };
            let rendered = made(&scenery, &request);
            if rendered.counters["render"]["inside"] == 0 || rendered.counters["precision"] != "f32" {
                continue;
            }
            let (cloud, _) = mcvr::draw_cloud(&scenery.volume, &scenery.map, &request, &Watch::default()).unwrap();
            let options = ProjectOptions { estimand: request.estimand, ..ProjectOptions::default() };
            let projected = project_cloud(&cloud, &scenery.camera, &options, &Watch::default()).unwrap();
            assert_eq!(rendered.image, projected.image, "{name}, {method}");
            if name == "close-up" {
                let culled = made(&scenery, &Request { cull: true, ..request });
                assert_ne!(culled.image, rendered.image, "{method}: culling draws other points");
            }
        }
    }
}

#[test]
fn a_skewed_volume_of_floats_is_planned_as_well() {
    let voxels: Vec<f32> = common::speckle().into_iter().map(|v| 1.01 * f32::from(v)).collect();
    let scenery = scene_of(skewed(voxels), DensityMap::default(), &common::pinhole()).with_effects(all_effects());
    for method in SAMPLERS {
        hold("floats", &scenery, &Request { method, samples: samples(method), ..Request::default() });
    }
}
