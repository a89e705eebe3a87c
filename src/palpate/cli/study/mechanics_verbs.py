"""The laws of contact, typed: one command, the scalars of one press by the law it names."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated

from typer import Option

from palpate.cli.verb_support import floats_of, print_record
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
    from palpate.mechanics.half_space.subsurface import greatest_shear

    R, skin = radius_mm / 1e3, (modulus_kpa * 1e3, poisson)
    d = _depth(depth_mm, force_n, lambda F: law.depth_from_force(F, R, *skin))
    a, p0 = law.contact_radius(d, R), law.peak_pressure(d, R, *skin)
    shear, z = greatest_shear(poisson)
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
    """Sphere on a layer over a rigid base: to d/h = 0.2.

    Beside the exact force stand Dimitriadis's series and a half-space.

    Example: palpate mechanics layer --radius-mm 5 --thickness-mm 10 --depth-mm 1 --modulus-kpa 300
    """
    from palpate.core.errors import RangeError
    from palpate.mechanics.half_space.sneddon import sphere_force_from_depth
    from palpate.mechanics.layers import bonded_layer as law

    d, R, h, skin = depth_mm / 1e3, radius_mm / 1e3, thickness_mm / 1e3, (modulus_kpa * 1e3, poisson)
    if base not in ("bonded", "sliding"):
        raise InputError(f"base {base!r} is not known; the layer's base is 'bonded' or 'sliding'")
    on: law.Base = "bonded" if base == "bonded" else "sliding"
    exact = law.sphere_force(d, R, h, *skin, on)
    answer: Answer = {"force_N": exact, "depth_mm": depth_mm, "sqrt_Rd_over_h_ratio": math.sqrt(R * d) / h}
    try:
        answer["dimitriadis_force_N"] = law.dimitriadis_force(d, R, h, *skin, on)
    except RangeError as e:
        answer |= {"dimitriadis_force_N": None, "dimitriadis_refused": str(e)}
    print_record(
        answer
        | {
            "half_space_force_N": sphere_force_from_depth(d, R, *skin),
            "law": f"rigid sphere, {base} layer, small strain, no friction, a/R <= 0.99, d/h <= 0.2",
        }
    )


def jkr(
    radius_mm: Radius,
    modulus_kpa: Modulus,
    adhesion_j_per_m2: Annotated[float, Option(help="Work of adhesion [J/m^2].")],
    poisson: Poisson = 0.5,
    depth_mm: Depth = None,
    force_n: Force = None,
    range_nm: Annotated[float, Option(help="Range of the surface forces, for Tabor's parameter [nm].")] = 0.3,
) -> None:
    """Sphere that sticks to a half-space (Johnson, Kendall, Roberts).

    Says whether that law applies.

    Example: palpate mechanics jkr --radius-mm 5 --modulus-kpa 300 --adhesion-j-per-m2 0.05 --force-n 0.01
    """
    from palpate.mechanics.half_space.adhesion import JKR_ABOVE, AdhesiveSphere

    one_of(depth_mm, force_n)
    ball = AdhesiveSphere(adhesion_j_per_m2, radius_mm / 1e3, modulus_kpa * 1e3, poisson)
    F = force_n or 0.0 if depth_mm is None else ball.force_from_depth(depth_mm / 1e3)
    a = ball.radius_from_force(F) if depth_mm is None else ball.radius_from_depth(depth_mm / 1e3)
    tabor = ball.tabor_parameter(range_nm * 1e-9)
    print_record(
        _scalars(F, ball.depth_from_radius(a), a)
        | {
            "pull_off_force_N": ball.pull_off_force_n,
            "pull_off_depth_mm": ball.pull_off_depth_m * 1e3,
            "tabor_ratio": tabor,
            "applies": tabor > JKR_ABOVE,
            "law": "JKR: rigid sphere, elastic half-space, small strain, a/R <= 0.5",
        }
    )


def ting(
    radius_mm: Radius,
    depth_mm: Annotated[float, Option(help="Greatest depth past first touch [mm].")],
    equilibrium_kpa: Annotated[float, Option(help="Modulus after a long time [kPa].")],
    branch: Annotated[list[str], Option(help="MODULUS_KPA:TIME_S of a branch; give one or more.")],
    rise_s: Annotated[float, Option(help="Time to the greatest depth [s].")],
    fall_s: Annotated[float, Option(help="Time back [s].")],
    hold_s: Annotated[float, Option(help="Time at the greatest depth [s].")] = 0.0,
    poisson: Poisson = 0.5,
    samples: Annotated[int, Option(help="Samples of the press, 10 to 100000.")] = 401,
) -> None:
    """Sphere pressed into a viscoelastic half-space and back (Ting).

    Both at constant speed.

    Example: palpate mechanics ting --radius-mm 5 --depth-mm 1 --equilibrium-kpa 200 --branch 100:0.5
    --rise-s 1 --fall-s 1
    """
    import numpy as np

    from palpate.mechanics.viscoelastic import Prony, ting as law

    for name, value in (("--rise-s", rise_s), ("--fall-s", fall_s)):
        if not (value > 0 and math.isfinite(value)):
            raise InputError(f"{name} is {value} s; give a positive time")
    if not (hold_s >= 0 and math.isfinite(hold_s)):
        raise InputError(f"--hold-s is {hold_s} s; give 0 s or more")
    if not 10 <= samples <= 100_000:
        raise InputError(f"--samples is {samples}; give 10 to 100000")
    pairs = [branch_of(text) for text in branch]
    skin = Prony(equilibrium_kpa * 1e3, tuple(E for E, _ in pairs), tuple(tau for _, tau in pairs))
    turns = np.array([0.0, rise_s, rise_s + hold_s, rise_s + hold_s + fall_s])
    t = np.unique(np.append(np.linspace(0, turns[-1], samples), turns))
    d = np.interp(t, turns, depth_mm / 1e3 * np.array([0.0, 1.0, 1.0, 0.0]))
    done = law(t, d, radius_mm / 1e3, skin, poisson)
    lost = int(np.flatnonzero(done.radius_m)[-1]) + 1 if done.radius_m.any() else 0
    print_record(
        {
            "greatest_force_N": float(done.force_n.max()),
            "force_before_return_N": float(np.interp(turns[2], t, done.force_n)),
            "contact_lost_at_s": float(t[min(lost, len(t) - 1)]),
            "contact_lost_at_depth_mm": float(d[min(lost, len(t) - 1)] * 1e3),
            "loss_mJ": done.loss_j * 1e3,
            "law": "Ting: rigid sphere, viscoelastic half-space, small strain, no friction, a/R <= 0.5",
        }
    )


def branch_of(text: str) -> tuple[float, float]:
    """Modulus [Pa] and relaxation time [s] from ``KPA:SECONDS``."""
    modulus, time = floats_of(text, "branch MODULUS_KPA:TIME_S", "100:0.5", ":")
    return modulus * 1e3, time


def one_of(depth_mm: float | None, force_n: float | None) -> None:
    """Refuse neither, and both."""
    if (depth_mm is None) == (force_n is None):
        raise InputError("give either --depth-mm or --force-n, and not both")


def _depth(depth_mm: float | None, force_n: float | None, of_force: Callable[[float], float]) -> float:
    one_of(depth_mm, force_n)
    return depth_mm / 1e3 if depth_mm is not None else of_force(force_n or 0.0)


def _scalars(force_n: float, depth_m: float, radius_m: float) -> Answer:
    return {"force_N": force_n, "depth_mm": depth_m * 1e3, "contact_radius_mm": radius_m * 1e3}
