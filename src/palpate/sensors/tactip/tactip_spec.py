"""Specification of the TacTip: a gel-filled hemisphere whose skin carries pins that a camera sees from
inside.

Sources: "R", the compliance report (Pagnanelli et al., Model-Based Compliance Discrimination via Soft Tactile
Optical Sensing and Optical Flow Computation: A Biomimetic Approach, IEEE Robotics and Automation Letters);
"W", the TacTip family (Ward-Cherrier et al. 2018, doi:10.1089/soro.2017.0052). Other values are assumed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from palpate.core import InputError, RangeError
from palpate.mechanics.axisymmetric.tip_table import TipTable, tip_table


@dataclass(frozen=True, slots=True)
class PinLayout:
    """Hexagonal lattice of pins in rings around one on the axis.

    Attributes:
        rings: Number of rings; n rings are 3 n (n + 1) + 1 pins.
        pitch_m: Distance of neighbours, seen along the axis [m].
        length_m: Length from the skin's inside to the marker [m].
        radius_m: Radius of the marker [m].
    """

    rings: int
    pitch_m: float
    length_m: float
    radius_m: float

    @property
    def count(self) -> int:
        return 3 * self.rings * (self.rings + 1) + 1


PINS_127 = PinLayout(6, 2.6e-3, 2.5e-3, 0.6e-3)
"""W: 127 pins; the rest is assumed to fill a dome of 40 mm."""

PINS_331 = PinLayout(10, 1.6e-3, 2.5e-3, 0.4e-3)
"""W: 331 pins; the rest assumed."""


@dataclass(frozen=True, slots=True)
class TacTipCamera:
    """Grey camera on the tip's axis, behind gel and a flat window.

    Attributes:
        height_m: Height of the pinhole above the apex [m].
        gel_index: Refractive index of the gel; 1 for no refraction.
        size_px: Side of the square image. R: 300.
        disc_px: Radius of the untouched pin field.
        rate_hz: Frame rate. R: 20.
        dark, bright: Grey levels of ground and pins.
        noise: Standard deviation of a pixel [grey levels].
        edge_px: Width of a pin's edge.
    """

    height_m: float = 60e-3
    gel_index: float = 1.41
    size_px: int = 300
    disc_px: float = 115.0
    rate_hz: float = 20.0
    exposure_s: float = 5e-3
    dark: float = 18.0
    bright: float = 200.0
    noise: float = 2.0
    edge_px: float = 1.5


@dataclass(frozen=True, slots=True)
class ForceSensorSpec:
    """Force sensor under the specimen.

    Attributes:
        rate_hz: R: 200.
        resolution_n: Step of a sample [N]. R: 1/16, an ATI Mini45.
        noise_n: Standard deviation before quantization [N].
    """

    rate_hz: float = 200.0
    resolution_n: float = 0.0625
    noise_n: float = 0.02


@dataclass(frozen=True, slots=True)
class SeatingSpread:
    """Standard deviations from press to press.

    Attributes:
        shift_px: Image shift along each axis.
        tilt_rad: Tilt of the specimen's top along each axis.
        light: Relative brightness.
        position_m: Zero of the approach [m].
    """

    shift_px: float = 0.7
    tilt_rad: float = 0.005
    light: float = 0.02
    position_m: float = 20e-6


@dataclass(frozen=True, slots=True)
class TacTipSpec:
    """Sensor and rig.

    Attributes:
        tip: Name of the tip's table: size, skin, and gel.
        speed_m_s: Speed towards the specimen [m/s]. R: 5 mm/s.
        friction: Coulomb coefficient on inclined specimens; 0 allows finite-strain tables, see `inclined`.
    """

    tip: str = "base"
    pins: PinLayout = PINS_127
    camera: TacTipCamera = field(default_factory=TacTipCamera)
    force: ForceSensorSpec = field(default_factory=ForceSensorSpec)
    seating: SeatingSpread = field(default_factory=SeatingSpread)
    speed_m_s: float = 5e-3
    friction: float = 0.5
    name: str = "virtual-tactip"

    def __post_init__(self) -> None:
        table, reach = self.table, self.pins.rings * self.pins.pitch_m
        if not (self.pins.rings >= 1 and reach < self.inner_radius_m):
            raise RangeError(
                f"pins out to {1e3 * reach:.3g} mm; the skin's inside has a radius of "
                f"{1e3 * self.inner_radius_m:.3g} mm",
                code="pin-radius",
            )
        if not 0 <= self.pins.length_m < 0.5 * table.radius_m:
            raise RangeError(f"pins of {1e3 * self.pins.length_m:g} mm; 0 to half the tip's radius")
        if not self.camera.height_m > table.radius_m:
            raise RangeError(
                f"the camera is {1e3 * self.camera.height_m:g} mm above the apex; it stands beyond the base, "
                f"more than {1e3 * table.radius_m:g} mm",
                code="camera-position",
            )
        if not (self.speed_m_s > 0 and self.friction >= 0):
            raise RangeError(
                f"speed {self.speed_m_s} m/s, friction {self.friction}; above 0, and 0 or more",
                code="speed-range",
            )

    @property
    def table(self) -> TipTable:
        return tip_table(self.tip)

    @property
    def inner_radius_m(self) -> float:
        """Radius of the skin's inside [m]."""
        return self.table.radius_m - self.table.skin_m


def tactip(pins: int = 127) -> TacTipSpec:
    """Return the TacTip with 127 or 331 pins."""
    layouts = {127: PINS_127, 331: PINS_331}
    if pins not in layouts:
        raise InputError(f"{pins} pins; there are 127 and 331, or a `PinLayout`", code="pin-count")
    return replace(TacTipSpec(), pins=layouts[pins])


def fitted_tactip() -> TacTipSpec:
    """Return the TacTip with 331 pins, and pin length and camera as fitted to another laboratory's taps.

    `palpate calibrate --method tip-pose` gave a lever of 0.29 mm (0.26 to 0.33) and a pinhole 34.2 mm above
    the apex (33.5 to 34.8); the lens's barrel distortion of 0.105 is not modeled.
    """
    return replace(
        tactip(331),
        pins=replace(PINS_331, length_m=0.29e-3),
        camera=TacTipCamera(height_m=34.2e-3),
        name="virtual-tactip-fitted",
    )
