"""A Contact: what one probe at one pose does to a skin."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from numpy import ndarray

from palpate.core.shapes import Field, Float, Mask
from palpate.core.specimen import Specimen


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
