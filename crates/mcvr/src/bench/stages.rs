//! The list of stages. Criterion (`cargo bench -p mcvr`) and `mcvr bench` run the same one.
//!
//! What the public API keeps apart is a stage of its own. Finding a sample's voxel and adding it to the film are not:
//! `cloud/project-*` is projection and accumulation of points that are there already, `render/*` is everything.

use mcvr_mc::{OrderStatistics, Quicksorted, Stratified};
use mcvr_qmc::{Scramble, SobolNet};
use mcvr_raycast::{
    Counters, Integrator, MarchOptions, RayOptions, ReferenceOptions, march, march_with_look, reference,
    reference_with_look,
};
use mcvr_sampling::{
    Distribution, PointBlock, PointStream, ProjectOptions, Provenance, RenderOptions, VoxelOrder, block_count,
    block_len, project_cloud, render, render_look, sample,
};
use mcvr_scene::{Camera, Effects, Estimand, Extent, Kernel, View, Watch};

use super::anchors;
use super::error::BenchError;
use super::scenes::{Scene, dense, effects, lobster};
use super::stage::{Prepared, Stage};
use crate::{Method, Request, Scenery, make};

/// What the names of the anchors begin with.
pub const ANCHOR: &str = "anchor/";

/// Samples of a stage that draws or renders: some milliseconds.
const SAMPLES: u64 = 1 << 18;
/// Kernels that a ray caster knows.
const SEPARABLE: [Kernel; 3] = [Kernel::Box, Kernel::Tent, Kernel::Bspline3];

/// Every stage, the anchors first.
///
/// # Errors
/// [`BenchError::Setup`] when an effect cannot be made.
pub fn stages() -> Result<Vec<Stage>, BenchError> {
    let mut all = anchors::stages();
    let orders = [VoxelOrder::Raster, VoxelOrder::Hilbert, VoxelOrder::YInnermost, VoxelOrder::ZInnermost];
    all.extend(orders.map(distribution));
    all.push(Stage::new("distribution/in-view", "voxel", in_view));
    all.extend(DRAWN.map(draw));
    for kernel in Kernel::ALL {
        all.extend(Estimand::ALL.map(|estimand| rendering(kernel, estimand)));
    }
    all.extend(effects()?.into_iter().map(|(name, effects)| effect(name, effects)));
    all.push(Stage::new("cloud/sample", "point", cloud_sample));
    all.extend(Estimand::ALL.map(cloud_project));
    all.extend(SEPARABLE.map(marching));
    all.extend(SEPARABLE.map(cells));
    all.push(Stage::new("exact/plain", "ray", exact));
    let shaded = effects()?.swap_remove(0).1;
    all.push(Stage::new("march/shading", "step", {
        let shaded = shaded.clone();
        move || marching_shaded(&shaded)
    }));
    all.push(Stage::new("exact/shading", "ray", move || exact_shaded(&shaded)));
    all.extend(Method::ALL.into_iter().filter(|m| *m != Method::Exact).map(image));
    Ok(all)
}

fn distribution(order: VoxelOrder) -> Stage {
    Stage::new(format!("distribution/{}", order.name()), "voxel", move || {
        let density = &lobster()?.density;
        let work = move || Ok(Distribution::new(density, order)?.total());
        let repeats = if order == VoxelOrder::Raster { 24 } else { 8 };
        Ok(Prepared::new(density.report().voxels, repeats, work))
    })
}

/// Bricks that the camera cannot see are left out: a narrow camera, half of them.
fn in_view() -> Result<Prepared, BenchError> {
    let Scene { volume, density, .. } = lobster()?;
    let view = View { azimuth: 30.0, fov: Some(8.0), ..View::default() };
    let camera = Camera::look(&view, volume.grid(), Extent::new(64, 64)?)?;
    let work = move || Ok(Distribution::in_view(density, VoxelOrder::Raster, &camera, Kernel::Tent)?.total());
    Ok(Prepared::new(density.report().voxels, 16, work))
}

type Stream = Box<dyn PointStream + Send>;
type Drawn = (&'static str, fn() -> Stream, u64);

/// Points by name; the last number is how often they are drawn in a run.
const DRAWN: [Drawn; 5] = [
    ("mc", || Box::new(OrderStatistics::new(SAMPLES, 1)), 4),
    ("mc-quicksort", || Box::new(Quicksorted::new(SAMPLES / 4, 1, TOTAL)), 2),
    ("stratified", || Box::new(Stratified::new(SAMPLES, 1)), 4),
    ("qmc", || Box::new(SobolNet::new(SAMPLES, 1, Scramble::Linear)), 8),
    ("qmc-owen", || Box::new(SobolNet::new(SAMPLES, 1, Scramble::Owen)), 2),
];
/// Sum of weights that points are drawn for.
const TOTAL: u64 = 1 << 40;

/// Making the stream, then all its blocks.
fn draw((name, stream, repeats): Drawn) -> Stage {
    Stage::new(format!("draw/{name}"), "point", move || {
        let mut block = PointBlock::default();
        let samples = stream().samples();
        let work = move || {
            let stream = stream();
            let mut sum = 0u64;
            for number in 0..block_count(samples) {
                block.resize(block_len(samples, number));
                stream.fill(number, TOTAL, &mut block);
                sum = sum.wrapping_add(block.targets[0]).wrapping_add(u64::from(block.uniforms[2][0]));
            }
            Ok(sum)
        };
        Ok(Prepared::new(samples, repeats, work))
    })
}

fn net() -> SobolNet {
    SobolNet::new(SAMPLES, 1, Scramble::Linear)
}

/// Draw, find, project and add, by kernel and estimand.
fn rendering(kernel: Kernel, estimand: Estimand) -> Stage {
    Stage::new(format!("render/{kernel}-{estimand}"), "sample", move || {
        let Scene { density, camera, .. } = lobster()?;
        let distribution = Distribution::new(density, VoxelOrder::Raster)?;
        let (net, options) = (net(), RenderOptions { kernel, estimand, ..RenderOptions::default() });
        let work = move || Ok(render(&distribution, &net, camera, &options, &Watch::default())?.counters.inside);
        Ok(Prepared::new(SAMPLES, 1, work))
    })
}

/// The same under an effect.
fn effect(name: &str, effects: Effects) -> Stage {
    Stage::new(format!("effect/{name}"), "sample", move || {
        let Scene { volume, density, camera } = lobster()?;
        let distribution = Distribution::new(density, VoxelOrder::Raster)?;
        let look = effects.look(volume.grid(), camera)?;
        let (net, options) = (net(), RenderOptions::default());
        let work =
            move || Ok(render_look(&distribution, &net, camera, &look, &options, &Watch::default())?.counters.inside);
        Ok(Prepared::new(SAMPLES, 1, work))
    })
}

fn cloud_sample() -> Result<Prepared, BenchError> {
    let distribution = Distribution::new(&lobster()?.density, VoxelOrder::Raster)?;
    let net = net();
    let work =
        move || Ok(sample(&distribution, &net, Kernel::Tent, Provenance::default(), &Watch::default())?.1.voxels_read);
    Ok(Prepared::new(SAMPLES, 1, work))
}

/// Projection and accumulation alone.
fn cloud_project(estimand: Estimand) -> Stage {
    Stage::new(format!("cloud/project-{estimand}"), "point", move || {
        let Scene { density, camera, .. } = lobster()?;
        let distribution = Distribution::new(density, VoxelOrder::Raster)?;
        let (cloud, _) = sample(&distribution, &net(), Kernel::Tent, Provenance::default(), &Watch::default())?;
        let options = ProjectOptions { estimand, ..ProjectOptions::default() };
        let work = move || Ok(project_cloud(&cloud, camera, &options, &Watch::default())?.counters.inside);
        Ok(Prepared::new(SAMPLES, 6, work))
    })
}

fn marching(kernel: Kernel) -> Stage {
    Stage::new(format!("march/{kernel}"), "step", move || {
        let Scene { density, camera, .. } = dense()?;
        let options = MarchOptions::from(RayOptions { kernel, ..RayOptions::default() });
        let run = move || Ok(march(density, camera, &options, &Watch::default())?.counters.evaluations);
        Ok(Prepared::new(run()?, if kernel == Kernel::Bspline3 { 1 } else { 6 }, run))
    })
}

fn marching_shaded(effects: &Effects) -> Result<Prepared, BenchError> {
    let Scene { volume, density, camera } = dense()?;
    let look = effects.look(volume.grid(), camera)?;
    let options = MarchOptions::default();
    let run = move || Ok(march_with_look(density, camera, &look, &options, &Watch::default())?.counters.evaluations);
    Ok(Prepared::new(run()?, 1, run))
}

/// One ray through every pixel's centre, exact in every cell.
fn cells(kernel: Kernel) -> Stage {
    Stage::new(format!("cells/{kernel}"), "cell", move || {
        let Scene { density, camera, .. } = dense()?;
        let field = Integrator::new(density, kernel)?;
        let run = move || {
            let (rays, mut counters) = (field.view(camera, Estimand::Line), Counters::default());
            let extent = camera.extent();
            let mut sum = 0.0;
            for y in 0..extent.height {
                for x in 0..extent.width {
                    sum += rays.integrate(x as f64 + 0.5, y as f64 + 0.5, &mut counters);
                }
            }
            std::hint::black_box(sum);
            Ok(counters.cells)
        };
        Ok(Prepared::new(run()?, if kernel == Kernel::Bspline3 { 1 } else { 4 }, run))
    })
}

/// The adaptive reference.
fn exact() -> Result<Prepared, BenchError> {
    let Scene { density, camera, .. } = dense()?;
    let options = ReferenceOptions { tolerance: 0.1, max_depth: 2, ..ReferenceOptions::default() };
    let run = move || Ok(reference(density, camera, &options, &Watch::default())?.counters.rays);
    Ok(Prepared::new(run()?, 1, run))
}

/// The gradient makes the integrand no polynomial: some thousand times a plain ray, so few pixels.
fn exact_shaded(effects: &Effects) -> Result<Prepared, BenchError> {
    let Scene { volume, density, .. } = dense()?;
    let camera = Camera::look(&View::default(), volume.grid(), Extent::new(4, 4)?)?;
    let look = effects.look(volume.grid(), &camera)?;
    let options = ReferenceOptions { tolerance: 0.3, max_depth: 1, ..ReferenceOptions::default() };
    let run = move || Ok(reference_with_look(density, &camera, &look, &options, &Watch::default())?.counters.rays);
    Ok(Prepared::new(run()?, 1, run))
}

/// A complete image, from the volume in memory to linear pixels.
fn image(method: Method) -> Stage {
    let (samples, repeats, unit) = match method {
        Method::McLinear => (1 << 6, 1, "sample"),
        Method::McBinary | Method::McQuicksort => (SAMPLES / 16, 1, "sample"),
        Method::March => (200 * 200, 1, "ray"),
        _ => (SAMPLES, 1, "sample"),
    };
    Stage::new(format!("image/{method}"), unit, move || {
        let Scene { volume, camera, .. } = lobster()?;
        let scenery = Scenery::new(volume.clone(), Default::default(), camera.clone());
        let request = Request { method, samples, ..Request::default() };
        let work = move || Ok(make(&scenery, &request, &Watch::default())?.samples);
        Ok(Prepared::new(samples, repeats, work))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn names_are_unique_and_there_are_four_anchors() {
        let stages = stages().unwrap();
        let names: HashSet<&str> = stages.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names.len(), stages.len());
        assert_eq!(names.iter().filter(|n| n.starts_with(ANCHOR)).count(), 4);
        assert!(
            names.iter().all(|n| n.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || "/-".contains(c)))
        );
    }

    #[test]
    fn a_stage_does_the_same_work_every_time() {
        for stage in stages().unwrap().iter().filter(|s| !s.name.starts_with(ANCHOR) && s.name != "exact/plain") {
            let mut prepared = stage.prepare().unwrap();
            let [a, b] = [prepared.run().unwrap(), prepared.run().unwrap()];
            assert!(a == b && a > 0 && prepared.elements > 0, "{}: {a}, then {b}", stage.name);
        }
    }
}
