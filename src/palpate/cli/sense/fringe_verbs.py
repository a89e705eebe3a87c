"""Verbs of fringe orders by pixel: maps from frames, and the colours of orders from a known specimen."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from typer import Argument, Option

from palpate.cli.verb_support import as_json, numbers_of, print_found, progress_bar, say
from palpate.core import InputError

if TYPE_CHECKING:
    import numpy as np

    from palpate.estimators.fringe_map import ColourTable
    from palpate.sensing.frame_sources import FileFrames
    from palpate.sensing.fringe_frames import MappedFrame, OrderReader

LAMPS = ("led", "tungsten")
STEPS = {"six-step": 6, "polarisation-camera": 4}
CHANNELS = ("red", "green", "blue")
SATURATED_CODE = 254
MUCH = 3.0  # misfit over its freedom
Tone = Annotated[str | None, Option(help="srgb, or linear where the numbers are light.")]
White = Annotated[Path | None, Option(help="Unloaded specimen between parallel polarisers, same exposure.")]


def fringe_order(
    frames: Annotated[list[Path], Argument(help="Images, or one folder, run, video or multi-page TIFF.")],
    calibration: Annotated[
        str,
        Option(
            help="Colours: led or tungsten (assumed curves) or a CSV of colour-table. Phases: six-step or "
            "polarisation-camera."
        ),
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
    reference_px: Annotated[
        str | None,
        Option(
            help="X,Y,ORDER of a place in the map, for phases, e.g. 200,140,0.3 [px]. A polarisation "
            "camera's map is half as wide and high as its raw frame."
        ),
    ] = None,
    channel: Annotated[str, Option(help="Of colour frames taken for phases: red, green or blue.")] = "green",
    tone: Tone = None,
    alone: Annotated[bool, Option("--alone", help="Read each frame for itself.")] = False,
) -> None:
    """Map the fringe order of every pixel, with its uncertainty.

    Prints a line a frame, as frames come. Writes nothing without --out.

    Example: palpate optics fringe-order disc.png --calibration beam.csv --out orders --json
    """
    from palpate.core import new_folder, refuse_existing
    from palpate.sensing.fringe_frames import read_orders

    refuse_existing(out)
    if tone not in (None, "srgb", "linear"):
        raise InputError(f"--tone {tone!r} is not srgb or linear")
    inside = None if mask is None else _mask(mask)
    with ExitStack() as stack:
        if calibration in STEPS and (calibration == "six-step" or len(frames) > 1):
            seen = iter([_stepped(frames, calibration, reference_px, inside, channel, tone, max_order)])
            count = 1
        else:
            if calibration in STEPS:
                from palpate.estimators.fringe_map import CameraReader

                reader: OrderReader = CameraReader(
                    _reference(reference_px), mask=inside, tone=_tone(tone, "linear")
                )
            else:
                reader = _colours(calibration, max_order, colour_error, white, noise, inside, plane, tone)
            source = _source(frames, stack)
            seen, count = read_orders(source, reader, follow=not alone), len(source)
        progress = stack.enter_context(progress_bar())
        files = None
        if out is not None:
            from palpate.reports.fringe_figures import OrderFiles

            files = stack.enter_context(OrderFiles(stack.enter_context(new_folder(out))))
        for done, one in enumerate(seen, 1):
            say(json.dumps(one.to_dict(), allow_nan=False) if as_json() else _line(one))
            if files is not None and one.found is not None:
                files.add(one.index, one.name, one.frame.image, one.found)
            progress("frames", done, count)


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
    tone: Tone = None,
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
        ends = cast("tuple[float, float]", _floats(str(orders), 2, "--orders"))
        line = cast("tuple[float, float, float, float]", numbers_of(line_px, 4, "--line-px"))
        known = line_orders(size, line, ends, width_px)
    else:
        if centre_order is None:
            raise InputError("give the order at the disc's centre: --centre-order, 8 C P / (pi D lambda)")
        disc = cast("tuple[float, float, float]", numbers_of(disc_px, 3, "--disc-px"))
        known = disc_orders(size, disc, centre_order)
    known[image.max(axis=2) >= SATURATED_CODE] = float("nan")
    light = linear_light(image, _tone(tone, "srgb"))
    if white is not None:
        light = light / _white(white, size, _tone(tone, "srgb"))
    table = measured_table(light, known, photo.name)
    table.write(out)
    result = {
        "table": str(out),
        "greatest_order": table.greatest_order,
        "light_error": table.error,
        "pixels": int((known == known).sum()),
    }
    text = (
        f"{out}: colours of orders 0 to {table.greatest_order:.2f} from {result['pixels']} pixels, "
        f"light told to {table.error:.2g}"
    )
    print_found(result, text)


def _colours(
    calibration: str,
    max_order: float,
    colour_error: float,
    white: Path | None,
    noise: float | None,
    inside: np.ndarray | None,
    plane: bool,
    tone: str | None,
) -> OrderReader:
    from palpate.estimators.fringe_map import ColourReader

    curve = _tone(tone, "srgb")
    return ColourReader(
        _table(calibration, max_order, colour_error),
        noise=noise,
        white=None if white is None else _white(white, None, curve),
        mask=inside,
        tone=curve,
        isoclinics=plane,
    )


def _table(calibration: str, max_order: float, colour_error: float) -> ColourTable:
    from palpate.estimators.fringe_light import tungsten, white_led
    from palpate.estimators.fringe_map import read_table, table_of

    if calibration in LAMPS:
        return table_of(white_led() if calibration == "led" else tungsten(), max_order, colour_error)
    if not calibration.lower().endswith(".csv"):
        raise InputError(
            f"--calibration {calibration!r} is not led, tungsten, six-step, polarisation-camera or the CSV "
            "of a table"
        )
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


def _stepped(
    paths: list[Path],
    calibration: str,
    reference_px: str | None,
    inside: np.ndarray | None,
    channel: str,
    tone: str | None,
    max_order: float,
) -> MappedFrame:
    import time

    import numpy as np

    from palpate.core import Frame
    from palpate.estimators.fringe_map import CAMERA, SIX_STEPS, order_from_phases
    from palpate.optics.colour import linear_light
    from palpate.recordings import read_image
    from palpate.sensing.fringe_frames import MappedFrame

    if len(paths) != STEPS[calibration]:
        raise InputError(
            f"{len(paths)} frames are given, and --calibration {calibration} takes {STEPS[calibration]}: "
            "circular alike and opposite to the light (six-step alone), then linear at 0, 45, 90 and 135 "
            "degrees"
        )
    if channel not in CHANNELS:
        raise InputError(f"--channel {channel!r} is not red, green or blue")
    images = [read_image(path) for path in paths]
    if len({image.shape for image in images}) > 1:
        raise InputError("the frames are not of one size and kind; take all alike")
    grey = np.stack([i if i.ndim == 2 else i[..., CHANNELS.index(channel)] for i in images])
    started = time.perf_counter()
    found = order_from_phases(
        linear_light(grey, _tone(tone, "srgb")),
        SIX_STEPS if calibration == "six-step" else CAMERA,
        _reference(reference_px),
        greatest_order=max_order,
        mask=inside,
        saturated=np.asarray(grey.max(axis=0) >= SATURATED_CODE),
    )
    took = time.perf_counter() - started
    return MappedFrame(0, Frame(images[0], name=paths[0].name), found, latency_s=took)


def _reference(text: str | None) -> tuple[int, int, float]:
    """Row, column and order."""
    if text is None:
        raise InputError("phases do not tell whole orders: give one place's, --reference-px X,Y,ORDER")
    x, y, order = _floats(text, 3, "--reference-px")
    return round(y), round(x), order


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


def _tone(given: str | None, usual: Literal["srgb", "linear"]) -> Literal["srgb", "linear"]:
    return usual if given is None else cast("Literal['srgb', 'linear']", given)


def _floats(text: str, count: int, what: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise InputError(f"{what} {text!r} is not {count} numbers separated by commas")
    return numbers


def _line(one: MappedFrame) -> str:
    if one.found is None:
        return f"{one.name}: {one.reason}"
    found: dict[str, Any] = one.found.summary()
    text = f"{one.name}: {found['told_share']:.0%} told"
    if found["order_median"] is not None:
        text += (
            f", order {found['order_median']:.3f} (median) to {found['order_greatest']:.3f}, standard "
            f"deviation {found['sigma_median']:.2g}"
        )
    untold = {name: share for name, share in found["untold_shares"].items() if share >= 0.005}
    if untold:
        text += "; untold: " + ", ".join(f"{name} {share:.0%}" for name, share in untold.items())
    if found["misfit_median"] is not None:
        text += f"; misfit {found['misfit_median']:.2g} of noise"
        if found["misfit_median"] > MUCH:
            text += ": colours are not the calibration's, measure a table (colour-table)"
    return f"{text}; {1e3 * one.latency_s:.0f} ms"
