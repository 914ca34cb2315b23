//! Animations of grey frames.

use std::path::Path;

use gif::{Encoder, Frame, Repeat};

use super::file::write_whole;
use crate::{Extent, SceneError};

/// Most frames a second that a GIF can ask for and viewers honour: two hundredths of a second each.
pub const GIF_RATE_LIMIT: u16 = 50;

/// Writes 8-bit grey frames, each of `extent`, as a GIF that repeats for ever, `rate` frames a second on average: GIFs count
/// in hundredths of a second. All 256 grey levels are kept.
///
/// # Errors
/// As [`write()`](super::write()); also for no frames, a side beyond 65535, a frame of another size, or a rate of 0 or beyond
/// [`GIF_RATE_LIMIT`].
pub fn write_gif(frames: &[Vec<u8>], extent: Extent, path: &Path, rate: u16) -> Result<(), SceneError> {
    write_whole(path, |out| {
        if frames.is_empty() || frames.iter().any(|f| f.len() != extent.pixels()) {
            return Err(format!("{} frames: at least one, each of {extent} pixels", frames.len()));
        }
        if !(1..=GIF_RATE_LIMIT).contains(&rate) {
            return Err(format!("{rate} frames a second: a GIF has 1 to {GIF_RATE_LIMIT}; use an animated PNG"));
        }
        let side = |n: usize| u16::try_from(n).map_err(|_| format!("{extent} pixels: a GIF has sides up to 65535"));
        let (width, height) = (side(extent.width)?, side(extent.height)?);
        let greys: Vec<u8> = (0..=255u8).flat_map(|g| [g; 3]).collect();
        let fail = |e: gif::EncodingError| e.to_string();
        let mut encoder = Encoder::new(out, width, height, &greys).map_err(fail)?;
        encoder.set_repeat(Repeat::Infinite).map_err(fail)?;
        // The hundredth at which a frame begins, rounded, so that delays of 8 and 9 add up to the rate.
        let begins = |frame: usize| (200 * frame + usize::from(rate)) / (2 * usize::from(rate));
        for (number, grey) in frames.iter().enumerate() {
            let delay = begins(number + 1) - begins(number);
            let frame = Frame { delay: delay as u16, width, height, buffer: grey.into(), ..Frame::default() };
            encoder.write_frame(&frame).map_err(fail)?;
        }
        encoder.into_inner().map(drop).map_err(fail)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(n: usize, extent: Extent) -> Vec<Vec<u8>> {
        (0..n).map(|f| (0..extent.pixels()).map(|i| (i * 7 + f * 31) as u8).collect()).collect()
    }

    #[test]
    fn a_gif_reads_back_grey_by_grey_and_turns_for_ever_at_its_rate() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        let extent = Extent::new(23, 17).unwrap();
        let written = frames(24, extent);
        for rate in [1, 12, 30, 50] {
            write_gif(&written, extent, &path, rate).unwrap();
            let mut options = gif::DecodeOptions::new();
            options.set_color_output(gif::ColorOutput::RGBA);
            let mut reader = options.read_info(std::fs::File::open(&path).unwrap()).unwrap();
            let mut hundredths = 0;
            for grey in &written {
                let frame = reader.read_next_frame().unwrap().unwrap();
                let rgba: Vec<u8> = grey.iter().flat_map(|g| [*g, *g, *g, 255]).collect();
                assert_eq!(*frame.buffer, *rgba);
                hundredths += u32::from(frame.delay);
            }
            assert!(reader.read_next_frame().unwrap().is_none());
            assert_eq!(reader.repeat(), Repeat::Infinite);
            assert!((f64::from(hundredths) - 2400.0 / f64::from(rate)).abs() <= 0.5, "{rate}: {hundredths}");
        }
    }

    #[test]
    fn what_no_gif_can_hold_is_refused_and_nothing_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        let extent = Extent::new(4, 3).unwrap();
        let long = Extent::new(65536, 1).unwrap();
        for (frames, extent, rate) in [
            (vec![], extent, 12),
            (vec![vec![0; 11]], extent, 12),
            (frames(1, extent), extent, 0),
            (frames(1, extent), extent, 51),
            (frames(1, long), long, 12),
        ] {
            assert!(write_gif(&frames, extent, &path, rate).is_err());
            assert!(!path.exists());
        }
    }
}
