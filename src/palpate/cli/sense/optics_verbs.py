"""Verbs of optics: optical flow along frames, and a material's stress-optic coefficient."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from typer import Argument, Option

from palpate.cli.verb_support import numbers_of, print_found, progress_bar
from palpate.core import InputError


def flow(
    frames: Annotated[Path, Argument(help="Multi-page TIFF, video, folder of images or run.")],
    out: Annotated[Path, Option(help="Folder to make; must not exist.")],
    method: Annotated[str, Option(help="horn-schunck, coarse-to-fine, dis or farneback.")] = "horn-schunck",
    from_first: Annotated[bool, Option(help="From the first frame, not the one before.")] = False,
    region: Annotated[
        str | None, Option(help="X,Y,WIDTH,HEIGHT of the divergence [px]; without, the moving region.")
    ] = None,
    fields: Annotated[bool, Option(help="Also keep every flow: fields.npy, 4 bytes a number.")] = False,
) -> None:
    """Compute optical flow and its divergence along a sequence.

    Makes flow.csv and flow.png. Speed and divergence are means over a region. The mean divergence over the
    whole image is only the flux through its border, and is listed as such.

    Example: palpate flow press.tif --out flow
    """
    from palpate.reports.flow_figures import write_flow

    box = cast("tuple[int, int, int, int] | None", numbers_of(region, 4, "--region"))
    with progress_bar() as progress:
        tell = partial(progress, "flow")
        result = write_flow(
            frames, out, method=method, from_first=from_first, fields=fields,
            region_px=box, progress=tell,
        )  # fmt: skip
    print_found(result, _flow_text(result))


def _flow_text(result: Mapping[str, Any]) -> str:
    place, flux = result["region"], f"{result['accumulated_border_flux']:.3g}"
    text = (
        f"{result['out']}: {result['steps']} steps by {result['method']}, mean speed "
        f"{result['mean_speed_px']:.3g} px, "
    )
    if place["kind"] == "image":
        return text + (
            f"border flux of the image {flux}; no divergence of a contact, because the region is the whole "
            "image: give --region X,Y,WIDTH,HEIGHT inside the contact"
        )
    return text + (
        f"accumulated divergence {result['accumulated_divergence']:.3g} in the {place['kind']} region of "
        f"{place['pixels']} px, border flux of the image {flux}"
    )


if TYPE_CHECKING:
    from palpate.calibration.stress_optic_fit import Disc, FringeFit, Strip
    from palpate.estimators.fringe_light import Polariscope


def fit_c(
    folder: Annotated[Path, Argument(help="Folder of photographs, one for each load.")],
    labels: Annotated[Path, Option(help="CSV or Parquet, one row a photograph; here or in the folder.")],
    roi_px: Annotated[str | None, Option(help="X,Y,WIDTH,HEIGHT where the stress is uniform [px].")] = None,
    strip_mm: Annotated[
        str | None, Option(help="WIDTHxTHICKNESS of a strip in tension [mm], e.g. 20x6.")
    ] = None,
    disc_mm: Annotated[
        float | None, Option(help="Diameter of a disc pressed across; the region is its centre [mm].")
    ] = None,
    disc_px: Annotated[
        str | None, Option(help="X,Y,DIAMETER of the disc in the photographs: fits its whole face [px].")
    ] = None,
    polariser_deg: Annotated[
        float | None, Option(help="Of a plane polariscope, from x, for --disc-px; without, circular.")
    ] = None,
    lamp: Annotated[str, Option(help="line, led or tungsten; the white two are assumed curves.")] = "line",
    wavelength_nm: Annotated[float, Option(help="Of the line [nm]; sodium is 589.3.")] = 589.3,
    bandwidth_nm: Annotated[float, Option(help="Standard deviation of the line [nm].")] = 0.0,
    dispersion_nm2: Annotated[float, Option(help="D in C(l) = C (1 + D (1/l^2 - 1/l0^2)) [nm^2].")] = 0.0,
    bright_field: Annotated[
        bool, Option("--bright-field", help="The polarisers are parallel, not crossed.")
    ] = False,
    parallel: Annotated[
        Path | None, Option(help="Photograph of the unloaded specimen between parallel polarisers.")
    ] = None,
    load_column: Annotated[
        str | None, Option(help="Column of the load, e.g. load_N, load_kgf or mass_g.")
    ] = None,
    image_column: Annotated[str, Option(help="Column that names the photograph.")] = "image_file",
    max_order: Annotated[
        float | None, Option(help="Greatest order at the greatest load, if you counted the fringes.")
    ] = None,
    residual_order: Annotated[
        float, Option(help="Order that may be there without load, one standard deviation.")
    ] = 0.05,
    load_error_percent: Annotated[
        float, Option(help="Standard uncertainty of all loads together [%].")
    ] = 1.0,
    breadth_error_mm: Annotated[float, Option(help="Standard uncertainty of width or diameter [mm].")] = 0.05,
    wavelength_error_nm: Annotated[
        float | None, Option(help="Standard uncertainty of the wavelength [nm]; 1, or 10 if white.")
    ] = None,
    tone: Annotated[str, Option(help="srgb, or linear where the numbers are light.")] = "srgb",
    out: Annotated[Path | None, Option(help="PNG of the fit to make; must not exist.")] = None,
) -> None:
    """Fit the stress-optic coefficient C from photographs.

    They are taken under known loads. Writes nothing without --out.

    Example: palpate optics fit-c photos --labels labels.csv --roi-px 200,300,240,120 --strip-mm 20x6
    """
    from palpate.calibration.stress_optic_fit import StatedErrors, fit_stress_optic
    from palpate.core.files import refuse_existing

    refuse_existing(out)
    if tone not in ("srgb", "linear"):
        raise InputError(f"--tone {tone!r} is not srgb or linear")
    light = replace(
        _light(lamp, wavelength_nm, bandwidth_nm),
        dispersion_m2=dispersion_nm2 * 1e-18,
        bright_field=bright_field,
    )
    with progress_bar() as progress:
        fit = fit_stress_optic(
            folder,
            labels,
            _specimen(strip_mm, disc_mm, disc_px, polariser_deg),
            light,
            None if roi_px is None else cast("tuple[int, int, int, int]", numbers_of(roi_px, 4, "--roi-px")),
            image_column=image_column,
            load_column=load_column,
            parallel=parallel,
            tone=cast("Literal['srgb', 'linear']", tone),
            greatest_order=max_order,
            residual_order=residual_order,
            errors=StatedErrors(
                load_error_percent / 100,
                breadth_error_mm * 1e-3,
                None if wavelength_error_nm is None else wavelength_error_nm * 1e-9,
            ),
            progress=progress,
        )
    if out is not None:
        from palpate.reports.fringe_figures import write_figure

        write_figure(fit, out)
    print_found(fit.to_dict(), _text(fit))


def _specimen(
    strip_mm: str | None, disc_mm: float | None, disc_px: str | None, polariser_deg: float | None
) -> Strip | Disc:
    from palpate.calibration.stress_optic_fit import Disc, Strip

    if (strip_mm is None) == (disc_mm is None):
        raise InputError("say what the specimen is: either --strip-mm WIDTHxTHICKNESS or --disc-mm DIAMETER")
    if disc_mm is not None:
        seen = None if disc_px is None else cast("tuple[int, int, int]", numbers_of(disc_px, 3, "--disc-px"))
        turned = None if polariser_deg is None else math.radians(polariser_deg)
        return Disc(disc_mm * 1e-3, seen, turned)
    try:
        width, thickness = (float(part) * 1e-3 for part in str(strip_mm).split("x"))
    except ValueError:
        raise InputError(f"--strip-mm {strip_mm!r} is not WIDTHxTHICKNESS in mm, as in 20x6") from None
    return Strip(width, thickness)


def _light(lamp: str, wavelength_nm: float, bandwidth_nm: float) -> Polariscope:
    from palpate.estimators.fringe_light import one_line, tungsten, white_led

    if lamp == "line":
        return one_line(wavelength_nm * 1e-9, bandwidth_nm * 1e-9)
    if lamp not in ("led", "tungsten"):
        raise InputError(f"--lamp {lamp!r} is not line, led or tungsten")
    return white_led() if lamp == "led" else tungsten()


def _text(fit: FringeFit) -> str:
    from palpate.estimators.fringe_order import RIVAL

    C, half = fit.coefficient_per_pa, (fit.high_per_pa - fit.low_per_pa) / 2
    lines = [
        f"C = {C:.4g} 1/Pa ± {half:.2g} 1/Pa (95 %) at {fit.wavelength_m * 1e9:g} nm",
        "of it " + ", ".join(f"{name} {part:.2g}" for name, part in fit.half_widths.items()),
        f"{fit.orders_per_n:.4g} orders per N; residual order {fit.residual_order:.3f}",
        f"R2 of order against load {fit.r_squared:.3f}; residual brightness {fit.rms:.1%} of its range",
        f"searched to order {fit.settings['greatest_order']:g} at the greatest load",
    ]
    lines += [
        f"also allowed: C = {r.coefficient_per_pa:.3g} 1/Pa, likelihood {r.likelihood:.2g} of the first: "
        f"{r.why}; "
        f"a photograph at {r.deciding_load_n:.4g} N would decide"
        for r in fit.rivals
        if r.likelihood > RIVAL
    ]
    lines += [f"not valid alone: {fit.code}"] if fit.code else []
    lines += [
        f"{name}: {load:.4g} N, order {order:.2f}, seen {seen:.2f} ({low:.2f} to {high:.2f})"
        for name, load, order, seen, low, high in zip(
            fit.images, fit.load_n, fit.order, fit.seen, fit.seen_low, fit.seen_high, strict=True
        )
    ]
    return "\n".join([*lines, *(f"note: {remark}" for remark in fit.remarks)])
