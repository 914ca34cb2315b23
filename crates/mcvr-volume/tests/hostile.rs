//! Whatever a file holds, opening it gives a volume or an error that helps; never a panic, never memory that the file
//! cannot fill.

#![allow(clippy::unwrap_used, reason = "helpers of tests, which clippy does not take for tests")]

mod common;

use std::path::Path;

use common::*;
use mcvr_volume::*;
use proptest::prelude::*;

const LE: Endian = Endian::Little;

fn error(path: &Path, options: Option<&RawOptions>) -> String {
    match open(path, options) {
        Ok(loaded) => panic!("{} was read as {}", path.display(), loaded.format),
        Err(e) => e.to_string(),
    }
}

#[test]
fn a_file_cut_off_at_any_byte_is_refused() {
    let folder = Folder::new();
    for packing in [Packing::Plain, Packing::Packed] {
        let t = VoxelType::I16;
        for bytes in [
            nrrd(t, LE, packing),
            metaimage(t, LE, packing),
            nifti(1, t, LE, packing),
            nifti(2, t, Endian::Big, packing),
        ] {
            for n in 0..bytes.len() {
                // Damaged magic bytes make it a raw file of unknown geometry, which is refused as well.
                assert!(open(&folder.file("cut", &bytes[..n]), None).is_err(), "{n} of {} bytes", bytes.len());
            }
            assert!(open(&folder.file("whole", &bytes), None).is_ok());
        }
    }
}

#[test]
fn surplus_bytes_are_refused_and_counted() {
    let folder = Folder::new();
    let t = VoxelType::U8;
    let plain = [nrrd(t, LE, Packing::Plain), metaimage(t, LE, Packing::Plain), nifti(1, t, LE, Packing::Plain)];
    for mut bytes in plain {
        bytes.extend([1, 2, 3]);
        let e = error(&folder.file("long", &bytes), None);
        assert!(e.contains("3 too many"), "{e}");
    }
    let packed = [nrrd(t, LE, Packing::Packed), metaimage(t, LE, Packing::Packed), nifti(2, t, LE, Packing::Packed)];
    for mut bytes in packed {
        bytes.extend([1, 2, 3]);
        let e = error(&folder.file("long", &bytes), None);
        assert!(e.contains("3 bytes follow the end of the compressed data"), "{e}");
    }
    let raw = RawOptions { dims: Some([5, 4, 2]), voxel_type: Some(t), ..Default::default() };
    let e = error(&folder.file("long", &gzip(&payload(t, LE))), Some(&raw));
    assert!(e.contains("holds 60 bytes (20 too many)"), "{e}");
    assert!(e.contains("5x4x3 of u8") && e.contains("header of 20 bytes"), "{e}");
}

#[test]
fn a_raw_file_of_the_wrong_size_is_told_what_would_fit() {
    let folder = Folder::new();
    let path = folder.file("scan", &vec![0u8; 2 * 16 * 16 * 16]);
    let raw = |dims, t| RawOptions { dims: Some(dims), voxel_type: Some(t), ..Default::default() };
    let e = error(&path, Some(&raw([16, 16, 16], VoxelType::U8)));
    assert!(e.contains("8192 bytes") && e.contains("4096") && e.contains("16x16x16 of u16"), "{e}");
    let e = error(&path, Some(&raw([16, 16, 20], VoxelType::I16)));
    assert!(e.contains("2048 too few") && e.contains("16x16x16 of i16"), "{e}");
    let e = error(&path, None);
    assert!(e.contains("dimensions and voxel type") && e.contains("16x16x16 of u16 or i16"), "{e}");
    let e = error(&path, Some(&RawOptions { dims: Some([16; 3]), ..Default::default() }));
    assert!(e.contains("give its voxel type") && e.contains("16x16x16 of i16"), "{e}");
}

#[test]
fn a_gzip_bomb_is_refused_without_being_unpacked_into_memory() {
    let folder = Folder::new();
    // 512 MiB of zeros in about half a megabyte, twice packed into a header's promise of 8 voxels.
    let mut e = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    for _ in 0..512 {
        std::io::Write::write_all(&mut e, &vec![0u8; 1 << 20]).unwrap();
    }
    let bomb = e.finish().unwrap();
    let path = folder.file("bomb_2x2x2_uint8.raw.gz", &bomb);
    let message = error(&path, None);
    assert!(message.contains("at least"), "{message}");

    // The other way round: a header that promises more than the bytes can hold.
    let path = folder.file("bomb_100000x100000x100_uint8.raw.gz", &gzip(&[0; 1000]));
    let message = error(&path, None);
    assert!(message.contains("at most"), "{message}");
}

#[test]
fn extents_that_are_zero_negative_or_gigantic_are_refused() {
    let folder = Folder::new();
    let t = VoxelType::F64;
    for dims in [
        "0 4 3",
        "-5 4 3",
        "5 4",
        "5 4 3 1",
        "99999999999999999999 1 1",
        "4294967296 4294967296 4294967296",
        "1048576 1048576 1",
        "9223372036854775807 2 1",
        "5 4 x",
        "100000 100000 100",
        "1e3 1 1",
        "",
    ] {
        for packing in [Packing::Plain, Packing::Packed] {
            let text = nrrd_header(t, LE, packing, "\n").replace("sizes: 5 4 3", &format!("sizes: {dims}"));
            let mut bytes = text.into_bytes();
            bytes.extend(payload(t, LE));
            assert!(open(&folder.file("n", &bytes), None).is_err(), "NRRD {dims}");
            let text = metaimage_header(t, LE, packing, "", "LOCAL").replace("= 5 4 3", &format!("= {dims}"));
            let mut bytes = text.into_bytes();
            bytes.extend(payload(t, LE));
            assert!(open(&folder.file("m", &bytes), None).is_err(), "MetaImage {dims}");
        }
    }
    for dims in [[0i64, 4, 3], [-5, 4, 3], [i64::MAX, 2, 1], [i64::MIN, 1, 1], [1 << 20, 1 << 20, 1], [1 << 40, 1, 1]] {
        let mut h = nifti2_header(t, LE);
        for (n, d) in dims.into_iter().enumerate() {
            Patch(&mut h, LE).i64(24 + 8 * n, d);
        }
        h.extend(payload(t, LE));
        assert!(open(&folder.file("2.nii", &h), None).is_err(), "NIfTI-2 {dims:?}");
        assert!(open(&folder.file("2.nii.gz", &gzip(&h)), None).is_err(), "NIfTI-2 {dims:?}");
    }
    for dims in [[0i16, 4, 3], [-5, 4, 3], [i16::MAX; 3], [i16::MIN; 3]] {
        let mut h = nifti1_header(t, LE);
        for (n, d) in dims.into_iter().enumerate() {
            Patch(&mut h, LE).i16(42 + 2 * n, d);
        }
        h.extend(payload(t, LE));
        assert!(open(&folder.file("1.nii", &h), None).is_err(), "NIfTI-1 {dims:?}");
    }
    for name in ["x_0x1x1_uint8.raw", "x_99999999999999999999x1x1_uint8.raw", "x_1048576x1048576x2_float64.raw"] {
        assert!(open(&folder.file(name, &[0; 60]), None).is_err(), "{name}");
    }
    let raw = RawOptions { dims: Some([usize::MAX; 3]), voxel_type: Some(t), skip: u64::MAX, ..Default::default() };
    assert!(open(&folder.file("r", &[0; 60]), Some(&raw)).is_err());
    let raw = RawOptions { dims: Some([1; 3]), voxel_type: Some(t), skip: u64::MAX, ..Default::default() };
    assert!(open(&folder.file("r", &[0; 60]), Some(&raw)).is_err());
    assert!(open(&folder.file("r", &gzip(&[0; 60])), Some(&raw)).is_err());
}

#[test]
fn hostile_nifti_numbers_are_refused() {
    let folder = Folder::new();
    let t = VoxelType::U8;
    for offset in [f32::NAN, f32::INFINITY, -1.0, 100.0, 352.5, 1e30, 353.0] {
        let mut h = nifti1_header(t, LE);
        Patch(&mut h, LE).f32(108, offset);
        h.extend(payload(t, LE));
        assert!(open(&folder.file("o.nii", &h), None).is_err(), "vox_offset {offset}");
        assert!(open(&folder.file("o.nii.gz", &gzip(&h)), None).is_err(), "vox_offset {offset}");
    }
    for code in [0i16, 1, 32, 128, 1024, 1280, 1536, 2304, -1] {
        let mut h = nifti1_header(t, LE);
        Patch(&mut h, LE).i16(70, code);
        h.extend(payload(t, LE));
        let e = error(&folder.file("c.nii", &h), None);
        assert!(e.contains("datatype") && e.contains(&code.to_string()), "{e}");
    }
    let mut h = nifti1_header(t, LE);
    Patch(&mut h, LE).i16(48, 2);
    h.extend(payload(t, LE));
    h.extend(payload(t, LE));
    assert!(error(&folder.file("4d.nii", &h), None).contains("one volume"));
}

#[test]
fn headers_without_an_end_are_given_up_after_a_megabyte() {
    let folder = Folder::new();
    let mut endless = b"NRRD0004\n".to_vec();
    endless.extend(std::iter::repeat_n(b'a', 3 << 20));
    assert!(error(&folder.file("n", &endless), None).contains("1048576"));
    let mut endless = b"ObjectType = Image\nName = ".to_vec();
    endless.extend(std::iter::repeat_n(b'a', 3 << 20));
    assert!(error(&folder.file("m", &endless), None).contains("1048576"));
    let mut lines = b"NRRD0005\n".to_vec();
    lines.extend(b"#\n".repeat(2 << 20));
    assert!(open(&folder.file("l", &lines), None).is_err());
}

#[test]
fn what_is_not_supported_is_named_with_what_to_do() {
    let folder = Folder::new();
    let mut tar = vec![0u8; 1024];
    tar[257..262].copy_from_slice(b"ustar");
    let e = error(&folder.file("series.tar.gz", &gzip(&tar)), None);
    assert!(e.contains("tar") && e.contains("convert"), "{e}");
    let mut dicom = vec![0u8; 400];
    dicom[128..132].copy_from_slice(b"DICM");
    let e = error(&folder.file("slice", &dicom), None);
    assert!(e.contains("DICOM") && e.contains("convert"), "{e}");
    assert!(error(&folder.file("png", b"\x89PNG\r\n\x1a\n...."), None).contains("PNG"));
    assert!(error(&folder.file("empty.nrrd", b""), None).contains("empty"));
    assert!(error(&folder.path("."), None).contains("directory"));
    assert!(error(&folder.path("none.raw"), None).contains("none.raw"));
    let t = VoxelType::U8;
    let packed = gzip(&nrrd(t, LE, Packing::Plain));
    assert!(error(&folder.file("x.nrrd.gz", &packed), None).contains("gunzip"));
    for (from, to, says) in [
        ("dimension: 3", "dimension: 4", "dimension"),
        ("unsigned char", "block", "type"),
        ("encoding: raw", "encoding: bzip2", "raw or gzip"),
        ("endian: little", "endian: middle", "endian"),
        ("NRRD0004", "NRRD0009", "NRRD0005"),
        ("sizes: 5 4 3", "sizes: 5 4 3\nsizes: 5 4 3", "twice"),
        ("key:=", "no separator at all", "free text"),
        ("# a", "spacings: 1 1 0\n#", "spacings"),
        ("# a", "space directions: (1,0,0) none (0,0,1)\n#", "space directions"),
        ("# a", "space directions: (1,0,0) (1,0,0) (0,0,1)\n#", "invertible"),
        ("# a", "space origin: (1,0,inf)\n#", "origin"),
    ] {
        let mut bytes = nrrd_header(t, LE, Packing::Plain, "\n").replace(from, to).into_bytes();
        bytes.extend(payload(t, LE));
        let e = error(&folder.file("n.nrrd", &bytes), None);
        assert!(e.contains(says), "{to}: {e}");
    }
    for (from, to, says) in [
        ("NDims = 3", "NDims = 2", "NDims"),
        ("MET_UCHAR", "MET_LONG_LONG", "MET_UCHAR"),
        ("BinaryData = True", "BinaryData = False", "text"),
        ("Offset = ", "ElementNumberOfChannels = 3\nOffset = ", "Channels"),
        ("ElementSpacing = 0.5", "ElementSpacing = -0.5", "ElementSpacing"),
        ("= 0 1 0 -1", "= 0 0 0 -1", "spacing, origin and direction"),
        ("CompressedData = False", "CompressedData = maybe", "CompressedData"),
    ] {
        let mut bytes = metaimage_header(t, LE, Packing::Plain, "", "LOCAL").replace(from, to).into_bytes();
        bytes.extend(payload(t, LE));
        let e = error(&folder.file("m.mha", &bytes), None);
        assert!(e.contains(says), "{to}: {e}");
    }
}

#[cfg(unix)]
#[test]
fn a_file_without_permission_is_named() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new();
    let path = folder.file("secret_5x4x3_uint8.raw", &[0; 60]);
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o000)).unwrap();
    // The superuser may read everything; nothing to see then.
    if std::fs::File::open(&path).is_err() {
        assert!(error(&path, None).contains("secret"));
    }
}

#[cfg(unix)]
#[test]
fn a_device_is_not_read() {
    assert!(error(Path::new("/dev/zero"), None).contains("regular file"));
}

#[test]
fn damaged_compressed_data_are_refused() {
    let folder = Folder::new();
    let good = gzip(&payload(VoxelType::U16, LE));
    for n in 0..good.len() {
        let mut bad = good.clone();
        bad[n] ^= 0xff;
        let raw = RawOptions { dims: Some(DIMS), voxel_type: Some(VoxelType::U16), ..Default::default() };
        // Bytes 4 to 9 of a gzip header (time, flags of the packer, system) say nothing about the data.
        if !(4..10).contains(&n) {
            assert!(open(&folder.file("bad", &bad), Some(&raw)).is_err(), "byte {n}");
        }
    }
}

/// A few seeds of every format, to be damaged.
fn seeds() -> Vec<Vec<u8>> {
    let t = VoxelType::I16;
    let mut seeds = Vec::new();
    for packing in [Packing::Plain, Packing::Packed] {
        seeds.push(nrrd(t, LE, packing));
        seeds.push(metaimage(t, Endian::Big, packing));
        seeds.push(nifti(1, t, LE, packing));
        seeds.push(nifti(2, t, Endian::Big, packing));
    }
    seeds
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..2000), which in 0usize..6) {
        let folder = Folder::new();
        let prefix: &[u8] = [b"" as &[u8], b"NRRD0004\n", b"ObjectType = Image\n", &[0x1f, 0x8b, 8, 0], b"NDims = 3\n", b"\x5c\x01\0\0"][which];
        let mut file = prefix.to_vec();
        file.extend(bytes);
        let path = folder.file("x_5x4x3_uint8.raw", &file);
        let _ = open(&path, None);
        let raw = RawOptions { dims: Some([5, 4, 3]), voxel_type: Some(VoxelType::I16), ..Default::default() };
        let _ = open(&path, Some(&raw));
    }

    #[test]
    fn damaged_files_never_panic(
        seed in 0usize..8,
        damage in proptest::collection::vec((any::<u16>(), any::<u8>()), 1..20),
        cut in any::<u16>(),
    ) {
        let folder = Folder::new();
        let mut bytes = seeds()[seed].clone();
        let n = bytes.len();
        for (at, b) in damage {
            bytes[at as usize % n] = b;
        }
        bytes.truncate(n - (cut as usize % (4 * n)).min(n));
        let _ = open(&folder.file("x", &bytes), None);
    }

    #[test]
    fn arbitrary_header_lines_never_panic(lines in proptest::collection::vec(
        ("(type|dimension|sizes|encoding|endian|spacings|space directions|space origin|byte skip|line skip|data file|DimSize|NDims|ElementType|ElementSpacing|HeaderSize|ElementDataFile|TransformMatrix)",
         "[-0-9a-zA-Z(), .]{0,24}"), 0..20), meta in any::<bool>()) {
        let folder = Folder::new();
        let mut text = if meta { "ObjectType = Image\n".to_string() } else { "NRRD0004\n".to_string() };
        for (key, value) in lines {
            text += &format!("{key}{}{value}\n", if meta { " = " } else { ": " });
        }
        text += "\nsome data";
        let _ = open(&folder.file("x", text.as_bytes()), None);
    }
}
