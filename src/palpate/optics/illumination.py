"""Lamp behind the membrane: a strip of LEDs with a diffuser, and the lens's vignetting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Float, Float32, RangeError, ndarray
from palpate.optics.camera_response import uneven_light

Places = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True)
class LedStrip:
    """Equal LEDs in a row along x behind a diffuser; values are assumed.

    Attributes:
        pitch_m, count: Spacing [m] and number of LEDs, centred on x = 0.
        height_m: z of the row [m].
        distance_m: Distance from the diffuser [m].
        evened: Fraction of light the diffuser spreads evenly, 0 to 1.
        slope_per_m: Relative change of light along x [1/m].
    """

    pitch_m: float = 8e-3
    count: int = 9
    height_m: float = 5e-3
    distance_m: float = 12e-3
    evened: float = 0.7
    slope_per_m: float = 0.0

    def __post_init__(self) -> None:
        if not (self.pitch_m > 0 and self.distance_m > 0 and self.count >= 1):
            raise RangeError(
                f"{self.count} LEDs at {self.pitch_m} m, {self.distance_m} m behind the diffuser: give 1 or "
                "more LEDs and positive lengths in m"
            )
        if not 0.0 <= self.evened <= 1.0:
            raise RangeError(f"evened share {self.evened} lies outside 0 to 1")
        if not (np.isfinite(self.height_m) and np.all(self.gain > 0)):
            raise RangeError(
                f"slope {self.slope_per_m} 1/m leaves some LED of the strip without light, or the height "
                f"{self.height_m} m is not a number; give a smaller slope"
            )

    @property
    def places_m(self) -> Places:
        """Positions of the LEDs along x [m]."""
        return (np.arange(self.count) - (self.count - 1) / 2) * self.pitch_m

    @property
    def gain(self) -> Places:
        """Light of each LED; 1 in the middle."""
        return 1 + self.slope_per_m * self.places_m


def strip_light(
    strip: LedStrip, x_m: Float[ndarray, " w"], z_m: Float[ndarray, " h"]
) -> Float[ndarray, "h w"]:
    """Return the light on the diffuser at columns and rows [m], 1 at its maximum; each LED is Lambertian."""
    rho2 = (x_m[:, None] - strip.places_m) ** 2 + (z_m[:, None, None] - strip.height_m) ** 2
    direct = (1 + rho2 / strip.distance_m**2) ** -2 @ strip.gain
    light = (1 - strip.evened) * direct + strip.evened * direct.mean()
    return np.asarray(light / light.max())


def backlight(
    strip: LedStrip, x_m: Float[ndarray, " w"], z_m: Float[ndarray, " h"], corner_loss: float = 0.0
) -> Float32[ndarray, "h w"]:
    """Return the lamp as the camera sees it, with vignetting; see `uneven_light`."""
    lens = uneven_light(len(z_m), len(x_m), corner_loss)
    return (strip_light(strip, x_m, z_m) * lens).astype(np.float32)
