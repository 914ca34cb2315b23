//! Decompression of gzip (all members) and zlib streams that stops where the caller stops reading.

use std::io::{self, Read};

use flate2::bufread::{GzDecoder, ZlibDecoder};

/// How a run of bytes is packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Coding {
    /// Not packed.
    Plain,
    /// One or more gzip members (RFC 1952).
    Gzip,
    /// One zlib stream (RFC 1950).
    Zlib,
}

/// Largest ratio of output to input that deflate can reach: 258 bytes per two bits.
pub(crate) const MAX_DEFLATE_RATIO: u64 = 1032;

/// The two bytes that every gzip file begins with.
pub(crate) const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

/// A reader over a packed slice; bytes behind the end of the packed data are an error.
struct Inflate<'a> {
    state: State<'a>,
}

enum State<'a> {
    Gzip(GzDecoder<&'a [u8]>),
    Zlib(ZlibDecoder<&'a [u8]>),
    Done,
}

/// A reader of what `packed` unpacks to; `Coding::Plain` hands the bytes through.
pub(crate) fn unpack<'a>(packed: &'a [u8], coding: Coding) -> Box<dyn Read + 'a> {
    match coding {
        Coding::Plain => Box::new(packed),
        Coding::Gzip => Box::new(Inflate { state: State::Gzip(GzDecoder::new(packed)) }),
        Coding::Zlib => Box::new(Inflate { state: State::Zlib(ZlibDecoder::new(packed)) }),
    }
}

impl Read for Inflate<'_> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        if buf.is_empty() {
            return Ok(0);
        }
        loop {
            let n = match &mut self.state {
                State::Gzip(d) => d.read(buf)?,
                State::Zlib(d) => d.read(buf)?,
                State::Done => return Ok(0),
            };
            if n > 0 {
                return Ok(n);
            }
            let rest = match std::mem::replace(&mut self.state, State::Done) {
                State::Gzip(d) => {
                    let rest = d.into_inner();
                    if rest.starts_with(&GZIP_MAGIC) {
                        self.state = State::Gzip(GzDecoder::new(rest));
                        continue;
                    }
                    rest
                }
                State::Zlib(d) => d.into_inner(),
                State::Done => &[],
            };
            if !rest.is_empty() {
                return Err(io::Error::new(
                    io::ErrorKind::InvalidData,
                    format!("{} bytes follow the end of the compressed data", rest.len()),
                ));
            }
            return Ok(0);
        }
    }
}

/// Reads until `buf` is full or the data ends; the number of bytes read.
pub(crate) fn read_up_to(reader: &mut dyn Read, buf: &mut [u8]) -> io::Result<usize> {
    let mut done = 0;
    while done < buf.len() {
        match reader.read(&mut buf[done..]) {
            Ok(0) => break,
            Ok(n) => done += n,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(done)
}
