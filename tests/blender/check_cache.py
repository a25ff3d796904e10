"""Plays softrig's point caches in Blender and compares every vertex of every frame.

    python check_cache.py CHARACTER CACHE --clip NAME --fps F --start S [--blended] [--world FOLDER]

CHARACTER  a .glb or .gltf file
CACHE      the .pc2 or .mdd of its only mesh, or the folder with one for each mesh
--start    clock of the clip at frame 0 of the cache [s], `start_time_s` of `softrig bake --report`
--blended  the cache holds plain linear blend skinning (the example `blend_to_cache` of softrig-io makes one): the mesh with
           the cache and without the armature must equal the mesh with the armature and without the cache
--world    folder of OBJ files of the same bake: the mesh with the cache must stand where they say

Needs `pip install bpy` (5.0.1 for Python 3.11). Ends with 0 when the largest distance is at most 1e-5 of the height.

Last run with --world, 2026-11-22, bpy 5.0.1, --cells 3000, 24 frames per second, .pc2 and .mdd alike:
    CesiumMan.glb: 1 meshes, 3273 vertices, 48 frames, moved 0.613 of the height, largest distance 2.17e-07 of it
    Cow.glb: 1 meshes, 4970 vertices, 29 frames, moved 0.385 of the height, largest distance 2.52e-07 of it
    Knight.glb: 15 meshes, 7024 vertices, 26 frames, moved 0.637 of the height, largest distance 4.25e-06 of it
    Fox.glb: 1 meshes, 1728 vertices, 18 frames, moved 0.739 of the height, largest distance 5.48e-08 of it
RobotExpressive.glb cannot be compared: its armature has a scale of 100, and Blender 5.0.1 itself puts meshes that hang on a bone
of such an armature off by the bone's length, with or without a cache.
"""

import argparse
import json
import math
import os
import struct
import sys
import tempfile

import bpy
import numpy as np


def arguments():
    parser = argparse.ArgumentParser()
    parser.add_argument("character")
    parser.add_argument("cache")
    parser.add_argument("--clip", default=None, help="name; default: the clip Blender plays after importing, its first")
    parser.add_argument("--fps", type=float, default=24.0)
    parser.add_argument("--start", type=float, default=0.0)
    parser.add_argument("--blended", action="store_true")
    parser.add_argument("--world", default=None)
    return parser.parse_args()


def load(path, fps, clip):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    # the importer turns seconds into frames with the rate of the scene
    scene.render.fps = math.ceil(fps)
    scene.render.fps_base = math.ceil(fps) / fps
    with tempfile.TemporaryDirectory() as folder:
        bpy.ops.import_scene.gltf(filepath=os.path.abspath(with_one_clip(path, clip, folder)))
    # the importer's sphere for drawing bones is no part of the file
    shapes = {b.custom_shape for o in bpy.data.objects if o.type == "ARMATURE" for b in o.pose.bones}
    return [o for o in bpy.data.objects if o.type == "MESH" and o not in shapes]


def with_one_clip(path, clip, folder):
    """A copy of a .glb file with one animation only: bones that a clip leaves alone must stand as the file's nodes do, but in
    Blender they keep what the clip played before them did."""
    if clip is None or not path.endswith(".glb"):
        return path
    with open(path, "rb") as file:
        data = file.read()
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20:20 + length])
    document["animations"] = [a for a in document["animations"] if a.get("name") == clip]
    if not document["animations"]:
        sys.exit(f"{path} has no clip {clip}")
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length:]
    out = os.path.join(folder, "one_clip.glb")
    with open(out, "wb") as file:
        file.write(data[:8] + struct.pack("<II", 20 + len(text) + len(rest), len(text)) + b"JSON" + text + rest)
    return out


def vertices(owner):
    """Evaluated vertices of an object in the world, in Blender's axes."""
    graph = bpy.context.evaluated_depsgraph_get()
    evaluated = owner.evaluated_get(graph)
    mesh = evaluated.to_mesh()
    points = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", points)
    evaluated.to_mesh_clear()
    points = points.reshape(-1, 3).astype(float)
    world = np.array(evaluated.matrix_world)
    return points @ world[:3, :3].T + world[:3, 3]


def show(frame):
    whole = math.floor(frame)
    bpy.context.scene.frame_set(whole, subframe=frame - whole)


def add_cache(owner, path, first_frame):
    """What an artist does by hand, see docs/blender.md."""
    for modifier in list(owner.modifiers):
        owner.modifiers.remove(modifier)
    cache = owner.modifiers.new("softrig", "MESH_CACHE")
    cache.cache_format = "PC2" if path.endswith(".pc2") else "MDD"
    cache.filepath = os.path.abspath(path)
    cache.frame_start = first_frame
    # glTF keeps Y up inside every mesh object; these two turn (x, y, z) to (x, -z, y), as the importer does
    cache.forward_axis = "POS_Z"
    cache.up_axis = "NEG_Y"
    cache.interpolation = "NONE"


def frames_in(path):
    with open(path, "rb") as file:
        head = file.read(32)
    if head.startswith(b"POINTCACHE2\0"):
        return int.from_bytes(head[28:32], "little"), int.from_bytes(head[16:20], "little")
    return int.from_bytes(head[:4], "big"), int.from_bytes(head[4:8], "big")


def obj_frames(folder):
    """For each OBJ file the vertices of each object, in Blender's axes."""
    for name in sorted(n for n in os.listdir(folder) if n.endswith(".obj")):
        objects, current = {}, None
        with open(os.path.join(folder, name)) as file:
            for line in file:
                if line.startswith("o "):
                    current = objects.setdefault(line[2:].strip(), [])
                elif line.startswith("v "):
                    x, y, z = map(float, line.split()[1:4])
                    current.append((x, -z, y))
        yield {k: np.array(v) for k, v in objects.items()}


def main():
    options = arguments()
    meshes = load(options.character, options.fps, options.clip)
    first_frame = options.start * options.fps
    if os.path.isdir(options.cache):
        files = {o.name: next((os.path.join(options.cache, o.name + e) for e in (".pc2", ".mdd")
                               if os.path.exists(os.path.join(options.cache, o.name + e))), None) for o in meshes}
    else:
        files = {o.name: options.cache for o in meshes}
    missing = [name for name, file in files.items() if file is None]
    if missing or not files:
        sys.exit(f"no cache for {missing}")
    count = min(frames_in(f)[0] for f in files.values())
    for owner in meshes:
        if frames_in(files[owner.name])[1] != len(owner.data.vertices):
            sys.exit(f"{owner.name}: Blender has {len(owner.data.vertices)} vertices, the cache {frames_in(files[owner.name])[1]}")

    show(first_frame)
    all_points = np.concatenate([vertices(o) for o in meshes])
    height = np.ptp(all_points[:, 2])
    expected = []
    if options.blended:
        for k in range(count):
            show(first_frame + k)
            expected.append({o.name: vertices(o) for o in meshes})
    elif options.world:
        expected = list(obj_frames(options.world))

    for owner in meshes:
        add_cache(owner, files[owner.name], first_frame)
    worst, moved = 0.0, 0.0
    for k in range(count):
        show(first_frame + k)
        for owner in meshes:
            now = vertices(owner)
            if not np.isfinite(now).all():
                sys.exit(f"{owner.name}: frame {k} is not finite")
            if expected:
                error = np.linalg.norm(now - expected[k][owner.name], axis=1).max()
                if error > worst:
                    worst = error
                    where = f"{owner.name}, frame {k}"
                moved = max(moved, np.linalg.norm(expected[k][owner.name] - expected[0][owner.name], axis=1).max())
    if not expected:
        sys.exit("nothing to compare with: give --blended or --world")
    good = worst <= 1e-5 * height and moved > 1e-3 * height
    print(f"{os.path.basename(options.character)}: {len(meshes)} meshes, {sum(len(o.data.vertices) for o in meshes)} vertices, "
          f"{count} frames, moved {moved / height:.3f} of the height, largest distance {worst / height:.2e} of it"
          + (f" ({where})" if worst > 0 else ""))
    sys.exit(0 if good else 1)


main()
