//! The tables of the page.

use std::fmt::Write as _;

use mcvr::harness::format::{percent, samples, seconds, significant};

use crate::Outcome;
use crate::bias::LIMIT;
use crate::entrants::{MC, NET, Points};
use crate::figures::{Figures, Place, TARGET, geometric};
use crate::scans::VIEWS;

const TITLE: &str = "## Error × √time";

fn cell(value: Option<String>) -> String {
    value.unwrap_or_else(|| "–".into())
}

fn head(page: &mut String, first: &[&str], others: &[String]) -> Outcome<()> {
    writeln!(page, "| {} | {} |", first.join(" | "), others.join(" | "))?;
    writeln!(page, "|{}{}", "---|".repeat(first.len()), "---:|".repeat(others.len()))?;
    Ok(())
}

/// Position of the least.
fn least(values: &[Option<f64>]) -> Option<usize> {
    let known = values.iter().enumerate().filter_map(|(i, v)| Some((i, (*v)?)));
    known.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
}

/// A column, its least in bold.
fn column(values: &[Option<f64>], show: impl Fn(f64) -> String) -> Vec<String> {
    let best = least(values);
    let text = |(i, v): (usize, &Option<f64>)| match v {
        Some(v) if best == Some(i) => format!("**{}**", show(*v)),
        Some(v) => show(*v),
        None => "–".into(),
    };
    values.iter().enumerate().map(text).collect()
}

fn two(value: f64) -> String {
    format!("{value:.2}")
}

impl Figures<'_> {
    fn seen(&self, view: &str) -> impl Iterator<Item = &Place> {
        self.places.iter().filter(move |p| p.view == view)
    }

    /// Standard error, relative, of the mean over the scans of a method's error over that of independent samples.
    fn uncertainty(&self, view: &str, method: &str, level: u32) -> Option<f64> {
        let square = |p: &Place, m: &str| self.error(p, m, level).map(|(e, se)| (se / e).powi(2));
        let squares: Option<Vec<f64>> = self.seen(view).map(|p| Some(square(p, method)? + square(p, MC)?)).collect();
        squares.map(|s| s.iter().sum::<f64>().sqrt() / s.len() as f64)
    }

    /// Geometric mean over the scans of a figure over that of independent samples, where all scans have it.
    fn against_mc(&self, view: &str, figure: impl Fn(&Place, &str) -> Option<f64>, method: &str) -> Option<f64> {
        let ratios: Option<Vec<f64>> = self.seen(view).map(|p| Some(figure(p, method)? / figure(p, MC)?)).collect();
        geometric(ratios?)
    }
}

/// Every method over Monte Carlo, as means over the scans.
pub fn summary(page: &mut String, f: &Figures<'_>) -> Outcome<()> {
    type Figure<'a> = &'a dyn Fn(&Place, &str, u32) -> Option<f64>;
    let error: Figure<'_> = &|p, m, l| f.error(p, m, l).map(|e| e.0);
    let cost: Figure<'_> = &|p, m, l| f.cost(p, m, l);
    for (title, figure, note) in [
        (
            TITLE,
            cost,
            "Relative RMSE × √seconds over that of `mc` at the same number of samples; geometric means over the scans, the best \
             of a column in bold. 0.50: the same error in a quarter of the time, as long as errors fall as the root of the time.",
        ),
        ("## Error at equal samples", error, "Relative RMSE over that of `mc`, as above."),
    ] {
        writeln!(page, "{title}\n\n{note}\n")?;
        let columns: Vec<(&str, u32)> = VIEWS.iter().flat_map(|v| f.levels.iter().map(move |l| (*v, *l))).collect();
        let names: Vec<String> = columns.iter().map(|(view, level)| format!("{view}, 2^{level}")).collect();
        head(page, &["method"], &names)?;
        let shown: Vec<Vec<String>> = columns
            .iter()
            .map(|(view, level)| {
                let of = |method: &str| f.against_mc(view, |p, m| figure(p, m, *level), method);
                column(&f.methods.iter().map(|m| of(m.name)).collect::<Vec<_>>(), two)
            })
            .collect();
        for (i, method) in f.methods.iter().enumerate() {
            let row: Vec<&str> = shown.iter().map(|c| c[i].as_str()).collect();
            // Whatever shows images on the way ends with the image of another row.
            let repeated = title != TITLE && matches!(method.points, Points::Passes | Points::Restarts);
            if !repeated && row.iter().any(|c| *c != "–") {
                writeln!(page, "| {} | {} |", method.name, row.join(" | "))?;
            }
        }
        let largest = |&(view, level): &(&str, u32)| {
            let all = f.methods.iter().filter_map(|m| f.uncertainty(view, m.name, level));
            cell(all.reduce(f64::max).map(|u| format!("± {:.1} %", 100.0 * u)))
        };
        let row: Vec<String> = columns.iter().map(largest).collect();
        writeln!(page, "| *largest standard error, by errors* | {} |\n", row.join(" | "))?;
    }
    Ok(())
}

/// Errors, seconds and their product in one place.
pub fn detail(page: &mut String, f: &Figures<'_>, place: &Place) -> Outcome<()> {
    writeln!(page, "### {}, {}\n", place.scan, place.view)?;
    let names: Vec<String> =
        f.levels.iter().flat_map(|l| [format!("2^{l}: error"), "time".into(), "error × √s".into()]).collect();
    head(page, &["method"], &names)?;
    let costs: Vec<Vec<String>> = f
        .levels
        .iter()
        .map(|l| {
            let costs: Vec<_> = f.methods.iter().map(|m| f.cost(place, m.name, *l)).collect();
            column(&costs, |v| significant(v, 3))
        })
        .collect();
    for (i, method) in f.methods.iter().enumerate() {
        let cells: Vec<String> = f
            .levels
            .iter()
            .zip(&costs)
            .flat_map(|(l, costs)| {
                let error = f.error(place, method.name, *l).map(|e| percent(e.0));
                let time = f.seconds(place, method.name, *l).map(seconds);
                [cell(error), cell(time), costs[i].clone()]
            })
            .collect();
        writeln!(page, "| {} | {} |", method.name, cells.join(" | "))?;
    }
    writeln!(page)?;
    Ok(())
}

/// Samples for 2 % error.
pub fn needed(page: &mut String, f: &Figures<'_>) -> Outcome<()> {
    writeln!(
        page,
        "## Samples for {} % error\n\nIndependent samples by their own constant (their slope is exactly -1/2; the measured one beside \
         it). The net, and whichever low-discrepancy method needs \
         fewest of those whose measured errors reach so far, by straight lines between the measured errors on log \
         scales; **\\*** marks what lies beyond the largest measured number of samples, where the last line goes on.\n",
        100.0 * TARGET
    )?;
    let names =
        ["mc", "its slope", "net", "its last slope", "mc / net", "best", "samples", "mc / best"].map(String::from);
    head(page, &["scan", "view"], &names)?;
    for p in &f.places {
        let mc = f.mc_needs(p, TARGET);
        let net = f.needs(p, NET, TARGET);
        let best = f.best(p, TARGET);
        let millions = |s: f64| format!("{} M", significant(s / 1e6, 3));
        let starred = |n: crate::figures::Needed| millions(n.samples) + if n.extrapolated { " \\*" } else { "" };
        let ratio = |s: Option<f64>| cell(mc.zip(s).map(|(a, b)| format!("**{}**", significant(a / b, 3))));
        writeln!(
            page,
            "| {} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            p.scan,
            p.view,
            cell(mc.map(millions)),
            cell(f.slope(p, MC).map(two)),
            cell(net.map(starred)),
            cell(f.slope(p, NET).map(two)),
            ratio(net.map(|n| n.samples)),
            cell(best.map(|b| b.0.to_owned())),
            cell(best.map(|b| starred(b.1))),
            ratio(best.map(|b| b.1.samples)),
        )?;
    }
    writeln!(page)?;
    for view in VIEWS {
        let over = |needs: &dyn Fn(&Place) -> Option<f64>| {
            let all: Option<Vec<f64>> = f.seen(view).map(|p| Some(f.mc_needs(p, TARGET)? / needs(p)?)).collect();
            cell(all.and_then(geometric).map(|r| significant(r, 3)))
        };
        let net = over(&|p| f.needs(p, NET, TARGET).map(|n| n.samples));
        let best = over(&|p| f.best(p, TARGET).map(|b| b.1.samples));
        writeln!(page, "- {view}: geometric mean mc / net {net}, mc / best {best}")?;
    }
    writeln!(page)?;
    Ok(())
}

/// Which half of the gain comes from where.
pub fn hybrids(page: &mut String, f: &Figures<'_>) -> Outcome<()> {
    writeln!(
        page,
        "## The hybrids: which half of the gain comes from where\n\nError of `mc` over that of: quasi-random voxels with random \
         offsets (`systematic`), random voxels with quasi-random offsets (`random voxels`), both quasi-random (`net`).\n"
    )?;
    let each = |l: &u32| [format!("2^{l}: voxels"), "offsets".into(), "both".into()];
    head(page, &["scan", "view"], &f.levels.iter().flat_map(each).collect::<Vec<_>>())?;
    for p in &f.places {
        let gain = |m: &str, l: u32| Some(f.error(p, MC, l)?.0 / f.error(p, m, l)?.0);
        let cells: Vec<String> = f
            .levels
            .iter()
            .flat_map(|l| ["systematic", "random voxels", NET].map(|m| cell(gain(m, *l).map(two))))
            .collect();
        writeln!(page, "| {} | {} | {} |", p.scan, p.view, cells.join(" | "))?;
    }
    writeln!(page)?;
    Ok(())
}

/// The sequence against the net.
pub fn sequence(page: &mut String, f: &Figures<'_>) -> Outcome<()> {
    writeln!(
        page,
        "## The sequence against the net\n\n**Error**: of the sequence's first M points over that of the net of M. **Time** over \
         that of the net: of one run of M points; of *passes* that refine each other (2^12, 2^12, 2^13, ... samples; M in all); of \
         *restarts*, nets of 2^12, 2^13, ..., M one after another, which show as many images on the way. **At equal time**: error × √time \
         of the passes over the net's, and over the restarts'. Means are geometric, over the scans.\n"
    )?;
    let each = |l: &u32| {
        let heads =
            ["error", "run", "passes", "restarts", "passes / net at equal time", "passes / restarts at equal time"];
        heads.map(|h| if h == "error" { format!("2^{l}: error") } else { h.to_owned() })
    };
    for level in &f.levels {
        head(page, &["scan", "view"], &each(level))?;
        let ratios = |p: &Place| {
            let error = f.error(p, "sequence", *level).zip(f.error(p, NET, *level)).map(|(a, b)| a.0 / b.0);
            let time = |m: &str| Some(f.seconds(p, m, *level)? / f.seconds(p, NET, *level)?);
            let cost = |m: &str| Some(f.cost(p, "passes", *level)? / f.cost(p, m, *level)?);
            [error, time("sequence"), time("passes"), time("restarts"), cost(NET), cost("restarts")]
        };
        for p in &f.places {
            writeln!(page, "| {} | {} | {} |", p.scan, p.view, ratios(p).map(|r| cell(r.map(two))).join(" | "))?;
        }
        for view in VIEWS {
            let all: Vec<[Option<f64>; 6]> = f.seen(view).map(ratios).collect();
            let mean = |c: usize| all.iter().map(|r| r[c]).collect::<Option<Vec<f64>>>().and_then(geometric);
            let cells = [0, 1, 2, 3, 4, 5].map(|c| cell(mean(c).map(|v| format!("**{}**", two(v)))));
            writeln!(page, "| mean | {view} | {} |", cells.join(" | "))?;
        }
        writeln!(page)?;
    }
    Ok(())
}

/// The check against the truth.
pub fn bias(page: &mut String, f: &Figures<'_>) -> Outcome<()> {
    let Some((key, [.., truth])) = f.biases().next() else { return Ok(()) };
    writeln!(
        page,
        "## No method is wrong\n\n{}, {}, {} samples, against ray casting good to {}: squared bias (the mean square of the mean \
         image's difference to the truth, less its variance) over the variance of one image, with a jackknife standard error; beside \
         it what the truth's own error adds. More than {LIMIT} standard errors above that is a bias.\n",
        key.scan,
        key.view,
        samples(1 << key.level),
        percent(truth)
    )?;
    head(page, &["method"], &["squared bias / variance", "truth's share", "verdict"].map(String::from))?;
    for (key, [ratio, error, share, _]) in f.biases() {
        let verdict = if ratio > share + LIMIT * error { "**biased**" } else { "none seen" };
        writeln!(page, "| {} | {ratio:.4} ± {error:.4} | {share:.4} | {verdict} |", key.method)?;
    }
    writeln!(page)?;
    Ok(())
}

/// What the methods and the scenes are.
pub fn lists(page: &mut String, f: &Figures<'_>) -> Outcome<()> {
    writeln!(page, "## Methods\n\n| method | what | source |\n|---|---|---|")?;
    for m in &f.methods {
        let note = if matches!(m.points, Points::Passes | Points::Restarts) { "; timed only" } else { "" };
        writeln!(page, "| {} | {}{note} | {} |", m.name, m.what, m.source)?;
    }
    writeln!(
        page,
        "\nAll but the orders have the axis nearest to the view innermost (`depth`); that one of `x inner`, `y inner` and `z inner` \
         is the net itself.\n\n## Scans and views\n\n| scan | view | azimuth, elevation | depth axis | voxels | of weight > 0 |\n|---|---|---|---|---|---|"
    )?;
    for p in &f.places {
        let [azimuth, elevation] = p.angles;
        writeln!(
            page,
            "| {} | {} | {azimuth}, {elevation} | {} | {} | {} |",
            p.scan,
            p.view,
            p.depth_axis,
            p.described,
            samples(p.drawable)
        )?;
    }
    writeln!(page)?;
    Ok(())
}
