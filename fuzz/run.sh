#!/bin/sh
# Runs every fuzz target for N executions (default 1,000,000), one after the other, gently.
# Usage: fuzz/run.sh [N] [TARGET ...]
# Needs a C++ compiler for libFuzzer. Works on stable Rust: the coverage hooks are switched on by hand.
# Seeds come from fuzz/seeds/TARGET, from fuzz/corpus/TARGET (grown by the runs, not kept in the repository) and, where present,
# the small files of ../shared/data. The machine's priority is left to others: NICE=19 by default.
# An input that takes TIMEOUT seconds (default 20) is a finding: seconds of the clock, so no fewer on a busy machine.
set -eu
cd "$(dirname "$0")"
runs=${1:-1000000}
[ $# -gt 0 ] && shift
targets=${*:-$(ls fuzz_targets | sed 's/\.rs$//')}
shared=${SOFTRIG_SHARED:-../../shared}

# only the readers report what they reach; libraries below them are built as they are
export RUSTC_BOOTSTRAP=1 RUSTC_WRAPPER="$PWD/instrument.sh"
nice -n "${NICE:-19}" cargo build --release --quiet --target-dir target

for target in $targets; do
    mkdir -p "corpus/$target" "artifacts/$target"
    [ ! -d "seeds/$target" ] || cp "seeds/$target/"* "corpus/$target/"
    case $target in
        tetgen) endings="" ;;
        gmsh) endings="msh" ;;
        medit) endings="mesh" ;;
        vega) endings="veg" ;;
        gltf) endings="gltf glb" ;;
        cache | journal | scene) endings="" ;;
        *) endings=$target ;;
    esac
    for ending in $endings; do
        find "$shared/data" -name "*.$ending" -size -40k -exec cp {} "corpus/$target/" \; 2>/dev/null || true
    done
    log="artifacts/$target.log"
    if nice -n "${NICE:-19}" "target/release/$target" "corpus/$target" -runs="$runs" -rss_limit_mb=500 -timeout="${TIMEOUT:-20}" \
        -max_len=20000 -artifact_prefix="artifacts/$target/" ${FUZZ_SECONDS:+-max_total_time=$FUZZ_SECONDS} >"$log" 2>&1
    then
        echo "$target: $(grep -a '^Done' "$log")"
    else
        echo "$target: FINDING, see fuzz/$log"
        exit 1
    fi
done
