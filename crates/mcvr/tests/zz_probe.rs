#![allow(missing_docs)]
mod common;
use common::*;
use mcvr::scene::*;
use mcvr::*;
use std::time::Instant;
#[test]
fn probe() {
    let s = speckled_scene(&pinhole());
    for k in SEPARABLE {
        for e in Estimand::ALL {
            for (tol, d) in [(1e-4, 8), (1e-5, 10), (1e-6, 10)] {
                if k == Kernel::Box && tol < 1e-5 {
                    continue;
                }
                let t = Instant::now();
                let r = exact(&s, k, e, tol, d);
                println!(
                    "{k} {e} tol {tol:e}: {:.2}s rays {} rel {:.2e} limited {} sum {} esum {:e} zero {}",
                    t.elapsed().as_secs_f64(),
                    r.counters.rays,
                    r.error.rel_rmse_estimate,
                    r.error.depth_limited,
                    r.image.sum(),
                    r.error.image.sum(),
                    r.image.values().iter().filter(|v| **v == 0.0).count()
                );
            }
        }
    }
    for m in SAMPLERS {
        for e in Estimand::ALL {
            let t = Instant::now();
            for seed in 0..64 {
                made(
                    &s,
                    &Request {
                        method: m,
                        samples: if m == Method::McLinear { 1 << 12 } else { 1 << 14 },
                        seed,
                        estimand: e,
                        ..Default::default()
                    },
                );
            }
            println!("{m} {e} {:.2}s", t.elapsed().as_secs_f64());
        }
    }
}
