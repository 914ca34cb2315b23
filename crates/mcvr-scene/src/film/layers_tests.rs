use super::super::{read, read_layers};
use super::*;

const NAMES: [&str; 4] = ["stderr.Y", "low.Y", "high.Y", "unresolved.Y"];

/// Values that no two layers, channels or pixels share; every third pixel is unresolved.
fn image(key: usize) -> Image {
    let extent = Extent::new(7, 5).unwrap();
    let values =
        (0..35).map(|i| if key % 10 == 9 { f64::from(i % 3 == 0) } else { (i as f64 + 0.1) / (key + 3) as f64 });
    Image::from_values(extent, values.collect()).unwrap()
}

fn layers(channel: usize) -> [Image; 4] {
    [6, 7, 8, 9].map(|layer| image(10 * channel + layer))
}

fn bars(layers: &[Image; 4]) -> ErrorBars<'_> {
    let [error, low, high, unresolved] = layers;
    ErrorBars { error, low, high, unresolved }
}

/// As a 32-bit float has it.
fn single(image: &Image) -> Vec<f64> {
    image.values().iter().map(|v| f64::from(*v as f32)).collect()
}

fn colours() -> [Image; 3] {
    [image(0), image(1), image(2)]
}

#[test]
fn a_grey_exr_gives_back_every_layer_to_the_bit_and_readers_of_pictures_still_read_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let layers = layers(0);
    write_with_error(&[image(1)], &[bars(&layers)], 0.95, &path, ImageFormat::Exr, &Tone::default()).unwrap();
    let found = read_layers(&path).unwrap();
    let names: Vec<&str> = found.keys().map(String::as_str).collect();
    assert_eq!(names, ["B", "G", "R", "high.Y", "low.Y", "stderr.Y", "unresolved.Y"]);
    for (name, layer) in NAMES.iter().zip(&layers) {
        assert_eq!(found[*name].extent(), layer.extent());
        assert_eq!(found[*name].values(), single(layer), "{name}");
    }
    let flags = &found["unresolved.Y"];
    assert!((flags.get(0, 0), flags.get(1, 0), flags.get(6, 4)) == (1.0, 0.0, 0.0) && flags.sum() == 12.0);
    assert_eq!(read(&path).unwrap().values(), single(&image(1)), "our own reader");
    let plain = folder.path().join("plain.exr");
    write(&image(1), &plain, ImageFormat::Exr, &Tone::default()).unwrap();
    assert_eq!(image::open(&path).unwrap(), image::open(&plain).unwrap(), "the same picture as without bars");
}

#[test]
fn the_level_of_the_intervals_stands_in_the_header() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let layers = layers(0);
    write_error(&[bars(&layers)], 0.99, &path, ImageFormat::Exr, &Tone::default()).unwrap();
    let meta = exr::meta::MetaData::read_from_file(&path, false).unwrap();
    let attributes = &meta.headers[0].own_attributes;
    assert_eq!(attributes.other[&Text::from("confidence")], AttributeValue::F64(0.99));
    assert!(attributes.comments.as_ref().unwrap().to_string().contains("standard error"));
    assert_eq!(meta.headers.len(), 1, "one part, which old readers read");
}

#[test]
fn a_coloured_exr_has_the_layers_of_every_channel_or_one_for_all() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let all = [layers(0), layers(1), layers(2)];
    let each = all.each_ref().map(bars);
    for bars in [&each[..], &each[..1]] {
        write_with_error(&colours(), bars, 0.95, &path, ImageFormat::Exr, &Tone::default()).unwrap();
        let found = read_layers(&path).unwrap();
        assert_eq!(found.len(), 3 + 4 * bars.len());
        let picture = image::open(&path).unwrap().to_rgb32f();
        assert_eq!(f64::from(picture.get_pixel(6, 4).0[2]), single(&image(2))[34]);
        for (name, image) in ["R", "G", "B"].iter().zip(colours()) {
            assert_eq!(found[*name].values(), single(&image), "{name}");
        }
        let names = if bars.len() == 1 { &["Y"][..] } else { &["R", "G", "B"] };
        for (colour, layers) in names.iter().zip(&all) {
            for (name, layer) in ErrorBars::LAYERS.iter().zip(layers) {
                assert_eq!(found[&format!("{name}.{colour}")].values(), single(layer), "{name}.{colour}");
            }
        }
    }
}

#[test]
fn an_array_holds_all_figures_in_64_bits_in_the_order_of_the_layers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    let all = [layers(0), layers(1), layers(2)];
    let each = all.each_ref().map(bars);
    for (bars, shape) in [(&each[..1], &[4, 5, 7][..]), (&each[..], &[4, 3, 5, 7])] {
        write_error(bars, 0.95, &path, ImageFormat::Npy, &Tone::default()).unwrap();
        let array = npyz::NpyFile::new(File::open(&path).unwrap()).unwrap();
        assert_eq!(array.shape(), shape);
        let values: Vec<f64> = array.into_vec().unwrap();
        let at = |layer: usize, channel: usize| &values[35 * (layer * bars.len() + channel)..][..35];
        for (channel, layers) in all.iter().take(bars.len()).enumerate() {
            for (layer, image) in layers.iter().enumerate() {
                assert_eq!(at(layer, channel), image.values(), "{layer} {channel}");
            }
        }
    }
}

#[test]
fn an_error_map_shows_the_standard_error() {
    let folder = tempfile::tempdir().unwrap();
    let all = [layers(0), layers(1), layers(2)];
    let each = all.each_ref().map(bars);
    for name in ["a.exr", "a.tiff", "a.png"] {
        let [map, plain] = [name.to_owned(), format!("plain-{name}")].map(|n| folder.path().join(n));
        let format = ImageFormat::of(&map, true).unwrap();
        write_error(&each[..1], 0.95, &map, format, &Tone::default()).unwrap();
        write(&all[0][0], &plain, format, &Tone::default()).unwrap();
        assert_eq!(image::open(&map).unwrap(), image::open(&plain).unwrap(), "{name}");
        write_error(&each, 0.95, &map, format, &Tone::default()).unwrap();
        write_colour(&[0, 1, 2].map(|c| all[c][0].clone()), &plain, format, &Tone::default()).unwrap();
        assert_eq!(image::open(&map).unwrap(), image::open(&plain).unwrap(), "{name}, coloured");
    }
}

#[test]
fn formats_without_layers_hold_the_image_as_ever() {
    let folder = tempfile::tempdir().unwrap();
    let layers = layers(0);
    for name in ["a.npy", "a.tiff", "a.png"] {
        let [with, plain] = [name.to_owned(), format!("plain-{name}")].map(|n| folder.path().join(n));
        let format = ImageFormat::of(&with, false).unwrap();
        write_with_error(&[image(1)], &[bars(&layers)], 0.95, &with, format, &Tone::default()).unwrap();
        write(&image(1), &plain, format, &Tone::default()).unwrap();
        assert_eq!(std::fs::read(&with).unwrap(), std::fs::read(&plain).unwrap(), "{name}");
    }
}

#[test]
fn what_does_not_fit_is_refused_with_its_name_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let layers = layers(0);
    let small = [(); 4].map(|()| Image::zeros(Extent::new(7, 4).unwrap()));
    let mut wide = layers.clone();
    wide[2].values_mut()[8] = 1e39;
    let good = [image(1)];
    let cases: [(&[Image], &[ErrorBars<'_>], &str); 6] = [
        (&[], &[bars(&layers)], "0 channels"),
        (&good, &[], "0 error bars"),
        (&good, &[bars(&layers); 3], "1 channels with 3"),
        (&colours(), &[bars(&layers); 2], "3 channels with 2"),
        (&good, &[bars(&small)], "7x4"),
        (&good, &[bars(&wide)], "high.Y: the value 1e39 of pixel (1, 1)"),
    ];
    for (channels, bars, expected) in cases {
        let path = folder.path().join("a.exr");
        let outcome = write_with_error(channels, bars, 0.95, &path, ImageFormat::Exr, &Tone::default());
        let message = outcome.unwrap_err().to_string();
        assert!(message.contains(expected) && message.contains("a.exr"), "{expected}: {message}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn an_interval_without_an_end_stays_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let mut layers = layers(0);
    layers[2].values_mut()[0] = f64::INFINITY;
    layers[0].values_mut()[0] = f64::NAN;
    write_error(&[bars(&layers)], 0.95, &path, ImageFormat::Exr, &Tone::default()).unwrap();
    let found = read_layers(&path).unwrap();
    assert!(found["high.Y"].get(0, 0) == f64::INFINITY && found["stderr.Y"].get(0, 0).is_nan());
}

#[test]
fn damaged_layers_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let layers = layers(0);
    write_error(&[bars(&layers)], 0.95, &path, ImageFormat::Exr, &Tone::default()).unwrap();
    let whole = std::fs::read(&path).unwrap();
    for cut in (0..whole.len()).step_by(7) {
        std::fs::write(&path, &whole[..cut]).unwrap();
        assert!(read_layers(&path).is_err(), "cut at {cut} of {}", whole.len());
    }
    // A picture of 60,000 x 60,000 pixels in some 2,000 bytes: 100 GB that no file of that length can fill.
    let mut bytes = whole.clone();
    for window in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
        let at = bytes.windows(window.len()).position(|w| w == window).unwrap() + window.len() + 4;
        bytes[at + 8..at + 16].copy_from_slice(&[59_999i32.to_le_bytes(); 2].concat());
    }
    std::fs::write(&path, &bytes).unwrap();
    let message = read_layers(&path).unwrap_err().to_string();
    assert!(message.contains("promises"), "{message}");
    // Whatever a wrong byte means, it is read or refused.
    for at in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x55;
        std::fs::write(&path, &bytes).unwrap();
        let _ = read_layers(&path);
    }
}
