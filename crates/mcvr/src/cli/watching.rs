//! The image while it is refined: in the terminal, in a folder.

use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::ProgressBar;
use mcvr::refinement::{Bars, Look, Picture, Snapshot, Stop};
use mcvr::scene::Image;
use mcvr::scene::film::{ErrorBars, ImageFormat, Tone};
use serde_json::Value;

use super::preview::Preview;
use super::progress;
use super::progressive::{PassRecord, Progressive};

/// How the image is watched while it is made.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Error")]
pub struct WatchArgs {
    /// Write the image after every pass into a new or empty folder: pass-01.png, the linear formats of -o beside it, and
    /// progress.json with samples, seconds and error of each pass
    #[arg(long, value_name = "DIR")]
    pub progressive: Option<PathBuf>,
    /// Draw the image so far in the terminal (standard error), where it shows 256 colours or more; NO_COLOR turns it off
    #[arg(long)]
    pub preview: bool,
}

impl WatchArgs {
    /// True when there is something to watch with.
    pub fn any(&self) -> bool {
        self.progressive.is_some() || self.preview
    }
}

/// Those who watch one image.
pub struct Watching {
    preview: Option<Preview>,
    folder: Option<Progressive>,
    tone: Tone,
    confidence: f64,
}

impl Watching {
    /// Claims the folder, if there is one: `DIR`, or `DIR/label` where there are several cameras.
    pub fn new(
        args: &WatchArgs,
        label: Option<&str>,
        formats: &[ImageFormat],
        tone: Tone,
        confidence: f64,
        request: Value,
        quiet: bool,
    ) -> anyhow::Result<Self> {
        let within = |dir: &Path| label.map_or_else(|| dir.to_owned(), |label| dir.join(label));
        let folder = args.progressive.as_deref().map(within);
        let folder = folder.map(|dir| Progressive::new(&dir, formats, tone, request)).transpose()?;
        let preview = if args.preview { Preview::new(quiet) } else { None };
        Ok(Self { preview, folder, tone, confidence })
    }

    /// Shows and writes the image after a pass.
    pub fn look(&mut self, look: &Look, snapshot: &Snapshot<'_, '_>, bar: &ProgressBar) -> anyhow::Result<()> {
        if self.preview.is_none() && self.folder.is_none() {
            return Ok(());
        }
        let picture = snapshot.picture();
        if let Some(folder) = &mut self.folder {
            let e = &look.estimate;
            let pass = PassRecord {
                pass: look.pass,
                samples: look.samples,
                seconds: look.seconds,
                error: e.error,
                bound: e.bound.filter(|b| b.is_finite()),
                pixel_error: e.pixel_bound.filter(|b| b.is_finite()),
                files: vec![],
            };
            let bars: Vec<ErrorBars<'_>> = picture.bars.iter().map(layers).collect();
            folder.pass(channels(&picture), Some((&bars, self.confidence)), pass)?;
        }
        // What Ctrl-C says has moved the cursor; nothing is drawn over it.
        if !progress::interrupt_flag().load(std::sync::atomic::Ordering::SeqCst)
            && let Some(preview) = &mut self.preview
        {
            let error = look.estimate.error.map_or_else(String::new, |e| format!(", error {:.2} %", 100.0 * e));
            let caption = format!("pass {}: {} samples, {:.2} s{error}", look.pass, look.samples, look.seconds);
            bar.suspend(|| preview.show(channels(&picture), &self.tone, &caption));
        }
        Ok(())
    }

    /// Ends the watching.
    pub fn stop(self, stop: Stop) -> anyhow::Result<()> {
        if let Some(mut preview) = self.preview {
            preview.leave();
        }
        let why = match stop {
            Stop::Reached => "error",
            Stop::Samples => "samples",
            Stop::Time => "time",
            Stop::Interrupted => "interrupted",
        };
        self.folder.map_or(Ok(()), |folder| folder.stop(why))
    }
}

/// The image's channels: itself, or red, green and blue.
pub fn channels(picture: &Picture) -> &[Image] {
    picture.colour.as_ref().map_or(std::slice::from_ref(&picture.image), |c| &c[..])
}

/// Error bars as files hold them.
pub fn layers(bars: &Bars) -> ErrorBars<'_> {
    ErrorBars { error: &bars.error, low: &bars.low, high: &bars.high, unresolved: &bars.unresolved }
}
