//! The image so far, drawn in the terminal.
//!
//! A character cell is twice as high as wide, so the half block (U+2580) with a foreground and a background colour shows two square
//! pixels. Written here in place of a library: `viuer`, the usual one, prints to standard output, where results belong, and asks
//! the terminal questions whose answers it waits for on standard input. Half blocks need neither.

use std::fmt::Write as _;

use console::Term;
use mcvr::scene::film::{Image, Tone, largest, toned_colour};
use mcvr::scene::{Extent, SceneError};

/// Most pixels across: enough to judge the noise by, and few enough for a slow connection.
const WIDEST: usize = 80;

/// Lines of the terminal that the picture leaves free: for the caption, the progress bar and the cursor.
const OTHER_LINES: usize = 3;

/// How a terminal is told colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Palette {
    /// 24 bits.
    True,
    /// The 256 colours of xterm: a cube of 6 x 6 x 6 and a ramp of 24 greys.
    Indexed,
}

impl Palette {
    /// What the terminal says of itself in its environment. Nothing for one that shows no colours or is asked for none
    /// (`NO_COLOR`, as on no-color.org).
    fn of(variable: impl Fn(&str) -> Option<String>) -> Option<Self> {
        let [term, colours, none] = ["TERM", "COLORTERM", "NO_COLOR"].map(|name| variable(name).unwrap_or_default());
        if !none.is_empty() {
            return None;
        }
        // GNU screen passes on what the terminal around it says, and knows no 24 bits.
        let inherits = term.starts_with("screen");
        let known =
            ["kitty", "alacritty", "foot", "ghostty", "wezterm", "-direct"].iter().any(|name| term.contains(name));
        match term.as_str() {
            "" | "dumb" => None,
            _ if !inherits && (known || matches!(colours.as_str(), "truecolor" | "24bit")) => Some(Self::True),
            _ if term.contains("256color") => Some(Self::Indexed),
            _ => None,
        }
    }

    /// The parameters of a colour's escape code after the 38 of the foreground or the 48 of the background.
    fn code(self, rgb: [u8; 3]) -> String {
        let [r, g, b] = rgb;
        if self == Self::True {
            return format!("2;{r};{g};{b}");
        }
        let index = if r == g && g == b {
            // Black and white stand in the cube, 24 greys between them in the ramp.
            match (f64::from(r) / 255.0 * 25.0).round() as u8 {
                0 => 16,
                25 => 231,
                level => 231 + level,
            }
        } else {
            let level = |v: u8| match v {
                0..48 => 0,
                48..115 => 1,
                _ => (v - 35) / 40,
            };
            16 + 36 * level(r) + 6 * level(g) + level(b)
        };
        format!("5;{index}")
    }
}

/// Draws the image so far, each time over the last.
#[derive(Debug)]
pub struct Preview {
    term: Term,
    palette: Palette,
    /// Lines of the last drawing, and the size of the terminal then.
    last: Option<(usize, Lines)>,
}

/// Rows and columns of a terminal.
type Lines = (u16, u16);

impl Preview {
    /// A preview on standard error; nothing where that is no terminal, or one that shows no colours, or quiet was asked for.
    pub fn new(quiet: bool) -> Option<Self> {
        let term = Term::stderr();
        if quiet || !term.is_term() {
            return None;
        }
        let palette = Palette::of(|name| std::env::var(name).ok())?;
        Some(Self { term, palette, last: None })
    }

    /// Draws one grey image, or red, green and blue, over the last drawing, with a caption below. Nothing else may have been
    /// printed since, or [`Preview::leave`] must have been called. Beside a progress bar, call this within
    /// [`indicatif::ProgressBar::suspend`].
    pub fn show(&mut self, channels: &[Image], tone: &Tone, caption: &str) {
        let frame = self.frame(channels, tone, caption, self.term.size());
        // Where nobody looks any more, the work goes on.
        let _ = frame.map(|text| self.term.write_str(&text));
    }

    /// Leaves the last drawing where it is: what comes next stands below it.
    pub fn leave(&mut self) {
        self.last = None;
    }

    fn frame(&mut self, channels: &[Image], tone: &Tone, caption: &str, size: Lines) -> Result<String, SceneError> {
        let (rows, columns) = (usize::from(size.0), usize::from(size.1));
        let Some(first) = channels.first() else { return Ok(String::new()) };
        let extent = fitted(first.extent(), columns, rows)?;
        let small = channels.iter().map(|c| shrunk(c, extent)).collect::<Result<Vec<_>, _>>()?;
        let lines = drawn(&small, tone, self.palette);
        let mut text = String::new();
        // After a change of size the terminal has wrapped its lines anew, and nobody knows where the last drawing is.
        if let Some((last, _)) = self.last.filter(|(_, then)| *then == size) {
            let _ = write!(text, "\x1b[{last}A\r");
        }
        let caption: String = caption.chars().filter(|c| !c.is_control()).collect();
        let caption = console::truncate_str(&caption, columns.saturating_sub(1), "");
        for line in lines.iter().map(String::as_str).chain([&*caption]) {
            let _ = writeln!(text, "{line}\x1b[K");
        }
        text.push_str("\x1b[J");
        self.last = Some((lines.len() + 1, size));
        Ok(text)
    }
}

/// Size in pixels at which an image fits into a terminal, its shape kept; never larger than it is.
fn fitted(extent: Extent, columns: usize, rows: usize) -> Result<Extent, SceneError> {
    // The last column stays free: after a character there, terminals differ about where the cursor is.
    let widest = columns.saturating_sub(1).clamp(1, WIDEST);
    let highest = 2 * rows.saturating_sub(OTHER_LINES).max(1);
    let scale = (widest as f64 / extent.width as f64).min(highest as f64 / extent.height as f64).min(1.0);
    let side = |n: usize, most: usize| ((n as f64 * scale).round() as usize).clamp(1, most);
    Extent::new(side(extent.width, widest), side(extent.height, highest))
}

/// The image at a smaller size, every pixel the mean over the area that it covers.
fn shrunk(image: &Image, extent: Extent) -> Result<Image, SceneError> {
    let from = image.extent();
    let (across, down) = (shares(from.width, extent.width), shares(from.height, extent.height));
    let mut values = Vec::with_capacity(extent.pixels());
    for (top, rows) in &down {
        for (left, columns) in &across {
            let mut sum = 0.0;
            for (y, high) in rows.iter().enumerate() {
                for (x, wide) in columns.iter().enumerate() {
                    sum += high * wide * image.get(left + x, top + y);
                }
            }
            values.push(sum);
        }
    }
    Image::from_values(extent, values)
}

/// For each of `to` equal parts of a line of `from` pixels: the first pixel in it, and the shares of that part which that pixel
/// and those after it have. Counted in units of 1/to of a pixel, hence without rounding.
fn shares(from: usize, to: usize) -> Vec<(usize, Vec<f64>)> {
    let part = |i: usize| {
        let (begin, end) = (i * from, (i + 1) * from);
        let share = |pixel: usize| (end.min((pixel + 1) * to) - begin.max(pixel * to)) as f64 / from as f64;
        (begin / to, (begin / to..end.div_ceil(to)).map(share).collect())
    };
    (0..to).map(part).collect()
}

/// Lines of half blocks, each ended by a reset of the colours.
fn drawn(channels: &[Image], tone: &Tone, palette: Palette) -> Vec<String> {
    let Extent { width, height } = channels[0].extent();
    let pixels: Vec<[f64; 3]> = match channels {
        [r, g, b] => {
            let channels = [r.clone(), g.clone(), b.clone()];
            let limits = tone.limits(&largest(&channels));
            toned_colour(&channels, tone, limits)
        }
        _ => tone.apply(&channels[0], tone.limits(&channels[0])).into_iter().map(|grey| [grey; 3]).collect(),
    };
    let code = |x: usize, y: usize| palette.code(pixels[y * width + x].map(|v| (v * 255.0).round() as u8));
    let line = |y: usize| {
        let mut line = String::new();
        let mut before = String::new();
        for x in 0..width {
            // Below the last row of an odd number there is nothing.
            let below = if y + 1 < height { format!("48;{}", code(x, y + 1)) } else { "49".into() };
            let colours = format!("\x1b[38;{};{below}m", code(x, y));
            if colours != before {
                line.push_str(&colours);
                before = colours;
            }
            line.push('▀');
        }
        line + "\x1b[0m"
    };
    (0..height).step_by(2).map(line).collect()
}

#[cfg(test)]
#[path = "preview_tests.rs"]
mod tests;
