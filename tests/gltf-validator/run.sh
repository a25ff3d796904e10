#!/bin/sh
# Checks GLB files with the Khronos validator: run.sh FILE.glb ...
# Needs node and npm; without them it says so and ends with 0. The package goes to a cache folder outside the repository.
# Last run, 2026-11-22, gltf-validator 2.0.0-dev.3.10, bakes of --cells 3000 with up to 64 morph targets: CesiumMan, Cow, Fox, Knight:
# 0 errors, 0 warnings, 0 infos each; RobotExpressive: 0 errors, 0 warnings, 2 infos (triangles that are degenerate in its file).
set -eu
if ! command -v node >/dev/null || ! command -v npm >/dev/null; then
    echo "skipped: the glTF validator needs node and npm" >&2
    exit 0
fi
cache="${XDG_CACHE_HOME:-${HOME:-/tmp}/.cache}/softrig-gltf-validator"
mkdir -p "$cache"
if [ ! -d "$cache/node_modules/gltf-validator" ]; then
    if ! npm install --silent --no-audit --no-fund --prefix "$cache" gltf-validator@2.0.0-dev.3.10 >/dev/null 2>&1; then
        echo "skipped: npm cannot install gltf-validator" >&2
        exit 0
    fi
fi
NODE_PATH="$cache/node_modules" node "$(dirname "$0")/validate.js" "$@"
