"""The laws of contact, typed: one command, the scalars of one press by the law it names."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated

from typer import Option

from palpate.cli.verb_support import print_record
from palpate.core import InputError

Answer = dict[str, object]

Radius = Annotated[float, Option("--radius-mm", help="Radius of the sphere or punch [mm].")]
Modulus = Annotated[float, Option("--modulus-kpa", help="Young's modulus of the skin [kPa].")]
Poisson = Annotated[float, Option(help="Poisson's ratio of the skin, 0 to 0.5.")]
Depth = Annotated[float | None, Option(help="Depth past first touch [mm].")]
Force = Annotated[float | None, Option(help="Normal force, instead of a depth [N].")]


def hertz(
    radius_mm: Radius,
    modulus_kpa: Modulus,
    poisson: Poisson = 0.5,
    depth_mm: Depth = None,
    force_n: Force = None,
) -> None:
    """Sphere on a half-space, as a paraboloid: to a/R = 0.5.

    Example: palpate mechanics hertz --radius-mm 5 --modulus-kpa 300 --poisson 0.49 --depth-mm 1
    """
    from palpate.mechanics.half_space import hertz as law

    R, skin = radius_mm / 1e3, (modulus_kpa * 1e3, poisson)
    d = _depth(depth_mm, force_n, lambda F: law.depth_from_force(F, R, *skin))
    a, p0 = law.contact_radius(d, R), law.peak_pressure(d, R, *skin)
    shear, z = law.greatest_shear(poisson)
    print_record(
        _scalars(law.force_from_depth(d, R, *skin), d, a)
        | {
            "peak_pressure_kPa": p0 / 1e3,
            "greatest_shear_kPa": shear * p0 / 1e3,
            "greatest_shear_depth_mm": z * a * 1e3,
            "law": law.MODEL,
        }
    )


def sphere(
    radius_mm: Radius,
    modulus_kpa: Modulus,
    poisson: Poisson = 0.5,
    depth_mm: Depth = None,
    force_n: Force = None,
) -> None:
    """Exact sphere on a half-space (Sneddon): to a/R = 0.99.

    Example: palpate mechanics sphere --radius-mm 5 --modulus-kpa 300 --depth-mm 1
    """
    import numpy as np

    from palpate.mechanics.half_space import sneddon as law

    R, skin = radius_mm / 1e3, (modulus_kpa * 1e3, poisson)
    d = _depth(depth_mm, force_n, lambda F: law.sphere_depth_from_force(F, R, *skin))
    a = law.sphere_radius_from_depth(d, R)
    p0 = float(law.sphere_pressure(np.zeros(1), a, R, *skin)[0])
    print_record(
        _scalars(law.sphere_force_from_radius(a, R, *skin), d, a)
        | {"peak_pressure_kPa": p0 / 1e3, "law": law.MODEL.format(shape="sphere")}
    )


def punch(
    radius_mm: Radius,
    modulus_kpa: Modulus,
    poisson: Poisson = 0.5,
    depth_mm: Depth = None,
    force_n: Force = None,
) -> None:
    """Flat-ended cylinder on a half-space (Sneddon): to d/a = 0.5.

    Example: palpate mechanics punch --radius-mm 2 --modulus-kpa 300 --depth-mm 0.2
    """
    from palpate.mechanics.half_space import sneddon as law

    R, skin = radius_mm / 1e3, (modulus_kpa * 1e3, poisson)
    d = _depth(depth_mm, force_n, lambda F: law.punch_depth(F, R, *skin))
    F = law.punch_force(d, R, *skin)
    print_record(
        _scalars(F, d, R)
        | {"mean_pressure_kPa": F / (math.pi * R**2) / 1e3, "law": law.MODEL.format(shape="flat punch")}
    )


def cone(
    half_angle_deg: Annotated[float, Option(help="Angle from its axis to its side [deg].")],
    modulus_kpa: Modulus,
    poisson: Poisson = 0.5,
    depth_mm: Depth = None,
    force_n: Force = None,
) -> None:
    """Cone on a half-space (Sneddon): small strain, so a blunt one.

    Example: palpate mechanics cone --half-angle-deg 70 --modulus-kpa 300 --depth-mm 1
    """
    from palpate.mechanics.half_space import sneddon as law

    alpha, skin = math.radians(half_angle_deg), (modulus_kpa * 1e3, poisson)
    d = _depth(depth_mm, force_n, lambda F: law.cone_depth(F, alpha, *skin))
    a, F = law.cone_radius(d, alpha), law.cone_force(d, alpha, *skin)
    mean = F / (math.pi * a**2) if a else 0.0
    print_record(_scalars(F, d, a) | {"mean_pressure_kPa": mean / 1e3, "law": law.MODEL.format(shape="cone")})


def layer(
    radius_mm: Radius,
    thickness_mm: Annotated[float, Option(help="Thickness of the layer [mm].")],
    depth_mm: Annotated[float, Option(help="Depth past first touch [mm].")],
    modulus_kpa: Modulus,
    poisson: Poisson = 0.5,
    base: Annotated[str, Option(help="bonded or sliding on its base.")] = "bonded",
) -> None:
    """Sphere on a layer over a rigid base: to d/h = 0.2, and on a half-space.

    Example: palpate mechanics layer --radius-mm 5 --thickness-mm 10 --depth-mm 1 --modulus-kpa 300
    """
    from palpate.mechanics.half_space.sneddon import sphere_force_from_depth
    from palpate.mechanics.layers import bonded_layer as law

    d, R, h, skin = depth_mm / 1e3, radius_mm / 1e3, thickness_mm / 1e3, (modulus_kpa * 1e3, poisson)
    if base not in ("bonded", "sliding"):
        raise InputError(f"base {base!r} is not known; the layer's base is 'bonded' or 'sliding'")
    on: law.Base = "bonded" if base == "bonded" else "sliding"
    print_record(
        {
            "force_N": law.sphere_force(d, R, h, *skin, on),
            "depth_mm": depth_mm,
            "half_space_force_N": sphere_force_from_depth(d, R, *skin),
            "law": f"rigid sphere, {base} layer, small strain, no friction, a/R <= 0.99, d/h <= 0.2",
        }
    )


def _depth(depth_mm: float | None, force_n: float | None, of_force: Callable[[float], float]) -> float:
    if (depth_mm is None) == (force_n is None):
        raise InputError("give either --depth-mm or --force-n, and not both")
    return depth_mm / 1e3 if depth_mm is not None else of_force(force_n or 0.0)


def _scalars(force_n: float, depth_m: float, radius_m: float) -> Answer:
    return {"force_N": force_n, "depth_mm": depth_m * 1e3, "contact_radius_mm": radius_m * 1e3}
