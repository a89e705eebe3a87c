"""Tables of judgements: what is written is read back, and what cannot be true is refused."""

import math
from dataclasses import replace

import pytest
from tests.psychophysics.responses import write_responses
from tests.refusals import refused

from palpate.core import ExistsError, InputError, LabelError, RangeError
from palpate.psychophysics import (
    Condition,
    Judgement,
    Presentation,
    Stimulus,
    Task,
    checked_judgements,
    read_judgements,
    read_stimuli,
    write_stimuli,
)

STIMULI = [
    Stimulus(f"SS{i + 1}", level, -1, "kPa") for i, level in enumerate((240.0, 170.0, 100.0, 60.0, 35.0))
]
PAIR = Judgement(
    "P01", Condition.INTEGRATED, Presentation.DIRECT, Task.PAIR, 1, 2, ("SS3", "SS1"), ("SS3",), 2.5
)
NAMES = tuple(one.name for one in STIMULI)
RANK = Judgement("P02", Condition.CUTANEOUS, Presentation.RENDERED, Task.RANK, 1, 1, NAMES[::-1], NAMES)
BY_NAME = {one.name: one for one in STIMULI}


def test_tables_come_back_as_they_were_written_and_are_never_overwritten(tmp_path) -> None:
    write_responses(tmp_path / "responses.csv", [PAIR, RANK])
    write_stimuli(tmp_path / "stimuli.csv", STIMULI)
    pair, rank = read_judgements(tmp_path)
    assert pair == PAIR
    assert math.isnan(rank.seconds)
    assert replace(rank, seconds=0.0) == replace(RANK, seconds=0.0)
    assert list(read_stimuli(tmp_path).values()) == STIMULI
    with pytest.raises(ExistsError):
        write_stimuli(tmp_path / "stimuli.csv", STIMULI)


def test_the_right_answer_is_the_softer_one_and_the_order_from_the_least_soft() -> None:
    assert PAIR.right(BY_NAME)
    assert not replace(PAIR, answer=("SS1",)).right(BY_NAME)
    assert RANK.right(BY_NAME)
    turned = {name: replace(one, softer=1) for name, one in BY_NAME.items()}
    assert not PAIR.right(turned)
    assert RANK.truth(turned) == NAMES[::-1]


@pytest.mark.parametrize("answer", [("SS1",) * 5, NAMES[:4], (*NAMES[:4], "SS9"), (*NAMES, "SS1")])
def test_a_ranking_that_is_no_permutation_is_refused(answer) -> None:
    with refused("not-a-permutation", InputError):
        replace(RANK, answer=answer)


def test_an_answer_that_was_not_presented_and_a_missing_one_are_refused() -> None:
    for answer in (("SS2",), (), ("SS1", "SS3")):
        with refused("answer-unknown", InputError):
            replace(PAIR, answer=answer)


@pytest.mark.parametrize(
    "code", ["../P01", "/etc/passwd", "P 01", "", "P01\n", "Ann Smith", "a" * 33, "..", "-P"]
)
def test_a_participant_code_that_is_a_path_or_a_name_is_refused(code) -> None:
    with refused("participant-code", InputError, match="P01"):
        replace(PAIR, participant=code)


def test_a_judgement_that_stands_twice_is_refused() -> None:
    with pytest.raises(LabelError, match="stands twice"):
        checked_judgements([PAIR, replace(PAIR, answer=("SS1",))])
    assert len(checked_judgements([PAIR, replace(PAIR, block=2)])) == 2


def test_a_stimulus_that_is_not_known_and_two_of_one_softness_have_no_right_answer() -> None:
    with refused("stimulus-unknown", InputError):
        PAIR.right({"SS1": STIMULI[0]})
    with refused("equal-levels", InputError):
        PAIR.right(BY_NAME | {"SS1": replace(STIMULI[0], level=100.0)})


def test_damaged_tables_are_named_by_their_row(tmp_path) -> None:
    path = tmp_path / "responses.csv"
    write_responses(path, [PAIR, RANK])
    good = path.read_text()
    for words, said in (
        (good.replace(",pair,", ",pare,"), "row 1"),
        (good.replace("P02", "../P02"), "row 2"),
        (good.replace("condition", "kind"), "no column condition"),
        (good.replace(",1,2,", ",one,2,"), "row 1"),
        (good + good.splitlines()[1] + "\n", "stands twice"),
    ):
        path.write_text(words)
        with pytest.raises(LabelError, match=said):
            read_judgements(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(LabelError):
        read_judgements(path)
    with refused("file-missing", LabelError, match=r"responses\.csv"):
        read_judgements(_empty(tmp_path))


@pytest.mark.parametrize("seconds", [-1.0, math.inf, -math.inf])
def test_no_answer_comes_before_its_question_or_never(seconds: float, tmp_path) -> None:
    with refused("response-time", RangeError):
        replace(PAIR, seconds=seconds)
    path = tmp_path / "responses.csv"
    write_responses(path, [PAIR])
    path.write_text(path.read_text().replace(",2.500,", f",{seconds},"))
    with refused("table-row", LabelError, match="P01"):
        read_judgements(path)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("stimulus;level;unit;softer\nA;3,3;g;1\n", "table-separator"),
        ('stimulus,level,unit,softer\nA,"3,3",g,1\n', "table-number"),
        ("stimulus,level,unit,softer\nA,3,3,g,1\n", "table-columns"),
    ],
)
def test_a_table_with_decimal_commas_or_semicolons_is_told_its_mend(rows: str, said: str, tmp_path) -> None:
    (tmp_path / "stimuli.csv").write_text(rows)
    with refused(said, LabelError):
        read_stimuli(tmp_path)


def _empty(tmp_path):
    (tmp_path / "none").mkdir()
    return tmp_path / "none"
