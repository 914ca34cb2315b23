#![allow(missing_docs)]
mod common;
use common::*;
use mcvr::scene::*;
use mcvr::*;
use std::time::Instant;
#[test]
fn probe() {
    for n in [32, 64, 96] { for (fov, e) in [(24.0, 16), (24.0, 8), (20.0, 12)] {
    let loaded = mcvr::volume::load(&format!("phantom:lobster@{n}"), None).unwrap();
    let view = View { fov: Some(fov), ..View::default() };
    let camera = Camera::look(&view, loaded.volume.grid(), Extent::new(e, e).unwrap()).unwrap();
    let s = Scenery::new(loaded.volume, DensityMap::default(), camera);
    let t = Instant::now();
    let r = exact(&s, Kernel::Tent, Estimand::Count, 3e-5, 8);
    let v = r.image.values();
    let d = density(&s);
    println!("{n} dims {:?} {fov} {e}: {:.2}s rel {:.1e} sum {} peff {} positive {} sumw {}", s.volume.grid().dims(), t.elapsed().as_secs_f64(), r.error.rel_rmse_estimate, r.image.sum(), r.image.sum().powi(2)/v.iter().map(|v| v*v).sum::<f64>(), d.report().positive, d.report().weight_sum);
    }}
}
