"""The palm's report reproduced on the virtual rig: record, train, score, and write one page of results.

The page reads like the results section of a paper, and goes beyond the source's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import InputError, PalpateError, Progress, silent
from palpate.reports.certificate_page import filled_template
from palpate.version import __version__
from palpate_reproductions import study_figures as draw
from palpate_reproductions.palm import palm_comparison as comparison, palm_conditions as cond
from palpate_reproductions.palm.palm_published import (
    DEPTH,
    FORCE,
    MAE,
    NAMES,
    PEERS,
    PLACE,
    R2,
    TABLE_2,
    targets_with_place,
)
from palpate_reproductions.palm.palm_setup import (
    BASELINES,
    MODELS,
    NETWORKS,
    PUBLISHED,
    SENSING,
    Scale,
    StudyFolder,
)
from palpate_reproductions.palm.palm_summary import summary_of
from palpate_reproductions.study_results import (
    REPORT_FILE,
    SUMMARY_FILE,
    StudyEntry,
    unfinished_work,
    write_results,
)

SHORT = {name: said.split(" (")[0] for name, said in NAMES.items()}
SAID = {
    "force_N": "F_z",
    "force_x_N": "F_x",
    "force_y_N": "F_y",
    "force_magnitude_N": "|F|",
    "depth_mm": "depth",
    "x_mm": "x",
    "y_mm": "y",
    "place_mm": "place (distance)",
}
INITIALS = dict(
    zip(MODELS, ("joint", "cond.", "MLP", "2-st.", "compact", "moments", "kernel", "mean"), strict=True)
)
HEADLINE = (FORCE, PLACE, DEPTH)
Panels = dict[str, dict[str, tuple[list[float], list[float]]]]
LIGHT, DARK = "#35c46a", "#3d7bff"


def write_up(study: StudyFolder, found: Mapping[str, Any]) -> None:
    """Write `summary.json` and `report.html` into the study's folder; one that was stopped begins anew."""
    for name in (SUMMARY_FILE, REPORT_FILE):
        (study.folder / name).unlink(missing_ok=True)
    write_results(study.folder, summary_of(found), palm_page(study, found))


def palm_page(study: StudyFolder, found: Mapping[str, Any]) -> str:
    """The report's HTML."""
    scores = {m: found[f"headline-{m}"] for m in MODELS if f"headline-{m}" in found}
    targets = {m: targets_with_place(setup.columns) for m, setup in study.setups.items()}
    return filled_template(
        "palm_study.html",
        "palpate_reproductions",
        scale=study.scale,
        seed=study.seed,
        version=__version__,
        seconds=study.seconds(),
        found=found,
        scores=scores,
        models=MODELS,
        names=NAMES,
        said=SAID,
        targets=targets,
        headline=HEADLINE,
        sensing=SENSING,
        studied=study.scale.studied,
        by_target={t: [m for m in study.scale.studied if t in targets[m]] for t in HEADLINE},
        networks=NETWORKS,
        short=INITIALS,
        printed=MAE,
        printed_r2=R2,
        training=TABLE_2,
        peers=PEERS,
        verdicts=verdicts(scores),
        figures=_figures(study, found, scores),
        copy={"stiffer": cond.STIFFER - 1, "dimmer": 1 - cond.DIMMER, "warmer_mired": cond.WARMER_MIRED},
    )


def verdicts(scores: Mapping[str, Any]) -> list[str]:
    """Sentences made from the headline's numbers: of each target, who is ahead off the grid."""
    if len(scores) < len(MODELS):
        return []
    return [
        line
        for target in HEADLINE
        for line in (_ahead(scores, target, PUBLISHED), _ahead(scores, target, ("palm-compact",)))
    ]


def _ahead(scores: Mapping[str, Any], target: str, networks: Sequence[str]) -> str:
    """The best of some networks beside the best of the models without one."""
    network, baseline = (_best(scores, target, group) for group in (networks, BASELINES))
    ours, theirs = scores[network]["new"][target], scores[baseline]["new"][target]
    which = "" if len(networks) == 1 else "the best of the published networks, "
    return (
        f"{SAID[target]}, off the grid: {which}{SHORT[network]}, has {ours['mae']:.3g} {ours['unit']}; the "
        f"best model without a network, {SHORT[baseline]}, has {theirs['mae']:.3g} {theirs['unit']} "
        f"(95 % intervals over places: network {beside(ours, theirs)})."
    )


def _best(scores: Mapping[str, Any], target: str, models: Sequence[str]) -> str:
    known = {m: scores[m]["new"][target]["mae"] for m in models if target in scores[m]["new"]}
    return min(known, key=lambda m: known[m])


def beside(network: Mapping[str, float], baseline: Mapping[str, float]) -> str:
    """Whether a network's error is below a baseline's, by 95 % intervals over places that do not overlap."""
    if network["mae_high"] < baseline["mae_low"]:
        return "ahead"
    if baseline["mae_high"] < network["mae_low"]:
        return "behind"
    return "overlapping"


def _figures(study: StudyFolder, found: Mapping[str, Any], scores: Mapping[str, Any]) -> dict[str, str]:
    if len(scores) < len(MODELS):
        return {}
    figures = {
        "force_bars": draw.bars(_bars(scores, FORCE), "F_z mean absolute error [N]"),
        "place_bars": draw.bars(_bars(scores, PLACE), "mean distance of places [mm]"),
        "forces": draw.clouds(_clouds(scores, FORCE), "F_z [N]"),
        "depths": draw.clouds(_clouds(scores, DEPTH), "depth [mm]"),
        "places": _places(scores),
    }
    if "one-frame" in found:
        figures["frame"] = _frame(study, found["one-frame"]["frame"])
    if "noise" in found:
        panels = _against(found["noise"], "times", study.scale.studied)
        figures["noise"] = draw.curves(panels, "noise, over the rig's own")
    if "durability" in found:
        panels = _against(found["durability"], "presses", study.scale.studied)
        panels |= _stood_by(found["durability"], study.scale.studied)
        figures["durability"] = draw.curves(panels, "presses", log_across=True)
    if "sustained" in found:
        figures["sustained"] = _sustained(found["sustained"])
    return figures


def _bars(scores: Mapping[str, Any], target: str) -> list[draw.Bar]:
    rows = []
    for model in SENSING:
        printed, one = MAE.get((model, target)), scores[model]["grid"].get(target)
        if one is not None:
            ends = one["mae_low"], one["mae_high"]
            rows.append(draw.Bar(NAMES[model], printed.value if printed else None, one["mae"], *ends))
    return rows


def _clouds(scores: Mapping[str, Any], target: str) -> list[draw.Cloud]:
    points = {m: scores[m]["points"] for m in SENSING if f"estimate:{target}" in scores[m]["points"]}
    return [draw.Cloud(SHORT[m], p[target], p[f"estimate:{target}"]) for m, p in points.items()]


def _places(scores: Mapping[str, Any]) -> str:
    names = ("x_mm", "y_mm", "estimate:x_mm", "estimate:y_mm")
    points = {m: scores[m]["points"] for m in SENSING if names[2] in scores[m]["points"]}
    return draw.places([SHORT[m] for m in points], [[p[n] for n in names] for p in points.values()])


def _frame(study: StudyFolder, frame: int) -> str:
    run = study.run("protocol")
    boxes = [(run.manifest.regions[name], c) for name, c in (("fringes", LIGHT), ("mirror", DARK))]
    return draw.annotated(run.frame(frame).image, boxes)


def _against(rows: list[dict[str, Any]], across: str, models: Sequence[str]) -> Panels:
    """Errors of the models, a panel a target."""
    panels: Panels = {}
    for target in HEADLINE:
        lines = {}
        for model in models:
            known = [row for row in rows if target in row["models"][model]["targets"]]
            if known:
                y = [row["models"][model]["targets"][target]["mae"] for row in known]
                lines[SHORT[model]] = ([row[across] for row in known], y)
        panels[f"{SAID[target]}: MAE [{'N' if target == FORCE else 'mm'}]"] = lines
    return panels


def _stood_by(rows: list[dict[str, Any]], models: Sequence[str]) -> Panels:
    across = [row["presses"] for row in rows]
    lines = {SHORT[m]: (across, [100 * row["models"][m]["valid"] for row in rows]) for m in models}
    return {"frames accepted [%]": lines}


def _sustained(found: Mapping[str, Any]) -> str:
    panels: Panels = {}
    for target, unit in ((FORCE, "N"), (DEPTH, "mm")):
        lines = {}
        for model, held in found["models"].items():
            if f"estimate:{target}" in held:
                truth, seen = np.array(held[target]), np.array(held[f"estimate:{target}"])
                time_s = np.linspace(0, found["seconds"], len(truth))
                lines[SHORT[model]] = (time_s.tolist(), (seen - truth).tolist())
        panels[f"{SAID[target]}: error [{unit}]"] = lines
    return draw.curves(panels, "time held [s]", log=False)


Stages = dict[str, Callable[[StudyFolder], Any]]
HEADLINE_STAGES: Stages = {
    "recorded": comparison.record_both,
    **{f"headline-{model}": partial(comparison.headline, model=model) for model in MODELS},
    "common-budget": comparison.common_budget,
    "one-frame": comparison.one_frame,
}
STAGES: Stages = HEADLINE_STAGES | {
    "leakage": comparison.leakage,
    "factorial": comparison.factorial,
    "mirror": comparison.mirror,
    "noise": cond.noise,
    "conditions": cond.conditions,
    "durability": cond.durability,
    "sustained": cond.sustained,
    "adaptation": cond.adaptation,
    "loads": cond.loads,
    "validity": cond.validity,
    "latency": comparison.latency,
}
"""What makes each result, in the order in which they are made."""

PARTS: Mapping[str, Stages] = {"all": STAGES, "headline": HEADLINE_STAGES}
"""What is written up when it is done. Any one stage can be made alone, too, and is kept."""


def reproduce_palm(
    out: Path, scale: Scale, *, seed: int = 0, part: str = "all", progress: Progress = silent
) -> list[StudyEntry]:
    """Record, train, score and write up the study into a new folder.

    Every stage's result is kept as it ends, and so are the parts of the long ones. Interrupted, the same call
    goes on from the first that is missing; where a stage fails, the others are made all the same.

    Args:
        out: folder to make; must not exist. It appears when everything is done.
        seed: of everything random: the rig's noise, which places are held out, the networks' beginnings.
        part: "all", "headline" for the comparison of the models alone, or one of `STAGES`, which is kept in
            the unfinished work that a later call for all or for the headline goes on with.
        progress: called with what is being done.

    Returns:
        The numbers, as `summary.json` holds them.
    """
    if part not in PARTS and part not in STAGES:
        raise InputError(f"no part {part!r}; there are {', '.join((*PARTS, *STAGES))}", code="unknown-name")
    study = study_folder(out, scale, seed, progress)
    if part not in PARTS:
        return summary_of(_made(study, {name: STAGES[name] for name in ("recorded", part)}))
    found = _made(study, PARTS[part])
    write_up(study, found)
    entries = summary_of(found)
    study.folder.rename(out)
    return entries


def _made(study: StudyFolder, stages: Stages) -> dict[str, Any]:
    """Every stage's result, made or kept before; one that fails keeps no other from being made."""
    found, failed = {}, {}
    for name, make in stages.items():
        try:
            found[name] = study.kept(name, partial(make, study))
        except Exception as error:  # whatever it is: what the others have found in hours is not lost for it
            failed[name] = error
    if failed:
        first = next(iter(failed.values()))
        raise PalpateError(
            f"{len(failed)} of {len(stages)} parts failed: {', '.join(failed)}; the first of them said: "
            f"{first} ({type(first).__name__}). The others are kept in {study.folder}, and the same command "
            "makes those that are missing",
            code="parts-failed",
        ) from first
    return found


def study_folder(out: Path, scale: Scale, seed: int, progress: Progress = silent) -> StudyFolder:
    """The folder of unfinished work towards `out`, made or found again."""
    asked = {"study": "palm", "scale": scale.name, "seed": seed}
    return StudyFolder(unfinished_work(out, asked), scale, seed, progress)
