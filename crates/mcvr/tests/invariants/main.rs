//! What must hold for any scene: properties of random small scenes, and sums and integrals against exact arithmetic.
//!
//! Cases are drawn with a fixed seed and no file of failures: a run is the same everywhere. `PROPTEST_CASES=5000` looks further,
//! `PROPTEST_RNG_SEED=7` elsewhere; bounds that hold with a probability say which.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

#[path = "../common/mod.rs"]
mod common;

mod closed;
mod exact_rays;
mod exact_weights;
mod polynomial;
mod sampling;
mod scenes;
mod symmetry;

/// `cargo test` optimises and checks at once: debug assertions come with overflow checks, or neither is there. Scripts that rely
/// on one or the other say so in `MCVR_EXPECT_CHECKS` (`yes` or `no`).
#[test]
fn debug_assertions_and_overflow_checks_come_together() {
    let one = std::hint::black_box(1u32);
    let overflow = std::panic::catch_unwind(|| u32::MAX + one).is_err();
    let assertion = std::panic::catch_unwind(|| debug_assert!(one == 0)).is_err();
    assert_eq!(overflow, assertion);
    if let Ok(expected) = std::env::var("MCVR_EXPECT_CHECKS") {
        assert_eq!(overflow, expected == "yes", "MCVR_EXPECT_CHECKS={expected}");
    }
}
