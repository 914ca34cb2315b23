//! Kinds of pixels, by the truth alone.

use mcvr::scene::Image;

/// Pixels that are judged together.
pub struct Group {
    pub name: String,
    pub pixels: Vec<usize>,
}

/// Names of the strata, in [`strata`]'s order.
pub const STRATA: [&str; 4] = ["dark", "bright", "edge", "all"];

/// Of the pixels that are not empty: the darkest third, the brightest third, the tenth with the steepest gradient, and all.
pub fn strata(truth: &Image) -> Vec<Group> {
    let mut all: Vec<usize> = (0..truth.values().len()).filter(|&p| truth.values()[p] > 0.0).collect();
    let steepness = gradient(truth);
    let by = |key: &[f64], pixels: &[usize]| {
        let mut sorted = pixels.to_vec();
        sorted.sort_by(|&a, &b| key[a].total_cmp(&key[b]));
        sorted
    };
    let bright = by(truth.values(), &all);
    let steep = by(&steepness, &all);
    all.sort_unstable();
    let n = all.len();
    let kinds = [bright[..n / 3].to_vec(), bright[n - n / 3..].to_vec(), steep[n - n / 10..].to_vec(), all];
    STRATA.into_iter().zip(kinds).map(|(name, pixels)| Group { name: name.into(), pixels }).collect()
}

/// Length of the gradient by central differences, value per pixel; one-sided at the border.
fn gradient(image: &Image) -> Vec<f64> {
    let extent = image.extent();
    let slope = |low: f64, high: f64, apart: usize| if apart == 0 { 0.0 } else { (high - low) / apart as f64 };
    let of = |p: usize| {
        let (x, y) = (p % extent.width, p / extent.width);
        let (west, east) = (x.saturating_sub(1), (x + 1).min(extent.width - 1));
        let (north, south) = (y.saturating_sub(1), (y + 1).min(extent.height - 1));
        let dx = slope(image.get(west, y), image.get(east, y), east - west);
        let dy = slope(image.get(x, north), image.get(x, south), south - north);
        dx.hypot(dy)
    };
    (0..extent.pixels()).map(of).collect()
}

/// Pixels by the number of samples that they expect: 0 to 1, 1 to 2, 2 to 4, ..., 256 and more. Empty pixels are left out.
pub fn by_samples(expected: &[f64]) -> Vec<Group> {
    const LAST: i32 = 9;
    let class = |e: f64| if e < 1.0 { 0 } else { (e.log2() as i32 + 1).min(LAST) };
    let name = |c: i32| match c {
        0 => "below 1".to_owned(),
        LAST => format!("from {}", 1 << (LAST - 1)),
        c => format!("{} to {}", 1 << (c - 1), 1 << c),
    };
    let of = |c| (0..expected.len()).filter(|&p| expected[p] > 0.0 && class(expected[p]) == c).collect();
    (0..=LAST).map(|c| Group { name: name(c), pixels: of(c) }).filter(|g: &Group| !g.pixels.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvr::scene::Extent;

    #[test]
    fn strata_are_thirds_and_a_tenth_of_what_is_not_empty() {
        // 0 in the first column, then a ramp with a step.
        let values =
            (0..60).map(|p| [0.0, 1.0, 2.0, 3.0, 50.0, 51.0][p % 6] + if p % 6 > 0 { p as f64 * 1e-3 } else { 0.0 });
        let image = Image::from_values(Extent::new(6, 10).unwrap(), values.collect()).unwrap();
        let s = strata(&image);
        assert_eq!(s.iter().map(|g| g.pixels.len()).collect::<Vec<_>>(), [16, 16, 5, 50]);
        assert!(s[0].pixels.iter().all(|p| [1, 2].contains(&(p % 6))));
        assert!(s[1].pixels.iter().all(|p| [4, 5].contains(&(p % 6))));
        assert!(s[2].pixels.iter().all(|p| [3, 4].contains(&(p % 6))), "beside the step");
    }

    #[test]
    fn gradients_are_per_pixel_at_the_border_too() {
        let image = Image::from_values(Extent::new(3, 2).unwrap(), vec![0.0, 3.0, 6.0, 4.0, 7.0, 10.0]).unwrap();
        assert!(gradient(&image).iter().all(|g| (g - 5.0).abs() < 1e-12));
    }

    #[test]
    fn pixels_fall_into_octaves_of_samples() {
        let groups = by_samples(&[0.0, 0.5, 1.0, 1.99, 2.0, 255.0, 256.0, 1e6]);
        let found: Vec<(&str, &[usize])> = groups.iter().map(|g| (g.name.as_str(), &g.pixels[..])).collect();
        let all: [(&str, &[usize]); 5] =
            [("below 1", &[1]), ("1 to 2", &[2, 3]), ("2 to 4", &[4]), ("128 to 256", &[5]), ("from 256", &[6, 7])];
        assert_eq!(found, all);
    }
}
