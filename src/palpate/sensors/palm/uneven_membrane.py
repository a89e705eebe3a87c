"""Spatial variation of one membrane's modulus, thickness, and residual birefringence.

Each varies in a few low-order modes drawn by a seed, with a given rms and zero mean. A press uses the modulus
and thickness under its axis, which assumes that both are constant over one or two contact radii.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre

from palpate.core import Float, InputError, RangeError, ndarray

if TYPE_CHECKING:
    from palpate.sensors.palm.palm_spec import PalmSpec

MAX_SHARE = 0.1  # maximum rms of modulus and thickness
MAX_BIREFRINGENCE = 1e-5  # maximum rms of the residual birefringence
SIDE_MODES = tuple((i, j) for i in range(4) for j in range(3) if i + j > 0)

Field = Float[ndarray, "..."]


@dataclass(frozen=True, slots=True)
class UnevenGel:
    """Membrane whose modulus and thickness vary over its disc. Sizes are assumed.

    Attributes:
        modulus, thickness: Rms of the logarithm, 0 to 0.1.
    """

    modulus: float = 0.0
    thickness: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("modulus", "thickness"):
            value = getattr(self, name)
            if not 0 <= value <= MAX_SHARE:
                raise RangeError(
                    f"an uneven gel's {name} of {value}; 0 to {MAX_SHARE:g}, as a share",
                    code="modulus-variation",
                )
        _check_seed(self.seed)


@dataclass(frozen=True, slots=True)
class ResidualMap:
    """Residual birefringence that varies over the side view, in addition to the uniform one. Assumed.

    Attributes:
        birefringence: Rms of each component (along the axes, along the diagonals) of the mean along a ray, 0
            to 1e-5.
        modes: Weights of the first `side_modes` of each component instead of drawn ones.
    """

    birefringence: float = 0.0
    seed: int = 0
    modes: tuple[tuple[float, ...], tuple[float, ...]] | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.birefringence <= MAX_BIREFRINGENCE:
            raise RangeError(
                f"a residual birefringence of {self.birefringence}; 0 to {MAX_BIREFRINGENCE:g}, a difference "
                "of indices",
                code="residual-birefringence",
            )
        for one in self.modes or ():
            if not (len(one) <= len(SIDE_MODES) and all(map(math.isfinite, one))):
                raise InputError(
                    f"weights {one}; give up to {len(SIDE_MODES)} finite numbers of each component"
                )
        _check_seed(self.seed)

    def weights(self, component: int) -> tuple[float, ...]:
        """Weights of the first modes of the axial (0) or diagonal (1) component."""
        if self.modes is None:
            return _weights(self.seed, component, len(SIDE_MODES))
        return self.modes[component]


def _check_seed(seed: int) -> None:
    if not isinstance(seed, int) or seed < 0:
        raise InputError(f"the seed is {seed!r}; give a whole number, 0 or more", code="seed")


def disc_modes(x: Field, y: Field) -> Float[ndarray, "7 ..."]:
    """Return Zernike modes of orders 1 to 3 without trefoils; positions are in disc radii.

    They are orthonormal over the disc. Reference: R. J. Noll, J. Opt. Soc. Am. 66 (1976) 207,
    doi:10.1364/JOSA.66.000207.
    """
    r2 = x**2 + y**2
    return np.stack([
        2 * x, 2 * y, math.sqrt(3) * (2 * r2 - 1), math.sqrt(6) * (x**2 - y**2), math.sqrt(6) * 2 * x * y,
        math.sqrt(8) * (3 * r2 - 2) * x, math.sqrt(8) * (3 * r2 - 2) * y,
    ])  # fmt: skip


def side_modes(across: Field, down: Field) -> Float[ndarray, "11 ..."]:
    """Return products of Legendre polynomials, orthonormal over a square of -1 to 1."""
    return np.stack([_legendre(i, across) * _legendre(j, down) for i, j in SIDE_MODES])


def _legendre(order: int, at: Field) -> Field:
    return np.asarray(math.sqrt(2 * order + 1) * legendre.legval(at, np.eye(order + 1)[order]))


@lru_cache(maxsize=64)
def _weights(seed: int, stream: int, modes: int) -> tuple[float, ...]:
    """Weights whose squares sum to 1."""
    drawn = np.random.default_rng([seed, stream]).standard_normal(modes)
    return tuple((drawn / np.linalg.norm(drawn)).tolist())


def modulus_ratio(spec: PalmSpec, x_m: float, y_m: float) -> float:
    """Return the modulus at a position over the membrane's."""
    return math.exp(spec.gel.modulus * _at(spec, 0, x_m, y_m)) if spec.gel.modulus else 1.0


def modulus_ratios(spec: PalmSpec, x_m: Field, y_m: Field) -> Field:
    """Return the modulus at many positions over the membrane's."""
    modes = disc_modes(x_m / spec.radius_m, y_m / spec.radius_m)
    weights = np.array(_weights(spec.gel.seed, 0, len(modes)))
    return np.asarray(np.exp(spec.gel.modulus * np.tensordot(weights, modes, axes=1)))


def thickness_at(spec: PalmSpec, x_m: float, y_m: float) -> float:
    """Return the thickness at a position [m]."""
    share = spec.gel.thickness
    return spec.thickness_m * math.exp(share * _at(spec, 1, x_m, y_m)) if share else spec.thickness_m


def thickness_range(spec: PalmSpec) -> tuple[float, float]:
    """Return the minimum and maximum thickness [m]."""
    if not spec.gel.thickness:
        return spec.thickness_m, spec.thickness_m
    away, angle = np.linspace(0.0, 1.0, 41), np.linspace(0.0, 2 * np.pi, 120, endpoint=False)
    modes = disc_modes(np.outer(away, np.cos(angle)), np.outer(away, np.sin(angle)))
    field = np.tensordot(np.array(_weights(spec.gel.seed, 1, len(modes))), modes, axes=1)
    thinnest, thickest = spec.thickness_m * np.exp(spec.gel.thickness * np.array([field.min(), field.max()]))
    return float(thinnest), float(thickest)


def _at(spec: PalmSpec, stream: int, x_m: float, y_m: float) -> float:
    R = spec.radius_m
    modes = disc_modes(np.asarray(x_m / R), np.asarray(y_m / R))
    return float(np.dot(_weights(spec.gel.seed, stream, len(modes)), modes))


def pressed_at(spec: PalmSpec, x_m: float, y_m: float) -> PalmSpec:
    """Return the even palm with the modulus and thickness at a position."""
    if spec.gel == EVEN:
        return spec
    return replace(
        spec,
        youngs_modulus_pa=spec.youngs_modulus_pa * modulus_ratio(spec, x_m, y_m),
        thickness_m=thickness_at(spec, x_m, y_m),
        gel=EVEN,
    )


def frozen_at(spec: PalmSpec, impact_m: Field, z_m: Field) -> tuple[Field, Field]:
    """Return the residual birefringence of rays by distance from the membrane's axis and depth [m].

    Returns:
        Axial and diagonal parts: n1 - n2 times cosine and sine of twice the angle of the larger index from x
            to
        z, including the uniform part.
    """
    uniform = (
        spec.frozen_birefringence * math.cos(2 * spec.frozen_axis_rad),
        spec.frozen_birefringence * math.sin(2 * spec.frozen_axis_rad),
    )
    size = spec.residual.birefringence
    across, down = np.broadcast_arrays(impact_m / spec.radius_m, 2 * z_m / spec.thickness_m - 1)
    if not size:
        return np.full(across.shape, uniform[0]), np.full(across.shape, uniform[1])
    modes, weights = (
        side_modes(across, np.clip(down, -1.0, 1.0)),
        [spec.residual.weights(k) for k in range(2)],
    )
    parts = [np.tensordot(one, modes[: len(one)], axes=1) for one in weights]
    return uniform[0] + size * parts[0], uniform[1] + size * parts[1]


EVEN = UnevenGel()
