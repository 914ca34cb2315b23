//! Damage that knows nothing of the format: bytes that are missing, surplus or flipped.

use super::super::{Case, CaseError, Context, Finding};
use super::case;
use super::damage::{May, Variant, judge_all};
use super::good::{GoodFile, Reader};

pub(super) const CASES: &[Case] = &[
    case(
        "file-header-cut",
        "a header that breaks off is read with zeros for the rest, or past its end",
        "cut at any byte of its header, a file is refused; only a scene or a log, whose prefix is one, may be read",
        header_cut,
    ),
    case(
        "file-data-cut",
        "the missing voxels, pixels or points are silently 0, or a short volume comes back",
        "every reader refuses a file cut at any of a hundred places of its data",
        data_cut,
    ),
    case(
        "file-surplus",
        "bytes behind the data, as of a wrong type or a joined file, are ignored",
        "volumes, arrays and clouds with surplus bytes are refused; pictures keep every pixel",
        surplus,
    ),
    case(
        "file-header-flips",
        "one flipped bit changes a size, and the reader trusts it",
        "any single bit of the header flipped: refused, or usable; a volume, array or cloud of the same size",
        header_flips,
    ),
    case(
        "file-data-flips",
        "a flipped bit of packed data goes unnoticed, or ends the reader",
        "any single bit of packed data flipped is refused by its checksum; plain data keep their size",
        data_flips,
    ),
];

/// Formats that say how long they are. A prefix of a scene or of a log is a scene or a log; that of a matrix lacks a number.
fn has_length(good: &GoodFile) -> bool {
    !matches!(good.reader, Reader::Scene | Reader::Records)
}

fn cut(good: &GoodFile, at: usize) -> Variant {
    (format!("cut at byte {at}"), good.bytes[..at].to_vec())
}

/// Exact. A picture that lacks only what follows its last pixel may be read whole; a matrix may lack its last line's end. A
/// prefix of a scene or a log may be one itself, with fewer keys or records, so those must only be read soundly.
fn header_cut(context: &Context) -> Result<Finding, CaseError> {
    let may = |good: &GoodFile| if has_length(good) { May::RefuseOrKeep } else { May::ReadSoundly };
    let tally = judge_all(context, may, |good| (0..good.header).map(|at| cut(good, at)).collect())?;
    Ok(tally.finding("cuts", "kept are pictures cut behind their last pixel and texts cut at a line's end"))
}

/// Exact: the length of every format with a header of its own is part of it, and gzip and zlib end with a checksum.
fn data_cut(context: &Context) -> Result<Finding, CaseError> {
    let cuts = |good: &GoodFile| {
        let data = good.bytes.len() - good.header;
        let places = data.min(100);
        (0..places).map(|n| cut(good, good.header + n * data / places)).collect()
    };
    Ok(judge_all(context, |_| May::Refuse, cuts)?.finding("cuts", ""))
}

/// Exact. PNG, EXR and TIFF allow what follows the picture; then no pixel may change.
fn surplus(context: &Context) -> Result<Finding, CaseError> {
    let may = |good: &GoodFile| {
        let picture = good.reader == Reader::Image && !good.text;
        if picture { May::RefuseOrKeep } else { May::Refuse }
    };
    let more = |good: &GoodFile| {
        let tails: [&[u8]; 5] = [&[0], b"\n\n0.5", &[0; 4096], &[0x1f, 0x8b], &good.bytes];
        // Text may go on, and the data of a detached header are elsewhere.
        if !has_length(good) || good.beside.is_some() {
            return vec![];
        }
        tails.iter().map(|t| (format!("{} bytes more", t.len()), [&good.bytes[..], t].concat())).collect()
    };
    Ok(judge_all(context, may, more)?.finding("files", ""))
}

fn flipped(good: &GoodFile, bit: usize) -> Variant {
    let mut bytes = good.bytes.clone();
    bytes[bit / 8] ^= 1 << (bit % 8);
    (format!("bit {} of byte {} flipped", bit % 8, bit / 8), bytes)
}

/// Exact. A text, whose content a flip may change as an editor would, must only be read soundly: a log may lose its last
/// record, a scene may name another size of picture. Sizes of volumes, pictures and clouds must agree with the data.
fn header_flips(context: &Context) -> Result<Finding, CaseError> {
    // The header of a picture lies among its data and names its size in several ways, which are its library's.
    let may = |good: &GoodFile| match good.reader {
        Reader::Scene | Reader::Records => May::ReadSoundly,
        Reader::Image if !good.text => May::ReadSoundly,
        _ => May::KeepSize,
    };
    let tally = judge_all(context, may, |good| (0..8 * good.header).map(|bit| flipped(good, bit)).collect())?;
    Ok(tally.finding("flips", ""))
}

/// Exact: the CRC of gzip and the Adler sum of zlib notice every single flipped bit, and what a flip in their framing
/// breaks is noticed by its own rules. Bytes 4 to 9 of a gzip header (time, packer, system) mean nothing to a reader.
fn data_flips(context: &Context) -> Result<Finding, CaseError> {
    let may = |good: &GoodFile| if good.sealed { May::RefuseOrKeep } else { May::KeepSize };
    let flips = |good: &GoodFile| {
        let bits = 8 * (good.bytes.len() - good.header);
        let places = bits.min(2000);
        (0..places).map(|n| flipped(good, 8 * good.header + n * bits / places)).collect()
    };
    Ok(judge_all(context, may, flips)?.finding("flips", "kept are flips in the time and system of a gzip header"))
}
