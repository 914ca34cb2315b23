//! Times the reference of a volume file: `cargo run --release -p mcvr-raycast --example time_reference -- FILE [KERNEL] [TOLERANCE] [ESTIMAND] [SIDE]`.

use mcvr_raycast::{ReferenceOptions, Watch, reference};
use mcvr_scene::{Camera, Density, DensityMap, Extent, View};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let arg = |n: usize, default: &str| args.get(n).cloned().unwrap_or_else(|| default.to_string());
    let volume = mcvr_volume::load(&arg(0, "phantom:lobster@301x324x56"), None)?.volume;
    let side: usize = arg(4, "400").parse()?;
    let density = Density::new(&volume, DensityMap::default())?;
    let camera = Camera::look(&View::default(), volume.grid(), Extent::new(side, side)?)?;
    let options = ReferenceOptions {
        kernel: arg(1, "tent").parse()?,
        tolerance: arg(2, "1e-4").parse()?,
        estimand: arg(3, "line").parse()?,
        ..ReferenceOptions::default()
    };
    let r = reference(&density, &camera, &options, &Watch::default())?;
    println!("{}: {:?}", volume.name(), options);
    println!(
        "{:.2} s, rel_rmse_estimate {:.2e}, {} pixels at the depth limit, mean {:.6e}, sum {:.9}",
        r.seconds,
        r.error.rel_rmse_estimate,
        r.error.depth_limited,
        r.image.mean(),
        r.image.sum()
    );
    println!("{:?}", r.counters);
    let threads = std::thread::available_parallelism()?.get() as f64;
    println!("{:.2} ns per cell and thread", r.seconds * 1e9 * threads / r.counters.cells as f64);
    Ok(())
}
