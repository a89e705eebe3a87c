"""The thesis's experiments as results in plain values, each from its recordings.

Section 4.2 fits lines of force over gamma and asks what they are worth on another day and another pad, beside
baselines; 4.3 places; 4.4 loops; 4.5 touches repeated; 4.6 edges; 4.7 pads that differ and one that is torn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from palpate.calibration.shear import LabelledCues, ShearCalibration, calibrate_shear
from palpate.calibration.shear.calibrate_runs import baseline_errors, transferred_errors, view_of_sensor
from palpate.calibration.shear.force_law import follow_memory
from palpate.calibration.shear.shear_calibration import usable
from palpate.core import Bool, InputError, Pose, Reading, ndarray
from palpate.estimators.shear import ShearReader, ShearTouch
from palpate.estimators.shear.touch_readings import NORMAL_90
from palpate.estimators.surface_strain import edge_direction
from palpate.recordings import Run
from palpate.sensors.nusense.nusense_sensor import ARM_M, NuSense
from palpate.sensors.nusense.nusense_spec import Tear
from palpate_reproductions.nusense.nusense_analysis import (
    GammaLine,
    branch_table,
    drift_of,
    force_line,
    gammas,
    hysteresis_loop,
    loading_frames,
    rms,
    rms_by,
    shuffled_r2,
    turned_deg,
)
from palpate_reproductions.nusense.nusense_setup import NuSenseStudy
from palpate_reproductions.nusense.published_shear import scale_of_published_shear, shear_forces

MM = 1e3
PLACE_N = 6.0
DRIFT_N = 5.0
DAMAGE_N = (1.0, 2.0, 3.0, 4.0)
WEIGHT_N = 5.0
NO_CONTACT_FRAMES = 60  # of each recording that is looked at
ROUND, FLAT = "round", "flat"
RANGES: dict[str, tuple[tuple[str, float, float], ...]] = {
    "round, 1 to 3 N": ((ROUND, 1.0, 3.0),),
    "round, 3 to 8 N": ((ROUND, 3.0, 8.0),),
    "flat, 1 to 3 N": ((FLAT, 1.0, 3.0),),
    "flat, 3 to 8 N": ((FLAT, 3.0, 8.0),),
    "round, 1 to 8 N": ((ROUND, 1.0, 8.0),),
    "flat, 1 to 8 N": ((FLAT, 1.0, 8.0),),
    "as the text has it: flat to 3 N, round to 8 N": ((FLAT, 1.0, 3.0), (ROUND, 1.0, 8.0)),
    "as the caption has it: round 1 to 3 N, flat 3 to 8 N": ((ROUND, 1.0, 3.0), (FLAT, 3.0, 8.0)),
    "both tips, 1 to 8 N": ((ROUND, 1.0, 8.0), (FLAT, 1.0, 8.0)),
}
"""Tip, least and greatest force; the thesis's text and the caption of its Fig. 4-1 contradict each other."""
FROM_N, TO_N = 1.0, 8.0

Mask = Bool[ndarray, " n"]


def in_ranges(samples: LabelledCues, parts: Sequence[tuple[str, float, float]]) -> Mask:
    """Frames of these tips within these forces."""
    keep = np.zeros(len(samples.force_n), bool)
    for tip, low, high in parts:
        keep |= (samples.tip == tip) & (samples.force_n >= low) & (samples.force_n <= high)
    return keep


def force_lines(study: NuSenseStudy) -> dict[str, Any]:
    """Section 4.2: lines of each tip and range on the way down, and over whole cycles; the control."""
    samples = study.cues("force")
    gamma, loading = gammas(samples), loading_frames(samples)

    def line(keep: Mask) -> GammaLine:
        return force_line(gamma[keep], samples.force_n[keep], samples.press[keep])

    both = in_ranges(samples, RANGES["both tips, 1 to 8 N"]) & loading
    points = {
        tip: {
            "gamma": gamma[loading & (samples.tip == tip)].tolist(),
            "force_N": samples.force_n[loading & (samples.tip == tip)].tolist(),
        }
        for tip in (ROUND, FLAT)
    }
    return {
        "loading": {name: line(in_ranges(samples, r) & loading)._asdict() for name, r in RANGES.items()},
        "whole cycles": {name: line(in_ranges(samples, r))._asdict() for name, r in RANGES.items()},
        "points": points,
        "gamma_at_rest": float(np.median(gamma[samples.force_n < 0.05])),
        "shuffled_r2": shuffled_r2(gamma[both], samples.force_n[both], samples.press[both], study.seed),
    }


def published_baseline(study: NuSenseStudy) -> dict[str, Any]:
    """Equation (3.1) as a baseline: gamma from the known pressure, without a fit and with one scale."""
    pad = study.pad("force")
    assert isinstance(pad, NuSense)
    samples = study.cues("force")
    gamma, loading = gammas(samples), loading_frames(samples)
    found: dict[str, Any] = {"curves": {}}
    for tip in (ROUND, FLAT):
        keep = loading & in_ranges(samples, ((tip, FROM_N, TO_N),))
        curve = shear_forces(pad, tip)
        rows = (gamma[keep], samples.force_n[keep], samples.press[keep])
        found[tip] = scale_of_published_shear(curve, *rows)
        found["curves"][tip] = {"gamma": curve.gamma.tolist(), "force_N": curve.force_n.tolist()}
    return found


def part_of(samples: LabelledCues, keep: Mask) -> LabelledCues:
    """Some of the frames."""
    rows = np.flatnonzero(keep)
    image = None if samples.image is None else samples.image[rows]
    return LabelledCues(
        tuple(samples.cues[i] for i in rows),
        samples.force_n[rows],
        samples.time_s[rows],
        samples.press[rows],
        samples.tip[rows],
        image,
    )


def on_other_days_and_pads(study: NuSenseStudy) -> dict[str, Any]:
    """What is learnt on one day of one pad, read there, on another day, and on two other pads.

    Loading branches alone, so that a weight that is brought on compares with what was learnt; the skin's
    memory is learnt on whole cycles beside it.
    """
    learnt, marks, view = study.cues("force"), study.marks("force"), view_of_sensor("nusense")
    down = part_of(learnt, loading_frames(learnt))
    fits = {
        law: calibrate_shear(down, marks, view.lens, view.camera_m, law=law)
        for law in ("published", "any-tip")
    }
    whole = calibrate_shear(learnt, marks, view.lens, view.camera_m, hysteresis=True)
    found: dict[str, Any] = {
        "held out": {
            "laws": {law: {"mae_N": fit.mae_n[0]} for law, fit in fits.items()},
            "baselines": baseline_errors(down, _to_8_n(down)),
            "whole cycles": {"alone_mae_N": whole.mae_n[0], "followed_mae_N": whole.mae_n[1]},
        }
    }
    for name in ("session", "copy-1", "copy-2"):
        samples = study.cues(name)
        read = part_of(samples, loading_frames(samples))
        found[name] = {
            "laws": {law: read_errors(fit, read) for law, fit in fits.items()},
            "baselines": transferred_errors(down, _to_8_n(down), read, _to_8_n(read)),
            "whole cycles": followed_errors(whole, samples),
        }
        if name != "session":
            found[name]["unknown stiffness"] = read_errors(fits["any-tip"].on_copy(), read)
            found[name]["weighed"] = weighed_errors(fits["any-tip"], read)
    return found


def _to_8_n(samples: LabelledCues) -> Mask:
    return usable(samples) & (samples.force_n <= TO_N)


def read_errors(calibration: ShearCalibration, samples: LabelledCues) -> dict[str, float]:
    """Mean absolute error [N], mean error [N], and how often the interval holds the truth, from 1 to 8 N."""
    rows = np.flatnonzero(_to_8_n(samples))
    readings = [calibration.read(samples.cues[i]) for i in rows]
    truth = samples.force_n[rows]
    off = np.array([one.value for one in readings]) - truth
    held = [one.low <= force <= one.high for one, force in zip(readings, truth, strict=True)]
    return {
        "mae_N": float(np.abs(off).mean()),
        "bias_N": float(off.mean()),
        "covered": float(np.mean(held)),
        "scale": calibration.scale,
    }


def weighed_errors(calibration: ShearCalibration, samples: LabelledCues) -> dict[str, float]:
    """The same after one known weight: the first round press at about 5 N, which is not scored."""
    first = samples.press == samples.press[np.flatnonzero(samples.tip == ROUND)[0]]
    near = np.where(first & usable(samples), np.abs(samples.force_n - WEIGHT_N), np.inf)
    weight = int(near.argmin())
    copy = calibration.weighed([samples.cues[weight]], float(samples.force_n[weight]))
    return read_errors(copy, part_of(samples, ~first)) | {"weight_N": float(samples.force_n[weight])}


def followed_errors(calibration: ShearCalibration, samples: LabelledCues) -> dict[str, float]:
    """Errors over whole cycles [N], of single frames and of those whose history is known."""
    assert calibration.remembering is not None
    remembered, _ = follow_memory(calibration.remembering, samples.cues, samples.time_s, samples.press)
    keep = _to_8_n(samples) & np.isfinite(remembered).all(axis=1)
    off = calibration.remembering.force_n(samples.cues, remembered)[keep] - samples.force_n[keep]
    alone = calibration.line.elastic_n(samples.cues)[keep] - samples.force_n[keep]
    return {"alone_mae_N": float(np.abs(alone).mean()), "followed_mae_N": float(np.abs(off).mean())}


def touches_at(study: NuSenseStudy, name: str, frames: Sequence[int]) -> Iterator[tuple[int, ShearTouch]]:
    """Touches of some frames of a recording, read against its first untouched one."""
    run = study.run(name)
    reader = reader_of(study, run)
    for count, i in enumerate(frames, 1):
        yield i, reader.touch(run.frame(i))
        study.progress(f"touches of {name}", count, len(frames))


def reader_of(study: NuSenseStudy, run: Run) -> ShearReader:
    """Reader of any of the pads: what it knows of the skin is the design, not the copy or the cut."""
    pad = study.pad("places")
    assert isinstance(pad, NuSense)
    rest = np.flatnonzero(run.labels["reference"].fillna(False).to_numpy(bool))
    return ShearReader(pad.shear_skin(), run.frame(int(rest[0])))


def frames_near(labels: pd.DataFrame, at_n: float) -> list[int]:
    """Frame of every press, on its loading branch, whose force is nearest to one."""
    force, press = labels["force_N"].to_numpy(float), labels["press"].to_numpy(object)
    found = []
    known = np.isfinite(force) & pd.notna(press)
    for one in dict.fromkeys(press[known]):
        rows = np.flatnonzero((press == one) & known)
        down = rows[: int(force[rows].argmax()) + 1]
        found.append(int(down[np.abs(force[down] - at_n).argmin()]))
    return found


def places(study: NuSenseStudy) -> dict[str, Any]:
    """Section 4.3: 24 places at 6 N; nothing is learnt, so that none of them was seen before."""
    run = study.run("places")
    labels, rows = run.labels, []
    for i, touch in touches_at(study, "places", frames_near(labels, PLACE_N)):
        contact = touch.places.contacts[0] if touch.places.contacts else None
        row = labels.iloc[i]
        true = (float(row["x_mm"]), float(row["y_mm"]))
        by_ring = None if contact is None or contact.ring is None else (contact.ring.x, contact.ring.y)
        told = [touch.readings[axis] for axis in "xy"]
        inside = [arm_or_reader_holds(reading, 1e-3 * at) for reading, at in zip(told, true, strict=True)]
        rows.append({
            "frame": i, "place": str(row["location"]), "cycle": int(row["cycle"]),
            "force_N": float(row["force_N"]), "true_mm": true,
            "pressure_mm": None if contact is None else (MM * contact.x, MM * contact.y),
            "ring_mm": None if by_ring is None else (MM * by_ring[0], MM * by_ring[1]),
            "inside": inside,
        })  # fmt: skip
    return {"touches": rows} | {by: place_errors(rows, by) for by in ("pressure", "ring")}


def arm_or_reader_holds(reading: Reading, true_m: float) -> bool:
    """Whether a place asked of the arm lies in the 90 % interval, widened by the arm's own error."""
    half = math.hypot((reading.high - reading.low) / 2, NORMAL_90 * ARM_M)
    return abs(reading.value - true_m) <= half


def place_errors(rows: Sequence[dict[str, Any]], by: str) -> dict[str, Any]:
    """Distances of places told one way from the true ones [mm]: whole, per place, per round of all places."""
    known = [row for row in rows if row[f"{by}_mm"] is not None]
    if not known:
        return {"told": 0, "of": len(rows)}
    off = np.array([np.subtract(row[f"{by}_mm"], row["true_mm"]) for row in known])
    far = np.hypot(*off.T)
    rounds = [*rms_by([str(row["cycle"]) for row in known], far).values()]
    return {
        "told": len(known),
        "of": len(rows),
        "rms_mm": rms(far),
        "greatest_mm": float(far.max()),
        "rounds_mm": rounds,
        "rounds_spread_mm": float(np.std(rounds, ddof=1)) if len(rounds) > 1 else None,
        "shift_mm": off.mean(axis=0).tolist(),
        "per_place_mm": rms_by([row["place"] for row in known], far),
    }


LOOP_PADS = ("hysteresis", "lighter", "softer")


def loops(study: NuSenseStudy) -> dict[str, Any]:
    """Section 4.4: loops of the designed pad, to 8 N and to 6 N, and of one with half the gel's modulus."""
    found: dict[str, Any] = {}
    for name in LOOP_PADS:
        samples = study.cues(name)
        gamma = gammas(samples)
        presses = [samples.press == one for one in dict.fromkeys(samples.press.tolist())]
        each = [hysteresis_loop(samples.force_n[rows], gamma[rows])._asdict() for rows in presses]
        found[name] = {
            "loops": each,
            "mean": {key: float(np.mean([one[key] for one in each])) for key in each[0]},
            "course": {"gamma": gamma[presses[0]].tolist(), "force_N": samples.force_n[presses[0]].tolist()},
        }
    return found


def cycles(study: NuSenseStudy) -> dict[str, Any]:
    """Section 4.5: gamma at 5 N, its greatest value, and the line, touch after touch."""
    samples = study.cues("cycles")
    gamma, loading = gammas(samples), loading_frames(samples)
    at = np.array([one[0] for one in branch_table(samples, [DRIFT_N]).values()])
    presses = [samples.press == one for one in dict.fromkeys(samples.press.tolist())]
    used = loading & (samples.force_n >= FROM_N)
    lines = [force_line(gamma[p & used], samples.force_n[p & used], samples.press[p & used]) for p in presses]
    return {
        "touches": len(presses),
        "gamma_at_5_N": at.tolist(),
        "greatest_gamma": [float(gamma[p].max()) for p in presses],
        "greatest_force_N": [float(samples.force_n[p].max()) for p in presses],
        "drift": {
            "gamma at 5 N": drift_of(at[np.isfinite(at)])._asdict(),
            "slope": drift_of(np.array([line.slope for line in lines]))._asdict(),
            "offset": drift_of(np.array([line.offset for line in lines]))._asdict(),
        },
    }


def edges(study: NuSenseStudy) -> dict[str, Any]:
    """Section 4.6: direction of a long tip at 8 N, by pressure and as published by the most moved samples."""
    run = study.run("edges")
    labels, rows = run.labels, []
    for i, touch in touches_at(study, "edges", frames_near(labels, TO_N)):
        row = labels.iloc[i]
        true = float(str(row["indenter"]).split(":")[2])
        edge = touch.places.edge
        moved = None if touch.fields is None else edge_direction(touch.fields)
        rows.append({
            "frame": i, "true_deg": true, "force_N": float(row["force_N"]),
            "pressure_off_deg": None if edge is None else turned_deg(math.degrees(edge.angle_rad), true),
            "pressure_half_deg": None if edge is None else math.degrees(edge.half_rad),
            "moved_off_deg": None if moved is None else turned_deg(math.degrees(moved.angle_rad), true),
            "moved_half_deg": None if moved is None else math.degrees(moved.half_rad),
        })  # fmt: skip
    return {"edges": rows} | {by: edge_errors(rows, by) for by in ("pressure", "moved")}


def edge_errors(rows: Sequence[dict[str, Any]], by: str) -> dict[str, Any]:
    """Errors of the directions that are told [degrees]."""
    off = [
        (abs(row[f"{by}_off_deg"]), row[f"{by}_half_deg"]) for row in rows if row[f"{by}_off_deg"] is not None
    ]
    if not off:
        return {"told": 0, "of": len(rows)}
    size, half = np.array(off).T
    return {
        "told": len(off),
        "of": len(rows),
        "median_deg": float(np.median(size)),
        "at_95_deg": float(np.quantile(size, 0.95)),
        "greatest_deg": float(size.max()),
        "covered": float((size <= half).mean()),
    }


PADS = ("pad-1", "pad-2", "torn")
GAPS_MM = (0.15, 0.3, 0.5)
DRAWS = 4  # of the camera's noise


def damage(study: NuSenseStudy) -> dict[str, Any]:
    """Section 4.7: three pads at 1 to 4 N: their lines, what one's line reads on the others, and the flag."""
    found: dict[str, Any] = {}
    for name in PADS:
        samples = study.cues(name)
        table = np.array([row for row in branch_table(samples, DAMAGE_N).values() if np.isfinite(row).all()])
        if not len(table):
            raise InputError(f"no press of {name} was read at {DAMAGE_N} N on its way down")
        press = np.repeat(np.arange(len(table)), len(DAMAGE_N))
        line = force_line(table.ravel(), np.tile(DAMAGE_N, len(table)), press)
        found[name] = {"gamma": table.tolist(), "line": line._asdict(), "flags": _flags(study, name)}
    first = found[PADS[0]]["line"]
    for name in PADS[1:]:
        mean = np.mean(found[name]["gamma"], axis=0)
        found[name]["off_by_line_of_first_N"] = (first["offset"] + first["slope"] * mean - DAMAGE_N).tolist()
    found["gaps"] = [cut_seen(study, gap_mm) for gap_mm in GAPS_MM]
    return found


def cut_seen(study: NuSenseStudy, gap_mm: float) -> dict[str, Any]:
    """How often the skin looks torn that has a cut as wide as this at rest, at rest and at 1 to 4 N.

    Frames are drawn, not recorded: against the torn pad's own rest, and against the whole pad's.
    """
    whole = study.pad("places")
    assert isinstance(whole, NuSense)
    torn = NuSense(replace(whole.spec, tear=Tear(gap_m=1e-3 * gap_mm)))
    rng, probe = np.random.default_rng([study.seed, round(1e3 * gap_mm)]), whole.probe(ROUND)
    known = np.linspace(0, whole.known_depth_m(probe), 25)
    forces = [whole.press(probe, Pose(0.0, 0.0, float(d))).force_n for d in known]
    depths = [0.0, *np.interp(DAMAGE_N, forces, known).tolist()]
    contacts = [torn.press(probe, Pose(0.0, 0.0, depth)) for depth in depths]
    untouched = whole.press(probe, Pose(0.0, 0.0, 0.0))
    before = {
        "its own rest": torn.render(contacts[0], rng),
        "the whole pad's rest": whole.render(untouched, rng),
    }
    flags = {}
    for name, reference in before.items():
        reader, up = ShearReader(whole.shear_skin(), reference), []
        for contact in [*contacts] * DRAWS:
            up.append(reader.touch(torn.render(contact, rng)).readings["damage"].value == "yes")
            study.progress(f"cut of {gap_mm:g} mm", len(up), DRAWS * len(contacts))
        rest = up[:: len(contacts)]
        flags[name] = {
            "rest": sum(rest),
            "rest_of": len(rest),
            "pressed": sum(up) - sum(rest),
            "pressed_of": len(up) - len(rest),
        }
    return {"gap_mm": gap_mm, "flags": flags}


def _flags(study: NuSenseStudy, name: str) -> dict[str, Any]:
    """How often a skin looks torn, at rest and pressed, against its own rest."""
    run = study.run(name)
    rest = np.flatnonzero(run.labels["reference"].fillna(False).to_numpy(bool)).tolist()[1:]
    pressed = sorted({i for at in DAMAGE_N for i in frames_near(run.labels, at)})
    up: dict[int, bool] = {}
    for i, touch in touches_at(study, name, sorted([*rest, *pressed])):
        up[i] = touch.readings["damage"].value == "yes"
    return {
        "rest": sum(up[i] for i in rest),
        "rest_of": len(rest),
        "pressed": sum(up[i] for i in pressed),
        "pressed_of": len(pressed),
    }


def no_contact(study: NuSenseStudy) -> dict[str, Any]:
    """Frames of untouched pads: a control in which no contact may be found."""
    seen = found = 0
    for name in ("force", "places", "cycles"):
        labels = study.run(name).labels
        rest = np.flatnonzero(labels["reference"].fillna(False).to_numpy(bool)).tolist()
        for _, touch in touches_at(study, name, rest[1 : 1 + NO_CONTACT_FRAMES]):
            seen += 1
            found += bool(touch.places.contacts)
    return {"frames": seen, "contacts": found}
