//! A log-log chart as SVG. The axes are laid out here, in decades, because a logarithmic axis of plotters that spans
//! no whole decade gets no labels; plotters draws the shapes and the text.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use crate::HarnessError;
use axis::Field;
use pen::{Drawn, FINE, Pen, px, stroke};

pub(crate) use axis::Axis;

mod axis;
mod hover;
pub(crate) mod pen;

pub(crate) const INK: RGBColor = RGBColor(31, 35, 40);
pub(crate) const MUTED: RGBColor = RGBColor(89, 96, 105);
const FRAME: RGBColor = RGBColor(140, 146, 152);
const GRID: RGBColor = RGBColor(222, 225, 229);
pub(crate) const FAINT: RGBColor = RGBColor(241, 243, 245);

/// Colours that people with any colour vision tell apart (Okabe and Ito 2008), yellow left out for contrast.
pub(crate) const PALETTE: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(31, 35, 40),
];

/// Styles from here on are of what is shown for comparison: grey, told apart by their markers, and not joined.
pub(crate) const OTHERS: usize = 96;

fn color_of(style: usize) -> RGBColor {
    if style >= OTHERS { MUTED } else { PALETTE[style % PALETTE.len()] }
}

/// A measured value with the smallest and largest of its replicates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bar {
    pub(crate) low: f64,
    pub(crate) mid: f64,
    pub(crate) high: f64,
}

/// One method's points, in the order in which the line joins them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Curve {
    pub(crate) label: String,
    /// Position in the palette, the same in every chart; from [`OTHERS`] on grey points that no line joins.
    pub(crate) style: usize,
    pub(crate) points: Vec<(Bar, Bar)>,
    /// What a reader sees at each point, one line for each figure; fewer than points, or none, is allowed.
    pub(crate) hover: Vec<String>,
}

/// A dashed straight line `y = y0 (x / x0)^slope`, to judge slopes by.
#[derive(Clone, Debug)]
pub(crate) struct Guide {
    pub(crate) label: String,
    pub(crate) slope: f64,
    pub(crate) through: (f64, f64),
}

/// Everything on one chart.
#[derive(Clone, Debug)]
pub(crate) struct Chart {
    pub(crate) name: &'static str,
    pub(crate) title: String,
    pub(crate) caption: Vec<String>,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) curves: Vec<Curve>,
    pub(crate) guides: Vec<Guide>,
    /// A horizontal line and what it means.
    pub(crate) floor: Option<(f64, String)>,
}

/// Sizes and places in CSS pixels; text lengths in characters.
struct Layout {
    width: i32,
    /// `None`: as high as the contents need.
    height: Option<i32>,
    margin: f64,
    /// Room beside the field.
    left: f64,
    right: f64,
    title_size: f64,
    title_wrap: usize,
    caption_size: f64,
    wrap: usize,
    key: Key,
}

/// Where the legend stands.
#[derive(Clone, Copy, PartialEq)]
enum Key {
    /// In the corner of the field where it covers least.
    Within,
    Below,
    Beside,
}

/// Most lines of a legend within the field.
const MOST_WITHIN: usize = 9;

impl Layout {
    const WIDE: Self = Self {
        width: 760,
        height: Some(560),
        margin: 16.0,
        left: 74.0,
        right: 22.0,
        title_size: 18.0,
        title_wrap: usize::MAX,
        caption_size: 12.0,
        wrap: 112,
        key: Key::Within,
    };
    const NARROW: Self = Self {
        width: 360,
        height: None,
        margin: 4.0,
        left: 64.0,
        right: 12.0,
        title_size: 14.0,
        title_wrap: 40,
        caption_size: 11.0,
        wrap: 56,
        key: Key::Below,
    };
}

impl Chart {
    /// The chart as a self-contained SVG document.
    ///
    /// # Errors
    /// [`HarnessError::Plot`] when the drawing library refuses.
    pub(crate) fn svg(&self) -> Result<String, HarnessError> {
        let (labels, width, _) = self.key_size();
        if labels.len() <= MOST_WITHIN {
            return self.with_room().laid_out(&Layout::WIDE);
        }
        // A long legend would hide the curves, whatever the corner.
        let beside = width.ceil() + 16.0;
        let width = Layout::WIDE.width + beside as i32;
        self.laid_out(&Layout { width, right: Layout::WIDE.right + beside, key: Key::Beside, ..Layout::WIDE })
    }

    /// The same for a phone: narrow, the legend below the field.
    ///
    /// # Errors
    /// As [`Chart::svg`].
    pub(crate) fn narrow_svg(&self) -> Result<String, HarnessError> {
        self.laid_out(&Layout::NARROW)
    }

    fn laid_out(&self, layout: &Layout) -> Result<String, HarnessError> {
        let mut svg = String::new();
        let fail = |e: String| HarnessError::Plot { name: self.name.to_owned(), problem: e };
        let title = wrap(&self.title, layout.title_wrap);
        let caption: Vec<String> = self.caption.iter().flat_map(|line| wrap(line, layout.wrap)).collect();
        let field = self.field(layout, title.len(), caption.len());
        let below = if layout.key == Key::Below { self.key_size().2 } else { 0.0 };
        let css = [layout.width, (field.bottom + 62.0 + below + 16.0 * caption.len() as f64).ceil() as i32];
        let [width, height] = css.map(|side| (side * FINE) as u32);
        let area = SVGBackend::with_string(&mut svg, (width, height)).into_drawing_area();
        let drawn = self.draw(&Pen { area: &area }, layout, &field, [&title, &caption]);
        drawn.and_then(|()| area.present()).map_err(|e| fail(e.to_string()))?;
        drop(area);
        finish_svg(&svg, css, &self.title, &self.targets(&field)).ok_or_else(|| fail("unexpected SVG document".into()))
    }

    /// The chart with its y axis a decade or two longer when the legend would otherwise hide points.
    fn with_room(&self) -> Self {
        let mut chart = self.clone();
        for _ in 0..2 {
            if chart.free_corner(&chart.field(&Layout::WIDE, 1, 0)).1 > 0 {
                chart.y.decades[1] += 1;
            }
        }
        chart
    }

    /// The rectangle of the data below so many lines of title and above so many of caption.
    fn field(&self, layout: &Layout, title_lines: usize, caption_lines: usize) -> Field<'_> {
        let top = 76.0 + 20.0 * title_lines.saturating_sub(1) as f64;
        let bottom = match layout.height {
            Some(height) => f64::from(height) - 62.0 - 16.0 * caption_lines as f64,
            None => top + 260.0,
        };
        Field { left: layout.left, right: f64::from(layout.width) - layout.right, top, bottom, x: &self.x, y: &self.y }
    }

    fn draw<DB: DrawingBackend>(
        &self,
        pen: &Pen<'_, DB>,
        layout: &Layout,
        field: &Field<'_>,
        [title, caption]: [&[String]; 2],
    ) -> Drawn<DB> {
        pen.area.fill(&WHITE)?;
        // A bold letter is about 0.62 of the font's size wide; a long title gets a smaller font.
        let longest = title.iter().map(|line| line.chars().count()).max().unwrap_or(0).max(1);
        let room = f64::from(layout.width) - 2.0 * layout.margin;
        let title_size = (room / 0.62 / longest as f64).clamp(10.0, layout.title_size);
        for (i, line) in title.iter().enumerate() {
            pen.text((layout.margin, 28.0 + 20.0 * i as f64), line, title_size, INK, HPos::Left, true)?;
        }
        pen.text((layout.margin, field.top - 18.0), &self.y.name, 13.5, MUTED, HPos::Left, false)?;
        self.grid(pen, field)?;
        let reach = self.curves.iter().flat_map(|c| &c.points).map(|(x, _)| x.high).fold(0.0, f64::max);
        let styles = [[9.0, 5.0], [2.5, 4.0], [14.0, 4.0]];
        for (guide, dash) in self.guides.iter().zip(styles.iter().cycle()) {
            if let Some([a, b]) = field.clip(guide, reach) {
                pen.dashed(a, b, *dash, MUTED)?;
            }
        }
        if let Some((value, label)) = &self.floor {
            let y = field.y(*value);
            pen.line(&[(field.left, y), (field.right, y)], 1.6, MUTED)?;
            pen.text((field.left + 8.0, y - 6.0), label, 12.5, MUTED, HPos::Left, false)?;
        }
        for curve in &self.curves {
            let color = color_of(curve.style);
            let at = |(x, y): &(Bar, Bar)| (field.x(x.mid), field.y(y.mid));
            for (x, y) in &curve.points {
                pen.bar((field.x(x.mid), [field.y(y.low), field.y(y.high)]), true, color)?;
                pen.bar((field.y(y.mid), [field.x(x.low), field.x(x.high)]), false, color)?;
            }
            if curve.style < OTHERS {
                pen.line(&curve.points.iter().map(at).collect::<Vec<_>>(), 2.0, color)?;
            }
            for point in &curve.points {
                pen.marker(at(point), curve.style, color)?;
            }
        }
        let (corner, below) = match layout.key {
            Key::Below => ((layout.margin, field.bottom + 50.0), self.key_size().2),
            Key::Within => (self.free_corner(field).0, 0.0),
            Key::Beside => ((field.right + 16.0, field.top), 0.0),
        };
        self.key(pen, corner, &styles)?;
        for (i, line) in caption.iter().enumerate() {
            let y = field.bottom + 64.0 + below + 16.0 * i as f64;
            pen.text((layout.margin, y), line, layout.caption_size, MUTED, HPos::Left, false)?;
        }
        Ok(())
    }

    fn grid<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>, f: &Field<'_>) -> Drawn<DB> {
        for strong in [false, true] {
            let color = if strong { GRID } else { FAINT };
            for (value, ..) in self.x.ticks().into_iter().filter(|t| t.1 == strong) {
                pen.line(&[(f.x(value), f.top), (f.x(value), f.bottom)], 1.0, color)?;
            }
            for (value, ..) in self.y.ticks().into_iter().filter(|t| t.1 == strong) {
                pen.line(&[(f.left, f.y(value)), (f.right, f.y(value))], 1.0, color)?;
            }
        }
        pen.line(&[(f.left, f.top), (f.left, f.bottom), (f.right, f.bottom)], 1.2, FRAME)?;
        for (value, ..) in self.x.ticks().into_iter().filter(|t| t.2) {
            pen.line(&[(f.x(value), f.bottom), (f.x(value), f.bottom + 5.0)], 1.2, FRAME)?;
            pen.text((f.x(value), f.bottom + 20.0), &(self.x.label)(value), 13.0, INK, HPos::Center, false)?;
        }
        for (value, ..) in self.y.ticks().into_iter().filter(|t| t.2) {
            pen.line(&[(f.left - 5.0, f.y(value)), (f.left, f.y(value))], 1.2, FRAME)?;
            pen.text((f.left - 9.0, f.y(value) + 4.5), &(self.y.label)(value), 13.0, INK, HPos::Right, false)?;
        }
        pen.text(((f.left + f.right) / 2.0, f.bottom + 39.0), &self.x.name, 13.5, MUTED, HPos::Center, false)
    }

    /// The legend's labels, and its width and height.
    fn key_size(&self) -> (Vec<&str>, f64, f64) {
        let guides = self.guides.iter().map(|g| g.label.as_str());
        let labels: Vec<&str> = self.curves.iter().map(|c| c.label.as_str()).chain(guides).collect();
        let longest = labels.iter().map(|l| l.chars().count()).max().unwrap_or(0);
        // 7.2 px a letter is on the wide side for 13 px sans-serif; the real font is not known here.
        let size = (56.0 + 7.2 * longest as f64, 12.0 + 20.0 * labels.len() as f64);
        (labels, size.0, size.1)
    }

    /// Top left point of the legend in the corner of the field where it covers least of the curves, the first of
    /// equals, and how much it covers there (0: nothing).
    fn free_corner(&self, f: &Field<'_>) -> ((f64, f64), usize) {
        let (_, width, height) = self.key_size();
        let (lefts, tops) = ([f.right - width - 8.0, f.left + 10.0], [f.top + 8.0, f.bottom - height - 10.0]);
        let corners = tops.into_iter().flat_map(|top| lefts.map(|left| (left, top)));
        let hidden = |(left, top): (f64, f64)| {
            let at = |p: &(Bar, Bar)| (f.x(p.0.mid), f.y(p.1.mid));
            let inside = |(x, y): (f64, f64)| {
                (left - 8.0..left + width + 8.0).contains(&x) && (top - 8.0..top + height + 8.0).contains(&y)
            };
            let floor = self.floor.as_ref().is_some_and(|(y, _)| (top - 8.0..top + height + 24.0).contains(&f.y(*y)));
            let along = |pair: &[(Bar, Bar)]| {
                let (a, b) = (at(&pair[0]), at(&pair[pair.len() - 1]));
                (0..=20)
                    .map(f64::from)
                    .filter(|t| inside((a.0 + (b.0 - a.0) * t / 20.0, a.1 + (b.1 - a.1) * t / 20.0)))
                    .count()
            };
            let pairs = self.curves.iter().flat_map(|c| c.points.windows(c.points.len().clamp(1, 2)));
            10 * usize::from(floor) + pairs.map(along).sum::<usize>()
        };
        corners.map(|corner| (corner, hidden(corner))).min_by_key(|c| c.1).unwrap_or(((lefts[0], tops[0]), 0))
    }

    /// The legend: one line for each curve, then the guides.
    fn key<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>, (left, top): (f64, f64), dashes: &[[f64; 2]; 3]) -> Drawn<DB> {
        let (labels, width, height) = self.key_size();
        pen.area.draw(&Rectangle::new([px((left, top)), px((left + width, top + height))], WHITE.mix(0.9).filled()))?;
        pen.area.draw(&Rectangle::new([px((left, top)), px((left + width, top + height))], stroke(1.0, GRID)))?;
        for (i, label) in labels.iter().enumerate() {
            let y = top + 16.0 + 20.0 * i as f64;
            let ends = [(left + 10.0, y), (left + 40.0, y)];
            if let Some(curve) = self.curves.get(i) {
                let color = color_of(curve.style);
                if curve.style < OTHERS {
                    pen.line(&ends, 2.0, color)?;
                }
                pen.marker((left + 25.0, y), curve.style, color)?;
            } else {
                pen.dashed(ends[0], ends[1], dashes[(i - self.curves.len()) % dashes.len()], MUTED)?;
            }
            pen.text((left + 49.0, y + 4.5), label, 13.0, INK, HPos::Left, false)?;
        }
        Ok(())
    }
}

/// A drawing of plotters at its CSS size, scaled by the view box, with the title that a screen reader says and more elements
/// at its end. `None` when plotters writes its documents otherwise.
pub(crate) fn finish_svg(svg: &str, css: [i32; 2], title: &str, more: &str) -> Option<String> {
    let [width, height] = css.map(|side| side * FINE);
    let fine = format!("<svg width=\"{width}\" height=\"{height}\"");
    let plain = format!("<svg role=\"img\" width=\"{}\" height=\"{}\"", css[0], css[1]);
    let (head, end) = (svg.find('>')? + 1, svg.rfind("</svg>")?);
    let opening = svg.starts_with(&fine).then(|| svg[..head].replacen(&fine, &plain, 1))?;
    let title = crate::html::escape(title);
    Some(format!("{opening}\n<title>{title}</title>{}{more}{}", &svg[head..end], &svg[end..]))
}

/// Breaks a line at spaces so that no part is longer than `most` characters, unless a single word is.
pub(crate) fn wrap(line: &str, most: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in line.split_whitespace() {
        match lines.last_mut() {
            Some(last) if last.chars().count() + 1 + word.chars().count() <= most => {
                last.push(' ');
                last.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests;
