#!/bin/sh
# Stands before rustc: adds coverage hooks for libFuzzer to softrig-io, softrig-cli and the fuzz targets, and to nothing else.
case " $* " in
*" --crate-name softrig_io "* | *" --crate-name softrig_cli "* | *"fuzz_targets/"*)
    exec "$@" --cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
        -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
        -Cllvm-args=-sanitizer-coverage-trace-compares
    ;;
*) exec "$@" ;;
esac
