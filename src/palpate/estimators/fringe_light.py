"""Light of a fringe order in each colour channel, by lamp, polarisers and camera.

    S_c(N) = sum_k w_kc sin^2(pi N l0 C(l_k) / (l_k C(l0)))

between crossed polarisers, one minus that between parallel ones. The lamp's and the camera's curves are
assumed, not measured; one wavelength needs none.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from palpate.core import Float, RangeError, ndarray
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
    """Lamp, camera and polarisers.

    Attributes:
        spectrum: bands, and what each channel makes of them; one band is one wavelength.
        wavelength_m: l0, at which orders are counted [m].
        lamp: in words.
        dispersion_m2: D of the stress-optic law [m^2]; 0 is none.
        bright_field: the polarisers are parallel, so that no load is bright.
        turn: half the phase that one order is in each band, pi l0 C(l) / (l C(l0)) [rad].
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
        """Transmitted fraction in each channel at fringe order N."""
        return self.light_and_slope(order)[0]

    def light_and_slope(
        self, order: Float[ndarray, "*n"]
    ) -> tuple[Float[ndarray, "*n c"], Float[ndarray, "*n c"]]:
        """Transmitted fraction in each channel, and its derivative by N."""
        phase = order[..., None] * self.turn
        light = np.sin(phase) ** 2 @ self.spectrum.weight
        slope = (self.turn * np.sin(2 * phase)) @ self.spectrum.weight
        return (1 - light, -slope) if self.bright_field else (light, slope)

    def grey(self) -> Polariscope:
        """The same with one channel, the mean of the three."""
        weight = self.spectrum.weight.mean(axis=1, keepdims=True).repeat(3, axis=1)
        return replace(self, spectrum=replace(self.spectrum, weight=weight))


def one_line(wavelength_m: float, bandwidth_m: float = 0.0) -> Polariscope:
    """A lamp of one line: sodium, a laser, or a lamp behind a narrow filter.

    Args:
        wavelength_m: of the line, 380 to 780 nm [m]; 400 to 700 nm if it has a width.
        bandwidth_m: its standard deviation, 0 to 60 nm [m]. With a width, the assumed camera's channels see
            it shifted a little against each other, and high orders fade.

    Raises:
        RangeError: not visible, or too wide to be one line.

    Example:
        >>> sodium = one_line(589.3e-9)
        >>> sodium.light(np.array([0.5, 1.0])).round(12)[:, 0].tolist()
        [1.0, 0.0]
    """
    low, high = VISIBLE_M if bandwidth_m == 0 else (400e-9, 700e-9)
    if not low <= wavelength_m <= high:
        raise RangeError(
            f"wavelength {wavelength_m * 1e9:g} nm is outside {low * 1e9:g} to {high * 1e9:g} nm; sodium is "
            "589.3 nm"
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
    """A phosphor white LED and a colour camera, both assumed; orders are counted at 550 nm."""
    return Polariscope(assumed_camera(), WHITE_REFERENCE_M, "white LED, assumed curves")


def tungsten(temperature_k: float = 2856.0) -> Polariscope:
    """An incandescent lamp and a colour camera, both assumed; orders are counted at 550 nm.

    Args:
        temperature_k: of the filament, 2000 to 3500 [K]; 2856 K is CIE illuminant A.

    Raises:
        RangeError: no filament glows so.
    """
    if not 2000.0 <= temperature_k <= 3500.0:
        raise RangeError(f"filament at {temperature_k} K; give 2000 to 3500 K (2856 is usual)")
    flat = assumed_camera(led_peaks_nm=(550.0, 550.0), led_widths_nm=(_FLAT_NM, _FLAT_NM))
    wavelength = flat.wavelength_m
    planck = wavelength**-5 / np.expm1(_SECOND_RADIATION_MK / (wavelength * temperature_k))
    weight = flat.weight * planck[:, None]
    spectrum = Spectrum(wavelength, weight / weight.sum(axis=0))
    return Polariscope(spectrum, WHITE_REFERENCE_M, f"tungsten at {temperature_k:g} K, assumed curves")
