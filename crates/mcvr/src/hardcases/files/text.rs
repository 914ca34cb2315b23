//! What editors and transfers do to text, and files that are something else.

use super::super::{Case, CaseError, Context, Finding};
use super::case;
use super::damage::{May, Tally, Variant, judge, judge_all, place};
use super::good::{GoodFile, Reader, good_files};

pub(super) const CASES: &[Case] = &[
    case(
        "file-line-ends",
        "a carriage return stays in the last word of a line, so that the value is not understood or the data are off by one",
        "text with LF, CRLF and both mixed reads the same; with CR alone it is refused, or the same",
        line_ends,
    ),
    case(
        "file-byte-order-mark",
        "three invisible bytes hide the magic, and the header is read as voxels",
        "a byte order mark in front is refused, or changes nothing",
        byte_order_mark,
    ),
    case(
        "file-foreign-bytes",
        "bytes that are no UTF-8, zeros or control characters in a header end the reader",
        "each byte of each text header replaced by four such bytes: refused, or usable and of the same size",
        foreign_bytes,
    ),
    case(
        "file-wrong-magic",
        "a picture opens as a volume, a volume as a log; or the message blames a field that is not there",
        "every reader refuses every file of another kind",
        wrong_magic,
    ),
];

/// Texts whose lines end in their header: not the one line of JSON in a cloud or an array.
fn has_lines(good: &GoodFile) -> bool {
    good.text && !matches!(good.reader, Reader::Cloud | Reader::Image)
}

/// The header with the end of each line as `end` says for its number.
fn with_ends(good: &GoodFile, end: impl Fn(usize) -> &'static [u8]) -> Vec<u8> {
    let (mut bytes, mut n) = (vec![], 0);
    for &b in &good.bytes[..good.header] {
        if b == b'\n' {
            bytes.extend(end(n));
            n += 1;
        } else {
            bytes.push(b);
        }
    }
    bytes.extend(&good.bytes[good.header..]);
    bytes
}

/// Exact. With CR alone a header is one endless line.
fn line_ends(context: &Context) -> Result<Finding, CaseError> {
    let (unix, dos, mac): (&[u8], &[u8], &[u8]) = (b"\n", b"\r\n", b"\r");
    let kept = |good: &GoodFile| -> Vec<Variant> {
        if !has_lines(good) {
            return vec![];
        }
        vec![
            ("CRLF".into(), with_ends(good, |_| dos)),
            ("LF and CRLF in turn".into(), with_ends(good, |n| if n % 2 == 0 { unix } else { dos })),
            ("CRLF first".into(), with_ends(good, |n| if n == 0 { dos } else { unix })),
            ("CRLF last".into(), with_ends(good, |n| if n > 5 { dos } else { unix })),
        ]
    };
    let mut total = judge_all(context, |_| May::Keep, kept)?;
    total += judge_all(
        context,
        |_| May::RefuseOrKeep,
        |good| if has_lines(good) { vec![("CR".into(), with_ends(good, |_| mac))] } else { vec![] },
    )?;
    Ok(total.finding("texts", ""))
}

/// Exact.
fn byte_order_mark(context: &Context) -> Result<Finding, CaseError> {
    let marked = |good: &GoodFile| {
        let marks: [&[u8]; 3] = [b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff"];
        marks.iter().map(|mark| (format!("mark {mark:x?}"), [mark, &good.bytes[..]].concat())).collect()
    };
    Ok(judge_all(context, |_| May::RefuseOrKeep, marked)?.finding("files", ""))
}

/// Exact. Texts that a person edits must be read soundly, sizes of all others be kept.
fn foreign_bytes(context: &Context) -> Result<Finding, CaseError> {
    let may = |good: &GoodFile| match good.reader {
        Reader::Scene | Reader::Records => May::ReadSoundly,
        _ => May::KeepSize,
    };
    let vary = |good: &GoodFile| {
        let mut all: Vec<Variant> = vec![];
        for at in 0..if good.text { good.header } else { 0 } {
            for byte in [0x00, 0x1b, 0x80, 0xff] {
                let mut bytes = good.bytes.clone();
                bytes[at] = byte;
                all.push((format!("byte {at} as {byte:#04x}"), bytes));
            }
        }
        all
    };
    Ok(judge_all(context, may, vary)?.finding("files", ""))
}

/// Exact: formats × readers. A volume reader also takes headerless data, but only where name or options describe them.
fn wrong_magic(context: &Context) -> Result<Finding, CaseError> {
    let folder = context.folder()?;
    let files = good_files(folder.path())?;
    let mut total = Tally::default();
    for good in &files {
        for other in files.iter().filter(|o| o.reader != good.reader) {
            // A headerless file is known by its name alone.
            if !other.format.starts_with("raw") {
                let variant = (format!("a {} under its name", good.format), good.bytes.clone());
                total += judge(context, other, May::Refuse, &[variant])?;
            }
        }
    }
    let noise: Vec<u8> = (0..4096u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    for good in files.iter().filter(|g| !g.format.starts_with("raw")) {
        let path = place(good, folder.path())?;
        std::fs::write(&path, &noise)?;
        // The last line of a log may be torn by a kill, so a log of one line is an empty one.
        let may = if good.reader == Reader::Records { May::ReadSoundly } else { May::Refuse };
        total.judge(&format!("noise as {}", good.format), &path, good.reader, may, None);
    }
    Ok(total.finding("files", ""))
}
