//! From a file's bytes to typed voxels: in place where possible, else inflated and swapped, never more memory than
//! the header's size once that is known to be possible.

use std::io::Read;

use rayon::prelude::*;

use super::inflate::{Coding, MAX_DEFLATE_RATIO, read_up_to, unpack};
use super::options::Endian;
use super::source::Source;
use crate::{Buffer, VolumeError, Voxel, VoxelType, Voxels};

/// Where a file's voxels are and what they are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Payload {
    /// First byte in the file.
    pub(crate) start: usize,
    /// How the bytes from `start` to the file's end are packed.
    pub(crate) coding: Coding,
    /// Bytes to drop before the first voxel, counted after decompression.
    pub(crate) skip: u64,
    /// Number of voxels.
    pub(crate) count: usize,
    /// Their type.
    pub(crate) voxel_type: VoxelType,
    /// Their byte order.
    pub(crate) endian: Endian,
}

/// Size of the (decompressed) data that was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Found {
    /// Exactly so many bytes.
    Exactly(u64),
    /// At least so many: counting stopped there.
    AtLeast(u64),
    /// At most so many: no compressed stream of this length can hold more.
    AtMost(u64),
}

/// Why no voxels came out.
pub(crate) enum PayloadError {
    /// Another number of bytes than `skip + count * bytes`.
    Size { expected: u64, found: Found },
    /// Anything else.
    Other(VolumeError),
}

impl From<VolumeError> for PayloadError {
    fn from(e: VolumeError) -> Self {
        Self::Other(e)
    }
}

impl PayloadError {
    /// The error of a format whose header states the size.
    pub(crate) fn into_volume_error(self, source: &Source) -> VolumeError {
        match self {
            PayloadError::Other(e) => e,
            PayloadError::Size { expected, found } => source.size_error(match found {
                Found::Exactly(n) if n < expected => format!(
                    "truncated: the header asks for {expected} bytes of data, the file has {n}; {} are missing",
                    expected - n
                ),
                Found::Exactly(n) => format!(
                    "over-long: the header asks for {expected} bytes of data, the file has {n}; {} too many",
                    n - expected
                ),
                Found::AtLeast(n) => {
                    format!("over-long: the header asks for {expected} bytes of data, the file has at least {n}")
                }
                Found::AtMost(n) => format!(
                    "the header asks for {expected} bytes of data, but the compressed data can hold at most {n}"
                ),
            }),
        }
    }
}

/// Bytes of scratch space for counting and skipping.
const SCRATCH: usize = 1 << 16;
/// Bytes that are inflated between two requests for memory.
const STEP: usize = 1 << 20;

macro_rules! per_type {
    ($ty:expr, $t:ident => $body:expr) => {
        match $ty {
            VoxelType::U8 => {
                type $t = u8;
                $body
            }
            VoxelType::I8 => {
                type $t = i8;
                $body
            }
            VoxelType::U16 => {
                type $t = u16;
                $body
            }
            VoxelType::I16 => {
                type $t = i16;
                $body
            }
            VoxelType::U32 => {
                type $t = u32;
                $body
            }
            VoxelType::I32 => {
                type $t = i32;
                $body
            }
            VoxelType::F32 => {
                type $t = f32;
                $body
            }
            VoxelType::F64 => {
                type $t = f64;
                $body
            }
        }
    };
}

/// Reads the voxels of `source`.
///
/// # Errors
/// [`PayloadError::Size`] when the size differs by a byte; otherwise damaged compressed data or no memory.
pub(crate) fn read(source: &Source, payload: &Payload) -> Result<Voxels, PayloadError> {
    per_type!(payload.voxel_type, T => read_as::<T>(source, payload).map(T::wrap))
}

fn read_as<T: Voxel>(source: &Source, p: &Payload) -> Result<Buffer<T>, PayloadError> {
    let packed = source.bytes().get(p.start..).unwrap_or(&[]);
    let too_large =
        || source.size_error(format!("{} voxels of {} after {} bytes are too many", p.count, T::TYPE, p.skip));
    let data = (p.count as u64).checked_mul(size_of::<T>() as u64).ok_or_else(too_large)?;
    let expected = data.checked_add(p.skip).ok_or_else(too_large)?;
    match p.coding {
        Coding::Plain => {
            if packed.len() as u64 != expected {
                return Err(PayloadError::Size { expected, found: Found::Exactly(packed.len() as u64) });
            }
            // The skip is smaller than the file, so it fits.
            let skip = p.skip as usize;
            if (!p.endian.is_swapped() || size_of::<T>() == 1)
                && let Some(buffer) = Buffer::mapped(source.map().clone(), p.start + skip, p.count)
            {
                return Ok(buffer);
            }
            Ok(copy_out::<T>(source, &packed[skip..], p)?.into())
        }
        Coding::Gzip | Coding::Zlib => {
            let most = (packed.len() as u64).saturating_mul(MAX_DEFLATE_RATIO);
            if expected > most {
                return Err(PayloadError::Size { expected, found: Found::AtMost(most) });
            }
            Ok(inflate_out::<T>(source, packed, p, expected)?.into())
        }
    }
}

/// An owned, aligned, native-order copy of plain bytes.
fn copy_out<T: Voxel>(source: &Source, bytes: &[u8], p: &Payload) -> Result<Vec<T>, VolumeError> {
    let mut voxels: Vec<T> = Vec::new();
    reserve(source, &mut voxels, p.count)?;
    voxels.resize(p.count, T::zeroed());
    let step = SCRATCH / size_of::<T>();
    voxels.par_chunks_mut(step).zip(bytes.par_chunks(SCRATCH)).for_each(|(v, b)| {
        bytemuck::cast_slice_mut::<T, u8>(v).copy_from_slice(b);
        to_native(v, p.endian);
    });
    Ok(voxels)
}

/// Voxels of a compressed stream, with memory taken as the data arrives and never beyond the expected size.
fn inflate_out<T: Voxel>(source: &Source, packed: &[u8], p: &Payload, expected: u64) -> Result<Vec<T>, PayloadError> {
    let damaged = |e: std::io::Error| {
        source.size_error(match e.kind() {
            std::io::ErrorKind::UnexpectedEof => format!("truncated: the compressed data breaks off ({e})"),
            _ => format!("the compressed data is damaged: {e}"),
        })
    };
    let mut reader = unpack(packed, p.coding);
    let mut scratch = vec![0u8; SCRATCH];
    let mut skipped = 0u64;
    while skipped < p.skip {
        let want = (p.skip - skipped).min(SCRATCH as u64) as usize;
        let got = read_up_to(&mut *reader, &mut scratch[..want]).map_err(damaged)?;
        skipped += got as u64;
        if got < want {
            return Err(PayloadError::Size { expected, found: Found::Exactly(skipped) });
        }
    }
    let mut voxels: Vec<T> = Vec::new();
    while voxels.len() < p.count {
        let old = voxels.len();
        let step = (STEP / size_of::<T>()).min(p.count - old);
        if voxels.capacity() - old < step {
            reserve(source, &mut voxels, step.max(old).min(p.count - old))?;
        }
        voxels.resize(old + step, T::zeroed());
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut voxels[old..]);
        let got = read_up_to(&mut *reader, bytes).map_err(damaged)?;
        if got < bytes.len() {
            let found = skipped + (old * size_of::<T>() + got) as u64;
            return Err(PayloadError::Size { expected, found: Found::Exactly(found) });
        }
    }
    // One byte more tells an over-long stream; the rest is only counted, and not for ever. Reading to the end
    // also checks the stream's checksum.
    let limit = expected.saturating_mul(4).saturating_add(64 << 20);
    let mut extra = 0u64;
    loop {
        let got = read_up_to(&mut *reader, &mut scratch).map_err(damaged)?;
        extra += got as u64;
        if got < SCRATCH {
            break;
        }
        if extra > limit {
            return Err(PayloadError::Size { expected, found: Found::AtLeast(expected + extra) });
        }
    }
    if extra > 0 {
        return Err(PayloadError::Size { expected, found: Found::Exactly(expected + extra) });
    }
    voxels.par_chunks_mut(STEP).for_each(|v| to_native(v, p.endian));
    Ok(voxels)
}

fn reserve<T>(source: &Source, voxels: &mut Vec<T>, more: usize) -> Result<(), VolumeError> {
    voxels.try_reserve_exact(more).map_err(|_| {
        source.size_error(format!("no memory for {} more bytes of voxels", more as u64 * size_of::<T>() as u64))
    })
}

fn to_native<T: Voxel>(voxels: &mut [T], endian: Endian) {
    if endian.is_swapped() && size_of::<T>() > 1 {
        for v in voxels {
            *v = v.swap_bytes();
        }
    }
}

/// Size of a packed run after decompression, counted up to `limit`.
pub(crate) fn unpacked_size(packed: &[u8], coding: Coding, limit: u64) -> std::io::Result<Found> {
    if coding == Coding::Plain {
        return Ok(Found::Exactly(packed.len() as u64));
    }
    let mut reader = unpack(packed, coding);
    let mut scratch = vec![0u8; SCRATCH];
    let mut total = 0u64;
    loop {
        let got = reader.read(&mut scratch)?;
        if got == 0 {
            return Ok(Found::Exactly(total));
        }
        total += got as u64;
        if total > limit {
            return Ok(Found::AtLeast(total));
        }
    }
}
