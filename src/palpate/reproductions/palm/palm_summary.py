"""Every number of the study as one flat list: name, value, unit, what the source prints, and where."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypedDict

from palpate.estimators.networks import model_kind
from palpate.reproductions.palm.palm_published import MAE, PLACE, R2, PublishedPalm
from palpate.reproductions.palm.palm_setup import MODELS

FIELDS = ("grid", "new")
WHERE = {"grid": "held-out places of the grid", "new": "places off the grid"}


class PalmStudyEntry(TypedDict):
    """One number.

    Attributes:
        name: what it is; value, unit: what was found; published, source: what is printed, and where.
    """

    name: str
    value: float
    unit: str
    published: float | None
    source: str


def summary_of(results: Mapping[str, Any]) -> list[PalmStudyEntry]:
    """All of them; of stages that were not made, none."""
    return [entry for part in _PARTS for entry in part(results)]


def entry(name: str, value: float, unit: str, printed: PublishedPalm | None = None) -> PalmStudyEntry:
    """One number, beside what the source prints of it."""
    where = f"palm-photoelastic-2026, {printed.where}" if printed else ""
    return PalmStudyEntry(
        name=name,
        value=float(value),
        unit=unit,
        published=printed.value if printed else None,
        source=where,
    )


def _headline(results: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    for model in MODELS:
        scores = results.get(f"headline-{model}")
        if scores is None:
            continue
        for at in FIELDS:
            for target, one in scores[at].items():
                # The source's numbers are of held-out places of its grid; off it, it has none.
                mae, r2 = (p.get((model, target)) if at == "grid" else None for p in (MAE, R2))
                name = f"{model}: {target}, {WHERE[at]}"
                yield entry(f"{name}, MAE", one["mae"], one["unit"], mae)
                yield entry(f"{name}, MAE, 95 % low", one["mae_low"], one["unit"])
                yield entry(f"{name}, MAE, 95 % high", one["mae_high"], one["unit"])
                yield entry(f"{name}, RMSE", one["rmse"], one["unit"])
                if one.get("r2") is not None:
                    yield entry(f"{name}, R2", one["r2"], "1", r2)
                if "coverage" in one:
                    yield entry(f"{name}, coverage of 90 % intervals", one["coverage"], "1")
                    yield entry(f"{name}, half-width over MAE", one["half_width"] / one["mae"], "1")
        yield entry(f"{model}: frames stood by, {WHERE['new']}", scores["new_valid"], "1")
        yield entry(f"{model}: time to train and score", scores["seconds"], "s")


def _of_targets(name: str, targets: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    for target, one in targets.items():
        yield entry(f"{name}: {target}, MAE", one["mae"], one["unit"])


def _leakage(results: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    for row in results.get("leakage", []):
        for at in ("held_out", "new"):
            said = "held out" if at == "held_out" else WHERE["new"]
            yield from _of_targets(f"split by {row['grouping']}, {row['model']}, {said}", row[at])


def _factorial(results: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    for row in results.get("factorial", []):
        for at in ("held_out", "new"):
            said = "held out" if at == "held_out" else WHERE["new"]
            yield from _of_targets(f"one architecture, {row['colour']} {row['seen']}, {said}", row[at])


def _mirror(results: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    for row in results.get("mirror", []):
        name = f"mirror, taught {row['taught']}, tested {row['tested']}"
        yield from _of_targets(name, row["targets"])


def _conditions(results: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    for row in results.get("noise", []):
        for model, one in row["models"].items():
            yield from _of_targets(f"{row['times']:g} times the noise, {model}", one["targets"])
    for one in results.get("conditions", {}).values():
        for model, scores in one["models"].items():
            yield from _of_targets(f"{one['said']}, {model}", scores["targets"])
            yield entry(f"{one['said']}, {model}: frames stood by", scores["valid"], "1")


def _wear(results: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    for row in results.get("durability", []):
        for model, one in row["models"].items():
            name = f"after {row['presses']:g} presses (assumed wear), {model}"
            yield from _of_targets(name, one["targets"])
            yield entry(f"{name}: frames stood by", one["valid"], "1")


def _adaptation(results: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    for row in results.get("adaptation", []):
        name = f"a copy after {row['presses']} presses, {row['model']}"
        yield from _of_targets(name, row["targets"])
        yield entry(f"{name}: frames stood by", row["valid"], "1")


def _loads(results: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    for kind, one in results.get("loads", {}).items():
        for model, read in one["models"].items():
            yield entry(f"{kind}, read by {model}: force_N, MAE", read["force_mae_N"], "N")
            yield entry(f"{kind}, read by {model}: frames stood by", read["stood_by"], "1")
        if one["learnt"]:
            yield from _of_targets(f"{kind}, learnt", one["learnt"]["targets"])
            for target, spread in one["learnt"]["spread"].items():
                unit = one["learnt"]["targets"][target]["unit"]
                yield entry(f"{kind}, always the mean: {target}, MAE", spread, unit)
        if "told apart" in one:
            yield entry("shapes told apart", one["told apart"]["right"], "1")


def _validity(results: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    for row in results.get("validity", []):
        for model, rate in row["models"].items():
            yield entry(f"{row['said']}, {model}: frames flagged", rate["flagged"], "1")


def _latency(results: Mapping[str, Any]) -> Iterator[PalmStudyEntry]:
    times = results.get("latency", {})
    for model, parts in times.items():
        for part, said in (("network", "network alone, onnxruntime"), ("reading", "frame to readings")):
            yield entry(f"{model}: {said}, median", parts[part]["median_ms"], "ms")
            yield entry(f"{model}: {said}, 95th percentile", parts[part]["p95_ms"], "ms")
    if times:
        two, ours = (times[m]["network"]["median_ms"] for m in ("palm-two-stage", "palm-compact"))
        yield entry("palm-two-stage over palm-compact, network alone", two / ours, "1")


_PARTS = (
    _headline,
    _leakage,
    _factorial,
    _mirror,
    _conditions,
    _wear,
    _adaptation,
    _loads,
    _validity,
    _latency,
)


def targets_of(model: str) -> tuple[str, ...]:
    """A model's targets, and the place as a whole where it has one."""
    targets = model_kind(model).targets
    return (*targets, PLACE) if "x_mm" in targets else targets
