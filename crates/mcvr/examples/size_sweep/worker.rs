//! One file, one number of threads: every phase, several times.

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use mcvr::qmc::{Scramble, SobolNet};
use mcvr::sampling::{Distribution, RenderOptions, VoxelOrder, render};
use mcvr::scene::{Camera, Density, DensityMap, Extent, Hounsfield, Kernel, Transfer, View, Watch};
use mcvr::volume::{Volume, load, with_voxels};
use mcvr::{Method, Request, Scenery, make};
use serde_json::{Map, Value, json};

use crate::Outcome;

/// Bytes that the read bandwidth is measured on: far beyond what a core's own caches hold.
const READ: usize = 1 << 29;

/// Seconds of wall time and of all processors, of each repeat.
struct Times {
    wall: Vec<f64>,
    cpu: Vec<f64>,
}

fn cpu_seconds() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    t.tv_sec as f64 + t.tv_nsec as f64 * 1e-9
}

fn timed<T>(repeats: usize, mut work: impl FnMut() -> Outcome<T>) -> Outcome<Times> {
    let mut times = Times { wall: vec![], cpu: vec![] };
    for _ in 0..repeats {
        let (wall, cpu) = (Instant::now(), cpu_seconds());
        let made = black_box(work()?);
        times.wall.push(wall.elapsed().as_secs_f64());
        times.cpu.push(cpu_seconds() - cpu);
        drop(made);
    }
    Ok(times)
}

impl Times {
    fn record(mut self) -> Value {
        self.wall.sort_by(f64::total_cmp);
        let n = self.wall.len();
        let least = self.cpu.iter().copied().fold(f64::INFINITY, f64::min);
        json!({ "median": self.wall[n / 2], "least": self.wall[0], "most": self.wall[n - 1], "cpu": least })
    }
}

/// Bytes of this process's memory, its own or that of files mapped into it, that are in memory (Linux; else 0).
fn resident(kind: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix(kind));
    let kib = line.and_then(|l| l.split_whitespace().next()?.parse::<u64>().ok());
    1024 * kib.unwrap_or(0)
}

/// Bytes of its own.
fn own() -> u64 {
    resident("RssAnon:")
}

/// The same volume, in memory of this process.
fn held(volume: Volume) -> Outcome<Volume> {
    let (grid, name) = (volume.grid().clone(), volume.name().to_owned());
    Ok(with_voxels!(volume.voxels(), v => Volume::from_vec(grid, v.to_vec(), name))?)
}

/// Seconds to read [`READ`] bytes of memory once, in order, by all threads.
fn reading(repeats: usize) -> Outcome<Value> {
    use rayon::prelude::*;
    let words = vec![1u64; READ / size_of::<u64>()];
    let sum = || words.par_chunks(1 << 16).map(|c| c.iter().fold(0u64, |a, b| a.wrapping_add(*b))).sum::<u64>();
    Ok(timed(repeats.max(5), || Ok(sum()))?.record())
}

fn maps() -> Outcome<[(&'static str, DensityMap); 3]> {
    let of = |transfer| DensityMap { transfer, ..DensityMap::default() };
    Ok([
        ("identity", of(Transfer::Identity)),
        ("linear", of(Transfer::Linear { slope: 0.37, intercept: 1.25 })),
        ("hounsfield", of(Transfer::Hounsfield(Hounsfield::at_energy(60.0, Hounsfield::SCAN_KEV)?))),
    ])
}

/// Views along x, y and z: voxels are drawn with that axis innermost.
fn cameras(volume: &Volume) -> Outcome<Vec<(VoxelOrder, Camera)>> {
    let mut cameras = vec![];
    for (azimuth, elevation) in [(10.0, 5.0), (80.0, 5.0), (10.0, 80.0)] {
        let view = View { azimuth, elevation, ..View::default() };
        let camera = Camera::look(&view, volume.grid(), Extent::new(400, 400)?)?;
        cameras.push((VoxelOrder::Depth.resolve(&camera, volume.grid()), camera));
    }
    Ok(cameras)
}

pub fn measure(path: &Path, heap: bool, threads: usize, repeats: usize) -> Outcome<Value> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build()?.install(|| phases(path, heap, repeats))
}

fn phases(path: &Path, heap: bool, repeats: usize) -> Outcome<Value> {
    let mut out = Map::new();
    let name = path.to_str().ok_or("the folder's name is not Unicode")?;
    out.insert("read".into(), json!({ "bytes": READ, "seconds": reading(repeats)? }));
    let open = || Ok(load(name, None)?.volume);
    out.insert("load".into(), timed(repeats, open)?.record());
    let volume = if heap { held(open()?)? } else { open()? };
    out.insert("bytes".into(), json!(volume.bytes()));
    out.insert("mapped".into(), json!(volume.voxels().is_mapped()));
    // Pages of a map are brought in by the first pass.
    let scan = |map: &DensityMap| Ok(Density::new(&volume, map.clone())?);
    out.insert("first pass".into(), timed(1, || scan(&DensityMap::default()))?.record());
    let cameras = cameras(&volume)?;
    for (name, map) in maps()? {
        out.insert(format!("density, {name}"), timed(repeats, || scan(&map))?.record());
        let density = scan(&map)?;
        for (order, _) in &cameras {
            let build = || Ok(Distribution::new(&density, *order)?);
            out.insert(format!("distribution, {name}, {}", order.name()), timed(repeats, build)?.record());
        }
    }
    out.insert("own, before".into(), json!(own()));
    let density = scan(&DensityMap::default())?;
    out.insert("own, density".into(), json!(own()));
    for (order, camera) in &cameras {
        let distribution = Distribution::in_view(&density, *order, camera, Kernel::Tent)?;
        out.insert(format!("own, distribution, {}", order.name()), json!(own()));
        out.insert("distribution bytes".into(), json!(distribution.counters().bytes));
        for log in [20, 24] {
            let stream = SobolNet::new(1 << log, 1, Scramble::default());
            let image =
                || Ok(render(&distribution, &stream, camera, &RenderOptions::default(), &Watch::default())?.image);
            out.insert(format!("image, 2^{log}, {}", order.name()), timed(repeats, image)?.record());
            out.insert(format!("own, image, 2^{log}, {}", order.name()), json!(own()));
        }
    }
    let scenery = Scenery::new(volume.clone(), DensityMap::default(), cameras[0].1.clone());
    let request = Request { method: Method::March, samples: 400 * 400, ..Request::default() };
    out.insert("march".into(), timed(repeats.min(3), || Ok(make(&scenery, &request, &Watch::default())?))?.record());
    out.insert("own, march".into(), json!(own()));
    out.insert("of files".into(), json!(resident("RssFile:")));
    Ok(Value::Object(out))
}
