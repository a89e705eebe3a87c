"""Presses of a TacTip on a flat rigid plate: two frames with identified pins, and known forces."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.core import RIGID, Float, ImageError, InputError, Int, LabelError, Shaped, ndarray
from palpate.estimators.pins import PinTracks, find_pins
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.press_folder import press_folder
from palpate.recordings.exchange.press_table import read_press_table
from palpate.recordings.manifest import MANIFEST
from palpate.recordings.run_reader import Run

MIN_SHARE = 0.06  # minimum force over the maximum
MIN_NAMED = 0.9  # minimum fraction of pins identified in both frames
AIR_FRAMES = 1  # untouched frames before a press

Places = Float[ndarray, "p 2"]


@dataclass(frozen=True, eq=False)
class PlatePress:
    """A press on a flat rigid plate.

    Attributes:
        rest_px, moved_px: Pins untouched and under load; NaN where one is not seen [px].
        cells: Lattice cells of the pins, in order.
        force_n: Known force [N] or None.
        force_sd_n: Standard deviation of the force [N].
        position_m: Stage position along the tip's axis, rising into the plate [m], or None.
        approach: Number of the approach, whose positions share a zero.
    """

    rest_px: Places
    moved_px: Places
    cells: Int[ndarray, "p 2"]
    force_n: float | None = None
    force_sd_n: float = 0.03
    position_m: float | None = None
    approach: int = 0

    def __post_init__(self) -> None:
        if self.force_n is not None and not (math.isfinite(self.force_n) and self.force_n > 0):
            raise InputError(f"a known force of {self.force_n} N; give one above 0 N", code="not-positive")
        if not (math.isfinite(self.force_sd_n) and self.force_sd_n > 0):
            raise InputError(
                f"a force known to {self.force_sd_n} N; it has to be finite and above 0 N",
                code="not-positive",
            )


def pins_between(
    reference: Shaped[ndarray, ...], image: Shaped[ndarray, ...], pins: int
) -> tuple[Places, Places, Int[ndarray, "p 2"]]:
    """Return pins of an untouched frame, their positions under load, and their cells; each frame is
    identified alone.
    """
    if reference.shape != image.shape:
        raise ImageError(
            f"frames of {reference.shape} and {image.shape} px; give two of one camera", code="image-size"
        )
    named = [_named(frame) for frame in (reference, image)]
    cells = sorted(named[0].keys())
    if not MIN_NAMED * pins <= len(cells) <= pins:
        raise ImageError(
            f"{len(cells)} pins are seen in the untouched frame, and this tip has {pins}: another tip's "
            "frame, or pins that are hidden",
            code="pin-count",
        )
    both = sum(cell in named[1] for cell in cells)
    if both < MIN_NAMED * len(cells):
        raise ImageError(
            f"{both} of {len(cells)} pins are named in both frames, and {MIN_NAMED:.0%} are needed; look at "
            "focus, light and glare"
        )
    rest = np.array([named[0][cell] for cell in cells])
    moved = np.array([named[1].get(cell, (np.nan, np.nan)) for cell in cells])
    return rest, moved, np.array(cells)


def _named(frame: Shaped[ndarray, ...]) -> dict[tuple[int, int], tuple[float, float]]:
    found: PinTracks = find_pins(frame)
    if found.cells is None:
        raise ImageError("the pins stand on no lattice; give frames that show the whole field of pins")
    seen = found.found
    return {
        (int(c), int(r)): (float(x), float(y))
        for (c, r), (x, y) in zip(found.cells[seen], found.xy_px[seen], strict=True)
    }


@dataclass(frozen=True, eq=False)
class _Loaded:
    """A frame under load, its reference, and its labels."""

    reference: ndarray
    image: ndarray
    force_n: float
    position_m: float | None
    approach: int


def known_presses(
    paths: Sequence[Path], count: int, pins: int, *, force_share: float = 0.005, force_sd_n: float = 0.03
) -> list[PlatePress]:
    """Return presses of known force from recordings, with evenly spaced forces and balanced approaches.

    Args:
        paths: Folders of presses with specimens.csv (rigid ones are used), runs of one press whose first
            frame is untouched, or runs with labels `press` and `reference`.
        count: Number of frames under load.
        pins: Number of pins.
        force_share, force_sd_n: Standard deviation of the force, relative and absolute [N].
    """
    loaded = [one for path in paths for one in _loaded(path)]
    approaches = {
        key: i for i, key in enumerate(dict.fromkeys((id(o.reference), o.approach) for o in loaded))
    }
    greatest = max((one.force_n for one in loaded), default=0.0)
    able = [one for one in loaded if one.force_n > MIN_SHARE * greatest]
    if not 1 <= count <= len(able):
        raise InputError(f"{count} presses of {len(able)} with a known force", code="press-count")
    chosen = _spread(able, count)
    found = []
    for one in chosen:
        rest, moved, cells = pins_between(one.reference, one.image, pins)
        sd = math.hypot(force_share * one.force_n, force_sd_n)
        number = approaches[(id(one.reference), one.approach)]
        found.append(PlatePress(rest, moved, cells, one.force_n, sd, one.position_m, number))
    return found


def _spread(able: Sequence[_Loaded], count: int) -> list[_Loaded]:
    """Frames at even forces, preferably of the least used approach."""
    low, high = min(o.force_n for o in able), max(o.force_n for o in able)
    left, used, chosen = list(able), dict.fromkeys((o.approach for o in able), 0), []
    for wanted in np.linspace(low, high, count):
        near = 0.5 * (high - low) / max(count - 1, 1)
        best = min(left, key=lambda o: abs(o.force_n - wanted) + near * used[o.approach])
        left.remove(best)
        used[best.approach] += 1
        chosen.append(best)
    return chosen


def _loaded(path: Path) -> Iterator[_Loaded]:
    if (path / MANIFEST).exists():
        yield from _of_run(Run.open(path))
        return
    rigid = [
        o for o in press_folder(path).specimens if o.stiffness_n_m is None or math.isinf(o.stiffness_n_m)
    ]
    if not any(one.stiffness_n_m is not None for one in rigid):
        raise InputError(
            f"{path} has no presses on a rigid plate; give them, with stiffness_N_per_mm inf in specimens.csv"
        )
    presses = [press for one in rigid if one.stiffness_n_m is not None for press in one.presses]
    for number, (tiff, table) in enumerate(presses):
        yield from _of_press(tiff, table, number)


def _of_press(tiff: Path, table: Path, number: int) -> Iterator[_Loaded]:
    """Frames of the loading of one press."""
    with open_sequence(tiff) as frames:
        told = read_press_table(table, len(frames))
        images = [np.array(image) for image in frames]
    force = told.force_n[told.frame_sample]
    for i in range(AIR_FRAMES, int(np.argmax(force)) + 1):
        position = None if told.position_m is None else float(told.position_m[told.frame_sample[i]])
        yield _Loaded(images[0], images[i], float(force[i]), position, number)


def _of_run(run: Run) -> Iterator[_Loaded]:
    table = run.labels
    if "force_N" not in table:
        raise LabelError("the run has no label force_N; a copy needs presses of known force")
    force = table["force_N"].to_numpy(float)
    place = next((name for name in ("position_mm", "depth_mm") if name in table), None)
    at = None if place is None else 1e-3 * table[place].to_numpy(float)
    if "press" not in table or "reference" not in table:
        rest = run.frame(0).image
        for i in range(AIR_FRAMES, int(np.nanargmax(force)) + 1):
            yield _Loaded(rest, run.frame(i).image, float(force[i]), None if at is None else float(at[i]), 0)
        return
    is_rest = table["reference"].astype(bool).to_numpy()
    rests: dict[str, ndarray] = {}
    for i in np.flatnonzero(is_rest).tolist():
        rests.setdefault(str(table["press"][i]), run.frame(i).image)
    numbers = {press: k for k, press in enumerate(rests)}
    plate = np.ones(len(table), bool) if "indenter" not in table else (table["indenter"] == RIGID).to_numpy()
    for i in np.flatnonzero(~is_rest & plate & np.isfinite(force)).tolist():
        press = str(table["press"][i])
        if press in rests:
            position = None if at is None or not math.isfinite(at[i]) else float(at[i])
            yield _Loaded(rests[press], run.frame(i).image, float(force[i]), position, numbers[press])
