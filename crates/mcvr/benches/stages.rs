//! Time per element of each stage. Run `cargo bench -p mcvr`; add `-- --quick` for a short run, or `-- render/` for the stages whose
//! names hold a word.
//!
//! The stages are those of `mcvr bench`, which holds their ratios to a committed baseline; here criterion gives the seconds, with
//! throughput in elements (voxels, samples, points, steps, cells, rays). Each runs on one thread, so figures are per core. The ray
//! caster's own benches (`cargo bench -p mcvr-raycast`) look at a larger volume.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mcvr::bench::{ANCHOR, on_one_thread, stages};

fn every_stage(c: &mut Criterion) {
    for stage in stages().expect("the effects are valid").iter().filter(|s| !s.name.starts_with(ANCHOR)) {
        let (group, what) = stage.name.split_once('/').unwrap_or(("stage", &stage.name));
        let mut group = c.benchmark_group(group);
        group.sample_size(10);
        let mut prepared = stage.prepare().expect("the stage's scene is valid");
        group.throughput(Throughput::Elements(prepared.elements));
        group.bench_function(what, |b| {
            on_one_thread(|| b.iter(|| prepared.run().expect("the stage runs"))).expect("a thread");
        });
        group.finish();
    }
}

criterion_group!(benches, every_stage);
criterion_main!(benches);
