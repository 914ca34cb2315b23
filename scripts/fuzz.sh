#!/usr/bin/env bash
# Fuzzes every reader of the program: coverage-guided (libFuzzer), on stable Rust. Needs a C++ compiler.
#
#   scripts/fuzz.sh [SECONDS [TARGET...]]      default: 60 seconds each of all targets
#   scripts/fuzz.sh replay TARGET FILE...      run single inputs, with the messages of panics
#
# Inputs that are worth keeping stay in $MCVR_FUZZ_DIR (default: mcvr-out/fuzz) and are the start of the next run; an
# input that crashes, hangs (10 s) or takes more memory than it can fill is saved there as TARGET/crash-* and ends the
# target. Each target's last line says how many inputs were tried.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
all=(volume image npy cloud scene matrix records numbers)

replay=0
if [ "${1:-}" = replay ]; then
    replay=1
    shift
    target=${1:?a target: ${all[*]}}
    shift
else
    seconds=${1:-60}
    shift || true
    targets=("${@:-${all[@]}}")
fi

host=$(rustc -vV | sed -n 's/^host: //p')
export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-target}/fuzz
# The compiler's own coverage pass, which needs no nightly; with --target, build scripts are left as they are.
RUSTFLAGS="-C passes=sancov-module -C llvm-args=-sanitizer-coverage-level=4 \
-C llvm-args=-sanitizer-coverage-inline-8bit-counters -C llvm-args=-sanitizer-coverage-pc-table \
-C llvm-args=-sanitizer-coverage-trace-compares -C codegen-units=4" \
    cargo build --release --quiet --manifest-path scripts/fuzz/Cargo.toml --target "$host"
fuzzer=$CARGO_TARGET_DIR/$host/release/mcvr-fuzz
export RAYON_NUM_THREADS=1

if [ $replay = 1 ]; then
    MCVR_FUZZ_TARGET=$target MCVR_FUZZ_VERBOSE=1 exec "$fuzzer" "$@"
fi
bad=0
for target in "${targets[@]}"; do
    kept=${MCVR_FUZZ_DIR:-mcvr-out/fuzz}/$target
    mkdir -p "$kept/corpus"
    log=$kept/log
    echo "$target: $seconds s"
    MCVR_FUZZ_TARGET=$target MCVR_FUZZ_SEEDS=$kept/corpus nice -n 19 "$fuzzer" "$kept/corpus" \
        -max_total_time="$seconds" -max_len=4096 -timeout=10 -rss_limit_mb=1024 -artifact_prefix="$kept/" \
        -print_final_stats=1 >"$log" 2>&1 || { bad=1; echo "$target: FOUND something, see $log"; }
    grep -E 'number_of_executed_units|Test unit written|one allocation' "$log" || tail -3 "$log"
done
exit $bad
