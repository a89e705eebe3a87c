"""Confound audit of a calibration: what other than touch could have told the labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from palpate.calibration.confounds.confound_findings import (
    Finding,
    TargetEvidence,
    function_finding,
    min_outside_share,
    order_not_asked,
    outside_findings,
    ranked,
    shift_finding,
)
from palpate.calibration.confounds.deciding_pixels import MAP_FILE, DecidingPixels
from palpate.calibration.confounds.kernel_regression import (
    Kernels,
    explained_share,
    interleaved_blocks,
)
from palpate.calibration.confounds.outside_control import outside_control, telling_cells
from palpate.calibration.confounds.recorded_units import recorded_units
from palpate.calibration.confounds.row_order import (
    OrderCheck,
    ShiftCheck,
    folds_among,
    order_checks,
    sampled,
    shift_check,
)
from palpate.calibration.confounds.skin_region import RegionSource, SkinRegion, boxed, find_skin
from palpate.calibration.confounds.target_functions import TargetFunction, target_functions
from palpate.core import Float32, Indices, Progress, Values, silent
from palpate.estimators.finding_cards import ConfoundCard, ConfoundFindingCard, TargetConfoundCard
from palpate.recordings import PackedSet, Split

MAX_ROWS = 400
"""Rows that are asked, evenly spaced over the recording."""
SMALL_PX = 64
"""Longer side of the pictures that are asked [px]."""
MIN_ROWS = 20
SHRINKS = (1.0, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7)
"""Sizes of a crop tried, over the box that just holds the skin; 0.7 lies within a round one."""
MAX_LEFT_OUTSIDE = 0.01
Box = tuple[int, int, int, int]


@dataclass(frozen=True)
class ConfoundAudit:
    """Audit of what other than touch could have told the labels.

    Attributes:
        findings: the gravest first.
        evidence: of each target.
        outside_share: share of the picture that lies outside the skin; None where none was found.
        outside_text: how the outside was found, or why there is none.
        skin_px: box (x, y, width, height) around the skin [px of the recorded frame]; None without outside.
        shift: labels of neighbouring rows against the images.
        functions: targets that follow from others.
        pixels: which pixels decide; None where no rows were held out.
    """

    findings: tuple[Finding, ...]
    evidence: tuple[TargetEvidence, ...]
    outside_share: float | None
    outside_text: str
    skin_px: Box | None
    shift: ShiftCheck
    functions: tuple[TargetFunction, ...]
    pixels: DecidingPixels | None = None

    @property
    def failed(self) -> bool:
        """True if something was found that the scores cannot be relied on with."""
        return any(finding.severity == "fails" for finding in self.findings)

    def card(self) -> ConfoundCard:
        """The audit as a part of a card."""
        shown = self.pixels is not None
        return ConfoundCard(
            failed=self.failed,
            findings=tuple(
                ConfoundFindingCard(**{name: getattr(f, name) for name in ConfoundFindingCard.model_fields})
                for f in self.findings
            ),
            targets=tuple(_target_card(evidence) for evidence in self.evidence),
            outside_share=self.outside_share,
            outside=self.outside_text,
            skin_px=self.skin_px,
            row_lag=self.shift.lag,
            map_file=MAP_FILE if shown else None,
            map_rows=self.pixels.rows if self.pixels is not None else None,
        )


def _target_card(evidence: TargetEvidence) -> TargetConfoundCard:
    return TargetConfoundCard(
        column=evidence.column,
        rank_correlation=evidence.order.rank_correlation,
        order_r2=evidence.order.share,
        order_level=evidence.order.level,
        model_r2=evidence.model,
        outside_r2=evidence.outside,
        outside_r2_blocks=evidence.outside_blocks,
        inside_r2=evidence.inside,
    )


@dataclass(frozen=True)
class AuditedRows:
    """Rows of a calibration that an audit asks.

    Attributes:
        packed: the prepared frames that were learnt from.
        values: ``[n t]`` their labels.
        names: of the targets.
        split: how rows were held out.
        held_out: ``[n t]`` estimates by models that had not seen the rows; NaN where there are none.
        untouched: prepared frames of the untouched sensor, in their order; none where there are none.
        frame_px: (height, width) of the recorded frames [px].
        columns: label column of each target but classes: a direction's cosine and sine are of one; the names
            by default.
        classes: how many of the last are outputs for classes, which follow from each other by what they are.
        presses: ``[n]`` label of what was recorded at one go, within its session; None where no column says.
        sessions: ``[n]`` label of each row's session or copy; None where there is one.
        untouched_sessions: the same of each untouched frame.
        in_recorded_order: whether rows lie in the order in which they were taken.
    """

    packed: PackedSet
    values: Values
    names: tuple[str, ...]
    split: Split
    held_out: Values
    untouched: PackedSet | None
    frame_px: tuple[int, int]
    columns: tuple[str, ...] = ()
    classes: int = 0
    presses: np.ndarray | None = None
    sessions: np.ndarray | None = None
    untouched_sessions: np.ndarray | None = None
    in_recorded_order: bool = True


def audit_confounds(
    rows: AuditedRows,
    *,
    skin_px: Box | None = None,
    pixels: DecidingPixels | None = None,
    progress: Progress = silent,
) -> ConfoundAudit:
    """Look for what other than touch could have told the labels.

    Args:
        rows: of the calibration.
        skin_px: where the skin is in the recorded frame, (x, y, width, height), where that is known [px].
        pixels: which pixels decide, as found while folds were held out.
        progress: told how far the work is.
    """
    steps, done = 4, 0

    def step() -> None:
        nonlocal done
        done += 1
        progress("looking for confounds", done, steps)

    values, recorded = rows.values, recorded_units(rows.values, rows.presses, rows.sessions)
    recorded = replace(recorded, in_recorded_order=rows.in_recorded_order)
    units, count = recorded.of, recorded.count
    orders = order_checks(values, recorded, rows.packed.times_s)
    plain = len(rows.names) - rows.classes
    functions = tuple(target_functions(values[:, :plain], rows.names[:plain], units, rows.columns or None))
    step()
    chosen = sampled(len(values), MAX_ROWS)
    images = small_pictures(rows.packed, chosen)
    region = _region(rows, images, units[chosen], recorded.sessions[chosen], skin_px)
    shift = ShiftCheck(0, float("nan"), float("nan"))
    if rows.in_recorded_order:  # labels in the images' own names are no other image's
        shift = shift_check(Kernels.of(images.reshape(len(images), -1)), values, chosen)
    step()
    evidence = _evidence(rows, orders, images, region, chosen, units)
    step()
    crop = _crop_remedy(rows, images, region, chosen, count, evidence)
    found = [f for e in evidence for f in outside_findings(e, count, crop)]
    found += [function_finding(f, rows.names[:plain], rows.columns) for f in functions]
    found += order_not_asked(recorded)
    shifted = shift_finding(shift)
    step()
    return ConfoundAudit(
        findings=ranked([shifted, *found] if shifted else found),
        evidence=evidence,
        outside_share=float(region.outside.mean()) if region.has_outside else None,
        outside_text=region.source.value if region.has_outside else f"no outside: {_why_none(region)}",
        skin_px=_in_frame(region.box, images.shape, rows) if region.has_outside and _one_view(rows) else None,
        shift=shift,
        functions=functions,
        pixels=pixels,
    )


def _why_none(region: SkinRegion) -> str:
    if not region.inside.any() or region.source is RegionSource.EVERYWHERE:
        return region.source.value
    return "touch changes the picture up to its border"


def small_pictures(packed: PackedSet, rows: Indices) -> Float32[np.ndarray, "n h w c"]:
    """Area means of prepared frames, at most 64 along the longer side [grey levels]."""
    height, width, channels = packed.shape
    scale = min(1.0, SMALL_PX / max(height, width))
    size = max(1, round(scale * width)), max(1, round(scale * height))
    small = [
        cv2.resize(frame.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for batch in packed.batches(rows, 64)
        for frame in batch
    ]
    return np.stack(small).reshape(len(rows), size[1], size[0], channels)


def _one_view(rows: AuditedRows) -> bool:
    return rows.packed.preparation.beside_px is None


def _region(
    rows: AuditedRows,
    images: Float32[np.ndarray, "n h w c"],
    units: np.ndarray,
    sessions: np.ndarray,
    skin_px: Box | None,
) -> SkinRegion:
    """The skin in small pictures: as given, or as found, in each view by itself."""
    if skin_px is not None and _one_view(rows):
        return boxed(images.shape[1:3], _in_small(skin_px, images.shape, rows))
    untouched = rest = None
    if rows.untouched is not None and len(rows.untouched) >= 4:
        asked = sampled(len(rows.untouched), 100)
        untouched = small_pictures(rows.untouched, asked)
        if rows.untouched_sessions is not None:
            rest = np.unique(rows.untouched_sessions[asked], return_inverse=True)[1]
    if _one_view(rows):
        return find_skin(images, units, untouched, sessions, rest)
    half = images.shape[2] // 2
    views = [
        find_skin(
            images[:, :, part], units, None if untouched is None else untouched[:, :, part], sessions, rest
        )
        for part in (slice(0, half), slice(half, None))
    ]
    outside, inside = (
        np.concatenate([getattr(view, name) for view in views], axis=1) for name in ("outside", "inside")
    )
    return SkinRegion(outside, inside, views[0].source)


def _evidence(
    rows: AuditedRows,
    orders: Sequence[OrderCheck],
    images: Float32[np.ndarray, "n h w c"],
    region: SkinRegion,
    chosen: Indices,
    units: np.ndarray,
) -> tuple[TargetEvidence, ...]:
    """What order, outside and single places tell of each target, beside what the model does."""
    values, folds = rows.values[chosen], folds_among(rows.split.folds, chosen)
    model = explained_share(rows.values, rows.held_out)
    labels = rows.columns + rows.names[len(rows.columns) :]
    evidence = [
        TargetEvidence(name, order, float(r2), label=label)
        for name, label, order, r2 in zip(rows.names, labels, orders, model, strict=True)
    ]
    if len(chosen) < MIN_ROWS:
        return tuple(evidence)
    if region.has_outside:
        control = outside_control(images, region, values, folds, interleaved_blocks(units[chosen]))
        evidence = [
            replace(
                e,
                outside=float(control.folds[j]),
                outside_blocks=float(control.blocks[j]),
                far=_finite(control.far[j]),
                inside=_finite(control.inside[j]),
            )
            for j, e in enumerate(evidence)
        ]
    cells = telling_cells(images, region, values, folds)
    return tuple(
        replace(e, cell=cell, cell_outside=cell is not None and _is_outside(region, cell.box))
        for e, cell in zip(evidence, cells, strict=True)
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _is_outside(region: SkinRegion, box: Box) -> bool:
    x, y, width, height = box
    return bool(region.has_outside and region.outside[y : y + height, x : x + width].mean() > 0.5)


def _crop_remedy(
    rows: AuditedRows,
    images: Float32[np.ndarray, "n h w c"],
    region: SkinRegion,
    chosen: Indices,
    count: int,
    evidence: Sequence[TargetEvidence],
) -> str:
    """The largest crop about the skin within which the outside tells none of the labels it told."""
    told = [j for j, e in enumerate(evidence) if e.told_outside(count)]
    again = "record it anew without, or cut it away"
    if not _one_view(rows):
        return f"crop both views closer to the skin (`--crop X,Y,WIDTH,HEIGHT` twice); {again}"
    if not region.has_outside:
        return f"cut the place away (`--crop X,Y,WIDTH,HEIGHT`), and calibrate again; {again}"
    box = region.box
    for shrink in SHRINKS:
        box = _shrunk(region.box, shrink)
        if not told or _silent(images, region, box, rows, chosen, count, told):
            break
    x, y, width, height = _in_frame(box, images.shape, rows)
    return (
        f"cut it away by `--crop {x},{y},{width},{height}`, calibrate again, and `palpate evaluate` both on "
        "another session"
    )


def _shrunk(box: Box, factor: float) -> Box:
    x, y, width, height = box
    small = [max(1, int(factor * length)) for length in (width, height)]
    return x + (width - small[0]) // 2, y + (height - small[1]) // 2, small[0], small[1]


def _silent(
    images: Float32[np.ndarray, "n h w c"],
    region: SkinRegion,
    box: Box,
    rows: AuditedRows,
    chosen: Indices,
    count: int,
    told: Sequence[int],
) -> bool:
    """True if what is left of the outside within a crop tells none of these labels."""
    x, y, width, height = box
    part = np.s_[y : y + height, x : x + width]
    beyond = ~region.inside[part]
    if beyond.mean() <= MAX_LEFT_OUTSIDE:
        return True
    pixels = images[:, part[0], part[1]][:, beyond].reshape(len(images), -1)
    values, folds = rows.values[chosen][:, list(told)], folds_among(rows.split.folds, chosen)
    shares = explained_share(values, Kernels.of(pixels).held_out(values, folds))
    return all(float(r2) < min_outside_share(count) for r2 in shares)


def _scale(shape: Sequence[int], rows: AuditedRows) -> tuple[int, int, float, float]:
    """Corner of the prepared picture in the frame, and frame pixels in a small one, across and down."""
    height, width = shape[1:3]
    x, y, across, down = rows.packed.preparation.crop_px or (0, 0, rows.frame_px[1], rows.frame_px[0])
    return x, y, across / width, down / height


def _in_frame(box: Box, shape: Sequence[int], rows: AuditedRows) -> Box:
    x0, y0, across, down = _scale(shape, rows)
    x, y, width, height = box
    return (
        round(x0 + across * x),
        round(y0 + down * y),
        max(1, int(across * width)),
        max(1, int(down * height)),
    )


def _in_small(box: Box, shape: Sequence[int], rows: AuditedRows) -> Box:
    x0, y0, across, down = _scale(shape, rows)
    x, y, width, height = box
    left, top = max(0, int(np.ceil((x - x0) / across))), max(0, int(np.ceil((y - y0) / down)))
    right, bottom = int((x + width - x0) / across), int((y + height - y0) / down)
    return left, top, max(1, right - left), max(1, bottom - top)
