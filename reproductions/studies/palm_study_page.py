"""The tables of the page on the palm's study, made from what the study found, so that the two cannot differ.

    palpate reproduce palm --scale small --seed 0 --out study
    python reproductions/studies/palm_study_page.py --take study  # figures of a study into the page data
    python reproductions/studies/palm_study_page.py --write       # tables of the page from the data

The page asks for a table by a pair of comments, `<!-- study: conditions -->` before it and `<!-- end -->`
after it. What a study has not made is not in the data, and its rows are not in the tables.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.linear_model import RidgeCV
from sklearn.metrics import r2_score
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from palpate.recordings import Run
from palpate_reproductions.palm.palm_comparison import GROUPINGS, MIRROR_SIGHTS
from palpate_reproductions.palm.palm_conditions import (
    ADAPTATION_PRESSES,
    CONDITIONS,
    FOREIGN,
    KINDS,
    NOISES,
    PRESSES,
    SEVERAL,
)
from palpate_reproductions.palm.palm_published import MAE, R2
from palpate_reproductions.palm.palm_setup import MODELS, NETWORKS, pressed_rows

EXPLANATIONS = Path(__file__).resolve().parents[2] / "docs" / "explanations"
PAGE, DATA = EXPLANATIONS / "palm-study.md", EXPLANATIONS / "palm-study.json"
BLOCK = re.compile(r"<!-- study: ([\w-]+) -->\n(.*?)<!-- end -->", re.DOTALL)
LEFT_OUT = ("points", "audit", "options", "calibration", "frame")
TARGETS = ("force_N", "place_mm", "depth_mm")
SAID = {"force_N": "F_z [N]", "place_mm": "place [mm]", "depth_mm": "depth [mm]"}
SHORT = {
    "palm-joint-raw": "Joint multi-task (raw RGB)",
    "palm-force-conditioned": "Force-conditioned (differential RGB)",
    "palm-mlp-delta": "MLP (flattened fringe delta, grey)",
    "palm-two-stage": "Two-stage (differential grey)",
    "palm-compact": "palm-compact (ours)",
    "palm-moments": "palm-moments (no network)",
    "kernel-ridge": "Kernel ridge on pixels",
    "mean": "Always the mean",
}
ACCURATE = ("palm-moments", "kernel-ridge", "palm-compact")
SPLITS = {"(row, column)": "place", "(row, column, cycle)": "place and cycle", "row of the table": "row"}
Data = Mapping[str, Any]


def taken(folder: Path) -> dict[str, Any]:
    """Figures of a study's folder, finished or not: every result and every kept part, in six digits."""
    results = folder / "results"
    found, cpu_s = {}, {}
    for path in sorted(results.rglob("*.json")):
        document = json.loads(path.read_text())
        name = path.relative_to(results).with_suffix("").as_posix().removeprefix("parts/")
        found[name] = rounded(document["found"])
        cpu_s[name] = document["cpu_seconds"]
    return {
        "cpu_seconds": cpu_s,
        "lateral": rounded(lateral(Run.open(folder / "runs" / "protocol"))),
        "found": found,
    }


def lateral(run: Run) -> dict[str, dict[str, float]]:
    """How much of each lateral force depth and place tell without a picture: R² on held-out places."""
    presses = run.labels.iloc[pressed_rows(run)]
    where, groups = presses[["depth_mm", "x_mm", "y_mm"]].to_numpy(float), presses["location"]
    found = {}
    for column in ("force_x_N", "force_y_N"):
        force = presses[column].to_numpy(float)
        model = make_pipeline(
            StandardScaler(), PolynomialFeatures(4), StandardScaler(), RidgeCV(np.logspace(-6, 3, 20))
        )
        estimate = cross_val_predict(model, where, force, groups=groups, cv=GroupKFold(5))
        found[column] = {"sd": float(force.std()), "r2": float(r2_score(force, estimate))}
    return found


def rounded(value: Any) -> Any:
    """Plain values with six digits, without what no table shows."""
    if isinstance(value, dict):
        return {k: rounded(v) for k, v in value.items() if k not in LEFT_OUT}
    if isinstance(value, list):
        return [rounded(v) for v in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def number(value: float) -> str:
    """Three digits, no power of ten."""
    return f"{value:.3g}"


def percent(share: float) -> str:
    """A share in per cent; 100 says all, and 0 none."""
    per_cent = 100 * share
    if 99 < per_cent < 100 or 0 < per_cent < 1:
        return f"{min(max(per_cent, 0.1), 99.9):.1f}"
    return f"{per_cent:.0f}"


def error(scores: Data, target: str) -> str:
    """Mean absolute error with its interval over places; a dash where it is not estimated."""
    if target not in scores:
        return "–"
    one = scores[target]
    return f"{number(one['mae'])} ({number(one['mae_low'])} to {number(one['mae_high'])})"


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown."""
    head = list(head)
    lines = [head, ["---"] * len(head), *map(list, rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def headline(data: Data) -> str:
    """A row a model: printed, at held-out places, off the grid."""
    head = ["model", "steps"]
    for target in TARGETS:
        head += [f"{SAID[target]} printed", "held out", "off the grid"]
    rows = []
    for model in MODELS:
        if (one := data["found"].get(f"headline-{model}")) is None:
            continue
        row = [SHORT[model], str(one["training"]["steps"]) if one["training"] else "–"]
        for target in TARGETS:
            printed = MAE.get((model, target))
            row += [f"{printed.value:g}" if printed else "–"]
            row += [error(one["grid"], target), error(one["new"], target)]
        rows.append(row)
    return table(head, rows)


def common(data: Data) -> str:
    """Errors off the grid of the networks that were given one number of steps, beside their own ends."""
    rows = []
    for model in NETWORKS:
        one, own = data["found"].get(f"setup-{model}-common"), data["found"].get(f"headline-{model}")
        if one is not None and own is not None:
            steps = [str(each["training"]["steps"]) for each in (one, own)]
            cells = [error(each["new"], target) for target in TARGETS for each in (one, own)]
            rows.append([SHORT[model], *steps, *cells])
    head = ["model", "steps in common", "own steps"]
    for target in TARGETS:
        head += [f"{SAID[target]} in common", "at its own end"]
    return table(head, rows)


def coverage(data: Data) -> str:
    """How often 90 % intervals hold the truth off the grid, and what a calibration accepts there."""
    head = ["model", "quantity", "covered [%]", "95 % interval", "half-width over mean error", "accepted [%]"]
    rows = []
    for model in ACCURATE:
        if (one := data["found"].get(f"headline-{model}")) is None:
            continue
        for target in ("force_N", "depth_mm", "x_mm", "y_mm"):
            new = one["new"][target]
            between = f"{percent(new['coverage_low'])} to {percent(new['coverage_high'])}"
            cells = [percent(new["coverage"]), between, number(new["half_width"] / new["mae"])]
            quantity = SAID.get(target, target).split(" [")[0].removesuffix("_mm")
            rows.append([SHORT[model], quantity, *cells, percent(one["new_valid"])])
    return table(head, rows)


def leakage(data: Data) -> str:
    """Errors promised by each split, and kept off the grid."""
    head = ["held out by", "model"]
    for target in TARGETS:
        head += [f"{SAID[target]} held out", "off the grid"]
    rows = []
    for grouping, split in GROUPINGS.items():
        tag = "" if split == "group:location" else f"-by-{split.partition(':')[2].replace(',', '-') or split}"
        for model in ("palm-moments", "kernel-ridge", "palm-compact-network"):
            if (one := data["found"].get(f"setup-{model}{tag}")) is None:
                continue
            cells = [error(one[at], target) for target in TARGETS for at in ("held_out", "new")]
            rows.append([SPLITS[grouping], SHORT.get(model, "palm-compact's network alone"), *cells])
    return table(head, rows)


def mirror(data: Data) -> str:
    """Errors off the grid by how the probe was seen when learnt from, and when tested."""
    found, rows = data["found"], []
    for model in ("palm-moments", "kernel-ridge"):
        for taught in MIRROR_SIGHTS:
            for tested in MIRROR_SIGHTS:
                one = found.get(f"mirror-{model}-{taught}-{tested}".replace(" ", "-"))
                if one is not None:
                    cells = [error(one["targets"], target) for target in TARGETS]
                    rows.append([SHORT[model], taught, tested, *cells, percent(one["valid"])])
    return table(["model", "taught", "tested", *map(SAID.get, TARGETS), "accepted [%]"], rows)


def under(names: Mapping[str, str], kind: str = "condition") -> Callable[[Data], str]:
    """A table of conditions: errors, how often intervals hold the truth, and the share accepted."""

    def made(data: Data) -> str:
        head = [
            "condition",
            "model",
            *map(SAID.get, TARGETS),
            "F_z covered [%]",
            "depth covered [%]",
            "accepted [%]",
        ]
        rows = []
        for name, said in names.items():
            for model in ACCURATE:
                one = data["found"].get(f"{kind}-{name}-{model}")
                if one is not None:
                    cells = [error(one["targets"], target) for target in TARGETS]
                    cells += [percent(one["targets"][t]["coverage"]) for t in ("force_N", "depth_mm")]
                    rows.append([said, SHORT[model], *cells, percent(one["valid"])])
        return table(head, rows)

    return made


def copies(data: Data) -> str:
    """Another copy of the palm, before and after a few presses."""
    rows = []
    for model in ("palm-moments", "palm-compact"):
        for presses in (0, *ADAPTATION_PRESSES):
            one = data["found"].get(f"copy-{model}-{presses}")
            if one is not None:
                cells = [error(one["targets"], target) for target in TARGETS]
                cover = percent(one["targets"]["force_N"]["coverage"])
                rows.append([SHORT[model], str(presses), *cells, cover, percent(one["valid"])])
    return table(["model", "presses", *map(SAID.get, TARGETS), "F_z covered [%]", "accepted [%]"], rows)


def validity(data: Data) -> str:
    """Shares of frames that are flagged."""
    names = {"held-out": "held-out places of the grid", "new-places": "places off the grid"}
    names |= SEVERAL | {one.name: one.said for one in FOREIGN}
    models = [m for m in ACCURATE if f"validity-held-out-{m}" in data["found"]]
    rows = []
    for name, said in names.items():
        rates = [data["found"].get(f"validity-{name}-{model}") for model in models]
        if rates and all(rates):
            shown = []
            for rate in filter(None, rates):
                off = rate.get("force_mae_N")
                shown += [f"{percent(rate['flagged'])} ({percent(rate['low'])} to {percent(rate['high'])})"]
                shown += [number(off) if off is not None else "–"]
            rows.append([said, *shown, str(rates[0]["n"])])
    head = [text for m in models for text in (f"{SHORT[m]}: flagged [%]", "F_z off by [N]")]
    return table(["frames", *head, "number"], rows)


def loads(data: Data) -> str:
    """Other contacts as the models read them."""
    rows = []
    for kind in KINDS:
        for model in ACCURATE:
            if (one := data["found"].get(f"loads-{kind}-{model}")) is not None:
                cells = [number(one["force_mae_N"]), percent(one["stood_by"])]
                rows.append([kind, SHORT[model], *cells, number(one["force_mae_stood_by_N"])])
    return table(["contact", "model", "whole F_z off by [N]", "accepted [%]", "those off by [N]"], rows)


def learnt(data: Data) -> str:
    """Forces and moments that a kernel ridge learns from a kind's own pictures."""
    rows = []
    for kind in KINDS:
        one = data["found"].get(f"loads-{kind}-learnt") or {}
        for target, scores in one.get("targets", {}).items():
            cells = [error(one["targets"], target), f"{scores['r2']:.2f}", number(one["spread"][target])]
            rows.append([kind, target, scores["unit"], *cells])
    return table(["contact", "quantity", "unit", "mean error", "R²", "always the mean"], rows)


def latency(data: Data) -> str:
    """Time of one frame on one thread: of the model alone, and of a whole reading."""
    rows = [
        [
            SHORT[model],
            *(number(one[part][f"{at}_ms"]) for part in ("network", "reading") for at in ("median", "p95")),
        ]
        for model, one in data["found"].get("latency", {}).items()
    ]
    head = ["model", "model alone, median [ms]", "95 % below", "whole reading, median [ms]", "95 % below"]
    return table(head, rows)


def told(data: Data) -> str:
    """Lateral forces of the recording, and how much of them depth and place tell."""
    rows = []
    for column, one in data["lateral"].items():
        printed = R2["palm-two-stage", column]
        share = f"{one['r2']:.2f}".replace("-", "−")
        rows.append([column.removesuffix("_N"), number(one["sd"]), share, f"{printed.value:g}"])
    head = [
        "force",
        "standard deviation [N]",
        "R² of depth and place",
        "R² of the report's two-stage network",
    ]
    return table(head, rows)


STAGES = {
    "recordings": r"recorded",
    "the models without a network": r"headline-(palm-moments|kernel-ridge|mean)",
    "the report's four networks, to their ends": r"headline-palm-(joint|force|mlp|two).*",
    "palm-compact to its end, with 16,000 frames drawn": r"headline-palm-compact",
    "the same number of steps": r"setup-.*-common",
    "leakage, without the network": r"setup-(palm-moments|kernel-ridge)(-by-.*)?",
    "mirror": r"mirror-.*",
    "noise": r"condition-noise-.*",
    "conditions": r"condition-(?!noise-|pressed-|lamp-|room-bright|no-membrane).*",
    "wear": r"condition-pressed-.*",
    "frames to refuse, read again": r"validity-.*",
    "another copy": r"copy-.*",
    "other contacts": r"loads-.*",
    "a press that is held, and the time of a frame": r"sustained|latency",
}
"""Parts of the study, and the results whose time is theirs."""


def time(data: Data) -> str:
    """Processor minutes of each part that was run, and of those that were not, by their steps."""
    rows, total = [], 0.0
    for said, pattern in STAGES.items():
        spent = [s for name, s in data["cpu_seconds"].items() if re.fullmatch(pattern, name)]
        if spent:
            rows.append([said, number(sum(spent) / 60), "measured"])
            total += sum(spent) / 60
    for said, spent_s in data["by_steps"]["recordings_cpu_seconds"].items():
        rows.append([said, number(spent_s / 60), "measured"])
        total += spent_s / 60
    for said, parts in data["by_steps"]["parts"].items():
        minutes = sum(steps * data["by_steps"]["seconds_a_step"][network] for network, steps in parts) / 60
        rows.append([said, number(minutes), "steps times the time of one"])
        total += minutes
    return table(["part", "minutes of one core", "how known"], [*rows, ["in all", number(total), ""]])


TABLES: Mapping[str, Callable[[Data], str]] = {
    "headline": headline,
    "common": common,
    "coverage": coverage,
    "leakage": leakage,
    "mirror": mirror,
    "noise": under({f"noise-{times:g}": f"{times:g} times the noise" for times in NOISES}),
    "conditions": under({one.name: one.said for one in CONDITIONS}),
    "durability": under({f"pressed-{n:g}": f"after {n:g} presses" for n in PRESSES}),
    "copies": copies,
    "validity": validity,
    "lateral": told,
    "time": time,
    "loads": loads,
    "learnt": learnt,
    "latency": latency,
}


def write(page: str, data: Data) -> str:
    """The page with every table that it asks for made anew."""
    return BLOCK.sub(lambda m: f"<!-- study: {m[1]} -->\n\n{TABLES[m[1]](data)}\n<!-- end -->", page)


def stored() -> dict[str, Any]:
    """The page's data."""
    data: dict[str, Any] = json.loads(DATA.read_text(encoding="utf-8"))
    return data


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--take", type=Path, help="the study's folder")
    parser.add_argument("--write", action="store_true", help="write the page's tables")
    asked = parser.parse_args()
    if asked.take:
        data = (stored() if DATA.exists() else {}) | taken(asked.take)
        lines = [f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in data.pop("found").items()]
        head = [f" {json.dumps(k)}: {json.dumps(v)},\n" for k, v in data.items()]
        DATA.write_text(
            "{\n" + "".join(head) + ' "found": {\n' + ",\n".join(lines) + "\n }\n}\n", encoding="utf-8"
        )
    if asked.write:
        PAGE.write_text(write(PAGE.read_text(encoding="utf-8"), stored()), encoding="utf-8")


if __name__ == "__main__":
    main()
