//! Time per sample of each stage and method. Run `cargo bench -p mcvr`; add `-- --quick` for a short run.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use mcvr::mc::{OrderStatistics, Stratified};
use mcvr::qmc::{Scramble, SobolNet};
use mcvr::sampling::{
    Distribution, PointBlock, PointStream, ProjectOptions, Provenance, RenderOptions, VoxelOrder, block_count,
    block_len, project_cloud, render, sample,
};
use mcvr::scene::{Camera, Density, DensityMap, Estimand, Extent, Kernel, View, Watch};

const SAMPLES: u64 = 1 << 22;

fn scene() -> (Density, Camera) {
    let volume = mcvr::volume::load("phantom:lobster@256x256x128", None).expect("a phantom").volume;
    let camera =
        Camera::look(&View::default(), volume.grid(), Extent::new(400, 400).expect("a size")).expect("a camera");
    (Density::new(&volume, DensityMap::default()).expect("a density"), camera)
}

/// Everything on one thread, so that figures are per core.
fn on_one_thread(f: impl FnOnce() + Send) {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool").install(f);
}

/// Projection of a kept cloud, by estimand.
fn cloud(c: &mut Criterion) {
    let (density, camera) = scene();
    let mut group = c.benchmark_group("cloud");
    group.throughput(Throughput::Elements(SAMPLES)).sample_size(10);
    let distribution = Distribution::new(&density, VoxelOrder::Raster).expect("a distribution");
    let net = SobolNet::new(SAMPLES, 1, Scramble::Linear);
    let draw = || sample(&distribution, &net, Kernel::Tent, Provenance::default(), &Watch::default());
    group.bench_function("sample-tent", |b| on_one_thread(|| b.iter(|| draw().expect("a cloud").1)));
    let (points, _) = draw().expect("a cloud");
    for estimand in Estimand::ALL {
        let options = ProjectOptions { estimand, ..ProjectOptions::default() };
        let project = || project_cloud(&points, &camera, &options, &Watch::default()).expect("an image").counters;
        group.bench_function(format!("project-{estimand}"), |b| on_one_thread(|| b.iter(project)));
    }
    group.finish();
}

fn streams() -> Vec<(&'static str, Box<dyn PointStream + Send>)> {
    vec![
        ("mc", Box::new(OrderStatistics::new(SAMPLES, 1))),
        ("stratified", Box::new(Stratified::new(SAMPLES, 1))),
        ("qmc", Box::new(SobolNet::new(SAMPLES, 1, Scramble::Linear))),
        ("qmc-owen", Box::new(SobolNet::new(SAMPLES, 1, Scramble::Owen))),
    ]
}

fn distribution(c: &mut Criterion) {
    let (density, _) = scene();
    let mut group = c.benchmark_group("distribution");
    group.throughput(Throughput::Elements(density.report().voxels));
    for (name, order) in
        [("raster", VoxelOrder::Raster), ("hilbert", VoxelOrder::Hilbert), ("z", VoxelOrder::ZInnermost)]
    {
        group.bench_function(name, |b| {
            on_one_thread(|| b.iter(|| Distribution::new(black_box(&density), order).expect("a distribution").total()));
        });
    }
    group.finish();
}

fn points(c: &mut Criterion) {
    let mut group = c.benchmark_group("points");
    group.throughput(Throughput::Elements(SAMPLES));
    for (name, stream) in streams() {
        group.bench_function(name, |b| {
            let mut out = PointBlock::default();
            b.iter(|| {
                for block in 0..block_count(SAMPLES) {
                    out.resize(block_len(SAMPLES, block));
                    stream.fill(block, 1 << 40, &mut out);
                    black_box(&out);
                }
            });
        });
    }
    group.finish();
}

fn image(c: &mut Criterion) {
    let (density, camera) = scene();
    let mut group = c.benchmark_group("image");
    group.throughput(Throughput::Elements(SAMPLES)).sample_size(10);
    let order = VoxelOrder::Depth.resolve(&camera, density.volume().grid());
    let distribution = Distribution::new(&density, order).expect("a distribution");
    let mut run = |id: BenchmarkId, stream: &(dyn PointStream + Send), options: RenderOptions| {
        group.bench_function(id, |b| {
            on_one_thread(|| {
                b.iter(|| {
                    render(&distribution, stream, &camera, &options, &Watch::default()).expect("an image").counters
                });
            });
        });
    };
    let options = |kernel, estimand| RenderOptions { kernel, estimand, ..RenderOptions::default() };
    // The plain net comes with every kernel and estimand below.
    for (name, stream) in streams().into_iter().filter(|(name, _)| *name != "qmc") {
        run(BenchmarkId::new(name, "box-count"), &*stream, options(Kernel::Box, Estimand::Count));
    }
    let net = SobolNet::new(SAMPLES, 1, Scramble::Linear);
    for kernel in Kernel::ALL {
        for estimand in Estimand::ALL {
            run(BenchmarkId::new("qmc", format!("{kernel}-{estimand}")), &net, options(kernel, estimand));
        }
    }
    group.finish();
}

criterion_group!(benches, distribution, points, image, cloud);
criterion_main!(benches);
