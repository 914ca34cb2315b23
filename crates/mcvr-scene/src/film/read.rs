//! Reading image files, which others may have damaged. The decoders are libraries: what they take on trust is checked
//! before, and a panic inside one is an error of the file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use exr::image::read::layers::ReadChannels;
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::ReadLayers;
use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use mcvr_volume::open_regular;

use super::Image;
use super::file::fail;
use crate::{Extent, SceneError};

/// Most bytes that one byte of packed data unpacks to, by deflate.
const DEFLATE: u64 = 1032;
/// What a decoder may take for itself.
const SCRATCH: u64 = 1 << 20;
/// Longest header of an array; NumPy's own limit.
const NPY_HEADER: usize = 10_000;
/// Deepest nesting of brackets in it; an array of numbers needs two.
const NPY_DEPTH: usize = 8;

/// Pixels of a tile that any EXR may have, however small its picture.
const TILE: usize = 1 << 20;

/// What is said of images of three different channels.
const COLOURED: &str = "this image holds colours, and one of grey values is needed; render the scene without colours";

/// Reads an image: `.npy` (`<f8` or `<f4`, 2-D), `.exr` and `.tiff` (of equal channels), `.png` (grey level 0..1; a toned
/// PNG holds no linear values, so prefer the others for comparison). An array is known by its name, the others by their
/// content. No more memory is taken than a file of that length can fill.
///
/// # Errors
/// [`SceneError::File`] when the file is missing, no regular file, damaged, coloured or not two-dimensional.
pub fn read(path: &Path) -> Result<Image, SceneError> {
    let file = open_regular(path).map_err(|e| fail(path, e))?;
    let length = file.metadata().map_err(|e| fail(path, e))?.len();
    let read = || match path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy")) {
        true => read_npy(file, length),
        false => decode(file, length),
    };
    let image = catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(|_| Err("damaged: its decoder gave up".into()));
    image.map_err(|e| fail(path, e))
}

/// Reads every channel of an EXR file by its name, as in `R`, `stderr.Y`: what [`write_with_error`](super::write_with_error) wrote.
/// No more memory is taken than a file of that length can fill.
///
/// # Errors
/// [`SceneError::File`] when the file is missing, no regular file, no EXR or damaged.
pub fn read_layers(path: &Path) -> Result<BTreeMap<String, Image>, SceneError> {
    let file = open_regular(path).map_err(|e| fail(path, e))?;
    let length = file.metadata().map_err(|e| fail(path, e))?.len();
    let layers = catch_unwind(AssertUnwindSafe(|| layers(file, length)));
    layers.unwrap_or_else(|_| Err("damaged: its decoder gave up".into())).map_err(|e| fail(path, e))
}

fn layers(file: File, length: u64) -> Result<BTreeMap<String, Image>, String> {
    let mut file = BufReader::new(file);
    check_exr(&mut file, length)?;
    let reader = exr::prelude::read().no_deep_data().largest_resolution_level().all_channels();
    let found = reader.all_layers().all_attributes().from_buffered(file).map_err(|e| e.to_string())?;
    let mut images = BTreeMap::new();
    for layer in found.layer_data {
        // A part has a name of its own, where a file has several.
        let part = layer.attributes.layer_name.map(|name| format!("{name}.")).unwrap_or_default();
        for channel in layer.channel_data.list {
            let values = channel.sample_data.values_as_f32().map(f64::from).collect();
            let name = format!("{part}{}", channel.name);
            let image = image(layer.size.width() as u64, layer.size.height() as u64, values);
            images.insert(name.clone(), image.map_err(|e| format!("channel {name}: {e}"))?);
        }
    }
    Ok(images)
}

fn decode(file: File, length: u64) -> Result<Image, String> {
    let mut reader = ImageReader::new(BufReader::new(file)).with_guessed_format().map_err(|e| e.to_string())?;
    if let Some(format @ (ImageFormat::Tiff | ImageFormat::OpenExr)) = reader.format() {
        let mut file = reader.into_inner();
        if format == ImageFormat::Tiff {
            check_tiff(&mut file, length)?;
        } else {
            check_exr(&mut file, length)?;
        }
        reader = ImageReader::with_format(file, format);
    }
    let ratio = match reader.format() {
        // A byte may hold eight pixels, each of which becomes a byte.
        Some(ImageFormat::Png) => DEFLATE * 8,
        Some(ImageFormat::OpenExr | ImageFormat::Tiff) => DEFLATE,
        _ => return Err("is no image in PNG, EXR or TIFF (an array must be called .npy)".into()),
    };
    let mut limits = Limits::default();
    limits.max_alloc = Some(length.saturating_mul(ratio).saturating_add(SCRATCH));
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| e.to_string())?;
    if decoded.color().has_color() {
        let grey = match &decoded {
            DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
                decoded.to_rgb32f().pixels().all(|p| p.0.iter().all(|v| v.to_bits() == p.0[0].to_bits()))
            }
            other => other.to_rgb16().pixels().all(|p| p.0[0] == p.0[1] && p.0[0] == p.0[2]),
        };
        if !grey {
            return Err(COLOURED.into());
        }
    }
    let values = match &decoded {
        DynamicImage::ImageLuma16(b) => b.iter().map(|&v| f64::from(v) / 65535.0).collect(),
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
            decoded.to_rgb32f().pixels().map(|p| f64::from(p.0[0])).collect()
        }
        other => other.to_luma8().iter().map(|&v| f64::from(v) / 255.0).collect(),
    };
    image(decoded.width().into(), decoded.height().into(), values)
}

/// Refuses a TIFF whose first directory promises more values than the file has bytes: the decoder takes some 50 bytes for each.
/// Leaves the file at its start.
fn check_tiff(file: &mut (impl Read + Seek), length: u64) -> Result<(), String> {
    let broken = |e: std::io::Error| format!("truncated: its directory breaks off ({e})");
    let mut head = [0; 16];
    file.read_exact(&mut head).map_err(broken)?;
    let little = head.starts_with(b"II");
    let number = |bytes: &[u8]| {
        let digit = |n: u64, b: &u8| n << 8 | u64::from(*b);
        if little { bytes.iter().rev().fold(0, digit) } else { bytes.iter().fold(0, digit) }
    };
    // The large kind has numbers of 8 bytes for 4, and of 8 for the 2 of the number of entries.
    let large = number(&head[2..4]) == 43;
    let (start, entries, size, count) =
        if large { (number(&head[8..16]), 8, 20, 4..12) } else { (number(&head[4..8]), 2, 12, 4..8) };
    file.seek(SeekFrom::Start(start)).map_err(broken)?;
    let mut buffer = [0; 20];
    file.read_exact(&mut buffer[..entries]).map_err(broken)?;
    for _ in 0..number(&buffer[..entries]) {
        file.read_exact(&mut buffer[..size]).map_err(broken)?;
        let (tag, values) = (number(&buffer[..2]), number(&buffer[count.clone()]));
        if values > length {
            return Err(format!("tag {tag} promises {values} values and the file has {length} bytes"));
        }
    }
    file.rewind().map_err(broken)
}

/// Refuses an EXR that promises more pixels than a file of its length can hold, and one with tiles much larger than its picture: the
/// decoder takes memory for whole blocks and tiles, whatever the file holds of them and whatever window is shown. Leaves
/// the file at its start.
fn check_exr(file: &mut (impl Read + Seek), length: u64) -> Result<(), String> {
    let meta = MetaData::read_from_buffered(&mut *file, false).map_err(|e| e.to_string())?;
    let bytes = meta.headers.iter().fold(0u64, |sum, header| {
        let values = (header.layer_size.width() as u64).saturating_mul(header.layer_size.height() as u64);
        sum.saturating_add(values.saturating_mul(4 * header.channels.list.len() as u64))
    });
    if bytes > length.saturating_mul(DEFLATE).saturating_add(SCRATCH) {
        return Err(format!("promises {bytes} bytes of pixels, more than a file of {length} bytes can hold"));
    }
    for header in &meta.headers {
        if let BlockDescription::Tiles(tiles) = header.blocks {
            let (tile, picture) = (tiles.tile_size, header.layer_size);
            let pixels = |width: usize, height: usize| width.saturating_mul(height);
            if pixels(tile.width(), tile.height()) > pixels(picture.width(), picture.height()).max(TILE) {
                return Err(format!(
                    "tiles of {} x {} pixels in a picture of {} x {}",
                    tile.width(),
                    tile.height(),
                    picture.width(),
                    picture.height()
                ));
            }
        }
    }
    file.rewind().map_err(|e| e.to_string())
}

fn image(width: u64, height: u64, values: Vec<f64>) -> Result<Image, String> {
    let extent = Extent::new(width as usize, height as usize).map_err(|e| e.to_string())?;
    Image::from_values(extent, values).map_err(|e| e.to_string())
}

/// The header of an array, as long as it says it is: the library would take memory for four gigabytes of it, and descend
/// as deep as it has brackets.
fn npy_header(file: &mut impl Read) -> Result<Vec<u8>, String> {
    let truncated = |e: std::io::Error| format!("truncated: the header breaks off ({e})");
    let mut header = vec![0; 12];
    file.read_exact(&mut header).map_err(truncated)?;
    // Version 1 has a length of two bytes, later ones of four.
    let (start, length) = match header[6] {
        0 | 1 => (10, u32::from(u16::from_le_bytes([header[8], header[9]])) as usize),
        _ => (12, u32::from_le_bytes([header[8], header[9], header[10], header[11]]) as usize),
    };
    if !header.starts_with(b"\x93NUMPY") || !(12..=NPY_HEADER).contains(&(start + length)) {
        return Err(format!("is no .npy array, or has a header longer than {NPY_HEADER} bytes"));
    }
    let read = header.len();
    header.resize(start + length, 0);
    file.read_exact(&mut header[read..]).map_err(truncated)?;
    let mut depth = 0usize;
    for b in &header[start..] {
        match b {
            b'(' | b'[' | b'{' => depth += 1,
            b')' | b']' | b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth > NPY_DEPTH {
            return Err(format!("the header nests brackets deeper than {NPY_DEPTH}"));
        }
    }
    Ok(header)
}

fn read_npy(file: File, length: u64) -> Result<Image, String> {
    let mut file = BufReader::new(file);
    let header = npy_header(&mut file)?;
    let data = length.saturating_sub(header.len() as u64);
    let npy = npyz::NpyFile::new(Cursor::new(header).chain(file)).map_err(|e| e.to_string())?;
    if let [_, _, 3] = npy.shape() {
        return Err(COLOURED.into());
    }
    let &[height, width] = npy.shape() else {
        return Err(format!("expected a (height, width) array, found shape {:?}", npy.shape()));
    };
    if npy.order() != npyz::Order::C {
        return Err("Fortran order is not supported; save with numpy.ascontiguousarray".into());
    }
    let pixels = Extent::new(width as usize, height as usize).map_err(|e| e.to_string())?.pixels() as u64;
    let kind = npy.dtype();
    if kind.num_bytes().and_then(|n| pixels.checked_mul(n as u64)) != Some(data) {
        let kind = kind.descr();
        return Err(format!("the header promises {height} x {width} values of {kind}, but {data} bytes follow it"));
    }
    let values = match npy.try_data::<f64>() {
        Ok(data) => data.collect::<Result<Vec<f64>, _>>().map_err(|e| e.to_string())?,
        Err(npy) => match npy.try_data::<f32>() {
            Ok(data) => data.map(|v| v.map(f64::from)).collect::<Result<_, _>>().map_err(|e| e.to_string())?,
            Err(_) => return Err(format!("array type {} is not supported; save as float64 or float32", kind.descr())),
        },
    };
    image(width, height, values)
}
