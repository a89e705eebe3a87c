"""Calibration of normal force for a patterned skin: fitted, kept in a file, and read with.

Only frames from 1 N on are trained on. A calibration states its force, positions, and tips; readings beyond
them are not valid. An image shows force only through the skin's stiffness: on another pad the interval
contains the stated spread of stiffness, until a known weight is measured.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from palpate.calibration.certificate import contents_id, load_record, save_record
from palpate.calibration.shear.force_law import (
    ForceInterval,
    ForceLine,
    MemoryTrace,
    fit_interval,
    fit_line,
    fit_remembering,
    follow_memory,
    held_out,
    touched_n,
)
from palpate.calibration.shear.touch_cues import (
    PUBLISHED_ALPHA_PX,
    SIDE_SAMPLES,
    CueMeter,
    LabelledCues,
    TouchCues,
)
from palpate.core import Bool, Drift, Float, Int, Lens, RangeError, Reading, ndarray
from palpate.core.reading import NONE, Refusal
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.shear.touch_places import CODE as OUTSIDE_AREA
from palpate.version import __version__

MIN_FORCE_N = 1.0  # below it the published sensor's pattern did not move enough
COVERAGE = 0.90
BEYOND_PLACES_M = 1e-3  # a place this far outside of those calibrated is still taken
PAD_STIFFNESS = 0.12  # standard deviation of the calibrated pad's own stiffness since then; assumed
COPY_STIFFNESS = math.hypot(0.10, PAD_STIFFNESS)  # of a copy: as virtual copies differ, and since then
COPY_SHAPE = 0.02  # what one known weight does not tell of a copy: layers of other thickness bend the law
DRIFT_LIMIT_PX = 0.5  # root mean square shift of the untouched marks

Series = Float[ndarray, " n"]


@dataclass(frozen=True)
class ShearCalibration:
    """Calibrated pad.

    Attributes:
        line, alone: law for single frames, fitted to all ways of loading, and its interval.
        remembering, followed: law for frames with known history, and its interval; None without.
        range_n: least and greatest force [N].
        places_m: least x, greatest x, least y, greatest y of contacts, from the camera's axis [m].
        alpha_px, samples: of gamma: scale [1/px] and samples along each side, K is their square.
        cells, places_px, sigma_px: marks of the no-contact pattern.
        mae_n: mean absolute error of held-out presses, of single frames and of followed ones [N].
        scale: of all forces, 1 on the calibrated pad.
        scale_error: its standard error; 0 on that pad, where `stiffness_error` counts.
        copy: assumption on the pad, in words.
    """

    line: ForceLine
    alone: ForceInterval
    remembering: ForceLine | None
    followed: ForceInterval | None
    range_n: tuple[float, float]
    places_m: tuple[float, float, float, float]
    tips: tuple[str, ...]
    alpha_px: float
    samples: int
    lens_json: str
    camera_m: float
    cells: Int[ndarray, "n 2"]
    places_px: Float[ndarray, "n 2"]
    sigma_px: Float[ndarray, " n"]
    presses: int
    mae_n: tuple[float, float]
    scale: float = 1.0
    scale_error: float = 0.0
    copy: str = "the pad that was calibrated"
    note: str = ""
    version: str = __version__

    @property
    def stiffness_error(self) -> float:
        """Relative standard deviation of the pad's stiffness; a known weight replaces the assumed 12 %."""
        return self.scale_error or PAD_STIFFNESS

    @property
    def assumes(self) -> str:
        percent = f"{100 * self.stiffness_error:.3g} %"
        return f"{self.copy}; stiffness within {percent} (standard deviation), which no frame shows"

    @property
    def id(self) -> str:
        return contents_id(self, "shear")

    @property
    def lens(self) -> Lens:
        return Lens.from_card(json.loads(self.lens_json))

    @property
    def reference(self) -> ControlPoints:
        """Marks of the untouched pattern that was calibrated [px]."""
        return ControlPoints(self.cells, self.places_px, self.sigma_px)

    @property
    def pitch_px(self) -> float:
        """Median distance of neighbouring marks [px]."""
        at = {tuple(cell): place for cell, place in zip(self.cells.tolist(), self.places_px, strict=True)}
        steps = [at[i + 1, j] - place for (i, j), place in at.items() if (i + 1, j) in at]
        return float(np.median(np.hypot(*np.array(steps).T)))

    def meter(self, reference: ControlPoints | None = None) -> CueMeter:
        """Cues as this calibration was fitted to, against a reference of now [px]."""
        reference = reference or self.reference
        return CueMeter(reference, self.lens, self.camera_m, self.alpha_px, self.samples)

    def drift(self, reference: ControlPoints) -> Drift:
        """How far untouched marks have moved since, root mean square over its limit's unit, px."""
        theirs, ours, _ = reference.shared_with(self.reference)
        off = math.inf if not len(ours) else float(np.sqrt(((ours - theirs) ** 2).sum(axis=1).mean()))
        return Drift(off, DRIFT_LIMIT_PX)

    def on_copy(self, spread: float = COPY_STIFFNESS) -> ShearCalibration:
        """Return the calibration for another pad of the same make with unknown stiffness.

        Args:
            spread: relative standard deviation of its stiffness, 0 to 0.5.
        """
        if not 0 < spread < 0.5:
            raise RangeError(f"a spread of stiffness of {spread}; give a share between 0 and 0.5")
        words = f"a copy of unknown stiffness, spread {100 * spread:.3g} % assumed"
        return replace(self, scale=1.0, scale_error=spread, copy=words)

    def weighed(
        self, cues: Sequence[TouchCues], weight_n: float, weight_error_n: float = 0.0, lays: int = 1
    ) -> ShearCalibration:
        """Return the calibration for a pad on which a known weight was laid.

        With a law of the memory the elastic part is compared, since a weight rests. Without one, apply the
        force as in the calibration.

        Args:
            cues: of frames with the weight at rest.
            weight_n, weight_error_n: its force, within the calibrated range, and standard error [N].
            lays: number of placements at different positions.
        """
        low, high = self.range_n
        if not low <= weight_n <= high:
            raise RangeError(
                f"a weight of {weight_n:.3g} N; give one within the calibrated {low:.3g} to {high:.3g} N"
            )
        if lays < 1 or not 0 <= weight_error_n < math.inf:  # NaN fails the comparison too
            raise RangeError(
                f"{lays} lays of a weight known to {weight_error_n:.3g} N; give 1 lay or more, and a finite "
                "error of 0 N or more"
            )
        line = self.remembering or self.line
        interval = self.followed or self.alone
        own = line.elastic_n(cues)
        if not len(own) or not (np.isfinite(own) & (own > MIN_FORCE_N / 2)).all():
            raise RangeError("not every frame shows a weight; give frames with it on the pad, at rest")
        seen = float(own.mean())
        single = interval.half(seen) / self._sigmas / seen / math.sqrt(lays)
        error = math.sqrt(single**2 + (weight_error_n / weight_n) ** 2 + COPY_SHAPE**2)
        words = f"a copy on which {weight_n:.4g} N were laid"
        return replace(self, scale=weight_n / seen, scale_error=error, copy=words)

    def referred_to(self, reference: ControlPoints) -> ShearCalibration:
        """The calibration with the untouched marks of another pad, or of another day [px]."""
        return replace(self, cells=reference.cells, places_px=reference.places, sigma_px=reference.sigma)

    @property
    def _sigmas(self) -> float:
        return NormalDist().inv_cdf(0.5 + self.alone.coverage / 2)

    def read(
        self,
        cues: TouchCues,
        remembered: Float[ndarray, " m"] | None = None,
        *,
        frame: str = "",
        time_s: float = 0.0,
        drift: Drift | None = None,
    ) -> Reading:
        """Return the normal force of a frame.

        Args:
            remembered: from a `MemoryTrace`; None or NaN where the history is not known.
        """
        known = remembered is not None and bool(np.isfinite(remembered).all())
        line, interval, extra = self.line, self.alone, 0.0
        if known and self.remembering is not None and self.followed is not None:
            line, interval = self.remembering, self.followed
            extra = float(np.dot(np.asarray(remembered), line.memory_share))
        own = float(line.elastic_n([cues])[0]) + extra
        value = self.scale * own
        if not math.isfinite(value):
            return self._reading(0.0, 0.0, self.range_n[0], self._refusal(cues, 0.0), frame, time_s, drift)
        half = math.hypot(self.scale * interval.half(own), self._sigmas * self.stiffness_error * value)
        why = self._refusal(cues, value)
        low, high = max(value - half, 0.0), max(value + half, 0.0)
        return self._reading(max(value, 0.0), low, high, why, frame, time_s, drift)

    def _refusal(self, cues: TouchCues, value: float) -> Refusal:
        """Why a force is not valid; none where it is."""
        low, high = self.range_n
        if cues.contacts == 0:
            return Refusal(
                "no_contact", f"no contact is seen; one below {MIN_FORCE_N:g} N hardly moves the pattern"
            )
        if cues.contacts > 1:
            return Refusal(
                "several_contacts", f"{cues.contacts} contacts at once, and the calibration is of one"
            )
        if value < low:
            return Refusal("out_of_range", f"below {low:.3g} N, where the calibration begins")
        if value > high:
            return Refusal("out_of_range", f"above {high:.3g} N, where the calibration ends")
        x0, x1, y0, y1 = self.places_m
        beside = max(x0 - cues.x_m, cues.x_m - x1, y0 - cues.y_m, cues.y_m - y1)
        if beside > BEYOND_PLACES_M:
            return Refusal(OUTSIDE_AREA, f"{1e3 * beside:.1f} mm beside the places of the calibration")
        return NONE

    def _reading(
        self, value: float, low: float, high: float, why: Refusal, frame: str, time_s: float,
        drift: Drift | None,
    ) -> Reading:  # fmt: skip
        return Reading(
            quantity="force",
            unit="N",
            coverage=self.alone.coverage,
            valid=not why,
            why=why.why,
            code=why.code,
            drift=drift,
            calibration=self.id,
            frame=frame,
            time_s=time_s,
            value=value,
            low=low,
            high=high,
            calibrated_range=self.range_n,
        )

    def save(self, path: Path) -> None:
        """Write one ``.npz``, whole or not at all."""
        save_record(self, path)

    @classmethod
    def load(cls, path: Path) -> ShearCalibration:
        """Read what `save` wrote; no code in it is run."""
        return load_record(cls, path, "shear force", "palpate calibrate --method shear-force")


class ForceFollower:
    """Force of successive frames, with the skin's memory where the calibration has it.

    Args:
        reference: marks of the no-contact pad now [px]; None for those of the calibration.
    """

    def __init__(self, calibration: ShearCalibration, reference: ControlPoints | None = None) -> None:
        self.calibration = calibration
        self._meter = calibration.meter(reference)
        self._drift = None if reference is None else calibration.drift(reference)
        line = calibration.remembering
        self._trace = None if line is None else MemoryTrace(line.memory_s)

    def read(self, points: ControlPoints, time_s: float, frame: str = "", *, clocked: bool = True) -> Reading:
        """Return the force of the next frame.

        Args:
            points: its marks [px].
            time_s: in temporal order [s].
            clocked: whether `time_s` is a clock's; without, the history is not known.
        """
        cues = self._meter.cues(points)
        return self.calibration.read(
            cues,
            self._remembered(cues, time_s if clocked else math.nan),
            frame=frame,
            time_s=time_s,
            drift=self._drift,
        )

    def unread(self, why: Refusal, time_s: float, frame: str = "") -> Reading:
        """Reading of a frame whose marks are not to be used: not valid, and why."""
        nan = math.nan
        return self.calibration._reading(nan, nan, nan, why, frame, time_s, self._drift)

    def _remembered(self, cues: TouchCues, time_s: float) -> Float[ndarray, " m"] | None:
        line = self.calibration.remembering
        if line is None or self._trace is None:
            return None
        return self._trace.step(time_s, float(touched_n(line, [cues])[0]))


def calibrate_shear(
    samples: LabelledCues,
    reference: ControlPoints,
    lens: Lens,
    camera_m: float,
    *,
    law: str = "any-tip",
    hysteresis: bool = False,
    coverage: float = COVERAGE,
    note: str = "",
) -> ShearCalibration:
    """Fit a calibration to labeled frames of one or more runs of one pad.

    Args:
        reference: marks of the no-contact pad [px].
        law: "any-tip" (moments and position), "placed" (gamma and position), or "published" (gamma alone).
        hysteresis: fit the skin's memory too; frames of a press then begin before contact.
        coverage: of the intervals, 0.5 to 0.99.
    """
    used = usable(samples)
    alone = held_out(
        lambda kept: fit_line(law, samples.cues, samples.force_n, used & kept).elastic_n(samples.cues),
        samples.press,
    )
    line = fit_line(law, samples.cues, samples.force_n, used)
    remembering, followed, error = None, None, math.nan
    if hysteresis:

        def fitted(kept: Bool[ndarray, " n"]) -> ForceLine:
            return fit_remembering(
                law, samples.cues, samples.force_n, used & kept, samples.time_s, samples.press
            )

        def estimated(one: ForceLine) -> Series:
            remembered, _ = follow_memory(one, samples.cues, samples.time_s, samples.press)
            return one.force_n(samples.cues, remembered)

        remembering = fitted(np.ones_like(used))
        estimates = held_out(lambda kept: estimated(fitted(kept)), samples.press)
        known = used & np.isfinite(estimates)
        followed = fit_interval(estimates[known], samples.force_n[known], samples.press[known], coverage)
        error = float(np.abs(estimates - samples.force_n)[known].mean())
    at = np.array([(c.x_m, c.y_m) for c in samples.cues])[used]
    (x0, y0), (x1, y1) = at.min(axis=0).tolist(), at.max(axis=0).tolist()
    force = samples.force_n[used]
    return ShearCalibration(
        line,
        fit_interval(alone[used], force, samples.press[used], coverage),
        remembering,
        followed,
        (max(MIN_FORCE_N, float(force.min())), float(force.max())),
        (x0, x1, y0, y1),
        tuple(sorted(set(samples.tip[used].tolist()))),
        PUBLISHED_ALPHA_PX,
        SIDE_SAMPLES,
        json.dumps(lens.card(), sort_keys=True),
        camera_m,
        reference.cells,
        reference.places,
        reference.sigma,
        len(np.unique(samples.press[used])),
        (float(np.abs(alone - samples.force_n)[used].mean()), error),
        note=note,
    )


def usable(samples: LabelledCues) -> Bool[ndarray, " n"]:
    """Return the mask of frames from 1 N on with one contact."""
    single = np.array([c.contacts == 1 for c in samples.cues])
    return np.asarray(single & (samples.force_n >= MIN_FORCE_N))


def calibration_record(calibration: ShearCalibration) -> dict[str, Any]:
    """Return the fit in plain numbers."""
    weights, memory = calibration.line.weights, calibration.remembering
    return {
        "calibration": calibration.id,
        "law": calibration.line.law,
        "weights_N": weights.tolist(),
        "alpha_per_px": calibration.alpha_px,
        "samples_K": calibration.samples**2,
        "range_N": list(calibration.range_n),
        "places_mm": [1e3 * at for at in calibration.places_m],
        "indenters": list(calibration.tips),
        "presses": calibration.presses,
        "coverage": calibration.alone.coverage,
        "interval_N": {
            "at": calibration.alone.at_n.tolist(),
            "half_width": calibration.alone.half_n.tolist(),
        },
        "mae_N": calibration.mae_n[0],
        "hysteresis": None
        if memory is None or calibration.followed is None
        else {
            "mae_N": calibration.mae_n[1],
            "memory_s": memory.memory_s.tolist(),
            "memory_share": memory.memory_share.tolist(),
            "half_width_N": calibration.followed.half_n.tolist(),
        },
        "pad": calibration.copy,
        "scale": calibration.scale,
        "scale_error": calibration.scale_error,
        "stiffness_error": calibration.stiffness_error,
        "assumes": calibration.assumes,
    }
