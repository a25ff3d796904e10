"""Reads softrig's point caches by the definitions of their formats alone, and compares them with OBJ files of the same bake.

    python check.py CACHE OBJFOLDER CHARACTER.glb [--fps F]

CACHE         a .pc2 or .mdd file, or the folder with one for each mesh
OBJFOLDER     the same bake as an OBJ series, in the world and the units of the file
CHARACTER.glb the file that was baked: where its mesh objects stand is taken from its nodes

PC2, little-endian: "POINTCACHE2\\0", version i32 = 1, points i32, start frame f32, sample rate f32, samples i32; then for each
sample x y z as f32 for each point.
MDD, big-endian: frames i32, points i32, a time in seconds as f32 for each frame; then as above.

A cache is in the local space of its mesh object, an OBJ file in the world. For a mesh without a skin the map between is that of
the file's nodes; where an animation moves these (a sword in a hand), one affine map for each frame must take all points there.
glTF gives a skinned mesh no space of its own: one affine map must take all points of all frames to the world.

Needs `pip install numpy`. Ends with 0 when the largest distance is at most 1e-5 of the height and something moved.

Last run, 2026-11-22, --cells 3000, 24 frames per second:
    CesiumMan.pc2: 1 skinned, 3273 points, 48 frames, moved 0.617 of the height, largest distance 4.24e-08 of it
    Cow.pc2: 1 skinned, 4970 points, 29 frames, moved 0.391 of the height, largest distance 1.56e-07 of it
    Knight.pc2: 9 animated, 6 skinned, 7024 points, 26 frames, moved 0.634 of the height, largest distance 5.89e-08 of it
    Fox.pc2: 1 skinned, 1728 points, 18 frames, moved 0.744 of the height, largest distance 5.48e-08 of it
    RobotExpressive.pc2: 12 animated, 2 skinned, 7214 points, 24 frames, moved 0.505 of the height, largest distance 1.06e-07 of it
and the same for .mdd.
"""

import argparse
import json
import os
import struct
import sys

import numpy as np


def read_pc2(data):
    signature, version, points, start, rate, samples = struct.unpack_from("<12siiffi", data)
    assert signature == b"POINTCACHE2\0", signature
    assert (version, start, rate) == (1, 0.0, 1.0), (version, start, rate)
    assert len(data) == 32 + samples * points * 12, "size and header do not agree"
    return np.frombuffer(data, "<f4", offset=32).reshape(samples, points, 3).astype(float), None


def read_mdd(data):
    frames, points = struct.unpack_from(">ii", data)
    times = np.frombuffer(data, ">f4", count=frames, offset=8).astype(float)
    assert len(data) == 8 + 4 * frames + frames * points * 12, "size and header do not agree"
    return np.frombuffer(data, ">f4", offset=8 + 4 * frames).reshape(frames, points, 3).astype(float), times


def read_cache(path):
    with open(path, "rb") as file:
        data = file.read()
    return read_pc2(data) if path.endswith(".pc2") else read_mdd(data)


def read_obj(path):
    objects, points = {}, None
    with open(path) as file:
        for line in file:
            if line.startswith("o "):
                points = objects.setdefault(line[2:].rstrip("\n"), [])
            elif line.startswith("v "):
                points.append([float(v) for v in line.split()[1:4]])
    return {name: np.array(p) for name, p in objects.items()}


class Nodes:
    """Where the nodes of a .glb file stand."""

    def __init__(self, path):
        with open(path, "rb") as file:
            data = file.read()
        assert data[:4] == b"glTF", "give a .glb file"
        document = json.loads(data[20:20 + int.from_bytes(data[12:16], "little")])
        self.nodes = document["nodes"]
        self.parent = {child: i for i, node in enumerate(self.nodes) for child in node.get("children", [])}
        self.animated = {c["target"].get("node") for a in document.get("animations", []) for c in a["channels"]}

    def local(self, i):
        node = self.nodes[i]
        if "matrix" in node:
            return np.array(node["matrix"]).reshape(4, 4).T
        x, y, z, w = node.get("rotation", [0, 0, 0, 1])
        turn = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])
        out = np.eye(4)
        out[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]))
        out[:3, 3] = node.get("translation", [0, 0, 0])
        return out

    def space(self, name):
        """How a mesh object stands: "skinned", "animated", or its matrix in the world."""
        found = [i for i, n in enumerate(self.nodes) if "mesh" in n and n.get("name", "") == name]
        if not found and sum("mesh" in n for n in self.nodes) == 1:
            found = [i for i, n in enumerate(self.nodes) if "mesh" in n]
        if not found:
            sys.exit(f"the file has no mesh object {name}")
        i, out = found[0], np.eye(4)
        if "skin" in self.nodes[i]:
            return "skinned"
        while i is not None:
            if i in self.animated:
                return "animated"
            out, i = self.local(i) @ out, self.parent.get(i)
        return out


def fitted(local, world):
    """The affine map that takes local points to the world best."""
    assert len(local) > 4, "too few points to find out where the object is"
    center = local.mean(axis=0)
    size = np.abs(local - center).max()
    rows = np.c_[(local - center) / size, np.ones(len(local))]
    solution = np.linalg.lstsq(rows, world, rcond=None)[0].T
    out = np.eye(4)
    out[:3, :3] = solution[:, :3] / size
    out[:3, 3] = solution[:, 3] - out[:3, :3] @ center
    return out


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("cache")
    parser.add_argument("objs")
    parser.add_argument("character")
    parser.add_argument("--fps", type=float, default=24.0)
    options = parser.parse_args()
    files = [options.cache]
    if os.path.isdir(options.cache):
        files = sorted(os.path.join(options.cache, f) for f in os.listdir(options.cache))
    frames = [read_obj(os.path.join(options.objs, f)) for f in sorted(os.listdir(options.objs)) if f.endswith(".obj")]
    height = np.ptp(np.concatenate(list(frames[0].values()))[:, 1])
    nodes = Nodes(options.character)
    worst = moved = 0.0
    points_seen, kinds = 0, {}
    for file in files:
        cache, times = read_cache(file)
        name = os.path.splitext(os.path.basename(file))[0] if len(files) > 1 else next(iter(frames[0]))
        assert cache.shape == (len(frames), len(frames[0][name]), 3), f"{file}: {cache.shape}"
        assert np.isfinite(cache).all(), file
        if times is not None:
            assert np.allclose(times, np.arange(len(frames)) / options.fps, atol=1e-5), times
        points_seen += cache.shape[1]
        space = nodes.space(name)
        kind = space if isinstance(space, str) else "unmoved"
        kinds[kind] = kinds.get(kind, 0) + 1
        worlds = np.array([objects[name] for objects in frames])
        if kind == "skinned":
            space = fitted(cache.reshape(-1, 3), worlds.reshape(-1, 3))
        for local, world in zip(cache, worlds):
            matrix = fitted(local, world) if kind == "animated" else space
            worst = max(worst, np.linalg.norm(local @ matrix[:3, :3].T + matrix[:3, 3] - world, axis=1).max())
            moved = max(moved, np.linalg.norm(world - worlds[0], axis=1).max())
    assert points_seen == sum(len(p) for p in frames[0].values()), "a mesh has no cache"
    print(f"{os.path.basename(options.cache)}: {', '.join(f'{n} {k}' for k, n in sorted(kinds.items()))}, {points_seen} points, "
          f"{len(frames)} frames, moved {moved / height:.3f} of the height, largest distance {worst / height:.2e} of it")
    sys.exit(0 if worst <= 1e-5 * height and moved > 1e-3 * height else 1)


main()
