//! The report's shaded figure, the memory that shading takes, and where gradients should come from.

use std::process::Command;
use std::time::Instant;

use mcvr::qmc::{Scramble, SobolNet};
use mcvr::sampling::{Distribution, GradientSource, RenderOptions, VoxelOrder, render_look};
use mcvr::scene::effects::{Shading, Sides};
use mcvr::scene::{Density, DensityMap, Effects, Kernel, Watch};
use mcvr::volume::Volume;
use mcvr::{Method, Request, Scenery, make};
use serde_json::{Value, json};

use crate::scenes::{self, HEAD, LOBSTER};
use crate::timing::{median, on_threads, thread_counts};
use crate::{Options, Outcome};

/// The report's number of samples.
const MILLION: u64 = 1_000_000;
/// Timed images of the report's figure.
const ROUNDS: usize = 9;
/// Pixels of a side, as everywhere in the results.
const SIDE: usize = 400;

fn shaded() -> Effects {
    let light = scenes::around(80.0, 60.0, None);
    Effects { light, shading: Some(Shading { sides: Sides::One }), ..Effects::default() }
}

fn lobster(volume: &Volume, effects: Effects) -> Outcome<Scenery> {
    let camera = scenes::camera(volume, scenes::VIEW, None, SIDE)?;
    Ok(Scenery::new(volume.clone(), scenes::piecewise(&scenes::NO_RESIN, None), camera).with_effects(effects))
}

/// One million samples, plain and shaded, loading excluded and included.
pub fn million(options: &Options) -> Outcome<Value> {
    let volume = LOBSTER.load(&options.data)?;
    let sceneries = [lobster(&volume, Effects::default())?, lobster(&volume, shaded())?];
    let mut rows = vec![];
    for threads in thread_counts() {
        for method in [Method::Mc, Method::Qmc] {
            let request = Request { method, samples: MILLION, ..Request::default() };
            let measured = on_threads(threads, || -> Outcome<[Vec<[f64; 4]>; 2]> {
                let mut measured = [vec![], vec![]];
                for round in 0..=ROUNDS {
                    for (scenery, times) in sceneries.iter().zip(&mut measured) {
                        let start = Instant::now();
                        let loaded = LOBSTER.load(&options.data)?;
                        let load = start.elapsed().as_secs_f64();
                        drop(loaded);
                        let s = make(scenery, &request, &Watch::default())?.seconds;
                        if round > 0 {
                            times.push([s.sampling, s.sampling + s.projection, s.complete, load + s.complete]);
                        }
                    }
                }
                Ok(measured)
            })??;
            for (name, times) in ["plain", "shaded"].iter().zip(&measured) {
                let at = |n: usize| median(times.iter().map(|t| t[n]).collect());
                let [sampling, drawing, complete, loaded] = [0, 1, 2, 3].map(at);
                println!("one million, {threads} threads, {method}, {name}: {complete:.4} s");
                rows.push(json!({
                    "threads": threads, "method": method, "image": name, "sampling": sampling, "sampling_and_projection": drawing,
                    "complete": complete, "with_loading": loaded,
                }));
            }
        }
    }
    Ok(json!({ "rows": rows, "rounds": ROUNDS, "samples": MILLION, "side": SIDE }))
}

/// Peak memory of whole programs that render the CT head at ten million samples.
pub fn memory(options: &Options) -> Outcome<Value> {
    if !options.program.exists() {
        return Err(format!("{} is missing; build it or name it by --program", options.program.display()).into());
    }
    let volume = HEAD.load(&options.data)?;
    let voxels = volume.grid().len() as u64;
    let samples = if options.quick { 1_000_000u64 } else { 10_000_000 };
    let record = std::env::temp_dir().join(format!("effects-table-{}.json", std::process::id()));
    let image = record.with_extension("npy");
    let mut rows = vec![];
    for (name, extra) in [("plain", vec![]), ("shaded", vec!["--shade", "one", "--light", "around:80,30"])] {
        let mut command = Command::new(&options.program);
        command.arg("render").arg(options.data.join(HEAD.file)).args(HEAD.arguments()).args(extra);
        command
            .args(["--view", "30,20", "-q", "-n", &samples.to_string(), "--json"])
            .arg(&record)
            .arg("-o")
            .arg(&image);
        let output = command.output()?;
        if !output.status.success() {
            return Err(String::from_utf8_lossy(&output.stderr).into_owned().into());
        }
        let told: Value = serde_json::from_str(&std::fs::read_to_string(&record)?)?;
        println!("memory, {name}: {}", told["peak_memory_bytes"]);
        rows.push(json!({ "image": name, "peak_memory_bytes": told["peak_memory_bytes"] }));
    }
    // Leftovers in a folder for temporary files do no harm.
    let _ = (std::fs::remove_file(&record), std::fs::remove_file(&image));
    Ok(json!({ "rows": rows, "voxels": voxels, "samples": samples, "volume_bytes": voxels * 2 }))
}

/// Expected share of the voxels that independent samples draw at least once.
fn hit(density: &Density, samples: u64) -> f64 {
    let n = density.volume().grid().len();
    let total = density.report().weight_sum;
    let one = |v| -(samples as f64 * (-density.weight(v) / total).ln_1p()).exp_m1();
    (0..n).map(one).sum::<f64>() / n as f64
}

/// Lazy against stored gradients.
pub fn gradients(options: &Options) -> Outcome<Value> {
    let top = if options.quick { 20 } else { 25 };
    let mut rows = vec![];
    let no_resin = scenes::piecewise(&scenes::NO_RESIN, None);
    let scans = [("lobster", LOBSTER, scenes::VIEW, no_resin), ("head", HEAD, [30.0, 20.0], DensityMap::default())];
    for (name, scan, view, map) in scans {
        let volume = scan.load(&options.data)?;
        let camera = scenes::camera(&volume, view, None, SIDE)?;
        let density = Density::new(&volume, map)?;
        let look = shaded().look(volume.grid(), &camera)?;
        let order = VoxelOrder::default().resolve(&camera, volume.grid());
        let distribution = Distribution::in_view(&density, order, &camera, Kernel::Tent)?;
        for level in (18..=top).step_by(if options.quick { 2 } else { 1 }) {
            let net = SobolNet::new(1 << level, 1, Scramble::default());
            let mut times = [vec![], vec![]];
            let mut field = 0;
            for round in 0..=3 {
                for (n, gradients) in [GradientSource::Lazy, GradientSource::Stored].into_iter().enumerate() {
                    let render = RenderOptions { gradients, ..RenderOptions::default() };
                    let start = Instant::now();
                    let made = render_look(&distribution, &net, &camera, &look, &render, &Watch::default())?;
                    if round > 0 {
                        times[n].push(start.elapsed().as_secs_f64());
                    }
                    field = field.max(made.counters.gradient_field);
                }
            }
            let [lazy, stored] = times.map(median);
            println!("{name}, 2^{level}: lazy {lazy:.4} s, stored {stored:.4} s");
            rows.push(json!({
                "scan": name, "level": level, "lazy": lazy, "stored": stored, "lazy_bytes": 0, "stored_bytes": 12 * field,
                "voxels_hit": hit(&density, 1 << level),
            }));
        }
    }
    Ok(json!({ "rows": rows, "threads": rayon::current_num_threads(), "side": SIDE }))
}
