"""Tables at finite strain of rigid non-axisymmetric probes pressed deep into a bonded layer.

Two planes of symmetry leave a quarter of a square of the layer. Lengths are in its thickness h, stresses in
Young's moduli E. The material is that of `axisymmetric.disc_table`; the base is bonded, top and sides are
free, without friction; edges are rounded by `rounding`. Solved by `tools/probe_tables.py`; mesh errors are in
`tools/probe_study.json`. In the probe's frame x points along its length, y across, z into the layer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

from palpate.core import Float, Int, Pose, Probe, RangeError, ndarray
from palpate.core.array_files import MAX_ARRAY_BYTES
from palpate.core.errors import InputError
from palpate.core.parsing import parser

FOLDER = resources.files("palpate.mechanics") / "tables"
SAME = 1e-6  # relative tolerance for rounding
STRESSES = ("xx", "yy", "zz", "yz", "xz", "xy")  # Voigt's order
FADES = (0.75, 0.95)
"""Range over which the stress fades out, in half sides: the table's rim is not where the membrane's is."""
ODD_ALONG = np.array([0, 0, 0, 0, 1, 1])
"""Whether each stress is odd in x (`ODD_ALONG`) or y (`ODD_ACROSS`)."""
ODD_ACROSS = np.array([0, 0, 0, 1, 0, 1])

Knots = Float[ndarray, " n"]
Plane = Float[ndarray, "ny nx"]


@dataclass(frozen=True)
class PressedLayer:
    """The layer at one depth of a probe; lengths in h, stresses in E.

    Attributes:
        depth, force, area, peak_pressure: Press; the area is seen from above.
        x, y, zeta: Knots of the quarter; zeta is 0 at the deformed top and 1 at the base.
        surface: z of the deformed top, positive where pressed in.
        pressure: Normal pressure on the top, which sums to the force over the area from above.
        stress: Cauchy stress in the order of `STRESSES`.
    """

    depth: float
    force: float
    area: float
    peak_pressure: float
    x: Float[ndarray, " nx"]
    y: Float[ndarray, " ny"]
    zeta: Float[ndarray, " m"]
    surface: Plane
    pressure: Plane
    stress: Float[ndarray, "6 m ny nx"]

    def share_at(self, x: ndarray, y: ndarray) -> ndarray:
        """Fade-out factor: 1 around the probe, 0 at the sides."""
        start, end = FADES
        out = np.clip((np.hypot(x, y) / self.x[-1] - start) / (end - start), 0, 1)
        return np.asarray(1 - out**2 * (3 - 2 * out))

    def on_top(self, values: Plane, x: ndarray, y: ndarray) -> ndarray:
        """Interpolate a field of the top over the whole layer, 0 beyond it."""
        read = RegularGridInterpolator((self.y, self.x), values, bounds_error=False, fill_value=0.0)
        return np.asarray(read(np.stack([np.abs(y), np.abs(x)], axis=-1)))


@dataclass(frozen=True)
class ProbeTable:
    """A probe pressed step by step; lengths in h, stresses in E, forces in E h^2.

    Attributes:
        shape: "cylinder", "edge", or "two-points".
        rounding: Edge radius; 0 for balls.
        depth: Ascending, from the first solved depth.
        surface_amount, surface_mode: Factors of surface and pressure, ``[d k]`` and ``[k 2 ny nx]``.
        stress_amount, stress_mode: Factors of the stress, ``[d l]`` and ``[l 6 m ny nx]``.
    """

    shape: str
    radius: float
    length: float
    rounding: float
    poisson_ratio: float
    half_side: float
    depth: Float[ndarray, " d"]
    force: Float[ndarray, " d"]
    area: Float[ndarray, " d"]
    peak_pressure: Float[ndarray, " d"]
    x: Float[ndarray, " nx"]
    y: Float[ndarray, " ny"]
    zeta: Float[ndarray, " m"]
    surface_amount: Float[ndarray, "d k"]
    surface_mode: Int[ndarray, "k 2 ny nx"]
    stress_amount: Float[ndarray, "d l"]
    stress_mode: Int[ndarray, "l 6 m ny nx"]

    @classmethod
    @parser("probe table", InputError, max_bytes=MAX_ARRAY_BYTES)
    def open(cls, path: Path) -> ProbeTable:
        """Load an .npz file written by `tools/probe_tables.py`."""
        with np.load(path, allow_pickle=False) as file:
            values: dict[str, Any] = {key: file[key] if file[key].ndim else file[key].item() for key in file}
        return cls(**values)

    @property
    def greatest_depth(self) -> float:
        """Maximum depth [h]."""
        return float(self.depth[-1])

    def fits(self, probe: Probe, thickness_m: float) -> bool:
        """Whether an upright probe is the table's in a layer of this thickness."""
        own = (self.radius * thickness_m, self.length * thickness_m)
        return probe.tilt_rad == 0.0 and probe.shape == self.shape and all(
            math.isclose(a, b, rel_tol=SAME, abs_tol=SAME * thickness_m)
            for a, b in zip(own, (probe.radius_m, probe.length_m), strict=True)
        )  # fmt: skip

    def at(self, depth: float) -> PressedLayer:
        """The layer at one depth [h]."""
        least, most = float(self.depth[0]), self.greatest_depth
        if not least * (1 - SAME) <= depth <= most * (1 + SAME):
            raise RangeError(
                f"depth {depth:g} h lies outside {least:g} to {most:g} h, where the table of a {self.shape} "
                "was solved; press to within it"
            )
        depth = min(max(depth, least), most)
        force, area, peak = map(float, self._law(depth))
        top = np.tensordot(self._amounts[0](depth), self.surface_mode, axes=1)
        stress = np.tensordot(self._amounts[1](depth), self.stress_mode, axes=1)
        stress[ODD_ALONG > 0, :, :, 0] = 0.0  # zero on planes of symmetry
        stress[ODD_ACROSS > 0, :, 0, :] = 0.0
        pressure = np.maximum(top[1], 0.0)
        summed = 4.0 * np.trapezoid(np.trapezoid(pressure, self.x, axis=1), self.y)
        knots, pressure = (self.x, self.y, self.zeta), pressure * (force / summed)
        return PressedLayer(depth, force, area, peak, *knots, top[0], pressure, stress)

    def law_at(self, depth: Knots) -> Float[ndarray, "3 n"]:
        """Force [E h^2], area [h^2], and maximum pressure [E] at depths within the table [h]."""
        return np.asarray(self._law(depth).T)

    def force_at(self, depth: Knots) -> Knots:
        return np.asarray(self.law_at(depth)[0])

    @cached_property
    def _law(self) -> PchipInterpolator:
        return PchipInterpolator(self.depth, np.stack([self.force, self.area, self.peak_pressure], axis=1))

    @cached_property
    def _amounts(self) -> tuple[PchipInterpolator, PchipInterpolator]:
        top, inside = (
            PchipInterpolator(self.depth, part) for part in (self.surface_amount, self.stress_amount)
        )
        return top, inside


@lru_cache(maxsize=1)
def probe_tables() -> tuple[ProbeTable, ...]:
    """Return all shipped tables."""
    files = sorted(p.name for p in FOLDER.iterdir() if p.name.startswith("probe-"))
    return tuple(ProbeTable.open(Path(str(FOLDER / name))) for name in files)


def probe_table_for(
    probe: Probe, thickness_m: float, radius_m: float, friction: float, poisson_ratio: float
) -> ProbeTable | None:
    """Return the table of a probe on a membrane of this size and material; None if there is none."""
    if friction != 0.0:
        return None
    for table in probe_tables():
        wide = radius_m >= table.half_side * thickness_m * (1 - SAME)
        if wide and abs(table.poisson_ratio - poisson_ratio) < SAME and table.fits(probe, thickness_m):
            return table
    return None


def own_frame(probe: Probe, pose: Pose, x_m: ndarray, y_m: ndarray) -> tuple[ndarray, ndarray]:
    """Return coordinates along and across a turned probe [m]."""
    c, s = math.cos(probe.turn_rad), math.sin(probe.turn_rad)
    x, y = x_m - pose.x_m, y_m - pose.y_m
    return c * x + s * y, c * y - s * x
