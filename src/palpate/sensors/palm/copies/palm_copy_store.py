"""Palm units on disk, and images of presses from runs and files."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pandas import DataFrame

from palpate.core import Bool, ImageError, InputError, RangeError, UInt8, ndarray, storage_errors
from palpate.core.parsing import parser
from palpate.estimators.unit_fit import Widening, read_unit, write_unit
from palpate.recordings.exchange.image_files import opencv_image
from palpate.recordings.run_reader import Run
from palpate.sensors.palm.copies.palm_copy import (
    LOCAL,
    TERMS,
    PalmCopy,
    PicturedPress,
    designed_copy,
)
from palpate.sensors.palm.palm_sensor import Palm
from palpate.sensors.palm.palm_spec import PalmSpec, preset

FORMAT = "palpate palm copy 3"
MIN_SHARE = 0.1  # minimum force of a press over the run's maximum
MAX_REACH = (
    0.7  # maximum distance from the axis over the radius; images near the rim are not modeled well enough
)

Image = UInt8[ndarray, "h w 3"]


def write_copy(copy: PalmCopy, design: str, path: Path) -> None:
    """Write a unit as JSON."""
    others = {
        "preset": design, "frame_px": list(copy.spec.frame_px), "friction": copy.spec.friction,
        "widening": copy.widening._asdict(),
        "local_spreads": dict(zip(LOCAL[3:], copy.local_spreads, strict=True)),
    }  # fmt: skip
    write_unit(path, FORMAT, TERMS, copy.terms, copy.covariance, others)


@parser("palm unit", InputError)
def read_copy(path: Path) -> PalmCopy:
    """Read a unit written by `write_copy`."""
    return read_unit(path, FORMAT, TERMS, "palpate calibrate --method palm-unit", _made)


def _made(record: dict[str, Any], terms: ndarray, covariance: ndarray) -> PalmCopy:
    width, height = (int(one) for one in record["frame_px"])
    wider = Widening(**record["widening"])
    widening = Widening(float(wider.place), float(wider.depth), float(wider.force), int(wider.presses))
    own = tuple(float(record["local_spreads"][name]) for name in LOCAL[3:])
    spec = design_for(str(record["preset"]), (height, width), float(record["friction"])).spec
    if not all(math.isfinite(one) and one > 0 for one in own):
        raise ValueError(f"spreads of one press, {own}, have to be above 0")
    if not all(math.isfinite(one) and one >= 1 for one in widening[:3]):
        raise ValueError(f"{widening} makes intervals narrower")
    return PalmCopy(spec, terms, covariance, widening, own)


def design_for(name: str, frame_px: tuple[int, int], friction: float = 0.0) -> PalmCopy:
    """Return a preset's design for frames (height, width), full size or as on a virtual rig."""
    spec = preset(name)
    on_rig = Palm(spec).for_rig().spec
    for one in (spec, on_rig):
        if one.frame_px == frame_px[::-1]:
            return designed_copy(_with_friction(one, friction))
    raise ImageError(
        f"frames of {frame_px[1]} x {frame_px[0]} px; the preset {name} has {spec.frame_px[0]} x "
        f"{spec.frame_px[1]} px, on a virtual rig {on_rig.frame_px[0]} x {on_rig.frame_px[1]} px",
        code="frame-size",
    )


def preset_radius_m(name: str) -> float:
    """Return the membrane radius of a preset [m]."""
    return preset(name).radius_m


def preset_ball(name: str) -> str:
    """Return the indenter name of a preset's ball."""
    return Palm(preset(name)).default_probe


def _with_friction(spec: PalmSpec, friction: float) -> PalmSpec:
    if friction not in (0.0, 0.5):
        raise RangeError(f"friction {friction:g}; presses were solved for 0 and for 0.5")
    return replace(spec, friction=friction)


def pictured_presses(
    path: Path, count: int, force_share: float, within_m: float = math.inf, ball: str = ""
) -> list[PicturedPress]:
    """Return frames of a run with evenly ranked forces above a tenth of the maximum, with their references.

    Args:
        path: Run.
        count: Number of frames.
        force_share: Relative standard deviation of the forces.
        within_m: Maximum distance from the membrane's axis [m].
        ball: Indenter to select; any if empty. Frames of lateral loads are excluded.
    """
    run = Run.open(path)
    table = run.labels
    wanted = ("force_N", "press", "reference", "x_mm", "y_mm")
    if missing := [name for name in wanted if name not in table]:
        raise InputError(f"{path} has no label {', '.join(missing)}; a copy needs {', '.join(wanted)}")
    is_rest = table["reference"].astype(bool).to_numpy()
    rests = {press: int(i) for i, press in zip(np.flatnonzero(is_rest), table["press"][is_rest], strict=True)}
    force = table["force_N"].to_numpy(float)
    places = 1e-3 * table[["x_mm", "y_mm"]].to_numpy(float)
    straight = ~is_rest & _is_of(table, ball, path)
    most_n = np.max(force, initial=0.0, where=straight & np.isfinite(force))
    if straight.any() and not most_n > 0:
        raise InputError(f"no force of {path} is above 0 N; compression is positive", code="force-sign")
    able = straight & (force > MIN_SHARE * most_n)
    able &= np.hypot(*places.T) <= within_m
    rows = [int(i) for i in np.flatnonzero(able) if table["press"][i] in rests]
    if not 1 <= count <= len(rows):
        near = f" within {1e3 * within_m:.3g} mm of the middle" if math.isfinite(within_m) else ""
        raise InputError(f"{count} presses of {len(rows)} usable frames{near}", code="press-count")
    rows.sort(key=lambda i: force[i])
    chosen = [rows[round(k)] for k in np.linspace(0, len(rows) - 1, count)]
    return [
        PicturedPress(
            run.frame(i).image, run.frame(rests[table["press"][i]]).image, float(force[i]), force_share,
            (float(places[i, 0]), float(places[i, 1])),
        )
        for i in chosen
    ]  # fmt: skip


def _is_of(table: DataFrame, ball: str, path: Path) -> Bool[ndarray, " n"]:
    """Frames of straight presses by the ball."""
    own = np.ones(len(table), bool)
    if ball and "indenter" in table:
        own = (table["indenter"].astype(str) == ball).to_numpy()
        if not own.any():
            others = ", ".join(sorted(set(table["indenter"].astype(str))))
            raise InputError(f"{path} was pressed by {others}, not by {ball}", code="indenter-differs")
    return own & (table["phase"] != "lateral").to_numpy() if "phase" in table else own


@parser("palm picture", ImageError, max_bytes=1 << 30)
def read_picture(path: Path) -> Image:
    """Read an image file as 8-bit color."""
    with storage_errors(path):
        data = np.frombuffer(path.read_bytes(), np.uint8)
    image = opencv_image(data, cv2.IMREAD_COLOR)
    if image is None:
        raise ImageError(f"{path} is no picture that can be read; give a PNG")
    return np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)
