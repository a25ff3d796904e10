"""Reads a .usda cache with Pixar's own library: check.py FILE.usda [FOLDER of OBJ files of the same bake]

With the folder, of a character whose file is in metres with Y up, points must be those of the OBJ files.
Needs `pip install usd-core numpy`. Ends with 0 when all is well.
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
        worst = max(worst, abs(points - obj_points(os.path.join(folder, files[t]))).max())
print(f"{sys.argv[1]}: {len(meshes)} meshes, {len(points)} points, {last - first + 1} frames at {stage.GetTimeCodesPerSecond()}, "
      f"moved {moved:.3f} m" + (f", largest difference {worst:.1e} m" if folder else ""))
sys.exit(0 if moved > 0 and worst < 1e-6 else 1)
