//! The projection of a tent onto an axis of the image.

/// Reach of a shape of variance 1/3 and its nodes: three equal tents reach to 2.45.
const REACH: f32 = 2.5;
const NODES: usize = 512;

/// Points that stand for a tent while others are added to it.
const POINTS: usize = 12;

/// Integral of the sum of three tents, scaled to a variance of 1/3, from minus infinity.
pub(crate) struct Shape {
    nodes: Vec<f32>,
}

/// Integral of a tent of half width 1 from minus infinity.
fn tent_integral(x: f32) -> f32 {
    let beyond = 1.0 - x.abs().min(1.0);
    let tail = 0.5 * beyond * beyond;
    if x < 0.0 { tail } else { 1.0 - tail }
}

impl Shape {
    /// For the steps along the image's axis that a voxel's step along each of its axes makes: they are the tents' half widths.
    pub fn new(steps: [f32; 3]) -> Self {
        let scale = (0.5 * steps.iter().map(|s| s * s).sum::<f32>()).sqrt().max(1e-30);
        let mut widths = steps.map(|s| s.abs() / scale);
        widths.sort_by(f32::total_cmp);
        // Places of equal shares of a tent, with its variance.
        let mut points = [0f32; POINTS];
        for (n, p) in points.iter_mut().enumerate() {
            let u = (n as f32 + 0.5) / POINTS as f32;
            *p = if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).sqrt() };
        }
        let variance = points.iter().map(|p| p * p).sum::<f32>() / POINTS as f32;
        let stretch = (1.0 / 6.0 / variance).sqrt();
        let widest = widths[2].max(1e-30);
        let mut shifts = [0f32; POINTS * POINTS];
        for (n, shift) in shifts.iter_mut().enumerate() {
            *shift = stretch * (points[n / POINTS] * widths[0] + points[n % POINTS] * widths[1]) / widest;
        }
        let mut nodes = vec![0f32; NODES + 1];
        // The second half is the first one's mirror image.
        for n in 0..=NODES / 2 {
            let x = (n as f32 / NODES as f32 * 2.0 - 1.0) * REACH / widest;
            let mut sum = 0.0;
            for shift in &shifts {
                sum += tent_integral(x - shift);
            }
            nodes[n] = sum / (POINTS * POINTS) as f32;
            nodes[NODES - n] = 1.0 - nodes[n];
        }
        Self { nodes }
    }

    /// The integral up to `x`, in units of the knot distance: `√(3 variance)`.
    #[inline(always)]
    pub fn integral(&self, x: f32) -> f32 {
        let at = ((x / REACH + 1.0) * 0.5 * NODES as f32).clamp(0.0, NODES as f32 - 0.001);
        let n = at as usize;
        let [low, high] = [self.nodes[n], self.nodes[n + 1]];
        low + (at - n as f32) * (high - low)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean, variance and mass, by summing over small steps; and one tent alone exactly.
    #[test]
    fn shapes_have_a_third_of_variance() {
        for steps in [[1.0, 0.0, 0.0], [0.0, 2.0, 2.0], [3.0, 3.0, 3.0], [0.3, -0.8, 0.1]] {
            let shape = Shape::new(steps);
            let (mut mass, mut variance) = (0.0, 0.0);
            for n in -300..300 {
                let x = n as f32 * 0.01;
                let part = shape.integral(x + 0.01) - shape.integral(x);
                mass += part;
                variance += part * (x + 0.005).powi(2);
            }
            assert!((mass - 1.0).abs() < 1e-5 && (variance - 1.0 / 3.0).abs() < 1e-3, "{steps:?}: {mass} {variance}");
        }
        let (shape, half) = (Shape::new([0.0, -5.0, 0.0]), 2f32.sqrt());
        for n in -30..30 {
            let x = n as f32 * 0.1;
            assert!((shape.integral(x) - tent_integral(x / half)).abs() < 1e-4, "{x}");
        }
    }
}
