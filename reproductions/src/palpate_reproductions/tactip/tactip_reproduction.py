"""The compliance report reproduced on the virtual TacTip.

Its figures 5 to 9, its p-values, and the new specimen's stiffness are set beside what is found here.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.calibration.compliance.compliance_reading import AreaCourse, read_touch
from palpate.calibration.compliance.press_cues import PressCues
from palpate.core import InputError, Progress, Reading, new_folder, refuse_existing, silent
from palpate.psychophysics import Comparison, compare
from palpate.reports.certificate_page import filled_template
from palpate.reports.compliance_figures import Courses
from palpate.rig.virtual.linear_rig import LINEAR_RIG
from palpate.sensors.tactip import tactip
from palpate.version import __version__
from palpate_reproductions import study_figures as draw
from palpate_reproductions.study_results import Published, StudyEntry, study_entry, write_results
from palpate_reproductions.tactip.tactip_conditions import Row, compared, order
from palpate_reproductions.tactip.tactip_setup import (
    ADJUSTED_R2,
    DUNN_P,
    KAPPA,
    KAPPA_NEW,
    KRUSKAL_P,
    NAMES,
    NEW,
    RANK_SUM_P,
    Displacement,
    Experiment,
    Plate,
    kappa_n_m,
    press_all,
    stiffness_line,
    under_plate,
)

TILTS = (0, 30, 45)
TRIALS = 5
SOURCE = "tactip-compliance-casr"
CUES = {
    "spread_rate_mm2_per_N": "spread rate dA/dF [mm²/N]",
    "area_at_4_N_mm2": "area at 4 N [mm²]",
    "divergence_paper_per_N": "divergence, eq. (12) [1/N]",
    "divergence_regression_per_N": "divergence, regression [1/N]",
}


CONTROLS = ("as assumed", "half the speed", "twice the speed", "20 frames each", "tight crop", "linear rig")
"""Of `controls`: what equation (12) says when frames, and not specimens, change."""

OVER: tuple[Displacement, ...] = ("encoder", "command")
"""Displacements over which force is set on the linear rig."""

SHOWN = (("disc", "paper"), ("contact", "paper"), ("disc", "secant"), ("contact", "secant"))


@dataclass(frozen=True)
class Study:
    """All that was made.

    Attributes:
        plates: specimens under a rigid plate on an ideal rig.
        driven: the same on the linear rig, by the displacement over which force is set.
        experiments: by tilt [deg].
        seed, trials, seconds: as asked for, and what it took.
    """

    plates: Mapping[str, Plate]
    driven: Mapping[Displacement, Mapping[str, Plate]]
    experiments: Mapping[int, Experiment]
    controls: tuple[Row, ...]
    seed: int
    trials: int
    seconds: float


def reproduce_tactip(
    out: Path, *, seed: int = 0, trials: int = TRIALS, progress: Progress = silent
) -> list[StudyEntry]:
    """Make ``report.html`` and ``summary.json``.

    Args:
        out: folder to make; it appears when all is done.
        trials: of each specimen at each tilt, beside as many that calibrate; 2 or more.
        progress: called at every press.

    Returns:
        What ``summary.json`` holds.
    """
    if trials < 2:
        raise InputError(f"{trials} trials; 2 or more, the report has 5", code="trial-count")
    refuse_existing(out)
    began, spec = time.perf_counter(), tactip()
    plates = {name: under_plate(spec, name, trials, seed) for name in NAMES}
    driven = {
        over: {name: under_plate(spec, name, trials, seed, LINEAR_RIG, over) for name in NAMES}
        for over in OVER
    }
    experiments = {
        tilt: press_all(spec, tilt, seed, calibrating=trials, testing=trials, progress=progress)
        for tilt in TILTS
    }
    controls: list[Row] = []
    for i, name in enumerate(CONTROLS):
        controls += compared((name,), range(trials))
        progress("controls of divergence", i + 1, len(CONTROLS))
    study = Study(plates, driven, experiments, tuple(controls), seed, trials, time.perf_counter() - began)
    entries = list(entries_of(study))
    with new_folder(out) as building:
        write_results(building, entries, tactip_page(study, entries))
    return entries


def entries_of(study: Study) -> Iterator[StudyEntry]:
    """Every number."""
    yield from _plate_entries(study.plates)
    yield from _driven_entries(study)
    for experiment in study.experiments.values():
        yield from _tilt_entries(experiment)
    for row in shown_controls(study):
        name = f"0 degrees, {row.condition}: {row.way} over the {row.region}, softest over stiffest"
        yield entry(name, row.mean[-1] / row.mean[0], "1")
        yield entry(f"{name}, concordance", row.concordance, "1")


def shown_controls(study: Study) -> list[Row]:
    """Controls by flow, over the pins' disc and the true contact, equation (12) and the secant."""
    return [
        row
        for region, way in SHOWN
        for row in study.controls
        if (row.source, row.region, row.way) == ("flow", region, way)
    ]


def _plate_entries(plates: Mapping[str, Plate]) -> Iterator[StudyEntry]:
    for name, plate in plates.items():
        slopes = [1e-3 * line.slope for line in plate.lines]
        yield entry(f"stiffness of {name} by a rigid plate", np.mean(slopes), "N/mm", KAPPA[name], PLATE_WHY)
    worst = min(line.adjusted_r2 for plate in plates.values() for line in plate.lines)
    yield entry("adjusted R2 of these lines, the worst", worst, "1", ADJUSTED_R2, R2_WHY)
    by_trial = compare({n: [1e-3 * line.slope for line in p.lines] for n, p in plates.items() if n != NEW})
    p = max(pair.rank_sum_p for pair in by_trial.pairs)
    yield entry("rank-sum p of these, one value a trial, worst pair", p, "1", RANK_SUM_P, RANK_WHY)


def _driven_entries(study: Study) -> Iterator[StudyEntry]:
    yield entry("linear rig: droop at 5 N", 1e3 * LINEAR_RIG.droop_m(5.0), "mm")
    for name, (by_encoder, by_command, expected) in driven_kappa(study).items():
        at = f"linear rig: stiffness of {name} by a rigid plate"
        yield entry(f"{at}, over the encoder's displacement", by_encoder, "N/mm")
        yield entry(f"{at}, over the commanded displacement", by_command, "N/mm")
        yield entry(f"{at}, over the commanded displacement, by 1/kappa + 1/Kp", expected, "N/mm")


def driven_kappa(study: Study) -> dict[str, tuple[float, float, float]]:
    """Stiffness of every specimen on the linear rig [N/mm].

    Over the encoder's displacement, over the commanded one, and what the latter is expected to be: the
    droop is a spring Kp in series.
    """
    result = {}
    for name in NAMES:
        found = [1e-3 * np.mean([line.slope for line in study.driven[over][name].lines]) for over in OVER]
        expected = 1e-3 / (1 / kappa_n_m(name) + 1 / LINEAR_RIG.stiffness_n_m)
        result[name] = (float(found[0]), float(found[1]), expected)
    return result


def _tilt_entries(one: Experiment) -> Iterator[StudyEntry]:
    at = f"{one.tilt_deg} degrees"
    for how, reading in stiffness_readings(one).items():
        for part, value in zip(("", ", low", ", high"), _n_per_mm(reading), strict=True):
            printed = KAPPA_NEW[one.tilt_deg] if not part and how == "touch alone" else None
            yield entry(f"{at}: new specimen by {how}{part}", value, "N/mm", printed, NEW_WHY)
    for cue, label in CUES.items():
        by_paper = cue == "divergence_paper_per_N"
        line, new = stiffness_line(one, cue)
        printed = KAPPA_NEW[one.tilt_deg] if by_paper else None
        yield entry(f"{at}: new specimen by a line over {label}", line.at(new)[0], "N/mm", printed, LINE_WHY)
        tests = rank_tests_of(one, cue)
        kruskal = KRUSKAL_P if one.tilt_deg == 0 and by_paper else None
        dunn = DUNN_P[one.tilt_deg] if by_paper else None
        yield entry(f"{at}: {label}, Kruskal-Wallis p", tests.kruskal_p, "1", kruskal, KRUSKAL_WHY)
        worst = max(pair.dunn_p for pair in tests.pairs)
        yield entry(f"{at}: {label}, Dunn p, worst pair", worst, "1", dunn, DUNN_WHY)
        for name, mean in means(one, cue).items():
            yield entry(f"{at}: {label} of {name}", mean, label.split("[")[1].rstrip("]"))
    for name, (error, spread) in area_errors(one).items():
        yield entry(f"{at}: contact area of {name}, median error over 1 to 5 N", 100 * error, "%")
        yield entry(f"{at}: contact area of {name} at 4 N, spread between trials", 100 * spread, "%")


PLATE_WHY = "virtual specimens were given the printed values; what differs is noise and where contact begins"
R2_WHY = "virtual specimens are linear, with the sensor's noise; real silicone and first contact are not"
RANK_WHY = (
    "the printed p needs some 160 independent samples a group, and samples of one trial are not independent; "
    "with so few trials complete separation gives the value found here, and no test can give less"
)
NEW_WHY = "another route: the motion of all pins, calibrated on a rigid plate and S1 to S3; virtual"
LINE_WHY = "the printed route, with the sum over frames of equation (12), on a virtual tip"
KRUSKAL_WHY = (
    "the printed p and the printed post-hoc p exclude each other: a worst pair at 0.01 forces p below 7e-6"
)
DUNN_WHY = "'LSD' after Kruskal-Wallis is Dunn's test uncorrected: 3 x 10 trials cannot give less than 0.011"


def entry(
    name: str, value: float | np.floating[Any], unit: str, printed: Published | None = None, why: str = ""
) -> StudyEntry:
    """One number, beside what the report prints of it, and why the two differ."""
    return {**study_entry(SOURCE, name, value, unit, printed), "why": why if printed else ""}


def stiffness_readings(one: Experiment) -> dict[str, Reading]:
    """Stiffness of the new specimen, by each way in which it was read."""
    touch = one.touch
    both = {} if touch.stiffness_both is None else {"both cues": touch.stiffness_both}
    return {"touch alone": touch.stiffness} | both


def _n_per_mm(reading: Reading) -> tuple[float, float, float]:
    """A stiffness with its interval [N/mm]."""
    return 1e-3 * reading.value, 1e-3 * reading.low, 1e-3 * reading.high


def groups_of(one: Experiment, cue: str, names: Sequence[str] = NAMES) -> dict[str, list[float]]:
    """Values of every specimen, one a trial."""
    rows = one.table[["specimen", cue]].dropna()
    return {name: rows.loc[rows["specimen"] == name, cue].tolist() for name in names}


def means(one: Experiment, cue: str) -> dict[str, float]:
    """Mean of every specimen."""
    return {name: float(np.mean(values)) for name, values in groups_of(one, cue).items()}


def rank_tests_of(one: Experiment, cue: str) -> Comparison:
    """Rank tests between S1, S2 and S3."""
    return compare(groups_of(one, cue, ("S1", "S2", "S3")))


def area_errors(one: Experiment) -> dict[str, tuple[float, float]]:
    """Median error of every specimen's area over 1 to 5 N, and its spread between trials at 4 N."""
    results = {}
    for name, cues in one.unseen().items():
        off, level = [], []
        for cue in cues:
            course = _course(one, cue)
            assert cue.trial.area_m2 is not None
            inside = (course.force_n >= 1) & (course.force_n <= 5)
            off.append(np.abs(course.area_m2[inside, 0] / cue.trial.area_m2[inside] - 1))
            level.append(np.interp(4.0, course.force_n, course.area_m2[:, 0]))
        results[name] = (float(np.median(np.concatenate(off))), float(np.std(level, ddof=1) / np.mean(level)))
    return results


def _course(one: Experiment, cue: PressCues) -> AreaCourse:
    course = read_touch(one.calibration, [cue.trial.press]).course
    assert course is not None
    return course


def tactip_page(study: Study, entries: Sequence[StudyEntry]) -> str:
    """The report's HTML."""
    by_tilt = {t: {cue: means(one, cue) for cue in CUES} for t, one in study.experiments.items()}
    return filled_template(
        "tactip_study.html",
        "palpate_reproductions",
        version=__version__,
        seed=study.seed,
        trials=study.trials,
        seconds=study.seconds,
        beside=[one for one in entries if one["published"] is not None],
        tilts=TILTS,
        names=NAMES,
        cues=CUES,
        kappa={name: printed.value for name, printed in KAPPA.items()},
        means=by_tilt,
        orders={t: {cue: order([*of.values()]) for cue, of in cues.items()} for t, cues in by_tilt.items()},
        tests={t: {cue: rank_tests_of(one, cue) for cue in CUES} for t, one in study.experiments.items()},
        areas={t: area_errors(one) for t, one in study.experiments.items()},
        controls=shown_controls(study),
        driven=driven_kappa(study),
        rig={"stiffness": 1e-3 * LINEAR_RIG.stiffness_n_m, "droop": 1e3 * LINEAR_RIG.droop_m(5.0)},
        calibration={t: one.calibration for t, one in study.experiments.items()},
        figures=_figures(study),
    )


def _figures(study: Study) -> dict[str, Any]:
    figures: dict[str, Any] = {
        "plate": draw.plate_figure(
            {n: _plate_samples(p) for n, p in study.plates.items()},
            {n: [1e-3 * line.slope for line in p.lines] for n, p in study.plates.items()},
            {n: (1e-3 * p.lines[0].slope, p.lines[0].start) for n, p in study.plates.items()},
        ),
        "trend": {t: draw.trend_figure(_panels(one)) for t, one in study.experiments.items()},
        "line": {
            t: draw.line_figure([_compared_value(one, cue) for cue in CUES])
            for t, one in study.experiments.items()
        },
    }
    rows, printed = {}, {}
    for t, one in study.experiments.items():
        for how, reading in stiffness_readings(one).items():
            rows[f"{t}°, {how.removesuffix(' alone')}"] = _n_per_mm(reading)
        for cue in ("spread_rate_mm2_per_N", "divergence_paper_per_N"):
            rows[f"{t}°, line over {CUES[cue].split(' [')[0]}"] = _compared_value(one, cue).new
        printed[f"{t}°, line over {CUES['divergence_paper_per_N'].split(' [')[0]}"] = KAPPA_NEW[t].value
    figures["new"] = draw.forest_figure(rows, KAPPA[NEW].value, printed)
    return figures


def _plate_samples(plate: Plate) -> tuple[Any, Any]:
    """The first trial's samples between 0.5 and 5 N."""
    inside = (plate.force_n >= 0.5) & (plate.force_n <= 5)
    return 1e3 * plate.position_m[inside], plate.force_n[inside]


def _panels(one: Experiment) -> dict[str, tuple[Courses, draw.Groups]]:
    """Contact area and the report's own sum, over force."""
    unseen = one.unseen()
    area = {
        name: [(c.force_n, 1e6 * c.area_m2[:, 0]) for c in (_course(one, cue) for cue in cues)]
        for name, cues in unseen.items()
    }
    summed = {
        name: [(cue.reported.force_n, cue.reported.summed) for cue in cues] for name, cues in unseen.items()
    }
    return {
        "contact area [mm²]|spread rate dA/dF [mm²/N]": (area, groups_of(one, "spread_rate_mm2_per_N")),
        "eq. (12) up to this force, over A0 [1/N]|eq. (12) above 2.5 N, over A0 [1/N]": (
            summed,
            groups_of(one, "divergence_paper_per_N"),
        ),
    }


def _compared_value(one: Experiment, cue: str) -> draw.ComparedValue:
    line, new = stiffness_line(one, cue)
    return draw.ComparedValue(
        CUES[cue],
        groups_of(one, cue, ("S1", "S2", "S3")),
        {name: printed.value for name, printed in KAPPA.items()},
        line.slope,
        line.start,
        new,
        line.at(new),
        KAPPA[NEW].value,
    )
