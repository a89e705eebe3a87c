"""Verbs of a camera's lens: calibrate it from photographs of a board, show it, rectify an image by it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

from typer import Argument, Option

from palpate.cli.verb_support import numbers_of, print_record, progress_bar
from palpate.core import ImageError, Lens

if TYPE_CHECKING:
    import numpy as np

    from palpate.calibration.lens import Board

BoardSize = Annotated[str, Option("--board", help="COLUMNSxROWS of inner corners, one less than squares.")]
SquareMm = Annotated[float, Option(help="Side of a square [mm].")]
Charuco = Annotated[str | None, Option(help="Marker dictionary of a ChArUco board, e.g. 4X4_50.")]


def calibrate(
    folder: Annotated[Path, Argument(help="Folder of photographs of the board, all of one camera.")],
    board: BoardSize,
    out: Annotated[Path, Option(help="Lens file to make, with a PNG beside it; must not exist.")],
    square_mm: SquareMm = 25.0,
    model: Annotated[str, Option(help="fisheye, pinhole, or auto: by views held out.")] = "auto",
    charuco: Charuco = None,
    name: Annotated[str, Option(help="What the lens shall be called.")] = "",
) -> None:
    """Calibrate a lens from photographs of a board.

    Views and corners that do not fit are left out, and told with the reason. The picture shows where the
    boards were.

    Example: palpate lens calibrate photos --board 9x6 --square-mm 25 --out lens.json
    """
    from palpate.calibration.lens import calibrate_lens
    from palpate.core.files import new_file, refuse_existing
    from palpate.reports.field_figures import write_lens_figure

    picture = out.with_suffix(".png")
    for path in (out, picture):
        refuse_existing(path)
    chosen = cast("Literal['auto', 'fisheye', 'pinhole']", model)
    with progress_bar() as progress:
        fit = calibrate_lens(folder, _board(board, square_mm, charuco), chosen, name=name, progress=progress)
    write_lens_figure(fit, picture)
    with new_file(out) as building:
        building.write_text(json.dumps(fit.card(), indent=1) + "\n", encoding="utf-8")
    print_record(fit.card() | {"lens": str(out), "picture": str(picture)})


def board(
    size: BoardSize,
    out: Annotated[Path, Option(help="PNG to make, for print; must not exist.")],
    charuco: Charuco = None,
    square_px: Annotated[int, Option(help="Side of a square in the picture [px].", min=8, max=400)] = 120,
) -> None:
    """Draw a board for print.

    Measure a square on the paper afterwards: printers scale.

    Example: palpate lens board --board 8x5 --charuco 4X4_50 --out board.png
    """
    picture = _board(size, 25.0, charuco).picture(square_px)
    _write_png(out, picture)
    height, width = picture.shape
    print_record({"board": str(out), "size_px": [height, width]})


def show(lens: Annotated[Path, Argument(help="Lens file.")]) -> None:
    """Say a lens's numbers, its field and its id.

    Example: palpate lens show lens.json
    """
    found = Lens.read(lens)
    field = math.degrees(found.field_rad)
    print_record(found.card() | {"field_deg": field})


def undistort(
    image: Annotated[Path, Argument(help="Image of the lens's camera, uncut and unscaled.")],
    lens: Annotated[Path, Option(help="Lens file.")],
    out: Annotated[Path, Option(help="PNG to make; must not exist.")],
    focal_px: Annotated[
        float | None, Option(help="Focal length of the rectified image [px]; smaller shows more of the rim.")
    ] = None,
) -> None:
    """Take the bending of a lens out of an image.

    Black is what the lens did not see, or where it was not calibrated.

    Example: palpate lens undistort frame.png --lens lens.json --out flat.png
    """
    from palpate.recordings import read_image
    from palpate.recordings.preparation import rectified

    found = Lens.read(lens)
    flat = found.flat(None if focal_px is None else (focal_px, focal_px))
    try:
        picture = rectified(read_image(image), found, flat)
    except ImageError as error:
        raise ImageError(f"{image}: {error}") from error
    _write_png(out, picture)
    print_record({"image": str(out), "lens": found.id, "onto": flat.card()})


def _write_png(path: Path, image: np.ndarray) -> None:
    from palpate.core import new_file
    from palpate.recordings.exchange import image_files

    with new_file(path) as building:
        building.write_bytes(image_files.encode(image).tobytes())


def _board(size: str, square_mm: float, charuco: str | None) -> Board:
    from palpate.calibration.lens import Board

    columns, rows = cast("tuple[int, int]", numbers_of(size, 2, "--board"))
    return Board(columns, rows, square_mm * 1e-3, charuco)
