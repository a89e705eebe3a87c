"""Transmissions as plain values, as object files, and live on the virtual bench."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from palpate.core import RangeError, SafetyError
from palpate.mechanics.fingertip_laws import Fingertip
from palpate.softness.process import RenderingSession, read_bench
from palpate.softness.rendering_law import Mode
from palpate.softness.transmission.judged_stages import CueNoise, StageJudgement
from palpate.softness.transmission.transmitted_cues import CUES, Transmission, modulus_of_chord

SIMULATED = (
    "Simulated: display, arm, finger and observer are models; no device was driven and nobody has felt it."
)
LOOK_S = 0.1
MAX_LIVE_S = 3600.0
FILE_STEP = 32  # of a curve's points, one is kept in an object's file
EDGE = {"displacement": "N/mm", "area": "kPa"}
"""Unit of a cue's chord in files and on pages, where it is a thousandth of the SI value."""


def transmissions_record(
    found: Sequence[Transmission], judgements: Mapping[str, StageJudgement], noise: CueNoise,
    finger: Fingertip, words: str,
) -> dict[str, Any]:  # fmt: skip
    """Return several transmissions at one force, and their judgments, as plain values."""
    return {
        "simulated": SIMULATED, "finger": words, "peak_N": found[0].peak_n,
        "objects": [transmission_record(one, finger) for one in found],
        "weber": {"displacement": noise.displacement, "area": noise.area},
        "judged": {
            stage: {"total": one.total, "pairs": {" / ".join(pair): p for pair, p in one.pairs.items()}}
            for stage, one in judgements.items()
        },
        "ranks": order_kept(found),
    }  # fmt: skip


def transmission_record(one: Transmission, finger: Fingertip) -> dict[str, Any]:
    """A transmission in plain numbers, in the units of files."""
    record: dict[str, Any] = {
        "name": one.name, "source": one.touched.words, "calibration": one.touched.calibration,
        "modulus_kPa": one.touched.flat_pa / 1e3, "modulus_low_kPa": one.touched.low_pa / 1e3,
        "modulus_high_kPa": one.touched.high_pa / 1e3 if np.isfinite(one.touched.high_pa) else None,
        "modulus_is": "Young's modulus over 1 - nu^2", "peak_N": one.peak_n, "inside": one.inside,
    }  # fmt: skip
    for name, cue in one.cues.items():
        low, high = cue.interval()
        as_modulus = None
        if one.true_flat_pa is not None:
            felt_pa = modulus_of_chord(finger, cue.felt, one.peak_n, name)
            as_modulus = felt_pa / one.true_flat_pa - 1 if np.isfinite(felt_pa) else None
        record[name] = {
            "unit": EDGE[name], "true": None if cue.true is None else cue.true / 1e3,
            "touched": cue.touched / 1e3, "felt": cue.felt / 1e3, "low": low / 1e3, "high": high / 1e3,
            "coverage": 0.9, "lost": dict(cue.lost), "as_modulus": as_modulus,
            "way_in": cue.way_in, "way_out": cue.way_out,
            "felt_true": None if cue.felt_true is None else cue.felt_true / 1e3,
            "held": cue.held, "true_held": cue.true_held,
            "off_rms_of_peak": one.off_rms(name),
        }  # fmt: skip
    return record


def order_kept(found: Sequence[Transmission]) -> dict[str, bool] | None:
    """Whether known objects keep their order by both cues, as touched and as felt; None if unknown."""
    if len(found) < 2 or any(one.true_flat_pa is None for one in found):
        return None
    order = sorted(found, key=lambda one: -(one.true_flat_pa or 0.0))
    return {
        stage: all(
            getattr(one.cues[cue], stage) > getattr(other.cues[cue], stage)
            for one, other in pairwise(order)
            for cue in CUES
            if one.true_flat_pa != other.true_flat_pa
        )
        for stage in ("touched", "felt")
    }


def object_file(one: Transmission) -> str:
    """The object's file, by which `palpate display run` renders it."""
    lines = [f'name = "{one.name}, as touched"']
    for cue, scale, unit in (("area", 1e6, "mm2"), ("displacement", 1e3, "mm")):
        curve = getattr(one.rendering.law.object, cue)
        part = slice(None, None, FILE_STEP)
        x, force = (
            ", ".join(f"{v:.9g}" for v in values) for values in (scale * curve.x[part], curve.force_n[part])
        )
        lines += [f"[force_{cue}]", f"{cue}_{unit} = [{x}]", f"force_N = [{force}]"]
    return "\n".join(lines) + "\n"


def felt_live(one: Transmission, seconds: float) -> dict[str, Any]:
    """Render an object live on the virtual bench in its own process; return timing and deviation."""
    if not 0 < seconds <= MAX_LIVE_S:
        raise RangeError(
            f"a live rendering of {seconds:g} s; above 0 and at most {MAX_LIVE_S:g} s are allowed"
        )
    soft, seen = one.rendering.law.object, []
    with RenderingSession(read_bench(None), soft, Mode.BOTH, one.peak_n, 1.0) as session:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and session.status().state != "ended":
            time.sleep(LOOK_S)
            seen += session.taken()
        status = session.stop()
    if not status.wished:
        raise SafetyError(f"the rendering ended by itself: {status.why}")
    felt = [sample for sample in seen if sample.touched]
    force, way = (np.array([getattr(each, name) for each in felt]) for name in ("force_n", "displacement_m"))
    off = force - np.interp(way, soft.displacement.x, soft.displacement.force_n)
    peak = float(force.max()) if felt else 0.0
    return {
        "seconds": seconds, "periods": status.periods, "late_share": status.late_share, "peak_N": peak,
        "force_displacement_rms_of_peak": float(np.sqrt(np.mean(off**2)) / peak) if peak else None,
    }  # fmt: skip
