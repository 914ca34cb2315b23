//! The hot loops, each as the library runs it.

use std::sync::Arc;

use mcvr::mc::OrderStatistics;
use mcvr::qmc::{Scramble, SobolNet};
use mcvr::sampling::{
    Cloud, Distribution, PointBlock, PointStream, ProjectOptions, Provenance, RenderOptions, VoxelOrder, block_count,
    block_len, project_cloud, render, sample,
};
use mcvr::scene::{Camera, Density, DensityMap, Estimand, Extent, Kernel, View, Watch};
use mcvr::volume::{self, Endian, RawOptions, VoxelType};
use rayon::prelude::*;

use crate::limits::{LARGE, READ, SMALL};
use crate::options::Options;
use crate::{Entry, Outcome};

/// The scan, its file, its extents and spacing (mm).
const SCAN: (&str, [usize; 3], [f64; 3]) = ("lobster_301x324x56_uint8.raw.gz", [301, 324, 56], [1.0, 1.0, 1.4]);
/// Sides of the images.
const SIDES: [(usize, &str); 2] = [(400, SMALL), (4096, LARGE)];

/// The density and how it is seen.
pub struct Scene {
    density: Density,
    name: String,
    cameras: Vec<Camera>,
}

/// What is made of it once.
pub struct Parts<'a> {
    distribution: Distribution<'a>,
    /// Of 12 bytes a point, and compact.
    clouds: [Cloud; 2],
}

type Stream = Arc<dyn PointStream + Send>;

impl Scene {
    pub fn load(options: &Options) -> Outcome<Self> {
        let (file, dims, spacing) = SCAN;
        let scan = options.data.as_ref().map(|d| d.join(file));
        let loaded = match &scan {
            Some(path) => {
                let raw = RawOptions {
                    dims: Some(dims),
                    voxel_type: Some(VoxelType::U8),
                    endian: Some(Endian::Little),
                    spacing: Some(spacing),
                    ..RawOptions::default()
                };
                volume::load(&path.to_string_lossy(), Some(&raw))?
            }
            None => volume::load(&format!("phantom:lobster@{}", options.phantom), None)?,
        };
        let density = Density::new(&loaded.volume, DensityMap::default())?;
        let view = View { azimuth: 30.0, elevation: 60.0, ..View::default() };
        let camera = |(side, _): (usize, _)| Camera::look(&view, loaded.volume.grid(), Extent::new(side, side)?);
        let cameras = SIDES.into_iter().map(camera).collect::<Result<_, _>>()?;
        let name = if scan.is_some() { file.to_owned() } else { loaded.volume.name().to_owned() };
        Ok(Self { density, name, cameras })
    }

    pub fn parts(&self, samples: u64) -> Outcome<Parts<'_>> {
        let order = VoxelOrder::Depth.resolve(&self.cameras[0], self.density.volume().grid());
        let distribution = Distribution::new(&self.density, order)?;
        let net = SobolNet::new(samples, 1, Scramble::Linear);
        let cloud = sample(&distribution, &net, Kernel::Tent, Provenance::default(), &Watch::default())?.0;
        let compact = cloud.compacted()?;
        Ok(Parts { distribution, clouds: [cloud, compact] })
    }

    pub fn described(&self) -> String {
        let [x, y, z] = self.density.volume().grid().dims();
        format!("{}, {x}×{y}×{z} voxels", self.name)
    }
}

/// All rows of one number of threads.
pub fn entries<'a>(
    scene: &'a Scene,
    parts: &'a Parts<'a>,
    options: &Options,
    threads: usize,
) -> Outcome<Vec<Entry<'a>>> {
    let samples = options.samples;
    let streams: [(&str, Stream); 2] = [
        ("qmc", Arc::new(SobolNet::new(samples, 1, Scramble::Linear))),
        ("mc", Arc::new(OrderStatistics::new(samples, 1))),
    ];
    let small: [(&str, Stream); 1] = [("qmc, 2^20", Arc::new(SobolNet::new(1 << 20, 1, Scramble::Linear)))];
    let mut all = vec![distribution(scene, threads)];
    for (name, stream) in &streams {
        all.push(drawing(name, stream.clone(), threads));
    }
    all.push(sampling(parts, streams[0].1.clone(), threads));
    for (camera, (side, limit)) in scene.cameras.iter().zip(SIDES) {
        for estimand in Estimand::ALL {
            for (name, stream) in streams.iter().chain(&small) {
                let title = format!("generate and project, {name}, {estimand}, {side}×{side}");
                all.push(rendering(title, parts, stream.clone(), camera, estimand, limit, threads));
            }
            for compact in [false, true] {
                let kind = if compact { "a compact cloud" } else { "a cloud" };
                let title = format!("project {kind}, {estimand}, {side}×{side}");
                all.push(projecting(title, &parts.clouds[usize::from(compact)], camera, estimand, limit, threads));
            }
        }
    }
    Ok(all)
}

fn distribution(scene: &Scene, threads: usize) -> Entry<'_> {
    let voxels = scene.density.report().voxels;
    let work = move || {
        std::hint::black_box(Distribution::new(&scene.density, VoxelOrder::Raster)?.total());
        Ok(voxels)
    };
    let bytes = scene.density.volume().bytes() as f64 / voxels as f64;
    let limit = Some((READ, bytes));
    Entry { name: "distribution".into(), unit: "voxel", threads, limit, work: Box::new(work) }
}

/// The points of a stream, block by block, into the same memory.
fn drawing<'a>(name: &str, stream: Stream, threads: usize) -> Entry<'a> {
    let work = move || {
        let samples = stream.samples();
        let sum: u64 = (0..block_count(samples))
            .into_par_iter()
            .map_init(PointBlock::default, |block, number| {
                block.resize(block_len(samples, number));
                stream.fill(number, 1 << 40, block);
                block.targets[0] ^ u64::from(block.uniforms[2][0])
            })
            .reduce(|| 0, u64::wrapping_add);
        std::hint::black_box(sum);
        Ok(samples)
    };
    Entry { name: format!("draw, {name}"), unit: "point", threads, limit: None, work: Box::new(work) }
}

/// Draw, locate, place and keep.
fn sampling<'a>(parts: &'a Parts<'a>, stream: Stream, threads: usize) -> Entry<'a> {
    let work = move || {
        let cloud = sample(&parts.distribution, &*stream, Kernel::Tent, Provenance::default(), &Watch::default())?.0;
        Ok(std::hint::black_box(cloud).samples())
    };
    Entry { name: "draw a cloud, qmc".into(), unit: "point", threads, limit: None, work: Box::new(work) }
}

fn rendering<'a>(
    name: String,
    parts: &'a Parts<'a>,
    stream: Stream,
    camera: &'a Camera,
    estimand: Estimand,
    limit: &'static str,
    threads: usize,
) -> Entry<'a> {
    let work = move || {
        let options = RenderOptions { estimand, ..RenderOptions::default() };
        let rendered = render(&parts.distribution, &*stream, camera, &options, &Watch::default())?;
        Ok(rendered.counters.samples)
    };
    Entry { name, unit: "point", threads, limit: Some((limit, 1.0)), work: Box::new(work) }
}

fn projecting<'a>(
    name: String,
    cloud: &'a Cloud,
    camera: &'a Camera,
    estimand: Estimand,
    limit: &'static str,
    threads: usize,
) -> Entry<'a> {
    let work = move || {
        let options = ProjectOptions { estimand, ..ProjectOptions::default() };
        Ok(project_cloud(cloud, camera, &options, &Watch::default())?.counters.samples)
    };
    Entry { name, unit: "point", threads, limit: Some((limit, 1.0)), work: Box::new(work) }
}
