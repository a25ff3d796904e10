#!/bin/sh
# Runs every fuzz target for N executions (default 1,000,000), one after the other, gently.
# Usage: fuzz/run.sh [N] [TARGET ...]
# Needs a C++ compiler for libFuzzer. Works on stable Rust: the coverage hooks are switched on by hand.
# Seeds come from fuzz/corpus/TARGET (grown by the runs, not kept in the repository) and, where present, the small files of ../shared/data.
set -eu
cd "$(dirname "$0")"
runs=${1:-1000000}
[ $# -gt 0 ] && shift
targets=${*:-$(ls fuzz_targets | sed 's/\.rs$//')}
shared=${SOFTRIG_SHARED:-../../shared}
host=$(rustc -vV | sed -n 's/^host: //p')

export RUSTC_BOOTSTRAP=1
export RUSTFLAGS="--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
-Cllvm-args=-sanitizer-coverage-trace-compares -Ccodegen-units=1"
nice -n 15 cargo build --release --quiet --target "$host" --target-dir target

for target in $targets; do
    mkdir -p "corpus/$target" "artifacts/$target"
    case $target in
        tetgen) endings="" ;;
        gmsh) endings="msh" ;;
        medit) endings="mesh" ;;
        vega) endings="veg" ;;
        gltf) endings="gltf glb" ;;
        *) endings=$target ;;
    esac
    for ending in $endings; do
        find "$shared/data" -name "*.$ending" -size -40k -exec cp {} "corpus/$target/" \; 2>/dev/null || true
    done
    log="artifacts/$target.log"
    if nice -n 15 "target/$host/release/$target" "corpus/$target" -runs="$runs" -rss_limit_mb=500 -timeout=2 \
        -max_len=20000 -artifact_prefix="artifacts/$target/" ${FUZZ_SECONDS:+-max_total_time=$FUZZ_SECONDS} >"$log" 2>&1
    then
        echo "$target: $(grep '^Done' "$log")"
    else
        echo "$target: FINDING, see fuzz/$log"
        exit 1
    fi
done
