"""Reads a .usda cache with Pixar's own library: check.py FILE.usda [FOLDER of OBJ files of the same bake [METRES]]

With the folder, of a character whose file has Y up, points must be those of the OBJ files times METRES, the length of the file's
unit (default 1; `softrig inspect` says it), to 1e-6 m.
Needs `pip install usd-core numpy`. Ends with 0 when all is well.

Last run, 2026-11-22, usd-core 26.11, --cells 3000, 24 frames per second:
    CesiumMan/walk.usda: 1 meshes, 3273 points, 48 frames at 24.0, moved 0.891 m, largest difference 6.0e-08 m
    Cow/walk.usda: 1 meshes, 4970 points, 29 frames at 24.0, moved 0.176 m, largest difference 4.8e-08 m
    Knight/walk.usda: 15 meshes, 7024 points, 26 frames at 24.0, moved 1.566 m, largest difference 1.2e-07 m
    Fox/walk.usda: 1 meshes, 1728 points, 18 frames at 24.0, moved 0.568 m, largest difference 7.3e-08 m
    RobotExpressive/walk.usda: 14 meshes, 7214 points, 24 frames at 24.0, moved 0.220 m, largest difference 4.7e-08 m
"""

import os
import sys

import numpy as np
from pxr import Usd, UsdGeom


def obj_points(path):
    with open(path) as file:
        return np.array([[float(v) for v in line.split()[1:4]] for line in file if line.startswith("v ")])


stage = Usd.Stage.Open(sys.argv[1])
assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1
assert stage.GetDefaultPrim()
first, last = int(stage.GetStartTimeCode()), int(stage.GetEndTimeCode())
meshes = [UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
assert meshes
folder = sys.argv[2] if len(sys.argv) > 2 else None
unit = float(sys.argv[3]) if len(sys.argv) > 3 else 1.0
files = sorted(f for f in os.listdir(folder) if f.endswith(".obj")) if folder else []
worst = moved = 0.0
rest = None
for t in range(first, last + 1):
    points = []
    for mesh in meshes:
        p = np.array(mesh.GetPointsAttr().Get(t), dtype=float)
        lo, hi = np.array(mesh.GetExtentAttr().Get(t), dtype=float)
        assert np.isfinite(p).all() and (p >= lo).all() and (p <= hi).all()
        counts, indices = mesh.GetFaceVertexCountsAttr().Get(), mesh.GetFaceVertexIndicesAttr().Get()
        assert sum(counts) == len(indices) and max(indices) < len(p)
        color = mesh.GetDisplayColorPrimvar()
        assert color.HasValue()
        size = {"constant": 1, "uniform": len(counts), "vertex": len(p)}[color.GetInterpolation()]
        assert len(color.Get()) == size
        points.append(p)
    points = np.concatenate(points)
    rest = points if rest is None else rest
    moved = max(moved, abs(points - rest).max())
    if folder:
        worst = max(worst, abs(points - unit * obj_points(os.path.join(folder, files[t]))).max())
print(f"{sys.argv[1]}: {len(meshes)} meshes, {len(points)} points, {last - first + 1} frames at {stage.GetTimeCodesPerSecond()}, "
      f"moved {moved:.3f} m" + (f", largest difference {worst:.1e} m" if folder else ""))
sys.exit(0 if moved > 0 and worst < 1e-6 else 1)
