"""Light of a fringe order in each color channel, by lamp, polarizers, and camera.

    S_c(N) = sum_k w_kc sin^2(pi N l0 C(l_k) / (l_k C(l0)))

between crossed polarizers, one minus that between parallel ones. The curves of lamp and camera are assumed.

The brightest colour of every pixel, as most estimators of coloured patterns begin with it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np

from palpate.core import Float, RangeError, Shaped, ndarray
from palpate.optics.colour import Spectrum, assumed_camera
from palpate.optics.stress_optic import StressOpticLaw

VISIBLE_M = (380e-9, 780e-9)
WHITE_REFERENCE_M = 550e-9
FINE_BANDS = 301  # 1 nm: a narrow lamp falls between wider ones
WIDEST_M = 60e-9  # standard deviation; wider than a phosphor's, and no longer one line
_SECOND_RADIATION_MK = 1.438776877e-2  # h c / k_B [m K], CODATA 2018
_FLAT_NM = 1e6


@dataclass(frozen=True, slots=True)
class Polariscope:
    """Lamp, camera, and polarizers.

    Attributes:
        spectrum: Bands and their weight in each channel.
        wavelength_m: l0, at which orders are counted [m].
        dispersion_m2: D of the stress-optic law [m^2].
        bright_field: Whether polarizers are parallel.
        turn: Half the phase of one order in each band, pi l0 C(l) / (l C(l0)) [rad].
    """

    spectrum: Spectrum
    wavelength_m: float
    lamp: str
    dispersion_m2: float = 0.0
    bright_field: bool = False
    turn: Float[ndarray, " k"] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        wavelength = self.spectrum.wavelength_m
        law = StressOpticLaw(1.0, self.dispersion_m2, self.wavelength_m)
        object.__setattr__(self, "turn", self.wavelength_m * law.half_phase(wavelength))

    def light(self, order: Float[ndarray, "*n"]) -> Float[ndarray, "*n c"]:
        """Return the transmitted fraction in each channel at fringe order N."""
        return self.light_and_slope(order)[0]

    def light_and_slope(
        self, order: Float[ndarray, "*n"]
    ) -> tuple[Float[ndarray, "*n c"], Float[ndarray, "*n c"]]:
        """Return the transmitted fraction in each channel and its derivative by N."""
        phase = order[..., None] * self.turn
        light = np.sin(phase) ** 2 @ self.spectrum.weight
        slope = (self.turn * np.sin(2 * phase)) @ self.spectrum.weight
        return (1 - light, -slope) if self.bright_field else (light, slope)

    def grey(self) -> Polariscope:
        """Return the same with one channel, the mean of the three."""
        weight = self.spectrum.weight.mean(axis=1, keepdims=True).repeat(3, axis=1)
        return replace(self, spectrum=replace(self.spectrum, weight=weight))


def one_line(wavelength_m: float, bandwidth_m: float = 0.0) -> Polariscope:
    """Return a polariscope with a line lamp: sodium, a laser, or a lamp behind a narrow filter.

    Args:
        wavelength_m: Wavelength, 380 to 780 nm (400 to 700 nm with a bandwidth) [m].
        bandwidth_m: Standard deviation of the line, 0 to 60 nm [m].

    Example:
        >>> sodium = one_line(589.3e-9)
        >>> sodium.light(np.array([0.5, 1.0])).round(12)[:, 0].tolist()
        [1.0, 0.0]
    """
    low, high = VISIBLE_M if bandwidth_m == 0 else (400e-9, 700e-9)
    if not low <= wavelength_m <= high:
        raise RangeError(
            f"wavelength {wavelength_m * 1e9:g} nm; allowed are {low * 1e9:g} to {high * 1e9:g} nm"
        )
    if not 0.0 <= bandwidth_m <= WIDEST_M:
        raise RangeError(
            f"bandwidth {bandwidth_m * 1e9:g} nm is outside 0 to {WIDEST_M * 1e9:g} nm; use a white lamp"
        )
    name = f"one line, {wavelength_m * 1e9:g} nm"
    if bandwidth_m == 0:
        return Polariscope(Spectrum(np.array([wavelength_m]), np.ones((1, 3))), wavelength_m, name)
    nm, width = wavelength_m * 1e9, bandwidth_m * 1e9
    spectrum = assumed_camera(FINE_BANDS, (nm, nm), (width, width))
    return Polariscope(spectrum, wavelength_m, f"{name} ± {width:g} nm, assumed camera")


def white_led() -> Polariscope:
    """Return a polariscope with an assumed white LED and color camera; orders count at 550 nm."""
    return Polariscope(assumed_camera(), WHITE_REFERENCE_M, "white LED, assumed curves")


def tungsten(temperature_k: float = 2856.0) -> Polariscope:
    """Return a polariscope with a filament lamp of 2000 to 3500 K; orders count at 550 nm."""
    if not 2000.0 <= temperature_k <= 3500.0:
        raise RangeError(f"filament at {temperature_k} K; give 2000 to 3500 K (2856 is usual)")
    flat = assumed_camera(led_peaks_nm=(550.0, 550.0), led_widths_nm=(_FLAT_NM, _FLAT_NM))
    wavelength = flat.wavelength_m
    planck = wavelength**-5 / np.expm1(_SECOND_RADIATION_MK / (wavelength * temperature_k))
    weight = flat.weight * planck[:, None]
    spectrum = Spectrum(wavelength, weight / weight.sum(axis=0))
    return Polariscope(spectrum, WHITE_REFERENCE_M, f"tungsten at {temperature_k:g} K, assumed curves")


def brightest_channel(image: Shaped[ndarray, ...]) -> Shaped[ndarray, "h w"]:
    """Return the greatest channel of every pixel; an image ``[h w]`` is returned as it is."""
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    return np.asarray(reduce(np.maximum, np.moveaxis(image, 2, 0)))
