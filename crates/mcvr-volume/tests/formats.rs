//! Every reader gives the voxels and the placing that a file was made with, whatever its type, byte order and packing.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which clippy does not take for tests")]

mod common;

use common::*;
use glam::DVec3;
use mcvr_volume::*;

const BOTH: [Endian; 2] = [Endian::Little, Endian::Big];
const PACKINGS: [Packing; 2] = [Packing::Plain, Packing::Packed];

fn check_values(volume: &Volume, t: VoxelType, what: &str) {
    assert_eq!(volume.grid().dims(), DIMS, "{what}");
    assert_eq!(volume.voxel_type(), t, "{what}");
    for n in 0..COUNT {
        assert_eq!(volume.voxels().get_f64(n), value(n, t), "{what}, voxel {n}");
    }
}

/// The made files turn x into world y, and y into world -x.
fn check_placing(grid: &Grid, what: &str) {
    let world = |i, j, k| grid.index_to_world().transform_point3(DVec3::new(i, j, k));
    assert!((world(0.0, 0.0, 0.0) - DVec3::new(10.0, -20.0, 30.5)).length() < 1e-6, "{what}");
    assert!((world(1.0, 0.0, 0.0) - DVec3::new(10.0, -19.5, 30.5)).length() < 1e-6, "{what}");
    assert!((world(0.0, 1.0, 0.0) - DVec3::new(8.0, -20.0, 30.5)).length() < 1e-6, "{what}");
    assert!((world(0.0, 0.0, 1.0) - DVec3::new(10.0, -20.0, 33.5)).length() < 1e-6, "{what}");
    assert!((grid.spacing() - DVec3::new(0.5, 2.0, 3.0)).length() < 1e-6, "{what}");
}

#[test]
fn every_format_type_byte_order_and_packing_gives_the_voxels_that_were_stored() {
    let folder = Folder::new();
    for &t in VoxelType::ALL {
        for endian in BOTH {
            for packing in PACKINGS {
                let files = [
                    (FileFormat::Nrrd, nrrd(t, endian, packing)),
                    (FileFormat::MetaImage, metaimage(t, endian, packing)),
                    (FileFormat::Nifti1, nifti(1, t, endian, packing)),
                    (FileFormat::Nifti2, nifti(2, t, endian, packing)),
                ];
                for (format, bytes) in files {
                    let what = format!("{format} {t} {endian} {packing:?}");
                    // The name says nothing: the content must.
                    let loaded = open(&folder.file("scan", &bytes), None).unwrap_or_else(|e| panic!("{what}: {e}"));
                    assert_eq!(loaded.format, format, "{what}");
                    check_values(&loaded.volume, t, &what);
                    check_placing(loaded.volume.grid(), &what);
                }
                let data = payload(t, endian);
                let bytes = if packing == Packing::Packed { gzip(&data) } else { data };
                let raw =
                    RawOptions { dims: Some(DIMS), voxel_type: Some(t), endian: Some(endian), ..Default::default() };
                let loaded = open(&folder.file("scan", &bytes), Some(&raw)).unwrap();
                check_values(&loaded.volume, t, &format!("raw {t} {endian} {packing:?}"));
            }
        }
    }
}

#[test]
fn the_name_of_a_raw_file_tells_dimensions_type_and_byte_order_and_options_win() {
    let folder = Folder::new();
    for endian in BOTH {
        for &t in VoxelType::ALL {
            let name = match t {
                VoxelType::U8 => "uint8",
                VoxelType::I8 => "int8",
                VoxelType::U16 => "uint16",
                VoxelType::I16 => "int16",
                VoxelType::U32 => "uint32",
                VoxelType::I32 => "int32",
                VoxelType::F32 => "float32",
                VoxelType::F64 => "float64",
            };
            let suffix = if endian == Endian::Big { "be" } else { "le" };
            let path = folder.file(&format!("my_scan_2_5x4x3_{name}{suffix}.raw.gz"), &gzip(&payload(t, endian)));
            let loaded = open(&path, None).unwrap();
            check_values(&loaded.volume, t, name);
            assert!(loaded.notes.iter().any(|n| n.contains("taken from the file's name")), "{:?}", loaded.notes);
        }
    }
    let path = folder.file("scan_5x4x3_uint16le.raw", &payload(VoxelType::U16, Endian::Big));
    let raw = RawOptions {
        endian: Some(Endian::Big),
        dims: Some([3, 4, 5]),
        spacing: Some([1.0, 2.0, 4.0]),
        ..Default::default()
    };
    let volume = open(&path, Some(&raw)).unwrap().volume;
    assert_eq!(volume.grid().dims(), [3, 4, 5]);
    assert_eq!(volume.grid().spacing(), DVec3::new(1.0, 2.0, 4.0));
    assert_eq!(volume.voxels().get_f64(3), 3007.0);
}

#[test]
fn skipped_bytes_come_before_the_first_voxel_in_plain_and_packed_files() {
    let folder = Folder::new();
    let mut bytes = b"a header of 23 bytes...".to_vec();
    bytes.extend(payload(VoxelType::I16, Endian::Little));
    let raw = RawOptions { dims: Some(DIMS), voxel_type: Some(VoxelType::I16), skip: 23, ..Default::default() };
    for bytes in [gzip(&bytes), bytes] {
        check_values(&open(&folder.file("s", &bytes), Some(&raw)).unwrap().volume, VoxelType::I16, "skip");
    }
}

#[test]
fn aligned_native_plain_voxels_are_mapped_and_others_are_not() {
    let folder = Folder::new();
    let mapped = |name: &str, bytes: &[u8], raw: &RawOptions| {
        open(&folder.file(name, bytes), Some(raw)).unwrap().volume.voxels().is_mapped()
    };
    let raw = RawOptions { dims: Some(DIMS), voxel_type: Some(VoxelType::F32), ..Default::default() };
    let native = payload(VoxelType::F32, Endian::NATIVE);
    assert!(mapped("a", &native, &RawOptions { endian: Some(Endian::NATIVE), ..raw.clone() }));
    let other = if Endian::NATIVE == Endian::Big { Endian::Little } else { Endian::Big };
    assert!(!mapped("b", &payload(VoxelType::F32, other), &RawOptions { endian: Some(other), ..raw.clone() }));
    assert!(!mapped("c", &gzip(&native), &RawOptions { endian: Some(Endian::NATIVE), ..raw.clone() }));
    let odd: Vec<u8> = std::iter::once(0).chain(native.iter().copied()).collect();
    assert!(!mapped("d", &odd, &RawOptions { endian: Some(Endian::NATIVE), skip: 1, ..raw }));
    for t in [VoxelType::U8, VoxelType::U16, VoxelType::F64] {
        assert!(mapped("e", &nifti(1, t, Endian::NATIVE, Packing::Plain), &RawOptions::default()));
    }
}

#[test]
fn written_files_read_back_the_same_and_mapped() {
    let folder = Folder::new();
    for &t in VoxelType::ALL {
        let path = folder.file("m.nrrd", &nrrd(t, Endian::Big, Packing::Packed));
        let volume = open(&path, None).unwrap().volume;
        let (a, b) = (folder.path("out.nrrd"), folder.path("out.mha"));
        write_nrrd(&volume, &a).unwrap();
        write_metaimage(&volume, &b).unwrap();
        for (path, format) in [(a, FileFormat::Nrrd), (b, FileFormat::MetaImage)] {
            let again = open(&path, None).unwrap();
            assert_eq!(again.format, format);
            check_values(&again.volume, t, "written");
            check_placing(again.volume.grid(), "written");
            assert_eq!(again.volume.voxels().is_mapped(), cfg!(target_endian = "little"));
        }
    }
}

#[test]
fn a_written_volume_with_a_slope_holds_its_isovalues() {
    let folder = Folder::new();
    let grid = Grid::with_spacing([3, 1, 1], [1.0; 3]).unwrap();
    let volume = Volume::from_vec(grid, vec![0u16, 1, 4095], "hu").unwrap().with_rescale(0.5, -1000.0).unwrap();
    let path = folder.path("hu.nrrd");
    write_nrrd(&volume, &path).unwrap();
    let again = open(&path, None).unwrap().volume;
    assert_eq!(again.voxel_type(), VoxelType::F32);
    assert_eq!([0, 1, 2].map(|n| again.isovalue(n)), [-1000.0, -999.5, 1047.5]);
}

#[test]
fn writing_into_a_missing_folder_fails_and_leaves_nothing() {
    let folder = Folder::new();
    let volume = Phantom::parse("box@4").unwrap().generate().unwrap();
    assert!(write_nrrd(&volume, &folder.path("no/such/x.nrrd")).is_err());
    std::fs::create_dir(folder.path("taken.mha")).unwrap();
    assert!(write_metaimage(&volume, &folder.path("taken.mha")).is_err());
    assert_eq!(std::fs::read_dir(folder.path("")).unwrap().count(), 1);
}

#[test]
fn the_spacing_option_replaces_the_spacing_of_every_format() {
    let folder = Folder::new();
    let options = RawOptions { spacing: Some([1.0, 1.0, 1.4]), ..Default::default() };
    let t = VoxelType::U8;
    for bytes in [
        nrrd(t, Endian::Little, Packing::Plain),
        metaimage(t, Endian::Little, Packing::Plain),
        nifti(1, t, Endian::Little, Packing::Packed),
        nifti(2, t, Endian::Big, Packing::Plain),
    ] {
        let loaded = open(&folder.file("s", &bytes), Some(&options)).unwrap();
        assert_eq!(loaded.volume.grid().spacing(), DVec3::new(1.0, 1.0, 1.4));
        assert!((loaded.volume.grid().origin() - DVec3::new(10.0, -20.0, 30.5)).length() < 1e-6);
        assert!(loaded.notes.iter().any(|n| n.contains("replaced by 1 x 1 x 1.4")), "{:?}", loaded.notes);
    }
    let phantom = load("phantom:lobster@16", Some(&options)).unwrap().volume;
    assert!(phantom.grid().centre().length() < 1e-9);
    assert_eq!(phantom.grid().spacing(), DVec3::new(1.0, 1.0, 1.4));
    let bad = RawOptions { spacing: Some([1.0, 0.0, 1.0]), ..Default::default() };
    assert!(load("phantom:box@4", Some(&bad)).is_err());
}

#[test]
fn detached_headers_find_their_data_beside_them() {
    let folder = Folder::new();
    let t = VoxelType::U16;
    let data = payload(t, Endian::Big);
    folder.file("d.raw", &data);
    folder.file("d.gz", &gzip(&data));
    folder.file("d.zraw", &zlib(&data));
    let mut with_lines = b"P5\n5 4\n".to_vec();
    with_lines.extend([9u8; 3]);
    with_lines.extend(&data);
    folder.file("d.pgm", &with_lines);
    let nrrd = |packing, extra: &str| nrrd_header(t, Endian::Big, packing, extra).into_bytes();
    let meta = |packing, extra, file| metaimage_header(t, Endian::Big, packing, extra, file).into_bytes();
    let headers = [
        nrrd(Packing::Plain, "data file: d.raw\n"),
        nrrd(Packing::Plain, "datafile: ./d.raw\n\n"),
        nrrd(Packing::Packed, "data file: d.gz\n"),
        nrrd(Packing::Plain, "data file: d.pgm\nline skip: 2\nbyte skip: 3\n"),
        nrrd(Packing::Plain, "data file: d.pgm\nbyte skip: -1\n"),
        meta(Packing::Plain, "", "d.raw"),
        meta(Packing::Packed, "CompressedDataSize = 77\n", "d.zraw"),
        meta(Packing::Plain, "HeaderSize = 10\n", "d.pgm"),
        meta(Packing::Plain, "HeaderSize = -1\n", "d.pgm"),
    ];
    for header in headers {
        let what = String::from_utf8_lossy(&header).into_owned();
        let loaded = open(&folder.file("h", &header), None).unwrap_or_else(|e| panic!("{what}: {e}"));
        check_values(&loaded.volume, t, &what);
    }
    for refused in [
        nrrd(Packing::Plain, "data file: missing.raw\n"),
        nrrd(Packing::Plain, "data file: LIST\nd.raw\n"),
        nrrd(Packing::Plain, "data file: d%03d.raw 1 3 1\n"),
        nrrd(Packing::Plain, "data file: .\n"),
        meta(Packing::Plain, "", "LIST"),
        meta(Packing::Plain, "", "d%03d.raw 1 3 1"),
        meta(Packing::Plain, "HeaderSize = 11\n", "d.pgm"),
    ] {
        assert!(open(&folder.file("h", &refused), None).is_err(), "{}", String::from_utf8_lossy(&refused));
    }
}

#[test]
fn nrrd_spacings_and_units_are_read_and_headers_may_end_lines_in_either_way() {
    let folder = Folder::new();
    let t = VoxelType::U8;
    let extra = "spacings: 0.5 nan 3\nspace units: \"cm\" \"cm\" \"cm\"\n\n";
    let header = nrrd_header(t, Endian::Little, Packing::Plain, extra).replace('\n', "\r\n");
    let mut bytes = header.into_bytes();
    bytes.extend(payload(t, Endian::Little));
    let loaded = open(&folder.file("s.nrrd", &bytes), None).unwrap();
    check_values(&loaded.volume, t, "CRLF");
    assert!((loaded.volume.grid().spacing() - DVec3::new(5.0, 10.0, 30.0)).length() < 1e-12);
    assert!(loaded.notes.iter().any(|n| n.contains("NaN")), "{:?}", loaded.notes);
}

#[test]
fn nifti_takes_the_qform_without_an_sform_and_pixdim_without_either() {
    let folder = Folder::new();
    let t = VoxelType::I16;
    let mut h = nifti1_header(t, Endian::Big);
    {
        let mut p = Patch(&mut h, Endian::Big);
        p.i16(254, 0);
        p.i16(252, 1);
        // A quarter turn about z, and a flipped third axis.
        p.f32(76, -1.0);
        p.f32(264, std::f32::consts::FRAC_1_SQRT_2);
        p.f32(268, 10.0);
        p.f32(272, -20.0);
        p.f32(276, 30.5);
    }
    h.extend(payload(t, Endian::Big));
    let grid = open(&folder.file("q.nii", &h), None).unwrap().volume.grid().clone();
    let world = |i, j, k| grid.index_to_world().transform_point3(DVec3::new(i, j, k));
    assert!((world(1.0, 0.0, 0.0) - DVec3::new(10.0, -19.5, 30.5)).length() < 1e-5);
    assert!((world(0.0, 1.0, 0.0) - DVec3::new(8.0, -20.0, 30.5)).length() < 1e-5);
    assert!((world(0.0, 0.0, 1.0) - DVec3::new(10.0, -20.0, 27.5)).length() < 1e-5);

    Patch(&mut h, Endian::Big).i16(252, 0);
    let grid = open(&folder.file("p.nii", &h), None).unwrap().volume.grid().clone();
    assert_eq!((grid.origin(), grid.direction()), (DVec3::ZERO, glam::DMat3::IDENTITY));
    assert_eq!(grid.spacing(), DVec3::new(0.5, 2.0, 3.0));
}

#[test]
fn nifti_slope_and_intercept_make_isovalues_and_slope_0_means_none() {
    let folder = Folder::new();
    let t = VoxelType::U16;
    for (slope, intercept, expected) in [(0.0, 5.0, 7.0), (2.0, -1000.0, -986.0), (f32::NAN, 1.0, 7.0)] {
        let mut h = nifti1_header(t, Endian::Little);
        Patch(&mut h, Endian::Little).f32(112, slope);
        Patch(&mut h, Endian::Little).f32(116, intercept);
        h.extend(payload(t, Endian::Little));
        assert_eq!(open(&folder.file("s.nii", &h), None).unwrap().volume.isovalue(0), expected);
    }
}

#[test]
fn a_sheared_sform_keeps_its_map_and_a_singular_one_is_replaced() {
    let folder = Folder::new();
    let t = VoxelType::U8;
    let mut h = nifti2_header(t, Endian::Little);
    Patch(&mut h, Endian::Little).f64(400 + 16, 1.5);
    h.extend(payload(t, Endian::Little));
    let loaded = open(&folder.file("s.nii", &h), None).unwrap();
    let p = loaded.volume.grid().index_to_world().transform_point3(DVec3::new(0.0, 0.0, 2.0));
    assert!((p - DVec3::new(13.0, -20.0, 36.5)).length() < 1e-9);
    assert!(loaded.notes.iter().any(|n| n.contains("sheared")));

    Patch(&mut h, Endian::Little).f64(464 + 16, 0.0);
    Patch(&mut h, Endian::Little).f64(400 + 16, 0.0);
    let loaded = open(&folder.file("s.nii", &h), None).unwrap();
    assert_eq!(loaded.volume.grid().spacing(), DVec3::new(0.5, 2.0, 3.0));
    assert!(loaded.notes.iter().any(|n| n.contains("ignored")));
}

#[test]
fn gzip_files_of_several_members_are_one_volume() {
    let folder = Folder::new();
    let data = payload(VoxelType::U8, Endian::Little);
    let mut bytes = gzip(&data[..20]);
    bytes.extend(gzip(&data[20..21]));
    bytes.extend(gzip(&data[21..]));
    let volume = open(&folder.file("s_5x4x3_uint8.raw.gz", &bytes), None).unwrap().volume;
    check_values(&volume, VoxelType::U8, "members");
}

#[test]
fn raw_options_for_a_file_with_a_header_are_ignored_with_a_note() {
    let folder = Folder::new();
    let raw = RawOptions { dims: Some([1, 1, 1]), ..Default::default() };
    let loaded = open(&folder.file("s", &nrrd(VoxelType::U8, Endian::Little, Packing::Plain)), Some(&raw)).unwrap();
    check_values(&loaded.volume, VoxelType::U8, "ignored options");
    assert!(loaded.notes.iter().any(|n| n.contains("header's")), "{:?}", loaded.notes);
}
