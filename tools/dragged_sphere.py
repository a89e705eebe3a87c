"""A rigid sphere pressed into a bonded disc and dragged under friction, in three dimensions at finite strain.

    python tools/dragged_sphere.py    # solve, and write dragged_sphere.json; half an hour on one core

What the tables of a pulled sphere, which are of first order in the pull, are held against. Mesh, material and
normal contact are those of `off_centre.py`. The sphere is pressed in the middle of its disc without friction,
then moved along x at constant depth. A point of the skin that touches sticks to the sphere by a stiff spring
along its surface, which slips at friction times the pressure. Within a step of the way that limit and the
normals are those of the state before, so that a potential stands behind what is solved; they are then renewed
until they stay. Lengths are in sphere radii, stresses in Young's moduli.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent))

from off_centre import NORMAL, Cells, Field, HalfDisc, OffCentre

OUT = Path(__file__).parent / "dragged_sphere.json"
TANGENT = 1000.0  # E/R
RENEWALS = 12
SETTLED = 2e-4  # of the pressed force: how much a renewal of limits and normals may change the drag
LEAST_STEP = 5e-3  # R of the way
DRAGGED, FINER = Cells(6, 6, 4, 5), Cells(8, 8, 6, 7)
DEPTHS = (0.3, 0.6, 1.0, 1.2)
STEPS = (0.05, 0.1, 0.2, *DEPTHS[:2], 0.8, 0.9, 1.0, 1.1, 1.2)
FRICTIONS = (1.0, 0.3)
SLIDES = 0.4  # share of the touching force that sticks, below which a drag ends
SHIFTS = (0.03, 0.06, 0.12, 0.2, 0.3, 0.45, 0.6)


@dataclass
class Dragged(OffCentre):
    """The disc under a sphere that is dragged.

    Attributes:
        shift: of the sphere along x, now [R].
    """

    friction: float = 0.0
    shift: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = self.top_area.shape
        self._anchor, self._normal = np.zeros((2, *shape, 3))
        self._limit = np.zeros(shape)

    def away(self, u: ndarray, depth: float) -> ndarray:
        return super().away(u, depth) - np.array([self.shift, 0.0, 0.0])

    def touch(self, u: ndarray, depth: float, stress: float = 1.0) -> tuple[ndarray, ndarray]:
        traction, stiff = super().touch(u, depth, stress)
        q, hold = self._friction(self.away(u, depth), stress)
        return traction - q, stiff + hold

    def _friction(self, away: ndarray, stress: float) -> tuple[ndarray, ndarray]:
        """What holds the skin back, and its stiffness; without stress that of sticking, which is more."""
        along, size, slips = self._lag(away)
        flat = np.eye(3) - self._normal[..., :, None] * self._normal[..., None, :]
        turn = along[..., :, None] * along[..., None, :] / np.maximum(size, 1e-12)[..., None, None] ** 2
        most = np.where(slips, self._limit, 0.0)
        k = np.where(slips, most / np.maximum(size, 1e-12), np.where(self._limit > 0.0, TANGENT, 0.0))
        q = k[..., None] * along
        if stress == 0.0:
            return q, np.where(self._limit > 0.0, TANGENT, 0.0)[..., None, None] * flat
        return q, k[..., None, None] * (flat - slips[..., None, None] * turn)

    def _lag(self, away: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        lag = away - self._anchor
        along = lag - self._normal * (lag * self._normal).sum(axis=-1, keepdims=True)
        size = np.linalg.norm(along, axis=-1)
        return along, size, TANGENT * size > self._limit

    def stored(self, u: ndarray, depth: float) -> ndarray:
        away = self.away(u, depth)
        sunk = np.maximum(1.0 - np.linalg.norm(away, axis=-1), 0.0)
        _, size, slips = self._lag(away)
        sticking = np.where(self._limit > 0.0, TANGENT, 0.0) * size**2 / 2
        return NORMAL * sunk**2 / 2 + np.where(
            slips, self._limit * (size - self._limit / TANGENT / 2), sticking
        )

    def drag(self, state: Field, depth: float, shifts: list[float]) -> Iterator[tuple[float, Field]]:
        """The state at each of the ascending shifts, from one pressed without friction."""
        self.shift, self._limit = 0.0, np.zeros_like(self._limit)
        self._renew(self.away(self.displacement(state), depth))
        rate = np.zeros_like(state)
        for target in shifts:
            step = target - self.shift
            while self.shift < target - 1e-9:
                here, kept = self.shift, (self._anchor.copy(), self._normal, self._limit)
                self.shift = min(target, here + step)
                try:
                    guess = state + rate * (self.shift - here) if rate.any() else self._stuck(state, depth)
                    found = self._settled(guess, depth)
                except ArithmeticError:
                    self.shift, (self._anchor, self._normal, self._limit) = here, kept
                    step /= 2
                    if step < LEAST_STEP:
                        raise
                    continue
                rate, state = (found - state) / (self.shift - here), found
                self._slip(state, depth)
            yield target, state

    def _stuck(self, state: Field, depth: float) -> Field:
        """The state if nothing slipped."""
        limit, self._limit = self._limit, np.where(self._limit > 0.0, np.inf, 0.0)
        try:
            return self._balance(state, depth)
        finally:
            self._limit = limit

    def release(self) -> None:
        """Forget friction and shift, for a deeper press without any."""
        self.friction, self.shift = 0.0, 0.0
        self._limit = np.zeros_like(self._limit)

    def _settled(self, state: Field, depth: float) -> Field:
        """Balance with limits and normals that are its own."""
        last = np.inf
        for _ in range(RENEWALS):
            state = self._balance(state, depth)
            u = self.displacement(state)
            self._renew(self.away(u, depth))
            (side, force), _ = self.load(u, depth)
            if abs(side - last) < SETTLED * force:
                return state
            last = side
        return state

    def _renew(self, away: ndarray) -> None:
        distance = np.linalg.norm(away, axis=-1)
        touching = distance < 1.0
        fresh = touching & (self._limit == 0.0)
        self._anchor[fresh] = away[fresh]
        self._normal = away / distance[..., None]
        self._limit = self.friction * NORMAL * np.where(touching, 1.0 - distance, 0.0)

    def _slip(self, state: Field, depth: float) -> None:
        """Take the anchors of slipping points along."""
        away = self.away(self.displacement(state), depth)
        along, size, slips = self._lag(away)
        left = np.where(slips, self._limit / TANGENT / np.maximum(size, 1e-12), 1.0)
        self._anchor = away - left[..., None] * along

    def sticks(self, state: Field, depth: float) -> float:
        """Share of the touching points, by force, that stick."""
        away = self.away(self.displacement(state), depth)
        _, size, _ = self._lag(away)
        slips = TANGENT * size > 0.999 * self._limit  # `_slip` leaves them at their limit
        share = self.top_area * self._limit
        return float((share * ~slips).sum() / share.sum()) if share.any() else 0.0


def drags(
    thickness: float,
    frictions: Sequence[float] = FRICTIONS,
    cells: Cells = DRAGGED,
    depths: Sequence[float] = DEPTHS,
    shifts: Sequence[float] = SHIFTS,
) -> Iterator[dict[str, float]]:
    """One press, and from some of its depths drags under each friction, shift by shift."""
    disc = HalfDisc(thickness, 0.0, cells)
    press = Dragged(disc)
    for depth, u in press.through(STEPS):
        if depth not in depths:
            continue
        pressed = np.zeros(disc.unknowns)
        pressed[disc.unknown[disc.unknown >= 0]] = u[disc.unknown >= 0]
        for friction in frictions:
            press.release()
            press.friction = friction
            yield row(press, pressed, thickness, depth)
            try:
                for _, dragged in press.drag(pressed, depth, shifts):
                    found = row(press, dragged, thickness, depth)
                    yield found
                    if found["sticks"] < SLIDES:
                        break
            except ArithmeticError as stop:
                print(f"stopped: {stop}", flush=True)
        press.release()


def row(press: Dragged, state: Field, thickness: float, depth: float) -> dict[str, float]:
    """What a state says."""
    (side, force), centre = press.load(press.displacement(state), depth)
    return {
        "thickness": thickness,
        "depth": depth,
        "friction": press.friction,
        "unknowns": press.disc.unknowns,
        "shift": press.shift,
        "force": round(float(force), 6),
        "side_force": round(float(side), 6),
        "centre": round(centre - press.shift, 5),
        "sticks": round(press.sticks(state, depth), 4),
    }


def main() -> int:
    """Solve, and write what was found."""
    made: dict[str, list[dict[str, float]]] = {"drags": [], "finer": []}
    jobs = {"drags": drags(2.0), "finer": drags(2.0, (1.0,), FINER, (0.6,), (0.06, 0.2))}
    for name, rows in jobs.items():
        for one in rows:
            print(one, flush=True)
            made[name].append(one)
            OUT.write_text(json.dumps({"lengths": "R", "forces": "E R^2", **made}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
