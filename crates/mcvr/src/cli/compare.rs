//! `mcvr compare`

use std::io::Write;
use std::path::PathBuf;

use serde_json::json;

use super::outputs;
use super::render::write_json;

#[derive(clap::Args)]
#[command(after_help = "Example:\n  mcvr compare fast.npy truth.npy --difference difference.png\n\n\
    Compare linear files (.npy, .exr, .tiff); a PNG holds toned grey levels, not values.")]
pub struct Args {
    /// Image to judge
    image: PathBuf,
    /// Reference
    reference: PathBuf,
    /// Write the signed difference: red where the image is larger, blue where it is smaller
    #[arg(long, value_name = "FILE.png")]
    difference: Option<PathBuf>,
    /// Write the figures as JSON; - for standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &Args) -> anyhow::Result<()> {
    outputs::check(args.difference.iter().chain(&args.json), &[Some(&args.image), Some(&args.reference)])?;
    let result = mcvr::harness::compare_files(&args.image, &args.reference, args.difference.as_deref())?;
    if let Some(path) = &args.json {
        write_json(
            path,
            &json!({
                "image": args.image.display().to_string(), "reference": args.reference.display().to_string(),
                "comparison": result.comparison, "difference_scale": result.difference_scale,
            }),
        )?;
    }
    if args.json.as_deref() != Some("-".as_ref()) {
        writeln!(outputs::stdout(), "{}", result.comparison)?;
    }
    Ok(())
}
