//! Values that no honest file has, in every field.

use mcvr_volume::open;

use super::super::{Case, CaseError, Context, Finding};
use super::case;
use super::damage::{May, Tally, Variant, judge, judge_all, place};
use super::good::{GoodFile, Reader, good_files};

pub(super) const CASES: &[Case] = &[
    case(
        "file-text-values",
        "a number like 1e99, NaN or one of a megabyte of digits overflows, hangs or is taken as it is",
        "each word of each text header replaced by extreme values: refused, or usable and of the same size",
        text_values,
    ),
    case(
        "file-binary-values",
        "an offset or extent of -1, 2^63 or NaN is used before it is checked",
        "each number of each binary header replaced by extreme values: refused, or usable",
        binary_values,
    ),
    case(
        "file-extents",
        "the product of the extents wraps to the number of voxels that the file has",
        "extents that are 0, negative, missing or wrap around are refused",
        extents,
    ),
    case(
        "file-geometry",
        "a spacing of 0, -1 or NaN or a singular direction gives NaN for every coordinate",
        "such geometry is refused, or replaced with a note that says so",
        geometry,
    ),
];

/// What stands in place of a word.
fn extremes() -> Vec<Vec<u8>> {
    let words = [
        "",
        "0",
        "-0",
        "-1",
        "1e99",
        "-1e308",
        "1e999",
        "1e-320",
        "nan",
        "inf",
        "-inf",
        "9223372036854775807",
        "9223372036854775808",
        "18446744073709551616",
        "4294967297",
        "0x10",
        "1 1",
        "\0",
        "\u{fffd}",
        "\"",
        "[[[[",
    ];
    let mut all: Vec<Vec<u8>> = words.iter().map(|w| w.as_bytes().to_vec()).collect();
    all.push(b"\xff\xfe".to_vec());
    all.push(vec![b'('; 5000]);
    all
}

/// The words of a text header: letters, digits and what numbers are made of.
fn words(good: &GoodFile) -> Vec<std::ops::Range<usize>> {
    let part = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'-' | b'+' | b'_');
    let start = match good.reader {
        Reader::Cloud => 16,
        Reader::Image => 10,
        _ => 0,
    };
    let (mut all, mut from) = (vec![], None);
    for at in start..=good.header {
        let inside = at < good.header && part(good.bytes[at]);
        match (inside, from) {
            (true, None) => from = Some(at),
            (false, Some(first)) => {
                all.push(first..at);
                from = None;
            }
            _ => {}
        }
    }
    all
}

/// Exact. A text that an editor may change in this way must only be read soundly; a volume, an array, a cloud or a matrix
/// keeps its size. A megabyte of digits, nines and zeros behind a point, is tried once per file in place of each tenth word,
/// because it takes as long to write as all others together.
fn text_values(context: &Context) -> Result<Finding, CaseError> {
    let may = |good: &GoodFile| match good.reader {
        Reader::Scene | Reader::Records => May::ReadSoundly,
        _ => May::KeepSize,
    };
    let extremes = extremes();
    let long: [Vec<u8>; 2] = [vec![b'9'; 1 << 20], [b"0.", &vec![b'0'; 1 << 20][..], b"1"].concat()];
    let vary = |good: &GoodFile| {
        if !good.text {
            return vec![];
        }
        let mut all: Vec<Variant> = vec![];
        for (n, word) in words(good).into_iter().enumerate() {
            let old = String::from_utf8_lossy(&good.bytes[word.clone()]).into_owned();
            let replaced = |value: &Vec<u8>| {
                let shown: String = String::from_utf8_lossy(value).chars().take(20).collect();
                (format!("'{old}' as '{shown}'"), good.with(word.clone(), value))
            };
            all.extend(extremes.iter().map(replaced));
            if n % 10 == 3 {
                all.extend(long.iter().map(replaced));
            }
        }
        all
    };
    Ok(judge_all(context, may, vary)?.finding("values", ""))
}

/// Exact. Every number of 2, 4 or 8 bytes at a multiple of its size, in both byte orders.
fn binary_values(context: &Context) -> Result<Finding, CaseError> {
    let vary = |good: &GoodFile| {
        if good.text && good.reader != Reader::Cloud || good.header == 0 {
            return vec![];
        }
        let header = if good.reader == Reader::Cloud { 16 } else { good.header };
        let mut all = vec![];
        for width in [2, 4, 8] {
            for at in (0..=header - width).step_by(width) {
                for (name, value) in numbers(width) {
                    let mut bytes = good.bytes.clone();
                    bytes[at..at + width].copy_from_slice(&value);
                    all.push((format!("{name} in bytes {at} to {}", at + width), bytes));
                }
            }
        }
        all
    };
    Ok(judge_all(context, |_| May::ReadSoundly, vary)?.finding("values", ""))
}

/// Extreme numbers of a width, little-endian, then big-endian where that differs.
fn numbers(width: usize) -> Vec<(&'static str, Vec<u8>)> {
    let mut all = vec![("0", vec![0; width]), ("-1", vec![0xff; width])];
    let mut both = |name, value: &[u8]| {
        all.push((name, value.to_vec()));
        all.push((name, value.iter().rev().copied().collect()));
    };
    let top = |byte: u8, rest: u8| [&vec![rest; width - 1][..], &[byte]].concat();
    both("the largest", &top(0x7f, 0xff));
    both("the smallest", &top(0x80, 0));
    match width {
        4 => {
            both("NaN", &f32::NAN.to_le_bytes());
            both("1e30", &1e30f32.to_le_bytes());
        }
        8 => {
            both("infinity", &f64::INFINITY.to_le_bytes());
            both("1e300", &1e300f64.to_le_bytes());
        }
        _ => {}
    }
    all
}

/// The files of text headers, plain, in which a line's value can be replaced: the format's name for the field comes with
/// the value.
fn with_lines(
    context: &Context,
    lines: &[(&str, &str, &str)],
    mut judged: impl FnMut(&GoodFile, &str, Vec<u8>) -> Result<(), CaseError>,
) -> Result<(), CaseError> {
    let folder = context.folder()?;
    for good in good_files(folder.path())? {
        for (format, key, value) in lines.iter().filter(|l| good.format.starts_with(l.0)) {
            let text = &good.bytes[..good.header];
            let from = text.windows(key.len()).position(|w| w == key.as_bytes());
            let from = from.ok_or_else(|| format!("{format} has no field {key}"))? + key.len();
            let to = from + text[from..].iter().position(|&b| b == b'\n').unwrap_or(0);
            judged(&good, &format!("{key}{value}"), good.with(from..to, value.as_bytes()))?;
        }
    }
    Ok(())
}

/// Exact. 19 × 5825287602224068944 is 240 modulo 2^64, the number of voxels in the file.
fn extents(context: &Context) -> Result<Finding, CaseError> {
    let sizes = [
        "0 6 5",
        "8 0 5",
        "8 6 0",
        "-8 6 5",
        "-8 -6 5",
        "8 6",
        "8 6 5 1",
        "8",
        "",
        "8 6 5.0",
        "8 6 5x",
        "8,6,5",
        "9223372036854775807 2 1",
        "4294967296 4294967296 240",
        "1099511627776 2 1",
        "18446744073709551616 1 1",
        "48 5 1 1",
        "19 5825287602224068944 1",
        "1 1 9223372036854775807",
    ];
    let mut total = Tally::default();
    total.check("the product that wraps", 19u64.wrapping_mul(5825287602224068944) == 240);
    let lines: Vec<_> =
        sizes.iter().flat_map(|s| [("NRRD", "\nsizes: ", *s), ("MetaImage", "\nDimSize = ", *s)]).collect();
    with_lines(context, &lines, |good, what, bytes| {
        total += judge(context, good, May::Refuse, &[(what.to_owned(), bytes)])?;
        Ok(())
    })?;
    Ok(total.finding("headers", "a product in 64 bits without checks wraps to what the file holds"))
}

/// Exact. Only an unknown spacing (NaN in NRRD) has a stated stand-in of 1 mm.
fn geometry(context: &Context) -> Result<Finding, CaseError> {
    let lines = [
        ("NRRD", "\nspace directions: ", "(0,0,0) (0,1,0) (0,0,2)"),
        ("NRRD", "\nspace directions: ", "(1,0,0) (2,0,0) (0,0,2)"),
        ("NRRD", "\nspace directions: ", "(nan,0,0) (0,1,0) (0,0,2)"),
        ("NRRD", "\nspace directions: ", "(1e200,0,0) (0,1e200,0) (0,0,2)"),
        ("NRRD", "\nspace directions: ", "(1e-160,0,0) (0,1e-160,0) (0,0,2)"),
        ("NRRD", "\nspace directions: ", "(1e150,0,0) (0,1e150,0) (0,0,1e150)"),
        ("NRRD", "\nspace directions: ", "none (0,1,0) (0,0,2)"),
        ("NRRD", "\nspace origin: ", "(nan,0,0)"),
        ("NRRD", "\nspace origin: ", "(0,inf,0)"),
        ("MetaImage", "\nElementSpacing = ", "0 1 1"),
        ("MetaImage", "\nElementSpacing = ", "1 -1 1"),
        ("MetaImage", "\nElementSpacing = ", "1 1 nan"),
        ("MetaImage", "\nElementSpacing = ", "inf 1 1"),
        ("MetaImage", "\nElementSpacing = ", "1e-320 1 1"),
        ("MetaImage", "\nElementSpacing = ", "1e120 1e120 1e120"),
        ("MetaImage", "\nElementSpacing = ", "1e-120 1e-120 1e-120"),
        ("MetaImage", "\nTransformMatrix = ", "1 0 0 1 0 0 0 0 1"),
        ("MetaImage", "\nTransformMatrix = ", "0 0 0 0 0 0 0 0 0"),
        ("MetaImage", "\nTransformMatrix = ", "nan 0 0 0 1 0 0 0 1"),
        ("MetaImage", "\nOffset = ", "nan nan nan"),
        ("MetaImage", "\nOffset = ", "0 0 1e999"),
    ];
    let mut total = Tally::default();
    with_lines(context, &lines, |good, what, bytes| {
        total += judge(context, good, May::Refuse, &[(what.to_owned(), bytes)])?;
        Ok(())
    })?;
    // Spacings of NRRD without directions, and those of NIfTI, may be unknown.
    let folder = context.folder()?;
    for good in good_files(folder.path())?.iter().filter(|g| matches!(g.format, "NRRD" | "NIfTI-1" | "NIfTI-2")) {
        let mut bytes = good.bytes.clone();
        if good.text {
            let text = String::from_utf8_lossy(&bytes[..good.header]).into_owned();
            let line = text.lines().find(|l| l.starts_with("space directions")).unwrap_or("").to_owned();
            bytes.splice(..good.header, text.replace(&line, "spacings: nan 1 1").bytes());
        } else {
            let (at, nan) = if good.format == "NIfTI-1" { (80, 4) } else { (112, 8) };
            bytes[at..at + nan].fill(0xff);
        }
        let path = place(good, folder.path())?;
        std::fs::write(&path, bytes)?;
        let told = open(&path, None).is_ok_and(|l| {
            l.volume.grid().spacing().x == 1.0 && l.notes.iter().any(|n| n.contains("NaN") && n.contains("1 mm"))
        });
        total.check(&format!("{}, an unknown spacing without its note", good.format), told);
    }
    Ok(total.finding("headers", "a spacing of NaN (unknown) is 1 mm, with a note, in NRRD and NIfTI"))
}
