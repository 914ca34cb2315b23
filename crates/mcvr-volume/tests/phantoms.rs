//! What each phantom promises.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which clippy does not take for tests")]

use glam::DVec3;
use mcvr_volume::*;

fn phantom(spec: &str) -> Volume {
    Phantom::parse(spec).unwrap().generate().unwrap()
}

fn mass(v: &Volume) -> f64 {
    Summary::of(v).mean * v.grid().len() as f64 * v.grid().voxel_volume()
}

#[test]
fn every_phantom_is_centred_and_256_mm_long_at_any_size() {
    for (name, about) in Phantom::names() {
        assert!(!about.is_empty());
        for size in ["32", "20x40x10", "1", "7x1x3"] {
            let v = phantom(&format!("{name}@{size}"));
            assert!(v.grid().centre().length() < 1e-9, "{name}@{size}");
            assert!((v.grid().size_mm().max_element() - 256.0).abs() < 1e-9, "{name}@{size}");
        }
        assert_eq!(Phantom::parse(name).unwrap().dims(), [128; 3]);
    }
}

#[test]
fn generation_does_not_depend_on_the_number_of_threads() {
    for (name, _) in Phantom::names() {
        let spec = format!("{name}@33x30x28");
        let on = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| phantom(&spec));
        let (a, b) = (on(1), on(5));
        assert!((0..a.grid().len()).all(|n| a.isovalue(n).to_bits() == b.isovalue(n).to_bits()), "{name}");
    }
}

#[test]
fn the_box_has_the_mass_of_its_volume_at_every_size() {
    for size in ["16", "40", "20x40x10"] {
        let v = phantom(&format!("box@{size}"));
        let expected = 100.0 * v.grid().size_mm().element_product();
        assert!((mass(&v) / expected - 1.0).abs() < 1e-12, "{size}");
    }
}

#[test]
fn the_ramp_is_the_x_index_and_the_voxel_is_one() {
    let v = phantom("ramp@300x3x2");
    assert!((0..v.grid().len()).all(|n| v.isovalue(n) == v.grid().unravel(n)[0] as f64));
    assert!(Phantom::parse("ramp@65537x1x1").is_err());
    let v = phantom("voxel@9x8x7");
    let on: Vec<usize> = (0..v.grid().len()).filter(|&n| v.isovalue(n) != 0.0).collect();
    assert_eq!(on, [v.grid().linear([4, 4, 3])]);
    assert_eq!(v.isovalue(on[0]), 255.0);
}

#[test]
fn the_gaussian_has_the_mass_of_its_integral() {
    let v = phantom("gaussian@64x48x32");
    let sigma = v.grid().size_mm() * 0.1;
    let expected = (2.0 * std::f64::consts::PI).powf(1.5) * sigma.element_product();
    assert!((mass(&v) / expected - 1.0).abs() < 1e-5);
}

#[test]
fn sums_of_ellipsoids_have_the_mass_and_the_line_integrals_of_their_formulas() {
    for (name, tolerance) in [("shepp-logan", 2e-3), ("ellipsoids", 2e-3)] {
        let p = Phantom::parse(&format!("{name}@96")).unwrap();
        let (v, ellipsoids) = (p.generate().unwrap(), p.ellipsoids().unwrap());
        let expected: f64 = ellipsoids.iter().map(Ellipsoid::mass).sum();
        assert!((mass(&v) / expected - 1.0).abs() < tolerance, "{name}: {} against {expected}", mass(&v));
        // Columns of voxels along z against lines through their middle.
        let g = v.grid();
        let (mut difference, mut total) = (0.0, 0.0);
        for i in (0..96).step_by(7) {
            for j in (0..96).step_by(5) {
                let sum: f64 = (0..96).map(|k| v.isovalue(g.linear([i, j, k]))).sum::<f64>() * g.spacing().z;
                let at = g.index_to_world().transform_point3(DVec3::new(i as f64, j as f64, 0.0));
                let line: f64 = ellipsoids.iter().map(|e| e.line_integral(at, DVec3::Z)).sum();
                difference += (sum - line).abs();
                total += line;
            }
        }
        assert!(difference < 0.02 * total, "{name}: {difference} of {total}");
    }
    assert!(Phantom::parse("lobster").unwrap().ellipsoids().is_none());
}

#[test]
fn shepp_logan_has_the_contrasts_of_the_table() {
    let v = phantom("shepp-logan@128");
    assert_eq!(v.voxel_type(), VoxelType::U16);
    let at = |x: f64, y: f64, z: f64| {
        let index = [x, y, z].map(|u| ((u + 1.0) * 64.0) as usize);
        v.isovalue(v.grid().linear(index))
    };
    assert_eq!(at(0.0, 0.9, 0.0), 10_000.0, "skull");
    assert_eq!(at(0.0, -0.3, 0.0), 2_000.0, "brain");
    assert_eq!(at(0.22, 0.0, 0.0), 0.0, "right ventricle");
    assert_eq!(at(0.0, 0.35, -0.15), 3_000.0, "tumour");
    assert_eq!(at(0.95, 0.95, 0.95), 0.0, "outside");
}

#[test]
fn the_lobster_is_mirrored_in_its_legs_and_lies_in_a_halo_that_is_not_zero() {
    let v = phantom("lobster@200x200x40");
    let g = v.grid();
    let at = |i, j, k| v.isovalue(g.linear([i, j, k]));
    // Resin, far from the animal, and nothing outside the disc.
    for (i, j) in [(30, 60), (170, 60), (20, 80), (100, 195)] {
        assert!((8.0..=15.0).contains(&at(i, j, 20)), "{i} {j}: {}", at(i, j, 20));
    }
    assert_eq!(at(2, 2, 20), 0.0);
    // Left and right agree but for the crusher claw.
    for j in 0..115 {
        for i in 0..100 {
            assert_eq!(at(i, j, 20), at(199 - i, j, 20), "{i} {j}");
        }
    }
    let s = Summary::of(&v);
    assert!(s.max > 200.0 && s.zero_share() < 0.4, "{s:?}");
    // All of the animal fits the thin grid of the real scan.
    let real = phantom("lobster@301x324x56");
    let (flat, cube) = (mass(&real), mass(&phantom("lobster@301x324x100")));
    assert!((flat / cube - 1.0).abs() < 0.02, "{flat} {cube}");
}

#[test]
fn vessels_are_thin_and_99_percent_of_the_voxels_are_zero() {
    let s = Summary::of(&phantom("vessels@128"));
    assert!((0.975..0.995).contains(&s.zero_share()), "{}", s.zero_share());
    let s = Summary::of(&phantom("vessels@256"));
    assert!((0.985..0.995).contains(&s.zero_share()), "{}", s.zero_share());
    assert_eq!(s.max, 255.0);
    // Thin tubes keep their mass when voxels get larger than they are.
    let (fine, coarse) = (mass(&phantom("vessels@256")), mass(&phantom("vessels@64")));
    assert!((coarse / fine - 1.0).abs() < 0.05, "{coarse} {fine}");
}

#[test]
fn marschner_lobb_is_symmetric_in_x_and_y_and_falls_along_z() {
    let v = phantom("marschner-lobb@41");
    let at = |i, j, k| v.isovalue(v.grid().linear([i, j, k]));
    for k in [0, 13, 40] {
        for j in 0..41 {
            for i in 0..41 {
                assert_eq!(at(i, j, k), at(j, i, k));
                assert_eq!(at(i, j, k), at(40 - i, j, k));
            }
        }
    }
    assert!(at(20, 20, 0) > at(20, 20, 20) && at(20, 20, 20) > at(20, 20, 40));
}

#[test]
fn names_and_sizes_that_are_wrong_are_explained() {
    let e = |spec| Phantom::parse(spec).unwrap_err().to_string();
    assert!(e("lobstar").contains("did you mean lobster?"));
    assert!(e("marschner-lob@4").contains("marschner-lobb"));
    assert!(e("whale").contains("one of shepp-logan, lobster"));
    for spec in [
        "",
        "@",
        "box@",
        "box@0",
        "box@-3",
        "box@3x4",
        "box@3x4x5x6",
        "box@1e3",
        "box@+5",
        "box@99999999999999999999",
        "box@65536",
        "box@4294967296",
        "box@ 5",
    ] {
        assert!(Phantom::parse(spec).is_err(), "{spec}");
    }
    assert!(load("phantom:nothing", None).is_err());
    assert_eq!(load("phantom:box@2x3x4", None).unwrap().format, FileFormat::Phantom);
    assert_eq!(Phantom::parse("phantom:box@2").unwrap().to_string(), "phantom:box@2x2x2");
}
