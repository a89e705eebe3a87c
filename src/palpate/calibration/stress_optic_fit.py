"""Stress-optic coefficient C from photographs of a specimen of known section under known loads.

The line N = k P + N0 is fitted to the light of a region (`fringe_order`); C = k l0 b, with the wavelength l0
at which orders are counted. A strip of width w in tension has b = w; the centre of a disc of diameter D has
s1 - s2 = 8 P / (pi D t), so b = pi D / 8. The thickness cancels in both.

Disc: S. Timoshenko and J. N. Goodier, Theory of Elasticity, 3rd ed. (1970), art. 41.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.load_series import PATCHES, Series, read_series
from palpate.core import Float, InputError, Progress, RangeError, ndarray, sha256_of_all, silent
from palpate.estimators.field_order import fit_field
from palpate.estimators.fringe_light import Polariscope
from palpate.estimators.fringe_order import SCAN_ORDER, OrderFit, fit_orders
from palpate.mechanics.probe_contact import disc_difference
from palpate.optics.colour import Tone
from palpate.version import __version__


@dataclass(frozen=True, slots=True)
class Strip:
    """Strip in tension; the region lies where the stress is uniform, or across the whole width.

    Attributes:
        width_m: across the load and across the light, w [m].
        thickness_m: along the light, t [m]; C does not depend on it.
    """

    width_m: float
    thickness_m: float

    def __post_init__(self) -> None:
        _positive("the strip's width", self.width_m)
        _positive("the strip's thickness", self.thickness_m)

    @property
    def breadth_m(self) -> float:
        """Breadth b that divides P in N = C P / (b l0) [m]."""
        return self.width_m

    def __str__(self) -> str:
        return f"strip {self.width_m * 1e3:g} mm wide, {self.thickness_m * 1e3:g} mm thick"


@dataclass(frozen=True, slots=True)
class Disc:
    """Disc pressed across its diameter between flat plates, the load running down the photograph.

    Attributes:
        diameter_m: D [m].
        seen_px: (x, y, diameter) in the photographs, to fit the whole face [px]; None for a small central
            box.
        polariser_rad: of a plane polariscope, from the photograph's x [rad]; None for a circular one.
    """

    diameter_m: float
    seen_px: tuple[float, float, float] | None = None
    polariser_rad: float | None = None

    def __post_init__(self) -> None:
        _positive("the disc's diameter", self.diameter_m)
        if self.seen_px is not None and not (np.isfinite(self.seen_px).all() and self.seen_px[2] > 0):
            raise RangeError(f"disc seen at {self.seen_px} px; give its centre's x and y and its diameter")

    def seen_stress(self, centre_px: Float[ndarray, "p 2"]) -> tuple[ndarray, ndarray, ndarray]:
        """s1 - s2 over the centre's, visibility, and where both are used; of places in the photograph."""
        seen = self._seen_px
        x, y = ((centre_px - seen[:2]) / (seen[2] / 2)).T
        u, axis = disc_difference(x, y)
        inside = np.isfinite(u) & (np.hypot(x, y) <= FACE) & (u <= STEEP)
        turned = 0.0 if self.polariser_rad is None else self.polariser_rad
        plain = np.ones(len(u)) if self.polariser_rad is None else np.sin(2 * (axis - turned)) ** 2
        return u, plain, inside

    def face_px(self) -> tuple[int, int, int, int]:
        """The square about the disc, as a region [px]."""
        x, y, D = self._seen_px
        return round(x - D / 2), round(y - D / 2), round(D), round(D)

    @property
    def breadth_m(self) -> float:
        """Breadth b that divides P in N = C P / (b l0) [m]."""
        return math.pi * self.diameter_m / 8

    @property
    def _seen_px(self) -> tuple[float, float, float]:
        if self.seen_px is None:
            raise InputError(
                "say where the disc is seen: --disc-px, or seen_px in Python, its centre and diameter [px]"
            )
        return self.seen_px

    def __str__(self) -> str:
        return f"disc {self.diameter_m * 1e3:g} mm across"


FACE = 0.95  # of the radius, up to which a face is used: beyond, its rim and bent rays
STEEP = 2.5  # times the centre's stress, from which fringes near the loads are too narrow for a patch
FIELD_PATCHES = 1600
FACE_ORDER = 6.0  # at the greatest load, where the scan of a whole face ends: its orders do not alias
AMBIGUOUS = "ambiguous_order"


def _positive(name: str, value: float) -> None:
    if not (value > 0.0 and math.isfinite(value)):
        raise RangeError(f"{name} is {value} m; give a positive number of m")


@dataclass(frozen=True, slots=True)
class StatedErrors:
    """Standard uncertainties that all photographs share.

    Attributes:
        load: relative, of all loads together; 0.01 is a shop scale's or a lever's.
        breadth_m: of the strip's width or the disc's diameter [m]; 0.05 mm is a caliper's on a soft edge.
        wavelength_m: of l0 [m]; by default 1 nm for a line, and 10 nm for an assumed white lamp.
    """

    load: float = 0.01
    breadth_m: float = 50e-6
    wavelength_m: float | None = None

    def __post_init__(self) -> None:
        for name, value, unit in (
            ("loads, a share of the load", self.load, ""),
            ("breadth", self.breadth_m, " m"),
            ("wavelength", self.wavelength_m or 0.0, " m"),
        ):
            if not (value >= 0.0 and math.isfinite(value)):
                raise RangeError(f"uncertainty of the {name} is {value}{unit}; give 0 or more")

    def shares(self, specimen: Strip | Disc, polariscope: Polariscope) -> dict[str, float]:
        """Each as a share of C, one standard deviation."""
        size = specimen.width_m if isinstance(specimen, Strip) else specimen.diameter_m
        assumed = ASSUMED_LAMP_M if "white" in polariscope.lamp or "tungsten" in polariscope.lamp else LINE_M
        wavelength = assumed if self.wavelength_m is None else self.wavelength_m
        return {
            "load": self.load,
            "section": self.breadth_m / size,
            "wavelength": wavelength / polariscope.wavelength_m,
        }


LINE_M, ASSUMED_LAMP_M = 1e-9, 10e-9  # a filter's centre as sold; white lamps err by 1 to 4 % of C
NORMAL_95 = 1.959964
SCALE_STEPS = 401
UNLIKE = 0.25  # share of the light that a field leaves over, from which it is remarked
UNEVEN = 0.05  # spread of k between patches from which it is remarked


@dataclass(frozen=True, slots=True)
class CoefficientCandidate:
    """Alternative C [1/Pa] with its likelihood ratio, the load at which the two differ most [N], and what
    makes them alike.
    """

    coefficient_per_pa: float
    likelihood: float
    deciding_load_n: float
    why: str


@dataclass(frozen=True, slots=True)
class FringeFit:
    """Stress-optic coefficient, its sources, and its reliability.

    Attributes:
        coefficient_per_pa, low_per_pa, high_per_pa: C and its 95 % interval [1/Pa].
        half_widths: 95 % half-widths of photographs, load, section, and wavelength, added in squares [1/Pa].
        ambiguous, code: another C fits nearly as well (likelihood above 0.05); code "ambiguous_order".
        rivals: other candidates, likeliest first.
        order: of the fitted line at each load.
        seen, seen_low, seen_high: order that each photograph shows by itself near the line, and 95 %
            interval.
        residual_order: N0, of the line without load.
        r_squared: of `seen` about the line, optimistic since orders are searched near it.
        monotone: `seen` never falls with rising load.
        rms: residual brightness, relative to its range.
        spread: relative standard deviation of C between patches.
        channels: color channels used, 0 red to 2 blue.
        observed: mean light of each photograph and channel over exposure.
        scale_order, scale_light: orders from none to the greatest, and the expected light.
        region_px: x, y, width, height [px].
        sha256: of the photographs, names and bytes.
    """

    coefficient_per_pa: float
    low_per_pa: float
    high_per_pa: float
    half_widths: dict[str, float]
    ambiguous: bool
    code: str
    rivals: tuple[CoefficientCandidate, ...]
    wavelength_m: float
    lamp: str
    specimen: str
    images: tuple[str, ...]
    load_n: tuple[float, ...]
    order: tuple[float, ...]
    seen: tuple[float, ...]
    seen_low: tuple[float, ...]
    seen_high: tuple[float, ...]
    residual_order: float
    r_squared: float
    monotone: bool
    rms: float
    spread: float
    channels: tuple[int, ...]
    observed: Float[ndarray, "n c"]
    scale_order: Float[ndarray, " m"]
    scale_light: Float[ndarray, "m c"]
    region_px: tuple[int, int, int, int]
    settings: dict[str, Any]
    sha256: str
    version: str
    remarks: tuple[str, ...]

    @property
    def orders_per_n(self) -> float:
        """Slope k of the line [1/N]."""
        top = int(np.argmax(self.load_n))
        return (self.order[top] - self.residual_order) / self.load_n[top]

    def to_dict(self) -> dict[str, Any]:
        """All but the colour scale, as JSON can hold it."""
        record = asdict(self) | {"observed": self.observed.tolist()}
        return {name: value for name, value in record.items() if not name.startswith("scale_")}


DEFAULT_ERRORS = StatedErrors()


def fit_stress_optic(
    folder: Path,
    labels: Path,
    specimen: Strip | Disc,
    polariscope: Polariscope,
    region_px: tuple[int, int, int, int] | None,
    *,
    image_column: str = "image_file",
    load_column: str | None = None,
    parallel: Path | None = None,
    tone: Tone = "srgb",
    greatest_order: float | None = None,
    residual_order: float = 0.05,
    errors: StatedErrors = DEFAULT_ERRORS,
    progress: Progress = silent,
) -> FringeFit:
    """Fit C of a specimen to photographs at known loads.

    Args:
        labels: table with one row per photograph, a path or a name in the folder.
        region_px: x, y, width, and height, the same in every photograph [px]; None takes a disc's whole face.
        load_column: label column of the load with its unit; by default load, force, mass, or weight.
        parallel: photograph of the unloaded specimen between parallel polarizers, exposed alike.
        tone: "srgb" undoes the curve of 8-bit color, "linear" takes the numbers as light.
        greatest_order: at the greatest load, if counted; None searches to 24 orders, or 6 on a whole face.
        residual_order: standard deviation of the order without load.
        errors: standard uncertainties of loads, section, and wavelength.

    Raises:
        LabelError, UnitError: the table does not fit, or a load has no number or unit.
        ImageError: a photograph cannot be read; the message names its row.
        InputError: too few photographs or loads, or a region outside a photograph.
        RangeError: the photographs do not determine C.
    """
    face = isinstance(specimen, Disc) and specimen.seen_px is not None
    if region_px is None:
        if not isinstance(specimen, Disc):
            raise InputError("give the region of the photographs where the strip's stress is uniform [px]")
        region_px = specimen.face_px()
    series = read_series(
        folder,
        labels,
        region_px,
        image_column,
        load_column,
        parallel,
        tone,
        progress,
        FIELD_PATCHES if face else PATCHES,
    )
    light = polariscope.grey() if series.grey else polariscope
    greatest = greatest_order or (FACE_ORDER if face else SCAN_ORDER)
    progress("fitting", 0, 1)
    if isinstance(specimen, Disc) and specimen.seen_px is not None:
        orders = _of_face(series, specimen, light, greatest, residual_order)
    else:
        orders = fit_orders(
            series.load_n,
            series.light,
            light,
            clipped=series.clipped,
            open_light=series.open_light,
            greatest_order=greatest,
            residual_order=residual_order,
        )
    progress("fitting", 1, 1)
    settings = {
        "load_column": series.load_column,
        "tone": tone,
        "bright_field": polariscope.bright_field,
        "dispersion_m2": polariscope.dispersion_m2,
        "greatest_order": greatest,
        "residual_order": residual_order,
        "parallel": None if parallel is None else parallel.name,
    }
    scale = np.linspace(0.0, max(orders.order.max(), orders.own_order.max()), SCALE_STEPS)
    return FringeFit(
        **_coefficients(
            orders, polariscope.wavelength_m * specimen.breadth_m, errors.shares(specimen, polariscope)
        ),
        wavelength_m=polariscope.wavelength_m,
        lamp=polariscope.lamp,
        specimen=str(specimen),
        images=series.images,
        load_n=tuple(series.load_n.tolist()),
        order=tuple(orders.order.tolist()),
        seen=tuple(orders.own_order.tolist()),
        seen_low=tuple(orders.own_low.tolist()),
        seen_high=tuple(orders.own_high.tolist()),
        residual_order=orders.residual_order,
        rms=orders.rms,
        spread=orders.spread,
        channels=orders.channels,
        r_squared=_r_squared(orders),
        monotone=_monotone(series.load_n, orders.own_order),
        observed=series.light.mean(axis=1),
        scale_order=scale,
        scale_light=orders.leak + orders.gain * light.light(scale),
        region_px=region_px,
        settings=settings,
        sha256=sha256_of_all(series.paths),
        version=__version__,
        remarks=_remarks(series, orders, polariscope, residual_order),
    )


def _of_face(
    series: Series, disc: Disc, light: Polariscope, greatest_order: float, residual_order: float
) -> OrderFit:
    u, visibility, inside = disc.seen_stress(series.centre_px)
    return fit_field(
        series.load_n,
        series.light[:, inside],
        u[inside],
        light,
        visibility=visibility[inside],
        clipped=series.clipped[:, inside],
        greatest_order=greatest_order,
        residual_order=residual_order,
    )


def _coefficients(orders: OrderFit, per_slope: float, shares: dict[str, float]) -> dict[str, Any]:
    """C with its interval, and its rivals: slopes [1/N] times l0 b [m^2]."""
    C = orders.slope_per_n * per_slope
    halves = {"photographs": orders.half_width_per_n * per_slope}
    halves |= {name: NORMAL_95 * share * C for name, share in shares.items()}
    half = math.hypot(*halves.values())
    return {
        "coefficient_per_pa": C,
        "low_per_pa": C - half,
        "high_per_pa": C + half,
        "half_widths": halves,
        "ambiguous": orders.ambiguous,
        "code": AMBIGUOUS if orders.ambiguous else "",
        "rivals": tuple(
            CoefficientCandidate(r.slope_per_n * per_slope, r.likelihood, r.deciding_load_n, r.why)
            for r in orders.rivals
        ),
    }


def _remarks(
    series: Series, orders: OrderFit, polariscope: Polariscope, residual_order: float
) -> tuple[str, ...]:
    remarks = [*series.remarks]
    if "assumed" in polariscope.lamp:
        remarks.append(
            f"the light ({polariscope.lamp}) was not measured; the interval holds the stated error of its "
            "wavelength, not another lamp"
        )
    if series.load_n.min() > 0:
        remarks.append(f"no photograph without load: N0 is taken as 0 ± {residual_order:g} before the fit")
    if abs(orders.residual_order) > 2 * residual_order:
        remarks.append(f"residual order {orders.residual_order:.2f} is more than was allowed for")
    if orders.rms > UNLIKE and len(series.centre_px) > 10 * PATCHES:
        remarks.append(
            f"{orders.rms:.0%} of the light's standard deviation does not follow the disc's field: check its "
            "place, the lamp and the polarisers"
        )
    if orders.spread > UNEVEN:
        remarks.append(f"C differs by {orders.spread:.0%} between patches: the stress is not uniform there")
    if not _monotone(series.load_n, orders.own_order):
        remarks.append("the orders that single photographs show do not all rise with load")
    if orders.ambiguous:
        rival = orders.rivals[0]
        remarks.append(
            f"ambiguous: another C, {rival.slope_per_n / orders.slope_per_n:.3g} times this one, fits nearly "
            f"as well ({rival.why}); a photograph at {rival.deciding_load_n:.4g} N would decide, or count "
            "the dark fringes to say how many orders the greatest load can turn; the lowest was given"
        )
    return tuple(remarks)


def _r_squared(orders: OrderFit) -> float:
    about_line = np.sum((orders.own_order - orders.order) ** 2)
    return float(1 - about_line / np.sum((orders.own_order - orders.own_order.mean()) ** 2))


def _monotone(load_n: ndarray, order: ndarray) -> bool:
    loads = np.unique(load_n)
    means = [order[load_n == load].mean() for load in loads]
    return bool(np.all(np.diff(means) >= 0))
