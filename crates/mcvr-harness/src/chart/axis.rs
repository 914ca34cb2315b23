//! Where values lie on a chart: axes in decades, and the rectangle that they span.

use super::Guide;

/// A logarithmic axis over whole decades.
#[derive(Clone, Debug)]
pub(crate) struct Axis {
    pub(super) decades: [i32; 2],
    pub(super) name: String,
    pub(super) label: fn(f64) -> String,
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
    pub(super) fn ticks(&self) -> Vec<(f64, bool, bool)> {
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

/// The rectangle of the data, in CSS pixels.
pub(super) struct Field<'a> {
    pub(super) left: f64,
    pub(super) right: f64,
    pub(super) top: f64,
    pub(super) bottom: f64,
    pub(super) x: &'a Axis,
    pub(super) y: &'a Axis,
}

impl Field<'_> {
    pub(super) fn x(&self, value: f64) -> f64 {
        self.left + (self.right - self.left) * self.x.position(value).clamp(0.0, 1.0)
    }

    pub(super) fn y(&self, value: f64) -> f64 {
        self.bottom - (self.bottom - self.top) * self.y.position(value).clamp(0.0, 1.0)
    }

    /// The part of a guide inside the field, ends in CSS pixels; it runs from its point to the right, up to `reach`.
    pub(super) fn clip(&self, guide: &Guide, reach: f64) -> Option<[(f64, f64); 2]> {
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
