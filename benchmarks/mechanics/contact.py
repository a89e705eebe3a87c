"""A sphere pressed into a bonded layer, against plain ways to the same pressures, all measured here and now.

Run ``OMP_NUM_THREADS=1 python benchmarks/mechanics/contact.py``. The baselines keep a set of touching
cells, solve for its pressures, drop what pulls, take in what is pierced, and repeat: one solves with
SciPy's conjugate gradients over ``scipy.signal.fftconvolve``, the other (on the smallest grid only) with a
dense matrix. All use the same influence of one cell, built beforehand; what building it costs is printed.
The ways take turns.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import fft, linalg, signal
from scipy.sparse.linalg import LinearOperator, cg

from palpate.mechanics.layers import contact_solver
from palpate.mechanics.layers.contact_solver import press_stack
from palpate.mechanics.layers.influence import cells, normal_influence, normal_preconditioner
from palpate.mechanics.layers.stack import ElasticLayer, Stack

RADIUS_M, DEPTH_M, HALF_WIDTH_M = 5e-3, 1e-3, 3e-3
LAYER = Stack((ElasticLayer(10e-3, 0.3e6, 0.49),))
DENSE_UP_TO = 64  # points a side: the matrix of more would not fit
ROUNDS_OF_CELLS = 50

Pressures = Callable[[], np.ndarray]
Solve = Callable[[np.ndarray, np.ndarray], np.ndarray]  # touching cells and depth there, to pressures there


@dataclass(frozen=True)
class Problem:
    """One grid: heights, and the influence of a cell on all offsets of the grid."""

    points: int

    @property
    def x_m(self) -> np.ndarray:
        return np.linspace(-HALF_WIDTH_M, HALF_WIDTH_M, self.points)

    @property
    def gap_m(self) -> np.ndarray:
        return contact_solver.sphere(self.x_m, self.x_m, RADIUS_M)

    def offsets(self) -> np.ndarray:
        """Sinking at each offset, from -(n - 1) to n - 1 along both axes."""
        influence = normal_influence(LAYER, cells(self.x_m, self.x_m))
        every = np.roll(fft.irfft2(influence.spectra[0], influence.shape), (self.points - 1,) * 2, (0, 1))
        return every[: 2 * self.points - 1, : 2 * self.points - 1]


def keep_cells(problem: Problem, solve: Solve, sinking: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Pressures by solving on a set of cells until none pulls and none is pierced."""
    asked = DEPTH_M - problem.gap_m
    touching = asked > 0
    for _ in range(ROUNDS_OF_CELLS):
        p = np.zeros_like(asked)
        p[touching] = solve(touching, asked[touching])
        pulling = p < 0
        pierced = ~touching & (sinking(np.maximum(p, 0)) < asked)
        if not pulling.any() and not pierced.any():
            break
        touching = touching & ~pulling if pulling.any() else touching | pierced
    return np.maximum(p, 0)


def by_conjugate_gradients(problem: Problem) -> Pressures:
    """SciPy's conjugate gradients and convolution."""
    offsets, n = problem.offsets(), problem.points

    def convolved(p: np.ndarray) -> np.ndarray:
        return signal.fftconvolve(p, offsets)[n - 1 : 2 * n - 1, n - 1 : 2 * n - 1]

    def solve(touching: np.ndarray, asked: np.ndarray) -> np.ndarray:
        def on_cells(values: np.ndarray) -> np.ndarray:
            p = np.zeros(touching.shape)
            p[touching] = values.ravel()
            return convolved(p)[touching]

        return cg(LinearOperator((len(asked),) * 2, on_cells, dtype=float), asked, rtol=1e-6)[0]

    return lambda: keep_cells(problem, solve, convolved)


def by_dense_matrix(problem: Problem) -> Pressures:
    """The matrix of all pairs of cells, and Cholesky's factors."""
    offsets, n = problem.offsets(), problem.points
    i = np.arange(n)
    rows = i[:, None] - i[None, :] + n - 1
    matrix = offsets[rows[:, None, :, None], rows[None, :, None, :]].reshape(n * n, n * n)

    def solve(touching: np.ndarray, asked: np.ndarray) -> np.ndarray:
        at = np.flatnonzero(touching)
        return linalg.solve(matrix[np.ix_(at, at)], asked, assume_a="pos")

    return lambda: keep_cells(problem, solve, lambda p: (matrix @ p.ravel()).reshape(n, n))


def build_ms(problem: Problem) -> float:
    """Building what the solver needs of one stack and grid [ms]; later presses find it ready."""
    grid = cells(problem.x_m, problem.x_m)
    normal_influence.cache_clear()
    normal_preconditioner.cache_clear()
    begin = time.perf_counter()
    normal_influence(LAYER, grid)
    normal_preconditioner(LAYER, grid)
    return (time.perf_counter() - begin) * 1e3


def compare(points: int, rounds: int) -> None:
    """Press by every way in turn, and print times and how far the forces are apart."""
    problem = Problem(points)
    x, z = problem.x_m, problem.gap_m
    print(f"{points} x {points} points; influence built in {build_ms(problem):.0f} ms")
    ways: dict[str, Pressures] = {
        "palpate": lambda: press_stack(LAYER, z, x, x, depth_m=DEPTH_M).pressure_pa,
        "scipy cg": by_conjugate_gradients(problem),
    }
    if points <= DENSE_UP_TO:
        ways["dense"] = by_dense_matrix(problem)
    times_ms: dict[str, list[float]] = {name: [] for name in ways}
    forces = {}
    for _ in range(rounds):
        for name, pressures in ways.items():
            begin = time.perf_counter()
            p = pressures()
            times_ms[name].append((time.perf_counter() - begin) * 1e3)
            forces[name] = p.sum()
    base = np.array(times_ms["scipy cg"])
    for name, taken in times_ms.items():
        ratios = base / np.array(taken)
        print(
            f"  {name:9s} median {np.median(taken):8.1f} ms (least {min(taken):.1f}); speed of scipy cg "
            f"x {np.median(ratios):.2f} (rounds {ratios.min():.2f} to {ratios.max():.2f}); "
            f"force {forces[name] / forces['palpate'] - 1:+.1e} from palpate's"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    for points in asked.points:
        compare(points, asked.rounds)


if __name__ == "__main__":
    main()
