//! How wrong is a million-sample image? Run `cargo run --release --example error_of_an_image`.

use mcvr::harness::Comparison;
use mcvr::scene::{Camera, DensityMap, Extent, View, Watch};
use mcvr::{Method, Request, Scenery, make, volume};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let volume = volume::load("phantom:lobster@96", None)?.volume;
    let camera = Camera::look(&View::default(), volume.grid(), Extent::new(128, 128)?)?;
    let scenery = Scenery::new(volume, DensityMap::default(), camera);
    let truth = make(&scenery, &Request { method: Method::Exact, ..Request::default() }, &Watch::default())?;
    for method in [Method::Mc, Method::Stratified, Method::Qmc] {
        let request = Request { method, samples: 1 << 20, ..Request::default() };
        let made = make(&scenery, &request, &Watch::default())?;
        let error = Comparison::of(&made.image, &truth.image)?.rel_rmse.unwrap_or(f64::NAN);
        println!(
            "{method:<12} RMSE {:5.2} % of the mean pixel in {:.1} ms",
            100.0 * error,
            1e3 * made.seconds.complete
        );
    }
    Ok(())
}
