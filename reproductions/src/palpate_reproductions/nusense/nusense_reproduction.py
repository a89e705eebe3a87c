"""The NUSense thesis's chapter 4 on the virtual pad: recorded, read, and set beside what is printed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import Frame, InputError, Progress, silent
from palpate.estimators.shear import ShearReader, ShearTouch
from palpate.reports.certificate_page import filled_template
from palpate.reports.shear_page import touch_pictures
from palpate.sensors.nusense.nusense_sensor import ARM_M
from palpate.version import __version__
from palpate_reproductions.nusense import nusense_experiments as made, skin_figures as draw
from palpate_reproductions.nusense.nusense_setup import (
    CYCLES,
    OFFSET_N,
    PLACE_MM,
    PLACE_SPREAD_MM,
    SLOPE_N,
    NuSenseStudy,
    StudyScale,
)
from palpate_reproductions.study_results import (
    REPORT_FILE,
    SUMMARY_FILE,
    Published,
    StudyEntry,
    kept_seconds,
    study_entry,
    unfinished_work,
    write_results,
)

SOURCE = "nusense-shear"
Found = Mapping[str, Any]

STAGES: dict[str, dict[str, Callable[[NuSenseStudy], Any]]] = {
    "force": {
        "force": made.force_lines,
        "published": made.published_baseline,
        "transfer": made.on_other_days_and_pads,
    },
    "places": {"places": made.places},
    "hysteresis": {"loops": made.loops},
    "cycles": {"cycles": made.cycles},
    "edges": {"edges": made.edges},
    "damage": {"damage": made.damage},
    "controls": {"no-contact": made.no_contact},
}
"""Part -> what makes each of its results, in the order in which they are made."""
READ: dict[str, tuple[str, ...]] = {
    "force": ("force", "session", "copy-1", "copy-2"),
    "hysteresis": made.LOOP_PADS,
    "cycles": ("cycles",),
    "damage": made.PADS,
}
RECORDED: dict[str, tuple[str, ...]] = {
    "places": ("places",),
    "edges": ("edges",),
    "controls": ("force", "places", "cycles"),
}
"""Part -> recordings that are read whole, and those of which some frames are."""
PARTS = ("all", *STAGES)

TOLD = {"pressure": "centre of the pressure", "ring": "centre of the ring"}
EDGES = {"pressure": "axis of the pressure", "moved": "PCA of the most moved samples, as published"}
PADS = {"pad-1": "case 1, copy 1", "pad-2": "case 2, copy 2", "torn": "case 3, torn"}
LOOPS = {
    "hysteresis": "as designed, 8 N",
    "lighter": "as designed, 6 N",
    "softer": "half the gel's modulus, 6 N",
}
READ_ON = {"session": "another day", "copy-1": "copy 1", "copy-2": "copy 2"}


def reproduce_nusense(
    out: Path, scale: StudyScale, *, seed: int = 0, part: str = "all", progress: Progress = silent
) -> list[StudyEntry]:
    """Record, read and write up the study into a new folder.

    Interrupted, the same call goes on at what is missing.

    Args:
        out: folder to make; must not exist. It appears when everything is done, with the recordings in it.
        progress: called with what is being done.

    Returns:
        What ``summary.json`` holds.
    """
    if part not in PARTS:
        raise InputError(f"there is no part {part!r}; there are {', '.join(PARTS)}", code="unknown-name")
    asked = {"study": "nusense", "scale": scale.name, "seed": seed, "part": part}
    study = NuSenseStudy(unfinished_work(out, asked), scale, seed, progress)
    found: dict[str, Any] = {}
    for one in STAGES if part == "all" else (part,):
        for name in RECORDED.get(one, ()):
            study.run(name)
        for name in READ.get(one, ()):
            study.cues(name)
        found |= {name: study.kept(name, partial(make, study)) for name, make in STAGES[one].items()}
    for name in (SUMMARY_FILE, REPORT_FILE):  # of a write-up that was stopped
        (study.folder / name).unlink(missing_ok=True)
    entries = list(entries_of(found))
    write_results(study.folder, entries, nusense_page(study, found, entries))
    study.folder.rename(out)
    return entries


SLOPE_WHY = (
    "gamma counts pixels: the virtual picture is 640 px wide, so that its tiles move fewer pixels; the "
    "thesis prints no size of its picture"
)
OFFSET_WHY = (
    "the virtual pad's gamma goes with force from the first touch on; a line through two tips, as the "
    "caption of Fig. 4-1 has them, has a negative offset here too"
)
PLACE_WHY = (
    "the virtual arm is off by 0.03 mm, the real one by up to 0.1 mm, and its indenter was set to the middle "
    "by hand; how the thesis tells the centre is not printed"
)
CYCLES_WHY = "as many touches as the thesis has"


def entry(
    name: str, value: float | None, unit: str, printed: Published | None = None, why: str = ""
) -> StudyEntry:
    """One number, beside what the thesis prints of it, and why the two differ."""
    number = np.nan if value is None else value
    return {**study_entry(SOURCE, name, number, unit, printed), "why": why if printed else ""}


def entries_of(found: Found) -> Iterator[StudyEntry]:
    """Every number of the parts that were made."""
    makers = {
        "force": _force_entries,
        "published": _published_entries,
        "transfer": _transfer_entries,
        "places": _place_entries,
        "loops": _loop_entries,
        "cycles": _cycle_entries,
        "edges": _edge_entries,
        "damage": _damage_entries,
        "no-contact": _control_entries,
    }
    for name, make in makers.items():
        if name in found:
            yield from make(found[name])


PRINTED_LINE = "as the text has it: flat to 3 N, round to 8 N"


def _force_entries(found: Found) -> Iterator[StudyEntry]:
    for how in ("loading", "whole cycles"):
        for name, line in found[how].items():
            beside = how == "loading" and name == PRINTED_LINE
            at = f"force, {how}, {name}"
            yield entry(f"{at}: slope", line["slope"], "N", SLOPE_N if beside else None, SLOPE_WHY)
            yield entry(f"{at}: offset", line["offset"], "N", OFFSET_N if beside else None, OFFSET_WHY)
            yield entry(f"{at}: R2", line["r2"], "1")
            yield entry(f"{at}: mean absolute error, presses held out", line["mae"], "N")
    yield entry("force: gamma of the untouched pad", found["gamma_at_rest"], "1")
    yield entry("control: R2 with the forces dealt out anew", found["shuffled_r2"], "1")


def _published_entries(found: Found) -> Iterator[StudyEntry]:
    for tip in (made.ROUND, made.FLAT):
        at, one = f"equation (3.1), {tip}", found[tip]
        yield entry(f"{at}: slope", one["slope_N"], "N")
        yield entry(f"{at}: gamma over the measured", one["gamma_over_measured"], "1")
        yield entry(f"{at}: mean absolute error, nothing fitted", one["mae_N"], "N")
        yield entry(f"{at}: mean absolute error, one scale, presses held out", one["one_scale_mae_N"], "N")


def _transfer_entries(found: Found) -> Iterator[StudyEntry]:
    for on, one in found.items():
        for law, errors in one["laws"].items():
            yield entry(f"force on {on}: {law}, mean absolute error", errors["mae_N"], "N")
            if "covered" in errors:
                yield entry(
                    f"force on {on}: {law}, truths in the 90 % interval", 100 * errors["covered"], "%"
                )
        for name, error in one["baselines"].items():
            yield entry(f"force on {on}: baseline {name}, mean absolute error", error, "N")
        for way, error in one["whole cycles"].items():
            how = "history known" if way.startswith("followed") else "single frames"
            yield entry(f"force on {on}: whole cycles, {how}, mean absolute error", error, "N")
        for how in ("unknown stiffness", "weighed"):
            if how in one:
                yield entry(f"force on {on}: {how}, mean absolute error", one[how]["mae_N"], "N")
                covered = 100 * one[how]["covered"]
                yield entry(f"force on {on}: {how}, truths in the 90 % interval", covered, "%")


def _place_entries(found: Found) -> Iterator[StudyEntry]:
    for by, said in TOLD.items():
        one = found[by]
        first = by == "ring"  # the annulus, as published
        yield entry(f"places by {said}: told", 100 * one["told"] / one["of"], "%")
        printed = PLACE_MM if first else None
        yield entry(f"places by {said}: RMS", one.get("rms_mm"), "mm", printed, PLACE_WHY)
        printed = PLACE_SPREAD_MM if first else None
        yield entry(
            f"places by {said}: SD of the rounds' RMS", one.get("rounds_spread_mm"), "mm", printed, PLACE_WHY
        )
        yield entry(f"places by {said}: greatest", one.get("greatest_mm"), "mm")
        for axis, shift in zip("xy", one.get("shift_mm", ()), strict=False):
            yield entry(f"places by {said}: mean shift along {axis}", shift, "mm")
        for place, value in one.get("per_place_mm", {}).items():
            yield entry(f"places by {said}: RMS at {place}", value, "mm")
    inside = [held for one in found["touches"] if one["pressure_mm"] for held in one["inside"]]
    yield entry(
        "places: coordinates in the 90 % interval of arm and reading", 100 * float(np.mean(inside)), "%"
    )
    yield entry("places: error of the virtual arm alone, RMS", 1e3 * ARM_M * np.sqrt(2), "mm")


def _loop_entries(found: Found) -> Iterator[StudyEntry]:
    units = {"area": "N", "share": "1", "width": "N", "off_line": "N", "gamma": "1"}
    names = {
        "area": "area of the loop",
        "share": "area over that below loading",
        "width": "width at half of the greatest gamma",
        "off_line": "RMS off its own line",
        "gamma": "greatest gamma",
    }
    for pad, said in LOOPS.items():
        for key, name in names.items():
            yield entry(f"hysteresis, {said}: {name}", found[pad]["mean"][key], units[key])
    for key in ("area", "width", "share", "off_line"):
        ratio = found["softer"]["mean"][key] / found["lighter"]["mean"][key]
        yield entry(f"hysteresis to 6 N, softer over designed: {names[key]}", ratio, "1")


def _cycle_entries(found: Found) -> Iterator[StudyEntry]:
    yield entry("cycles: touches", found["touches"], "1", CYCLES, CYCLES_WHY)
    for name, one in found["drift"].items():
        unit = "1" if name.startswith("gamma") else "N"
        yield entry(f"cycles: {name}, mean", one["mean"], unit)
        yield entry(f"cycles: {name}, standard deviation", one["spread"], unit)
        yield entry(f"cycles: {name}, change from first to last", one["change"], unit)
        yield entry(f"cycles: {name}, standard error of that change", one["error"], unit)
    top = np.array(found["greatest_gamma"])
    yield entry(
        "cycles: greatest gamma, standard deviation over mean", 100 * top.std(ddof=1) / top.mean(), "%"
    )


def _edge_entries(found: Found) -> Iterator[StudyEntry]:
    for by, said in EDGES.items():
        one = found[by]
        yield entry(f"edges by {said}: told", 100 * one["told"] / one["of"], "%")
        yield entry(f"edges by {said}: median error", one.get("median_deg"), "deg")
        yield entry(f"edges by {said}: 95 % within", one.get("at_95_deg"), "deg")
        yield entry(f"edges by {said}: greatest error", one.get("greatest_deg"), "deg")
        covered = one.get("covered")
        yield entry(
            f"edges by {said}: in their 90 % interval", None if covered is None else 100 * covered, "%"
        )


def _damage_entries(found: Found) -> Iterator[StudyEntry]:
    for pad, said in PADS.items():
        line = found[pad]["line"]
        for key, name, unit in (
            ("slope", "slope", "N"),
            ("offset", "offset", "N"),
            ("r2", "R2", "1"),
            ("rms", "RMS off the line", "N"),
        ):
            yield entry(f"damage, {said}: {name}", line[key], unit)
        off = found[pad].get("off_by_line_of_first_N")
        if off is not None:
            yield entry(f"damage, {said}: read by case 1's line, greatest mean error", np.abs(off).max(), "N")
    for pad, said in PADS.items():
        flags = found[pad]["flags"]
        for when in ("rest", "pressed"):
            share = 100 * flags[when] / flags[f"{when}_of"] if flags[f"{when}_of"] else None
            yield entry(f"damage, {said}: looks torn, {when}", share, "%")
    for gap in found["gaps"]:
        for before, flags in gap["flags"].items():
            for when in ("rest", "pressed"):
                at = f"damage, cut of {gap['gap_mm']:g} mm against {before}"
                yield entry(f"{at}: looks torn, {when}", 100 * flags[when] / flags[f"{when}_of"], "%")


def _control_entries(found: Found) -> Iterator[StudyEntry]:
    yield entry("control: untouched frames", found["frames"], "1")
    yield entry("control: untouched frames with a contact", found["contacts"], "1")


def nusense_page(study: NuSenseStudy, found: Found, entries: Sequence[StudyEntry]) -> str:
    """The report's HTML."""
    return filled_template(
        "nusense_study.html",
        "palpate_reproductions",
        version=__version__,
        scale=study.scale.name,
        seed=study.seed,
        seconds=sum(kept_seconds(study.folder).values()),
        found=found,
        beside=[one for one in entries if one["published"] is not None],
        told=TOLD,
        edge_ways=EDGES,
        arm_mm=1e3 * ARM_M * float(np.sqrt(2)),
        pads=PADS,
        pad_loops=LOOPS,
        read_on=READ_ON,
        figures=_figures(study, found),
    )


def _figures(study: NuSenseStudy, found: Found) -> dict[str, str]:
    figures: dict[str, str] = {}
    if "force" in found:
        lines = {tip: found["force"]["loading"][f"{tip}, 1 to 8 N"] for tip in (made.ROUND, made.FLAT)}
        shown = [
            draw.ForceLineShown(
                tip, points["gamma"], points["force_N"], lines[tip]["slope"], lines[tip]["offset"]
            )
            for tip, points in found["force"]["points"].items()
        ]
        figures["force"] = draw.force_lines(
            shown, (SLOPE_N.value, OFFSET_N.value), found["published"]["curves"]
        )
    if "places" in found:
        touches = found["places"]["touches"]
        by_place = {f"{by}_mm": found["places"][by].get("per_place_mm", {}) for by in TOLD}
        middle = min(touches, key=lambda one: float(np.hypot(*one["true_mm"])))
        figures["press"] = touch_pictures(*_touch(study, "places", middle["frame"]))
        figures["press_shift"] = draw.shift_map(_touch(study, "places", middle["frame"])[2].fields)
        figures["places"] = draw.place_errors(touches, {f"{by}_mm": s for by, s in TOLD.items()}, by_place)
    if "loops" in found:
        courses = {said: found["loops"][pad]["course"] for pad, said in LOOPS.items()}
        figures["loops"] = draw.hysteresis_loops(courses)
    if "cycles" in found:
        one = found["cycles"]
        figures["cycles"] = draw.repeated_touches(one["gamma_at_5_N"], one["greatest_gamma"], "γ at 5 N [1]")
    if "edges" in found:
        rows = found["edges"]["edges"]
        sixty = min(rows, key=lambda row: abs(row["true_deg"] - 60))
        figures["edge"] = touch_pictures(*_touch(study, "edges", sixty["frame"]))
        figures["edge_shift"] = draw.shift_map(_touch(study, "edges", sixty["frame"])[2].fields)
        figures["edges"] = draw.edge_errors(rows, EDGES)
    if "damage" in found:
        figures["damage"] = draw.pads_lines([_shown_pad(found["damage"][pad], s) for pad, s in PADS.items()])
    return figures


def _shown_pad(one: Found, said: str) -> draw.ForceLineShown:
    gamma = np.array(one["gamma"])
    force = np.tile(made.DAMAGE_N, len(gamma)).tolist()
    return draw.ForceLineShown(
        said, gamma.ravel().tolist(), force, one["line"]["slope"], one["line"]["offset"]
    )


def _touch(study: NuSenseStudy, name: str, frame: int) -> tuple[ShearReader, Frame, ShearTouch]:
    """Touch in one frame of a recording, with its reader."""
    run = study.run(name)
    reader = made.reader_of(study, run)
    seen = run.frame(frame)
    return reader, seen, reader.touch(seen)
