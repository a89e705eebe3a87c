"""Verbs of optics: optical flow along frames, and a material's stress-optic coefficient.

Verbs of fringe orders by pixel: maps from frames, and the colours of orders from a known specimen.
"""

from __future__ import annotations

import json
import math
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

from typer import Argument, Option

from palpate.cli.verb_support import as_json, floats_of, in_line, numbers_of, print_record, progress_bar, say
from palpate.core import InputError

if TYPE_CHECKING:
    import numpy as np

    from palpate.calibration.stress_optic_fit import Disc, Strip
    from palpate.estimators.fringe_light import Polariscope
    from palpate.estimators.fringe_map import ColourTable
    from palpate.sensing.frame_sources import FileFrames


def flow(
    frames: Annotated[Path, Argument(help="Multi-page TIFF, video, folder of images or run.")],
    out: Annotated[Path, Option(help="Folder to make; must not exist.")],
    method: Annotated[str, Option(help="horn-schunck or dis.")] = "horn-schunck",
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
    from palpate.reports.field_figures import write_flow

    box = cast("tuple[int, int, int, int] | None", numbers_of(region, 4, "--region"))
    with progress_bar() as progress:
        tell = partial(progress, "flow")
        result = write_flow(
            frames, out, method=method, from_first=from_first, fields=fields,
            region_px=box, progress=tell,
        )  # fmt: skip
    if result["region"]["kind"] == "image":
        result["note"] = "no divergence of a contact: give --region X,Y,WIDTH,HEIGHT inside it"
    print_record(result)


Tone = Annotated[str, Option(help="srgb, or linear where the numbers are light.")]


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
    tone: Tone = "srgb",
    out: Annotated[Path | None, Option(help="PNG of the fit to make; must not exist.")] = None,
) -> None:
    """Fit the stress-optic coefficient C from photographs.

    They are taken under known loads. Writes nothing without --out.

    Example: palpate optics fit-c photos --labels labels.csv --roi-px 200,300,240,120 --strip-mm 20x6
    """
    from palpate.calibration.stress_optic_fit import StatedErrors, fit_stress_optic
    from palpate.core.files import refuse_existing

    refuse_existing(out)
    curve = _tone(tone)
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
            tone=curve,
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
        from palpate.reports.field_figures import write_figure

        write_figure(fit, out)
    print_record(fit.to_dict())


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
    width, thickness = floats_of(str(strip_mm), "--strip-mm WIDTHxTHICKNESS", "20x6", "x")
    return Strip(width * 1e-3, thickness * 1e-3)


def _light(lamp: str, wavelength_nm: float, bandwidth_nm: float) -> Polariscope:
    from palpate.estimators.fringe_light import one_line, tungsten, white_led

    if lamp == "line":
        return one_line(wavelength_nm * 1e-9, bandwidth_nm * 1e-9)
    if lamp not in ("led", "tungsten"):
        raise InputError(f"--lamp {lamp!r} is not line, led or tungsten")
    return white_led() if lamp == "led" else tungsten()


LAMPS = ("led", "tungsten")
SATURATED_CODE = 254
White = Annotated[Path | None, Option(help="Unloaded specimen between parallel polarisers, same exposure.")]


def fringe_order(
    frames: Annotated[list[Path], Argument(help="Images, or one folder, run, video or multi-page TIFF.")],
    calibration: Annotated[
        str,
        Option(help="Colours of the orders: led or tungsten (assumed curves) or a CSV of colour-table."),
    ] = "led",
    out: Annotated[Path | None, Option(help="Folder of maps to make; must not exist.")] = None,
    white: White = None,
    noise: Annotated[
        float | None, Option(help="Standard deviation of linear light, of 1; measured if not given.")
    ] = None,
    colour_error: Annotated[
        float, Option(help="Standard deviation of an assumed lamp's colours, of light 1.")
    ] = 0.02,
    max_order: Annotated[float, Option(help="Greatest order looked for.")] = 4.0,
    mask: Annotated[Path | None, Option(help="Image that is black where no specimen is.")] = None,
    plane: Annotated[
        bool, Option("--plane", help="Plane polariscope: light also falls with the axis; slower.")
    ] = False,
    tone: Tone = "srgb",
    alone: Annotated[bool, Option("--alone", help="Read each frame for itself.")] = False,
) -> None:
    """Map the fringe order of every pixel, with its uncertainty.

    Prints a line a frame, as frames come. Writes nothing without --out.

    Example: palpate optics fringe-order disc.png --calibration beam.csv --out orders --json
    """
    from palpate.core import new_folder, refuse_existing
    from palpate.estimators.fringe_map import ColourReader
    from palpate.sensing.frame_readers import read_orders

    refuse_existing(out)
    curve = _tone(tone)
    with ExitStack() as stack:
        reader = ColourReader(
            _table(calibration, max_order, colour_error),
            noise=noise,
            white=None if white is None else _white(white, None, curve),
            mask=None if mask is None else _mask(mask),
            tone=curve,
            isoclinics=plane,
        )
        source = _source(frames, stack)
        progress = stack.enter_context(progress_bar())
        files = None
        if out is not None:
            from palpate.reports.field_figures import OrderFiles

            files = stack.enter_context(OrderFiles(stack.enter_context(new_folder(out))))
        for done, one in enumerate(read_orders(source, reader, follow=not alone), 1):
            say(json.dumps(one.to_dict(), allow_nan=False) if as_json() else in_line(one.to_dict()))
            if files is not None and one.found is not None:
                files.add(one.index, one.name, one.frame.image, one.found)
            progress("frames", done, len(source))


def colour_table(
    photo: Annotated[Path, Argument(help="Colour image of a specimen whose orders are known.")],
    out: Annotated[Path, Option(help="CSV of the table to make; must not exist.")],
    line_px: Annotated[
        str | None, Option(help="X,Y,X,Y of a line across a beam in bending, e.g. 300,80,300,400 [px].")
    ] = None,
    orders: Annotated[
        str | None, Option(help="Orders at its two ends, of two signs across the neutral line: -3,3.")
    ] = None,
    width_px: Annotated[float, Option(help="Width of the strip along the line [px].")] = 40.0,
    disc_px: Annotated[str | None, Option(help="X,Y,DIAMETER of a disc pressed from above [px].")] = None,
    centre_order: Annotated[float | None, Option(help="Order at the disc's centre.")] = None,
    white: White = None,
    tone: Tone = "srgb",
) -> None:
    """Measure the colour of every fringe order on a known specimen.

    A beam in pure bending has its orders even across it, a disc by the closed form of its stress.

    Example: palpate optics colour-table beam.png --line-px 300,80,300,400 --orders=-3,3 --out beam.csv
    """
    from palpate.core import refuse_existing
    from palpate.estimators.fringe_map import disc_orders, line_orders, measured_table
    from palpate.optics.colour import linear_light
    from palpate.recordings import read_image

    refuse_existing(out)
    image = read_image(photo)
    if image.ndim != 3:
        raise InputError(f"{photo} is grey; colours of orders are measured with a colour camera")
    if (line_px is None) == (disc_px is None) or (orders is None) != (line_px is None):
        raise InputError(
            "say what the specimen is: --line-px with --orders, or --disc-px with --centre-order"
        )
    size = image.shape[:2]
    if line_px is not None:
        ends = cast("tuple[float, float]", floats_of(str(orders), "--orders", "-3,3"))
        line = cast("tuple[float, float, float, float]", numbers_of(line_px, 4, "--line-px"))
        known = line_orders(size, line, ends, width_px)
    else:
        if centre_order is None:
            raise InputError("give the order at the disc's centre: --centre-order, 8 C P / (pi D lambda)")
        disc = cast("tuple[float, float, float]", numbers_of(disc_px, 3, "--disc-px"))
        known = disc_orders(size, disc, centre_order)
    known[image.max(axis=2) >= SATURATED_CODE] = float("nan")
    curve = _tone(tone)
    light = linear_light(image, curve)
    if white is not None:
        light = light / _white(white, size, curve)
    table = measured_table(light, known, photo.name)
    table.write(out)
    result = {
        "table": str(out),
        "greatest_order": table.greatest_order,
        "light_error": table.error,
        "pixels": int((known == known).sum()),
    }
    print_record(result)


def _table(calibration: str, max_order: float, colour_error: float) -> ColourTable:
    from palpate.estimators.fringe_light import tungsten, white_led
    from palpate.estimators.fringe_map import read_table, table_of

    if calibration in LAMPS:
        return table_of(white_led() if calibration == "led" else tungsten(), max_order, colour_error)
    if not calibration.lower().endswith(".csv"):
        raise InputError(f"--calibration {calibration!r} is not led, tungsten or the CSV of a table")
    return read_table(calibration)


def _white(path: Path, size: tuple[int, ...] | None, tone: Literal["srgb", "linear"]) -> np.ndarray:
    from palpate.estimators.fringe_map import flat_field
    from palpate.optics.colour import linear_light
    from palpate.recordings import read_image

    image = read_image(path)
    if image.ndim != 3 or (size is not None and image.shape[:2] != size):
        raise InputError(f"{path} is grey or not of the photograph's size; take it with the same camera")
    if (image >= SATURATED_CODE).mean() > 0.1:
        raise InputError(f"{path} is saturated; expose it and the frames less")
    return flat_field(linear_light(image, tone))


def _source(paths: list[Path], stack: ExitStack) -> FileFrames:
    from palpate.core import ImageError
    from palpate.sensing.frame_sources import image_files, open_source

    if len(paths) == 1:
        return stack.enter_context(open_source(paths[0]))
    missing = [str(path) for path in paths if not path.is_file()]
    if missing:
        raise ImageError(f"{', '.join(missing)} is not there; give images, or one folder, run or video")
    return image_files(paths)


def _mask(path: Path) -> np.ndarray:
    import numpy as np

    from palpate.recordings import read_image

    image = read_image(path)
    return np.asarray((image if image.ndim == 2 else image.max(axis=2)) > 127)


def _tone(given: str) -> Literal["srgb", "linear"]:
    if given not in ("srgb", "linear"):
        raise InputError(f"--tone {given!r} is not srgb or linear")
    return cast("Literal['srgb', 'linear']", given)
