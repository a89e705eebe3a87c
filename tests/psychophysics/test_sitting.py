"""Sittings: an answer is on disk at once, nothing is asked twice or left out, and all are blind."""

import errno
import os
import re
from pathlib import Path

import pytest
from tests.psychophysics.sitting_desks import NOW, Desk, Presenter, jelly, sit
from tests.refusals import refused

from palpate.core import (
    DeviceError,
    ExistsError,
    InputError,
    LabelError,
    RangeError,
    RecordingError,
    StorageError,
)
from palpate.psychophysics import read_judgements
from palpate.psychophysics.experiments import (
    Enrolment,
    Sitting,
    SittingDialogue,
    ask_enrolment,
    enrol,
    laterality_quotient,
    make_experiment,
    noisy_answers,
    participant_folder,
    read_design,
    read_kept_answers,
    records,
)
from palpate.psychophysics.experiments.experiment_file import EXPERIMENT
from palpate.psychophysics.experiments.participant_record import (
    ACTIVITIES,
    ResponseLog,
    checked_age,
    letter_codes,
)
from palpate.psychophysics.experiments.sitting import KEY, SCHEDULE


def table(design, participant: str = "P01") -> Path:
    return participant_folder(design, participant) / "responses.csv"


def opened(design, participant: str = "P01") -> Sitting:
    return Sitting(design, participant, lambda: NOW)


def test_a_sitting_asks_all_in_the_order_of_the_schedule_and_keeps_each_answer(tmp_path) -> None:
    design = jelly(tmp_path)
    desk = Desk(["1", "2"] * 6 + ["2 1 5 4 3"])
    outcome = sit(design, desk)
    assert outcome.complete
    assert outcome.kept == 13
    assert any("cues), direct" in one for one in desk.told)
    judgements = read_judgements(tmp_path / "jelly")
    with opened(design) as sitting:
        assert sitting.next is None
        assert sitting.schedule.next(judgements) is None
        with pytest.raises(InputError, match="answered all"):
            sitting.take(("cup1",), 1.0)
    assert judgements[0].answer == judgements[0].presented[:1]
    assert judgements[1].answer == judgements[1].presented[1:]
    last = judgements[-1]
    assert last.answer == tuple(last.presented[k] for k in (1, 0, 4, 3, 2))
    assert {one.seconds for one in judgements} == {1.5}, "from when the specimens lay there to the answer"
    assert {one.when for one in judgements} == {NOW}


def test_a_pause_goes_on_where_it_was_and_letters_answer_as_places_do(tmp_path) -> None:
    design = jelly(tmp_path)
    codes = letter_codes(design, 1)
    with opened(design) as sitting:
        first = sitting.next
    letter = codes[first.presentation, first.condition, first.presented[1]]
    paused = sit(design, Desk([letter.lower(), "q"]))
    assert (paused.complete, paused.kept, paused.fault) == (False, 1, None)
    assert read_judgements(table(design))[0].answer == first.presented[1:]
    assert sit(design, Desk(["1"] * 11 + ["12345"])).complete
    assert len({one.key for one in read_judgements(table(design))}) == 13
    events = (participant_folder(design, "P01") / "sittings.csv").read_text().splitlines()
    assert [line.split(",")[1] for line in events[1:]] == ["begins", "pauses", "goes on", "ends"]


@pytest.mark.parametrize("kept", [0, 1, 5, 12])
def test_whatever_the_crash_the_order_is_the_same_and_nothing_is_asked_twice(kept: int, tmp_path) -> None:
    whole, broken = jelly(tmp_path / "a"), jelly(tmp_path / "b")
    sit(whole, Desk(), observed=True)
    desk = Desk()
    answer = noisy_answers(broken, "P01", 0.0)
    with opened(broken) as sitting:
        for _ in range(kept):
            sitting.take(answer(sitting.next), 0.0)
    with table(broken).open("a") as file:
        file.write("P01,I,direct,pair,1,")  # the row that a kill cut short
    with opened(broken) as sitting:
        assert sitting._log.torn == 20
        assert len(sitting.judgements) == kept
    sit(broken, desk, observed=True)
    assert table(whole).read_text() == table(broken).read_text()


def test_a_row_that_was_cut_anywhere_is_asked_again(tmp_path) -> None:
    design = jelly(tmp_path)
    sit(design, Desk(["1", "2", "q"]))
    whole = table(design).read_bytes()
    begin = whole[:-1].rfind(b"\n") + 1
    assert whole.endswith(b",no\n")
    for cut in [*range(begin, len(whole) - 2, 7), len(whole) - 2]:
        table(design).write_bytes(whole[:cut])
        with opened(design) as sitting:
            assert len(sitting.judgements) == 1
            assert table(design).read_bytes() == whole[:begin]
            assert (sitting.next.block, sitting.next.trial) == (1, 2)
            assert sitting.torn == cut - begin
            desk = Desk(["q"])
            SittingDialogue(sitting, desk, None, desk.clock).run()
        assert any("asked again" in one for one in desk.told) is (cut > begin)


def test_a_table_with_a_row_missing_twice_or_changed_is_refused(tmp_path) -> None:
    design = jelly(tmp_path)
    sit(design, Desk(["1"] * 6 + ["q"]))
    lines = table(design).read_text().splitlines(keepends=True)
    for damaged, said in (
        (lines[:2] + lines[3:], "row is missing"),
        ([*lines, lines[-1]], "stands twice"),
        ([lines[0], lines[1].replace(",1,1,", ",1,7,"), *lines[2:]], "was changed"),
        (["participant\n", *lines[1:]], "no column"),
    ):
        table(design).write_text("".join(damaged))
        with pytest.raises(LabelError, match=said):
            opened(design)
    table(design).write_text("".join(lines))
    opened(design).close()


def test_a_design_schedule_key_or_number_that_was_changed_between_sittings_is_refused(tmp_path) -> None:
    design = jelly(tmp_path)
    folder = participant_folder(design, "P01")
    for path, old, new, said in (
        (design.folder / EXPERIMENT, "repeats = 3", "repeats = 2", "experiment.toml of .* changed since P01"),
        (design.folder / EXPERIMENT, "seed = 5", "seed = 6", "experiment.toml of .* changed since P01"),
        (design.folder / "stimuli.csv", "3.3", "3.4", "stimuli.csv of .* changed since P01"),
        (folder / "participant.json", '"number": 1', '"number": 2', "participant.json was changed"),
        (folder / "participant.json", '"simulated": false', '"simulated": true', "was changed: simulated"),
        (folder / SCHEDULE, "cup1", "cup2", "schedule.jsonl was changed since P01"),
        (folder / KEY, "cup1", "cup2", "key.csv was changed since P01"),
    ):
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))
        with pytest.raises(InputError, match=said):
            opened(read_design(design.folder))
        path.write_text(text)
    opened(read_design(design.folder)).close()
    (folder / "participant.json").write_text("{}")
    with pytest.raises(LabelError, match="damaged"):
        opened(design)


def test_nothing_that_is_told_or_named_says_which_stimulus_it_is(tmp_path) -> None:
    design = make_experiment(tmp_path / "study", "bianchi-2010", 3)
    for k in range(4):
        enrol(design, f"P{k}", Enrolment(True))
    for one in records(design):
        desk, presenter = Desk(["9", "s2", "1", "12", "s2", "2", "x", *["s2", "1"] * 2, "q"]), Presenter()
        presenter.refuses = 2
        answer = noisy_answers(design, one.participant, 20.0)
        with opened(design, one.participant) as sitting:
            desk.mend = desk.wait
            SittingDialogue(sitting, desk, presenter, desk.clock).run()
            assert len(sitting.judgements) == 4
            SittingDialogue(sitting, desk, presenter, desk.clock, answer).run()
            assert sitting.next is None
        said = (
            "\n".join(desk.told) + (participant_folder(design, one.participant) / "sittings.csv").read_text()
        )
        names = "\n".join(path.relative_to(tmp_path).as_posix() for path in design.folder.rglob("sub-*/**/*"))
        leak = re.compile(r"\bS[SH]\d|percent|softener|\b(0|10|20|35|45) ?%")
        assert not leak.search(said)
        assert not leak.search(names)
        assert leak.search((participant_folder(design, one.participant) / KEY).read_text()), "it can be seen"
        assert all(re.fullmatch("[A-Z]{1,2}", code) for _, _, code in presenter.shown)


def test_a_device_that_refuses_pauses_the_sitting_and_nothing_is_lost(tmp_path) -> None:
    design = make_experiment(tmp_path / "study", "threshold", 3)
    enrol(design, "P01", Enrolment(True))
    presenter = Presenter()
    presenter.refuses = 1
    desk = Desk(["", "s2", "1", "s2", "2", "q"])  # mended, both felt, answered; both felt, answered
    outcome = sit(design, desk, presenter)
    assert (outcome.kept, outcome.fault) == (2, None)
    assert "0 judgements" in "\n".join(desk.told)
    first, second = read_judgements(table(design))
    names = [name for _, name, _ in presenter.shown]
    assert names[:4] == [*first.presented, *second.presented]
    presenter.refuses = 1
    outcome = sit(design, Desk([]), presenter)  # nobody mends it
    assert isinstance(outcome.fault, DeviceError)
    assert outcome.kept == 2


def test_no_rendered_answer_is_taken_before_each_stimulus_was_shown(tmp_path) -> None:
    design = make_experiment(tmp_path / "study", "threshold", 3)
    enrol(design, "P01", Enrolment(True))
    with opened(design) as sitting:
        trial = sitting.next
        second = sitting.codes[trial.presentation, trial.condition, trial.presented[1]]
    desk, presenter = Desk(["1", "2", "s2", "1", "q"]), Presenter()
    assert sit(design, desk, presenter).kept == 1
    said = "\n".join(desk.told)
    assert said.count(f"{second} not shown yet: type s2") == 2
    assert "s2 shows" in said
    assert said.index("still to be felt") < said.index("shows one again"), "that is for what was shown"
    assert [name for _, name, _ in presenter.shown[:2]] == list(trial.presented)
    [kept] = read_judgements(table(design))
    assert kept.answer == trial.presented[:1]


def test_what_was_felt_before_a_fault_has_to_be_felt_again(tmp_path) -> None:
    design = make_experiment(tmp_path / "study", "threshold", 3)
    enrol(design, "P01", Enrolment(True))
    presenter = Presenter()

    def breaks() -> str:
        presenter.refuses = 1
        return "s2"

    desk = Desk([breaks, "", "1", "s1", "1", "q"])  # the second after the fault; the first is lacking then
    assert sit(design, desk, presenter).kept == 1
    assert "type s1" in "\n".join(desk.told)


def test_an_answer_to_what_had_ended_by_itself_is_not_taken(tmp_path) -> None:
    design = make_experiment(tmp_path / "study", "threshold", 3)
    enrol(design, "P01", Enrolment(True))
    presenter = Presenter()
    presenter.has_ended = 1
    desk = Desk(["s2", "1", "", "s2", "2", "q"])
    outcome = sit(design, desk, presenter)
    [kept] = read_judgements(table(design))
    assert outcome.kept == 1
    assert kept.answer == kept.presented[1:]
    assert "the answer" in "\n".join(desk.told)


def test_a_rendered_sitting_without_a_display_and_a_closed_input_pause(tmp_path) -> None:
    design = make_experiment(tmp_path / "study", "threshold", 3)
    enrol(design, "P01", Enrolment(True))
    outcome = sit(design, Desk(["1"]), None)
    assert outcome.kept == 0
    assert "--bench" in str(outcome.fault)
    plain = jelly(tmp_path)
    outcome = sit(plain, Desk(["1", "1"]))
    assert outcome.kept == 2
    assert "is closed" in str(outcome.fault)


def test_a_full_disk_keeps_the_sitting_and_the_answer_until_there_is_room(tmp_path, monkeypatch) -> None:
    design = jelly(tmp_path)
    full = [3]
    write = os.write

    def short(handle: int, data: bytes) -> int:
        if full[0] and data.startswith(b"P01,"):
            full[0] -= 1
            write(handle, data[:7])
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(handle, data)

    monkeypatch.setattr(os, "write", short)
    desk = Desk(["2", "", "", "", "q"])  # three times full, then room
    outcome = sit(design, desk)
    assert outcome.kept == 1
    assert "room left" in "\n".join(desk.told)
    [kept] = read_judgements(table(design))
    assert kept.answer == kept.presented[1:]
    full[0] = 1
    outcome = sit(design, Desk(["1"]))
    assert isinstance(outcome.fault, StorageError)
    assert table(design).read_text().count("\n") == 2


def test_a_sync_that_fails_takes_the_row_back(tmp_path) -> None:
    design = jelly(tmp_path)
    folder = participant_folder(design, "P01")
    before = table(design).read_bytes()
    calls = []

    def failing(handle: int) -> None:
        calls.append(handle)
        raise OSError(errno.EIO, "Input/output error")

    with opened(design) as sitting:
        trial = sitting.next
        sitting.take(trial.presented[:1], 1.0)
    [one] = read_judgements(table(design))
    table(design).write_bytes(before)
    with ResponseLog(folder, False, failing) as log:
        with pytest.raises(StorageError):
            log.append(one)
        assert calls
        assert table(design).read_bytes() == before
        assert log.judgements == []


def test_two_sittings_of_one_participant_are_refused_and_so_is_a_change_meanwhile(tmp_path) -> None:
    design = jelly(tmp_path)
    enrol(design, "P02", Enrolment(True))
    with opened(design) as sitting, opened(design, "P02"):
        with refused("session-in-use", RecordingError, match="sub-P01"):
            opened(design)
        with table(design).open("a") as file:
            file.write("x\n")
        with pytest.raises(LabelError, match="changed while"):
            sitting.take(sitting.next.presented[:1], 1.0)


def test_participants_are_numbered_as_they_come_and_a_refusal_takes_no_number(tmp_path) -> None:
    design = make_experiment(tmp_path / "jelly", "jelly", 1)
    assert enrol(design, "P01", Enrolment(True)).number == 1
    assert enrol(design, "P02", Enrolment(False)).number == 0
    assert enrol(design, "P03", Enrolment(True)).number == 2
    assert not (participant_folder(design, "P02") / "responses.csv").exists()
    with refused("no-consent", InputError):
        opened(design, "P02")
    with pytest.raises(ExistsError, match="enrolled before"):
        enrol(design, "P01", Enrolment(True))
    assert [one.consent for one in records(design)] == ["yes", "no", "yes"]


def test_a_rehearsal_is_counted_and_kept_apart_from_what_was_measured(tmp_path) -> None:
    design = jelly(tmp_path)
    record = enrol(design, "P01", Enrolment(True, simulated=True))
    assert (record.number, record.consent) == (1, "simulated")
    with Sitting(design, "P01", lambda: NOW, simulated=True) as sitting:
        sitting.take(sitting.next.presented[:1], 1.0)
    rehearsal = design.folder / "rehearsal"
    assert (rehearsal / "sub-P01" / "responses.csv").read_text().splitlines()[1].endswith(",yes")
    assert len(read_judgements(rehearsal)) == 1
    assert read_judgements(design.folder) == ()
    assert read_kept_answers(rehearsal).stimuli == design.stimuli
    assert not (rehearsal / "stimuli.csv").exists(), "the design's table is the only one"
    assert [one.simulated for one in records(design)] == [False]


@pytest.mark.parametrize("preset", ["jelly", "threshold"])
def test_a_rehearsal_tells_neither_letters_nor_orders_of_the_participant_of_its_number(
    preset: str, tmp_path
) -> None:
    design = make_experiment(tmp_path / "study", preset, 5)
    person = enrol(design, "P01", Enrolment(True))
    rehearsed = enrol(design, "R01", Enrolment(True, simulated=True))
    assert person.number == rehearsed.number
    assert person.group == rehearsed.group, "who meets what is no secret"
    homes = [participant_folder(design, "P01"), participant_folder(design, "R01", simulated=True)]
    for name in (KEY, SCHEDULE):
        one, other = ((home / name).read_text() for home in homes)
        assert one != other
    mine, theirs = (letter_codes(design, 1, simulated) for simulated in (False, True))
    assert sum(mine[place] == theirs[place] for place in mine) < len(mine) / 2
    with Sitting(design, "R01", lambda: NOW, simulated=True) as sitting:
        assert sitting.codes == theirs


@pytest.mark.parametrize(
    "code", ["../P01", "/etc/P01", "..", "a/b", "a\\b", "", "P 01", "P01\n", "é", "-P", "x" * 33]
)
def test_a_code_that_is_a_path_or_no_code_makes_nothing(code: str, tmp_path: Path) -> None:
    design = make_experiment(tmp_path / "jelly", "jelly", 1)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match="letters, digits"):
        enrol(design, code, Enrolment(True))
    assert sorted(tmp_path.rglob("*")) == before


def test_codes_that_differ_by_capitals_alone_are_refused(tmp_path) -> None:
    design = jelly(tmp_path)
    with refused("participant-exists", InputError, match="'sub-P01'"):
        enrol(design, "p01", Enrolment(True))
    assert enrol(design, "CON1", Enrolment(True)).number == 2, "sub-CON1 is no device of Windows"


def test_the_laterality_quotient_is_the_inventory_s() -> None:
    assert laterality_quotient(["RR"] * 10) == 100
    assert laterality_quotient(["LL"] * 10) == -100
    assert laterality_quotient(["B"] * 10) == 0
    # 8 RR, 1 L, 1 without experience: R = 16, L = 1
    assert laterality_quotient(["RR"] * 8 + ["L", ""]) == pytest.approx(100 * 15 / 17)
    assert laterality_quotient(["R"] * 7 + ["B"] * 3) == pytest.approx(100 * 7 / 13)
    assert laterality_quotient([""] * 10) != laterality_quotient([""] * 10)  # NaN: nothing is known
    for wrong in (["RR"] * 9, ["X"] * 10):
        with pytest.raises(InputError, match="ten of"):
            laterality_quotient(wrong)


def test_an_age_is_kept_only_as_it_was_asked_for() -> None:
    for text, asked in (("", "years"), ("27", "years"), ("20-29", "band"), ("60+", "band")):
        assert checked_age(text, asked) == text
    for wrong in (("27", "band"), ("20-29", "years"), ("Anna", "band"), ("1999-01-02", "band")):
        with pytest.raises(InputError, match="age"):
            checked_age(*wrong)
    for wrong in (("121", "years"), ("30-20", "band")):
        with refused("age", RangeError, match="120"):
            checked_age(*wrong)


def test_enrolment_asks_consent_first_and_keeps_no_more_than_the_design_asks_for(tmp_path) -> None:
    design = make_experiment(tmp_path / "study", "bianchi-2010", 1)
    desk = Desk(["no"])
    assert ask_enrolment(design, desk) == Enrolment(False)
    assert len(desk.told) == 2
    desk = Desk(["perhaps", "Yes", "rr", "XX", *["RR"] * 8, "", "young", "27"])
    told = ask_enrolment(design, desk)
    assert told == Enrolment(True, 100.0, "27")
    assert [line for line in desk.told if line in ACTIVITIES] == [*ACTIVITIES[:2], *ACTIVITIES[1:]]
    record = enrol(design, "P01", told)
    assert (record.laterality_quotient, record.age) == (100.0, "27")
    with pytest.raises(EOFError):
        ask_enrolment(design, Desk([]))
    assert ask_enrolment(jelly(tmp_path), Desk(["y"])).age == ""


def test_a_full_disk_at_enrolment_leaves_nothing_and_takes_no_number(tmp_path, monkeypatch) -> None:
    design = make_experiment(tmp_path / "jelly", "jelly", 1)
    before = sorted(tmp_path.rglob("*"))
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", _full)
        with refused("disk-full", StorageError):
            enrol(design, "P01", Enrolment(True))
    assert sorted(tmp_path.rglob("*")) == before
    assert enrol(design, "P01", Enrolment(True)).number == 1


def _full(handle: int) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")
