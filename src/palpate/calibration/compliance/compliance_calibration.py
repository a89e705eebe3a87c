"""Compliance calibration of a TacTip on specimens of known stiffness.

A rigid plate and soft references give the stiffness curve, by touch alone and with the approach, and an area
fit where contact areas are known. The file holds plain arrays; the id is that of its contents.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from palpate.calibration.certificate import contents_id, load_record, save_record
from palpate.calibration.compliance.press_nuisances import Nuisances
from palpate.calibration.compliance.reference_stiffness import check_references
from palpate.core import (
    Float,
    InputError,
    Int,
    Progress,
    RangeError,
    Shaped,
    ndarray,
    refuse_existing,
    silent,
)
from palpate.core.reading import ReasonCode, Refusal
from palpate.estimators.compliance.contact_area import (
    AreaFit,
    Motions,
    fit_area,
    fit_motions,
    left_out_areas,
)
from palpate.estimators.compliance.hertz_inversion import (
    Finger,
    PressCurves,
    Roundness,
    ShapeSurface,
    fit_finger,
    fit_shape_surface,
    invert_hertz,
)
from palpate.estimators.compliance.pin_press import (
    PinPress,
    Seat,
    at_forces,
    fit_seat,
    follow_press,
    motion_on_layout,
    sideways_px,
)
from palpate.estimators.compliance.spread_rate import RateFit, fit_rate
from palpate.estimators.compliance.stiffness_curve import SoftnessCurve, fit_softness, softness
from palpate.recordings.exchange.frame_sequences import FrameSequence, open_sequence
from palpate.recordings.exchange.press_folder import (
    UNKNOWN_BODY,
    KnownBody,
    PressedSpecimen,
    PressFolder,
    press_folder,
)
from palpate.recordings.exchange.press_table import PressTable, read_press_table
from palpate.version import __version__

BEYOND = 0.05  # of the span of references in s and c, beyond which a place is not read
OUTSIDE_MODULUS = "{:.3g} MPa is outside of the references' moduli, {:.3g} MPa to rigid"
OUTSIDE_RADIUS = "a radius of {:.3g} mm is outside of the references', {:.3g} mm to flat"
HOLLOW = (
    "the object shows itself hollow, by a radius of {:.3g} mm the other way: no such reference was pressed, "
    "and a layer on a hard base shows itself so too"
)


def fit_shapes(
    bodies: Sequence[KnownBody], rows: Sequence[Float[ndarray, " d"]], which: Int[ndarray, " t"]
) -> ShapeSurface | None:
    """Fit the surface of modulus and radius through references; None where no sphere is among them.

    Args:
        rows: of every trial, motion of pins at every level and the approach from the first level to others.
        which: reference of every trial.
    """
    known = [i for i, body in enumerate(bodies) if body.known]
    if not any(np.isfinite(bodies[i].radius_m) for i in known):
        return None
    stacked = np.stack(rows)
    return fit_shape_surface(
        [bodies[i].modulus_pa for i in known],
        [bodies[i].radius_m for i in known],
        [stacked[which == i] for i in known],
    )


def moduli_pa(surface: ShapeSurface) -> tuple[float, float]:
    """Return the least and greatest finite modulus of the references [Pa]."""
    finite = surface.modulus_pa[np.isfinite(surface.modulus_pa)]
    return float(finite.min()), float(finite.max())


def errors_between(surface: ShapeSurface) -> dict[str, float]:
    """Return the leave-one-out errors of the references, for files."""
    of_modulus, of_c = surface.between
    return {"modulus": of_modulus, "curvature_per_m": of_c / surface.turning_m}


def shape_reasons(surface: ShapeSurface, found: Roundness) -> list[Refusal]:
    """Return why neither modulus nor radius is valid."""
    s, c = found.place
    least, _ = moduli_pa(surface)
    smallest, why = float(surface.radius_m.min()), []
    if s > (1 + BEYOND) / (1 + least / surface.turning_pa):
        why.append(OUTSIDE_MODULUS.format(1e-6 * found.modulus_pa[0], 1e-6 * least))
    if c > (1 + BEYOND) * surface.turning_m / smallest:
        why.append(OUTSIDE_RADIUS.format(1e3 * found.radius_m[0], 1e3 * smallest))
    if c + found.half[1] < 0:
        why.append(HOLLOW.format(-1e3 * surface.turning_m / c))
    return [Refusal(ReasonCode.SHAPE_OUTSIDE_RANGE, text) for text in why]


T = TypeVar("T")
Samples = Float[ndarray, " _"]


LEVELS_N = np.arange(1.0, 4.51, 0.5)
AREA_AT_N = 4.0  # where an area is told
MIN_AREAS = 6  # of a press, for a spread rate
APPROACH_PX = 2e5  # px/m: what a metre of approach weighs beside pins' motion; scatter is discounted anyway


@dataclass(frozen=True)
class ReferenceTrial:
    """A trial of a reference: its pins, and the contact area at its frames where that is known [m^2]."""

    press: PinPress
    area_m2: Float[ndarray, " f"] | None = None


@dataclass(frozen=True)
class ReferenceSpecimen:
    """Specimen of known stiffness (`inf` for a rigid plate, NaN for a sphere) or modulus and radius."""

    name: str
    kappa_n_m: float
    trials: tuple[ReferenceTrial, ...]
    body: KnownBody = UNKNOWN_BODY


@dataclass(frozen=True)
class ComplianceCalibration:
    """Calibrated tip; fields are None where the references lack what they need.

    Attributes:
        layout_px: no-contact pins ``[p 2]`` [px].
        levels_n: forces at which presses are compared [N].
        touch, both: stiffness curves of the pins' motion alone, and with the approach.
        motions, area: contact area by the pins' motion.
        finger: Hertz pair that acts as the tip does.
        wobble_px: RMS distance of no-contact pins from the layout [px].
        speed_m_s: least and greatest of the references [m/s].
        tilt_rad: inclination of the specimens' tops, for which alone it is valid [rad].
        rate, level: spread rates and areas at 4 N against known ones.
        nuisances: standard sizes that intervals contain.
        latency_s: camera latency that was corrected [s].
        shape: modulus and radius by motion and approach, from spheres.
        moduli_per_m: E* over stiffness of the flat references, by the inversion used for a press [1/m].
    """

    names: tuple[str, ...]
    layout_px: Float[ndarray, "p 2"]
    levels_n: Float[ndarray, " l"]
    touch: SoftnessCurve
    both: SoftnessCurve | None
    motions: Motions | None
    area: AreaFit | None
    finger: Finger | None
    wobble_px: float
    speed_m_s: tuple[float, float]
    seat: Seat
    nuisances: Nuisances
    tilt_rad: float = 0.0
    note: str = ""
    version: str = __version__
    rate: RateFit | None = None
    latency_s: float | None = None
    shape: ShapeSurface | None = None
    level: RateFit | None = None
    moduli_per_m: float | None = None

    @cached_property
    def id(self) -> str:
        return contents_id(self, "compliance")

    def save(self, path: Path) -> None:
        """Write one ``.npz``, whole or not at all."""
        save_record(self, path)

    @classmethod
    def load(cls, path: Path) -> ComplianceCalibration:
        """Read what `save` wrote; no code in it is run."""
        return load_record(cls, path, "compliance", "palpate calibrate --method compliance")


def calibrate_compliance(
    references: Sequence[ReferenceSpecimen],
    *,
    tilt_rad: float = 0.0,
    note: str = "",
    nuisances: Nuisances | None = None,
) -> ComplianceCalibration:
    """Fit a calibration to references.

    Args:
        references: two or more, pressed alike.
        tilt_rad: inclination of their tops [rad].
        nuisances: sizes by which later presses may differ; None for the standard sizes, `NONE` for none.
    """
    trials = [(i, trial) for i, one in enumerate(references) for trial in one.trials]
    if not trials:
        raise InputError("no reference has a trial; press a rigid plate and a soft specimen, five times each")
    presses = [trial.press for _, trial in trials]
    layout = _layout(presses)
    motions_px = [motion_on_layout(press, layout) for press in presses]
    touch_rows = [touch_row(press, layout, LEVELS_N) for press in presses]
    which = np.array([i for i, _ in trials])
    flat = [i for i, one in enumerate(references) if not np.isnan(one.kappa_n_m)]
    kappa = [references[i].kappa_n_m for i in flat]

    def curve(rows: list[ndarray]) -> SoftnessCurve:
        stacked = np.stack(rows)
        return fit_softness(kappa, [stacked[which == i] for i in flat])

    touch, both, shape = curve(touch_rows), None, None
    if all(press.position_m is not None for press in presses):
        approach_rows = [approach_row(press, LEVELS_N) for press in presses]
        joined = [np.concatenate(rows) for rows in zip(touch_rows, approach_rows, strict=True)]
        both = curve(joined)
        shape = fit_shapes([one.body for one in references], joined, which)
    check_references(
        [references[i].name for i in flat], touch, both, approach_px=APPROACH_PX, tilt_rad=tilt_rad
    )
    flat_trials = [(i, t, m) for (i, t), m in zip(trials, motions_px, strict=True) if i in flat]
    motions, area, rate, level = _areas(
        [(flat.index(i), t) for i, t, _ in flat_trials], [m for _, _, m in flat_trials], layout
    )
    speeds = [press.speed_m_s for press in presses]
    finger = _finger(references)
    return ComplianceCalibration(
        tuple(one.name for one in references),
        layout,
        LEVELS_N,
        touch,
        both,
        motions,
        area,
        finger,
        float(np.sqrt(np.mean([wobble_px(press, layout) ** 2 for press in presses]))),
        (float(np.min(speeds)), float(np.max(speeds))),
        fit_seat(softness(touch.kappa_n_m, touch.turning_n_m), _seats(presses, which, layout, flat)),
        Nuisances() if nuisances is None else nuisances,
        tilt_rad,
        note,
        rate=rate,
        shape=shape,
        level=level,
        moduli_per_m=None if finger is None else _moduli_per_m(finger, [references[i] for i in flat]),
    )


def _seats(
    presses: Sequence[PinPress],
    which: Int[ndarray, " t"],
    layout: Float[ndarray, "p 2"],
    references: Sequence[int],
) -> list[Float[ndarray, "_ 2"]]:
    sideways = np.stack([sideways_px(press, layout) for press in presses])
    return [sideways[which == i] for i in references]


def _layout(presses: Sequence[PinPress]) -> Float[ndarray, "p 2"]:
    """The untouched pins: mean over presses, about where the first has them."""
    first = presses[0].untouched_px
    first = first[np.isfinite(first).all(axis=1)]
    places = [_untouched(press, first) for press in presses]
    return np.asarray(np.nanmean([at - np.nanmean(at, axis=0) for at in places], axis=0) + first.mean(axis=0))


def _untouched(press: PinPress, layout: Float[ndarray, "p 2"]) -> Float[ndarray, "p 2"]:
    still = replace(
        press,
        frame=press.frame[:1],
        force_n=press.force_n[:1],
        moved_px=press.untouched_px[None],
        position_m=None,
        time_s=None,
    )
    return motion_on_layout(still, layout)[0]


def wobble_px(press: PinPress, layout: Float[ndarray, "p 2"]) -> float:
    """Return the RMS distance of no-contact pins from the layout, less the common shift [px]."""
    off = _untouched(press, layout) - layout
    off = off[np.isfinite(off).all(axis=1)]
    return float(np.sqrt(np.mean(np.sum((off - off.mean(axis=0)) ** 2, axis=1))))


def touch_row(press: PinPress, layout: Float[ndarray, "p 2"], levels_n: Float[ndarray, " l"]) -> ndarray:
    """Return the motion of the pins at every level, in one row; NaN for lost pins."""
    motion = motion_on_layout(press, layout)
    tracked = np.isfinite(motion).all(axis=(0, 2))
    row = np.full((len(levels_n), *motion.shape[1:]), np.nan)
    row[:, tracked] = at_forces(press.force_n, motion[:, tracked], levels_n)
    return row.ravel()


def approach_row(press: PinPress, levels_n: Float[ndarray, " l"]) -> Float[ndarray, " l-1"]:
    """Return the approach from the first level to the others, weighted as pins' motion."""
    assert press.position_m is not None
    d = at_forces(press.force_n, press.position_m, levels_n)
    return np.asarray(APPROACH_PX * (d - d[0])[1:])


def _areas(
    trials: Sequence[tuple[int, ReferenceTrial]],
    moved: Sequence[Float[ndarray, "_ p 2"]],
    layout: Float[ndarray, "p 2"],
) -> tuple[Motions | None, AreaFit | None, RateFit | None, RateFit | None]:
    known = [(i, m, t.area_m2) for (i, t), m in zip(trials, moved, strict=True) if t.area_m2 is not None]
    if len({i for i, _, _ in known}) < 2:
        return None, None, None, None
    which = [i for i, _, _ in known]
    areas = [a for _, _, a in known]
    motions = fit_motions([m for _, m, _ in known])
    measures = [motions.of(m) for _, m, _ in known]
    area = fit_area(measures, areas, which)
    forces = [t.press.force_n for _, t in trials if t.area_m2 is not None]
    found = left_out_areas(measures, areas)
    rate, level = (_against_known(of, forces, found, areas, which) for of in (rate_by_areas, area_at_4_n))
    return motions, area, rate, level


def rate_by_areas(force_n: Samples, area_m2: Samples) -> float:
    """Return the slope of area over force, 1 to 4.5 N, at even forces; NaN with too few areas [m^2/N]."""
    known = np.isfinite(area_m2)
    if known.sum() < MIN_AREAS:
        return float("nan")
    try:
        area = at_forces(force_n[known], area_m2[known], LEVELS_N)
    except RangeError:
        return float("nan")
    return float(np.polyfit(LEVELS_N, area, 1)[0])


def area_at_4_n(force_n: Samples, area_m2: Samples) -> float:
    """Return the area at 4 N by areas at other forces; NaN with too few [m^2]."""
    known = np.isfinite(area_m2)
    if known.sum() < MIN_AREAS:
        return float("nan")
    try:
        return float(at_forces(force_n[known], area_m2[known], np.array([AREA_AT_N]))[0])
    except RangeError:
        return float("nan")


def _against_known(
    measure: Callable[[Samples, Samples], float],
    forces: Sequence[Samples],
    found: Sequence[Samples],
    true: Sequence[Samples],
    which: Sequence[int],
) -> RateFit | None:
    pairs = [
        (measure(f, np.where(np.isfinite(known), a, np.nan)), measure(f, known), i)
        for f, a, known, i in zip(forces, found, true, which, strict=True)
    ]
    usable = [one for one in pairs if one[0] > 0 and one[1] > 0]
    try:
        return fit_rate(*zip(*usable, strict=True)) if usable else None
    except InputError:
        return None


def _finger(references: Sequence[ReferenceSpecimen]) -> Finger | None:
    presses = _curves(one for one in references if np.isinf(one.kappa_n_m))
    return fit_finger(presses) if presses else None


def _moduli_per_m(finger: Finger, flats: Sequence[ReferenceSpecimen]) -> float | None:
    """Return the median of E* over stiffness [1/m] of the soft references whose areas are known."""
    soft = [(one, presses) for one in flats if np.isfinite(one.kappa_n_m) and (presses := _curves([one]))]
    moduli = [invert_hertz(presses, finger, np.random.default_rng(0)).modulus_pa[0] for _, presses in soft]
    ratios = [modulus / one.kappa_n_m for modulus, (one, _) in zip(moduli, soft, strict=True)]
    finite = [ratio for ratio in ratios if np.isfinite(ratio)]
    return float(np.median(finite)) if finite else None


def _curves(references: Iterable[ReferenceSpecimen]) -> list[PressCurves]:
    return [
        PressCurves(t.press.force_n[good], t.press.position_m[good], t.area_m2[good])
        for one in references
        for t in one.trials
        if t.area_m2 is not None and t.press.position_m is not None
        for good in [np.isfinite(t.area_m2) & (t.press.force_n >= LEVELS_N[0])]
    ]


def reference_trial(frames: Iterable[Shaped[ndarray, ...]], table: PressTable) -> ReferenceTrial:
    """Read a press: its pins' motion, and its contact area at their frames where the table has it."""
    press = follow_press(frames, table.force_n, table.frame_sample, table.position_m, table.time_s)
    area = None if table.area_m2 is None else table.area_m2[table.frame_sample[press.frame]]
    return ReferenceTrial(press, area)


def load_references(
    folder: PressFolder, progress: Progress = silent, *, latency_s: float = 0.0
) -> list[ReferenceSpecimen]:
    """Read the specimens of known stiffness, or modulus and radius, in the folder's order."""
    known = [one for one in folder.specimens if one.stiffness_n_m is not None or one.body.known]
    flat = sum(one.stiffness_n_m is not None for one in known)
    if flat < 2:
        raise InputError(
            f"{flat} of {len(folder.specimens)} specimens in {folder.path} have a known stiffness; "
            "write two or more into specimens.csv: stiffness_N_per_mm, inf for a rigid plate"
        )
    trials = read_presses(known, reference_trial, progress, latency_s)
    return [
        ReferenceSpecimen(
            one.name,
            np.nan if one.stiffness_n_m is None else one.stiffness_n_m,
            tuple(trials[one.name]),
            one.body,
        )
        for one in known
    ]


def read_presses(
    specimens: Sequence[PressedSpecimen],
    read: Callable[[FrameSequence, PressTable], T],
    progress: Progress,
    latency_s: float = 0.0,
) -> dict[str, list[T]]:
    """Apply `read` to frames and table of every press, by specimen.

    Args:
        latency_s: camera latency to take off [s].
    """
    done, total = 0, sum(len(one.presses) for one in specimens)
    results: dict[str, list[T]] = {one.name: [] for one in specimens}
    for one in specimens:
        for frames, table in one.presses:
            with open_sequence(frames) as sequence:
                rows = read_press_table(table, len(sequence)).earlier(latency_s)
                results[one.name].append(read(sequence, rows))
            done += 1
            progress("presses", done, total)
    return results


def calibrate_folder(
    folder: Path,
    out: Path,
    *,
    tilt_deg: float = 0.0,
    note: str = "",
    nuisances: Sequence[str] = (),
    latency: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Calibrate on the specimens of known stiffness in a folder; return the fit in plain numbers.

    Args:
        folder: experiment; see `recordings.exchange.press_folder`.
        out: ``.npz`` to make.
        tilt_deg: inclination of the specimens' tops [deg].
        nuisances: sizes that differ from the standard ones, see `Nuisances.named`.
        latency: camera latency to take off; its uncertainty is the size of `late_ms` unless that is named.

    Raises:
        PalpateError: a folder, press, or reference that cannot be used; `out` exists.
    """
    if out.suffix != ".npz":
        raise InputError(f"{out} is not an .npz file; name the calibration e.g. tip.npz")
    refuse_existing(out)
    sizes, late_s = Nuisances.named(nuisances), None if latency is None else latency[0]
    if latency is not None and not any(one.startswith("late_ms=") for one in nuisances):
        sizes = replace(sizes, late_s=latency[1])
    references = load_references(press_folder(folder), progress, latency_s=late_s or 0.0)
    calibration = calibrate_compliance(
        references, tilt_rad=float(np.deg2rad(tilt_deg)), note=note, nuisances=sizes
    )
    calibration = replace(calibration, latency_s=late_s)
    calibration.save(out)
    both, area = calibration.both, calibration.area
    return {
        "calibration": calibration.id,
        "out": str(out),
        "references": [
            {
                "specimen": one.name,
                "stiffness_N_per_mm": finite_or_none(1e-3 * one.kappa_n_m),
                "reduced_modulus_MPa": finite_or_none(1e-6 * one.body.modulus_pa),
                "radius_mm": finite_or_none(1e3 * one.body.radius_m),
                "trials": len(one.trials),
            }
            for one in references
        ],
        "pins": len(calibration.layout_px),
        "error_between_references": finite_or_none(calibration.touch.between),
        "error_between_references_both_cues": None if both is None else finite_or_none(both.between),
        "shape_known": calibration.shape is not None,
        "errors_between_shapes": None if calibration.shape is None else errors_between(calibration.shape),
        "area_known": area is not None,
        "area_error": None if area is None else finite_or_none(area.spread),
        "tilt_deg": tilt_deg,
        "nuisances": sizes.at_edge(),
        "latency_ms": None if late_s is None else 1e3 * late_s,
    }


def finite_or_none(value: float) -> float | None:
    """Return a number for JSON: None where it is not finite."""
    return float(value) if np.isfinite(value) else None
