//! Targets over the points of a chart. Their titles are what a browser shows under a resting pointer and what a screen
//! reader says, without any script; the page's script shows the same words at once.

use std::fmt::Write;

use super::axis::Field;
use super::pen::px;
use super::{Bar, Chart, FINE};
use crate::html::escape;

/// Radius of a target in CSS pixels: easy to hit with a pointer; fingers are helped by the page's script.
const RADIUS: i32 = 9;

impl Chart {
    /// A group of invisible circles for each curve; empty when no curve has words.
    pub(super) fn targets(&self, field: &Field<'_>) -> String {
        let mut text = String::new();
        for curve in self.curves.iter().filter(|c| !c.hover.is_empty()) {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "<g class=\"hits\" aria-label=\"{}\">", escape(&curve.label));
            for ((x, y), words) in curve.points.iter().zip(&curve.hover) {
                let (cx, cy) = px(at(field, x, y));
                let _ = writeln!(
                    text,
                    "<circle class=\"hit\" cx=\"{cx}\" cy=\"{cy}\" r=\"{}\" fill=\"none\" pointer-events=\"all\">\
                     <title>{}</title></circle>",
                    RADIUS * FINE,
                    escape(words)
                );
            }
            text.push_str("</g>\n");
        }
        text
    }
}

fn at(field: &Field<'_>, x: &Bar, y: &Bar) -> (f64, f64) {
    (field.x(x.mid), field.y(y.mid))
}
