//! One fuzzer over every reader; `MCVR_FUZZ_TARGET` names which, `MCVR_FUZZ_SEEDS` where its first inputs go.
//!
//! A panic, a hang, or one allocation that the input could not fill ends it with the input saved.
#![no_main]

mod memory;
#[allow(dead_code, reason = "shared with the program's command line, of which a part is tried here")]
#[path = "../../../crates/mcvr/src/cli/numbers.rs"]
mod numbers;
mod seeds;
mod targets;

use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;
use targets::Target;

static TARGET: OnceLock<Target> = OnceLock::new();

fuzz_target!(
    init: {
        // Panics inside a decoder that the reader contains are no findings; what leaves a target ends the process.
        std::panic::set_hook(Box::new(|panic| if std::env::var_os("MCVR_FUZZ_VERBOSE").is_some() { eprintln!("{panic}") }));
        let target = TARGET.get_or_init(Target::from_environment);
        if let Some(folder) = std::env::var_os("MCVR_FUZZ_SEEDS") {
            target.write_seeds(folder.as_ref());
        }
    },
    |data: &[u8]| {
        let Some(target) = TARGET.get() else { return };
        memory::allow(data.len());
        target.run(data);
    }
);
