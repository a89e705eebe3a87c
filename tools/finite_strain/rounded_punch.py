"""A rigid upright cylinder of unit radius against the top, its edge rounded: how deep linear layers hold.

    python tools/finite_strain/rounded_punch.py --thickness 2.5 --cells 24

Without friction. The punch is all that lies within its edge's radius of a smaller cylinder, so that the
nearest point of that cylinder tells normal and gap. Prints force, contact radius and greatest pressure over
depth, in radii and moduli, until Newton's method finds no balance.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

sys.path.insert(0, str(Path(__file__).parent.parent))

from finite_strain import press as stepwise
from finite_strain.disc import Disc
from finite_strain.neo_hookean import NeoHookean
from finite_strain.sphere import Top, Touch

EDGE = 0.1  # radius of the rounded edge, as of the palm's punches
STEP = 0.02


def touch(
    x: Float[ndarray, "facets q 2"],
    depth: float,
    friction: float,
    anchor: Top,
    normal: float,
    cautious: bool = False,
) -> Touch:
    """Press the punch to `depth` against points at x; arguments as of `sphere.touch`, friction 0."""
    core = np.stack([np.minimum(x[..., 0], 1.0 - EDGE), np.minimum(x[..., 1], depth - EDGE)], axis=-1)
    away = x - core
    distance = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-12)
    n = away / distance[..., None]
    touching = distance < EDGE
    p = normal * np.where(touching, EDGE - distance, 0.0)
    rounded = (x[..., 0] > 1.0 - EDGE) & (x[..., 1] > depth - EDGE)
    nn = n[..., :, None] * n[..., None, :]
    turning = np.where(rounded, p / distance, 0.0)[..., None, None]
    return Touch(
        traction=p[..., None] * n,
        stiffness=np.where(touching, normal, 0.0)[..., None, None] * nn - turning * (np.eye(2) - nn),
        pressure=p,
        shear=np.zeros_like(p),
        angle=np.arctan2(n[..., 0], n[..., 1]),
        anchor=np.where(touching, 0.0, np.nan),
        touching=touching,
    )


def main() -> int:
    """Press, and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--thickness", type=float, default=2.5, help="of the layer, in the punch's radii")
    parser.add_argument("--cells", type=int, default=24, help="a radius")
    parser.add_argument("--to", type=float, default=1.5, help="depth, in the punch's radii")
    args = parser.parse_args()
    stepwise.touch = touch
    press = stepwise.Press(Disc(args.thickness, 1.0 / args.cells), NeoHookean(0.49), 0.0)
    try:
        for balanced in press.through(np.arange(STEP, args.to + STEP / 2, STEP)):
            radius = press.top(balanced.state)[..., 0][balanced.touch.touching].max()
            print(
                f"depth {balanced.depth:.2f}: force {press.force(balanced):.4f} contact radius {radius:.3f} "
                f"greatest pressure {balanced.touch.pressure.max():.2f}",
                flush=True,
            )
    except stepwise.ConvergenceError as stop:
        print(f"stopped: {stop}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
