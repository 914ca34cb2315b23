//! The report page in a real browser: what a reader with a phone, a keyboard, a dark screen or no script gets.
//! Skipped with a notice where there is no Chromium.

#![allow(clippy::unwrap_used, reason = "a test may panic, and its helpers with it")]

use std::ffi::OsString;
use std::path::PathBuf;

use base64::Engine;
use mcvr_harness::RunSummary;
use mcvr_scene::Extent;
use serde_json::Value;
use tempfile::TempDir;

#[path = "browser/chromium.rs"]
mod chromium;
#[path = "../examples/mock_report/pretended.rs"]
mod pretended;

/// Pixels of the pictures; the viewer shows each as a square of five by five.
const EXTENT: (usize, usize) = (96, 80);
const SERIES: [u64; 3] = [1000, 4096, 30_000];

/// A report of pretended methods, and the browser to open it with.
struct Bench {
    browser: PathBuf,
    folder: TempDir,
    run: RunSummary,
}

impl Bench {
    fn new() -> Option<Self> {
        let browser = chromium::find()?;
        let folder = tempfile::tempdir().unwrap();
        let size = pretended::Size {
            extent: Extent::new(EXTENT.0, EXTENT.1).unwrap(),
            samples: (10..=16).map(|m| 1 << m).collect(),
            series: SERIES.to_vec(),
            replicates: 3,
        };
        let run = pretended::run(size, folder.path().join("run"), &|_, _, _| {}).unwrap();
        Some(Self { browser, folder, run })
    }

    fn report(&self) -> String {
        self.text("report.html")
    }

    fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.folder.path().join("run").join(name)).unwrap()
    }

    fn pixels(&self, name: &str) -> image::RgbImage {
        image::open(self.folder.path().join("run").join(name)).unwrap().to_rgb8()
    }

    /// Lets the probe look at a page; what it found, and the console.
    fn probe(&self, page: &str, mode: &str, flags: &[OsString]) -> (Value, Vec<String>) {
        let work = tempfile::tempdir_in(self.folder.path()).unwrap().keep();
        std::fs::write(work.join("page.html"), page).unwrap();
        let script = include_str!("browser/probe.js");
        let wrapper = format!(
            "<!DOCTYPE html><html><body><script>const PAGE = \"page.html\", MODE = \"{mode}\";\n{script}</script></body></html>"
        );
        std::fs::write(work.join("wrapper.html"), wrapper).unwrap();
        let mut all = flags.to_vec();
        let shot = flags.iter().any(|f| f.to_string_lossy().starts_with("--screenshot"));
        if !shot {
            all.push("--dump-dom".into());
        }
        let opened = chromium::open(&self.browser, &work.join("wrapper.html"), &work, &all);
        let text = opened.document.split("<pre id=\"found\" hidden=\"\">").nth(1).and_then(|t| t.split('<').next());
        let found = text.map_or(Value::Null, |text| {
            let bytes = base64::engine::general_purpose::STANDARD.decode(text).unwrap();
            serde_json::from_slice(&bytes).unwrap()
        });
        assert!(found["error"].is_null() && (found.is_object() || shot), "{}: {:?}", found["error"], opened.console);
        (found, opened.console)
    }
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map(Vec::as_slice).unwrap_or_else(|| panic!("{value} is no list"))
}

/// What holds in any frame.
fn holds(layout: &Value, run: &RunSummary) {
    assert_eq!(layout["scrollWidth"], layout["clientWidth"], "the page scrolls sideways");
    assert_eq!(layout["tooWide"], serde_json::json!([]), "beyond the edge");
    assert_eq!(layout["tables"], 5);
    assert_eq!(layout["unscoped"], 0);
    assert_eq!(list(&layout["plots"]).len(), 3, "one form of each plot");
    let pictures = list(&layout["pictures"]);
    assert_eq!(pictures.len(), 1 + 2 * run.methods.len() * SERIES.len());
    assert!(pictures.iter().all(|whole| *whole == true), "{pictures:?}");
    assert!(list(&layout["links"]).len() >= 5 && list(&layout["links"]).iter().all(|there| *there == true));
    let levels: Vec<u64> = list(&layout["levels"]).iter().map(|l| l.as_u64().unwrap()).collect();
    assert!(levels[0] == 1 && levels.iter().filter(|l| **l == 1).count() == 1, "{levels:?}");
    assert!(levels.windows(2).all(|pair| pair[1] <= pair[0] + 1), "no level is skipped: {levels:?}");
    assert_eq!(layout["fetched"], serde_json::json!([]), "nothing comes from elsewhere");
}

#[test]
fn the_page_works_on_a_phone_and_on_a_desk() {
    let Some(bench) = Bench::new() else { return };
    let (found, console) = bench.probe(&bench.report(), "work", &[]);
    assert!(console.is_empty(), "{console:#?}");
    for (width, plot) in [("375", "360"), ("1280", "760")] {
        let layout = &found["layout"][width];
        holds(layout, &bench.run);
        assert_eq!(layout["clientWidth"].to_string(), width);
        assert!(list(&layout["plots"]).iter().all(|w| w == plot), "{width}: {}", layout["plots"]);
        assert_eq!((&layout["live"], &layout["shownPictures"]), (&true.into(), &0.into()));
        words(&found["words"][width], &bench.run);
    }
    viewer(&found["view"], &bench.run);
    holds(&found["open"], &bench.run);
    let downloads = list(&found["downloads"]);
    assert_eq!(downloads.len(), 2);
    for (download, name) in downloads.iter().zip(["records.csv", "summary.json"]) {
        assert!(download["name"].as_str().unwrap().starts_with(name), "{download}");
        assert!(download["text"] == bench.text(name), "{name} is not what the link holds");
    }
}

/// The tooltip shows the point's method, sample count, error and time, and nothing when it should not.
fn words(found: &Value, run: &RunSummary) {
    assert_eq!(found["stops"], 1, "one stop of the tab key for a whole plot");
    for closed in ["before", "escaped", "away", "tappedElsewhere"] {
        assert_eq!(found[closed]["words"], Value::Null, "{closed}");
    }
    for (open, row) in [("focused", 0), ("right", 1)] {
        let name = &run.methods[0].name;
        let row = run.rows.iter().filter(|r| r.method == *name && !r.series_only).nth(row).unwrap();
        says(&found[open], run, row);
    }
    assert_eq!((&found["right"]["moved"], &found["down"]["moved"]), (&true.into(), &true.into()));
    assert!(found["down"]["words"].as_str().unwrap().starts_with(&run.methods[1].label), "{found}");
    let last = run.methods.last().unwrap();
    let row = run.rows.iter().rfind(|r| r.method == last.name && !r.series_only).unwrap();
    says(&found["pointed"], run, row);
    says(&found["tapped"], run, row);
    let label = found["label"].as_str().unwrap();
    assert_eq!(label, found["pointed"]["words"].as_str().unwrap().replace('\n', ", "), "what a screen reader says");
}

fn says(state: &Value, run: &RunSummary, row: &mcvr_harness::Row) {
    assert_eq!(state["inside"], true, "the tooltip is cut off: {state}");
    let words = state["words"].as_str().unwrap_or_else(|| panic!("no words: {state}"));
    let lines: Vec<&str> = words.lines().collect();
    let method = run.methods.iter().find(|m| m.name == row.method).unwrap();
    assert_eq!(lines[0], method.label);
    let number = |line: &str, name: &str| -> f64 {
        let rest = line.strip_prefix(name).unwrap_or_else(|| panic!("{line} does not begin with {name}"));
        rest.trim().split(' ').next().unwrap().replace(',', "").parse().unwrap()
    };
    assert_eq!(number(lines[1], "M ="), row.samples as f64);
    let error = number(lines[2], "Error") / (100.0 * row.error);
    assert!((error - 1.0).abs() < 0.005 && lines[2].ends_with('%'), "three digits: {} for {}", lines[2], row.error);
    let unit = [("µs", 1e-6), ("ms", 1e-3), ("s", 1.0)];
    let unit = unit.iter().find(|(unit, _)| lines[3].split(' ').nth(2) == Some(*unit)).unwrap().1;
    let time = number(lines[3], "Time") * unit / row.complete.median;
    assert!((time - 1.0).abs() < 0.005, "three digits: {} for {}", lines[3], row.complete.median);
    assert_eq!(lines[4], format!("{} replicates", row.replicates));
}

fn viewer(found: &Value, run: &RunSummary) {
    let label = |i: usize| run.methods[i].label.as_str();
    let caption = |state: &str| found[state]["caption"].as_str().unwrap().to_owned();
    assert_eq!((found["many"].as_u64(), found["methods"].as_u64()), (Some(3), Some(run.methods.len() as u64)));
    for state in ["start", "half", "truth", "difference", "first", "other", "button"] {
        let seen = &found[state];
        assert_eq!((&seen["image"], &seen["difference"]), (&true.into(), &true.into()), "{state}: another picture");
        assert_eq!(seen["spoken"], seen["caption"], "{state}");
    }
    let opacity = |state: &str| found[state]["opacity"].clone();
    assert_eq!(opacity("start"), serde_json::json!([1, 0, 0]));
    assert_eq!(opacity("half"), serde_json::json!([1, 0.5, 0]));
    assert_eq!(opacity("truth"), serde_json::json!([1, 1, 0]));
    assert_eq!(opacity("difference"), serde_json::json!([1, 1, 1]));
    assert_eq!(opacity("button"), serde_json::json!([1, 0, 0]));
    assert_eq!(found["truth"]["pressed"], serde_json::json!([false, true, false]));
    assert!(caption("start").starts_with(&format!("{}, M = 30,000, error", label(0))), "{}", caption("start"));
    assert!(caption("half").starts_with("50 % method, 50 % truth: "), "{}", caption("half"));
    assert_eq!(caption("truth"), "Truth, ray cast");
    assert!(caption("difference").starts_with(&format!("{} minus truth, M = 30,000", label(0))));
    assert!(found["first"]["setting"].as_str().unwrap().starts_with("M = 1,000, error"));
    // The sample count stays when the method changes.
    assert!(caption("other").starts_with(&format!("{} minus truth, M = 1,000", label(2))), "{}", caption("other"));
    assert!(caption("button").starts_with(&format!("{}, M = 1,000", label(2))), "{}", caption("button"));
    assert_eq!(found["shownPictures"].as_u64(), Some(1 + 2 * 4 * 3), "all pictures side by side");
}

#[test]
fn the_slider_shows_method_truth_and_difference_pixel_by_pixel() {
    let Some(bench) = Bench::new() else { return };
    let m = SERIES[2];
    let stops = [
        ("0", format!("images/mc-{m:010}.png")),
        ("20", "truth.png".into()),
        ("40", format!("images/mc-{m:010}-difference.png")),
    ];
    for (stop, name) in stops {
        let shot = bench.folder.path().join(format!("{stop}.png"));
        let mut screenshot = OsString::from("--screenshot=");
        screenshot.push(&shot);
        let (_, console) = bench.probe(&bench.report(), stop, &[screenshot, "--window-size=700,600".into()]);
        assert!(console.is_empty(), "{console:#?}");
        let (seen, wanted) = (image::open(&shot).unwrap().to_rgb8(), bench.pixels(&name));
        let middle = |x: u32, y: u32| *seen.get_pixel(5 * x + 2, 5 * y + 2);
        let wrong = wanted.enumerate_pixels().filter(|(x, y, pixel)| middle(*x, *y) != **pixel).count();
        assert_eq!(wrong, 0, "pixels of {name} at stop {stop}");
    }
}

#[test]
fn a_dark_screen_gets_a_dark_page_and_dark_plots() {
    let Some(bench) = Bench::new() else { return };
    let scheme = |flags: &[OsString]| bench.probe(&bench.report(), "look", flags).0["layout"]["375"].clone();
    // Blink counts dark as 0 and light as 1.
    let light = scheme(&["--blink-settings=preferredColorScheme=1".into()]);
    let dark = scheme(&["--blink-settings=preferredColorScheme=0".into()]);
    let bright = |value: &Value| -> f64 {
        let text = value.as_str().unwrap();
        let inside = text.split(['(', ')']).nth(1).unwrap_or_else(|| panic!("{text} is no colour"));
        inside.split(", ").map(|c| c.parse::<f64>().unwrap()).take(3).sum::<f64>() / 3.0
    };
    for (back, ink) in [("back", "ink"), ("plotBack", "plotInk")] {
        assert!(bright(&light[back]) > 240.0 && bright(&light[ink]) < 60.0, "{light}");
        assert!(bright(&dark[back]) < 40.0 && bright(&dark[ink]) > 200.0, "{dark}");
    }
}

#[test]
fn without_a_script_everything_is_there() {
    let Some(bench) = Bench::new() else { return };
    let (found, console) = bench.probe(&bench.report(), "still", &[]);
    // The frame's sandbox is how scripts are switched off; it says so.
    let other: Vec<_> = console.iter().filter(|line| !line.contains("Blocked script execution")).collect();
    assert!(other.is_empty() && console.len() == 1, "{console:#?}");
    let layout = &found["layout"]["375"];
    holds(layout, &bench.run);
    assert_eq!(layout["live"], false);
    assert_eq!(layout["shownPictures"].as_u64(), Some(1 + 2 * 4 * 3));
    let titles = list(&layout["titles"]);
    let points = bench.run.rows.iter().filter(|r| !r.series_only).count();
    // Three plots, each in two forms; a plot leaves out points that the truth's own error may touch.
    assert!(titles.len() > points && titles.len() <= 6 * points, "{} for {points}", titles.len());
    assert!(titles.iter().all(|t| t.as_str().unwrap().contains("\nError ")), "{titles:?}");
}

#[test]
fn what_the_probe_is_to_find_it_finds() {
    let Some(bench) = Bench::new() else { return };
    let page = bench.report();
    let planted = |what: &str| page.replacen("</main>", &format!("{what}</main>"), 1);
    let (found, _) = bench.probe(&planted("<p style=\"width: 2000px; max-width: none\">wide</p>"), "look", &[]);
    let layout = &found["layout"]["375"];
    assert_ne!(layout["scrollWidth"], layout["clientWidth"]);
    assert!(!list(&layout["tooWide"]).is_empty());
    let (_, console) = bench.probe(&planted("<script>console.warn('planted')</script>"), "look", &[]);
    assert!(console.len() == 1 && console[0].contains("planted"), "{console:?}");
    let (_, console) = bench.probe(&planted("<script>absent()</script>"), "look", &[]);
    assert!(console.len() == 1 && console[0].contains("absent is not defined"), "{console:?}");
    // The page forbids itself whatever is not inside it.
    let (_, console) = bench.probe(&planted("<img alt=\"\" src=\"https://example.invalid/a.png\">"), "look", &[]);
    assert!(console.iter().any(|line| line.contains("Content Security Policy")), "{console:?}");
    let broken = page.replacen("src=\"data:image/png;base64,iVBORw0KGgo", "src=\"data:image/png;base64,iVBORw0KGgx", 1);
    let (found, _) = bench.probe(&broken, "look", &[]);
    assert!(list(&found["layout"]["375"]["pictures"]).iter().any(|whole| *whole == false));
}
