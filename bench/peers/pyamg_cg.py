"""Smoothed aggregation of pyamg on the system that `softrig bench cow --static` solves.

    pip install numpy scipy pyamg
    python3 make_systems.py DIR cow_65k              # of the baseline's folder, see docs/performance.md; DIR holds cow_65k.node .ele .fix
    OMP_NUM_THREADS=2 python3 pyamg_cg.py DIR/cow_65k_static.bcsr [TOLERANCE] [ROUNDS]

Rigid body modes as near null space, symmetric block Gauss-Seidel on 3x3 blocks, conjugate gradients. Prints the time of setup and solve [ms], the
iterations and the true relative residual of every round, and the medians.
"""

import sys
import time

import numpy as np
import pyamg
import scipy.sparse as sp


def read(path):
    """The matrix in 3x3 blocks, the right-hand side, and the positions [m] of the free nodes."""
    with open(path, "rb") as file:
        rows, blocks = np.fromfile(file, np.int64, 2)
        start = np.fromfile(file, np.int32, rows + 1)
        column = np.fromfile(file, np.int32, blocks)
        value = np.fromfile(file, np.float64, 9 * blocks).reshape(-1, 3, 3)
        rhs = np.fromfile(file, np.float64, 3 * rows)
        position = np.fromfile(file, np.float64, 3 * rows).reshape(-1, 3)
    if len(position) != rows:
        sys.exit(f"{path}: ends early; make it again with make_systems.py")
    return sp.bsr_matrix((value, column, start)), rhs, position


def rigid_modes(position):
    """Three translations and three turns about the middle, as columns."""
    x, y, z = (position - position.mean(0)).T
    modes = np.zeros((len(position), 3, 6))
    modes[:, :, :3] = np.eye(3)
    modes[:, 1, 3], modes[:, 2, 3] = -z, y
    modes[:, 0, 4], modes[:, 2, 4] = z, -x
    modes[:, 0, 5], modes[:, 1, 5] = -y, x
    return modes.reshape(-1, 6)


def main():
    if not 2 <= len(sys.argv) <= 4:
        sys.exit(__doc__)
    tolerance = float(sys.argv[2]) if len(sys.argv) > 2 else 1e-6
    rounds = int(sys.argv[3]) if len(sys.argv) > 3 else 3
    matrix, rhs, position = read(sys.argv[1])
    modes = rigid_modes(position)
    print(f"pyamg {pyamg.__version__}: {matrix.shape[0]} unknowns, to {tolerance:g}")
    smoother = ("block_gauss_seidel", {"sweep": "symmetric", "blocksize": 3})
    times = []
    for _ in range(rounds):
        before = time.perf_counter()
        levels = pyamg.smoothed_aggregation_solver(
            matrix, B=modes, symmetry="symmetric", presmoother=smoother, postsmoother=smoother
        )
        ready = time.perf_counter()
        history = []
        solution = levels.solve(rhs, tol=tolerance, accel="cg", maxiter=500, residuals=history)
        done = time.perf_counter()
        residual = np.linalg.norm(rhs - matrix @ solution) / np.linalg.norm(rhs)
        times.append([1e3 * (ready - before), 1e3 * (done - ready)])
        iterations = len(history) - 1
        print(f"setup {times[-1][0]:.0f} solve {times[-1][1]:.0f} iterations {iterations} residual {residual:.2e}")
    setup, solve = np.median(times, 0)
    print(f"medians: setup {setup:.0f} solve {solve:.0f} together {np.median(np.sum(times, 1)):.0f} ms")


if __name__ == "__main__":
    main()
