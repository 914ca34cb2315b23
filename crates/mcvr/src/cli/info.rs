//! `mcvr info`

use std::io::Write;
use std::path::PathBuf;

use anyhow::bail;
use mcvr::sampling::{Distribution, VoxelOrder};
use mcvr::scene::{Density, DensityMap};
use mcvr::volume::{Phantom, Summary};
use serde_json::json;

use super::args::VolumeArgs;
use super::outputs;
use super::render::write_json;
use super::setup::volume_options;

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  mcvr info scan.nii.gz\n  \
    mcvr info head.raw --dims 256,256,113 --type u16 --endian be\n  mcvr info --phantoms")]
pub struct Args {
    #[command(flatten)]
    volume: VolumeArgs,
    /// List the phantoms
    #[arg(long)]
    phantoms: bool,
    /// Write the description as JSON; - for standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    outputs::check(&args.json, &[args.volume.file()])?;
    let mut out = outputs::stdout();
    if args.phantoms {
        for (name, what) in Phantom::names() {
            writeln!(out, "phantom:{name:<14} {what}")?;
        }
        writeln!(out, "\nSize: phantom:NAME@256 or phantom:NAME@301x324x56; 128 cubed without.")?;
        return Ok(());
    }
    let (input, options) = volume_options(&args.volume, &Default::default());
    let Some(input) = input else { bail!("no volume: give a file or phantom:NAME, or --phantoms for the list") };
    let loaded = mcvr::volume::load(&input, Some(&options))?;
    let volume = &loaded.volume;
    let grid = volume.grid();
    let s = Summary::of(volume);
    let suspicion = mcvr::volume::byte_order_suspicion(volume);
    let held = Density::new(volume, DensityMap::default()).map_err(anyhow::Error::new).and_then(|d| {
        let counters = Distribution::new(&d, VoxelOrder::Raster)?.counters();
        Ok((counters.bytes, *d.report()))
    });
    if let Some(path) = &args.json {
        write_json(
            path,
            &json!({
                "input": input, "format": loaded.format.to_string(), "dims": grid.dims(), "type": volume.voxel_type(),
                "spacing": grid.spacing().to_array(), "origin": grid.origin().to_array(),
                "direction": grid.direction().transpose().to_cols_array_2d(), "size_mm": grid.size_mm().to_array(),
                "slope": volume.slope(), "intercept": volume.intercept(), "mapped": volume.voxels().is_mapped(),
                "min": s.min, "max": s.max, "mean": s.mean, "zero_share": s.zero_share(),
                "negative_share": s.negative_share(), "nan": s.nan, "infinite": s.infinite, "histogram": s.histogram,
                "bytes": volume.bytes(), "distribution_bytes": held.as_ref().ok().map(|h| h.0),
                "notes": loaded.notes, "suspicion": suspicion,
            }),
        )?;
        if path.as_os_str() == "-" {
            return Ok(());
        }
    }
    let [x, y, z] = grid.dims();
    let (h, size) = (grid.spacing(), grid.size_mm());
    writeln!(out, "{input}: {}", loaded.format)?;
    writeln!(out, "dimensions   {x} x {y} x {z} = {} voxels of {}", grid.len(), volume.voxel_type())?;
    writeln!(out, "spacing      {} x {} x {} mm", h.x, h.y, h.z)?;
    writeln!(out, "size         {:.5} x {:.5} x {:.5} mm, diameter {:.5} mm", size.x, size.y, size.z, grid.diameter())?;
    writeln!(out, "origin       {}", grid.origin())?;
    if (volume.slope(), volume.intercept()) != (1.0, 0.0) {
        writeln!(out, "isovalue     {} x stored + {}", volume.slope(), volume.intercept())?;
    }
    writeln!(out, "values       {} .. {}, mean {:.6}", s.min, s.max, s.mean)?;
    writeln!(out, "zero         {:.3} %   negative {:.3} %", 100.0 * s.zero_share(), 100.0 * s.negative_share())?;
    if s.nan + s.infinite > 0 {
        writeln!(out, "not finite   {} NaN, {} infinite", s.nan, s.infinite)?;
    }
    histogram(&mut out, &s)?;
    let place = if volume.voxels().is_mapped() { "mapped from the file" } else { "in memory" };
    write!(out, "memory       {:.2} MB voxels {place}", volume.bytes() as f64 / 1e6)?;
    match held {
        Ok((bytes, mass)) => {
            let share = 100.0 * bytes as f64 / volume.bytes() as f64;
            writeln!(out, " + {:.2} MB distribution ({share:.1} %)", bytes as f64 / 1e6)?;
            writeln!(out, "mass         {:.6e} isovalue x mm3 in {} voxels", mass.mass, mass.positive)?;
            if mass.negative > 0 {
                writeln!(
                    out,
                    "negative     {} voxels count as 0 under the identity map (sum {:.4e})",
                    mass.negative, -mass.dropped
                )?;
            }
        }
        Err(e) => writeln!(out, "\nno image     {e}")?,
    }
    for note in loaded.notes.iter().filter(|n| suspicion.as_ref() != Some(n)) {
        writeln!(out, "note         {note}")?;
    }
    if let Some(warning) = suspicion {
        writeln!(out, "SUSPICIOUS   {warning}")?;
    }
    Ok(())
}

/// The histogram in 16 rows, bars on a logarithmic scale.
fn histogram(out: &mut impl Write, s: &Summary) -> std::io::Result<()> {
    let group = s.histogram.len().div_ceil(16).max(1);
    let rows: Vec<u64> = s.histogram.chunks(group).map(|c| c.iter().sum()).collect();
    let top = rows.iter().max().copied().unwrap_or(0) as f64;
    writeln!(out, "histogram    (bars: logarithm of the count)")?;
    for (i, &n) in rows.iter().enumerate() {
        let length = if n == 0 { 0.0 } else { 1.0 + 39.0 * (n as f64).ln_1p() / top.ln_1p() };
        let (low, high) = (s.bin_edge(i * group), s.bin_edge((i * group + group).min(s.histogram.len())));
        writeln!(out, "  {low:>11.5} .. {high:>11.5}  {n:>12} {}", "#".repeat(length as usize))?;
    }
    Ok(())
}
