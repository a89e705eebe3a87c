"""Which trial comes next for a participant: a pure function of design, seed, number and the answers so far.

What is drawn is drawn by sorting: items come in the order of the SHA-256 of seed, participant's number, place
and item. That is a random order which no version of a library changes, and which anybody can check.

Participants are counted in the order in which they come. Of groups one place each is filled in a drawn order,
round by round. Within a group the orders of conditions follow the rows of a Williams design, in which each
condition stands in each place, and after each other condition, equally often (E. J. Williams, Aust. J. Sci.
Res. A 2 (1949) 149, doi:10.1071/CH9490149); groups begin at different rows, so that three groups of five
leave out a whole Latin square.

In a block every comparison meets the standard once, in a drawn order, with the standard first in half of
them, and first in the next block where it was second in this one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

from palpate.core import InputError, LabelError
from palpate.psychophysics.experiments.adaptive_placement import (
    Placement,
    StaircaseRule,
    StaircaseState,
    begin_staircase,
    step_staircase,
)
from palpate.psychophysics.experiments.experiment_file import (
    BayesianPart,
    ConstantPart,
    ExperimentDesign,
    ExperimentFile,
    GroupPart,
    RankPart,
    StaircasePart,
    StimuliPart,
    task_of,
)
from palpate.psychophysics.judgements import Condition, Judgement, Presentation, Task

Item = TypeVar("Item", bound=Hashable)


def drawn_order(items: Sequence[Item], *place: object) -> list[Item]:
    """A random order of items, the same for the same words that say what for."""
    words = "\0".join(map(str, place))
    return sorted(items, key=lambda one: hashlib.sha256(f"{words}\0{one}".encode()).digest())


def draw_of(seed: int, number: int, simulated: bool) -> tuple[object, ...]:
    """The first words of what is drawn for a participant; a rehearsal's are others than a person's."""
    return (seed, number, "simulated") if simulated else (seed, number)


def williams_rows(count: int) -> list[tuple[int, ...]]:
    """Return orders of `count` conditions, balanced for first-order carryover; 2 x count rows if odd."""
    zigzag = [(k + 1) // 2 if k % 2 else -(k // 2) for k in range(count)]
    square = [tuple((one + row) % count for one in zigzag) for row in range(count)]
    if count % 2 == 0 or count == 1:
        return square
    return [row for one in square for row in (one, one[::-1])]


def allocation(file: ExperimentFile, number: int) -> tuple[int, int]:
    """Return group and position within the group, from 0, of participant `number`, from 1."""
    sizes = [group.participants for group in file.group]
    turns = [
        group
        for turn in range(max(sizes))
        for group in drawn_order([g for g, size in enumerate(sizes) if size > turn], file.seed, "group", turn)
    ]
    rounds, index = divmod(number - 1, len(turns))
    group = turns[index]
    return group, rounds * sizes[group] + turns[:index].count(group)


def order_of_conditions(file: ExperimentFile, number: int) -> Iterator[tuple[Presentation, Condition]]:
    """Presentations and conditions in the order in which a participant meets them."""
    group, place = allocation(file, number)
    named = drawn_order(file.conditions, file.seed, "conditions")
    rows = williams_rows(len(named))
    presentations: Sequence[Presentation] = file.group[group].presentations
    if (place // min(2, len(rows))) % 2:  # by twos, so that each row comes with either presentation first
        presentations = presentations[::-1]
    for k, presentation in enumerate(presentations):
        for one in rows[(place + 2 * group + k) % len(rows)]:
            yield presentation, named[one]


@dataclass(frozen=True, slots=True)
class PlannedTrial:
    """The next trial, with the stimuli in order of presentation."""

    presentation: Presentation
    condition: Condition
    task: Task
    block: int
    trial: int
    presented: tuple[str, ...]

    def fits(self, judgement: Judgement) -> bool:
        """Whether a judgement is one of this trial."""
        return self == PlannedTrial(
            judgement.presentation, judgement.condition, judgement.task, judgement.block, judgement.trial,
            judgement.presented,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class BlockPlace:
    """Place of a block in a participant's schedule; blocks of a task count from 1 in each condition."""

    presentation: Presentation
    condition: Condition
    task: Task
    block: int

    @property
    def place(self) -> tuple[Presentation, Condition, Task, int]:
        return (self.presentation, self.condition, self.task, self.block)


@dataclass(frozen=True, slots=True)
class FixedBlock(BlockPlace):
    """A block whose trials are known beforehand: of constant stimuli, or one ranking."""

    trials: tuple[tuple[str, ...], ...]

    @property
    def max_trials(self) -> int:
        return len(self.trials)

    def next(self, answers: Sequence[str]) -> tuple[str, ...] | None:
        return self.trials[len(answers)] if len(answers) < len(self.trials) else None


@dataclass(frozen=True, slots=True)
class StaircaseBlock(BlockPlace):
    """Interleaved staircases.

    Attributes:
        sides: comparisons of each track, nearest to the standard first.
        turns: order of tracks in each round.
    """

    standard: str
    sides: tuple[tuple[str, ...], ...]
    softer: tuple[bool, ...]
    rule: StaircaseRule
    turns: tuple[tuple[int, ...], ...]
    standard_first: tuple[bool, ...]

    @property
    def max_trials(self) -> int:
        return len(self.standard_first)

    def next(self, answers: Sequence[str]) -> tuple[str, ...] | None:
        _, following = self._follow(answers)
        return following

    def tracks(self, answers: Sequence[str]) -> tuple[StaircaseState, ...]:
        """How each track stands after some answers."""
        states, _ = self._follow(answers)
        return states

    def _follow(self, answers: Sequence[str]) -> tuple[tuple[StaircaseState, ...], tuple[str, ...] | None]:
        states = [begin_staircase(len(side)) for side in self.sides]
        done = 0
        for turn in self.turns:
            for track in turn:
                if states[track].ended:
                    continue
                comparison = self.sides[track][states[track].place]
                if done == len(answers):
                    return tuple(states), _pair(self.standard, comparison, self.standard_first[done])
                right = (answers[done] == comparison) == self.softer[track]
                states[track] = step_staircase(self.rule, len(self.sides[track]), states[track], right)
                done += 1
        return tuple(states), None


@dataclass(frozen=True, slots=True)
class BayesianBlock(BlockPlace):
    """A block whose comparisons are placed by what the answers so far leave open."""

    standard: str
    comparisons: tuple[str, ...]
    x: tuple[float, ...]
    standard_first: tuple[bool, ...]

    @property
    def max_trials(self) -> int:
        return len(self.standard_first)

    def next(self, answers: Sequence[str]) -> tuple[str, ...] | None:
        if len(answers) >= len(self.standard_first):
            return None
        _, chosen = _placed(self.x, self.comparisons, tuple(answers))
        comparison = self.comparisons[chosen]
        return _pair(self.standard, comparison, self.standard_first[len(answers)])


@lru_cache(maxsize=2048)  # each answer then costs one step, though the whole block is gone through
def _placed(
    x: tuple[float, ...], comparisons: tuple[str, ...], answers: tuple[str, ...]
) -> tuple[Placement, int]:
    if answers:
        before, chosen = _placed(x, comparisons, answers[:-1])
        placement = before.after(chosen, answers[-1] == comparisons[chosen])
    else:
        placement = Placement.of_differences(x)
    return placement, placement.next


PlannedBlock = FixedBlock | StaircaseBlock | BayesianBlock
"""Each has `max_trials` and `next`, the stimuli presented after some answers; None at the end."""


def _pair(standard: str, comparison: str, standard_first: bool) -> tuple[str, str]:
    return (standard, comparison) if standard_first else (comparison, standard)


@dataclass(frozen=True, slots=True)
class Schedule:
    """All blocks of a participant, in order."""

    number: int
    group: GroupPart
    blocks: tuple[PlannedBlock, ...]

    @property
    def digest(self) -> str:
        """SHA-256 of the whole schedule, as 64 hexadecimal digits."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def text(self) -> str:
        """The schedule as JSON, a line a block: what is known before the first answer."""
        head = json.dumps({"number": self.number, "group": self.group.name})
        return "\n".join([head, *(json.dumps(_block_row(block)) for block in self.blocks)]) + "\n"

    @property
    def max_trials(self) -> int:
        """How many judgements there will be, or at most where staircases end by reversals."""
        return sum(block.max_trials for block in self.blocks)

    @property
    def is_fixed(self) -> bool:
        """Whether there will be so many, since no staircase may end by its reversals."""
        return not any(isinstance(block, StaircaseBlock) for block in self.blocks)

    def next(self, judgements: Sequence[Judgement]) -> PlannedTrial | None:
        """Return the trial after the given judgments, None at the end; reject judgments not
        on the schedule.
        """
        i = 0
        for block in self.blocks:
            answers: list[str] = []
            while (presented := block.next(answers)) is not None:
                planned = PlannedTrial(*block.place, len(answers) + 1, presented)
                if i == len(judgements):
                    return planned
                if not planned.fits(judgements[i]):
                    raise LabelError(
                        f"judgement {i + 1} of {judgements[i].participant} is not the one that the schedule "
                        f"asks for there, block {planned.block}, trial {planned.trial} of "
                        f"{planned.presentation.value} {planned.condition.value} {planned.task.value}: a row "
                        "is missing, stands twice or was changed; put the table back as it was written",
                        code="schedule",
                    )
                answers.append(" ".join(judgements[i].answer))
                i += 1
        if i < len(judgements):
            raise LabelError(f"{len(judgements)} judgements, and the schedule asks for {i}; leave none twice")
        return None


def _block_row(block: PlannedBlock) -> dict[str, object]:
    row: dict[str, object] = {
        "presentation": block.presentation.value, "condition": block.condition.value,
        "task": block.task.value, "block": block.block,
    }  # fmt: skip
    if isinstance(block, FixedBlock):
        return row | {"trials": block.trials}
    row |= {"standard": block.standard, "standard_first": block.standard_first}
    if isinstance(block, BayesianBlock):
        return row | {"comparisons": block.comparisons, "x": block.x}
    rule = {name: getattr(block.rule, name) for name in block.rule.__slots__}
    return row | {"sides": block.sides, "softer": block.softer, "rule": rule, "turns": block.turns}


def make_schedule(design: ExperimentDesign, number: int, simulated: bool = False) -> Schedule:
    """Return the schedule of participant `number`, from 1; rehearsals have trials of their own."""
    if number < 1:
        raise InputError(f"participant number {number}; they count from 1")
    blocks: list[PlannedBlock] = []
    for presentation, condition in order_of_conditions(design.file, number):
        stimuli = design.file.set_of(presentation, condition)
        count = {Task.PAIR: 0, Task.RANK: 0}
        for k, part in enumerate(design.file.task):
            begin = count[task_of(part)] + 1
            place = (*draw_of(design.file.seed, number, simulated), presentation.value, condition.value, k)
            made = list(_blocks(design, stimuli, part, begin, place))
            count[task_of(part)] += len(made)
            blocks += made
    return Schedule(number, design.file.group[allocation(design.file, number)[0]], tuple(blocks))


def _blocks(
    design: ExperimentDesign,
    stimuli: StimuliPart,
    part: ConstantPart | StaircasePart | BayesianPart | RankPart,
    begin: int,
    place: tuple[object, ...],
) -> Iterator[PlannedBlock]:
    where = (stimuli.presentation, stimuli.condition, task_of(part))
    comparisons = tuple(name for name in stimuli.names if name != stimuli.standard)
    match part:
        case ConstantPart():
            for k in range(part.repeats):
                trials = _balanced_pairs(stimuli.standard, comparisons, k, place)
                yield FixedBlock(*where, begin + k, trials)
        case RankPart():
            for k in range(part.repeats):
                yield FixedBlock(*where, begin + k, (tuple(drawn_order(stimuli.names, *place, "rank", k)),))
        case BayesianPart():
            x = tuple(design.softness(one) - design.softness(stimuli.standard) for one in comparisons)
            yield BayesianBlock(
                *where, begin, stimuli.standard, comparisons, x, _firsts(part.trials, place)
            )  # fmt: skip
        case StaircasePart():
            yield _staircases(design, stimuli, part, begin, place)


def _balanced_pairs(
    standard: str, comparisons: tuple[str, ...], block: int, place: tuple[object, ...]
) -> tuple[tuple[str, ...], ...]:
    """The pairs of a block; two blocks that follow each other have each pair in either order."""
    two, second = divmod(block, 2)
    half = drawn_order(comparisons, *place, "half", two)[: len(comparisons) // 2]
    return tuple(
        _pair(standard, one, (one in half) != bool(second))
        for one in drawn_order(comparisons, *place, "pairs", block)
    )


def _firsts(trials: int, place: tuple[object, ...]) -> tuple[bool, ...]:
    """Whether the standard comes first, in each two trials once."""
    return tuple(
        first
        for two in range((trials + 1) // 2)
        for first in drawn_order((True, False), *place, "first", two)
    )[:trials]


def _staircases(
    design: ExperimentDesign, stimuli: StimuliPart, part: StaircasePart, begin: int, place: tuple[object, ...]
) -> StaircaseBlock:
    base = design.softness(stimuli.standard)
    sides = []
    for side in part.sides:
        sign = 1 if side == "softer" else -1
        beside = [one for one in stimuli.names if sign * (design.softness(one) - base) > 0]
        if not beside:
            raise InputError(
                f"a staircase on the {side} side of {stimuli.presentation.value} {stimuli.condition.value}, "
                "which has no stimulus there; leave that side out or add one"
            )
        sides.append(tuple(sorted(beside, key=lambda one: abs(design.softness(one) - base))))
    rule = StaircaseRule(
        part.right, part.wrong, part.steps, part.up_ratio, part.reversals, part.max_trials
    )  # fmt: skip
    turns = tuple(tuple(drawn_order(range(len(sides)), *place, "turn", k)) for k in range(part.max_trials))
    return StaircaseBlock(
        stimuli.presentation, stimuli.condition, Task.PAIR, begin, stimuli.standard, tuple(sides),
        tuple(side == "softer" for side in part.sides), rule, turns,
        _firsts(part.max_trials * len(sides), place),
    )  # fmt: skip


def tracks_of(
    schedule: Schedule, judgements: Sequence[Judgement]
) -> Iterator[tuple[StaircaseBlock, tuple[StaircaseState, ...]]]:
    """How the staircases of a participant stand, block by block; those not begun are left out."""
    for block in schedule.blocks:
        if isinstance(block, StaircaseBlock):
            answers = [
                " ".join(one.answer)
                for one in judgements
                if (one.presentation, one.condition, one.task, one.block) == block.place
            ]
            if answers:
                yield block, block.tracks(answers)
