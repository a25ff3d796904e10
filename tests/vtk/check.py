"""Opens the VTU series of a bake with VTK and compares it with the report of the bake.

    python check.py SERIES.pvd REPORT.json

Checked in every frame: number and type of the cells, every array finite, stress and strain symmetric, von Mises stress that of
the stress, displacement = position now minus position at rest, and volumes: of the body as the report counts them, each cell
by the part of it that is inside the skin. VTK's volume of a hexahedron is that of the tetrahedra it cuts it into, softrig's the
integral over its curved faces: the ratio to the volume at rest may differ by 1e-3.

Needs `pip install vtk numpy`. Ends with 0 when all is well.

Last run, 2026-11-22, --cells 3000, VTK 9.7.2:
    CesiumMan.glb: 48 frames, 3011 hex cells, 4630 nodes, all finite; von Mises up to 1.43e+04 Pa, strain up to 0.73, moved 0.80 m;
      rest volume 0.05359 m3, over time 0.9885 to 0.9944 of it, the report says 0.9885 to 0.9944; single cells' ratios within 4.6e-02
    Cow.glb: 29 frames, 2999 hex cells, 4288 nodes, all finite; von Mises up to 1.52e+04 Pa, strain up to 0.73, moved 0.19 m;
      rest volume 0.02405 m3, over time 0.9883 to 0.9917 of it, the report says 0.9883 to 0.9917; single cells' ratios within 3.2e-02
    Knight.glb: 26 frames, 3037 hex cells, 4310 nodes, all finite; von Mises up to 2.3e+04 Pa, strain up to 1.18, moved 0.80 m;
      rest volume 0.99921 m3, over time 0.9493 to 0.9865 of it, the report says 0.9493 to 0.9865; single cells' ratios within 1.4e-01
    Fox.glb: 18 frames, 2943 hex cells, 4338 nodes, all finite; von Mises up to 2.41e+04 Pa, strain up to 1.21, moved 0.46 m;
      rest volume 0.06641 m3, over time 0.9716 to 0.9943 of it, the report says 0.9716 to 0.9943; single cells' ratios within 4.8e-02
    RobotExpressive.glb: 24 frames, 2966 hex cells, 4412 nodes, all finite; von Mises up to 1.39e+04 Pa, strain up to 0.70, moved 0.37 m;
      rest volume 0.00066 m3, over time 0.9942 to 0.9954 of it, the report says 0.9942 to 0.9954; single cells' ratios within 1.0e-01
(a single cell's ratio is that in its middle in the file, that of the whole cell in VTK)
"""

import json
import os
import sys
import xml.etree.ElementTree as xml

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

VOLUME = 1e-3
TYPES = {"tet": vtk.VTK_TETRA, "hex": vtk.VTK_HEXAHEDRON}


def volumes(grid):
    """Volume of each cell by VTK."""
    sizes = vtk.vtkCellSizeFilter()
    sizes.SetInputData(grid)
    sizes.ComputeVolumeOn()
    sizes.Update()
    return vtk_to_numpy(sizes.GetOutput().GetCellData().GetArray("Volume"))


def moved_to(grid, points):
    """The same cells with other points."""
    out = vtk.vtkUnstructuredGrid()
    out.DeepCopy(grid)
    out.GetPoints().SetData(numpy_to_vtk(points, deep=True))
    return out


def main():
    series, report = sys.argv[1], json.load(open(sys.argv[2]))
    entries = xml.parse(series).getroot().findall("./Collection/DataSet")
    assert len(entries) == report["frames"], (len(entries), report["frames"])
    rest_volume = rest_points = None
    ratios, worst_cell, highest_stress, most_strain, farthest = [], 0.0, 0.0, 0.0, 0.0
    for k, entry in enumerate(entries):
        assert abs(float(entry.get("timestep")) - k / report["fps"]) < 1e-9
        reader = vtk.vtkXMLUnstructuredGridReader()
        reader.SetFileName(os.path.join(os.path.dirname(series), entry.get("file")))
        reader.Update()
        grid = reader.GetOutput()
        assert reader.GetErrorCode() == 0
        assert grid.GetNumberOfCells() == report["cells"] and grid.GetNumberOfPoints() == report["nodes"]
        assert set(vtk_to_numpy(grid.GetCellTypes())) == {TYPES[report["cell_kind"]]}
        point_data, cell_data = grid.GetPointData(), grid.GetCellData()
        array = {a: vtk_to_numpy(cell_data.GetArray(a)) for a in map(cell_data.GetArrayName, range(cell_data.GetNumberOfArrays()))}
        moved = vtk_to_numpy(point_data.GetArray("displacement [m]"))
        points = vtk_to_numpy(grid.GetPoints().GetData())
        assert all(np.isfinite(a).all() for a in [*array.values(), moved, points])

        stress = array["stress [Pa]"].reshape(-1, 3, 3)
        strain = array["strain"].reshape(-1, 3, 3)
        for a in (stress, strain):
            assert (a == a.transpose(0, 2, 1)).all()
        deviator = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
        von_mises = np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))
        assert np.allclose(von_mises, array["von Mises stress [Pa]"], rtol=1e-9, atol=1e-6)
        highest_stress = max(highest_stress, von_mises.max())
        most_strain = max(most_strain, np.abs(np.linalg.eigvalsh(strain)).max())
        farthest = max(farthest, np.linalg.norm(moved, axis=1).max())

        if rest_volume is None:
            rest_points = points - moved
            rest_volume = volumes(moved_to(grid, rest_points))
            assert (rest_volume > 0).all()
        assert np.abs(points - moved - rest_points).max() < 1e-12
        now = volumes(grid)
        fill = array.get("fill", np.ones(len(now)))
        assert ((fill > 0) & (fill <= 1)).all()
        ratios.append((fill * now).sum() / (fill * rest_volume).sum())
        worst_cell = max(worst_cell, np.abs(now / rest_volume - array["volume ratio"]).max())
    body = [min(ratios) - report["volume_ratio_min"], max(ratios) - report["volume_ratio_max"]]
    print(f"{report['character'].split('/')[-1]}: {len(entries)} frames, {report['cells']} {report['cell_kind']} cells, "
          f"{report['nodes']} nodes, all finite; von Mises up to {highest_stress:.3g} Pa, strain up to {most_strain:.2f}, "
          f"moved {farthest:.2f} m; rest volume {(fill * rest_volume).sum():.5f} m3, over time {min(ratios):.4f} to {max(ratios):.4f} of it, "
          f"the report says {report['volume_ratio_min']:.4f} to {report['volume_ratio_max']:.4f}; "
          f"single cells' ratios within {worst_cell:.1e}")
    sys.exit(0 if np.abs(body).max() < VOLUME and highest_stress > 0 and farthest > 0 else 1)


main()
