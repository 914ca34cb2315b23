//! Nanoseconds per cell of the exact walk and per step of the march, on a dense generated volume (so that empty
//! bricks help nobody). Criterion's element rate is cells or steps per second on one thread.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use mcvr_raycast::{Counters, Integrator, MarchOptions, RayOptions, Watch, march};
use mcvr_scene::{Camera, Density, DensityMap, Estimand, Extent, Kernel, View};
use mcvr_volume::Phantom;

fn scene(side: usize) -> Result<(Density, Camera), Box<dyn std::error::Error>> {
    let volume = Phantom::parse("marschner-lobb@128")?.generate()?;
    let camera = Camera::look(&View::default(), volume.grid(), Extent::new(side, side)?)?;
    Ok((Density::new(&volume, DensityMap::default())?, camera))
}

/// One ray through every pixel's centre.
fn image(field: &Integrator, camera: &Camera, estimand: Estimand, counters: &mut Counters) -> f64 {
    let rays = field.view(camera, estimand);
    let mut sum = 0.0;
    for y in 0..camera.extent().height {
        for x in 0..camera.extent().width {
            sum += rays.integrate(x as f64 + 0.5, y as f64 + 0.5, counters);
        }
    }
    sum
}

fn walk(c: &mut Criterion) {
    let (density, camera) = scene(48).expect("the phantom and the view are valid");
    let mut group = c.benchmark_group("cells");
    group.sample_size(10);
    for kernel in [Kernel::Box, Kernel::Tent, Kernel::Bspline3] {
        let field = Integrator::new(&density, kernel).expect("a separable kernel");
        for estimand in Estimand::ALL {
            let mut counters = Counters::default();
            image(&field, &camera, estimand, &mut counters);
            group.throughput(Throughput::Elements(counters.cells));
            group.bench_function(BenchmarkId::new(kernel.name(), estimand), |b| {
                b.iter(|| image(&field, &camera, estimand, &mut Counters::default()));
            });
        }
    }
}

fn steps(c: &mut Criterion) {
    let (density, camera) = scene(96).expect("the phantom and the view are valid");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool of one thread");
    let mut group = c.benchmark_group("march");
    group.sample_size(10);
    for kernel in [Kernel::Box, Kernel::Tent, Kernel::Bspline3] {
        let options = MarchOptions::from(RayOptions { kernel, ..RayOptions::default() });
        let run = || march(&density, &camera, &options, &Watch::default()).expect("valid options");
        group.throughput(Throughput::Elements(run().counters.evaluations));
        group.bench_function(kernel.name(), |b| b.iter(|| pool.install(run)));
    }
}

criterion_group!(benches, walk, steps);
criterion_main!(benches);
