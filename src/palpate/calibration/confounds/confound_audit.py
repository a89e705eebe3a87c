"""Confound audit of a calibration: what other than touch could predict the labels."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from palpate.calibration.calibration_job import CalibrationJob, is_grouped, presses_of, recordings_of
from palpate.calibration.confounds.row_order import (
    OrderCheck,
    RecordedUnits,
    ShiftCheck,
    folds_among,
    order_checks,
    recorded_units,
    sampled,
    shift_check,
    told_by_neighbors,
)
from palpate.calibration.confounds.skin_region import (
    MAP_FILE,
    DecidingPixels,
    RegionSource,
    SkinRegion,
    boxed,
    find_skin,
    outside_shares,
)
from palpate.calibration.confounds.target_functions import (
    Kernels,
    TargetFunction,
    explained_share,
    interleaved_blocks,
    target_functions,
)
from palpate.core import Float32, Indices, Progress, Values, silent
from palpate.estimators.class_sets import Outputs
from palpate.estimators.findings import ConfoundCard, Finding, FindingCode, TargetConfoundCard, ranked
from palpate.recordings import PackedSet

MAX_ROWS = 400  # rows that are tested, evenly spaced over the recording
SMALL_PX = 64  # longer side of the images that are tested
MIN_ROWS = 20
MIN_OUTSIDE_SHARE, OUTSIDE_SHARE_PER_UNIT = 0.1, 4.0  # R² of the outside, and addend over the presses
MIN_AWAY = 0.1  # ratio of what decides a reading outside the skin, above which it is no touch
MAX_BY_NEIGHBORS = 0.5  # R² of the trained rows nearest in order, above which folds test nothing
Box = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class TargetEvidence:
    """Measured predictability of one output; None where it was not tested.

    Attributes:
        column: target, or the name of one of a direction's two outputs.
        model: R² of the model's held-out estimates.
        outside, outside_blocks: R² of the outside on the calibration's folds and on short interleaved blocks.
        away: ratio of the deciding pixels outside the skin.
        label: its label column; empty where that is `column`.
        neighbors: R² of the trained rows nearest in order.
    """

    column: str
    order: OrderCheck
    model: float
    outside: float | None = None
    outside_blocks: float | None = None
    away: float | None = None
    label: str = ""
    neighbors: float | None = None

    @property
    def about(self) -> str:
        return self.label or self.column

    def told_outside(self, units: int) -> bool:
        """True if the outside predicts the label beyond chance, with so many presses."""
        best = max((r for r in (self.outside, self.outside_blocks) if r is not None), default=0.0)
        return best >= MIN_OUTSIDE_SHARE + OUTSIDE_SHARE_PER_UNIT / units

    def finding(self, code: FindingCode, **values: float | str) -> Finding:
        name = output_in_words(self.column, self.about)
        return Finding(code=code, target=self.about, values={"name": name, **values})

    @property
    def card(self) -> TargetConfoundCard:
        return TargetConfoundCard(
            column=self.column,
            rank_correlation=self.order.rank_correlation,
            order_r2=self.order.share,
            order_level=self.order.level,
            model_r2=self.model,
            outside_r2=self.outside,
            outside_r2_blocks=self.outside_blocks,
            neighbors_r2=self.neighbors,
        )


def output_in_words(name: str, label: str) -> str:
    """A target by its label column, or as the cosine or the sine of that.

    Example:
        >>> output_in_words("angle_cos_ratio", "angle_deg")
        'the cosine of angle_deg'
    """
    if name == label:
        return label
    return f"the {'cosine' if name.endswith('_cos_ratio') else 'sine'} of {label}"


def audit_confounds(
    job: CalibrationJob,
    held_out: Outputs,
    *,
    pixels: DecidingPixels | None = None,
    progress: Progress = silent,
) -> ConfoundCard:
    """Test what other than touch could predict the labels.

    Args:
        held_out: outputs ``[n o]`` of models that had not seen the rows; NaN where there are none.
        pixels: deciding pixels; None where not measured.
    """
    rows = _AuditedRows.of(job, held_out)
    progress("looking for confounds", 0, 2)
    shift, evidence = rows.shift(), rows.evidence(pixels)
    progress("looking for confounds", 1, 2)
    count, plain = rows.units.count, len(rows.columns)
    crop = ",".join(map(str, rows.box)) if rows.box is not None else "X,Y,WIDTH,HEIGHT"
    functions = target_functions(
        rows.values[:, :plain], rows.names[:plain], rows.units.of, rows.columns or None
    )
    found = [f for one in evidence for f in target_confounds(one, count, crop, job.parts.kind)]
    found += [function_finding(f, dict(zip(rows.names, rows.labels, strict=True))) for f in functions]
    found += order_not_tested(rows.units)
    if shift.lag:
        values: dict[str, int | float | str] = {"lag": shift.lag, "own": shift.own, "best": shift.best}
        found.insert(0, Finding(code=FindingCode.ROWS_SHIFTED, values=values))
    findings = ranked(found)
    progress("looking for confounds", 2, 2)
    region, shown = rows.region, pixels is not None
    return ConfoundCard(
        failed=any(one.severity == "fails" for one in findings),
        findings=findings,
        targets=tuple(one.card for one in evidence),
        outside_share=float(region.outside.mean()) if region.has_outside else None,
        outside=region.source.value if region.has_outside else f"no outside: {_why_none(region)}",
        skin_px=rows.box,
        row_lag=shift.lag,
        map_file=MAP_FILE if shown else None,
        map_rows=pixels.rows if pixels is not None else None,
    )


def target_confounds(evidence: TargetEvidence, units: int, crop: str, kind: str) -> list[Finding]:
    """Return findings about order, outside, and burnt-in labels of one output.

    Args:
        units: number of presses.
        crop: X,Y,WIDTH,HEIGHT that removes the outside.
        kind: kind of the split.
    """
    order, told, found = evidence.order, evidence.told_outside(units), []
    if told and order.follows:
        shares = {"folds": evidence.outside or 0.0, "blocks": evidence.outside_blocks or 0.0}
        finding = FindingCode.OUTSIDE_DRIFTS
        found.append(evidence.finding(finding, **shares, model=evidence.model, crop=crop))
    if evidence.away is not None and evidence.away > MIN_AWAY and not order.follows:
        found.append(evidence.finding(FindingCode.BURNT_IN, share=evidence.away, crop=crop))
    found += _order_findings(evidence, told, kind)
    return found


def _order_findings(evidence: TargetEvidence, told: bool, kind: str) -> list[Finding]:
    order, found = evidence.order, []
    by_neighbors = evidence.neighbors is not None and evidence.neighbors > MAX_BY_NEIGHBORS
    if order.follows:
        checked = evidence.outside is not None and not by_neighbors
        code = FindingCode.ORDER_CHECKED if checked else FindingCode.ORDER_UNCHECKED
        found.append(
            evidence.finding(
                FindingCode.ORDER_DRIFTS if told else code,
                scale="time" if order.by_time else "order",
                share=order.share,
                rank=order.rank_correlation,
                level=order.level,
                units=order.units,
            )
        )
    elif by_neighbors:
        share = evidence.neighbors or 0.0
        found.append(evidence.finding(FindingCode.ORDER_NEIGHBORS, share=share, kind=kind))
    return found


def order_not_tested(units: RecordedUnits) -> list[Finding]:
    """Return a note if the temporal order of the rows could not be tested."""
    if units.can_be_ordered:
        return []
    if not units.in_recorded_order:
        return [Finding(code=FindingCode.ORDER_UNKNOWN)]
    values: dict[str, int | float | str] = {
        "count": units.count,
        "units": units.kind,
        "sessions": len(units.in_sessions),
    }
    return [Finding(code=FindingCode.ORDER_OF_FEW, values=values)]


def function_finding(function: TargetFunction, labels: dict[str, str]) -> Finding:
    """Return the finding about targets that are functions of each other.

    Args:
        labels: label column of each output name.
    """
    own = labels[function.target]
    values: dict[str, int | float | str] = {
        "name": output_in_words(function.target, own),
        "of": output_in_words(function.of, labels[function.of]),
        "share": function.told,
        "both_ways": int(function.both_ways),
    }
    return Finding(code=FindingCode.FUNCTION, target=own, values=values)


def _why_none(region: SkinRegion) -> str:
    if not region.inside.any() or region.source is RegionSource.EVERYWHERE:
        return region.source.value
    return "touch changes the picture up to its border"


def small_images(packed: PackedSet, rows: Indices) -> Float32[np.ndarray, "n h w c"]:
    """Return area means of prepared frames, at most 64 px along the longer side [grey levels]."""
    height, width, channels = packed.shape
    scale = min(1.0, SMALL_PX / max(height, width))
    size = max(1, round(scale * width)), max(1, round(scale * height))
    small = [
        cv2.resize(frame.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for batch in packed.batches(rows, 64)
        for frame in batch
    ]
    return np.stack(small).reshape(len(rows), size[1], size[0], channels)


@dataclass
class _AuditedRows:
    """Rows of a calibration in the form that its tests need.

    Attributes:
        values: labels as outputs ``[n o]``.
        columns: label column of each output but those of classes, which follow from each other.
        chosen: rows whose images are tested.
    """

    job: CalibrationJob
    held_out: Outputs
    values: Values
    names: tuple[str, ...]
    columns: tuple[str, ...]
    units: RecordedUnits
    chosen: Indices
    images: Float32[np.ndarray, "m h w c"]
    region: SkinRegion = field(init=False)

    @classmethod
    def of(cls, job: CalibrationJob, held_out: Outputs) -> _AuditedRows:
        layout, values = job.plan.layout, job.outputs.values
        columns = tuple(
            column
            for column, period in zip(job.plan.targets, layout.periods, strict=True)
            for _ in range(1 if period is None else 2)
        )
        units = recorded_units(values, presses_of(job.table, job.parts), recordings_of(job.table))
        units = replace(units, in_recorded_order=job.in_recorded_order)
        chosen = sampled(len(values), MAX_ROWS)
        images = small_images(job.packed, chosen)
        rows = cls(job, held_out, values, job.outputs.names, columns, units, chosen, images)
        rows.region = rows._region()
        return rows

    @property
    def labels(self) -> tuple[str, ...]:
        return self.columns + self.names[len(self.columns) :]

    @property
    def one_view(self) -> bool:
        return self.job.packed.preparation.beside_px is None

    def shift(self) -> ShiftCheck:
        if not self.job.in_recorded_order:  # labels in the images' own names are no other image's
            return ShiftCheck(0, float("nan"), float("nan"))
        flat = self.images.reshape(len(self.images), -1)
        return shift_check(Kernels.of(flat), self.values, self.chosen)

    def _region(self) -> SkinRegion:
        """The skin in small images: as given, or as found, in each view by itself."""
        given = self.job.plan.skin_px or self.job.run.manifest.regions.get("skin")
        if given is not None and self.one_view:
            return boxed(self.images.shape[1:3], self._in_small(given))
        rest = self.job.whole.only(self.job.untouched.rows)
        untouched = of_rest = None
        if len(rest) >= 4:
            asked = sampled(len(rest), 100)
            untouched = small_images(rest, asked)
            if (names := recordings_of(rest.table)) is not None:
                of_rest = np.unique(names[asked], return_inverse=True)[1]
        units, sessions = self.units.of[self.chosen], self.units.sessions[self.chosen]
        half = self.images.shape[2] // 2
        parts = [slice(None)] if self.one_view else [slice(0, half), slice(half, None)]
        views = [
            find_skin(
                self.images[:, :, part],
                units,
                None if untouched is None else untouched[:, :, part],
                sessions,
                of_rest,
            )
            for part in parts
        ]
        outside, inside = (
            np.concatenate([getattr(view, name) for view in views], axis=1) for name in ("outside", "inside")
        )
        return SkinRegion(outside, inside, views[0].source)

    def evidence(self, pixels: DecidingPixels | None) -> list[TargetEvidence]:
        job, region = self.job, self.region
        model = explained_share(self.values, self.held_out)
        orders = order_checks(self.values, self.units, job.packed.times_s)
        by_rows = job.parts.groups is None or job.parts.block_rows is not None
        in_turn = job.in_recorded_order and by_rows and not is_grouped(job.table)
        evidence = [
            TargetEvidence(name, order, float(r2), label=label)
            for name, label, order, r2 in zip(self.names, self.labels, orders, model, strict=True)
        ]
        if in_turn:
            for j in range(len(self.columns)):
                told = told_by_neighbors(self.values[:, j], job.parts.folds)
                evidence[j] = replace(evidence[j], neighbors=told)
        if pixels is not None:
            away = pixels.away_from_skin(region).tolist()
            evidence = [replace(one, away=ratio) for one, ratio in zip(evidence, away, strict=True)]
        if len(self.chosen) < MIN_ROWS or not region.has_outside:
            return evidence
        folds, blocks = outside_shares(
            self.images,
            region,
            self.values[self.chosen],
            folds_among(job.parts.folds, self.chosen),
            interleaved_blocks(self.units.of[self.chosen]),
        )
        return [
            replace(one, outside=float(r2), outside_blocks=float(of_blocks))
            for one, r2, of_blocks in zip(evidence, folds, blocks, strict=True)
        ]

    @property
    def box(self) -> Box | None:
        """The box around the skin [px of the recorded frame]; None where there is no outside."""
        return self.in_frame(self.region.box) if self.region.has_outside and self.one_view else None

    def _scale(self) -> tuple[int, int, float, float]:
        height, width = self.images.shape[1:3]
        frame = self.job.run.frame(0).image.shape
        x, y, across, down = self.job.packed.preparation.crop_px or (0, 0, frame[1], frame[0])
        return x, y, across / width, down / height

    def in_frame(self, box: Box) -> Box:
        """A box of the small images in the recorded frame [px]."""
        x0, y0, across, down = self._scale()
        x, y, width, height = box
        corner = round(x0 + across * x), round(y0 + down * y)
        return (*corner, max(1, int(across * width)), max(1, int(down * height)))

    def _in_small(self, box: Box) -> Box:
        x0, y0, across, down = self._scale()
        x, y, width, height = box
        left, top = max(0, int(np.ceil((x - x0) / across))), max(0, int(np.ceil((y - y0) / down)))
        right, bottom = int((x + width - x0) / across), int((y + height - y0) / down)
        return left, top, max(1, right - left), max(1, bottom - top)
