"""A rigid upright cylinder of unit radius against the top, its edge rounded, without friction.

The punch is all that lies within its edge's radius of a smaller cylinder, so that the nearest point of that
cylinder tells normal and gap. The skin that it meets flows outwards under the flat end, around the edge and,
from a third of a radius of depth on, up the upright side: cells must be as fine as the edge asks for where
that skin was at rest, far inside.

Springs that let go and take hold within Newton's method throw it off: a guess too high by 1e-4 R lets go of
all the skin under the edge. So which points are held is decided between balances only, by what is then
pulled or sunk in.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from .disc import Disc
from .neo_hookean import deformation, volume_ratio
from .press import (
    MAX_MOVE,
    RESIDUAL,
    SHORTEST_STEP,
    Balanced,
    ConvergenceError,
    Press,
    State,
    _solve,
    extrapolated,
    strained,
)
from .sphere import NORMAL, Top, Touch

EDGE = 0.1  # radius of the rounded edge, as of the palm's punches
DENSE = (0.4, 0.97)  # radii at rest of the skin that comes to lie about the edge
GROWTH = 1.3
WIDTH = 2.85  # radius of the disc over its thickness: that of the palm's membrane
HOLDS = 12  # times that points are let go or taken hold of at one depth
LET_GO = 6  # after so many times none is let go
PULLS = 0.01  # of the greatest pressure, that a point held by its spring may pull
ITERATIONS = 15
STIFF = 20.0  # p^2 / (mu cell): springs so stiff that the top does not wrinkle between them
EVEN = (0.6, 1.3)  # of a volume's ratio at any point; what lies beyond has jumped to a state of folded cells


def core(x: Float[ndarray, "*n 2"], depth: float) -> Float[ndarray, "*n 2"]:
    """Nearest points of the smaller cylinder."""
    return np.stack([np.minimum(x[..., 0], 1.0 - EDGE), np.minimum(x[..., 1], depth - EDGE)], axis=-1)


def touch(
    x: Float[ndarray, "facets q 2"],
    depth: float,
    friction: float,
    anchor: Top,
    normal: float,
    cautious: bool = False,
) -> Touch:
    """Press the punch to `depth` against points at x; arguments as of `sphere.touch`, friction 0.

    Points whose anchor is a number are held by their springs, that they may pull; `touching` says which of
    all points lie inside the punch.
    """
    away = x - core(x, depth)
    distance = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-12)
    n = away / distance[..., None]
    held, touching = ~np.isnan(anchor), distance < EDGE
    p = normal * np.where(held, EDGE - distance, 0.0)
    rounded = (x[..., 0] > 1.0 - EDGE) & (x[..., 1] > depth - EDGE)
    nn = n[..., :, None] * n[..., None, :]
    turning = np.where(rounded, p / distance, 0.0)[..., None, None]
    return Touch(
        traction=p[..., None] * n,
        stiffness=np.where(held, normal, 0.0)[..., None, None] * nn - turning * (np.eye(2) - nn),
        pressure=p,
        angle=np.arctan2(n[..., 0], n[..., 1]),
        anchor=np.where(touching, 0.0, np.nan),
        touching=touching,
    )


def punch_disc(thickness: float, cell: float) -> Disc:
    """A disc as wide as the palm's, whose mesh is fine where skin passes the edge."""
    return Disc(thickness, cell, WIDTH * thickness, DENSE, GROWTH)


@dataclass
class PunchPress(Press):
    """A press of the punch; what is held is changed between balances."""

    def __init__(self, disc: Disc, solid: object) -> None:
        super().__init__(disc, solid, 0.0, touch)  # type: ignore[arg-type]

    def through(self, depths: Iterable[float]) -> Iterator[Balanced]:
        """Balance at each of the ascending depths; arguments and errors as of `Press.through`."""
        past, step = [self.untouched()], np.inf
        for depth in depths:
            while past[-1].depth < depth - 1e-12:
                target = min(depth, past[-1].depth + step)
                try:
                    guess = extrapolated([(b.depth, b.state) for b in past], target)
                    found = self._balance(past[-1], target, guess)
                except ConvergenceError:
                    step = (target - past[-1].depth) / 2
                    if step < SHORTEST_STEP:
                        raise
                    continue
                past, step = [*past[-2:], found], 1.5 * step
            yield past[-1]

    def _stiffness(self, pressure: float) -> float:
        return max(NORMAL, STIFF * pressure**2 / (self.solid.mu * self.disc.cell))

    def _balance(self, last: Balanced, depth: float, state: State) -> Balanced:
        """Newton's method with what the last balance held, until what is held is what touches."""
        normal = self._stiffness(float(last.touch.pressure.max()))
        held: Bool[ndarray, "facets q"] = last.touch.touching
        if not held.any():
            held = self.disc.top_radius < 1.0 - EDGE
        for swap in range(HOLDS):
            state, now = self._newton(state, depth, np.where(held, 0.0, np.nan), normal)
            # one or two points at the rim may change for ever: then they are kept, and hardly pull
            wanted = now.touching if swap < LET_GO else held | now.touching
            if (held == wanted).all() and now.pressure.min() > -PULLS * now.pressure.max():
                return Balanced(depth, state, now)
            held = wanted
        raise ConvergenceError(f"depth {depth:g} R: points are let go and taken hold of without end")

    def _newton(self, state: State, depth: float, anchor: Top, normal: float) -> tuple[State, Touch]:
        free = self.disc.free
        out, K, now = self._assemble(state, depth, anchor, normal)
        for _ in range(ITERATIONS):
            if np.abs(out).max() < RESIDUAL:
                low, high = EVEN
                J = volume_ratio(deformation(strained(self.disc, state)[0]))
                if not (low < J.min() and J.max() < high):
                    raise ConvergenceError(f"depth {depth:g} R: cells are folded, J {J.min():.2f}")
                return state, now
            self.iterations += 1
            move = np.zeros_like(state)
            move[free] = _solve(K, -out)
            length = min(1.0, MAX_MOVE / np.abs(move[: 2 * self.disc.nodes]).max())
            state = state + length * move
            out, K, now = self._assemble(state, depth, anchor, normal)
        raise ConvergenceError(f"depth {depth:g} R: {np.abs(out).max():.1e} left out of balance")

    def energy(self, balanced: Balanced) -> float:
        """Strain energy of the disc [E R^3]."""
        d, solid = self.disc, self.solid
        H, p = strained(d, balanced.state)
        F = deformation(H)
        J = volume_ratio(F)
        shear = solid.mu / 2.0 * ((F**2).sum(axis=(-2, -1)) - 3.0) - solid.mu * np.log(J)
        return float(2.0 * np.pi * (d.weight * (shear + p**2 / (2.0 * solid.lame))).sum())
