//! Measures: errors and fits of images that break squares, sums and logarithms.

use mcvr_harness::fit::ErrorsAt;
use mcvr_harness::{Comparison, SlopeFit};
use mcvr_scene::{Extent, Image};

use super::{Bound, Case, CaseError, Context, Cost, Finding, Group};

const fn case(
    name: &'static str,
    breaks: &'static str,
    asserts: &'static str,
    measure: fn(&Context) -> Result<Finding, CaseError>,
) -> Case {
    Case { name, group: Group::Measures, breaks, asserts, cost: Cost::Quick, measure }
}

pub(super) const CASES: &[Case] = &[
    case(
        "error-of-tiny-and-huge-images",
        "squares of differences of 1e-170 vanish and an arbitrary error counts as 0; those of 1e170 overflow",
        "every relative figure of two images is the same, bit for bit, after multiplying both by 2^k, k = -1000 to 1000",
        scaled,
    ),
    case(
        "error-over-1000-octaves",
        "differences from 2^-500 to 2^500 in one image: a sum of squares overflows or loses all but the largest",
        "the RMSE against the closed form of the geometric series",
        octaves,
    ),
    case(
        "bias-under-cancellation",
        "signed errors of 1e9 that cancel to 1e-9 a pixel: a running sum returns rounding noise as bias",
        "the mean signed error against the exact one",
        cancelling,
    ),
    case(
        "small-error-on-a-large-offset",
        "mean(x²) − mean(x)² cancels to nothing or below zero, and its root is no number",
        "the standard error of the bias for differences of ±2^-10 about 2^20",
        offset,
    ),
    case(
        "undefined-figures",
        "equal images give a PSNR of infinity, a black truth divides by zero; either ends up in a table or a JSON file",
        "figures that are not defined are absent, and none is NaN or infinite",
        undefined,
    ),
    case(
        "pixels-that-are-no-numbers",
        "one NaN makes every figure NaN, or is skipped and the error looks better than it is",
        "NaN, infinite and too distant pixels are refused, and the message names the pixel",
        not_numbers,
    ),
    case(
        "slope-over-40-octaves",
        "logarithms of errors near 1e-300 lose digits, or M = 2^40 loses its last bits as a float",
        "the fitted exponent of 1e-290 M^(-2/3), M = 1 to 2^40",
        long_slope,
    ),
    case(
        "slope-of-too-few-points",
        "one point, equal M, errors of zero or below the truth's own error: 0/0 in the fit is printed as a slope",
        "no slope where there is none; with two points a slope without an interval",
        short_slope,
    ),
];

fn image(values: Vec<f64>) -> Result<Image, CaseError> {
    Ok(Image::from_values(Extent::new(values.len(), 1)?, values)?)
}

/// The figures that do not carry a unit.
fn relative(c: &Comparison) -> [Option<f64>; 7] {
    [c.rel_rmse, c.rel_rmse_peak, c.mae, c.max, c.psnr, c.bias, c.bias_se]
}

/// Exact. Multiplying by a power of two rounds nothing while all numbers stay normal. The pixels lie in [1, 2), so they do;
/// differences are at least 2^-12 by construction, so those do as well.
fn scaled(_: &Context) -> Result<Finding, CaseError> {
    let pixels = |seed: u64| -> Vec<f64> {
        (0..257u64).map(|i| 1.0 + f64::from((i.wrapping_mul(seed) >> 3) as u32 % 4096) / 4096.0).collect()
    };
    let (test, truth) = (pixels(0x9e37_79b9), pixels(0x85eb_ca6b));
    let plain = relative(&Comparison::of(&image(test.clone())?, &image(truth.clone())?)?);
    let (mut wrong, mut naive, mut of) = (0, 0, 0);
    for k in (-1000..=1000).step_by(125) {
        let unit = 2f64.powi(k);
        let times = |v: &[f64]| image(v.iter().map(|v| v * unit).collect());
        let c = Comparison::of(&times(&test)?, &times(&truth)?)?;
        let bits = |f: [Option<f64>; 7]| f.map(|v| v.map(f64::to_bits));
        of += 1;
        wrong += u64::from(bits(relative(&c)) != bits(plain));
        let squares: f64 = test.iter().zip(&truth).map(|(a, b)| ((a - b) * unit).powi(2)).sum();
        naive += u64::from(squares == 0.0 || squares.is_infinite());
    }
    Ok(Finding::wrong(wrong, of, "scales").with(format!("plain sums of squares are 0 or infinite at {naive} of {of}")))
}

/// Differences 2^i, i = -500 to 500, against a truth of zeros: Σ d² = (4^501 − 4^-500) / 3, of which 4^501 / 3 is the nearest
/// double. Every square is exact or vanishes below 2^-1000 of the sum; a compensated sum is off by 2 ulp at most, the division,
/// the root and its scaling by one each: 5 · 2^-53 relatively, 8 granted.
fn octaves(_: &Context) -> Result<Finding, CaseError> {
    let values: Vec<f64> = (-500..=500).map(|i| 2f64.powi(i)).collect();
    let n = values.len() as f64;
    let c = Comparison::of(&image(values.clone())?, &image(vec![0.0; values.len()])?)?;
    let expected = 2f64.powi(501) / (3.0 * n).sqrt();
    let off = (c.rmse / expected - 1.0).abs() / f64::EPSILON;
    let f32s: f32 = values.iter().map(|v| (*v as f32).powi(2)).sum();
    Ok(Finding::new(off, "× 2^-52, relative", Bound::AtMost(4.0)).with(format!("summed in f32: {f32s}")))
}

/// Differences ±2^30 in turn, which cancel, and 2^-30 in every hundredth pixel; the truth is black but for one pixel of 1, where
/// the image agrees. The bias over the truth's mean is then Σ d = 20 · 2^-30. Neumaier's sum is off by at most
/// 2^-53 |Σ d| + n² 2^-106 Σ |d| (Ogita, Rump and Oishi 2005, proposition 4.5): for n = 2,000 and Σ |d| < 2^41 by 1.1e-13, which
/// over Σ d = 1.9e-8 is 5.8e-6; the other roundings are of 1e-16.
fn cancelling(_: &Context) -> Result<Finding, CaseError> {
    let n = 2000usize;
    let mut truth = vec![0.0; n];
    truth[1] = 1.0;
    let values: Vec<f64> = (0..n)
        .map(|i| match i % 100 {
            0 => 2f64.powi(-30),
            1 => truth[i],
            i if i % 2 == 0 => 2f64.powi(30),
            _ => -(2f64.powi(30)),
        })
        .collect();
    let exact = 20.0 * 2f64.powi(-30);
    let naive = values.iter().zip(&truth).map(|(v, t)| v - t).sum::<f64>() / exact;
    let c = Comparison::of(&image(values)?, &image(truth)?)?;
    let off = (c.bias.ok_or("no bias")? / exact - 1.0).abs();
    Ok(Finding::new(off, "relative", Bound::AtMost(6e-6)).with(format!("a running sum gives {naive} times the bias")))
}

/// Differences alternate 2^20 ± 2^-10 over n = 2^12 pixels, all exact: their mean is 2^20, each deviation 2^-10, so the standard
/// error is 2^-10 / √(n − 1). Mean, deviations and squares are exact in doubles (31 bits are needed), the sum exact (a multiple
/// of 2^-20 below 2^53 of them); what is left is a division, a root, and the division by the truth's mean: 3 · 2^-53, 4 granted.
fn offset(_: &Context) -> Result<Finding, CaseError> {
    let n = 1usize << 12;
    let values: Vec<f64> = (0..n).map(|i| 2f64.powi(20) + if i % 2 == 0 { 1.0 } else { -1.0 } / 1024.0).collect();
    let single: Vec<f32> = values.iter().map(|v| *v as f32).collect();
    let mean = single.iter().sum::<f32>() / n as f32;
    let naive = single.iter().map(|v| v * v).sum::<f32>() / n as f32 - mean * mean;
    let truth = vec![1.0; n];
    let test = image(values.iter().map(|v| v + 1.0).collect())?;
    let c = Comparison::of(&test, &image(truth)?)?;
    let expected = 2f64.powi(-10) / ((n - 1) as f64).sqrt();
    let off = (c.bias_se.ok_or("no standard error")? / expected - 1.0).abs() / f64::EPSILON;
    Ok(Finding::new(off, "× 2^-52, relative", Bound::AtMost(2.0))
        .with(format!("mean(x²) − mean(x)² in f32: {naive:e}")))
}

/// Exact.
fn undefined(_: &Context) -> Result<Finding, CaseError> {
    let compare = |a: &[f64], b: &[f64]| -> Result<Comparison, CaseError> {
        Ok(Comparison::of(&image(a.to_vec())?, &image(b.to_vec())?)?)
    };
    let equal = compare(&[1.0, 2.0], &[1.0, 2.0])?;
    let black = compare(&[1.0, 2.0], &[0.0, 0.0])?;
    let balanced = compare(&[1.0, 2.0], &[1.0, -1.0])?;
    let one = compare(&[1.0], &[2.0])?;
    let both_black = compare(&[0.0, 0.0], &[0.0, 0.0])?;
    let expected = [
        equal.psnr.is_none() && equal.rel_rmse == Some(0.0),
        relative(&black).iter().all(Option::is_none),
        balanced.rel_rmse.is_none() && balanced.rel_rmse_peak.is_some(),
        one.bias_se.is_none() && one.rel_rmse == Some(0.5),
        relative(&both_black).iter().all(Option::is_none) && both_black.rmse == 0.0,
    ];
    let finite =
        [equal, black, balanced, one, both_black].map(|c| relative(&c).iter().flatten().all(|v| v.is_finite()));
    let wrong = expected.iter().chain(&finite).filter(|ok| !**ok).count() as u64;
    Ok(Finding::wrong(wrong, (expected.len() + finite.len()) as u64, "checks"))
}

/// Exact: each of the images is refused, with the pixel's column and row in the message where one pixel is to blame.
fn not_numbers(_: &Context) -> Result<Finding, CaseError> {
    let good = Image::from_values(Extent::new(3, 2)?, vec![1.0; 6])?;
    let (mut wrong, mut of) = (0, 0);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut damaged = good.clone();
        damaged.values_mut()[4] = bad;
        for (a, b) in [(&damaged, &good), (&good, &damaged)] {
            of += 1;
            let named = Comparison::of(a, b).err().is_some_and(|e| e.to_string().contains("(1, 1)"));
            wrong += u64::from(!named);
        }
    }
    of += 1;
    wrong += u64::from(Comparison::of(&image(vec![f64::MAX])?, &image(vec![-f64::MAX])?).is_ok());
    Ok(Finding::wrong(wrong, of, "images"))
}

/// The points lie on a line up to the rounding of the power (2 ulp of the error, 1e-15 in its logarithm) and of the logarithm
/// itself (1 ulp of 300: 6e-14). A least-squares slope over 41 equidistant points of spacing 0.301 with errors of at most
/// 6.1e-14 each is off by at most Σ|x − x̄| ε / Σ(x − x̄)² = 126 / 520 ε = 1.5e-14, and rounding inside the fit adds n ulp of its
/// terms, 41 · 300 · 1.1e-16 / 12 = 1.1e-13.
fn long_slope(_: &Context) -> Result<Finding, CaseError> {
    let points: Vec<ErrorsAt> = (0..=40)
        .map(|m| ErrorsAt { samples: 1 << m, errors: vec![1e-290 * (2f64.powi(m)).powf(-2.0 / 3.0)] })
        .collect();
    let fit = SlopeFit::of(&points, 0.0).ok_or("no fit")?;
    Ok(Finding::new((fit.slope + 2.0 / 3.0).abs(), "off −2/3", Bound::AtMost(1.3e-13)))
}

/// Exact.
fn short_slope(_: &Context) -> Result<Finding, CaseError> {
    let at = |samples: u64, error: f64| ErrorsAt { samples, errors: vec![error] };
    let none = [
        vec![],
        vec![at(10, 0.1)],
        vec![at(10, 0.1), at(10, 0.2)],
        vec![at(10, 0.1), at(20, 0.0)],
        vec![at(0, 0.1), at(20, 0.1)],
        vec![at(10, 0.1), at(20, f64::NAN)],
        vec![at(10, 0.1), at(20, f64::INFINITY)],
        vec![at(10, 0.1), ErrorsAt { samples: 20, errors: vec![] }],
        // Below ten times the truth's own error.
        vec![at(10, 0.01), at(20, 0.009), at(40, 0.008)],
    ];
    let mut wrong = none.iter().filter(|points| SlopeFit::of(points, 1e-3).is_some()).count();
    let two = SlopeFit::of(&[at(10, 0.4), at(40, 0.2)], 1e-3);
    wrong += usize::from(!two.is_some_and(|f| (f.slope + 0.5).abs() < 1e-12 && f.low.is_none() && f.high.is_none()));
    Ok(Finding::wrong(wrong as u64, none.len() as u64 + 1, "fits"))
}
