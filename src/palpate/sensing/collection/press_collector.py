"""Labelled presses of a hand, collected into an ordinary run while frames and forces come.

Each press that was held still becomes a few frames with the force that the scale told, and one frame of the
untouched sensor before it. What was not held still is refused, with the reason, and leaves nothing behind. A
run that exists goes on: nothing of it is overwritten.

Presses of a live sensor labelled by a scale of their own, which is not the sensor's.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import (
    NS_PER_S,
    Clock,
    Closing,
    ForceSensor,
    Frame,
    Image,
    InputError,
    MonotonicClock,
    PathText,
    RangeError,
    Readings,
    Wrench,
)
from palpate.core.provenance import Provenance
from palpate.recordings.label_tables import Label
from palpate.recordings.manifest import MANIFEST, LabelKind, Manifest
from palpate.recordings.run_reader import Run
from palpate.recordings.run_writer import RunWriter
from palpate.sensing.collection.image_plateau import ImagePlateau, contact_place
from palpate.sensing.collection.plateau_finder import (
    Plateau,
    PlateauFinder,
    PlateauRule,
    Refused,
    Weighing,
)
from palpate.sensing.collection.press_coverage import Box, LabelledPress, PressCoverage

PRESS_LABELS: dict[str, LabelKind] = {
    "press": "text",
    "session": "text",
    "reference": "flag",
    "force_N": "number",
    "force_spread_N": "number",
    "place_x_px": "number",
    "place_y_px": "number",
}
"""Labels of every frame. `force_N` is along the scale's axis, its zero taken off; `reference` marks the
untouched sensor before a press; places are of the contact in the image, missing where it is not seen. Frames
of the press "rest" are of the untouched sensor too, and learnt from as 0 N."""

FRAMES_A_PRESS = 4
"""Frames that are kept of a press: eight tell no more of its force, and take twice as long to learn from."""
FRAMES_HZ = 12.0  # that are kept of a press, at most
KEPT_S = 3.0  # of frames while nothing is touched
KEPT_BYTES = 192_000_000
CLEAR_S = 0.2  # before a press, that its frame of the untouched sensor is taken
RESTS = 5  # last images of the untouched sensor, beside which a contact is seen
REST_S = 0.5  # before that, in which the sensor is taken to be at rest
FAST_DELAY_S = 0.02  # of a scale whose samples are those of a frame's own exposure
SAMPLES_A_FRAME = 2.0
FEW_PRESSES = 20  # below which a calibration that says nothing is first asked for more presses
REST, REST_EVERY = "rest", 5
"""Press that stands for none: of each fifth press a frame before it is kept with 0 N, so that a calibration
reads the untouched sensor too. All are one press, since they are alike: none is learnt from while one is held
out."""
MAX_REFUSED = 20  # that are remembered
DRIFT_SHARE = 0.02  # of the greatest force, by which a zero may wander before it is said
LONG_S = 20.0  # of a touch, after which it is asked whether it is one
BEHIND_S = 1.5  # of a scale's newest sample behind the newest frame, beyond its delay

Truth = Callable[[int], dict[str, float]]


class PressCollector:
    """Collects labeled presses; a subscriber of the live loop.

    Args:
        run: Folder of the recording; an existing run is continued.
        scale: Scale that labels presses; None for typed weights, see `label`.
        session: Session name; today's date by default.
        region: Image region of contacts (x, y, width, height); None for the whole image [px].
        force_range_n: Force range to cover; None for 0 to the largest force so far [N].
        frame_late_s: Delay from the end of an exposure to the arrival of its frame [s].
        truth: Function of the host time [ns] that returns additional labels of a virtual sensor.
        dark_field: Image region that only stress in the skin lights, used to check stillness [px].
    """

    def __init__(
        self,
        run: PathText,
        sensor: str,
        scale: Weighing | None,
        *,
        asked: int = 40,
        session: str = "",
        frames_a_press: int = FRAMES_A_PRESS,
        region: Box | None = None,
        force_range_n: tuple[float, float] | None = None,
        rule: PlateauRule | None = None,
        frame_late_s: float = 0.0,
        truth: Truth | None = None,
        truths: Sequence[str] = (),
        origin: str = "pressed by hand",
        provenance: Provenance = Provenance.MEASURED,
        licence: str = "",
        regions: dict[str, Box] | None = None,
        dark_field: Box | None = None,
        clock: Clock | None = None,
    ) -> None:
        if asked < 1 or frames_a_press < 1:
            raise InputError(f"{asked} presses of {frames_a_press} frames; ask for 1 or more of both")
        self.run, self.scale, self.asked = Path(run), scale, asked
        self._clock = clock or MonotonicClock()
        self._frames_a_press, self._region, self._range = frames_a_press, region, force_range_n
        self._late_ns = round(frame_late_s * NS_PER_S)
        self._truth = truth
        self._lock = threading.RLock()
        self._finder = PlateauFinder(scale, rule) if scale else None
        self._dark_field = dark_field
        self._image = ImagePlateau(region=dark_field)
        self._typed_n: float | None = None
        self._frames: deque[tuple[int, Frame]] = deque()
        self._rest_images: deque[Image] = deque(maxlen=RESTS)
        self._bytes = 0
        self._closed = False
        self.session = session or datetime.now(UTC).strftime("%Y-%m-%d")
        self.presses: list[LabelledPress] = []
        self.refused: deque[Refused] = deque(maxlen=MAX_REFUSED)
        self._refusals = 0
        labels = PRESS_LABELS | dict.fromkeys(truths, "number")
        self._writer = self._opened(sensor, labels, origin, provenance, licence, regions or {})
        self._opened_ns = self._clock.now_ns()

    def on_frame(self, frame: Frame, readings: Readings | None = None) -> None:
        """Take in the next frame."""
        with self._lock:
            if self._closed or frame.fault or frame.arrived_ns < self._opened_ns:
                return
            self._keep(frame.arrived_ns, frame)
            if self._finder is None:
                self._by_image(frame)

    def on_force(self, samples: Sequence[Wrench]) -> None:
        """Take in samples of the scale, oldest first."""
        with self._lock:
            if self._closed or self._finder is None:
                return
            for verdict in self._finder.take(samples):
                self._judge(verdict)

    def label(self, force_n: float) -> None:
        """State the weight that lies on the sensor now; the next one is stated anew [N]."""
        if self._finder is not None:
            raise InputError(
                f"{self._finder.scale.name} labels presses here; to type weights, collect with scale typed"
            )
        if not (np.isfinite(force_n) and force_n > 0):
            raise RangeError(
                f"a weight of {force_n} N; give a finite force above 0 N (100 g are 0.981 N)",
                code="weight-range",
            )
        with self._lock:
            if not self._image.touched:
                raise InputError(
                    "nothing is seen to lie on the sensor; lay the weight on, then state it",
                    code="nothing-pressed",
                )
            self._typed_n = force_n

    @property
    def weight_stated(self) -> bool:
        """Whether a weight was stated of a press that has not ended yet."""
        return self._typed_n is not None

    def rezero(self) -> None:
        """Take what comes next for the untouched sensor."""
        with self._lock:
            for verdict in self._finder.rezero() if self._finder else []:
                self._judge(verdict)
            if self._finder is None:
                self._image = ImagePlateau(region=self._dark_field)

    @property
    def refusals(self) -> int:
        """How many presses did not count."""
        return self._refusals

    @property
    def coverage(self) -> PressCoverage:
        """Where and how hard was pressed."""
        with self._lock:
            return PressCoverage.of(self.presses, self._whole(), self.asked, self._range)

    @property
    def advice(self) -> str:
        """What to mind, in words; empty where nothing is."""
        with self._lock:
            finder = self._finder
            if finder is None:
                if self._image.touched and self._typed_n is None:
                    return "state the weight that lies on the sensor"
                return ""
            newest = self._frames[-1][0] if self._frames else None
            behind_s = 0.0
            if newest is not None and finder.newest_ns is not None:
                behind_s = (newest - finder.newest_ns) / NS_PER_S
            silent = behind_s > BEHIND_S + finder.scale.delay_s
            if finder.fault and (silent or not finder.touched):
                return f"{finder.scale.name} said: {finder.fault}; no press counts until that is mended"
            if finder.newest_ns is None or finder.zero_n is None:
                return f"waiting for {finder.scale.name}; leave the sensor untouched"
            if silent:
                return f"{finder.scale.name} has said nothing for {behind_s:.1f} s; check its cable"
            if finder.touched_s > LONG_S:
                return (
                    f"{finder.scale.name} has felt a touch for {finder.touched_s:.0f} s; take it off. Where "
                    "nothing lies there, its zero has moved: stop, and begin again, which takes it anew"
                )
            most = max((one.force_n for one in self.presses), default=0.0)
            if most and abs(finder.drift_n) > DRIFT_SHARE * most:
                rate = f" ({finder.drift_n_min:+.2g} N a minute)" if finder.drift_n_min else ""
                return (
                    f"the zero of {finder.scale.name} has moved by {finder.drift_n:+.3g} N since the "
                    f"start{rate}; it is taken off, but let the scale warm up"
                )
            return ""

    @property
    def status(self) -> dict[str, Any]:
        """Plain values for the page and for ``--json``."""
        with self._lock:
            coverage, finder = self.coverage, self._finder
            last = self.refused[-1] if self.refused else None
            return {
                "presses": coverage.presses,
                "asked": self.asked,
                "map": coverage.to_dict(),
                "missing": ", ".join(coverage.missing),
                "text": coverage.text,
                "holding": finder.holding if finder else self._image.still is not None,
                "touched": finder.touched if finder else self._image.touched,
                "force_N": finder.force_n if finder else self._typed_n,
                "zero_N": finder.zero_n if finder else None,
                "refused": self._refusals,
                "last_refused": last and {"kind": last.kind, "why": last.why},
                "advice": self.advice,
                "session": self.session,
                "run": str(self.run),
            }

    def close(self) -> None:
        """Judge what is over, and close the run. Closing again does nothing."""
        with self._lock:
            if self._closed:
                return
            for verdict in self._finder.end() if self._finder else []:
                self._judge(verdict)
            self._closed = True
            self._writer.close()

    def __enter__(self) -> PressCollector:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _opened(
        self,
        sensor: str,
        labels: dict[str, LabelKind],
        origin: str,
        provenance: Provenance,
        licence: str,
        regions: dict[str, Box],
    ) -> RunWriter:
        if not (self.run / MANIFEST).is_file():
            manifest = Manifest.new(
                sensor=sensor,
                rig="by hand",
                licence=licence,
                origin=origin,
                provenance=provenance,
                labels=labels,
                targets=("force_N",),
                regions=regions,
            )
            return RunWriter.create(self.run, manifest, clock=self._clock, overflow="wait")
        run = Run.open(self.run)
        lacking = sorted(labels.keys() - run.manifest.labels.keys())
        if run.manifest.sensor != sensor or lacking:
            what = f"has no label {', '.join(lacking)}" if lacking else f"is of {run.manifest.sensor}"
            raise InputError(
                f"{self.run} {what}, and presses of {sensor} were to go on in it; choose another run",
                code="run-differs",
            )
        self.presses = presses_in(run)
        return RunWriter.resume(self.run, clock=self._clock, overflow="wait")

    def _keep(self, at_ns: int, frame: Frame) -> None:
        if self._frames and at_ns - self._frames[-1][0] < NS_PER_S / FRAMES_HZ - 1e6:
            return
        self._frames.append((at_ns, frame))
        self._bytes += frame.image.nbytes
        pressed = self._finder.pending if self._finder else self._image.touched
        delay_s = self.scale.delay_s if self.scale else 0.0
        oldest = at_ns - round((KEPT_S + 2 * delay_s) * NS_PER_S)
        while self._frames and (self._bytes > KEPT_BYTES or (not pressed and self._frames[0][0] < oldest)):
            self._bytes -= self._frames.popleft()[1].image.nbytes

    def _by_image(self, frame: Frame) -> None:
        """Weights that are typed: plateaus are told by the image."""
        ended = self._image.take(frame.arrived_ns, frame.image)
        if ended is None:
            return
        weight_n, self._typed_n = self._typed_n, None
        if weight_n is None:
            why = "no weight was stated while it lay there; lay it on, and state it before you take it off"
            self._judge(Refused("no weight", why, ended.ends_ns))
            return
        # The last frames may already show the weight going.
        ends_ns = ended.ends_ns - round(CLEAR_S * NS_PER_S)
        self._judge(Plateau(ended.begins_ns, ends_ns, weight_n, 0.0, 0.0))

    def _judge(self, verdict: Plateau | Refused) -> None:
        if isinstance(verdict, Plateau):
            verdict = self._record(verdict) or verdict
        if isinstance(verdict, Refused):
            self.refused.append(verdict)
            self._refusals += 1
            self._writer.event("press refused", reason=verdict.kind, why=verdict.why)

    def _record(self, plateau: Plateau) -> Refused | None:
        """Write a press; or why it cannot be."""
        shown = [(at, one, self._middle_ns(at, one)) for at, one in self._frames]
        during = [one for one in shown if plateau.begins_ns <= one[2] <= plateau.ends_ns]
        if not during:
            why = "no frame of the camera came while it was held; check the camera's rate"
            return Refused("late", why, plateau.ends_ns)
        chosen = np.unique(np.linspace(0, len(during) - 1, self._frames_a_press).round().astype(int))
        rests = self._rests_before(shown, plateau)
        during = [during[k] for k in chosen]
        name = f"{len(self.presses) + 1}"
        middle = during[len(during) // 2][1]
        self._rest_images.extend(one.image for _, one in rests)
        place = contact_place(middle.image, self._rest_images, self._whole(middle)) if rests else None
        if len(rests) > 1 and len(self.presses) % REST_EVERY == 0:
            self._write(*rests[0], REST, False, 0.0, 0.0, None)
        if rests:
            self._write(*rests[-1], name, True, 0.0, 0.0, None)
        for at, frame, middle_ns in during:
            force = self._force_of(plateau, middle_ns, frame)
            self._write(at, frame, name, False, force, plateau.spread_n, place)
        self.presses.append(LabelledPress(plateau.force_n, place))
        while self._frames and self._frames[0][0] <= during[-1][0]:  # time only goes forwards in a run
            self._bytes -= self._frames.popleft()[1].image.nbytes
        return None

    def _rests_before(
        self, shown: Sequence[tuple[int, Frame, int]], plateau: Plateau
    ) -> list[tuple[int, Frame]]:
        """Frames of the untouched sensor before a press, from `REST_S` before it on."""
        clear_ns = (plateau.touched_ns or plateau.begins_ns) - CLEAR_S * NS_PER_S
        return [one[:2] for one in shown if clear_ns - REST_S * NS_PER_S < one[2] < clear_ns]

    def _write(
        self,
        at: int,
        frame: Frame,
        press: str,
        reference: bool,
        force_n: float,
        spread_n: float,
        place: tuple[float, float] | None,
    ) -> None:
        labels: dict[str, Label] = {
            "press": press,
            "session": self.session,
            "reference": reference,
            "force_N": force_n,
            "force_spread_N": spread_n,
        }
        if place is not None:
            labels |= {"place_x_px": place[0], "place_y_px": place[1]}
        if self._truth is not None:
            labels |= self._truth(at)
        self._writer.frame(frame.image, time_ns=at, exposure_s=frame.exposure_s, labels=labels)

    def _force_of(self, plateau: Plateau, middle_ns: int, frame: Frame) -> float:
        """Force over a frame's own exposure where the scale is quick enough, else the plateau's [N]."""
        scale = self.scale
        if scale is None or not len(plateau.samples_n) or scale.delay_s > FAST_DELAY_S:
            return plateau.force_n
        half = max((frame.exposure_s or 0.0) / 2, SAMPLES_A_FRAME / 2 / scale.rate_hz) * NS_PER_S
        near = np.abs(plateau.time_ns - middle_ns) <= half
        quick = scale.rate_hz * 2 * half / NS_PER_S >= SAMPLES_A_FRAME and scale.rate_hz >= 50
        return float(plateau.samples_n[near].mean()) if quick and near.any() else plateau.force_n

    def _middle_ns(self, at_ns: int, frame: Frame) -> int:
        """Middle of an exposure [ns]."""
        return at_ns - self._late_ns - round((frame.exposure_s or 0.0) / 2 * NS_PER_S)

    def _whole(self, frame: Frame | None = None) -> Box:
        """The region in which contacts lie."""
        if self._region is not None:
            return self._region
        if frame is None and self._frames:
            frame = self._frames[-1][1]
        if frame is None:
            return 0, 0, 1, 1
        return 0, 0, frame.image.shape[1], frame.image.shape[0]


def presses_in(run: Run) -> list[LabelledPress]:
    """Presses that a run holds, in their order."""
    table = run.labels
    if not len(table):
        return []
    touched = table[~table["reference"].astype(bool) & (table["press"] != REST)]
    found = []
    for _, rows in touched.groupby(["session", "press"], sort=False):
        first = rows.iloc[0]
        x, y = (float(first.get(name, np.nan)) for name in ("place_x_px", "place_y_px"))
        found.append(LabelledPress(float(rows["force_N"].mean()), (x, y) if math.isfinite(x) else None))
    return found


class ScaleCollector(Closing):
    """Collector that asks a scale for its samples with each frame; it opens nothing, and closes both.

    Args:
        scale: that labels them. What a force sensor beside the camera says is not heard.
    """

    def __init__(self, collector: PressCollector, scale: ForceSensor) -> None:
        self._collector, self._scale = collector, scale

    @property
    def run(self) -> Path:
        """Run of the presses."""
        return self._collector.run

    @property
    def status(self) -> dict[str, Any]:
        """Status of the collector."""
        return self._collector.status

    def on_frame(self, frame: Frame, readings: Readings | None = None) -> None:
        """Take in what the scale has said since, then the frame."""
        self._collector.on_force(self._scale.drain())
        self._collector.on_frame(frame, readings)

    def on_force(self, samples: Sequence[Wrench]) -> None:
        """Nothing: another sensor's forces label nothing here."""

    def rezero(self) -> None:
        """Take the scale's zero anew."""
        self._collector.rezero()

    def label(self, force_n: float) -> None:
        """Refuse a weight that is typed, as the collector does beside a scale."""
        self._collector.label(force_n)

    def close(self) -> None:
        """Close the run whole, and the scale."""
        self._collector.close()
        self._scale.close()
