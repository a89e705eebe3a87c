"""A Contact: what one probe at one pose does to a skin.

A Specimen: the body that is pressed, and the words that name one.

The outline of a skin: where a probe may come down on it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy import ndarray

from palpate.core.errors import InputError
from palpate.core.shapes import Field, Float, Mask

RIGID, UNTOLD = "rigid", "?"

SPHERE, LAYER, VISCOUS = "sphere", "layer", "viscous"
MODULUS, RADIUS, THICKNESS = "E_MPa", "R_mm", "h_mm"
NUMBERS: Mapping[str, tuple[str, ...]] = {
    SPHERE: (RADIUS, MODULUS),
    LAYER: (THICKNESS, MODULUS),
    VISCOUS: (MODULUS,),
}
EXAMPLES = {
    SPHERE: "ball=sphere:R_mm=20,E_MPa=0.3 (rigid without E_MPa)",
    LAYER: "sheet=layer:h_mm=2,E_MPa=0.1",
    VISCOUS: "slow=viscous:E_MPa=0.1,E1_MPa=0.05,tau1_s=1",
}
WORDS_OF_SPECIMENS = f"{RIGID}, NAME=STIFFNESS in N/mm as S1=7.6, or {', '.join(EXAMPLES.values())}"
MM, MPA = 1e-3, 1e6
_BRANCH = re.compile(r"(E|tau)([1-9])_(?:MPa|s)")


@dataclass(frozen=True, slots=True)
class Specimen:
    """A body that yields where it is touched; without one, the probe is rigid.

    Attributes:
        name: of the specimen, such as "S1".
        stiffness_n_m: force over deformation under a load spread over its whole top, inf for a rigid body;
            None where only the modulus is known [N/m].
        youngs_modulus_pa: of its material, of a viscous one after a long time, inf for a rigid sphere; None
            where only the stiffness is known [Pa].
        radius_m: radius of curvature of its top, inf for a flat one [m].
        thickness_m: of a layer bonded to a rigid base; None for another body [m].
        branches: of a viscous material's relaxation, (modulus [Pa], time [s]) each, beyond the modulus after
            a long time; empty for an elastic one.
    """

    name: str = ""
    stiffness_n_m: float | None = math.inf
    youngs_modulus_pa: float | None = None
    radius_m: float = math.inf
    thickness_m: float | None = None
    branches: tuple[tuple[float, float], ...] = ()

    @property
    def shape(self) -> str:
        """Kind of body in one word: rigid, cylinder, sphere or layer."""
        if math.isfinite(self.radius_m):
            return SPHERE
        if self.thickness_m is not None:
            return LAYER
        return RIGID if self.stiffness_n_m == math.inf and self.youngs_modulus_pa is None else "cylinder"

    @classmethod
    def parse(cls, words: str) -> Specimen:
        """A specimen from "rigid", NAME=STIFFNESS in N/mm, as in "S1=7.6", or NAME=KIND:NUMBERS.

        Kinds are a sphere of radius ``R_mm``, rigid without ``E_MPa``; a layer of thickness ``h_mm`` bonded
        to a rigid base; and a viscous cylinder. ``E_MPa`` is Young's modulus. ``E1_MPa`` and ``tau1_s``, and
        so on to 9, make any of them viscous: E(t) = E + sum E_i exp(-t / tau_i).

        A question mark at the end asks that whoever records it does not tell it on, as of a specimen
        that a calibration shall be tried on; it changes nothing here.
        """
        name, equals, value = words.removesuffix(UNTOLD).partition("=")
        kind, colon, numbers = value.partition(":")
        if name and colon:
            return _shaped(cls, words, name, kind, numbers)
        try:
            stiffness_n_m = 1e3 * float(value) if equals else math.inf
        except ValueError:
            stiffness_n_m = math.nan
        if not (name and stiffness_n_m > 0 and (equals or name == RIGID)):
            raise InputError(f"{words!r} is no specimen; give {WORDS_OF_SPECIMENS}", code="specimen-syntax")
        return cls(name, stiffness_n_m)


def _shaped(cls: type[Specimen], words: str, name: str, kind: str, numbers: str) -> Specimen:
    """A specimen of a kind."""
    if kind not in NUMBERS:
        raise InputError(
            f"{words!r}: there is no specimen {kind!r}; give {WORDS_OF_SPECIMENS}", code="specimen-kind"
        )
    given = _numbers(words, kind, numbers)
    needed = NUMBERS[kind][:1] if kind == SPHERE else NUMBERS[kind]
    missing = [key for key in needed if key not in given]
    if missing:
        raise InputError(
            f"{words!r}: a {kind} needs {' and '.join(missing)}, as in {EXAMPLES[kind]}",
            code="missing-parameter",
        )
    branches = _branches(words, given)
    if kind == VISCOUS and not branches:
        raise InputError(
            f"{words!r}: a viscous specimen needs E1_MPa and tau1_s, as in {EXAMPLES[VISCOUS]}",
            code="viscous-needs-term",
        )
    modulus = given.get(MODULUS, math.inf)
    if branches and not math.isfinite(modulus):
        raise InputError(
            f"{words!r}: a rigid sphere does not relax; give its E_MPa after a long time",
            code="rigid-relaxes",
        )
    return cls(
        name,
        None,
        MPA * modulus,
        MM * given[RADIUS] if kind == SPHERE else math.inf,
        MM * given[THICKNESS] if kind == LAYER else None,
        branches,
    )


def _numbers(words: str, kind: str, numbers: str) -> dict[str, float]:
    """Numbers of words such as "R_mm=20,E_MPa=0.3"."""
    allowed = NUMBERS[kind]
    given: dict[str, float] = {}
    for part in numbers.split(","):
        key, equals, text = part.partition("=")
        if key not in allowed and not _BRANCH.fullmatch(key):
            raise InputError(
                f"{words!r}: a {kind} has no {key!r}; it has {', '.join(allowed)}, and E1_MPa with tau1_s "
                "where it is viscous",
                code="unknown-parameter",
            )
        if key in given:
            raise InputError(f"{words!r} gives {key} twice", code="repeated-parameter")
        try:
            given[key] = float(text) if equals else math.nan
        except ValueError:
            given[key] = math.nan
        if not (given[key] > 0 and math.isfinite(given[key])):
            raise InputError(
                f"{words!r}: {key} of {text or 'nothing'}; give a finite number above 0 in that unit",
                code="number-range",
            )
    return given


def _branches(words: str, given: Mapping[str, float]) -> tuple[tuple[float, float], ...]:
    """Pairs of modulus [Pa] and time [s]."""
    found = {match for key in given if (match := _BRANCH.fullmatch(key))}
    moduli = {one[2]: MPA * given[one[0]] for one in found if one[1] == "E"}
    times = {one[2]: given[one[0]] for one in found if one[1] == "tau"}
    alone = sorted(moduli.keys() ^ times.keys())
    if alone:
        raise InputError(
            f"{words!r}: E{alone[0]}_MPa and tau{alone[0]}_s come together; give both",
            code="relaxation-terms",
        )
    return tuple((moduli[i], times[i]) for i in sorted(moduli))


@dataclass(frozen=True, slots=True)
class Probe:
    """The body that touches the skin.

    Attributes:
        shape: ``"sphere"``, ``"punch"`` (an upright cylinder), ``"edge"`` (a wedge), ``"cylinder"`` (lying),
            ``"two-points"`` (two spheres), ``"points"`` (any number of spheres), ``"plate"`` (a flat face
            wider than any contact, which touches a curved skin).
        radius_m: of the sphere, the lying cylinder or each of several points; of a punch's flat end [m]. An
            edge and a plate have none: 0.
        length_m: of an edge or lying cylinder; between two points [m].
        turn_rad: of that length, and of the way the probe leans, from x towards y [rad].
        tilt_rad: by which it leans: the side that ``turn_rad`` points to is the lower one [rad].
        places_m: of several points' lowest places beside the probe's axis, and how much higher each is than
            the lowest of them: (x, y, height) [m].
    """

    shape: str
    radius_m: float
    length_m: float = 0.0
    turn_rad: float = 0.0
    tilt_rad: float = 0.0
    places_m: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Pose:
    """Place and depth of the probe, in the sensor's frame of reference.

    Attributes:
        x_m, y_m: position over the skin [m]; the origin is the skin's centre.
        depth_m: approach past first touch, positive into the skin; negative for a probe that hangs over it,
            by so much [m]. 0 is a skin at rest with no probe in sight.
    """

    x_m: float
    y_m: float
    depth_m: float


@dataclass(frozen=True, slots=True)
class EarlierPress:
    """A press that is over.

    Attributes:
        pose: its deepest.
        ago_s: since the probe left [s].
    """

    pose: Pose
    ago_s: float


@dataclass(frozen=True, slots=True)
class PressHistory:
    """Path and earlier presses by which a press came to its pose.

    Attributes:
        path_m: where the probe has been since first touch, beside where it touched first, (x, y) in order,
            the last one now; empty for a press straight down [m].
        lateral_n: force along x and y that this path has built up, where whoever presses knows it; None
            leaves it to the sensor's own law [N].
        stiffening: normal force over that of the relaxed skin at this depth: above 1 while a viscoelastic
            skin still remembers.
        earlier: presses of the same skin before, the oldest first.
    """

    path_m: tuple[tuple[float, float], ...] = ()
    lateral_n: tuple[float, float] | None = None
    stiffening: float = 1.0
    earlier: tuple[EarlierPress, ...] = ()


FRESH = PressHistory()
"""Straight down on a skin that was never touched before."""


class ContactSolution(StrEnum):
    """How a contact was solved; `Contact.model` describes it."""

    LINEAR = "linear"  # linear elastic layers or a half space
    DISC_TABLE = "disc-table"  # finite strain, axisymmetric, tabulated
    PULLED_TABLE = "pulled-table"  # the same under a lateral load, to first order in it
    PROBE_TABLE = "probe-table"  # finite strain of a probe without an axis, tabulated


@dataclass(frozen=True, slots=True)
class Contact:
    """Traction, displacement and contact region on a grid of the skin's surface, SI.

    The sensor's frame is right-handed: x to the right, y towards the viewer of an edge-on picture, z into
    the skin.

    Attributes:
        x_m: grid columns ``[nx]`` [m].
        y_m: grid rows ``[ny]`` [m].
        pressure_pa: normal traction ``[ny nx]``, positive in compression [Pa].
        displacement_m: surface displacement along z ``[ny nx]`` [m].
        touching: where probe and skin touch ``[ny nx]``.
        force_n: normal force, positive in compression [N].
        radius_m: radius of the contact region [m].
        probe, pose: what made it.
        model: the law that gave it, and what that law assumes.
        shear_pa: traction of the probe on the skin along x and y ``[2 ny nx]`` [Pa]; None without any.
        lateral_n: force of the probe on the skin along x and y [N].
        moment_nm: of that shear about z through the probe's axis, from x towards y [N m].
        solution: how it was solved.
        specimen, history: what made it besides probe and pose; None for a rigid probe.
    """

    x_m: Float[ndarray, " nx"]
    y_m: Float[ndarray, " ny"]
    pressure_pa: Field
    displacement_m: Field
    touching: Mask
    force_n: float
    radius_m: float
    probe: Probe
    pose: Pose
    model: str
    shear_pa: Float[ndarray, "2 ny nx"] | None = None
    lateral_n: tuple[float, float] = (0.0, 0.0)
    moment_nm: float = 0.0
    specimen: Specimen | None = None
    history: PressHistory = FRESH
    solution: ContactSolution = ContactSolution.LINEAR


ROUNDING_M = 1e-12
ONCE = 1.5  # turns of all corners together: a convex polygon's are one, a star's at least two

Series = Float[ndarray, " n"]
Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Outline:
    """A disc about the skin's centre, or a convex polygon; made by `disc`, `rectangle` and `polygon`.

    Attributes:
        radius_m: of the disc, or of the circle around the polygon's corners, about the skin's centre [m].
        corners_m: of the polygon, (x, y) in order, clockwise as the camera sees it; empty for a disc [m].
    """

    radius_m: float
    corners_m: Corners = ()

    @classmethod
    def disc(cls, diameter_m: float) -> Outline:
        """A disc of a diameter [m]."""
        if not (math.isfinite(diameter_m) and diameter_m > 0):
            raise InputError(f"a disc of {diameter_m} m; give a diameter above 0 m")
        return cls(diameter_m / 2)

    @classmethod
    def rectangle(cls, width_m: float, height_m: float) -> Outline:
        """A rectangle along x and y about the centre [m]."""
        x, y = width_m / 2, height_m / 2
        return cls.polygon(((-x, -y), (x, -y), (x, y), (-x, y)))

    @classmethod
    def polygon(cls, corners_m: Corners) -> Outline:
        """A convex polygon around the skin's centre; corners in order, once around, from +x towards +y."""
        corners = tuple((float(x), float(y)) for x, y in corners_m)
        at = np.array(corners).reshape(-1, 2)
        sides = np.roll(at, -1, axis=0) - at
        after = np.roll(sides, -1, axis=0)
        turns = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
        if len(at) < 3 or not (np.isfinite(at).all() and (turns > 0).all()):
            raise InputError(
                f"a polygon of corners {corners} m; give three or more of a convex one, in order from +x "
                "towards +y"
            )
        around = np.arctan2(turns, (sides * after).sum(axis=1)).sum() / math.tau
        if around > ONCE:
            raise InputError(
                f"a polygon of corners {corners} m: its sides cross, as they go {round(around)} times "
                "around; give each corner once, in the order of one way around",
                code="polygon-crosses",
            )
        made = cls(float(np.hypot(*at.T).max()), corners)
        if made.clearance_m(0.0, 0.0) <= 0:
            raise InputError(
                f"a polygon of corners {corners} m leaves out the skin's centre, (0, 0); give corners "
                "counted from the centre, all around it",
                code="polygon-center",
            )
        return made

    def contains(self, x_m: float, y_m: float, probe_radius_m: float = 0.0) -> bool:
        """True where a round probe lies wholly inside."""
        return probe_radius_m - self.clearance_m(x_m, y_m) <= ROUNDING_M

    def clearance_m(self, x_m: float, y_m: float) -> float:
        """Distance from a point inside to the rim; negative outside [m]."""
        return -float(self._signed(np.array([x_m]), np.array([y_m]))[0])

    def beyond_m(self, x_m: Series, y_m: Series) -> Series:
        """Distance outside, 0 inside [m]; past a polygon's corner a little less than that."""
        return np.clip(self._signed(x_m, y_m), 0.0, None)

    def _signed(self, x_m: Series, y_m: Series) -> Series:
        """Distance to the outline, negative inside."""
        if not self.corners_m:
            return np.asarray(np.hypot(x_m, y_m) - self.radius_m)
        at = np.array(self.corners_m)
        sides = np.roll(at, -1, axis=0) - at
        out = np.stack([sides[:, 1], -sides[:, 0]], axis=1) / np.hypot(*sides.T)[:, None]
        away = np.stack([x_m, y_m], axis=-1)[:, None, :] - at
        return np.asarray((away * out).sum(axis=-1).max(axis=1))
