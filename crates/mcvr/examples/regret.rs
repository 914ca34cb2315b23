//! What `--method auto` costs beside the best fixed method: every scan of a folder, three views, four errors.
//!
//! `cargo run --release -p mcvr --example regret -- DATA_DIR [--markdown FILE] [--json FILE] [--rounds 7] [--only PART]`; `phantoms`
//! in place of a folder takes the program's own phantoms, on which the constants of the choice and of adaptive rays were
//! found (the example `bends` has part of them). `SHARE` and `DOUBT` of adaptive rays were first set beside some scans (lobster, CT head, chest, statue)
//! and not changed since.
//!
//! For each scan and view a truth is cast (rays through 8 by 8 places of every pixel, exact in depth, averaged), then every fixed
//! setting of the methods `comb`, `rays`, `march`, `footprint` and `qmc` is made. Of those that reach an error, the quickest are made again, in
//! turn with the choice, so that what else the machine does meets all alike. The regret is the choice's median time
//! over that of the quickest fixed setting; both begin with the volume's weights and its map of empty bricks at
//! hand, which all images of it share, and end with the image. A choice that misses its error is counted, whatever its time.

mod phantoms;

use std::io::Write;
use std::path::{Path, PathBuf};

use mcvr::harness::Comparison;
use mcvr::scene::{Camera, Density, DensityMap, Extent, Hounsfield, Image, Transfer, View, Watch};
use mcvr::{Adaptive, Method, Request, Scenery, make_of};
use phantoms::{PHANTOMS, VIEWS};
use serde_json::{Value, json};

const ERRORS: [f64; 4] = [0.1, 0.03, 0.01, 0.003];
const STEPS: [f64; 9] = [1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 20.0];
/// Errors that fixed settings of adaptive rays leave between the rays.
const LEFT: [f64; 4] = [0.07, 0.02, 0.007, 0.002];

type Failure = Box<dyn std::error::Error>;

struct Measured {
    name: String,
    request: Request,
    error: f64,
    seconds: f64,
}

/// The quickest fixed setting that reaches an error.
struct Best<'a> {
    name: &'a str,
    error: f64,
    seconds: f64,
}

/// Seconds beyond which an image is made once only for its error.
const LONG: f64 = 0.05;

/// Fixed settings that are timed in turn with the choice: the quickest by a first look, at most this many, none that took `NEAR` times as
/// long as the first.
const SHORT_LIST: usize = 8;
const NEAR: f64 = 1.6;

/// Fixed settings: rays a pixel or pixels a ray, or adaptive rays, distances, samples.
fn settings(pixels: u64) -> Vec<(String, Request)> {
    let base = Request::default();
    let mut all = vec![];
    let of_pixels = (1..=4).map(|n| (format!("{n}x{n} rays"), n * n * pixels));
    let of_blocks = (2..=4).map(|n| (format!("a ray for {n}x{n}"), pixels.div_ceil(n * n)));
    for (name, samples) in of_pixels.chain(of_blocks) {
        all.push((format!("rays, {name}"), Request { method: Method::Rays, samples, ..base }));
        for step in STEPS {
            let request = Request { method: Method::Comb, samples, step, ..base };
            all.push((format!("comb {step}, {name}"), request));
        }
    }
    for left in LEFT {
        let base = Request { adaptive: Some(Adaptive::leaving(left)), ..base };
        let name = format!("leaving {:.1} %", 100.0 * left);
        all.push((format!("rays {name}"), Request { method: Method::Rays, ..base }));
        for step in STEPS {
            all.push((format!("comb {step} {name}"), Request { method: Method::Comb, step, ..base }));
        }
    }
    for n in 1..=3u64 {
        let request = Request { method: Method::March, samples: n * n * pixels, ..base };
        all.push((format!("march {n}x{n}"), request));
    }
    all.push(("footprint".to_owned(), Request { method: Method::Footprint, ..base }));
    for m in 18..=24 {
        all.push((format!("qmc 2^{m}"), Request { method: Method::Qmc, samples: 1 << m, ..base }));
    }
    all
}

/// Error and quickest time of two images; of one where that takes long.
fn measure(
    (density, scenery): (&Density, &Scenery),
    request: &Request,
    truth: &Image,
) -> Result<(f64, f64, Value), Failure> {
    let made = make_of(density, scenery, request, &Watch::default())?;
    let mut seconds = made.seconds.complete;
    if seconds < LONG {
        seconds = make_of(density, scenery, request, &Watch::default())?.seconds.complete.min(seconds);
    }
    // Every image of a request is the same.
    let error = Comparison::of(&made.image, truth)?.rel_rmse.unwrap_or(f64::NAN);
    Ok((error, seconds, json!(made.choice.map(|c| c.chosen))))
}

/// Median times of several requests, made in turn.
fn in_turn(
    (density, scenery): (&Density, &Scenery),
    requests: &[&Request],
    rounds: usize,
) -> Result<Vec<f64>, Failure> {
    let mut times = vec![vec![]; requests.len()];
    for _ in 0..rounds {
        for (request, times) in requests.iter().zip(&mut times) {
            times.push(make_of(density, scenery, request, &Watch::default())?.seconds.complete);
        }
    }
    let median = |times: &mut Vec<f64>| {
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    };
    Ok(times.iter_mut().map(median).collect())
}

fn scans(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(folder)?.map(|e| Ok(e?.path())).collect::<Result<_, Failure>>()?;
    all.retain(|p| {
        let name = p.to_string_lossy();
        !name.ends_with(".md") && !name.ends_with(".tar.gz")
    });
    all.sort();
    Ok(all)
}

/// The density map that fits a scan: Hounsfield units become attenuation.
fn map_for(name: &str) -> Result<DensityMap, Failure> {
    let hounsfield = name.contains("_hu_") || name.contains("abdomen");
    let transfer = if hounsfield { Transfer::Hounsfield(Hounsfield::of_water(0.02)?) } else { Transfer::Identity };
    Ok(DensityMap { transfer, ..DensityMap::default() })
}

fn main() -> Result<(), Failure> {
    mcvr::keep_freed_memory();
    let mut args = std::env::args().skip(1);
    let usage = "usage: regret DATA_DIR [--markdown FILE] [--json FILE] [--rounds N] [--only PART]";
    let folder = PathBuf::from(args.next().ok_or(usage)?);
    let (mut markdown, mut records, mut rounds, mut only) = (None, None, 7, None);
    while let Some(flag) = args.next() {
        let value = args.next().ok_or(usage)?;
        match &flag[..] {
            "--markdown" => markdown = Some(PathBuf::from(value)),
            "--json" => records = Some(PathBuf::from(value)),
            "--rounds" => rounds = value.parse::<usize>()?.max(1),
            "--only" => only = Some(value),
            _ => return Err(usage.into()),
        }
    }
    let extent = Extent::new(400, 400)?;
    let mut rows = vec![];
    let inputs: Vec<String> = if folder.as_os_str() == "phantoms" {
        PHANTOMS.iter().map(|p| (*p).to_owned()).collect()
    } else {
        scans(&folder)?.iter().map(|p| p.to_string_lossy().into_owned()).collect()
    };
    for input in inputs.iter().filter(|i| only.as_ref().is_none_or(|o| i.contains(&o[..]))) {
        let name = input.rsplit(['/', ':']).next().unwrap_or("scan").split('_').next().unwrap_or("scan").to_owned();
        let volume = mcvr::volume::load(input, None)?.volume;
        let map = map_for(input)?;
        let density = Density::new(&volume, map.clone())?;
        for [azimuth, elevation] in VIEWS {
            let view = View { azimuth, elevation, ..View::default() };
            let camera = Camera::look(&view, volume.grid(), extent)?;
            let scenery = Scenery::new(volume.clone(), map.clone(), camera);
            let pixels = extent.pixels() as u64;
            let exact = Request { method: Method::Rays, samples: 64 * pixels, ..Request::default() };
            let truth = make_of(&density, &scenery, &exact, &Watch::default())?.image;
            let of = (&density, &scenery);
            let mut fixed = vec![];
            for (name, request) in settings(pixels) {
                let (error, seconds, _) = measure(of, &request, &truth)?;
                fixed.push(Measured { name, request, error, seconds });
            }
            for f in fixed.iter().filter(|f| f.name == "footprint") {
                eprintln!(
                    "{name:<12} {azimuth:>4},{elevation:<4} footprint: {:.4} s, {:.3} %",
                    f.seconds,
                    100.0 * f.error
                );
            }
            for target in ERRORS {
                let request = Request { method: Method::Auto, error: target, ..Request::default() };
                let (error, _, choice) = measure(of, &request, &truth)?;
                let mut list: Vec<&Measured> = fixed.iter().filter(|m| m.error <= target).collect();
                list.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
                let quickest = list.first().map_or(0.0, |m| m.seconds);
                list.retain(|m| m.seconds <= NEAR * quickest);
                list.truncate(SHORT_LIST);
                let requests: Vec<&Request> = list.iter().map(|m| &m.request).chain([&request]).collect();
                let mut times = in_turn(of, &requests, rounds)?;
                let seconds = times.pop().unwrap_or(f64::NAN);
                let timed = list.iter().zip(times).map(|(m, seconds)| Best { name: &m.name, error: m.error, seconds });
                let best = timed.min_by(|a, b| a.seconds.total_cmp(&b.seconds));
                let regret = best.as_ref().map(|b| seconds / b.seconds);
                eprintln!(
                    "{name:<12} {azimuth:>4},{elevation:<4} {:>5} %: auto {:.4} s, {:.3} %; best {} {:.4} s, {:.3} %; regret {:.2}",
                    100.0 * target,
                    seconds,
                    100.0 * error,
                    best.as_ref().map_or("-", |b| b.name),
                    best.as_ref().map_or(f64::NAN, |b| b.seconds),
                    best.as_ref().map_or(f64::NAN, |b| 100.0 * b.error),
                    regret.unwrap_or(f64::NAN)
                );
                rows.push(json!({
                    "scan": name, "view": [azimuth, elevation], "target": target, "seconds": seconds, "error": error,
                    "choice": choice, "best": best.as_ref().map(|b| b.name), "best_seconds": best.as_ref().map(|b| b.seconds),
                    "best_error": best.as_ref().map(|b| b.error), "regret": regret,
                    "threads": rayon::current_num_threads(),
                }));
            }
        }
    }
    let text = table(&rows);
    print!("{text}");
    if let Some(path) = markdown {
        mcvr::volume::write_whole(&path, |out| out.write_all(text.as_bytes()))?;
    }
    if let Some(path) = records {
        let lines: String = rows.iter().map(|r| format!("{r}\n")).collect();
        mcvr::volume::write_whole(&path, |out| out.write_all(lines.as_bytes()))?;
    }
    Ok(())
}

fn table(rows: &[Value]) -> String {
    let mut out = format!(
        "# What the choice of method costs\n\nTime of `--method auto` over that of the quickest fixed setting that reaches the error, of {} settings; both with the volume's weights and its map of empty bricks at hand; 400x400 pixels.\n\n\
         | error | cases | regret: median | 90 % | worst | missed the error | worst miss |\n| ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n",
        settings(1).len()
    );
    let line = |label: String, of: &dyn Fn(&Value) -> bool| {
        let chosen: Vec<&Value> = rows.iter().filter(|r| of(r)).collect();
        let mut regrets: Vec<f64> = chosen.iter().filter_map(|r| r["regret"].as_f64()).collect();
        regrets.sort_by(f64::total_cmp);
        let at = |share: f64| {
            regrets.get(((regrets.len() as f64 - 1.0) * share).round() as usize).copied().unwrap_or(f64::NAN)
        };
        let over = |r: &&&Value| r["error"].as_f64().unwrap_or(0.0) / r["target"].as_f64().unwrap_or(1.0);
        let missed = chosen.iter().filter(|r| over(r) > 1.0).count();
        let worst = chosen.iter().map(|r| over(&r)).fold(0.0, f64::max);
        format!(
            "| {label} | {} | {:.2} | {:.2} | {:.2} | {missed} | {:.2} times the error |\n",
            chosen.len(),
            at(0.5),
            at(0.9),
            at(1.0),
            worst
        )
    };
    for target in ERRORS {
        out += &line(format!("{} %", 100.0 * target), &|r| r["target"] == target);
    }
    out += &line("all".into(), &|_| true);
    out += "\n| scan | view | error | auto | seconds | error reached | best fixed | seconds | regret |\n| --- | --- | ---: | --- | ---: | ---: | --- | ---: | ---: |\n";
    for r in rows {
        let number = |key: &str, scale: f64, digits: usize| {
            r[key].as_f64().map_or("-".into(), |v| format!("{:.digits$}", v * scale))
        };
        let c = &r["choice"];
        let left = c["adaptive"]["left"].as_f64();
        let adaptive = left.map_or(String::new(), |left| format!(", adaptive, leaving {:.2} %", 100.0 * left));
        out += &format!(
            "| {} | {} | {} % | {} {} {:.2}{adaptive} | {} | {} % | {} | {} | {} |\n",
            r["scan"].as_str().unwrap_or(""),
            r["view"],
            100.0 * r["target"].as_f64().unwrap_or(0.0),
            c["method"].as_str().unwrap_or(""),
            c["samples"],
            c["step"].as_f64().unwrap_or(0.0),
            number("seconds", 1.0, 4),
            number("error", 100.0, 3),
            r["best"].as_str().unwrap_or("-"),
            number("best_seconds", 1.0, 4),
            number("regret", 1.0, 2)
        );
    }
    out
}
