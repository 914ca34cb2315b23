//! Several small plots of the same lines, side by side, with one legend: ratios on a logarithmic axis.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::HarnessError;
use crate::chart::{INK, MUTED, PALETTE};
use crate::format::significant;

/// Width of a picture, heights of a panel, of the head above and of a line of the legend below, in pixels.
const WIDTH: u32 = 1200;
const PANEL: u32 = 330;
const HEAD: u32 = 48;
const KEY: u32 = 28;
/// Panels beside each other.
const COLUMNS: usize = 3;
/// Most lines that can be told apart: the palette's, and a violet.
pub const LINES: usize = PALETTE.len() + 1;
/// Values of the y axis that may get a label.
const TICKS: [f64; 10] = [0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 5.0];

/// One method's points.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Its name in the legend; the same name has the same colour in all panels.
    pub label: String,
    /// (x, y), y above 0.
    pub points: Vec<(f64, f64)>,
}

/// One field.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Written above it.
    pub title: String,
    /// What is drawn, the first at the bottom.
    pub lines: Vec<Line>,
}

/// All of a picture.
#[derive(Clone, Debug)]
pub struct Plot {
    /// Heading, and what a screen reader says.
    pub title: String,
    /// Name of the x axis.
    pub x: String,
    /// Name of the y axis.
    pub y: String,
    /// How a value of x is written.
    pub x_label: fn(f64) -> String,
    /// The fields, in reading order; all have the same axes.
    pub panels: Vec<Panel>,
}

impl Plot {
    /// The picture as a self-contained SVG document.
    ///
    /// # Errors
    /// [`HarnessError::Plot`] for nothing to draw, values that a logarithmic axis cannot show, more than [`LINES`] lines, or
    /// when the drawing library refuses.
    pub fn svg(&self) -> Result<String, HarnessError> {
        let fail = |problem: String| HarnessError::Plot { name: self.title.clone(), problem };
        let labels = self.labels();
        if labels.is_empty() || labels.len() > LINES {
            return Err(fail(format!("{} lines; 1 to {LINES} can be drawn", labels.len())));
        }
        let values = || self.panels.iter().flat_map(|p| &p.lines).flat_map(|l| &l.points);
        if let Some((x, y)) = values().find(|(x, y)| !(x.is_finite() && y.is_finite() && *y > 0.0)) {
            return Err(fail(format!("the point ({x}, {y}) has no place on a logarithmic axis")));
        }
        let columns = self.panels.len().min(COLUMNS);
        let rows = self.panels.len().div_ceil(columns);
        let places = key_places(&labels);
        let foot = places.last().map_or(0, |p| p.1 as u32) + KEY;
        let size = (WIDTH, HEAD + PANEL * rows as u32 + foot);
        let mut text = String::new();
        {
            let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
            self.draw(&root, &labels, &places, [columns, rows]).map_err(|e| fail(e.to_string()))?;
            root.present().map_err(|e| fail(e.to_string()))?;
        }
        let head = text.find('>').map_or(text.len(), |i| i + 1);
        text.insert_str(head, &format!("\n<title>{}</title>", crate::html::escape(&self.title)));
        Ok(text)
    }

    /// Names of lines in the order in which they first appear.
    fn labels(&self) -> Vec<&str> {
        let mut labels: Vec<&str> = vec![];
        for line in self.panels.iter().flat_map(|p| &p.lines) {
            if !labels.contains(&line.label.as_str()) {
                labels.push(&line.label);
            }
        }
        labels
    }

    /// Least and largest of a coordinate, a little wider.
    fn range(&self, of: impl Fn(&(f64, f64)) -> f64) -> std::ops::Range<f64> {
        let values = self.panels.iter().flat_map(|p| &p.lines).flat_map(|l| &l.points).map(of);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let pad = (0.06 * (high - low)).max(0.02);
        low - pad..high + pad
    }

    fn draw<DB: DrawingBackend>(
        &self,
        root: &DrawingArea<DB, plotters::coord::Shift>,
        labels: &[&str],
        places: &[(i32, i32)],
        [columns, rows]: [usize; 2],
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
        root.fill(&WHITE)?;
        let title = TextStyle::from(("sans-serif", 20).into_font()).color(&INK);
        root.draw(&Text::new(self.title.clone(), (16, 14), title))?;
        let (fields, foot) = root.split_vertically(HEAD + PANEL * rows as u32);
        let (_, fields) = fields.split_vertically(HEAD);
        for (area, panel) in fields.split_evenly((rows, columns)).iter().zip(&self.panels) {
            self.field(area, panel, labels)?;
        }
        let style = TextStyle::from(("sans-serif", 14).into_font()).color(&INK).pos(Pos::new(HPos::Left, VPos::Center));
        for (i, (label, &(left, y))) in labels.iter().zip(places).enumerate() {
            foot.draw(&PathElement::new([(left, y), (left + 26, y)], colour(i).stroke_width(3)))?;
            foot.draw(&Circle::new((left + 13, y), 4, colour(i).filled()))?;
            foot.draw(&Text::new((*label).to_owned(), (left + 33, y), style.clone()))?;
        }
        Ok(())
    }

    fn field<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, plotters::coord::Shift>,
        panel: &Panel,
        labels: &[&str],
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
        let y = self.range(|p| p.1.log10());
        let ticks: Vec<f64> = TICKS.iter().map(|t| t.log10()).filter(|t| y.contains(t)).collect();
        let mut steps: Vec<f64> = panel.lines.iter().flat_map(|l| l.points.iter().map(|p| p.0)).collect();
        steps.sort_by(f64::total_cmp);
        steps.dedup();
        let mut chart = ChartBuilder::on(area)
            .caption(&panel.title, ("sans-serif", 16))
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(56)
            .build_cartesian_2d(Marked { ends: self.range(|p| p.0), marks: steps }, Marked { ends: y, marks: ticks })?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(222, 225, 229))
            .axis_style(MUTED)
            .x_desc(&self.x)
            .y_desc(&self.y)
            .axis_desc_style(("sans-serif", 13))
            .label_style(("sans-serif", 13))
            .x_label_formatter(&|v| (self.x_label)(*v))
            .y_label_formatter(&|v| significant(10f64.powf(*v), 2))
            .draw()?;
        for line in &panel.lines {
            let colour = colour(labels.iter().position(|l| *l == line.label).unwrap_or(0));
            let points = line.points.iter().map(|(x, y)| (*x, y.log10()));
            chart.draw_series(LineSeries::new(points.clone(), colour.stroke_width(2)))?;
            chart.draw_series(points.map(|p| Circle::new(p, 3, colour.filled())))?;
        }
        Ok(())
    }
}

/// Where the legend's entries begin, in as many lines as they need.
fn key_places(labels: &[&str]) -> Vec<(i32, i32)> {
    let (mut left, mut y) = (16, 14);
    let mut places = vec![];
    for label in labels {
        // 7.6 px a letter is on the wide side; the real font is not known here.
        let width = 54 + (7.6 * label.chars().count() as f64) as i32;
        if left > 16 && left + width > WIDTH as i32 {
            (left, y) = (16, y + KEY as i32);
        }
        places.push((left, y));
        left += width;
    }
    places
}

/// An axis with labels where they are wanted.
struct Marked {
    ends: std::ops::Range<f64>,
    marks: Vec<f64>,
}

impl Ranged for Marked {
    type FormatOption = plotters::coord::ranged1d::DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (low, high): (i32, i32)) -> i32 {
        let share = (value - self.ends.start) / (self.ends.end - self.ends.start);
        low + (share * f64::from(high - low)).round() as i32
    }

    fn key_points<Hint: plotters::coord::ranged1d::KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.marks.clone()
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.ends.clone()
    }
}

fn colour(line: usize) -> RGBColor {
    // The palette's black first, for what the others are compared with.
    let [others @ .., black] = PALETTE;
    match line {
        0 => black,
        n => others.get(n - 1).copied().unwrap_or(RGBColor(120, 70, 160)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(points: Vec<(f64, f64)>, lines: usize) -> Plot {
        let line = |i: usize| Line { label: format!("m{i} & co"), points: points.clone() };
        let panel = |title: &str| Panel { title: title.into(), lines: (0..lines).map(line).collect() };
        let panels = ["one", "two", "three", "four"].map(panel).to_vec();
        Plot { title: "a < b".into(), x: "samples".into(), y: "ratio".into(), x_label: |x| format!("2^{x:.0}"), panels }
    }

    #[test]
    fn every_panel_line_and_label_is_drawn() {
        let svg = plot(vec![(18.0, 1.0), (22.0, 0.4), (26.0, 0.15)], 2).svg().unwrap();
        for text in ["<title>a &lt; b</title>", "one", "four", "m1 &amp; co", "2^22", "samples", "0.20", "1.0"] {
            assert!(svg.contains(text), "{text}");
        }
        // Three points in four panels of two lines, and one in each line's legend.
        assert_eq!(svg.matches("<circle").count(), 3 * 4 * 2 + 2);
    }

    #[test]
    fn what_cannot_be_drawn_is_refused() {
        for (points, lines) in
            [(vec![(1.0, 0.0)], 1), (vec![(1.0, f64::NAN)], 1), (vec![(1.0, 1.0)], 0), (vec![(1.0, 1.0)], 9)]
        {
            assert!(plot(points, lines).svg().is_err());
        }
        assert!(plot(vec![(1.0, 1.0)], 8).svg().is_ok());
        let long = "a label of more than forty characters in all";
        assert!(
            key_places(&[long; 8]).iter().all(|p| p.0 < WIDTH as i32 / 2 + 400) && key_places(&[long; 8])[7].1 > 14
        );
    }
}
