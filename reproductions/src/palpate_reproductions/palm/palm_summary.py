"""Every number of the study as one flat list: name, value, unit, what the source prints, and where."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from palpate_reproductions.palm.palm_published import MAE, R2
from palpate_reproductions.palm.palm_setup import MODELS
from palpate_reproductions.study_results import StudyEntry, study_entry

WHERE = {"grid": "held-out places of the grid", "new": "places off the grid"}
TIMES = {"network": "network alone, onnxruntime", "reading": "frame to readings"}
entry = partial(study_entry, "palm-photoelastic-2026")


def summary_of(results: Mapping[str, Any]) -> list[StudyEntry]:
    """All of them; of stages that were not made, none."""
    parts = (_headline, _variants, _conditions, _loads, _validity, _latency)
    return [one for part in parts for one in part(results)]


def _headline(results: Mapping[str, Any]) -> Iterator[StudyEntry]:
    for model in MODELS:
        scores = results.get(f"headline-{model}")
        if scores is None:
            continue
        for at, where in WHERE.items():
            for target, one in scores[at].items():
                # The source's numbers are of held-out places of its grid; off it, it has none.
                mae, r2 = (p.get((model, target)) if at == "grid" else None for p in (MAE, R2))
                name = f"{model}: {target}, {where}"
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
        if scores["training"]:
            steps = scores["training"]["steps"]
            yield entry(f"{model}: steps until watched places gained no more", steps, "1")


def _of_targets(name: str, targets: Mapping[str, Any]) -> Iterator[StudyEntry]:
    for target, one in targets.items():
        yield entry(f"{name}: {target}, MAE", one["mae"], one["unit"])


def _stood_by(name: str, scores: Mapping[str, Any]) -> Iterator[StudyEntry]:
    """Errors, and the share of frames that the calibration stands by."""
    yield from _of_targets(name, scores["targets"])
    yield entry(f"{name}: frames stood by", scores["valid"], "1")


def _variants(results: Mapping[str, Any]) -> Iterator[StudyEntry]:
    """Other splits, other inputs, and the mirror seen otherwise."""
    for stage, name in (
        ("common-budget", "the same number of steps, {model}"),
        ("leakage", "split by {grouping}, {model}"),
        ("factorial", "one architecture, {colour} {seen}"),
    ):
        for row in results.get(stage, []):
            yield from _of_targets(f"{name.format(**row)}, held out", row["held_out"])
            yield from _of_targets(f"{name.format(**row)}, {WHERE['new']}", row["new"])
    for row in results.get("mirror", []):
        name = f"mirror, {row['model']}, taught {row['taught']}, tested {row['tested']}"
        yield from _of_targets(name, row["targets"])


def _conditions(results: Mapping[str, Any]) -> Iterator[StudyEntry]:
    """Noise, other conditions, wear, and a copy of the sensor."""
    for row in results.get("noise", []):
        for model, one in row["models"].items():
            yield from _of_targets(f"{row['times']:g} times the noise, {model}", one["targets"])
    for row in results.get("conditions", {}).values():
        for model, one in row["models"].items():
            yield from _stood_by(f"{row['said']}, {model}", one)
    for row in results.get("durability", []):
        for model, one in row["models"].items():
            yield from _stood_by(f"after {row['presses']:g} presses (assumed wear), {model}", one)
    for row in results.get("adaptation", []):
        yield from _stood_by(f"a copy after {row['presses']} presses, {row['model']}", row)


def _loads(results: Mapping[str, Any]) -> Iterator[StudyEntry]:
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


def _validity(results: Mapping[str, Any]) -> Iterator[StudyEntry]:
    for row in results.get("validity", []):
        for model, rate in row["models"].items():
            yield entry(f"{row['said']}, {model}: frames flagged", rate["flagged"], "1")
            if rate.get("force_mae_N") is not None:
                yield entry(f"{row['said']}, {model}: force_N, MAE", rate["force_mae_N"], "N")


def _latency(results: Mapping[str, Any]) -> Iterator[StudyEntry]:
    times = results.get("latency", {})
    for model, parts in times.items():
        for part, said in TIMES.items():
            yield entry(f"{model}: {said}, median", parts[part]["median_ms"], "ms")
            yield entry(f"{model}: {said}, 95th percentile", parts[part]["p95_ms"], "ms")
    if times:
        two, ours = (times[m]["network"]["median_ms"] for m in ("palm-two-stage", "palm-compact"))
        yield entry("palm-two-stage over palm-compact, network alone", two / ours, "1")
