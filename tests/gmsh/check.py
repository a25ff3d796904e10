"""Opens Gmsh 4.1 files of softrig with Gmsh itself and with meshio.

    python check.py FILE.msh [TETS HEXES NODES VOLUME]

The numbers are what `softrig inspect --json FILE.msh` says; with them they must agree, volumes to 1e-9 of themselves for
tetrahedra and 1e-6 for hexahedra at rest.

Needs `pip install gmsh meshio numpy`. Ends with 0 when all is well.

Last run, 2026-11-22, Gmsh 4.15.2, meshio 5.3.5:
    hex.msh: 0 tetrahedra, 3011 hexahedra, 4630 nodes, 1 volumes, volume 0.0784426252, smallest cell 2.61e-05
    tet.msh: 18066 tetrahedra, 0 hexahedra, 4630 nodes, 1 volumes, volume 0.0784426252, smallest cell 4.34e-06
    elbow.msh: 8161 tetrahedra, 0 hexahedra, 1823 nodes, 1 volumes named 6, volume 0.00087736231, smallest cell 2.6e-08
    simpleBridge_hex.msh: 0 tetrahedra, 1736 hexahedra, 3923 nodes, 1 volumes named EL, volume 27.4803449, smallest cell 0.0158
    turtle-volumetric-heterogeneous.msh: 1185 tetrahedra, 0 hexahedra, 347 nodes, 2 volumes named softMaterial, hardMaterial, volume 45.1870453, smallest cell 0.00563
(hex, tet: `softrig mesh CesiumMan.glb --cells 3000`, and with `--kind tet`; the others: `softrig mesh` of volume meshes).
"""

import sys

import gmsh
import meshio
import numpy as np

TET, HEX = 4, 5
# tetrahedra that fill a hexahedron with flat faces, in the order of nodes of VTK and Gmsh
CUT = [(0, 1, 3, 4), (1, 2, 3, 6), (1, 3, 4, 6), (3, 4, 6, 7), (1, 4, 5, 6)]


def tet_volume(p):
    """Signed, from corners of shape (n, 4, 3)."""
    e = p[:, 1:] - p[:, :1]
    return np.linalg.det(e) / 6


def main():
    path = sys.argv[1]
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(path)
    tags, points, _ = gmsh.model.mesh.getNodes()
    place = np.zeros(int(tags.max()) + 1, dtype=int)
    place[tags] = np.arange(len(tags))
    points = points.reshape(-1, 3)
    kinds, elements, corners = gmsh.model.mesh.getElements(dim=3)
    counts, volume, smallest = {TET: 0, HEX: 0}, 0.0, np.inf
    for kind, ids, nodes in zip(kinds, elements, corners):
        p = points[place[nodes.reshape(len(ids), -1)]]
        v = tet_volume(p) if kind == TET else sum(tet_volume(p[:, list(c)]) for c in CUT)
        counts[int(kind)] += len(ids)
        volume += v.sum()
        smallest = min(smallest, v.min())
        # Gmsh's own measure of how well each cell is shaped
        assert min(gmsh.model.mesh.getElementQualities(ids, "minSJ")) > 0, "Gmsh finds cells inside out"
    groups = [gmsh.model.getPhysicalName(d, t) for d, t in gmsh.model.getPhysicalGroups(3)]
    entities = len(gmsh.model.getEntities(3))
    gmsh.finalize()

    other = meshio.read(path)
    by_meshio = {k: sum(len(c.data) for c in other.cells if c.type == n) for k, n in ((TET, "tetra"), (HEX, "hexahedron"))}
    assert by_meshio == counts and len(other.points) == len(tags), (by_meshio, counts)
    assert np.array_equal(np.asarray(other.points), points[np.argsort(tags)]), "Gmsh and meshio read other points"
    assert np.isfinite(points).all() and smallest > 0, smallest
    print(f"{path.split('/')[-1]}: {counts[TET]} tetrahedra, {counts[HEX]} hexahedra, {len(tags)} nodes, "
          f"{entities} volumes{' named ' + ', '.join(groups) if groups else ''}, volume {volume:.9g}, smallest cell {smallest:.3g}")
    if len(sys.argv) > 2:
        tets, hexes, nodes = map(int, sys.argv[2:5])
        assert (counts[TET], counts[HEX], len(tags)) == (tets, hexes, nodes)
        expected = float(sys.argv[5])
        tolerance = 1e-6 if hexes else 1e-9
        assert abs(volume - expected) <= tolerance * expected, (volume, expected)


main()
