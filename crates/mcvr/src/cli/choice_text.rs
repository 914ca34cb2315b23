//! A choice of method in words.

use mcvr::auto::{Candidate, Choice};

fn percent(share: f64) -> String {
    let p = 100.0 * share;
    if p >= 0.1 { format!("{p:.2} %") } else { format!("{p:.1e} %") }
}

fn words(c: &Candidate) -> String {
    let unit = c.method.unit();
    let step = match c.step {
        step if step <= 0.0 => String::new(),
        step if c.method == mcvr::Method::Footprint => format!(", parts of {step:.2}"),
        step => format!(", {step:.2} voxels apart"),
    };
    let number = if c.adaptive.is_some() { format!("some {}", c.samples) } else { c.samples.to_string() };
    format!("{} with {number} {unit}{step}", c.method)
}

/// One line about what was chosen.
pub fn say(choice: &Choice) {
    say!(
        "chosen for an error of {}: {}; expected {} in {:.4} s of one thread",
        percent(choice.target),
        words(&choice.chosen),
        percent(choice.chosen.error),
        choice.chosen.seconds
    );
    if !choice.reaches {
        say!("mcvr: warning: no method is expected to reach {}; this is the most accurate", percent(choice.target));
    }
}

/// The choice and its runners-up, a line each.
pub fn table(choice: &Choice) -> String {
    let mut out = format!("choice for an error of {}\n", percent(choice.target));
    for (n, c) in std::iter::once(&choice.chosen).chain(&choice.runners_up).enumerate() {
        let mark = if n == 0 { "*" } else { " " };
        out += &format!(
            "  {mark} {:<44} error {:>9}  {:>9.2} ms of one thread\n",
            words(c),
            percent(c.error),
            1e3 * c.seconds
        );
    }
    match (&choice.pilot, &choice.glance) {
        (Some(p), _) => {
            out += &format!(
                "  from one ray for 4 by 4 pixels, {} in all, {} of them compared with others; {:.0} voxels' way a ray\n",
                p.rays, p.looked_at, p.steps
            );
        }
        (None, Some(g)) => {
            out += &format!("  after a glance at {} rays: footprints are done before rays could be\n", g.counters.rays);
        }
        (None, None) => {
            out += "  without a look: footprints are done before it, or rays are cast in packets only for plain X-rays of tent\n"
        }
    }
    if let Some(check) = &choice.checked {
        out += &format!("  footprints were made on trial: {} off at {} pixels\n", percent(check.error), check.pixels);
    }
    out
}
