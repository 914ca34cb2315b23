//! Point clouds: the image of `render` from kept points, files that lose nothing, damaged files refused.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

mod common;

use std::path::Path;
use std::process::{Command, Output};

use common::*;
use mcvr::sampling::{
    BLOCK, Cloud, Distribution, Precision, ProjectOptions, Provenance, RenderOptions, SimdLevel, VoxelOrder,
    project_cloud, render, sample,
};
use mcvr::scene::{Camera, DensityMap, Estimand, Extent, Kernel, View, Watch};
use mcvr::volume::Grid;
use mcvr::{Method, Request, draw_cloud, is_cloud, read_cloud, write_cloud, write_ply};

const SAMPLES: u64 = 9 * BLOCK as u64 + 77;

fn on_threads<R: Send>(threads: usize, work: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

fn views() -> [View; 2] {
    let diameter = skewed_grid().diameter();
    [
        View { fov: Some(38.0), near: Some(0.9 * diameter), ..pinhole() },
        View { azimuth: 200.0, elevation: -35.0, parallel: true, ..View::default() },
    ]
}

fn drawn(samples: u64) -> Cloud {
    let scenery = speckled_scene(&pinhole());
    let request = Request { samples, order: VoxelOrder::Raster, ..Request::default() };
    draw_cloud(&scenery.volume, &DensityMap::default(), &request, &Watch::default()).unwrap().0
}

#[test]
fn a_projected_cloud_is_the_rendered_image_bit_for_bit() {
    let scenery = speckled_scene(&pinhole());
    let density = density(&scenery);
    let distribution = Distribution::new(&density, VoxelOrder::Hilbert).unwrap();
    let watch = Watch::default();
    for method in [Method::Mc, Method::Stratified, Method::Qmc] {
        let stream = stream(method, SAMPLES, 5, distribution.total());
        for kernel in Kernel::ALL {
            let draw = |threads| {
                on_threads(threads, || sample(&distribution, &*stream, kernel, Provenance::default(), &watch))
            };
            let (cloud, _) = draw(1).unwrap();
            assert_eq!(cloud, draw(5).unwrap().0, "{method} {kernel}");
            for view in views() {
                let camera = Camera::look(&view, scenery.volume.grid(), Extent::new(57, 43).unwrap()).unwrap();
                for estimand in Estimand::ALL {
                    let options = RenderOptions { estimand, kernel, ..RenderOptions::default() };
                    let whole = render(&distribution, &*stream, &camera, &options, &watch).unwrap();
                    assert_eq!(whole.precision, Precision::F32);
                    for (threads, simd) in [1, 3].into_iter().zip([None, Some(SimdLevel::Portable)]) {
                        let options = ProjectOptions { estimand, simd, ..ProjectOptions::default() };
                        let kept = on_threads(threads, || project_cloud(&cloud, &camera, &options, &watch)).unwrap();
                        assert_eq!(kept.image, whole.image, "{method} {kernel} {estimand}");
                        let c = kept.counters;
                        assert_eq!(c.inside + c.outside + c.clipped, SAMPLES);
                        assert_eq!(
                            [c.inside, c.outside, c.clipped, c.line_weights],
                            [
                                whole.counters.inside,
                                whole.counters.outside,
                                whole.counters.clipped,
                                whole.counters.line_weights
                            ]
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn in_64_bits_a_cloud_differs_only_by_the_rounding_of_its_positions() {
    let cloud = drawn(SAMPLES);
    let camera = Camera::look(&views()[1], cloud.grid(), Extent::new(57, 43).unwrap()).unwrap();
    let image = |precision| {
        let options = ProjectOptions { precision: Some(precision), ..ProjectOptions::default() };
        project_cloud(&cloud, &camera, &options, &Watch::default()).unwrap().image
    };
    let (single, double) = (image(Precision::F32), image(Precision::F64));
    let apart: f64 = single.difference(&double).unwrap().values().iter().map(|d| d.abs()).sum();
    assert!(apart < 1e-3 * double.sum(), "{apart}");
}

#[test]
fn a_native_file_gives_the_same_cloud_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcvr");
    let cloud = drawn(20_001);
    write_cloud(&cloud, &path).unwrap();
    assert!(is_cloud(&path));
    let again = read_cloud(&path).unwrap();
    assert_eq!(cloud, again);
    assert_eq!(cloud.mass().to_bits(), again.mass().to_bits());
}

#[test]
fn damaged_native_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcvr");
    write_cloud(&drawn(3), &path).unwrap();
    let good = std::fs::read(&path).unwrap();
    let refused = |bytes: &[u8], what: &str| {
        std::fs::write(&path, bytes).unwrap();
        read_cloud(&path).expect_err(what).to_string()
    };
    for n in 0..good.len() {
        refused(&good[..n], "cut");
    }
    refused(&[&good[..], &[0]].concat(), "too long");
    for byte in 0..8 {
        let mut bad = good.clone();
        bad[byte] ^= 1;
        assert!(refused(&bad, "magic").contains("no point cloud"));
    }
    let mut bad = good.clone();
    bad[8] = 3;
    assert!(refused(&bad, "version").contains("version 3"));
    bad[8] = 2;
    assert!(refused(&bad, "version").contains("bricks and side"));
    bad = good.clone();
    bad[12..16].fill(255);
    assert!(refused(&bad, "header length").contains("4294967295"));
    // Headers that promise what is not there.
    let length = u32::from_le_bytes(good[12..16].try_into().unwrap()) as usize;
    let header: serde_json::Value = serde_json::from_slice(&good[16..16 + length]).unwrap();
    let with = |key: &str, value: serde_json::Value| {
        let mut header = header.clone();
        header[key] = value;
        let text = serde_json::to_vec(&header).unwrap();
        [&good[..12], &(text.len() as u32).to_le_bytes(), &text, &good[16 + length..]].concat()
    };
    for samples in [0, 2, 4, 1 << 40, u64::MAX / 12 + 1, u64::MAX] {
        refused(&with("samples", samples.into()), "count");
    }
    for (key, value) in [
        ("mass", serde_json::json!(-1.0)),
        ("mass", serde_json::json!(null)),
        ("dims", serde_json::json!([0, 1, 1])),
        ("dims", serde_json::json!([1, 1, 1])),
        ("dims", serde_json::json!([1u64 << 40, 1u64 << 40, 1])),
        ("spacing", serde_json::json!([0.0, 1.0, 1.0])),
        ("kernel", serde_json::json!("gauss")),
        ("surprise", serde_json::json!(1)),
    ] {
        refused(&with(key, value.clone()), &format!("{key} {value}"));
    }
    for value in [f32::NAN, f32::INFINITY, -1e9] {
        let mut bad = good.clone();
        let at = bad.len() - 4;
        bad[at..].copy_from_slice(&value.to_le_bytes());
        assert!(refused(&bad, "position").contains("position"));
    }
}

/// Points are the same up to the error that the cloud states, so an image differs by what crosses pixels' edges: with points of even
/// density, of those in a pixel of side s voxels a share of about 2 error / s along each of its axes.
#[test]
fn a_compact_cloud_gives_the_image_of_points_that_hardly_moved() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcvr");
    let cloud = drawn(200_000);
    let compact = cloud.compacted().unwrap();
    let error = compact.compact().unwrap().error();
    assert!(compact.bytes() < cloud.bytes() * 6 / 10 && error <= 1.0 / 2048.0);
    assert_eq!(compact.compacted().unwrap(), compact);
    write_cloud(&compact, &path).unwrap();
    assert!(std::fs::metadata(&path).unwrap().len() < 7 * cloud.samples());
    assert_eq!(read_cloud(&path).unwrap(), compact);
    for view in views() {
        let camera = Camera::look(&view, cloud.grid(), Extent::new(57, 43).unwrap()).unwrap();
        for estimand in Estimand::ALL {
            let image = |cloud: &Cloud, threads, simd| {
                let options = ProjectOptions { estimand, simd, ..ProjectOptions::default() };
                on_threads(threads, || project_cloud(cloud, &camera, &options, &Watch::default())).unwrap()
            };
            let (exact, near) = (image(&cloud, 2, None), image(&compact, 1, None));
            assert_eq!(near.image, image(&compact, 3, Some(SimdLevel::Portable)).image);
            assert_eq!(near.counters.samples, 200_000);
            let apart: f64 = exact.image.difference(&near.image).unwrap().values().iter().map(|d| d.abs()).sum();
            // A voxel is no more than 6 pixels wide here, so 4 edges of a pixel pass by at most 24 errors of points on either side.
            assert!(apart > 0.0 && apart <= 48.0 * error * exact.image.sum(), "{apart} {}", exact.image.sum());
        }
    }
}

#[test]
fn damaged_compact_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcvr");
    let grid = Grid::with_spacing([90, 40, 20], [1.0; 3]).unwrap();
    let axis = |k: usize, n: f32| (0..3000).map(|i| (i * k % 997) as f32 / 997.0 * n - n / 2.0).collect();
    let positions = [axis(7, 88.0), axis(31, 38.0), axis(113, 18.0)];
    let compact = Cloud::new(grid, Kernel::Tent, 1.5, positions, Provenance::default()).unwrap().compacted().unwrap();
    let bricks = compact.compact().unwrap().bricks().len();
    assert!(bricks > 1);
    write_cloud(&compact, &path).unwrap();
    let good = std::fs::read(&path).unwrap();
    let refused = |bytes: &[u8], what: &str| {
        std::fs::write(&path, bytes).unwrap();
        read_cloud(&path).expect_err(what).to_string()
    };
    let length = u32::from_le_bytes(good[12..16].try_into().unwrap()) as usize;
    let start = 16 + length;
    for n in (0..start + 16 * bricks + 8).chain([good.len() - 1]) {
        refused(&good[..n], "cut");
    }
    refused(&[&good[..], &[0]].concat(), "too long");
    let mut old = good.clone();
    old[8] = 1;
    assert!(refused(&old, "version").contains("version 1"));
    let with = |at: usize, value: u32| {
        let mut bad = good.clone();
        bad[at..at + 4].copy_from_slice(&value.to_le_bytes());
        bad
    };
    // A brick far away, one without points, points that are not there, bricks in disorder.
    assert!(refused(&with(start + 16 * (bricks - 1) + 8, u32::MAX), "far").contains("axis 2"));
    assert!(refused(&with(start + 12, 0), "empty").contains("no points"));
    assert!(refused(&with(start + 12, u32::MAX), "many").contains("three"));
    assert!(refused(&with(start + 8, 1 << 20), "order").contains("does not follow"));
    let header: serde_json::Value = serde_json::from_slice(&good[16..start]).unwrap();
    for (key, value) in [
        ("side", serde_json::json!(0)),
        ("side", serde_json::json!(48)),
        ("side", serde_json::json!(null)),
        ("bricks", serde_json::json!(0)),
        ("bricks", serde_json::json!(u64::MAX)),
        ("bricks", serde_json::json!(null)),
        ("samples", serde_json::json!(u64::MAX / 6 + 1)),
        ("dims", serde_json::json!([1, 1, 1])),
        ("dims", serde_json::json!([1u64 << 30, 1, 1])),
    ] {
        let mut header = header.clone();
        header[key] = value.clone();
        let text = serde_json::to_vec(&header).unwrap();
        let bytes = [&good[..12], &(text.len() as u32).to_le_bytes(), &text, &good[start..]].concat();
        refused(&bytes, &format!("{key} {value}"));
    }
}

#[test]
fn a_ply_holds_every_point_in_world_millimetres() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let cloud = drawn(1001);
    write_ply(&cloud, &path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let header = std::str::from_utf8(&bytes[..start]).unwrap();
    for line in
        ["ply\nformat binary_little_endian 1.0\n", "element vertex 1001\n", "comment seed 1\n", "comment kernel tent\n"]
    {
        assert!(header.contains(line), "{header}");
    }
    assert!(header.contains("property float x\nproperty float y\nproperty float z\nend_header"));
    let values: Vec<f32> = bytes[start..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(bytes.len() - start, 12 * 1001);
    let corners = cloud.grid().corners(1.0);
    for (i, point) in values.chunks_exact(3).enumerate() {
        for axis in 0..3 {
            let [low, high] = [f64::min, f64::max].map(|f| corners.iter().map(|c| c[axis]).reduce(f).unwrap());
            let value = f64::from(point[axis]);
            assert!((low - 1e-3..=high + 1e-3).contains(&value), "{i}: {value} in {low}..{high}");
            assert!((value - cloud.world(i)[axis]).abs() <= 1e-6 * value.abs().max(1.0));
        }
    }
}

#[test]
fn a_cloud_has_no_depth_order_and_rays_have_no_points() {
    let scenery = speckled_scene(&pinhole());
    let draw = |request: Request| {
        draw_cloud(&scenery.volume, &DensityMap::default(), &request, &Watch::default()).unwrap_err().to_string()
    };
    assert!(draw(Request::default()).contains("raster"));
    let rays = Request { method: Method::March, order: VoxelOrder::Raster, ..Request::default() };
    assert!(draw(rays).contains("march"));
}

fn mcvr(folder: &Path, args: &[&str]) -> Output {
    let out = Command::new(env!("CARGO_BIN_EXE_mcvr")).current_dir(folder).args(args).output().unwrap();
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    out
}

#[test]
fn sample_and_project_write_the_file_that_render_writes() {
    let folder = tempfile::tempdir().unwrap();
    let draw = ["phantom:vessels@24", "-n", "20000", "--method", "mc", "--seed", "7", "--kernel", "bspline3"];
    let view = ["--view", "100,-10", "--size", "33x21", "--quiet"];
    let at = folder.path();
    let record = mcvr(at, &[&["sample"], &draw[..], &["-o", "c.mcvr", "-o", "c.ply", "--json", "-"]].concat()).stdout;
    let record: serde_json::Value = serde_json::from_slice(&record).unwrap();
    assert_eq!((&record["samples"], &record["points"]["seed"]), (&20000.into(), &7.into()));
    let record = mcvr(at, &[&["project", "c.mcvr", "-o", "a.npy", "--json", "-"], &view[..]].concat()).stdout;
    let record: serde_json::Value = serde_json::from_slice(&record).unwrap();
    assert_eq!(record["precision"], "f32");
    mcvr(at, &[&["render"], &draw[..], &view, &["--order", "raster", "-o", "b.npy"]].concat());
    let bytes = |name: &str| std::fs::read(at.join(name)).unwrap();
    assert_eq!(bytes("a.npy"), bytes("b.npy"));
    assert!(bytes("c.ply").len() > 12 * 20000);
    let record =
        mcvr(at, &[&["sample"], &draw[..], &["--compact", "-o", "d.mcvr", "-o", "d.ply", "--json", "-"]].concat())
            .stdout;
    let record: serde_json::Value = serde_json::from_slice(&record).unwrap();
    assert_eq!(record["compact"]["side"], 16);
    assert_eq!(bytes("c.ply"), bytes("d.ply"));
    assert!(bytes("d.mcvr").len() < bytes("c.mcvr").len() * 6 / 10);
    mcvr(at, &[&["project", "d.mcvr", "-o", "e.npy"], &view[..]].concat());
    assert_eq!(bytes("e.npy").len(), bytes("a.npy").len());
    mcvr(at, &["orbit", "d.mcvr", "--frames", "2", "--size", "20x16", "-o", "turned"]);
}

#[test]
fn an_orbit_writes_its_frames_from_a_volume_and_from_a_cloud() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let common = ["--frames", "5", "--size", "20x16"];
    mcvr(at, &[&["orbit", "phantom:box@12", "-n", "2^12", "-o", "frames"], &common[..]].concat());
    let mut names: Vec<_> = std::fs::read_dir(at.join("frames")).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["0000.png", "0001.png", "0002.png", "0003.png", "0004.png"]);
    mcvr(at, &["sample", "phantom:box@12", "-n", "2^12", "-o", "c.mcvr"]);
    mcvr(at, &[&["orbit", "c.mcvr", "-o", "again"], &common[..]].concat());
    for name in names {
        let read = |from: &str| std::fs::read(at.join(from).join(&name)).unwrap();
        assert_eq!(read("frames"), read("again"));
    }
    mcvr(at, &[&["orbit", "c.mcvr", "-o", "turn.png"], &common[..]].concat());
    let png = std::fs::read(at.join("turn.png")).unwrap();
    let control = png.windows(4).position(|w| w == b"acTL").unwrap() + 4;
    assert_eq!(u32::from_be_bytes(png[control..control + 4].try_into().unwrap()), 5);
    assert_eq!(png.windows(4).filter(|w| w == b"fcTL").count(), 5);

    mcvr(at, &[&["orbit", "c.mcvr", "-o", "turn.gif", "--rate", "10"], &common[..]].concat());
    let mut options = gif::DecodeOptions::new();
    options.set_color_output(gif::ColorOutput::RGBA);
    let mut reader = options.read_info(std::fs::File::open(at.join("turn.gif")).unwrap()).unwrap();
    assert_eq!((reader.width(), reader.height()), (20, 16));
    let mut shown = vec![];
    while let Some(frame) = reader.read_next_frame().unwrap() {
        assert_eq!((frame.width, frame.height, frame.delay), (20, 16, 10));
        shown.push(frame.buffer.iter().step_by(4).copied().collect::<Vec<u8>>());
    }
    assert_eq!((shown.len(), reader.repeat()), (5, gif::Repeat::Infinite));
    for (number, greys) in shown.iter().enumerate() {
        let still = mcvr::scene::film::read(&at.join(format!("frames/{number:04}.png"))).unwrap();
        let still: Vec<u8> = still.values().iter().map(|v| (255.0 * v).round() as u8).collect();
        assert_eq!(*greys, still, "frame {number}: the grey levels of the PNG");
    }
    for bad in [&["--rate", "60"][..], &["--deep"], &["--size", "70000x2"]] {
        let args = [&["orbit", "c.mcvr", "-o", "no.gif"], bad].concat();
        let out = Command::new(env!("CARGO_BIN_EXE_mcvr")).current_dir(at).args(&args).output().unwrap();
        assert_eq!(out.status.code(), Some(1), "{args:?}");
        assert!(String::from_utf8_lossy(&out.stderr).contains(bad[0]) && !at.join("no.gif").exists());
    }
}
