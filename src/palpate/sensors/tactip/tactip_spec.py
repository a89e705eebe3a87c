"""Every number of the TacTip: a gel-filled hemisphere whose skin carries pins that a camera sees from inside.

Sources: "R", the compliance report (Pagnanelli et al., Model-Based Compliance Discrimination via Soft Tactile
Optical Sensing and Optical Flow Computation: A Biomimetic Approach, IEEE Robotics and Automation Letters);
"W", the TacTip family (Ward-Cherrier et al. 2018, doi:10.1089/soro.2017.0052). What neither tells is marked
assumed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from palpate.core import InputError, RangeError
from palpate.mechanics.axisymmetric.tip_table import TipTable, tip_table


@dataclass(frozen=True, slots=True)
class PinLayout:
    """A hexagonal lattice of pins, rings of it around one on the axis.

    Attributes:
        rings: around the middle pin; n rings are 3 n (n + 1) + 1 pins.
        pitch_m: between neighbours, seen along the axis [m].
        length_m: of the rigid pin, from the skin's inside to the marker on its end [m].
        radius_m: of the marker [m].
    """

    rings: int
    pitch_m: float
    length_m: float
    radius_m: float

    @property
    def count(self) -> int:
        return 3 * self.rings * (self.rings + 1) + 1


PINS_127 = PinLayout(6, 2.6e-3, 2.5e-3, 0.6e-3)
"""W: 127 pins; pitch, length and radius assumed, so that they fill a dome of 40 mm."""

PINS_331 = PinLayout(10, 1.6e-3, 2.5e-3, 0.4e-3)
"""W: 331 pins; the rest assumed."""


@dataclass(frozen=True, slots=True)
class TacTipCamera:
    """A grey camera on the tip's axis, looking at the skin's inside through the gel and a flat window.

    Attributes:
        height_m: of the pinhole above the tip's apex [m]. Assumed.
        gel_index: refractive index of the gel up to the window at the tip's base; 1 for no refraction.
            Assumed: that of silicone.
        size_px: of the square image [px]. R: 300.
        disc_px: radius of the untouched field of pins in the image [px]. Assumed.
        rate_hz: frames a second. R: 20.
        exposure_s: of a frame [s]. Assumed; a trial's frames are of one instant.
        dark, bright: grey levels of ground and pins. Assumed.
        noise: standard deviation of a pixel [grey levels]. Assumed.
        edge_px: width over which a pin's edge fades [px]. Assumed.
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
    """The force sensor under the specimen.

    Attributes:
        rate_hz: samples a second [Hz]. R: 200.
        resolution_n: step of a sample [N]. R: 1/16, an ATI Mini45.
        noise_n: standard deviation before that step [N]. Assumed.
    """

    rate_hz: float = 200.0
    resolution_n: float = 0.0625
    noise_n: float = 0.02


@dataclass(frozen=True, slots=True)
class SeatingSpread:
    """Spread from press to press; standard deviations, all assumed.

    Attributes:
        shift_px: of the whole image, along each axis: how the tip is hooked in.
        tilt_rad: of the specimen's top, along each axis.
        light: of the brightness, as a share.
        position_m: of where the approach is counted from, as the encoder has it [m].
    """

    shift_px: float = 0.7
    tilt_rad: float = 0.005
    light: float = 0.02
    position_m: float = 20e-6


@dataclass(frozen=True, slots=True)
class TacTipSpec:
    """The sensor and its rig.

    Attributes:
        tip: name of the tip's table: its size, skin and gel. Assumed: no table of a real tip's material is
            printed.
        pins, camera, force, seating: see there.
        speed_m_s: of the tip towards the specimen [m/s]. R: 5 mm/s.
        friction: Coulomb's coefficient of skin on an inclined specimen; head-on there is none. Only with 0
            are inclined presses read from tables at finite strain, see `inclined`. Assumed.
        name: goes into each frame.
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
        """The tip on head-on specimens."""
        return tip_table(self.tip)

    @property
    def inner_radius_m(self) -> float:
        """Radius of the skin's inside [m]."""
        return self.table.radius_m - self.table.skin_m


def tactip(pins: int = 127) -> TacTipSpec:
    """The TacTip with 127 or 331 pins."""
    layouts = {127: PINS_127, 331: PINS_331}
    if pins not in layouts:
        raise InputError(f"{pins} pins; there are 127 and 331, or a `PinLayout`", code="pin-count")
    return replace(TacTipSpec(), pins=layouts[pins])


def fitted_tactip() -> TacTipSpec:
    """The TacTip with 331 pins, its lever and camera as fitted to taps of a real one, closest to upright.

    Fitted by `palpate calibrate --method tip-pose` to another laboratory's recordings, a stand-in: a lever of
    0.29 mm (0.26 to 0.33) and a pinhole 34.2 mm above the apex (33.5 to 34.8). The barrel distortion of that
    lens, 0.105 at the edge of the pins, is not in this camera; tip, gel and all else stay assumed.
    """
    return replace(
        tactip(331),
        pins=replace(PINS_331, length_m=0.29e-3),
        camera=TacTipCamera(height_m=34.2e-3),
        name="virtual-tactip-fitted",
    )
