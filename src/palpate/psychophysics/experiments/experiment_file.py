"""An experiment's design in a folder: ``experiment.toml``, ``stimuli.csv``, objects that a display renders.

The file says which conditions and presentations there are, of which stimuli each has, in what groups
participants are, and what is asked of them in which order:

    name = "five cups of jelly"
    seed = 7
    conditions = ["I"]                  # I: both cues; K: the arm's; C: the skin's

    [[group]]
    name = "direct"
    participants = 5
    presentations = ["direct"]

    [[stimuli]]
    presentation = "direct"
    condition = "I"
    names = ["cup1", "cup2", "cup3", "cup4", "cup5"]   # of stimuli.csv
    standard = "cup3"
    # objects = [...]                   # of rendered ones: a file for each name; see `softness.object_file`

    [[task]]
    method = "constant"                 # or "staircase", "bayesian", "rank"
    repeats = 3

In each condition the tasks come in the order of the file. Nothing in the file is changed by running it; a
participant who has begun goes on by the same design alone, which digests of all its files see to.

Ready designs, each written as a folder that its owner may edit until the first participant comes.

* ``jelly``: five cups of jelly of other strengths, in ten minutes, with nothing but a spoon and a kettle.
* ``bianchi-2010``: the design of Scilingo, Bianchi, Grioli and Bicchi, IEEE Trans. Haptics 3 (2010) 109,
  doi:10.1109/TOH.2010.2: three conditions, direct and rendered, pairs against the third of five stimuli and
  rankings, three times each, five participants who touch, five who use the display, and five who do both.
* ``threshold``: flats of 21 moduli on a display, placed by what each answer leaves open, and by staircases.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath
from string import Template
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from palpate.core import InputError, LabelError, RangeError, new_folder, sha256_of
from palpate.core.parsing import parser
from palpate.devices.device_plugins import Part, read_toml, validated
from palpate.psychophysics.judgements import (
    STIMULI,
    Condition,
    Presentation,
    Stimulus,
    Task,
    checked_code,
    read_stimuli,
)

EXPERIMENT = "experiment.toml"
Count = Annotated[int, Field(ge=1, le=1000)]
Name = Annotated[str, Field(min_length=1, max_length=80)]


class GroupPart(Part):
    """Participants who meet the same presentations; of two, every other one begins with the second."""

    name: Name
    participants: Count
    presentations: Annotated[tuple[Presentation, ...], Field(min_length=1)]


class StimuliPart(Part):
    """Stimuli of one presentation in one condition.

    Attributes:
        objects: object file of each rendered stimulus, in the folder of the experiment.
        layout: instruction to the experimenter when the condition begins.
    """

    presentation: Presentation
    condition: Condition
    names: Annotated[tuple[str, ...], Field(min_length=2, max_length=400)]
    standard: str = ""
    objects: tuple[str, ...] = ()
    layout: Annotated[str, Field(max_length=400)] = ""

    @field_validator("objects")
    @classmethod
    def _inside(cls, objects: tuple[str, ...]) -> tuple[str, ...]:
        for one in objects:
            if "\\" in one or PurePosixPath(one).is_absolute() or ".." in PurePosixPath(one).parts:
                raise ValueError(
                    f"{one!r} lies outside the experiment's folder; name a file in it, as objects/a.toml"
                )
        return objects

    @model_validator(mode="after")
    def _whole(self) -> StimuliPart:
        if len(set(self.names)) < len(self.names):
            raise ValueError("a name stands twice; give each stimulus once")
        if self.standard and self.standard not in self.names:
            raise ValueError(f"the standard {self.standard!r} is not among {', '.join(self.names)}")
        wanted = len(self.names) if self.presentation is Presentation.RENDERED else 0
        if len(self.objects) != wanted:
            raise ValueError(
                f"{len(self.objects)} objects for {len(self.names)} stimuli; a rendered set has a file for "
                "each of its names, a direct one has none"
            )
        return self


class ConstantPart(Part):
    """Pairs by the method of constant stimuli: the standard against every other stimulus, `repeats` times."""

    method: Literal["constant"]
    repeats: Count


class StaircasePart(Part):
    """Pairs by interleaved transformed up-down staircases (`adaptive_placement.StaircaseRule`)."""

    method: Literal["staircase"]
    sides: Annotated[tuple[Literal["softer", "harder"], ...], Field(min_length=1)] = ("softer", "harder")
    right: Annotated[int, Field(ge=1, le=10)] = 2
    wrong: Annotated[int, Field(ge=1, le=10)] = 1
    steps: Annotated[tuple[Count, ...], Field(min_length=1)] = (2, 1)
    up_ratio: Annotated[int, Field(ge=1, le=10)] = 1
    reversals: Annotated[int, Field(ge=2, le=100)] = 8
    max_trials: Annotated[int, Field(ge=1, le=200)] = 60

    @field_validator("sides")
    @classmethod
    def _once(cls, sides: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(sides)) < len(sides):
            raise ValueError("a side stands twice; give each once")
        return sides


class BayesianPart(Part):
    """Pairs placed where the answer is expected to tell most; see `adaptive_placement.Placement`."""

    method: Literal["bayesian"]
    trials: Annotated[int, Field(ge=1, le=400)]


class RankPart(Part):
    """Rankings of the whole set."""

    method: Literal["rank"]
    repeats: Count


TaskPart = Annotated[ConstantPart | StaircasePart | BayesianPart | RankPart, Field(discriminator="method")]


class ExperimentFile(Part):
    """Contents of ``experiment.toml``; `question` and `request` are the experimenter's words for pairs and
    rankings.
    """

    name: Name
    seed: Annotated[int, Field(ge=0, lt=1 << 63)]
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)]
    group: Annotated[tuple[GroupPart, ...], Field(min_length=1)]
    stimuli: tuple[StimuliPart, ...]
    task: Annotated[tuple[TaskPart, ...], Field(min_length=1)]
    handedness: bool = False
    age: Literal["no", "years", "band"] = "no"
    question: Annotated[str, Field(max_length=200)] = "Which of the two is softer, the first or the second?"
    request: Annotated[str, Field(max_length=200)] = (
        "Please put them in order, from the hardest to the softest."
    )

    @model_validator(mode="after")
    def _whole(self) -> ExperimentFile:
        if len(set(self.conditions)) < len(self.conditions):
            raise ValueError("conditions: one stands twice; give each once")
        if len({one.name for one in self.group}) < len(self.group):
            raise ValueError("group: two of one name; give each a name of its own")
        for group in self.group:
            if len(set(group.presentations)) < len(group.presentations):
                raise ValueError(f"group {group.name}: a presentation stands twice; give each once")
        places = [(one.presentation, one.condition) for one in self.stimuli]
        if len(set(places)) < len(places):
            raise ValueError("stimuli: two sets for one presentation and condition; give one")
        for presentation, condition in self.places():
            if (presentation, condition) not in places:
                raise ValueError(f"stimuli: no set for {presentation.value}, condition {condition.value}")
            of_pairs = any(one.method != "rank" for one in self.task)
            if of_pairs and not self.set_of(presentation, condition).standard:
                raise ValueError(f"stimuli: {presentation.value} {condition.value} has no standard for pairs")
        return self

    def places(self) -> Iterator[tuple[Presentation, Condition]]:
        """Presentations that any group meets, each in all conditions."""
        for presentation in Presentation:
            if any(presentation in group.presentations for group in self.group):
                for condition in self.conditions:
                    yield presentation, condition

    def set_of(self, presentation: Presentation, condition: Condition) -> StimuliPart:
        """The stimuli that are met there."""
        return next(
            one for one in self.stimuli if (one.presentation, one.condition) == (presentation, condition)
        )


def task_of(part: ConstantPart | StaircasePart | BayesianPart | RankPart) -> Task:
    """What is asked by a method."""
    return Task.RANK if part.method == "rank" else Task.PAIR


@dataclass(frozen=True, slots=True)
class ExperimentDesign:
    """A validated experiment folder; `digests` are SHA-256 of the content of each file."""

    folder: Path
    file: ExperimentFile
    stimuli: Mapping[str, Stimulus]
    digests: Mapping[str, str]

    def softness(self, name: str) -> float:
        """A stimulus's level, turned so that it rises with softness."""
        return self.stimuli[name].softness


@parser("experiment", InputError)
def read_design(folder: Path) -> ExperimentDesign:
    """Read an experiment's folder, and check all of it."""
    path = folder / EXPERIMENT
    if not path.is_file():
        raise InputError(f"{folder} has no {EXPERIMENT}; `palpate experiment new` makes a folder with one")
    file = validated(ExperimentFile, path, read_toml(path))
    stimuli = read_stimuli(folder)
    for part in file.stimuli:
        _check_set(path, part, stimuli)
    _check_words(path, file, stimuli)
    digests = {EXPERIMENT: _digest(file.model_dump(mode="json"))}
    digests[STIMULI] = stimuli_digest(stimuli)
    for one in sorted({one for part in file.stimuli for one in part.objects}):
        if not (folder / one).is_file():
            raise InputError(f"{path}: there is no object's file {folder / one}", code="object-path")
        digests[one] = sha256_of(folder / one)
    for part in file.stimuli:
        _check_moduli(folder, part, stimuli)
    return ExperimentDesign(folder, file, stimuli, digests)


def stimuli_digest(stimuli: Mapping[str, Stimulus]) -> str:
    """SHA-256 of what a table of stimuli says, as 64 hexadecimal digits."""
    return _digest([[s.name, repr(s.level), s.softer, s.unit] for s in stimuli.values()])


def _check_set(path: Path, part: StimuliPart, stimuli: Mapping[str, Stimulus]) -> None:
    at = f"{path}: stimuli of {part.presentation.value} {part.condition.value}"
    for name in part.names:
        checked_code(name, "stimulus")
        if name not in stimuli:
            raise InputError(
                f"{at}: {name} is not in {STIMULI}, which has {', '.join(stimuli)}", code="stimulus-unknown"
            )
    softness = [stimuli[name].softness for name in part.names]
    if len(set(softness)) < len(softness):
        raise LabelError(
            f"{at}: two of one level; of such a pair neither answer would be right", code="equal-levels"
        )


def _check_moduli(folder: Path, part: StimuliPart, stimuli: Mapping[str, Stimulus]) -> None:
    """Refuse a flat that is not as stiff as its level says, where levels are moduli."""
    for name, path in zip(part.names, part.objects, strict=False):
        level = stimuli[name]
        material = read_toml(folder / path).get("material") if level.unit == "kPa" else None
        modulus = material.get("modulus_kPa") if isinstance(material, dict) else None
        if isinstance(modulus, int | float) and not math.isclose(modulus, level.level, rel_tol=1e-4):
            raise InputError(
                f"{folder / path}: modulus_kPa = {modulus:g}, and {STIMULI} has {name} at {level.level:g} "
                "kPa; what is felt and what is counted have to be one: give both files the same",
                code="object-level",
            )


def _check_words(path: Path, file: ExperimentFile, stimuli: Mapping[str, Stimulus]) -> None:
    """Refuse words for participants or experimenter that tell which stimulus is meant."""
    for words in (file.question, file.request, *(part.layout for part in file.stimuli)):
        told = [
            name
            for name in stimuli
            if re.search(rf"(?<![^\W_]){re.escape(name)}(?![^\W_])", words, re.IGNORECASE)
        ]
        if told:
            raise InputError(
                f"{path}: {words!r} names the stimulus {told[0]}, so that nobody would be blind",
                code="not-blind",
            )


def _digest(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, ensure_ascii=True).encode()).hexdigest()


PRESETS = ("jelly", "bianchi-2010", "threshold")
FOLDER, OBJECT = Path(__file__).with_name("presets"), "object.toml"
MODULI_KPA = (800.0, 500.0, 300.0, 150.0, 100.0)  # of no silicone in particular: the report's are not printed
CLASSES = {Condition.INTEGRATED: "CL1", Condition.KINESTHETIC: "CL2", Condition.CUTANEOUS: "CL3"}


def make_experiment(
    folder: Path, preset: str, seed: int, moduli_kpa: Sequence[float] | None = None
) -> ExperimentDesign:
    """Write the folder of a preset; `moduli_kpa` of ``bianchi-2010`` are for 0 to 45 % softener."""
    if preset not in PRESETS:
        raise InputError(f"preset {preset!r}; there are {', '.join(PRESETS)}", code="preset-unknown")
    if not 0 <= seed < 1 << 63:
        raise RangeError(f"seed {seed}; 0 to {(1 << 63) - 1} are allowed")
    moduli = _checked_moduli(preset, moduli_kpa)
    with new_folder(folder) as part:
        for name in (EXPERIMENT, STIMULI):
            _fill(preset, name, part / name, {"seed": seed})
        stimuli = read_stimuli(part)
        file = validated(ExperimentFile, part / EXPERIMENT, read_toml(part / EXPERIMENT))
        said = "as given" if moduli_kpa else "of no silicone in particular: put in what you measured"
        given: dict[str, object] = {"moduli": ", ".join(f"{one:g}" for one in moduli), "said": said}
        for rendered in file.stimuli:
            for number, (name, path) in enumerate(zip(rendered.names, rendered.objects, strict=False), 1):
                words = given | {"number": number, "kind": CLASSES[rendered.condition]}
                _fill(preset, OBJECT, part / path, words | {"level": f"{stimuli[name].level:g}"})
        read_design(part)
    return read_design(folder)


def _checked_moduli(preset: str, moduli_kpa: Sequence[float] | None) -> tuple[float, ...]:
    """Moduli of a preset's silicones, from the hardest."""
    if moduli_kpa is not None and preset != "bianchi-2010":
        raise InputError(f"moduli are for the preset bianchi-2010; {preset} has none: leave them out")
    moduli = tuple(moduli_kpa or MODULI_KPA)
    if len(moduli) != len(MODULI_KPA) or not all(0 < one < float("inf") for one in moduli):
        raise InputError(
            f"moduli {moduli} kPa; five above 0 are needed, from 0 to 45 % of softener", code="moduli-count"
        )
    if any(softer >= harder for harder, softer in pairwise(moduli)):
        said = " ".join(f"{one:g}" for one in moduli)
        raise InputError(
            f"moduli {said} kPa; from 0 to 45 % of softener they have to fall", code="moduli-order"
        )
    return moduli


def _fill(preset: str, name: str, path: Path, words: Mapping[str, object]) -> None:
    """Write a file of a preset, with words in the places of their names."""
    path.parent.mkdir(exist_ok=True)
    text = (FOLDER / preset / name).read_text(encoding="utf-8")
    path.write_text(Template(text).substitute(words), encoding="utf-8", newline="")
