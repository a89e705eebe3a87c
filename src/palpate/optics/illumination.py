"""The lamp behind the skin: a strip of LEDs and a diffuser, and what the lens loses towards the corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Float, Float32, RangeError, ndarray
from palpate.optics.camera_response import uneven_light

Places = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True)
class LedStrip:
    """Equal LEDs in a row along x behind a diffuser. All numbers are assumed; none belongs to a product.

    Attributes:
        pitch_m: from LED to LED [m].
        count: of LEDs; the row's middle is at x = 0.
        height_m: z of the row [m].
        distance_m: from the LEDs to the diffuser [m].
        evened: share of the light that the diffuser spreads evenly, 0 to 1.
        slope_per_m: relative change of the LEDs' light along x, as from a voltage drop [1/m].
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
        """Places of the LEDs along x [m]."""
        return (np.arange(self.count) - (self.count - 1) / 2) * self.pitch_m

    @property
    def gain(self) -> Places:
        """Each LED's light; 1 in the strip's middle."""
        return 1 + self.slope_per_m * self.places_m


def strip_light(
    strip: LedStrip, x_m: Float[ndarray, " w"], z_m: Float[ndarray, " h"]
) -> Float[ndarray, "h w"]:
    """Light on the diffuser, 1 at its brightest in view.

    Each LED radiates by Lambert's law onto the parallel diffuser: (1 + rho^2 / d^2)^-2 at rho beside it.

    Args:
        strip: the lamp.
        x_m, z_m: columns and rows on the diffuser [m].
    """
    rho2 = (x_m[:, None] - strip.places_m) ** 2 + (z_m[:, None, None] - strip.height_m) ** 2
    direct = (1 + rho2 / strip.distance_m**2) ** -2 @ strip.gain
    light = (1 - strip.evened) * direct + strip.evened * direct.mean()
    return np.asarray(light / light.max())


def backlight(
    strip: LedStrip, x_m: Float[ndarray, " w"], z_m: Float[ndarray, " h"], corner_loss: float = 0.0
) -> Float32[ndarray, "h w"]:
    """The lamp as the camera sees it: the strip's light times the lens's loss towards the corners.

    Args:
        strip: the lamp.
        x_m, z_m: columns and rows on the diffuser [m].
        corner_loss: see `uneven_light`.
    """
    lens = uneven_light(len(z_m), len(x_m), corner_loss)
    return (strip_light(strip, x_m, z_m) * lens).astype(np.float32)
