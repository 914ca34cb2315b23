//! `--progressive DIR`: the image after every pass, and a record of how well it was known then.
//!
//! `progress.json` is written anew, whole, after the files of each pass: however a run ends, the record names files that are
//! there and figures that are theirs.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use mcvr::scene::film::{self, ErrorBars, Image, ImageFormat, Tone};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::render::write_json;

/// Name of the record in the folder.
pub const RECORD: &str = "progress.json";

/// What is known of the image after a pass.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PassRecord {
    /// Number of the pass, from 1.
    pub pass: u32,
    /// Samples so far, in all replicates.
    pub samples: u64,
    /// Seconds so far, without those for writing.
    pub seconds: f64,
    /// Estimate of the relative RMSE: over the mean pixel.
    pub error: Option<f64>,
    /// Upper bound of the relative RMSE at the confidence asked for.
    pub bound: Option<f64>,
    /// The same bound for the asked quantile of pixels.
    pub pixel_error: Option<f64>,
    /// Files of the image, in the folder of the record. [`Progressive::pass`] fills them in.
    pub files: Vec<String>,
}

/// A folder that fills pass by pass.
#[derive(Debug)]
pub struct Progressive {
    folder: PathBuf,
    formats: Vec<ImageFormat>,
    tone: Tone,
    /// What was asked for, as the render's own record has it.
    request: Value,
    passes: Vec<PassRecord>,
}

impl Progressive {
    /// Makes the folder, or takes an empty one, and claims it by a record without passes. The images become PNG, and every linear
    /// format among `outputs`; 16 bits where an output has them.
    ///
    /// # Errors
    /// A folder that holds anything, since records of two runs must not mix; one that cannot be made or written; no folder.
    pub fn new(folder: &Path, outputs: &[ImageFormat], tone: Tone, request: Value) -> anyhow::Result<Self> {
        let name = || folder.display().to_string();
        std::fs::create_dir_all(folder).with_context(name)?;
        let held = std::fs::read_dir(folder).with_context(name)?.count();
        let another = "--progressive needs a new or empty folder, so that its record is of one run; name another";
        if held > 0 {
            bail!("{}: holds {held} file{} already; {another}", name(), if held == 1 { "" } else { "s" });
        }
        // Fails where another run was faster.
        match File::create_new(folder.join(RECORD)) {
            Err(e) if e.kind() == ErrorKind::AlreadyExists => bail!("{}: another run just took it; {another}", name()),
            other => other.with_context(name)?,
        };
        let deep = outputs.contains(&ImageFormat::Png16);
        let mut formats = vec![if deep { ImageFormat::Png16 } else { ImageFormat::Png8 }];
        for format in outputs.iter().filter(|f| f.is_linear()) {
            if !formats.contains(format) {
                formats.push(*format);
            }
        }
        let new = Self { folder: folder.to_owned(), formats, tone, request, passes: vec![] };
        new.write_record(None)?;
        Ok(new)
    }

    /// Writes the image after a pass, one grey image or red, green and blue, and then the record with it. A PNG's tone has its
    /// window from this image. Where error bars and the level of their intervals are given, EXR files hold them.
    ///
    /// # Errors
    /// What [`film::write_with_error`] says; the record then does not name this pass.
    pub fn pass(
        &mut self,
        channels: &[Image],
        bars: Option<(&[ErrorBars<'_>], f64)>,
        pass: PassRecord,
    ) -> anyhow::Result<()> {
        let mut files = vec![];
        for format in &self.formats {
            let file = format!("pass-{:02}.{}", pass.pass, ending(*format));
            let path = self.folder.join(&file);
            match (bars, channels) {
                (Some((bars, level)), _) => {
                    film::write_with_error(channels, bars, level, &path, *format, &self.tone)?;
                }
                (None, [grey]) => film::write(grey, &path, *format, &self.tone)?,
                (None, [r, g, b]) => {
                    film::write_colour(&[r.clone(), g.clone(), b.clone()], &path, *format, &self.tone)?;
                }
                (None, other) => bail!("{}: {} channels; an image has one or three", path.display(), other.len()),
            }
            files.push(file);
        }
        self.passes.push(PassRecord { files, ..pass });
        self.write_record(None)
    }

    /// Says in the record why no further pass comes, such as `error`, `time`, `samples` or `interrupted`. A record without that is
    /// of a run that goes on, or was killed.
    ///
    /// # Errors
    /// When the record cannot be written.
    pub fn stop(self, why: &str) -> anyhow::Result<()> {
        self.write_record(Some(why))
    }

    fn write_record(&self, stopped: Option<&str>) -> anyhow::Result<()> {
        write_json(
            &self.folder.join(RECORD),
            &json!({
                "request": self.request,
                "stopped": stopped,
                "passes": self.passes,
                "versions": { "mcvr": env!("CARGO_PKG_VERSION"), "record": 1 },
            }),
        )
    }
}

fn ending(format: ImageFormat) -> &'static str {
    match format {
        ImageFormat::Png8 | ImageFormat::Png16 => "png",
        ImageFormat::Exr => "exr",
        ImageFormat::Tiff => "tiff",
        ImageFormat::Npy => "npy",
    }
}

#[cfg(test)]
mod tests {
    use mcvr::scene::Extent;

    use super::*;

    fn image(value: f64) -> Image {
        let extent = Extent::new(4, 3).unwrap();
        Image::from_values(extent, (0..12).map(|i| value * f64::from(i)).collect()).unwrap()
    }

    fn record(folder: &Path) -> (Value, Vec<PassRecord>) {
        let value: Value = serde_json::from_slice(&std::fs::read(folder.join(RECORD)).unwrap()).unwrap();
        let passes = serde_json::from_value(value["passes"].clone()).unwrap();
        (value, passes)
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn pass(number: u32) -> PassRecord {
        let error = (number > 1).then(|| 0.1 / f64::from(number));
        PassRecord { pass: number, samples: 1 << number, seconds: 0.1, error, bound: error, ..PassRecord::default() }
    }

    #[test]
    fn after_every_pass_the_record_names_what_is_there() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("a/b");
        let outputs = [ImageFormat::Exr, ImageFormat::Png8, ImageFormat::Npy, ImageFormat::Exr];
        let mut progressive = Progressive::new(&folder, &outputs, Tone::default(), json!({ "seed": 7 })).unwrap();
        assert_eq!(record(&folder).1, [], "a record from the start");
        for number in 1..=3 {
            progressive.pass(&[image(f64::from(number))], None, pass(number)).unwrap();
            let (value, passes) = record(&folder);
            assert!(value["request"]["seed"] == 7 && value["stopped"].is_null());
            assert_eq!(passes.len(), number as usize);
            let last = passes.last().unwrap();
            assert_eq!(last.files, ["png", "exr", "npy"].map(|e| format!("pass-0{number}.{e}")));
            assert_eq!(PassRecord { files: vec![], ..last.clone() }, pass(number));
            for file in &last.files[1..] {
                let back = film::read(&folder.join(file)).unwrap();
                assert_eq!(back, image(f64::from(number)), "{file}");
            }
            assert_eq!(names(&folder).len(), 1 + 3 * number as usize, "nothing half written, nothing unnamed");
        }
        progressive.stop("interrupted").unwrap();
        let (value, passes) = record(&folder);
        assert_eq!((value["stopped"].as_str(), passes.len()), (Some("interrupted"), 3));
    }

    #[test]
    fn without_linear_outputs_there_are_pictures_only_and_as_deep_as_asked() {
        for (outputs, deep) in [(&[][..], false), (&[ImageFormat::Png16], true)] {
            let folder = tempfile::tempdir().unwrap();
            let mut progressive = Progressive::new(folder.path(), outputs, Tone::default(), Value::Null).unwrap();
            progressive.pass(&[image(1.0)], None, pass(12)).unwrap();
            assert_eq!(names(folder.path()), ["pass-12.png", RECORD]);
            let bytes = std::fs::read(folder.path().join("pass-12.png")).unwrap();
            assert_eq!(bytes[24], if deep { 16 } else { 8 }, "bits of a PNG's header");
        }
    }

    #[test]
    fn error_bars_stand_in_exr_files_and_colours_stay_colours() {
        let folder = tempfile::tempdir().unwrap();
        let outputs = [ImageFormat::Exr];
        let mut progressive = Progressive::new(folder.path(), &outputs, Tone::default(), Value::Null).unwrap();
        let [error, low, high, unresolved] = &[0.1, 0.8, 1.2, 0.0].map(image);
        let bars = [ErrorBars { error, low, high, unresolved }];
        progressive.pass(&[image(1.0)], Some((&bars, 0.95)), pass(1)).unwrap();
        let layers = film::read_layers(&folder.path().join("pass-01.exr")).unwrap();
        assert!(layers.len() == 7 && layers["low.Y"].get(1, 0) == f64::from(0.8f32));
        progressive.pass(&[1.0, 2.0, 3.0].map(image), None, pass(2)).unwrap();
        let layers = film::read_layers(&folder.path().join("pass-02.exr")).unwrap();
        assert_eq!((layers["R"].get(1, 0), layers["B"].get(1, 0)), (1.0, 3.0));
        assert!(progressive.pass(&[image(1.0), image(2.0)], None, pass(3)).is_err());
        assert_eq!(record(folder.path()).1.len(), 2, "a pass that failed is not named");
    }

    #[test]
    fn a_folder_of_something_else_is_refused_and_left_as_it_was() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("run");
        let new = |folder: &Path| Progressive::new(folder, &[], Tone::default(), Value::Null);
        new(&folder).unwrap();
        let before = std::fs::read(folder.join(RECORD)).unwrap();
        let message = new(&folder).unwrap_err().to_string();
        assert!(message.contains("run") && message.contains("new or empty folder"), "{message}");
        assert_eq!(std::fs::read(folder.join(RECORD)).unwrap(), before);
        let file = place.path().join("file");
        std::fs::write(&file, "x").unwrap();
        let message = format!("{:#}", new(&file).unwrap_err());
        assert!(message.contains("file"), "{message}");
        assert_eq!(std::fs::read(&file).unwrap(), b"x");
    }
}
