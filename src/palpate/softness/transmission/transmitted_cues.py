"""Softness from a touch to a percept: what a TacTip has read, a finger meets, and a display lets it feel.

Four stages, each with what it loses:

    object      its curves under a finger: force over displacement, and over contact area
    touched     the same of the object as a TacTip has read it, with the reading's interval
    felt        what the finger feels where the display and the arm render what was touched
    judged      which of two a participant would call softer, of each stage (`psychophysics.observers`)

Each object is a thick flat, and it is mapped through the finger's own radius and modulus, never the TacTip's
(`mechanics.fingertip_laws.on_flat`). A cue is a chord: force at the end of the press over displacement there,
or over area. A rendering's is that of what it renders, times the least-squares factor of force felt over
force due at the displacements (areas) that were felt, over the part of the press that can be rendered.

The reading's uncertainty is carried by draws: of each the curves follow exactly, and the display's factor by
interpolation between renderings at quantiles of the reading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from palpate.core import Float, InputError, Progress, RangeError, ndarray, silent
from palpate.mechanics.fingertip_laws import Fingertip, on_flat
from palpate.softness import Mode, SoftObject
from palpate.softness.characteristics import Characteristic, fingertip_object
from palpate.softness.cone_display import ConeDisplay
from palpate.softness.rendering_simulation import Rendering, simulate
from palpate.softness.touched_flat import TouchedFlat

CUES = ("displacement", "area")
NODES = (0.02, 0.25, 0.5, 0.75, 0.98)  # quantiles of a reading that are rendered
DRAWS = 400
SPLINE_POINTS = 12
FILLED = 0.9  # of the display's base, at the end of a press
MIN_INSIDE = 0.2  # of the scored periods, for a factor

Values = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class CueTransmission:
    """One cue along the stages, as chords [N/m of displacement, Pa of area].

    Attributes:
        touched: of the object as read.
        felt: of what the finger feels.
        drawn: of what it would feel, by draws of the reading.
        true, felt_true: of the object itself, and of what would be felt if it were rendered; None unknown.
    """

    touched: float
    felt: float
    drawn: Values
    true: float | None = None
    felt_true: float | None = None

    def interval(self, coverage: float = 0.9) -> tuple[float, float]:
        """Ends of what would be felt."""
        low, high = np.quantile(self.drawn, [(1 - coverage) / 2, (1 + coverage) / 2])
        return float(low), float(high)

    @property
    def held(self) -> bool | None:
        """Whether the interval of 90 % holds what would be felt of the object itself."""
        if self.felt_true is None:
            return None
        low, high = self.interval()
        return low <= self.felt_true <= high

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
    """An object along the stages.

    Attributes:
        name: of the object.
        touched: as it was read.
        peak_n: force at the end of a press [N].
        cues: by name.
        rendering: of the object as read.
        object: the true one under the finger; None unknown.
        inside: share of a press that the display can render as it is.
        true_flat_pa: true modulus over 1 - nu^2; None unknown [Pa].
    """

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
    """Both curves of a thick flat under a finger, to a force.

    Raises:
        RangeError: a force beyond what is known of the finger there.
    """
    return fingertip_object(name, on_flat(finger, flat_pa), peak_n)


def shared_peak_n(
    finger: Fingertip, flats: Sequence[TouchedFlat], display: ConeDisplay | None = None
) -> float:
    """Greatest force to which all of some flats, as soft as they may be, can be pressed on a display [N]."""
    widest = FILLED * (display or ConeDisplay()).greatest_m2
    ends = []
    for flat in flats:
        tip = on_flat(finger, float(flat.at(np.array([0.002]))[0]))
        force = np.linspace(0.0, tip.greatest_n, 2000)
        ends.append(min(tip.greatest_n, float(np.interp(widest, tip.area_m2(force), force))))
    return min(ends)


def transmit(
    name: str, touched: TouchedFlat, finger: Fingertip, *, peak_n: float, true_flat_pa: float | None = None,
    frequency_hz: float = 1.0, seed: int = 0, draws: int = DRAWS, progress: Progress = silent,
) -> Transmission:  # fmt: skip
    """Render an object that was touched, and say what of it reaches the finger.

    Args:
        name: of the object.
        touched: as it was read.
        finger: that feels it, on a rigid flat.
        peak_n: force at the end of a press, alike for all objects that are compared [N].
        true_flat_pa: its true modulus over 1 - nu^2, where it is known [Pa].
        frequency_hz: of the virtual finger's presses [Hz].
        seed: of the reading's draws and the bench's noise.
        draws: of the reading.
        progress: called with how many renderings are done.

    Raises:
        RangeError: a force beyond what is known of the finger, or an object that the display cannot render.
        InputError: too few draws.
    """
    if draws < 20:
        raise InputError(f"{draws} draws; 20 or more are needed for an interval")
    rng = np.random.default_rng(seed)
    at_nodes = touched.at(np.array(NODES))
    renderings, done = [], len(NODES) + (true_flat_pa is not None)
    for i, flat_pa in enumerate(at_nodes):
        progress("renderings", i, done)
        soft = object_under(finger, float(flat_pa), peak_n, name)
        renderings.append(_rendered(soft, peak_n, frequency_hz, seed + i))
    middle = renderings[len(NODES) // 2]
    drawn_pa = touched.drawn(draws, rng)
    true = None if true_flat_pa is None else object_under(finger, true_flat_pa, peak_n, name)
    felt_true = None if true is None else _rendered(true, peak_n, frequency_hz, seed + len(NODES))
    cues = {}
    for cue in CUES:
        factors = np.array([felt_factor(one, cue) for one in renderings])
        chords = _chords_of(finger, drawn_pa, peak_n, cue)
        factor = _between(at_nodes, factors, drawn_pa)
        touched_chord = _chord_of(finger, touched.flat_pa, peak_n, cue)
        cues[cue] = CueTransmission(
            touched_chord,
            touched_chord * float(factors[len(NODES) // 2]),
            chords * factor,
            None if true_flat_pa is None else _chord_of(finger, true_flat_pa, peak_n, cue),
            None if true_flat_pa is None or felt_true is None
            else _chord_of(finger, true_flat_pa, peak_n, cue) * felt_factor(felt_true, cue),
        )  # fmt: skip
    inside = float(middle.inside.sum() / max(1, middle.scored.sum()))
    return Transmission(name, touched, peak_n, cues, middle, true, inside, true_flat_pa)


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


def felt_factor(felt: Rendering, cue: str) -> float:
    """Least-squares factor of the force felt over the force due at the displacements or areas felt.

    Over the part of the presses that can be rendered as it is.

    Raises:
        RangeError: that is too little of them.
    """
    inside = felt.inside
    if inside.sum() < MIN_INSIDE * felt.scored.sum():
        raise RangeError(
            f"{felt.law.object.name}: the display renders {inside.sum() / max(1, felt.scored.sum()):.0%} of "
            f"the press as it is, and {MIN_INSIDE:.0%} are needed; press less"
        )
    curve: Characteristic = getattr(felt.law.object, cue)
    x = felt.displacement_m if cue == "displacement" else felt.area_m2
    due = np.interp(x[inside], curve.x, curve.force_n)
    return float(due @ felt.force_n[inside] / (due @ due))


def _rendered(soft: SoftObject, peak_n: float, frequency_hz: float, seed: int) -> Rendering:
    return simulate(soft, Mode.BOTH, peak_n=peak_n, frequency_hz=frequency_hz, seed=seed)


def _chord_of(finger: Fingertip, flat_pa: float, peak_n: float, cue: str) -> float:
    tip = on_flat(finger, flat_pa)
    return peak_n / float(tip.approach_m(peak_n) if cue == "displacement" else tip.area_m2(peak_n))


def _chords_of(finger: Fingertip, flats_pa: Values, peak_n: float, cue: str) -> Values:
    """Chords of many flats, by a spline through some: they are smooth in 1 / E."""
    at = np.linspace(np.min(1 / flats_pa), np.max(1 / flats_pa), SPLINE_POINTS)
    with np.errstate(divide="ignore"):
        chords = [_chord_of(finger, float(pa), peak_n, cue) for pa in 1 / at]
    return np.asarray(CubicSpline(at, chords)(1 / flats_pa))


def _between(at_nodes: Float[ndarray, " k"], factors: Float[ndarray, " k"], drawn_pa: Values) -> Values:
    """The display's factor at moduli between those rendered, level beyond them."""
    return np.asarray(np.interp(-1 / drawn_pa, -1 / at_nodes, factors))
