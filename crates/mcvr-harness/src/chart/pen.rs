//! Shapes and text in CSS pixels, drawn by plotters.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Drawing units per CSS pixel: plotters rounds positions to whole units.
pub(crate) const FINE: i32 = 8;
/// plotters-svg writes a font of nominal size s as s / 1.24 px.
const FONT: f64 = 1.24;

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

    pub(crate) fn line(&self, points: &[(f64, f64)], width: f64, color: RGBColor) -> Drawn<DB> {
        self.area.draw(&PathElement::new(points.iter().copied().map(px).collect::<Vec<_>>(), stroke(width, color)))
    }

    pub(crate) fn dashed(&self, a: (f64, f64), b: (f64, f64), [on, off]: [f64; 2], color: RGBColor) -> Drawn<DB> {
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
    pub(crate) fn bar(&self, (across, ends): (f64, [f64; 2]), vertical: bool, color: RGBColor) -> Drawn<DB> {
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
    pub(crate) fn marker(&self, (x, y): (f64, f64), shape: usize, color: RGBColor) -> Drawn<DB> {
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

pub(crate) fn stroke(width: f64, color: RGBColor) -> ShapeStyle {
    color.stroke_width((width * f64::from(FINE)).round() as u32)
}
