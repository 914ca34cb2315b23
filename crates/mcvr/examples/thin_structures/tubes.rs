//! Straight tubes thinner than a few voxels, whose images are known in closed form.

use glam::DVec3;
use mcvr::scene::{Image, View};
use mcvr::volume::Grid;

use crate::kernels::candidates;
use crate::report::{Row, spread};
use crate::ridges::Section;
use crate::{Outcome, Weights, Yardstick, parallel, rmse, shown};

/// Radii in voxels.
const RADII: [f64; 3] = [0.5, 1.0, 1.5];
/// Voxels per axis.
const SIDE: usize = 40;
/// Directions of the tubes of each radius.
const DIRECTIONS: usize = 12;
/// Pixels per voxel.
const SCALE: f64 = 4.0;
/// Points per axis that average a voxel, and a pixel of the truth.
const SUB: usize = 8;
/// Half the length, in voxels, over which sections are taken.
const HALF: f64 = 7.0;

/// An endless tube of density 1: a point on its axis, its direction, its radius.
struct Tube {
    point: DVec3,
    axis: DVec3,
    radius: f64,
}

impl Tube {
    /// Tube `n`: directions of a Fibonacci half-sphere, axes off the lattice by irrational shares of a voxel.
    fn new(n: usize, radius: f64) -> Self {
        let z = (n as f64 + 0.5) / DIRECTIONS as f64;
        let (sin, cos) = (2.399_963_229_728_653 * n as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        let share = |a: f64| (a * (n + 1) as f64).fract() - 0.5;
        let middle = DVec3::splat((SIDE - 1) as f64 / 2.0);
        let point = middle + DVec3::new(share(0.754_877_666), share(0.569_840_290), share(0.430_159_709));
        Self { point, axis: DVec3::new(r * cos, r * sin, z), radius }
    }

    fn inside(&self, x: DVec3) -> bool {
        (x - self.point).cross(self.axis).length_squared() <= self.radius * self.radius
    }

    /// Voxels as a scanner without blur would store them: the share of each that lies inside.
    fn voxels(&self) -> Outcome<Weights> {
        let grid = Grid::with_spacing([SIDE; 3], [1.0; 3])?;
        let sub = |s: usize| (2 * s + 1) as f64 / (2 * SUB) as f64 - 0.5;
        let share = |n: usize| {
            let centre = DVec3::from_array(grid.unravel(n).map(|v| v as f64));
            if (centre - self.point).cross(self.axis).length() > self.radius + 0.87 {
                return 0.0;
            }
            let points = (0..SUB * SUB * SUB).map(|s| DVec3::new(sub(s % SUB), sub(s / SUB % SUB), sub(s / SUB / SUB)));
            points.filter(|&o| self.inside(centre + o)).count() as f32 / (SUB * SUB * SUB) as f32
        };
        Ok(Weights { values: (0..grid.len()).map(share).collect(), grid })
    }

    /// The line integral along a ray that crosses the tube: a chord, `2 √(r² − d²) / sin θ`.
    fn chord(&self, origin: DVec3, direction: DVec3) -> f64 {
        let across = self.axis.cross(direction);
        let sine = across.length();
        let d = (origin - self.point).dot(across) / sine;
        2.0 * (self.radius * self.radius - d * d).max(0.0).sqrt() / sine
    }
}

/// The images of one tube and where its sections lie.
struct Case {
    weights: Weights,
    camera: mcvr::scene::Camera,
    truth: Image,
    yardstick: Yardstick,
}

impl Case {
    fn new(n: usize, radius: f64) -> Outcome<Option<Self>> {
        let tube = Tube::new(n, radius);
        let view = View { azimuth: 30.0, elevation: 20.0, ..View::default() };
        let weights = tube.voxels()?;
        let camera = parallel(view, &weights.grid, SCALE)?;
        // A tube seen nearly end on has no long image.
        if tube.axis.cross(camera.axis()).length() < 0.6 {
            return Ok(None);
        }
        let mut truth = Image::zeros(camera.extent());
        let width = camera.extent().width;
        let sub = |s: usize| (2 * s + 1) as f64 / (2 * SUB) as f64;
        for (n, value) in truth.values_mut().iter_mut().enumerate() {
            let at = |s: usize| {
                let ray = camera.ray((n % width) as f64 + sub(s % SUB), (n / width) as f64 + sub(s / SUB));
                tube.chord(ray.origin, ray.direction)
            };
            *value = (0..SUB * SUB).map(at).sum::<f64>() / (SUB * SUB) as f64;
        }
        let flat = |x: DVec3| {
            let (px, py, _) = camera.project(x);
            [px, py]
        };
        let [a, b] = [flat(tube.point), flat(tube.point + tube.axis)];
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        let normal = [-(b[1] - a[1]) / length, (b[0] - a[0]) / length];
        // Half a voxel apart along the tube; the background is 0, six voxels off on both sides at the scale of the
        // measurement (a pixel pair to a voxel of the measure, see `VOXEL`).
        let steps = (2.0 * HALF / 0.5) as i64;
        let sections: Vec<Section> = (0..=steps)
            .map(|s| {
                let at = flat(tube.point + tube.axis * (s as f64 * 0.5 - HALF));
                Section { at, normal, sides: [-6.0 * SCALE, 6.0 * SCALE], reach: 10.0 * SCALE }
            })
            .collect();
        let yardstick = Yardstick::new(&truth, &sections, SCALE);
        if yardstick.sections.len() != sections.len() {
            return Err(format!("a tube along {} cannot be measured in its own truth", tube.axis).into());
        }
        Ok(Some(Self { weights, camera, truth, yardstick }))
    }

    /// RMSE over the pixels near the sections, over the mean of the truth there.
    fn error(&self, image: &Image) -> Outcome<f64> {
        let [first, last] = [0, self.yardstick.sections.len() - 1].map(|n| self.yardstick.sections[n].at);
        let (cx, cy) = (0.5 * (first[0] + last[0]), 0.5 * (first[1] + last[1]));
        let r = HALF * SCALE;
        let inside = |n: usize| {
            let (x, y) = ((n % image.extent().width) as f64 - cx, (n / image.extent().width) as f64 - cy);
            x.abs() <= r && y.abs() <= r
        };
        let keep = |image: &Image| -> Outcome<Image> {
            let kept: Vec<f64> =
                image.values().iter().enumerate().filter(|(n, _)| inside(*n)).map(|(_, v)| *v).collect();
            Ok(Image::from_values(mcvr::scene::Extent::new(kept.len(), 1)?, kept)?)
        };
        rmse(&keep(image)?, &keep(&self.truth)?)
    }
}

/// Standard deviation over the mean.
fn unevenness(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt() / mean
}

/// Every kernel on the tubes of every radius, against the chords.
pub fn study(rows: &mut Vec<Row>) -> Outcome<()> {
    for radius in RADII {
        let mut cases: Vec<Case> = vec![];
        for n in 0..DIRECTIONS {
            cases.extend(Case::new(n, radius)?);
        }
        println!("tubes of radius {radius}: {} of {DIRECTIONS} directions", cases.len());
        for candidate in candidates() {
            let (mut all, mut beads, mut errors, mut checks) = (vec![], vec![], vec![], vec![]);
            let mut last = None;
            for case in &cases {
                let shown = shown(&case.weights, &candidate, &case.camera)?;
                let measures = case.yardstick.compared(&shown.image);
                let contrast: Vec<f64> = measures.iter().flatten().map(|m| m[0]).collect();
                if contrast.len() > 1 {
                    beads.push(unevenness(&contrast));
                }
                errors.push(case.error(&shown.image)?);
                checks.extend(shown.check);
                all.extend(measures);
                last = Some(shown);
            }
            let Some(mut last) = last else { continue };
            last.check = checks.into_iter().reduce(f64::max);
            let name = format!("tubes r = {radius}");
            let row = Row::new("closed form", &name, &candidate, &last, &all, [1.0 / SCALE, SCALE]);
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            let row = row.rmse(mean).beading(spread(beads)[1]);
            println!("  {row}");
            rows.push(row);
        }
    }
    Ok(())
}
