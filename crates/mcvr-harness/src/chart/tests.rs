//! Claims about charts.

use super::*;
use crate::format::{percent_tick, power_tick};

fn bar(mid: f64, spread: f64) -> Bar {
    Bar { low: mid / spread, mid, high: mid * spread }
}

fn chart(methods: usize, counts: &[f64], spread: f64) -> Chart {
    let curve = |i: usize| {
        let error = |m: f64| (1.0 + 0.4 * i as f64).recip() * 20.0 / m.sqrt();
        let points = counts.iter().map(|&m| (bar(m, 1.0), bar(error(m), spread))).collect();
        let hover = counts.iter().map(|m| format!("method {i}\nM = {m}, \"<{i}>\"")).collect();
        Curve { label: format!("Method number {i} of several"), style: i, points, hover }
    };
    let curves: Vec<Curve> = (0..methods).map(curve).collect();
    let points = || curves.iter().flat_map(|c| &c.points);
    let x = Axis::holding(points().map(|p| p.0.mid), "Samples M", power_tick).unwrap();
    let y = Axis::holding(points().flat_map(|p| [p.1.low, p.1.high]), "Error", percent_tick).unwrap();
    Chart {
        name: "test.svg",
        title: "A title that is rather long because the data set has a long name: head of a person, 512 x 512 x 226"
            .into(),
        caption: vec!["word ".repeat(60)],
        x,
        y,
        guides: vec![Guide { label: "slope −1/2".into(), slope: -0.5, through: (counts[0], 1.0) }],
        curves,
        floor: None,
    }
}

fn texts(svg: &str) -> Vec<&str> {
    svg.split("<text").skip(1).filter_map(|t| t.split('>').nth(1)?.split('<').next().map(str::trim)).collect()
}

#[test]
fn axes_end_at_whole_decades_and_span_at_least_one() {
    let axis = |values: &[f64]| Axis::holding(values.iter().copied(), "", power_tick).map(|a| a.decades);
    assert_eq!(axis(&[2e3, 5e5]), Some([3, 6]));
    assert_eq!(axis(&[1e3, 1e6]), Some([3, 6]));
    assert_eq!(axis(&[300.0, 400.0]), Some([2, 3]));
    assert_eq!(axis(&[1000.0]), Some([3, 4]));
    assert_eq!(axis(&[0.2, f64::NAN, 0.0, f64::INFINITY]), Some([-1, 0]));
    assert_eq!(axis(&[0.0, -1.0]), None);
}

#[test]
fn every_axis_has_at_least_two_labels_even_within_a_decade() {
    for counts in [&[1000.0][..], &[2000.0, 3000.0], &[1e3, 1e9], &[1.0, 1e40]] {
        let chart = chart(2, counts, 1.0);
        for axis in [&chart.x, &chart.y] {
            let labels = axis.ticks().iter().filter(|t| t.2).count();
            assert!((2..=10).contains(&labels), "{labels} labels for {counts:?}");
        }
        let svg = chart.svg().unwrap();
        assert!(texts(&svg).contains(&"10³") || texts(&svg).contains(&"10⁰"), "{:?}", texts(&svg));
    }
}

#[test]
fn a_chart_is_one_svg_element_with_all_its_words() {
    let svg = chart(7, &[1e3, 1e4, 1e5], 1.3).svg().unwrap();
    assert!(
        svg.starts_with("<svg role=\"img\" width=\"760\" height=\"560\" viewBox=\"0 0 6080 4480\""),
        "{}",
        &svg[..120]
    );
    assert!(svg.trim_end().ends_with("</svg>") && svg.matches("<svg").count() == 1);
    for i in 0..7 {
        assert!(texts(&svg).contains(&format!("Method number {i} of several").as_str()));
    }
    assert!(texts(&svg).contains(&"slope −1/2"));
    assert_eq!(texts(&svg).iter().filter(|t| t.starts_with("word word")).count(), 3, "the caption is wrapped");
}

#[test]
fn the_legend_moves_to_the_corner_that_is_free() {
    let mut chart = chart(1, &[1e3, 1e4, 1e5], 1.0);
    let corner = |chart: &Chart| {
        let f = chart.field(&Layout::WIDE, 1, 0);
        let ((x, y), hidden) = chart.free_corner(&f);
        assert_eq!(hidden, 0);
        (x > (f.left + f.right) / 2.0, y > (f.top + f.bottom) / 2.0)
    };
    assert_eq!(corner(&chart), (true, false), "falling curve: top right");
    chart.curves[0].points.iter_mut().for_each(|(x, y)| *y = bar(x.mid * 1e-5, 1.0));
    chart.y = Axis::holding([1e-2, 1.0].into_iter(), "", percent_tick).unwrap();
    assert_eq!(corner(&chart), (false, false), "rising curve: top left");
}

#[test]
fn a_legend_that_fits_nowhere_gets_a_decade_of_its_own() {
    let crowded = chart(7, &[1e3, 1e4, 1e5], 1.3);
    assert!(crowded.free_corner(&crowded.field(&Layout::WIDE, 1, 0)).1 > 0);
    let roomy = crowded.with_room();
    assert_eq!(roomy.free_corner(&roomy.field(&Layout::WIDE, 1, 0)).1, 0);
    assert_eq!(roomy.y.decades, [crowded.y.decades[0], crowded.y.decades[1] + 1]);
}

/// Of more curves than a corner holds: the legend is to the right of every point, and the axis as it was.
#[test]
fn a_long_legend_stands_beside_the_field() {
    let width =
        |svg: &str| -> f64 { svg.split("width=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap() };
    let [few, many] = [7, 12].map(|curves| chart(curves, &[1e3, 1e4, 1e5], 1.3).svg().unwrap());
    assert!(width(&few) == 760.0 && width(&many) > 900.0, "{} {}", width(&few), width(&many));
    assert!((0..12).all(|i| texts(&many).contains(&format!("Method number {i} of several").as_str())));
}

#[test]
fn guides_stay_inside_the_field() {
    let chart = chart(1, &[1e3, 1e5], 1.0);
    let f = Field { left: 0.0, right: 100.0, top: 0.0, bottom: 100.0, x: &chart.x, y: &chart.y };
    for slope in [-2.0, -0.5, 1.0] {
        for through in [(1e3, 0.5), (1e3, 1e3), (1e4, 0.1)] {
            let guide = Guide { label: String::new(), slope, through };
            for (x, y) in f.clip(&guide, 1e5).into_iter().flatten() {
                assert!((-1e-6..=100.0 + 1e-6).contains(&x) && (-1e-6..=100.0 + 1e-6).contains(&y), "{guide:?}");
            }
        }
    }
}

#[test]
fn every_point_with_words_can_be_hit_and_says_them() {
    let mut chart = chart(3, &[1e3, 1e4], 1.0);
    chart.curves[1].hover.truncate(1);
    chart.curves[2].hover.clear();
    for svg in [chart.svg().unwrap(), chart.narrow_svg().unwrap()] {
        let hits: Vec<&str> = svg.split("<circle class=\"hit\"").skip(1).collect();
        assert_eq!(hits.len(), 3);
        assert!(hits[0].contains("<title>method 0\nM = 1000, &quot;&lt;0&gt;&quot;</title>"), "{}", hits[0]);
        assert!(svg.matches("aria-label=\"Method number").count() == 2 && svg.trim_end().ends_with("</g>\n</svg>"));
    }
    chart.curves.iter_mut().for_each(|c| c.hover.clear());
    assert!(!chart.svg().unwrap().contains("hit"), "a chart without words is as before");
}

#[test]
fn a_target_lies_on_its_point() {
    let chart = chart(1, &[1e3, 1e5], 1.0);
    let svg = chart.svg().unwrap();
    let number = |text: &str, name: &str| -> i32 {
        text.split(&format!("{name}=\"")).nth(1).and_then(|t| t.split('"').next()).unwrap().parse().unwrap()
    };
    let at = |text: &str| (number(text, "cx"), number(text, "cy"));
    let hits: Vec<_> = svg.split("<circle class=\"hit\"").skip(1).map(at).collect();
    // Markers of the first style are circles as well; the last is that of the legend.
    let markers: Vec<_> = svg.split("<circle cx").skip(1).map(|t| at(&format!("cx{t}"))).collect();
    assert_eq!(hits[..], markers[..2]);
}

#[test]
fn a_narrow_chart_keeps_all_words_within_its_width() {
    let svg = chart(3, &[1e3, 1e5], 1.3).narrow_svg().unwrap();
    assert!(svg.starts_with("<svg role=\"img\" width=\"360\""), "{}", &svg[..80]);
    let words = texts(&svg);
    assert!(words.contains(&"Method number 2 of several") && words.contains(&"slope −1/2"));
    assert!(words.iter().all(|w| w.chars().count() <= 56), "{words:?}");
    assert_eq!(words.iter().flat_map(|w| w.split(' ')).filter(|w| *w == "word").count(), 60);
}
