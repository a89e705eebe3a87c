"""Softness from a tactile reading to what a finger feels.

Stages: the object, the object as read, the object as rendered, and the judgment. Every object is a thick flat
under the finger's own radius and modulus (`mechanics.fingertip_laws.on_flat`). A cue is a chord: force at the
end of the press over displacement or area. Rendering multiplies it by the least-squares factor of felt over
due force. Draws of the reading and of the press frequency carry the uncertainty.

Discriminability of objects at each stage of a transmission.

An observer perceives the logarithm of each cue's chord with Gaussian noise and weights the cues by 1 /
variance. A cue of Weber fraction w has sigma = ln(1 + w) / 0.954 (75 % of pairs). Draws of different objects
are independent.

Transmissions as plain values, as object files, and live on the virtual bench.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, RegularGridInterpolator
from scipy.optimize import brentq

from palpate.core import Float, InputError, Progress, RangeError, SafetyError, ndarray, silent
from palpate.mechanics.fingertip_laws import Fingertip, on_flat
from palpate.psychophysics.judgements import RankObserver
from palpate.softness import SoftObject
from palpate.softness.characteristics import Characteristic, fingertip_object
from palpate.softness.display_parts import ConeDisplay
from palpate.softness.process import RenderingSession, read_bench
from palpate.softness.rendering_law import Mode
from palpate.softness.rendering_simulation import Rendering, simulate
from palpate.softness.touched_flat import TouchedFlat

CUES = ("displacement", "area")
NODES = (0.02, 0.5, 0.98)  # quantiles of a reading that are rendered
FASTER = 2.2  # than the middle frequency a finger may press, or as much slower
DRAWS = 400
SOFTEST = 0.002  # share of a reading beyond which no draw lies
SPLINE_POINTS = 12
MIN_PEAK_N = 0.02  # of a press that the display feels at all
FILLED = 0.9  # of the display's base, at the end of a press
MIN_INSIDE = 0.2  # of the scored periods, for a factor

Values = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class CueTransmission:
    """One cue along the stages, as chords [N/m of displacement, Pa of area].

    Attributes:
        way_in, way_out: factors of felt over due force, loading and unloading.
        drawn: felt chords over draws of the reading and the frequency.
        true, felt_true: chord of the object, and if it were rendered; None if unknown.
    """

    touched: float
    felt: float
    way_in: float
    way_out: float
    drawn: Values
    true: float | None = None
    felt_true: float | None = None

    def interval(self, coverage: float = 0.9) -> tuple[float, float]:
        """Ends of what would be felt."""
        low, high = np.quantile(self.drawn, [(1 - coverage) / 2, (1 + coverage) / 2])
        return float(low), float(high)

    @property
    def held(self) -> bool | None:
        """Whether the interval of 90 % holds what would be felt if the object itself were rendered."""
        return self._holds(self.felt_true)

    @property
    def true_held(self) -> bool | None:
        """Whether it holds the object's own chord, which no display's error moves."""
        return self._holds(self.true)

    def _holds(self, chord: float | None) -> bool | None:
        if chord is None:
            return None
        low, high = self.interval()
        return low <= chord <= high

    @property
    def lost(self) -> Mapping[str, float]:
        """Relative errors: by the touch, by the display, and both; empty where the object is not known."""
        if self.true is None:
            return {}
        return {
            "touch": self.touched / self.true - 1,
            "display": self.felt / self.touched - 1,
            "together": self.felt / self.true - 1,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Transmission:
    """An object along the stages; `object` and `true_flat_pa` are None if unknown."""

    name: str
    touched: TouchedFlat
    peak_n: float
    cues: Mapping[str, CueTransmission]
    rendering: Rendering
    object: SoftObject | None
    inside: float
    true_flat_pa: float | None = None

    def off_rms(self, cue: str) -> float:
        """Root mean square of force felt less force due, inside the envelope, over the peak."""
        felt = self.rendering
        off_n = felt.off_displacement_n() if cue == "displacement" else felt.off_area_n()
        return felt.share(off_n, felt.inside)


def object_under(finger: Fingertip, flat_pa: float, peak_n: float, name: str = "flat") -> SoftObject:
    """Both curves of a thick flat under a finger, to a force."""
    return fingertip_object(name, on_flat(finger, flat_pa), peak_n)


def shared_peak_n(
    finger: Fingertip, flats: Sequence[TouchedFlat], display: ConeDisplay | None = None
) -> float:
    """Greatest force to which all of some flats, as soft as they may be, can be pressed on a display [N]."""
    widest = FILLED * (display or ConeDisplay()).greatest_m2
    ends = []
    for flat in flats:
        tip = on_flat(finger, float(flat.at(np.array([SOFTEST]))[0]))
        force = np.linspace(0.0, tip.greatest_n, 2000)
        ends.append(min(tip.greatest_n, float(np.interp(widest, tip.area_m2(force), force))))
    return min(ends)


def transmit(
    name: str, touched: TouchedFlat, finger: Fingertip, *, peak_n: float, true_flat_pa: float | None = None,
    frequency_hz: float = 1.0, seed: int = 0, draws: int = DRAWS, progress: Progress = silent,
) -> Transmission:  # fmt: skip
    """Render an object as read, and return what reaches the finger.

    Args:
        peak_n: force at the end of a press, equal for all compared objects [N].
        true_flat_pa: true modulus over 1 - nu^2, if known [Pa].
        frequency_hz: median press frequency; draws span a factor of 2.2 to either side [Hz].
    """
    if not MIN_PEAK_N <= peak_n < np.inf:
        raise RangeError(
            f"a press to {peak_n:g} N; {MIN_PEAK_N:g} N and more are allowed, such as 0.3", code="press-force"
        )
    if draws < 20:
        raise InputError(f"{draws} draws; 20 or more are needed for an interval", code="too-few-draws")
    rng = np.random.default_rng(seed)
    at_nodes = touched.at(np.array(NODES))
    at_hz = frequency_hz * np.array([1 / FASTER, 1.0, FASTER])
    renderings, count = [], len(at_nodes) * len(at_hz)
    for i, (flat_pa, f_hz) in enumerate(product(at_nodes, at_hz)):
        progress("renderings", i, count)
        soft = object_under(finger, float(flat_pa), peak_n, name)
        renderings.append(simulate(soft, Mode.BOTH, peak_n=peak_n, frequency_hz=float(f_hz), seed=seed + i))
    drawn_pa = touched.drawn(draws, rng, SOFTEST)
    drawn_hz = frequency_hz * FASTER ** rng.uniform(-1.0, 1.0, draws)
    middle, felt_true = renderings[count // 2], None
    if true_flat_pa is not None:
        own_hz = frequency_hz * FASTER ** float(rng.uniform(-1.0, 1.0))
        true = object_under(finger, true_flat_pa, peak_n, name)
        felt_true = simulate(true, Mode.BOTH, peak_n=peak_n, frequency_hz=own_hz, seed=seed + count)
    cues = {}
    for cue in CUES:
        factors = np.array([felt_factor(one, cue) for one in renderings]).reshape(len(NODES), len(at_hz))
        display = RegularGridInterpolator((_rising(-1 / at_nodes), np.log(at_hz)), factors)
        at = np.stack([np.clip(-1 / drawn_pa, -1 / at_nodes[0], -1 / at_nodes[-1]), np.log(drawn_hz)], axis=1)
        chord = _chord_of(finger, touched.flat_pa, peak_n, cue)
        own = None if true_flat_pa is None else _chord_of(finger, true_flat_pa, peak_n, cue)
        cues[cue] = CueTransmission(
            chord,
            chord * felt_factor(middle, cue),
            felt_factor(middle, cue, way=1),
            felt_factor(middle, cue, way=-1),
            _chords_of(finger, drawn_pa, peak_n, cue) * display(at),
            own,
            None if own is None or felt_true is None else own * felt_factor(felt_true, cue),
        )
    inside = float(middle.inside.sum() / max(1, middle.scored.sum()))
    itself = None if true_flat_pa is None else object_under(finger, true_flat_pa, peak_n, name)
    return Transmission(name, touched, peak_n, cues, middle, itself, inside, true_flat_pa)


def modulus_of_chord(finger: Fingertip, chord: float, peak_n: float, cue: str) -> float:
    """The flat, over 1 - nu^2, with a chord under a finger; infinite where a rigid one has less [Pa]."""
    if chord >= _chord_of(finger, np.inf, peak_n, cue):
        return float("inf")

    def off(log_pa: float) -> float:
        return _chord_of(finger, float(np.exp(log_pa)), peak_n, cue) - chord

    least = np.log(1e-3)
    while True:  # a flat so soft that the finger is not known there any more
        try:
            if off(least) < 0:
                return float(np.exp(brentq(off, least, np.log(1e12), xtol=1e-9)))
            return 0.0
        except RangeError:
            least += 0.25


def felt_factor(felt: Rendering, cue: str, way: int = 0) -> float:
    """Return the least-squares factor of felt over due force, where rendered; `way` 1 loading, -1 unloading,
    0 both.
    """
    inside = felt.inside
    if inside.sum() < MIN_INSIDE * felt.scored.sum():
        raise RangeError(
            f"{felt.law.object.name}: the display renders {inside.sum() / max(1, felt.scored.sum()):.0%} of "
            f"the press as it is, and {MIN_INSIDE:.0%} are needed; press less"
        )
    curve: Characteristic = getattr(felt.law.object, cue)
    x = felt.displacement_m if cue == "displacement" else felt.area_m2
    if way:
        inside = inside & (way * np.gradient(felt.displacement_m) > 0)
    due = np.interp(x[inside], curve.x, curve.force_n)
    if not due @ due > 0:
        raise RangeError(
            f"{felt.law.object.name}: no force is due in a press to {felt.peak_n:.2g} N; press more"
        )
    return float(due @ felt.force_n[inside] / (due @ due))


def _rising(values: Values) -> Values:
    """Values that rise, and do so by a little where they are equal, as of a reading without an interval."""
    return np.asarray(values + 1e-9 * np.abs(values).max() * np.arange(len(values)))


def _chord_of(finger: Fingertip, flat_pa: float, peak_n: float, cue: str) -> float:
    tip = on_flat(finger, flat_pa)
    return peak_n / float(tip.approach_m(peak_n) if cue == "displacement" else tip.area_m2(peak_n))


def _chords_of(finger: Fingertip, flats_pa: Values, peak_n: float, cue: str) -> Values:
    """Chords of many flats, by a spline through some: they are smooth in 1 / E."""
    low, high = float(np.min(1 / flats_pa)), float(np.max(1 / flats_pa))
    if high - low < 1e-9 * high:  # a reading without an interval
        return np.full_like(flats_pa, _chord_of(finger, float(flats_pa[0]), peak_n, cue))
    at = np.linspace(low, high, SPLINE_POINTS)
    with np.errstate(divide="ignore"):
        chords = [_chord_of(finger, float(pa), peak_n, cue) for pa in 1 / at]
    return np.asarray(CubicSpline(at, chords)(1 / flats_pa))


STAGES = {
    "true": "objects themselves",
    "touched": "as touched",
    "felt": "as felt",
    "drawn": "as felt, readings' intervals carried",
}
JUDGED_DRAWS = 100
JND_SD = math.sqrt(2) * 0.6744897501960817  # d' of a pair that is told right in 75 %


@dataclass(frozen=True, slots=True)
class StageJudgement:
    """Probability of naming the softer of each pair, and expected fraction of correct
    positions in a ranking.
    """

    pairs: Mapping[tuple[str, str], float]
    total: float


@dataclass(frozen=True, slots=True)
class CueNoise:
    """Weber fraction of each cue (75 % of pairs correct); infinite for a cue that is not perceived."""

    displacement: float
    area: float

    def __post_init__(self) -> None:
        if not (self.displacement > 0 and self.area > 0 and min(self.displacement, self.area) < math.inf):
            raise RangeError(
                f"Weber fractions of {self.displacement:g} and {self.area:g}; both have to be above 0, and "
                "one finite, such as 0.15"
            )

    def place(self, chords: Mapping[str, float]) -> float:
        """Place of an object, rising with softness [standard deviations of the percept]."""
        total = place = 0.0
        for cue, chord in chords.items():
            reliability = (JND_SD / math.log1p(getattr(self, cue))) ** 2
            total += reliability
            place -= reliability * math.log(chord)
        return place / math.sqrt(total)


def judged(transmissions: Sequence[Transmission], noise: CueNoise) -> dict[str, StageJudgement]:
    """Judge two or more objects at each stage; ``true`` is omitted if an object is unknown."""
    known = all(one.true_flat_pa is not None for one in transmissions)
    transmissions = sorted(
        transmissions,
        key=lambda one: -(one.true_flat_pa if known and one.true_flat_pa else one.touched.flat_pa),
    )
    names = [one.name for one in transmissions]
    if len(names) < 2 or len(set(names)) < len(names):
        raise InputError(f"objects {', '.join(names)}; two or more of different names can be told apart")
    stages = {}
    for stage in ("true", "touched", "felt"):
        chords = [{cue: getattr(one.cues[cue], stage) for cue in CUES} for one in transmissions]
        if all(None not in each.values() for each in chords):
            stages[stage] = _mean(names, [[noise.place(each) for each in chords]])
    count = min(JUDGED_DRAWS, *(len(one.cues[CUES[0]].drawn) for one in transmissions))
    places = [
        [noise.place({cue: float(one.cues[cue].drawn[k]) for cue in CUES}) for one in transmissions]
        for k in range(count)
    ]
    return stages | {"drawn": _mean(names, places)}


def _mean(names: Sequence[str], places: Sequence[Sequence[float]]) -> StageJudgement:
    observers = [RankObserver(tuple(one)) for one in places]
    pairs = {
        (names[i], names[j]): float(np.mean([one.pair_accuracy(i, j) for one in observers]))
        for i, j in combinations(range(len(names)), 2)
    }
    return StageJudgement(pairs, float(np.mean([one.total_accuracy() for one in observers])))


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
