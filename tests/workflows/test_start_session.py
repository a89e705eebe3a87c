"""Laws of the first session: whole on a virtual sensor, gone on with where it was left, honest at its end."""

import json
import shlex
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from tests.fakes.printing_scale import PrintingScale
from tests.refusals import refused
from tests.rig.serial_terminal import FakeTerminal
from tests.small_figures import saved_blank

import palpate
from palpate.calibration.coverage.conformal import fit_intervals
from palpate.core import DeviceError, Frame, InputError, RecordingError
from palpate.estimators.certified import Estimator
from palpate.estimators.session_folder import SESSION_FILE, calibration_in
from palpate.recordings import Run, RunWriter
from palpate.sensing.collection import learning_curve
from palpate.sensing.collection.learning_curve import curve_of
from palpate.sensing.collection.press_collector import REST, presses_in
from palpate.workflows import stored_session
from palpate.workflows.certification import beats_the_mean, rate_beyond
from palpate.workflows.press_feeds import VirtualFeed
from palpate.workflows.start_session import StartSession
from palpate.workflows.stored_session import STATE


@pytest.fixture(scope="module", autouse=True)
def quickly_learnt(changes_untried):
    """A model that is fitted in no time, and pages without pictures: neither is what a session decides."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(stored_session, "MODEL", "pca-ridge")
        patched.setattr(Figure, "savefig", saved_blank)
        yield


def begun(folder: Path, presses: int = 10) -> StartSession:
    session = StartSession(folder)
    session.choose("virtual:tactip", "virtual", asked=presses)
    return session


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, quickly_learnt: None) -> StartSession:
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


def test_only_estimates_that_surely_beat_the_mean_are_worth_something() -> None:
    rng, press = np.random.default_rng(0), np.repeat(np.arange(40), 8)
    force = rng.uniform(1, 10, 40)[press]
    good = pd.DataFrame({"press": press, "force_N": force, "estimate:force_N": force + 0.5})
    assert beats_the_mean(good)
    shuffled = good.assign(**{"estimate:force_N": rng.permutation(40)[press] / 4.0})
    assert not beats_the_mean(shuffled)


@pytest.mark.parametrize(("seeds", "least"), [(2, 1), pytest.param(12, 10, marks=pytest.mark.slow)])
def test_intervals_of_the_sentence_are_tried_on_presses_they_were_not_made_of(seeds: int, least: int) -> None:
    told, truth, holds = [], [], 0
    for seed in range(seeds):
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
    assert np.mean(told) == pytest.approx(np.mean(truth), abs=0.07 / seeds**0.5)
    assert holds >= least


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


def test_device_that_goes_leaves_what_was_collected(tmp_path: Path) -> None:
    session = begun(tmp_path / "session")
    feed = session.feed()
    session.check_settings(feed)
    session.take_untouched(feed)
    grab = feed.grab

    def gone() -> Frame:
        if feed.clock.now_ns() > 11e9:
            raise DeviceError("the camera does not answer")
        return grab()

    feed.grab = gone  # type: ignore[method-assign]
    with pytest.raises(DeviceError):
        session.collect(feed)
    kept = Run.open(session.run).labels.press.nunique()
    assert kept >= 1
    assert StartSession(session.folder).step == "collect"


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


@pytest.mark.parametrize("seeds", [20, pytest.param(80, marks=pytest.mark.slow)])
def test_intervals_of_a_learning_curve_hold_what_more_presses_bring_at_their_rate(
    seeds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learning_curve, "DRAWS", 100)
    presses, held = np.repeat([10, 20, 32], 2), []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        refits, scored = 0.2 * rng.standard_normal((6, 1)), 0.3 * rng.standard_normal((6, 40))
        errors = 4 * presses[:, None] ** -0.5 * np.exp(refits + scored)
        errors[rng.permuted(np.tile(np.arange(40), (6, 1)), axis=1) < presses[:, None]] = np.nan
        low, high = curve_of(presses, errors, 40, seed=seed).ratio[1:]
        held.append(low < (40 / 50) ** 0.5 < high)
    assert np.mean(held) >= 0.9 - 2 * (0.09 / seeds) ** 0.5  # two standard errors


@pytest.mark.parametrize(
    "kept",
    [
        {"cameras": []},
        {"done": ["camera", "dance"]},
        {"asked": True},
        {"seed": -1},
        {"scale_lag_s": "slow"},
        {"settings": {"size_px": [256, 128]}},
        {"settings": {"size_px": [256, 128], "rate_hz": 30.0, "health": []}},
        {"collected": {"presses": -1}},
        {"trained": {"folder": "../elsewhere"}},
        {"trained": {"folder": "/etc"}},
        {"trained": {"curve": "steep"}},
    ],
)
def test_a_sessions_file_with_a_value_that_no_session_keeps_is_refused(kept: dict, tmp_path: Path) -> None:
    (tmp_path / STATE).write_text(json.dumps({"camera": "virtual:palm", "scale": "virtual"} | kept))
    with refused("session-damaged", RecordingError):
        StartSession(tmp_path)


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


def test_more_presses_join_the_old_ones_and_frames_that_a_kill_left_bare_are_left_out(
    whole: StartSession, tmp_path: Path
) -> None:
    shutil.copytree(whole.folder, tmp_path / "s")
    session = StartSession(tmp_path / "s")
    before, first = presses_in(Run.open(session.run)), session.calibration
    session.ask_more(3)
    assert (session.step, session.state.asked) == ("collect", 13)
    with session.feed() as feed:
        session.collect(feed)
    run = Run.open(session.run)
    after = presses_in(run)
    assert after[:10] == before
    assert len(after) == 13
    assert not set(after[10:]) & set(before)  # the hand does not press the same again
    with RunWriter.resume(session.run) as writer:
        for _ in range(2):
            writer.frame(np.asarray(run.frame(0).image))
    assert (len(Run.open(session.run)), len(Run.open(session.run).labelled())) == (len(run) + 2, len(run))
    session.train(curve=False)
    assert session.state.trained["presses"] == 13
    assert "2 frames" in session.state.trained["left_out"]
    assert session.calibration != first
    assert calibration_in(session.folder) == session.calibration, "a session's folder means its newest"
    assert calibration_in(first) == first
    assert shlex.split(session.commands()[-1])[2] == str(session.calibration)
    with palpate.live(session.folder, camera="virtual:tactip", max_frames=1) as live:
        assert next(iter(live)).to_dict()["calibration"] == session.state.trained["id"]
    with refused("press-count", InputError):
        session.ask_more(0)


def test_a_file_in_place_of_the_folder_is_named_with_what_to_give(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("x")
    with refused("not-a-folder", InputError):
        StartSession(tmp_path / "mine.txt")


@pytest.mark.parametrize(
    "kept",
    [
        "",
        "[]",
        "{",
        '{"trained": {}}',
        '{"trained": {"folder": "../out"}}',
        '{"trained": {"folder": "gone"}}',
    ],
)
def test_a_folder_that_names_no_calibration_within_it_means_itself(kept: str, tmp_path: Path) -> None:
    (tmp_path / "s").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "s" / SESSION_FILE).write_text(kept)
    assert calibration_in(tmp_path / "s") == tmp_path / "s"
    assert calibration_in(tmp_path / "none") == tmp_path / "none"
