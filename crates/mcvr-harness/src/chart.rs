//! A log-log chart as SVG. The axes are laid out here, in decades, because a logarithmic axis of plotters that spans
//! no whole decade gets no labels; plotters draws the shapes and the text.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::HarnessError;

/// Width and height in CSS pixels.
const SIZE: (i32, i32) = (760, 560);
/// Drawing units per CSS pixel: plotters rounds positions to whole units.
pub(crate) const FINE: i32 = 8;
/// plotters-svg writes a font of nominal size s as s / 1.24 px.
const FONT: f64 = 1.24;

pub(crate) const INK: RGBColor = RGBColor(31, 35, 40);
pub(crate) const MUTED: RGBColor = RGBColor(89, 96, 105);
const FRAME: RGBColor = RGBColor(140, 146, 152);
const GRID: RGBColor = RGBColor(222, 225, 229);
const FAINT: RGBColor = RGBColor(241, 243, 245);

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

/// A logarithmic axis over whole decades.
#[derive(Clone, Debug)]
pub(crate) struct Axis {
    decades: [i32; 2],
    name: String,
    label: fn(f64) -> String,
}

impl Axis {
    /// The axis of whole decades that holds all values; at least one decade wide. `None` without a positive value.
    pub(crate) fn holding(values: impl Iterator<Item = f64>, name: &str, label: fn(f64) -> String) -> Option<Self> {
        let logs = values.filter(|v| *v > 0.0 && v.is_finite()).map(f64::log10);
        let ends = logs
            .fold(None, |ends: Option<[f64; 2]>, v| Some(ends.map_or([v, v], |[low, high]| [low.min(v), high.max(v)])));
        let [low, high] = ends?.map(|v| if (v - v.round()).abs() < 1e-9 { v.round() } else { v });
        let low = low.floor() as i32;
        Some(Self { decades: [low, (high.ceil() as i32).max(low + 1)], name: name.to_owned(), label })
    }

    /// Position from 0 to 1 of a value.
    fn position(&self, value: f64) -> f64 {
        let [low, high] = self.decades.map(f64::from);
        (value.log10() - low) / (high - low)
    }

    /// Grid values: (value, strong line, labelled).
    fn ticks(&self) -> Vec<(f64, bool, bool)> {
        let [low, high] = self.decades;
        let (few, step) = (high - low <= 2, ((high - low) / 9) + 1);
        let mut ticks = Vec::new();
        for decade in low..=high {
            let base = 10f64.powi(decade);
            ticks.push((base, true, (decade - low) % step == 0));
            if decade < high {
                ticks.extend((2..10).map(|i| (f64::from(i) * base, false, few && (i == 2 || i == 5))));
            }
        }
        ticks
    }
}

/// A measured value with the smallest and largest of its replicates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bar {
    pub(crate) low: f64,
    pub(crate) mid: f64,
    pub(crate) high: f64,
}

/// One method's points, in the order in which the line joins them.
#[derive(Clone, Debug)]
pub(crate) struct Curve {
    pub(crate) label: String,
    /// Position in the palette, the same in every chart.
    pub(crate) style: usize,
    pub(crate) points: Vec<(Bar, Bar)>,
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

impl Chart {
    /// The chart as a self-contained SVG document.
    ///
    /// # Errors
    /// [`HarnessError::Plot`] when the drawing library refuses.
    pub(crate) fn svg(&self) -> Result<String, HarnessError> {
        let mut svg = String::new();
        let fail = |e: String| HarnessError::Plot { name: self.name.to_owned(), problem: e };
        let size = ((SIZE.0 * FINE) as u32, (SIZE.1 * FINE) as u32);
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        self.with_room().draw(&Pen { area: &area }).and_then(|()| area.present()).map_err(|e| fail(e.to_string()))?;
        drop(area);
        finish_svg(&svg, SIZE, &self.title, self.name)
    }

    /// The chart with its y axis a decade or two longer when the legend would otherwise hide points.
    fn with_room(&self) -> Self {
        let mut chart = self.clone();
        for _ in 0..2 {
            if chart.free_corner(&chart.field(0)).1 > 0 {
                chart.y.decades[1] += 1;
            }
        }
        chart
    }

    /// The rectangle of the data above a caption of so many lines.
    fn field(&self, caption_lines: usize) -> Field<'_> {
        let bottom = f64::from(SIZE.1) - 62.0 - 16.0 * caption_lines as f64;
        Field { left: 74.0, right: f64::from(SIZE.0) - 22.0, top: 76.0, bottom, x: &self.x, y: &self.y }
    }

    fn draw<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>) -> Drawn<DB> {
        let lines: Vec<String> = self.caption.iter().flat_map(|line| wrap(line, 112)).collect();
        let field = self.field(lines.len());
        pen.area.fill(&WHITE)?;
        // A bold letter is about 0.62 of the font's size wide; a long title gets a smaller font.
        let title_size = (728.0 / 0.62 / self.title.chars().count() as f64).clamp(10.0, 18.0);
        pen.text((16.0, 28.0), &self.title, title_size, INK, HPos::Left, true)?;
        pen.text((16.0, 58.0), &self.y.name, 13.5, MUTED, HPos::Left, false)?;
        self.grid(pen, &field)?;
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
            let color = PALETTE[curve.style % PALETTE.len()];
            let at = |(x, y): &(Bar, Bar)| (field.x(x.mid), field.y(y.mid));
            for (x, y) in &curve.points {
                pen.bar((field.x(x.mid), [field.y(y.low), field.y(y.high)]), true, color)?;
                pen.bar((field.y(y.mid), [field.x(x.low), field.x(x.high)]), false, color)?;
            }
            pen.line(&curve.points.iter().map(at).collect::<Vec<_>>(), 2.0, color)?;
            for point in &curve.points {
                pen.marker(at(point), curve.style, color)?;
            }
        }
        self.key(pen, &field, &styles)?;
        for (i, line) in lines.iter().enumerate() {
            let y = field.bottom + 64.0 + 16.0 * i as f64;
            pen.text((16.0, y), line, 12.0, MUTED, HPos::Left, false)?;
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
    fn key<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>, f: &Field<'_>, dashes: &[[f64; 2]; 3]) -> Drawn<DB> {
        let (labels, width, height) = self.key_size();
        let ((left, top), _) = self.free_corner(f);
        pen.area.draw(&Rectangle::new([px((left, top)), px((left + width, top + height))], WHITE.mix(0.9).filled()))?;
        pen.area.draw(&Rectangle::new([px((left, top)), px((left + width, top + height))], stroke(1.0, GRID)))?;
        for (i, label) in labels.iter().enumerate() {
            let y = top + 16.0 + 20.0 * i as f64;
            let ends = [(left + 10.0, y), (left + 40.0, y)];
            if let Some(curve) = self.curves.get(i) {
                let color = PALETTE[curve.style % PALETTE.len()];
                pen.line(&ends, 2.0, color)?;
                pen.marker((left + 25.0, y), curve.style, color)?;
            } else {
                pen.dashed(ends[0], ends[1], dashes[(i - self.curves.len()) % dashes.len()], MUTED)?;
            }
            pen.text((left + 49.0, y + 4.5), label, 13.0, INK, HPos::Left, false)?;
        }
        Ok(())
    }
}

/// The rectangle of the data, in CSS pixels.
struct Field<'a> {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    x: &'a Axis,
    y: &'a Axis,
}

impl Field<'_> {
    fn x(&self, value: f64) -> f64 {
        self.left + (self.right - self.left) * self.x.position(value).clamp(0.0, 1.0)
    }

    fn y(&self, value: f64) -> f64 {
        self.bottom - (self.bottom - self.top) * self.y.position(value).clamp(0.0, 1.0)
    }

    /// The part of a guide inside the field, ends in CSS pixels; it runs from its point to the right, up to `reach`.
    fn clip(&self, guide: &Guide, reach: f64) -> Option<[(f64, f64); 2]> {
        let (x0, y0) = (guide.through.0.log10(), guide.through.1.log10());
        let x_of = |y: f64| x0 + (y - y0) / guide.slope;
        let [x_low, x_high] = self.x.decades.map(f64::from);
        let mut across = self.y.decades.map(|d| x_of(f64::from(d)));
        across.sort_unstable_by(f64::total_cmp);
        let ends = [x_low.max(across[0]).max(x0), x_high.min(across[1]).min(reach.log10())];
        (ends[0] < ends[1])
            .then(|| ends.map(|x| (self.x(10f64.powf(x)), self.y(10f64.powf(y0 + guide.slope * (x - x0))))))
    }
}

/// A drawing at its CSS size, scaled by the view box, with the title that a screen reader says.
///
/// # Errors
/// [`HarnessError::Plot`] when the drawing library begins its documents otherwise.
pub(crate) fn finish_svg(svg: &str, css: (i32, i32), title: &str, name: &str) -> Result<String, HarnessError> {
    let fine = format!("<svg width=\"{}\" height=\"{}\"", css.0 * FINE, css.1 * FINE);
    let plain = format!("<svg role=\"img\" width=\"{}\" height=\"{}\"", css.0, css.1);
    if !svg.starts_with(&fine) {
        return Err(HarnessError::Plot { name: name.into(), problem: "unexpected start of the SVG document".into() });
    }
    let head = svg.find('>').map_or(svg.len(), |i| i + 1);
    let title = format!("\n<title>{}</title>", crate::html::escape(title));
    Ok(format!("{}{title}{}", svg[..head].replacen(&fine, &plain, 1), &svg[head..]))
}

/// What drawing gives.
pub(crate) type Drawn<DB> = Result<(), DrawingAreaErrorKind<<DB as DrawingBackend>::ErrorType>>;

/// Draws in CSS pixels.
pub(crate) struct Pen<'a, DB: DrawingBackend> {
    pub(crate) area: &'a DrawingArea<DB, plotters::coord::Shift>,
}

impl<DB: DrawingBackend> Pen<'_, DB> {
    /// Text whose baseline starts, is centred or ends at a point.
    pub(crate) fn text(
        &self,
        at: (f64, f64),
        text: &str,
        size: f64,
        color: RGBColor,
        h: HPos,
        bold: bool,
    ) -> Drawn<DB> {
        let style = if bold { FontStyle::Bold } else { FontStyle::Normal };
        let font = ("sans-serif", size * f64::from(FINE) * FONT, style).into_font();
        let style = TextStyle::from(font).color(&color).pos(Pos::new(h, VPos::Bottom));
        // plotters-svg lifts bottom-anchored text by 0.5 ex, about 0.26 of its size.
        self.area.draw(&Text::new(text.to_owned(), px((at.0, at.1 + 0.26 * size)), style))
    }

    fn line(&self, points: &[(f64, f64)], width: f64, color: RGBColor) -> Drawn<DB> {
        self.area.draw(&PathElement::new(points.iter().copied().map(px).collect::<Vec<_>>(), stroke(width, color)))
    }

    fn dashed(&self, a: (f64, f64), b: (f64, f64), [on, off]: [f64; 2], color: RGBColor) -> Drawn<DB> {
        let length = (b.0 - a.0).hypot(b.1 - a.1);
        let at = |t: f64| (a.0 + (b.0 - a.0) * t / length, a.1 + (b.1 - a.1) * t / length);
        let mut from = 0.0;
        while from < length {
            self.line(&[at(from), at((from + on).min(length))], 1.6, color)?;
            from += on + off;
        }
        Ok(())
    }

    /// An error bar with caps across `ends` at `across`; left out when it is shorter than the marker hides.
    fn bar(&self, (across, ends): (f64, [f64; 2]), vertical: bool, color: RGBColor) -> Drawn<DB> {
        if (ends[0] - ends[1]).abs() < 2.0 {
            return Ok(());
        }
        let at = |a: f64, along: f64| if vertical { (a, along) } else { (along, a) };
        self.line(&[at(across, ends[0]), at(across, ends[1])], 1.3, color)?;
        for end in ends {
            self.line(&[at(across - 3.5, end), at(across + 3.5, end)], 1.3, color)?;
        }
        Ok(())
    }

    /// One of six shapes, so that curves differ without colour as well.
    fn marker(&self, (x, y): (f64, f64), shape: usize, color: RGBColor) -> Drawn<DB> {
        let polygon = |corners: &[(f64, f64)]| {
            let corners: Vec<_> = corners.iter().map(|(dx, dy)| px((x + dx, y + dy))).collect();
            self.area.draw(&Polygon::new(corners, color.filled()))
        };
        match shape % 6 {
            0 => self.area.draw(&Circle::new(px((x, y)), (4.0 * f64::from(FINE)) as i32, color.filled())),
            1 => polygon(&[(-3.8, -3.8), (3.8, -3.8), (3.8, 3.8), (-3.8, 3.8)]),
            2 => polygon(&[(0.0, -5.2), (4.8, 3.6), (-4.8, 3.6)]),
            3 => polygon(&[(0.0, -5.4), (5.4, 0.0), (0.0, 5.4), (-5.4, 0.0)]),
            4 => polygon(&[(0.0, 5.2), (4.8, -3.6), (-4.8, -3.6)]),
            _ => {
                self.line(&[(x - 4.0, y - 4.0), (x + 4.0, y + 4.0)], 2.2, color)?;
                self.line(&[(x - 4.0, y + 4.0), (x + 4.0, y - 4.0)], 2.2, color)
            }
        }
    }
}

pub(crate) fn px((x, y): (f64, f64)) -> (i32, i32) {
    ((x * f64::from(FINE)).round() as i32, (y * f64::from(FINE)).round() as i32)
}

fn stroke(width: f64, color: RGBColor) -> ShapeStyle {
    color.stroke_width((width * f64::from(FINE)).round() as u32)
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
#[path = "chart_tests.rs"]
mod tests;
