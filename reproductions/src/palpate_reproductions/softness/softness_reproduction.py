"""The softness display's report beside our numbers: ambiguous pairs, stacked specimens, tracking, the foam.

Figures 1 to 3 and 5 are made here, and Figure 6 stands as what it would need: its values are not in the text.
Of the experiments with people, Tables 1 and 2 are recomputed and observers are tested on them, beside what is
printed of Figures 10 and 11 (`judged_softness`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.core import Progress, new_folder, silent
from palpate.mechanics.half_space.hertz import Body, alike_to_the_arm, alike_to_the_skin
from palpate.reports.certificate_page import filled_template
from palpate.reports.softness_figures import (
    bandwidth_panels,
    bench_test_panels,
    pair_panels,
    specimen_panels,
    tracking_panels,
)
from palpate.softness import (
    Characteristic,
    Mode,
    SoftObject,
    SpecimenClass,
    hertz_object,
    polynomial,
    series_spread,
    specimen_object,
    specimens,
)
from palpate.softness.control import FlowServo, PidServo, PressureServo
from palpate.softness.display_bench_test import BenchTest, PressureResponse
from palpate.softness.display_parts import ProportionalValve
from palpate.softness.rendering_simulation import Rendering, simulate
from palpate.softness.virtual.rendering_bench import virtual_bench_test, virtual_pressure_response
from palpate.version import __version__
from palpate_reproductions.softness.judged_page import judged_shown
from palpate_reproductions.softness.judged_softness import JudgedSoftness, judged_entries, judged_softness
from palpate_reproductions.study_results import Published, StudyEntry, study_entry, write_results

SOURCE = "softness-display-2010"
POISSON = 0.5
FINGER_RADIUS_M = 15e-3
PRINTED_FINGER_PA = 100e3  # at which Figure 3's pairs are alike; the text quotes 7 to 33 kPa
QUOTED_PA = (7e3, 20e3, 33e3)
PAIR_N = 2.0
ASSUMED_KPA = (180.0, 130.0, 100.0, 1 / (0.02 - 1 / 130.0), 1 / (0.02 - 1 / 180.0))
"""Assumed moduli of the five silicones, whose sums 1 / E are equal in CL3; Figure 6's are not in the text."""
SPECIMEN_FINGER_PA = 20e3
SPECIMEN_N = 0.6
FREQUENCIES_HZ = (1.0, 3.0, 5.0)
AMPLITUDES_PA = (2e3, 15e3)


def reproduce_softness(out: Path, *, seed: int = 0, progress: Progress = silent) -> list[StudyEntry]:
    """Make the study into a new folder.

    Args:
        out: folder to make; must not exist, and appears when all is done.
        seed: of the sensors' noise and of simulated rankings.
        progress: called with what is being done.

    Returns:
        What ``summary.json`` holds.
    """
    with new_folder(out) as folder:
        pairs = ambiguous_pairs()
        stacked = stacked_specimens(progress)
        tracked = tracking(seed, progress)
        bench = virtual_bench_test(seed=seed, progress=progress)
        answers = pressure_responses(seed, progress)
        entries = [*_pair_entries(pairs), *_specimen_entries(stacked), *_bench_entries(bench)]
        entries += [*_response_entries(answers), *_tracking_entries(tracked)]
        progress("observers", 0, 1)
        judged = judged_softness(stacked, SPECIMEN_N, seed)
        entries += judged_entries(SOURCE, judged)
        write_results(folder, entries, _page(pairs, stacked, bench, answers, tracked, judged, entries, seed))
    return entries


@dataclass(frozen=True, slots=True)
class AmbiguousPair:
    """Two objects that one cue does not tell apart.

    Attributes:
        printed_mm: radius of the other, as printed [mm].
    """

    names: str
    cue: str
    one: Body
    other: Body
    printed_mm: float


def ambiguous_pairs(finger_pa: float = PRINTED_FINGER_PA) -> tuple[AmbiguousPair, AmbiguousPair]:
    """The pairs of Figure 3 under a finger of a modulus [Pa]."""
    finger = _body(finger_pa, FINGER_RADIUS_M)
    a, c = _body(1e6, 2.5e-3), _body(2e5, 30e-3)
    return (
        AmbiguousPair("A and B", "kinesthetic", a, alike_to_the_arm(a, finger, _modulus(1.5e5)), 7.3),
        AmbiguousPair("C and D", "cutaneous", c, alike_to_the_skin(c, finger, _modulus(2e4)), 3.0),
    )


def stacked_specimens(progress: Progress = silent) -> Mapping[str, Sequence[SoftObject]]:
    """The five specimens of each class, under a finger of `SPECIMEN_FINGER_PA`."""
    finger = _body(SPECIMEN_FINGER_PA, FINGER_RADIUS_M)
    found: dict[str, list[SoftObject]] = {}
    for i, kind in enumerate(SpecimenClass):
        progress("specimens", i, len(SpecimenClass))
        stacks = specimens(kind, [1e3 * one for one in ASSUMED_KPA])
        found[kind.value] = [specimen_object(one, finger, SPECIMEN_N) for one in stacks]
    return found


def rendered_objects() -> Mapping[str, tuple[SoftObject, float]]:
    """Objects to track, and the force to which they are pressed [N]."""
    finger = _body(PRINTED_FINGER_PA, FINGER_RADIUS_M)
    ball = hertz_object("ball of 50 kPa and 20 mm", _body(50e3, 20e-3), finger, 8.0)
    area = Characteristic("area", 1e-6 * np.array([0.0, 20, 130]), np.array([0.0, 0.6, 3.9]))
    way = Characteristic("displacement", np.array([0.0, 6e-3]), np.array([0.0, 3.9]))
    line = SoftObject("linear, 6 mm at 3.9 N", area, way, "a table")
    area = polynomial("area", (0.554, 0.33, 1.4), 1e-4, 1.33e-4)
    way = polynomial("displacement", (0.64, 42.0), 1e-2, 0.8e-3)
    foam = SoftObject("the report's foam, displacement read in cm", area, way, "printed polynomials")
    return {"ball": (ball, 1.4), "line": (line, 3.0), "foam": (foam, 2.5)}


def tracking(seed: int = 0, progress: Progress = silent) -> Mapping[str, Rendering]:
    """Presses of each object at each frequency, the ball by a PID too, and the line with another curve."""
    wanted: dict[str, tuple[SoftObject, float, float, PressureServo]] = {
        f"{name}, {f:g} Hz": (soft, peak, f, FlowServo())
        for name, (soft, peak) in rendered_objects().items() for f in FREQUENCIES_HZ
    }  # fmt: skip
    ball, peak = rendered_objects()["ball"]
    wanted |= {f"ball, {f:g} Hz, PID": (ball, peak, f, PidServo()) for f in FREQUENCIES_HZ}
    line, peak = rendered_objects()["line"]
    stiffer = replace(line, displacement=replace(line.displacement, x=0.7 * line.displacement.x))
    wanted["line, 1 Hz, stiffer to the arm"] = (stiffer, peak, 1.0, FlowServo())
    found = {}
    for i, (name, (soft, peak, f, servo)) in enumerate(wanted.items()):
        progress("presses", i, len(wanted))
        found[name] = simulate(soft, Mode.BOTH, peak_n=peak, frequency_hz=f, seed=seed, servo=servo)
    return found


def pressure_responses(seed: int = 0, progress: Progress = silent) -> Mapping[str, PressureResponse]:
    """How fast the pressure follows by each servo, to small sines and to large ones."""
    shut = replace(ProportionalValve(), overlap=ProportionalValve().overlap / 2)
    servos: dict[str, Callable[[], PressureServo]] = {
        "model of the flow": FlowServo,
        "PID": PidServo,
        "model with half the valve's overlap": lambda: FlowServo(valve=shut),
    }
    found = {}
    for i, (name, servo) in enumerate(servos.items()):
        progress("responses", i, len(servos))
        for amplitude_pa in AMPLITUDES_PA:
            answer = virtual_pressure_response(servo(), amplitude_pa, seed=seed)
            found[f"{name}, {amplitude_pa / 1e3:g} kPa"] = answer
    return found


def _modulus(young_pa: float) -> float:
    return young_pa / (1 - POISSON**2)


def _body(young_pa: float, radius_m: float) -> Body:
    return Body(_modulus(young_pa), radius_m)


def _pair_entries(pairs: Sequence[AmbiguousPair]) -> Iterator[StudyEntry]:
    for pair in pairs:
        printed = Published(pair.printed_mm, "Fig. 3")
        name = f"{pair.names}: radius of the other, finger 100 kPa"
        yield study_entry(SOURCE, name, 1e3 * pair.other.radius_m, "mm", printed)
    for finger_pa in QUOTED_PA:
        for pair in ambiguous_pairs(finger_pa):
            name = f"{pair.names}: radius of the other, finger {finger_pa / 1e3:g} kPa"
            yield study_entry(SOURCE, name, 1e3 * pair.other.radius_m, "mm")
    finger = _body(20e3, FINGER_RADIUS_M)
    for pair in pairs:
        one, other = (body.against(finger) for body in (pair.one, pair.other))
        ways = float(one.approach_m(1.0)) / float(other.approach_m(1.0))
        areas = float(one.area_m2(1.0)) / float(other.area_m2(1.0))
        ratio = (ways if pair.cue == "kinesthetic" else areas) ** 1.5
        name = f"{pair.names}: force of the other over the one, {pair.cue} cue, finger 20 kPa"
        yield study_entry(SOURCE, name, ratio, "1")


def _specimen_entries(stacked: Mapping[str, Sequence[SoftObject]]) -> Iterator[StudyEntry]:
    mirrored = specimens(SpecimenClass.MIRRORED, [1e3 * one for one in ASSUMED_KPA])
    name = "CL3: springs in a line differ, with the assumed moduli"
    yield study_entry(SOURCE, name, 100 * series_spread(mirrored), "%")
    for kind, objects in stacked.items():
        ways = [float(one.displacement.at_force(SPECIMEN_N)) for one in objects]
        areas = [float(one.area.at_force(SPECIMEN_N)) for one in objects]
        for said, values in (("displacement", ways), ("area", areas)):
            spread = 100 * (max(values) / min(values) - 1)
            yield study_entry(
                SOURCE, f"{kind}: greatest over least {said} at {SPECIMEN_N:g} N, less 1", spread, "%"
            )


def _bench_entries(test: BenchTest) -> Iterator[StudyEntry]:
    fit = test.fit()
    yield study_entry(SOURCE, "bench test: P = p A(s) + k s off by, RMS", 1e3 * test.rms_n, "mN")
    yield study_entry(SOURCE, "bench test: the same, of the peak", 100 * test.rms_n / test.peak_n, "%")
    yield study_entry(SOURCE, "bench test: fitted over stated p A(s)", fit.scale, "1")
    yield study_entry(SOURCE, "bench test: fitted sleeve", fit.sleeve_n_m, "N/m")
    yield study_entry(SOURCE, "bench test: fitted friction", 1e3 * fit.friction_n, "mN")


def _response_entries(answers: Mapping[str, PressureResponse]) -> Iterator[StudyEntry]:
    for name, answer in answers.items():
        yield study_entry(SOURCE, f"pressure by {name}: -3 dB at", answer.bandwidth_hz, "Hz")
        yield study_entry(SOURCE, f"pressure by {name}: greatest gain", answer.peak, "1")


def _tracking_entries(tracked: Mapping[str, Rendering]) -> Iterator[StudyEntry]:
    for name, felt in tracked.items():
        for cue, off in (("area", felt.off_area_n()), ("displacement", felt.off_displacement_n())):
            yield study_entry(
                SOURCE, f"{name}: force over {cue}, RMS of the peak", 100 * felt.share(off), "%"
            )
            inside = 100 * felt.share(off, felt.inside)
            yield study_entry(SOURCE, f"{name}: force over {cue}, inside the envelope", inside, "%")
        yield study_entry(SOURCE, f"{name}: energy given back, three presses", 1e3 * felt.given_back_j, "mJ")
    one, other = tracked["line, 1 Hz"], tracked["line, 1 Hz, stiffer to the arm"]
    moved = 100 * _mean_difference(one, other) / one.peak_n
    yield study_entry(
        SOURCE, "line: another displacement curve moves force over area by, of the peak", moved, "%"
    )


def _mean_difference(one: Rendering, other: Rendering) -> float:
    """Greatest difference of the mean forces at ten bins of area [N]."""
    edges = 1e-6 * np.linspace(20.0, 95.0, 11)

    def means(felt: Rendering) -> np.ndarray:
        at = np.digitize(felt.area_m2[felt.scored], edges)
        return np.array([felt.force_n[felt.scored][at == i].mean() for i in range(1, len(edges))])

    return float(np.abs(means(one) - means(other)).max())


def _page(
    pairs: Sequence[AmbiguousPair],
    stacked: Mapping[str, Sequence[SoftObject]],
    bench: BenchTest,
    answers: Mapping[str, PressureResponse],
    tracked: Mapping[str, Rendering],
    judged: JudgedSoftness,
    entries: Sequence[StudyEntry],
    seed: int,
) -> str:
    shown = {}
    for pair in pairs:
        objects = dict(zip(pair.names.split(" and "), (pair.one, pair.other), strict=True))
        for kpa in (100, 20):
            finger = _body(1e3 * kpa, FINGER_RADIUS_M)
            shown[f"{pair.names}, {pair.cue}, finger {kpa} kPa"] = pair_panels(objects, finger, PAIR_N)
    return filled_template(
        "softness_study.html",
        "palpate_reproductions",
        version=__version__,
        seed=seed,
        entries=entries,
        beside=[one for one in entries if one["published"] is not None and "Fig. 3" in one["source"]],
        assumed_kpa=ASSUMED_KPA,
        finger_kpa=SPECIMEN_FINGER_PA / 1e3,
        pairs=shown,
        stacked={kind: specimen_panels(objects) for kind, objects in stacked.items()},
        bench=bench_test_panels(bench),
        bench_off={"mn": 1e3 * bench.rms_n, "percent": 100 * bench.rms_n / bench.peak_n},
        answers=bandwidth_panels(answers),
        tracked={name: tracking_panels(felt) for name, felt in tracked.items()},
        **judged_shown(judged, entries),
    )
