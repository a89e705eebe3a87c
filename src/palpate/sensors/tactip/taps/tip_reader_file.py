"""A tip's reader on disk, and images read by it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from palpate.core import ImageError, InputError, Progress, silent, storage_errors
from palpate.core.parsing import parser
from palpate.estimators.lattice.pin_lattice import PinLayoutKind, name_pins
from palpate.sensors.tactip.posed_tip import POSE, PosedTip, TipTerms
from palpate.sensors.tactip.taps.tap_pins import NamedPins, placed, read_image, spots
from palpate.sensors.tactip.taps.tip_reader import TipReader
from palpate.sensors.tactip.taps.twin_error import PoseScale, TwinError

FORMAT = "palpate tip reader 1"
FILE = "reader.json"


def reader_record(reader: TipReader, layout: NamedPins) -> dict[str, Any]:
    """Return a reader and its pin layout as plain values."""
    error = reader.error
    return {
        "format": FORMAT, "size": list(layout.size), "kind": layout.kind,
        "cells": [list(c) for c in layout.cells],
        "tip": reader.tip.tip, "gel_index": reader.tip.gel_index, "rest_depth_mm": reader.tip.rest_depth_mm,
        "rest_px": reader.tip.rest_px.tolist(), "terms": reader.terms._asdict(),
        "known_poses": error.known.tolist(), "off_px": error.off.tolist(), "lengths": error.lengths.tolist(),
        "amplitude": error.amplitude, "noise": error.noise, "pixel_px": reader.pixel_px,
        "widths": reader.widths.tolist(), "limit": reader.limit,
    }  # fmt: skip


@parser("tip reader", InputError)
def load_reader(folder: Path) -> tuple[TipReader, NamedPins]:
    """Load a reader and its pin layout from a fitted tip's folder."""
    path = folder / FILE
    if not path.is_file():
        raise InputError(f"there is no {path}; `palpate calibrate --method tip-pose` makes one")
    with storage_errors(path):
        text = path.read_bytes()
    try:
        record = json.loads(text)
        reader, layout = _made(record)
    except (ValueError, KeyError, TypeError) as e:
        raise InputError(f"{path} is no tip reader: {type(e).__name__}: {e}", code="reader-damaged") from e
    return reader, layout


def _made(record: dict[str, Any]) -> tuple[TipReader, NamedPins]:
    if record["format"] != FORMAT:
        raise ValueError(f"its format is {record['format']!r}, not {FORMAT!r}")
    known, off, rest, widths, lengths = (
        np.array(record[name], np.float64)
        for name in ("known_poses", "off_px", "rest_px", "widths", "lengths")
    )
    cells = tuple((int(c), int(r)) for c, r in record["cells"])
    height, width = (int(one) for one in record["size"])
    if record["kind"] not in get_args(PinLayoutKind):
        raise ValueError(f"no layout is {record['kind']!r}")
    sound = known.shape == (len(off), len(POSE)) and rest.shape == (len(cells), 2) and len(known) > 1
    parts = (known, off, rest, widths, lengths)
    if not (
        sound and widths.shape == lengths.shape == (len(POSE),) and all(np.isfinite(p).all() for p in parts)
    ):
        raise ValueError("its arrays do not fit each other, or hold values that are not finite")
    error = TwinError(
        PoseScale.of(known), known, off, lengths, float(record["amplitude"]), float(record["noise"])
    )
    tip = PosedTip(rest, float(record["rest_depth_mm"]), str(record["tip"]), float(record["gel_index"]))
    reader = TipReader(
        tip, TipTerms(**record["terms"]), error, float(record["pixel_px"]), widths, float(record["limit"])
    )
    return reader, NamedPins((height, width), record["kind"], cells)


def read_images(
    reader: TipReader, layout: NamedPins, paths: Sequence[Path], progress: Progress = silent
) -> list[dict[str, Any]]:
    """Read poses of tap images, with intervals, validity, and reason."""
    rows = []
    for i, path in enumerate(paths):
        progress("reading taps", i, len(paths))
        image = read_image(path)
        if image.shape != layout.size:
            raise ImageError(
                f"{path} has {image.shape[1]} x {image.shape[0]} px; this tip was fitted to "
                f"{layout.size[1]} x {layout.size[0]} px",
                code="image-size",
            )
        found = spots(image)
        places = placed(found, name_pins(found, layout.size, layout.kind), layout.cells)
        rows.append({"image": str(path)} | _reading(reader, places))
    return rows


def _reading(reader: TipReader, places: np.ndarray) -> dict[str, Any]:
    read = reader.read(places[None])
    if not np.isfinite(read.poses[0, 0]):
        named = int(np.isfinite(places[:, 0]).sum())
        said = (
            f"{named} of {len(places)} pins could be named; is it a tap of this tip, binarised, pins bright?"
        )
        return {"valid": False, "why": said, "pose": None, "half_width": None}
    why = [] if read.within[0] else ["the pose is beyond the taps that the tip was fitted to"]
    if not read.like[0]:
        why.append("pins stand as in no tap that the tip was fitted to")
    return {
        "valid": bool(read.valid[0]), "why": "; ".join(why) or None,
        "pose": dict(zip(POSE, read.poses[0].tolist(), strict=True)),
        "half_width": dict(zip(POSE, read.half_widths[0].tolist(), strict=True)),
        "misfit": float(read.misfit[0]),
    }  # fmt: skip
