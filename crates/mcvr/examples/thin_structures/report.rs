//! The records of the study and the page that shows them.

use std::fmt::Write as _;
use std::path::Path;

use glam::DVec3;
use serde::Serialize;

use crate::kernels::{Candidate, candidates};
use crate::{Outcome, SCANS, Shown, ridges};

/// One kernel on one scene.
#[derive(Serialize)]
pub struct Row {
    /// `half`: a copy at half the resolution, `half in large pixels`: its images averaged over pixels as wide as a voxel; `full`: the scan itself; `closed form`: tubes.
    pub study: String,
    pub scene: String,
    pub kernel: &'static str,
    /// `ray cast` or `footprint`.
    pub image: &'static str,
    pub sections: usize,
    /// Sections whose structure can no longer be measured.
    pub lost: usize,
    /// Quartiles of the contrast over the reference's.
    pub contrast: [f64; 3],
    /// Quartiles of the width over the reference's.
    pub widening: [f64; 3],
    /// Median full width at half maximum.
    pub width_mm: f64,
    /// Root mean square of the displacement, in voxels of the rendered grid.
    pub shift_voxels: f64,
    /// Tubes: median over the tubes of the contrast's standard deviation along each, over its mean.
    pub beading: Option<f64>,
    /// RMSE against the reference over its mean.
    pub rmse: f64,
    /// The ray caster's own estimate of its error over the mean.
    pub cast_error: Option<f64>,
    /// Distance of the footprint image from the ray-cast one, over the latter's root mean square.
    pub footprint_error: Option<f64>,
}

/// Quartiles.
pub fn spread(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    let at = |q: f64| match values.len() {
        0 => f64::NAN,
        n => {
            let x = q * (n - 1) as f64;
            let (i, f) = (x as usize, x.fract());
            values[i] + f * (values[(i + 1).min(n - 1)] - values[i])
        }
    };
    [at(0.25), at(0.5), at(0.75)]
}

impl Row {
    /// A row from measures by section (contrast, widening, width and shift in pixels), with mm per pixel and pixels
    /// per voxel of the rendered grid.
    pub fn new(
        study: &str,
        scene: &str,
        candidate: &Candidate,
        shown: &Shown,
        measures: &[Option<[f64; 4]>],
        [mm, voxel]: [f64; 2],
    ) -> Self {
        let column = |c: usize| -> Vec<f64> { measures.iter().flatten().map(|m| m[c]).collect() };
        let shifts = column(3);
        let square = shifts.iter().map(|s| (s / voxel).powi(2)).sum::<f64>() / shifts.len().max(1) as f64;
        Self {
            study: study.into(),
            scene: scene.into(),
            kernel: candidate.name,
            image: if shown.cast.is_some() { "ray cast" } else { "footprint" },
            sections: measures.len(),
            lost: measures.iter().filter(|m| m.is_none()).count(),
            contrast: spread(column(0)),
            widening: spread(column(1)),
            width_mm: spread(column(2))[1] * mm,
            shift_voxels: square.sqrt(),
            beading: None,
            rmse: f64::NAN,
            cast_error: shown.cast,
            footprint_error: shown.check,
        }
    }

    pub fn rmse(self, rmse: f64) -> Self {
        Self { rmse, ..self }
    }

    pub fn beading(self, beading: f64) -> Self {
        Self { beading: Some(beading), ..self }
    }
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (c, w) = (self.contrast, self.widening);
        write!(
            f,
            "{:<17} contrast {:.3} ({:.3}-{:.3}) width x{:.3} ({:.3}-{:.3}) shift {:.3} rmse {:.4} lost {} check {:?} {:?}",
            self.kernel,
            c[1],
            c[0],
            c[2],
            w[1],
            w[0],
            w[2],
            self.shift_voxels,
            self.rmse,
            self.lost,
            self.footprint_error,
            self.beading
        )
    }
}

fn table(page: &mut String, rows: &[&Row]) -> Outcome<()> {
    let tubes = rows.iter().any(|r| r.beading.is_some());
    let extra = if tubes { " beading |" } else { "" };
    writeln!(page, "| kernel | contrast | width | median width | moves by |{extra} RMSE | lost | image |")?;
    writeln!(page, "|---|---|---|---|---|{}---|---|---|", if tubes { "---|" } else { "" })?;
    for r in rows {
        let q = |v: [f64; 3]| format!("{:.3} ({:.3}–{:.3})", v[1], v[0], v[2]);
        let beading = r.beading.map_or(String::new(), |b| format!(" {:.1} % |", 100.0 * b));
        writeln!(
            page,
            "| {} | {} | {} | {:.2} mm | {:.3} voxel |{beading} {:.1} % | {} of {} | {} |",
            r.kernel,
            q(r.contrast),
            q(r.widening),
            r.width_mm,
            r.shift_voxels,
            100.0 * r.rmse,
            r.lost,
            r.sections,
            r.image
        )?;
    }
    writeln!(page)?;
    Ok(())
}

fn responses(page: &mut String) -> Outcome<()> {
    writeln!(
        page,
        "| kernel | | variance (voxels²) | keeps at period 4 | keeps at period 2 | lattice (1,0,0) | (1,1,0) | (1,1,1) | staircase |"
    )?;
    writeln!(page, "|---|---|---|---|---|---|---|---|---|")?;
    for c in candidates() {
        let at = |x: f64, y: f64, z: f64| c.response(DVec3::new(x, y, z));
        writeln!(
            page,
            "| {} | {} | {:.4} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {} |",
            c.name,
            c.note,
            c.variance(),
            at(0.25, 0.0, 0.0),
            at(0.5, 0.0, 0.0),
            at(1.0, 0.0, 0.0),
            at(1.0, 1.0, 0.0),
            at(1.0, 1.0, 1.0),
            c.staircase().map_or("-".into(), |s| format!("{s:.3}"))
        )?;
    }
    writeln!(page)?;
    Ok(())
}

/// Writes `thin-structures.md`, `.csv` and `.json`. `shell` holds the footprint image's distance from a sampled one
/// and the distance of two sampled ones.
pub fn write(out: &Path, rows: &[Row], missing: &[&str], shell: [f64; 2]) -> Outcome<()> {
    std::fs::write(out.join("thin-structures.json"), serde_json::to_string_pretty(rows)? + "\n")?;
    let mut csv = String::from(
        "study,scene,kernel,image,sections,lost,contrast_q1,contrast_median,contrast_q3,widening_q1,widening_median,\
         widening_q3,width_mm,shift_voxels,beading,rmse,cast_error,footprint_error\n",
    );
    for r in rows {
        let optional = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.6}"));
        let three = |v: [f64; 3]| v.map(|v| format!("{v:.6}")).join(",");
        writeln!(
            csv,
            "{},{},{},{},{},{},{},{},{:.6},{:.6},{},{:.6},{},{}",
            r.study,
            r.scene,
            r.kernel,
            r.image,
            r.sections,
            r.lost,
            three(r.contrast),
            three(r.widening),
            r.width_mm,
            r.shift_voxels,
            optional(r.beading),
            r.rmse,
            optional(r.cast_error),
            optional(r.footprint_error)
        )?;
    }
    std::fs::write(out.join("thin-structures.csv"), csv)?;
    std::fs::write(out.join("thin-structures.md"), page(rows, missing, shell)?)?;
    Ok(())
}

fn page(rows: &[Row], missing: &[&str], shell: [f64; 2]) -> Outcome<String> {
    let mut page = String::from("# Thin structures under each kernel\n\n");
    writeln!(page, "{}\n", INTRODUCTION.replace('\n', " "))?;
    writeln!(page, "{}\n", ridges::rules())?;
    let worst = |of: fn(&Row) -> Option<f64>| rows.iter().filter_map(of).fold(0.0, f64::max);
    writeln!(
        page,
        "How good the images are: `ray cast` ones are exact along rays; over the pixels' area they are good to {:.1e} \
         of the mean by the ray caster's own estimate (the worst). `footprint` ones (the shell, the kernels outside the \
         library, `bspline3` on images of more than {} pixels, and the whole study **full**) \
         carry no noise; where both kinds exist they differ by at most {:.2} % \
         (root mean square of the difference over the image's). The shell's footprint and its sampler (2^28 points, \
         `phantom:vessels@64`) differ by {:.2} %, two such samples by {:.2} %.\n",
        worst(|r| r.cast_error),
        crate::SPLINE_PIXELS,
        100.0 * worst(|r| r.footprint_error),
        100.0 * shell[0],
        100.0 * shell[1]
    )?;
    if !missing.is_empty() {
        writeln!(page, "Left out, as the scans were not there: {}.\n", missing.join(", "))?;
    }
    writeln!(page, "## What theory says of each kernel\n\n{}\n", THEORY.replace('\n', " "))?;
    responses(&mut page)?;
    let mut last = ("", "");
    for first in rows {
        if (first.study.as_str(), first.scene.as_str()) == last {
            continue;
        }
        last = (&first.study, &first.scene);
        let group: Vec<&Row> = rows.iter().filter(|r| (r.study.as_str(), r.scene.as_str()) == last).collect();
        let title = match last.0 {
            "half" => "copy at half the resolution against the fine scan",
            "half in large pixels" => "the same, seen by pixels as wide as a voxel of the copy",
            "full" => "the scan itself against its own `box` image",
            _ => "against the closed form",
        };
        writeln!(page, "## {}: {title}\n", last.1)?;
        if let Some(scan) = SCANS.iter().find(|s| last.0 == "half" && s.name == last.1) {
            writeln!(
                page,
                "View {},{} degrees; profiles reach {} fine voxels to each side, contrasts are at least {} % of the image's \
                 maximum.\n",
                scan.view[0],
                scan.view[1],
                scan.look.reach,
                100.0 * scan.look.faintest
            )?;
            let tiles = crate::pictures::TILES.join(", ");
            writeln!(
                page,
                "![]({0}.png)\n\nLeft to right: fine reference, {tiles}. Sections: [{0}-sections.png]({0}-sections.png).\n",
                last.1
            )?;
        }
        table(&mut page, &group)?;
    }
    Ok(page)
}

const INTRODUCTION: &str = "Contrast (peak above the local background, over the reference's), full width at half maximum (over
the reference's, and in mm), displacement of the structure (RMS) and RMSE of thin structures in X-ray images (`line`, parallel rays,
2 pixels per fine voxel; tubes: 4 per voxel). Medians, quartiles in brackets. The studies: **half** - every kernel on a copy of the
scan averaged over 2x2x2 voxels, against the fine scan itself (`box`: its voxels as they are), and the same images averaged
over pixels as wide as a voxel, as images are commonly made; **full** - every kernel on
the fine scan, against the same `box` image; here `box` is the reference by construction, and the others show what
they add; **closed form** - straight tubes of density 1 in voxels of side 1 mm that hold their share of the tube, against
the chords; beading is the unevenness of the contrast along a tube.";

const THEORY: &str =
    "A kernel multiplies a wave of the voxels' weights by its Fourier transform. The variance says how much it
widens: FWHM² grows by about 8 ln 2 times the variance per axis across. What it leaves at whole frequencies (cycles
per voxel) is the voxel lattice showing through a uniform region: 0 for a partition of unity. The staircase is the largest
deviation from a ramp, in the ramp's rise per voxel.";
