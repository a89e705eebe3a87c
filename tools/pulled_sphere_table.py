"""Make the table of a sphere that is pulled aside: what a pull adds to the press tables, to first order.

    python tools/pulled_sphere_table.py solved --out src/palpate/mechanics/tables    # ten minutes on one core

Needs scikit-fem. Options are those of `table_runner`; the study that it is held against is
`dragged_sphere.py`'s.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.optimize import brentq

sys.path.insert(0, str(Path(__file__).parent))

from finite_strain.disc import Disc
from finite_strain.neo_hookean import NeoHookean
from finite_strain.press import Press
from finite_strain.pulled import Increment, Pull
from finite_strain.recover import Deformed, Grid, deformed, edge, projection, tensor_order
from table_runner import kept, run, write

from palpate.mechanics.axisymmetric.pulled_sphere import FULL, mindlin_stiffness, radii_of, shares_down
from palpate.mechanics.axisymmetric.shape_table import SphereTable

THICKNESSES = (1.8, 2.0, 2.2, 2.5, 4.0)
DEPTHS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0, 1.1, 1.2)
SHARES = (0.0, 0.3, 0.6, 0.8, FULL)
CELL = 1.0 / 40.0
STEPS = sorted({0.005, 0.01, 0.02, 0.03, *(k / 20 for k in range(1, 25)), *DEPTHS})
MODES = 72


def increments(pull: Pull, shares: tuple[float, ...] = SHARES) -> list[Increment]:
    """The pulls of these shares of friction."""
    press = pull.press.force(pull.balanced)
    stuck = pull.slipping(1.0, np.inf)
    made = [stuck]
    for share in shares[1:]:

        def missing(x: float, share: float = share) -> float:
            return pull.slipping(x).force / press - share

        low, high = 0.0, 1.1 * share * press / stuck.force
        while missing(high) < 0.0:  # slip takes the sphere further
            low, high = high, 1.2 * high
        made.append(pull.slipping(brentq(missing, low, high, xtol=1e-5 * high)))
    return made


class Added:
    """Stress and surface that increments add, read where the sphere is now."""

    def __init__(self, pull: Pull) -> None:
        self.pull, disc = pull, pull.disc
        self.body: Deformed = deformed(pull.press, pull.balanced)
        middles = tuple(np.sort(np.concatenate([k, (k[1:] + k[:-1]) / 2])) for k in disc.knots)
        self.node = tensor_order(disc.cells.doflocs, *middles)
        _, _, J, _ = pull.pressed
        self.projected = projection(disc, disc.weight * J)

    def nodal(self, one: Increment) -> Float[ndarray, "9 nodes"]:
        """Cauchy's stress at places of the skin that move along, and U, V, W."""
        disc, n = self.pull.disc, self.pull.disc.nodes
        stress = self.projected(self.pull.cauchy(one))
        axis = np.isclose(disc.cells.doflocs[0], 0.0)
        stress[np.ix_([0, 1, 2, 4], axis)] = 0.0
        across = (stress[3, axis] - stress[5, axis]) / 2
        stress[3, axis], stress[5, axis] = across, -across
        return np.concatenate([stress, one.state[: 3 * n].reshape(3, n)])

    def read(self, one: Increment, r: ndarray, zeta: ndarray) -> tuple[Float[ndarray, "6 m n"], ndarray]:
        """Stress over (zeta, r) of the top as it is now, and the top's depth."""
        h = self.pull.disc.thickness
        top = self.body.surface(r)
        z = top + zeta[:, None] * (h - top)
        rr = np.broadcast_to(r, z.shape)
        R, Z, _ = self.body.unloaded(rr.ravel(), z.ravel())
        grid = Grid(self.pull.disc.knots, self.nodal(one)[:, self.node])
        values, _ = grid.at(R, Z)
        added, (U, V, W) = values[:6], values[6:]
        base, slope = self.body.stress.at(R, Z)
        _, D = self.body.place.at(R, Z)
        det = D[0, 0] * D[1, 1] - D[0, 1] * D[1, 0]
        over_r = (slope[:, 0] * D[1, 1] - slope[:, 1] * D[1, 0]) / det
        over_z = (slope[:, 1] * D[0, 0] - slope[:, 0] * D[0, 1]) / det
        moved = (U - one.shift).reshape(z.shape)
        sunk = W.reshape(z.shape)
        tilt = np.gradient(top, r)
        surface = sunk[0] - tilt * moved[0]
        down = (1.0 - zeta[:, None]) * surface - sunk
        stress = added.reshape(6, *z.shape).copy()
        drawn = over_z.reshape(4, *z.shape) * down - over_r.reshape(4, *z.shape) * moved
        stress[:4] += drawn
        s_rr, s_tt, _, s_rz = base.reshape(4, *z.shape)
        turned = (V + one.shift).reshape(z.shape) / np.maximum(rr, 1e-9)
        turned[:, r == 0.0] = 0.0
        stress[4] += turned * (s_tt - s_rr)
        stress[5] -= turned * s_rz
        return stress, surface


def solve(path: Path, thickness: float) -> None:
    """Every depth and share of one disc."""
    press = Press(Disc(thickness, CELL), NeoHookean(0.49), 0.0)
    table = SphereTable.of_disc(thickness, 0.0, 0.49)
    stiffness, shift, values = [], [], []
    for balanced in press.through(STEPS):
        if not np.isclose(balanced.depth, DEPTHS).any():
            continue
        a = table.contact_radius_at(balanced.depth)
        r, zeta = radii_of(a), shares_down(a, balanced.depth, thickness)
        pull = Pull(press, balanced)
        made = increments(pull)
        added = Added(pull)
        k = made[0].force / made[0].shift
        # one mesh knows its own edge: stiffness goes with it, and is kept over that of its own radius
        stiffness.append(k / mindlin_stiffness(sum(edge(press, balanced)) / 2))
        shift.append([k * one.shift / one.force for one in made])
        fields = [(one.force, *added.read(one, r, zeta)) for one in made]
        values.append([np.concatenate([(s * a**2 / f).ravel(), top * a / f]) for f, s, top in fields])
        print(
            f"{path.stem} depth {balanced.depth:g} R: {stiffness[-1]:.4f} of Mindlin's stiffness", flush=True
        )
    np.savez(path, stiffness=stiffness, shift=shift, values=values)


def tables(folder: Path, out: Path) -> None:
    """Cut the fields to modes, and write them."""
    made = [kept(folder / f"pulled-h{thickness:g}.npz") for thickness in THICKNESSES]
    values = np.stack([one["values"] for one in made])
    scale = np.sqrt((values**2).mean(axis=(0, 1, 2)))
    scale = np.maximum(scale, 1e-3 * scale.max()).astype(np.float16).astype(float)
    flat = values.reshape(-1, values.shape[-1]) / scale
    _, _, mode = np.linalg.svd(flat, full_matrices=False)
    mode = mode[:MODES]
    mode = (mode / np.abs(mode).max(axis=1, keepdims=True)).astype(np.float16)
    amount = np.linalg.lstsq(mode.astype(float).T, flat.T, rcond=None)[0].T
    left = flat - amount @ mode.astype(float)
    print(f"rms left out {np.sqrt((left**2).mean()):.1e} of each knot's own, worst {np.abs(left).max():.1e}")
    arrays = {name: np.stack([one[name] for one in made]) for name in ("stiffness", "shift")}
    arrays |= {"thickness": np.array(THICKNESSES), "depth": np.array(DEPTHS), "share": np.array(SHARES)}
    arrays |= {"amount": amount.reshape(*values.shape[:3], -1).astype(np.float32), "mode": mode}
    write(out / "pulled_sphere.npz", arrays | {"scale": scale.astype(np.float16)})


if __name__ == "__main__":
    run(__doc__ or "", {f"pulled-h{h:g}": partial(solve, thickness=h) for h in THICKNESSES}, tables)
