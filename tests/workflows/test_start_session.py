"""Laws of the first session: whole on a virtual sensor, gone on with where it was left, honest at its end."""

from __future__ import annotations

import json
import shlex
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.fakes.printing_scale import PrintingScale
from tests.refusals import refused
from tests.rig.serial_terminal import FakeTerminal

from palpate.calibration.certificate import read_predictions
from palpate.calibration.coverage.conformal import fit_intervals
from palpate.core import DeviceError, InputError, RecordingError
from palpate.estimators.certified import Estimator, read_card
from palpate.recordings import Run
from palpate.sensing.collection import learning_curve
from palpate.sensing.collection.learning_curve import curve_of
from palpate.sensing.collection.press_collector import REST
from palpate.workflows.certificate_sentence import beats_the_mean, honest_sentence, rate_beyond
from palpate.workflows.press_feeds import CameraFeed, FedFrame, VirtualFeed, open_feed
from palpate.workflows.start_session import StartSession
from palpate.workflows.start_state import STATE


def begun(folder: Path, presses: int = 10) -> StartSession:
    session = StartSession(folder)
    session.choose("virtual:tactip", "virtual", asked=presses)
    return session


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StartSession:
    session = begun(tmp_path_factory.mktemp("start") / "session")
    feed = session.feed()
    session.check_settings(feed)
    session.take_untouched(feed)
    session.collect(feed)
    feed.close()
    session.train(curve=False)
    return session


def test_session_ends_in_a_calibration_that_reads_newtons(whole: StartSession) -> None:
    assert whole.step == "live"
    run, estimator = Run.open(whole.run), Estimator.open(whole.calibration)
    touched = run.labels[~run.labels.reference.astype(bool)]
    off = [
        estimator.read(run.frame(i))["force_N"].value - touched.true_force_N[i]
        for i in touched.index[::7].tolist()
    ]
    assert np.abs(off).mean() < 0.3 * touched.true_force_N.mean()


def test_session_goes_on_where_it_was_left(whole: StartSession, tmp_path: Path) -> None:
    again = StartSession(whole.folder)
    assert again.state == whole.state
    assert again.step == "live"
    left = begun(tmp_path / "left")
    assert left.step == "settings"
    with pytest.raises(InputError, match="'untouched'"):
        left.train()


def test_commands_say_what_was_done(whole: StartSession) -> None:
    verbs = [shlex.split(one)[1] for one in whole.commands()]
    assert verbs == ["collect", "calibrate", "live"]
    assert "--split group:press" in whole.commands()[1]  # ten presses, and the untouched sensor


def test_untouched_sensor_is_read_as_no_force(whole: StartSession) -> None:
    labels, estimator = Run.open(whole.run).labels, Estimator.open(whole.calibration)
    at_rest = Run.open(whole.run).frame(int(np.flatnonzero(labels.reference.astype(bool))[-1]))
    reading = estimator.read(at_rest)["force_N"]
    assert abs(reading.value) < 0.3
    assert reading.low <= 0 <= reading.high


def test_sentence_says_by_whom_and_what_is_not_tested(whole: StartSession) -> None:
    for words in ("10 presses", "one hand, on one day", "not tested"):
        assert words in whole.sentence


def test_only_estimates_that_surely_beat_the_mean_are_worth_something() -> None:
    rng, press = np.random.default_rng(0), np.repeat(np.arange(40), 8)
    force = rng.uniform(1, 10, 40)[press]
    good = pd.DataFrame({"press": press, "force_N": force, "estimate:force_N": force + 0.5})
    assert beats_the_mean(good)
    shuffled = good.assign(**{"estimate:force_N": rng.permutation(40)[press] / 4.0})
    assert not beats_the_mean(shuffled)


def test_intervals_of_the_sentence_are_tried_on_presses_they_were_not_made_of() -> None:
    told, truth, holds = [], [], 0
    for seed in range(12):
        rng = np.random.default_rng(seed)

        def pressed(count: int, rng: np.random.Generator = rng) -> pd.DataFrame:
            press = np.repeat(np.arange(count), 4)
            force = rng.uniform(0.5, 11, count)[press]
            off = 0.5 * rng.standard_t(4, count)[press] + rng.normal(0, 0.05, len(press))
            return pd.DataFrame({"press": press, "force_N": force, "estimate:force_N": force + off})

        learnt, new = pressed(40), pressed(1000)
        told_of, true_of = (
            [one[[name]].to_numpy() for one in (learnt, new)] for name in ("estimate:force_N", "force_N")
        )
        intervals = fit_intervals(told_of[0], true_of[0], learnt.press.to_numpy(), 0.9)
        truth.append(float(intervals.hold(told_of[1], true_of[1]).mean()))
        rate, low, high = rate_beyond(learnt)
        told.append(rate)
        holds += low <= truth[-1] <= high
    assert np.mean(told) == pytest.approx(np.mean(truth), abs=0.02)
    assert holds >= 10


def test_sentence_of_two_sittings_does_not_say_one_day(whole: StartSession) -> None:
    card = read_card(whole.calibration)
    predictions = read_predictions(whole.calibration, card)
    assert "one day" in honest_sentence(card, predictions, 10)
    half = np.where(predictions.press.isin(list("12345")), "monday", "tuesday")
    told = honest_sentence(card, predictions.assign(session=half), 10)
    assert "2 sittings" in told
    assert "one day" not in told


@pytest.mark.slow
def test_sentence_of_shuffled_labels_says_useless(whole: StartSession, tmp_path: Path) -> None:
    from palpate.recordings.manifest import Manifest
    from palpate.recordings.run_writer import RunWriter

    run = Run.open(whole.run)
    table = run.labels
    order = np.random.default_rng(3).permutation(table.press.nunique())
    level = table[~table.reference.astype(bool)].groupby("press").force_N.mean()
    other = dict(zip(level.index, level.to_numpy()[order], strict=True))
    session = begun(tmp_path / "shuffled")
    session._done("untouched")
    kinds = {name: run.manifest.labels[name] for name in ("press", "session", "reference", "force_N")}
    manifest = Manifest.new(sensor="tactip", labels=kinds, targets=("force_N",))
    with RunWriter.create(session.run, manifest, overflow="wait") as writer:
        for i in range(len(run)):
            row = table.iloc[i]
            labels = {"press": str(row.press), "session": str(row.session), "reference": bool(row.reference)}
            force = 0.0 if row.reference else float(other[row.press])
            writer.frame(run.frame(i).image, labels=labels | {"force_N": force})
    session.train(curve=False)
    assert session.sentence.startswith("Useless")


def test_calibration_is_never_overwritten(whole: StartSession) -> None:
    assert whole._next_calibration() != whole.calibration


def test_device_that_goes_leaves_what_was_collected(tmp_path: Path) -> None:
    session = begun(tmp_path / "session")
    feed = session.feed()
    session.check_settings(feed)
    session.take_untouched(feed)
    grab = feed.grab

    def gone() -> FedFrame:
        if feed.clock.now_ns() > 16e9:
            raise DeviceError("the camera does not answer")
        return grab()

    feed.grab = gone  # type: ignore[method-assign]
    with pytest.raises(DeviceError):
        session.collect(feed)
    kept = Run.open(session.run).labels.press.nunique()
    assert kept >= 2
    assert StartSession(session.folder).step == "collect"


def test_real_camera_does_not_stand_on_a_virtual_scale() -> None:
    with pytest.raises(InputError, match="typed"):
        open_feed("0", "virtual")


@pytest.mark.slow
def test_kitchen_scale_on_a_serial_port_labels_a_virtual_sensor(tmp_path: Path) -> None:
    """In real time: a scale of 10 lines a second that is 0.4 s late."""
    hands: list[VirtualFeed] = []
    device = PrintingScale(lambda t: hands[0].hand.force_at(t) if hands else 0.0, now_s=time.monotonic())
    with FakeTerminal(device) as terminal:
        feed = VirtualFeed("tactip", scale=terminal.path)
        hands.append(feed)
        session = StartSession(tmp_path / "session")
        session.choose("virtual:tactip", terminal.path, asked=10)
        collector = session.collector(feed)
        feed.press(go_on=True)
        ends_ns = feed.clock.now_ns() + 20 * 10**9
        with collector:
            while feed.clock.now_ns() < ends_ns:
                assert feed.force is not None
                frame = feed.grab()
                collector.on_force(feed.force.drain())
                collector.on_frame(frame)
        feed.close()
    table = Run.open(session.run).labels
    untouched = table[table.press == REST]
    assert (untouched.force_N == 0).all()
    assert (untouched.true_force_N < 0.5).all()  # of a scale that is late on a busy machine
    touched = table[~table.reference.astype(bool) & (table.press != REST)]
    assert touched.press.nunique() >= 3
    assert np.abs(touched.force_N / touched.true_force_N - 1).max() < 0.06


def test_broken_file_of_a_session_is_named(tmp_path: Path) -> None:
    (tmp_path / STATE).write_text(json.dumps({"cameras": []}))
    with refused("session-damaged", RecordingError):
        StartSession(tmp_path)


def test_too_few_presses_are_refused(tmp_path: Path) -> None:
    with refused("too-few-presses", InputError, match="10"):
        StartSession(tmp_path).choose("virtual:palm", "virtual", asked=3)


def test_learning_curve_finds_the_power_and_what_ten_more_bring() -> None:
    rng = np.random.default_rng(0)
    presses = np.repeat([10, 20, 32], 2)
    errors = (4 / presses)[:, None] * np.exp(0.1 * rng.standard_normal((6, 40)))
    curve = curve_of(presses, errors, 40)
    assert curve.b == pytest.approx(1.0, abs=0.1)
    assert curve.with_more[0] == pytest.approx(4 / 50, rel=0.1)
    assert curve.with_more[1] < curve.with_more[0] < curve.with_more[2]
    assert curve.ratio[0] == pytest.approx(40 / 50, rel=0.03)
    assert curve.ratio[1] < 40 / 50 < curve.ratio[2]
    assert curve.text.startswith("10 more presses would change the error by -")


def test_intervals_of_a_learning_curve_hold_what_more_presses_bring_at_their_rate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Refits scatter by what they learnt from, which drawing the scored presses anew does not tell."""
    monkeypatch.setattr(learning_curve, "DRAWS", 100)
    presses, held = np.repeat([10, 20, 32], 2), []
    for seed in range(80):
        rng = np.random.default_rng(seed)
        refits, scored = 0.2 * rng.standard_normal((6, 1)), 0.3 * rng.standard_normal((6, 40))
        errors = 4 * presses[:, None] ** -0.5 * np.exp(refits + scored)
        errors[rng.permuted(np.tile(np.arange(40), (6, 1)), axis=1) < presses[:, None]] = np.nan
        low, high = curve_of(presses, errors, 40, seed=seed).ratio[1:]
        held.append(low < (40 / 50) ** 0.5 < high)
    assert 0.84 <= np.mean(held) < 1.0  # of 90 %: from 80


def test_learning_curve_that_does_not_fall_says_so() -> None:
    presses = np.repeat([10, 20, 32], 2)
    errors = np.random.default_rng(0).uniform(0.9, 1.0, (6, 40)) * (1 + presses[:, None] / 100)
    assert "not lessened" in curve_of(presses, errors, 40).text
    assert "are labelled" in curve_of(presses, errors, 20).text
    few = curve_of(presses, errors, 19).text
    assert few.startswith("19 presses are few")
    assert "press more" in few
    assert "label" not in few


def test_useless_presses_that_are_few_are_to_be_more_before_their_labels_are_looked_at(
    whole: StartSession,
) -> None:
    card = read_card(whole.calibration)
    predictions = read_predictions(whole.calibration, card)
    wrong = predictions.assign(**{"estimate:force_N": 10.0 - predictions["force_N"]})
    told = honest_sentence(card, wrong, 19)
    assert told.startswith("Useless")
    assert told.index("19 presses are few: press more first") < told.index("look whether each label")
    enough = honest_sentence(card, wrong, 20)
    assert "few" not in enough
    assert "label belongs" in enough


def test_feeds_keep_their_contract() -> None:
    from palpate.workflows.press_feeds import PressFeed

    assert isinstance(VirtualFeed("tactip"), PressFeed)
    assert all(hasattr(CameraFeed, name) for name in ("grab", "press", "close", "truth", "truths"))


@pytest.mark.parametrize(
    "kept",
    [
        {"done": None},
        {"done": 3},
        {"done": ["camera", "dance"]},
        {"asked": "40"},
        {"asked": True},
        {"seed": -1},
        {"scale_lag_s": -0.1},
        {"scale_lag_s": "slow"},
        {"scale_lag_s": True},
        {"settings": 7},
        {"settings": {"size_px": [256, 128]}},
        {"settings": {"size_px": "256x128", "rate_hz": 30.0}},
        {"settings": {"size_px": [256, 128], "rate_hz": None}},
        {"settings": {"size_px": [256, 128], "rate_hz": 30.0, "health": []}},
        {"collected": {"presses": "many"}},
        {"collected": {"presses": -1}},
        {"collected": {"presses": True}},
        {"collected": {"map": "everywhere"}},
        {"trained": []},
        {"trained": {"folder": 3}},
        {"trained": {"folder": "../elsewhere"}},
        {"trained": {"folder": "/etc"}},
        {"trained": {"sentence": None}},
        {"trained": {"curve": "steep"}},
    ],
)
def test_a_sessions_file_with_a_value_that_no_session_keeps_is_refused(kept: dict, tmp_path: Path) -> None:
    (tmp_path / STATE).write_text(json.dumps({"camera": "virtual:palm", "scale": "virtual"} | kept))
    with refused("session-damaged", RecordingError):
        StartSession(tmp_path)


def test_unit_and_lag_of_a_scale_stay_until_others_are_stated(tmp_path: Path) -> None:
    session = StartSession(tmp_path / "session")
    session.choose_if_other("0", "/dev/ttyUSB0", asked=12, unit="kg", scale_lag_s=0.3)
    session.choose_if_other("0", "/dev/ttyUSB0")
    kept = StartSession(tmp_path / "session").state
    assert (kept.unit, kept.scale_lag_s, kept.asked) == ("kg", 0.3, 12)
    session.choose_if_other("0", "/dev/ttyUSB0", unit="g")
    assert (session.state.unit, session.state.scale_lag_s, session.state.asked) == ("g", 0.3, 12)
    session.choose_if_other("0", "/dev/ttyUSB0", scale_lag_s=0.0)
    assert (session.state.unit, session.state.scale_lag_s) == ("g", 0.0)
    session.choose_if_other("0", "/dev/ttyUSB1", asked=20)  # another scale has its own
    assert (session.state.unit, session.state.scale_lag_s, session.state.asked) == ("", None, 20)


def test_presses_that_were_weighed_in_one_unit_are_not_gone_on_with_in_another(
    whole: StartSession, tmp_path: Path
) -> None:
    folder = tmp_path / "session"
    shutil.copytree(whole.folder, folder)
    session = StartSession(folder)
    session.state.unit = "g"
    with refused("unit-differs", InputError):
        session.choose_if_other(session.state.camera, session.state.scale, unit="kg")


def test_a_session_whose_presses_were_deleted_says_what_can_be_done(
    whole: StartSession, tmp_path: Path
) -> None:
    shutil.copytree(whole.folder, tmp_path / "session", ignore=shutil.ignore_patterns("presses"))
    session = StartSession(tmp_path / "session")
    for asks in (session.commands, session.train):
        with refused("run-missing", RecordingError, match="--more 10") as caught:
            asks()
        named = (session.run, session.folder, session.calibration)
        assert all(str(path) in str(caught.value) for path in named)
    session.ask_more(10)  # as that command does: ten are all, none is left to add them to
    assert (session.step, session.state.asked) == ("collect", 10)
    whole_again = StartSession(whole.folder)
    whole_again._write = lambda: None  # type: ignore[method-assign]
    whole_again.ask_more(10)
    assert whole_again.state.asked == 20  # with its presses there


def test_a_stated_lag_goes_to_the_scale_and_into_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, asked = StartSession(tmp_path / "session"), {}

    def opened(*_: object, **words: object) -> None:
        asked.update(words)
        raise DeviceError("none is there")

    session.choose_if_other("0", "/dev/ttyUSB0", scale_lag_s=0.35)
    session.run.mkdir()
    monkeypatch.setattr("palpate.workflows.start_session.open_feed", opened)
    with pytest.raises(DeviceError, match="none is"):
        session.feed()
    assert asked["lag_s"] == 0.35
    assert "--scale-lag-s 0.35" in session.commands()[0]


def test_one_process_at_a_time_goes_through_a_session(tmp_path: Path) -> None:
    first, second = StartSession(tmp_path / "session"), StartSession(tmp_path / "session")
    with first.held():
        first.choose("virtual:tactip", "virtual", asked=10)
        with pytest.raises(RecordingError, match="another writer"), second.held():
            pass
    with second.held():
        assert second.state == first.state  # not as it was when the second read it


def test_a_session_that_is_refused_leaves_no_folder_and_one_that_was_begun_stays(tmp_path: Path) -> None:
    refused = StartSession(tmp_path / "refused")
    with pytest.raises(DeviceError, match="none is"), refused.held():
        raise DeviceError("none is there")
    assert not refused.folder.exists()
    begun = StartSession(tmp_path / "begun")
    with begun.held():
        (begun.folder / "kept").touch()
    assert sorted(path.name for path in begun.folder.iterdir()) == [".start.lock", "kept"]
    for name in (".start.lock", "kept"):
        (begun.folder / name).unlink()
    with begun.held():  # it was there before, and nothing of it is anybody's to remove
        pass
    assert begun.folder.is_dir()


def refuse(session: StartSession, meanwhile: Callable[[], object] = lambda: None, keep: bool = True) -> None:
    """A refusal while it is held, after something else."""

    def refused() -> None:
        with session.held(keep_choice=keep):
            meanwhile()
            raise DeviceError("none is there")

    with pytest.raises(DeviceError, match="none is there"):
        refused()


def test_of_a_refused_session_s_folders_those_that_it_made_are_removed_and_no_other(tmp_path, monkeypatch):
    refuse(StartSession(tmp_path / "a" / "b" / "c"), (tmp_path / "a" / "other").touch)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "other"]

    gone = StartSession(tmp_path / "gone")
    refuse(gone, lambda: shutil.rmtree(gone.folder))  # told is the refusal, not that a folder is gone

    made, mkdir = StartSession(tmp_path / "made"), Path.mkdir

    def made_by_another(path: Path, **words: bool) -> None:
        if path == made.folder:
            mkdir(path)
        mkdir(path, **words)

    monkeypatch.setattr(Path, "mkdir", made_by_another)
    refuse(made)
    assert made.folder.is_dir()


@pytest.mark.parametrize("keep", [False, True])
def test_what_was_chosen_stays_after_a_refusal_where_it_shall(tmp_path: Path, keep: bool) -> None:
    session = StartSession(tmp_path / "session")
    refuse(session, lambda: session.choose("9", "typed", asked=12), keep)
    assert session.folder.exists() == keep
    with session.held(keep_choice=False):
        session.choose("9", "typed", asked=12)
    refuse(session, keep=False)
    assert (session.folder / STATE).is_file()  # it was there before


@pytest.mark.filterwarnings("error")
def test_a_draw_of_presses_that_were_all_learnt_from_is_left_out_without_a_word() -> None:
    errors = np.array([[np.nan, 0.8, 0.8], [0.4, np.nan, 0.4], [np.nan, np.nan, 0.2]])
    curve = curve_of(np.array([4, 8, 16]), errors, 16)
    assert curve.mae == pytest.approx((0.8, 0.4, 0.2))
    assert np.isfinite(curve.expected).all()


def test_everything_may_be_chosen_anew_until_the_camera_has_given_a_frame(
    whole: StartSession, tmp_path: Path
) -> None:
    session = StartSession(tmp_path / "session")
    session.choose_if_other("9", "/dev/ttyUSB0", asked=12, seed=3)
    assert StartSession(session.folder).unopened
    session.choose_if_other("9", "/dev/ttyUSB0", asked=15, seed=4)
    assert (session.state.asked, session.state.seed) == (15, 4)
    session.choose_if_other("virtual:tactip", "virtual", asked=11)
    with session.feed() as feed:
        session.check_settings(feed)
    assert not StartSession(session.folder).unopened
    assert not whole.unopened
    session.choose_if_other("virtual:tactip", "virtual", asked=15)
    assert session.state.asked == 11


def test_so_many_presses_in_all_are_asked_for_and_none_is_taken_away(whole: StartSession) -> None:
    session = StartSession(whole.folder)
    session._write = lambda: None  # type: ignore[method-assign]
    assert (session.ask_for(10), session.step) == ("", "live")
    session.state.asked = 12
    assert "10 presses" in session.ask_for(10)
    assert (session.step, session.state.asked) == ("live", 12)
    assert (session.ask_for(14), session.step, session.state.asked) == ("", "collect", 14)
    with refused("too-few-presses", InputError, match="10"):
        session.ask_for(9)
