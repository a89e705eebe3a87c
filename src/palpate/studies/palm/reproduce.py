"""The palm's report made again on the virtual rig, and gone beyond: record, train, score, write it up."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from palpate.core.errors import ExistsError, InputError
from palpate.core.files import new_file, refuse_existing, storage_errors
from palpate.estimators.networks.model_interface import Progress, silent
from palpate.studies.palm import conditions as cond
from palpate.studies.palm import questions
from palpate.studies.palm.copies import adaptation
from palpate.studies.palm.headline import headline, one_frame, record_both
from palpate.studies.palm.latency import latency
from palpate.studies.palm.loads import loads
from palpate.studies.palm.report import write_up
from palpate.studies.palm.scale import MODELS, Scale
from palpate.studies.palm.summary import Entry, summary_of
from palpate.studies.palm.validity import validity
from palpate.studies.palm.workshop import Workshop

PLAN_FILE = "study.json"
PARTS = ("all", "headline")


@dataclass(frozen=True, slots=True)
class Stage:
    """A part of the study: its name, and what makes its result."""

    name: str
    make: Callable[[Workshop], Any]


def stages(part: str = "all") -> tuple[Stage, ...]:
    """The parts, in the order in which they are made."""

    def one(model: str) -> Callable[[Workshop], Any]:
        return lambda shop: headline(shop, model)

    first = (
        Stage("recorded", record_both),
        *(Stage(f"headline-{model}", one(model)) for model in MODELS),
        Stage("one-frame", one_frame),
    )
    if part == "headline":
        return first
    return (
        *first,
        Stage("leakage", questions.leakage),
        Stage("factorial", questions.factorial),
        Stage("mirror", questions.mirror),
        Stage("noise", cond.noise),
        Stage("conditions", cond.conditions),
        Stage("durability", cond.durability),
        Stage("sustained", cond.sustained),
        Stage("adaptation", adaptation),
        Stage("loads", loads),
        Stage("validity", validity),
        Stage("latency", latency),
    )


def reproduce_palm(
    out: Path, scale: Scale, *, seed: int = 0, part: str = "all", progress: Progress = silent
) -> list[Entry]:
    """Record, train, score and write up the study into a new folder.

    Interrupted, the same call goes on from the first part that is missing.

    Args:
        out: folder to make; must not exist. It appears when everything is done.
        scale: how large.
        seed: of everything random: the rig's noise, which places are held out, the networks' beginnings.
        part: "all", or "headline" for the comparison of the five models alone.
        progress: told what is being done.

    Returns:
        The numbers, as `summary.json` holds them.

    Raises:
        ExistsError: `out` exists, or unfinished work of another scale, seed or part lies beside it.
        InputError: there is no such part.
    """
    if part not in PARTS:
        raise InputError(f"there is no part {part!r}; there are {', '.join(PARTS)}")
    shop = workshop(out, scale, seed, part, progress)
    found = {stage.name: shop.kept(stage.name, partial(stage.make, shop)) for stage in stages(part)}
    write_up(shop, found)
    entries = summary_of(found)
    shop.folder.rename(out)
    return entries


def workshop(out: Path, scale: Scale, seed: int, part: str = "all", progress: Progress = silent) -> Workshop:
    """The folder of unfinished work towards `out`, made or found again.

    Raises:
        ExistsError: `out` exists, or work of another scale, seed or part lies beside it.
    """
    refuse_existing(out)
    work = out.with_name(f".{out.name}.work")
    wanted = json.dumps({"study": "palm", "scale": scale.name, "seed": seed, "part": part})
    note = work / PLAN_FILE
    if note.is_file() and note.read_text() != wanted:
        raise ExistsError(
            f"{work} holds unfinished work of another scale, seed or part ({note.read_text()}); run that one "
            "again to finish it, remove the folder, or choose another --out"
        )
    if not note.is_file():
        with storage_errors(work):
            work.mkdir(parents=True, exist_ok=True)
        with new_file(note) as path:
            path.write_text(wanted)
    return Workshop(work, scale, seed, progress)
