//! Real scans: read from the folder that `MCVR_DATA_DIR` names, checked against the figures in its README. Without the
//! variable the same readers run on phantoms written here.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which clippy does not take for tests")]

mod common;

use std::path::PathBuf;

use common::{Folder, gzip};
use mcvr_volume::*;
use sha2::{Digest, Sha256};

/// What the README states about a file.
struct Known {
    file: &'static str,
    dims: [usize; 3],
    voxel_type: VoxelType,
    spacing: [f64; 3],
    /// Smallest, largest, mean value.
    values: (f64, f64, f64),
    /// Of the packed (or only) file.
    sha256: &'static str,
    /// Of the voxels, where the README states it for them.
    unpacked: Option<&'static str>,
}

const fn known(
    file: &'static str,
    dims: [usize; 3],
    voxel_type: VoxelType,
    values: (f64, f64, f64),
    sha256: &'static str,
    unpacked: Option<&'static str>,
) -> Known {
    Known { file, dims, voxel_type, spacing: [1.0; 3], values, sha256, unpacked }
}

use VoxelType::{I16, U8, U16};

#[rustfmt::skip]
const VOLUMES: [Known; 18] = [
    known("lobster_301x324x56_uint8.raw.gz", [301, 324, 56], U8, (0.0, 255.0, 13.0526), "bbe26b544c3ccef97a583357345f2ffc1527247f9b0ef906a0c7691cea82108c", Some("838de17d5bbca0134e56831e311d3721df3c2d8c3f9d4275122386f8fa0e506a")),
    known("lobster_avs_120x120x34_uint8.raw.gz", [120, 120, 34], U8, (0.0, 255.0, 17.5362), "afa472e5f58952ad7d7e124f302d7afe2dc200fd9b4a0a86a8a8b325f8c597c7", Some("7ceac85945b61fcd5d701550504b95e17a18e82b967f76956aa46b929571d298")),
    known("cthead_256x256x113_uint16be.raw.gz", [256, 256, 113], U16, (0.0, 3272.0, 379.5421), "ddcf6e796c54414f4ce46a0a7ae738fd9276a136c93d83b436f278ad7d6f727d", Some("163572eca68c0a6b4142ce43396922b465027e6bf97949b9fad168405e27e6c7")),
    known("chest_ct_hu_256x256x137_int16le.raw.gz", [256, 256, 137], I16, (-1000.0, 1851.0, -619.9888), "00097882fca3de69ae25932b3ab3b2c2f1b84a41d9374fa52c3ce7d0513bf3fd", Some("bd4fc82a287c752e9298007a607d2a3f5815882d3883758d4082b60749b8c71c")),
    known("engine_256x256x128_uint8.raw.gz", [256, 256, 128], U8, (0.0, 255.0, 22.3488), "df59d3adf9aa24ea02bf45528f0e8467a777647f78af02f63bd235aa084ec8d7", Some("15cf29cdde69cd6c8b5ab9eeef4d1bb21f276056da4111cb5069ebfbe5b6ff90")),
    known("aneurism_256x256x256_uint8.raw.gz", [256, 256, 256], U8, (0.0, 255.0, 1.0692), "efa42d02985bdf6f7a24092dc8c958ac69037f4dc6473da458e24a5e005d79b1", Some("2826a66db406f19bdd9e38cfe42a80b861fbce34a947c24ce511f07f1c160b83")),
    known("stent_128x128x256_int16le.raw.gz", [128, 128, 256], I16, (0.0, 2000.0, 35.3982), "324d1add5846d2de3aa78b14b8e316d9da7c181deed3191b0c19dc906e0ef175", Some("8431cfdc59600c1a6e2b68adeac61a8535d01cfdba236150b92101f984454da1")),
    known("statue_leg_341x341x93_uint8.raw.gz", [341, 341, 93], U8, (0.0, 250.0, 6.0679), "eb5114364f1630c927ee1b59aebb2e65347496a29f56913ee2a7094bceb77c19", Some("f14d33364f0a3841d02218706099a9f608eb66197469a2afcbd2f0a91c250d72")),
    known("mni152_t1_197x233x189_uint8.nii.gz", [197, 233, 189], U8, (0.0, 255.0, 38.4389), "421a10e872fd6cadae7f61d358dffbcc1795a497d61ee76c5dda2503e1a1e9e6", None),
    Known { spacing: [3.0; 3], ..known("ct_abdomen_small_122x101x30_int16.nii.gz", [122, 101, 30], I16, (-1100.0, 1207.0, -354.0953), "e50c00b2914e2cac0aaee8e7f3b5f57d44d9f21bfd5c0577271c54c0cb49e9fb", None) },
    known("headsq_64x64x93_int16le.raw.gz", [64, 64, 93], I16, (0.0, 3926.0, 507.6873), "a6f57b02bbf47d97b3304940366a1da15aae78a8459a9ab2cd349ecf86faccea", Some("35b0a0101e612dc83ff56295b09e1ac95c8462198def11a8db1297f8aed3e5f6")),
    known("tooth_103x94x161_uint8.nrrd", [103, 94, 161], U8, (0.0, 255.0, 103.1652), "5ad2e1c52929fde75becd7ba1654c5ef9f4fef40c3032cf36d72ef7bcca0dc64", None),
    known("fuel_64x64x64_uint8.raw.gz", [64, 64, 64], U8, (0.0, 255.0, 1.9448), "636c985803c96e3c487b2ea0c066bfc462e30479004d93e4c0324963137d9cb6", Some("349321dc4668d034bc7a299340d651033b44cb759c0d67b4b43c6faa7d485728")),
    known("neghip_64x64x64_uint8.raw.gz", [64, 64, 64], U8, (0.0, 255.0, 18.4028), "e67cb2ede86ceecbb9045755ce3ceab516ed32ab1b0fb56b9c19a267234487ca", Some("72cfeacbc7e5d6612198a169a3f2d6df09d78f67506ffa83b0f34498d9d85872")),
    known("silicium_98x34x34_uint8.raw.gz", [98, 34, 34], U8, (0.0, 255.0, 40.9032), "dd69d4cf4057a78c66208b35e506bfed95668442a4d836bd455d1eb6106f8fb3", Some("adbf15c3d292e222f81464050c04fac923d416af20e8bb5eb83bd374d79a1e54")),
    known("hydrogen_atom_128x128x128_uint8.raw.gz", [128, 128, 128], U8, (0.0, 250.0, 2.8567), "fb4efd3bf70fcc75908d483ea98755fc7b4aa706f7016ab24a9741c3030c5cb0", Some("5b7e638c62f1aa74e16ddc59b4985273493d9aa2fb55e4862fa21770d67eac80")),
    known("nucleon_41x41x41_uint8.raw.gz", [41, 41, 41], U8, (0.0, 249.0, 39.3977), "70f1f1ea0f141aad67b1f0bcddac21ed51bfa60f79e2291beb0796f37a7108c1", Some("6fe2992a994f6150d7300c3c5a143ba9e8aa4bb9f38c77ce0d9b512ebd286c60")),
    known("marschner_lobb_41x41x41_uint8.raw.gz", [41, 41, 41], U8, (0.0, 255.0, 127.1294), "6dd7e7bda859ed6b690730e7f11e82d601890e5724767fd6012e0d192e778f83", Some("ea06319008ae86ed18e1ca02ebe72ed9567243d65870baf4a8cfd1deaa78e568")),
];

/// The DICOM series, which is not supported.
const DICOM: &str = "dicom_ct_lidc0314_16slices.tar.gz";

fn folder() -> Option<PathBuf> {
    std::env::var_os("MCVR_DATA_DIR").filter(|d| !d.is_empty()).map(PathBuf::from)
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// The voxels as stored in a big- or little-endian file.
fn stored_bytes(volume: &Volume, endian: Endian) -> Vec<u8> {
    fn bytes<T: Voxel>(v: &[T], swap: bool) -> Vec<u8> {
        let v: Vec<T> = v.iter().map(|x| if swap { x.swap_bytes() } else { *x }).collect();
        bytemuck::cast_slice(&v).to_vec()
    }
    let swap = endian != Endian::NATIVE;
    match volume.voxels() {
        Voxels::U8(v) => bytes(v, swap),
        Voxels::U16(v) => bytes(v, swap),
        Voxels::I16(v) => bytes(v, swap),
        other => panic!("no shared volume has {}", other.voxel_type()),
    }
}

fn check(path: &std::path::Path, known: &Known, endian: Endian) {
    let loaded = open(path, None).unwrap();
    let volume = &loaded.volume;
    let what = known.file;
    assert_eq!(volume.grid().dims(), known.dims, "{what}");
    assert_eq!(volume.voxel_type(), known.voxel_type, "{what}");
    assert!((volume.grid().spacing() - glam::DVec3::from_array(known.spacing)).length() < 1e-6, "{what}");
    let s = Summary::of(volume);
    assert_eq!((s.min, s.max), (known.values.0, known.values.1), "{what}");
    assert!((s.mean - known.values.2).abs() < 5.1e-5, "{what}: mean {}", s.mean);
    assert_eq!(s.histogram.iter().sum::<u64>(), s.count, "{what}");
    if let Some(expected) = known.unpacked {
        assert_eq!(sha256(&stored_bytes(volume, endian)), expected, "{what}");
    }
    assert_eq!(byte_order_suspicion(volume), None, "{what}");
}

#[test]
fn shared_volumes_have_the_values_of_their_readme() {
    let Some(folder) = folder() else {
        // The same checks on a phantom in a file of the same kind.
        let here = Folder::new();
        let volume = Phantom::parse("shepp-logan@40x30x20").unwrap().generate().unwrap();
        let packed = gzip(&stored_bytes(&volume, Endian::Big));
        let path = here.file("head_40x30x20_uint16be.raw.gz", &packed);
        let s = Summary::of(&volume);
        let known = known("head", [40, 30, 20], U16, (s.min, s.max, s.mean), "", None);
        return check(&path, &known, Endian::Big);
    };
    for known in &VOLUMES {
        let path = folder.join(known.file);
        assert_eq!(sha256(&std::fs::read(&path).unwrap()), known.sha256, "{}", known.file);
        check(&path, known, if known.file.contains("16be") { Endian::Big } else { Endian::Little });
    }
}

#[test]
fn byte_swapped_scans_are_flagged() {
    let Some(folder) = folder() else {
        let here = Folder::new();
        let smooth = Phantom::parse("gaussian@64").unwrap().generate().unwrap();
        let voxels = (0..smooth.grid().len()).map(|n| (4000.0 * smooth.isovalue(n)) as u16).collect();
        let volume = Volume::from_vec(smooth.grid().clone(), voxels, "smooth").unwrap();
        let path = here.file("head_64x64x64_uint16le.raw", &stored_bytes(&volume, Endian::Big));
        let loaded = open(&path, None).unwrap();
        assert!(loaded.notes.iter().any(|n| n.contains("byte-swapped")), "{:?}", loaded.notes);
        assert_eq!(byte_order_suspicion(&volume), None);
        return;
    };
    for known in VOLUMES.iter().filter(|k| k.voxel_type != U8 && k.file.contains(".raw")) {
        let right = if known.file.contains("16be") { Endian::Big } else { Endian::Little };
        let wrong = if right == Endian::Big { Endian::Little } else { Endian::Big };
        let options = RawOptions { endian: Some(wrong), ..Default::default() };
        let loaded = open(&folder.join(known.file), Some(&options)).unwrap();
        let flagged = loaded.notes.iter().find(|n| n.contains("byte-swapped"));
        assert!(flagged.is_some(), "{}: {:?}", known.file, loaded.notes);
    }
}

#[test]
fn the_mni_template_keeps_its_place() {
    let Some(folder) = folder() else { return };
    let grid = open(&folder.join("mni152_t1_197x233x189_uint8.nii.gz"), None).unwrap().volume.grid().clone();
    assert_eq!(grid.origin(), glam::DVec3::new(-98.0, -134.0, -72.0));
    assert_eq!(grid.direction(), glam::DMat3::IDENTITY);
}

#[test]
fn the_dicom_series_is_refused_with_advice() {
    let Some(folder) = folder() else { return };
    let e = open(&folder.join(DICOM), None).unwrap_err().to_string();
    assert!(e.contains("tar archive") && e.contains("convert"), "{e}");
}

#[test]
fn the_marschner_lobb_phantom_is_the_shared_one() {
    let Some(folder) = folder() else { return };
    let shared = open(&folder.join("marschner_lobb_41x41x41_uint8.raw.gz"), None).unwrap().volume;
    let ours = Phantom::parse("marschner-lobb@41").unwrap().generate().unwrap();
    // The shared file lost its first sample and ends in a line feed instead: every other one is moved by one.
    let last = shared.grid().len() - 1;
    assert_eq!(shared.isovalue(last), f64::from(b'\n'));
    assert!((0..last).all(|n| (shared.isovalue(n) - ours.isovalue(n + 1)).abs() <= 1.0));
}
