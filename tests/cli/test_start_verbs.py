"""`palpate collect` and `start --terminal`, as typed: what cannot go on ends, and says why."""

import pytest
from typer.testing import CliRunner

from palpate.cli import app
from palpate.cli.record.start_verbs import force_of
from palpate.core.errors import InputError
from palpate.recordings import Run
from palpate.workflows.start_session import StartSession
from palpate.workflows.stored_session import STATE


@pytest.mark.parametrize("words", [["collect", "--out"], ["start", "--terminal", "--folder"]])
@pytest.mark.parametrize("typed", ["", "100\nheavy\n"])
def test_weights_that_can_no_more_be_typed_end_it(words: list[str], typed: str, tmp_path) -> None:
    options = ["--camera", "virtual:tactip", "--scale", "typed"]
    done = CliRunner().invoke(app, [*words, str(tmp_path / "kept"), *options], input=typed)
    assert done.exit_code == 2, done.output
    assert "type its mass in g" in done.output
    assert ("'heavy' is no weight" in done.output) == ("heavy" in typed)
    assert "nothing more can be typed" in done.output


@pytest.mark.parametrize(
    "words", ["1,000", "1,000 g", "12,345g", "1_000", "1e3,5", "nan", "inf N", "5 stone"]
)
def test_what_may_mean_two_weights_is_not_guessed(words: str) -> None:
    with pytest.raises(InputError, match="no weight"):
        force_of(words)


@pytest.mark.parametrize(("words", "force_n"), [("0,5 kg", 4.903325), ("2.5N", 2.5), ("1000", 9.80665)])
def test_a_decimal_comma_is_read(words: str, force_n: float) -> None:
    assert force_of(words) == pytest.approx(force_n)


def test_a_unit_that_is_not_known_is_refused_with_those_that_are(tmp_path) -> None:
    words = ["collect", "--camera", "virtual:tactip", "--scale", "/dev/none", "--unit", "stone"]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "run")])
    assert (done.exit_code, "--unit stone: it is not known; give one of N, mN" in done.output) == (2, True)


@pytest.mark.slow
def test_typed_weights_are_laid_on_by_a_virtual_hand_and_label_what_lies_still(tmp_path) -> None:
    out = tmp_path / "run"
    words = ["collect", "--camera", "virtual:palm", "--scale", "typed", "--presses", "2", "--out", str(out)]
    done = CliRunner().invoke(app, words, input="9kg\n500\n3N\n")
    assert done.exit_code == 0, done.output
    assert "whose skin is known to" in done.output  # 9 kg are refused
    table = Run.open(out).labels
    touched = table[~table["reference"].astype(bool) & (table["press"] != "rest")]
    forces = touched.groupby("press")["force_N"].mean()
    assert sorted(forces) == pytest.approx([3.0, 0.5 * 9.80665])
    again = CliRunner().invoke(app, words)
    told = " ".join(again.output.split())
    assert f"{out} holds 2 presses, and --presses 2 is how many there shall be in all: none" in told
    # A virtual hand lays a weight on by depth, and so is off by what places and seating do to the force.
    assert touched["true_force_N"].to_numpy() == pytest.approx(touched["force_N"].to_numpy(), rel=0.1)


@pytest.mark.parametrize(
    ("more", "left"), [((), "7 presses of 12; 5 are"), (("--more", "3"), "7 presses of 10; 3 are")]
)
def test_another_scale_is_told_how_many_presses_are_missing(more, left, tmp_path, monkeypatch) -> None:
    StartSession(tmp_path).choose("virtual:palm", "typed", asked=12)
    monkeypatch.setattr(StartSession, "presses_held", property(lambda session: 7))

    def none(session: StartSession, **_: object) -> None:
        raise InputError("not opened here")

    monkeypatch.setattr(StartSession, "feed", none)
    words = ["start", "--terminal", "--folder", str(tmp_path), "--scale", "virtual", *more]
    told = " ".join(CliRunner().invoke(app, words).output.split())
    assert f"{left} still to be collected" in told, told
    assert "which stays" not in told


@pytest.mark.parametrize("more", [(), ("--more", "5")])
@pytest.mark.parametrize("scale", ["/dev/no-such-port", "virtul", ""])
def test_a_scale_that_cannot_be_opened_leaves_a_session_as_it_was(scale: str, more, tmp_path) -> None:
    session = StartSession(tmp_path / "session")
    session.choose("virtual:tactip", "virtual", asked=10)
    session._done("train")
    kept = (session.folder / STATE).read_bytes()
    words = ["start", "--terminal", "--folder", str(session.folder), "--camera", "virtual:tactip"]
    done = CliRunner().invoke(app, [*words, *more, "--scale", scale, "--quiet"])
    assert done.exit_code == 2, done.output
    assert (session.folder / STATE).read_bytes() == kept
    again = StartSession(session.folder)
    again.choose("virtual:tactip", "typed", asked=10)  # one that can be is kept once it was opened
    with again.feed():
        assert StartSession(session.folder).state == again.state
    assert again.state.done == ["camera"]


@pytest.mark.parametrize(
    "words",
    [("--camera", "virtual:nothing"), ("--camera", "9", "--scale", "typed"), ("--scale", "/dev/none")],
)
def test_a_new_session_that_is_refused_leaves_no_folder(words, tmp_path) -> None:
    folder = tmp_path / "new" / "session"
    done = CliRunner().invoke(app, ["start", "--terminal", "--folder", str(folder), *words])
    assert done.exit_code == 2, done.output
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def complete(tmp_path, monkeypatch) -> StartSession:
    """A session that holds its twelve presses and a calibration, and may open no camera."""
    session = StartSession(tmp_path / "session")
    session.choose("virtual:palm", "virtual", asked=12)
    session.state.settings = {"size_px": [8, 8], "rate_hz": 1.0}
    session._done("train")

    def opened(session: StartSession, **_: object) -> None:
        raise InputError(f"opened for {session.state.asked}")

    monkeypatch.setattr(StartSession, "presses_held", property(lambda session: 12))
    monkeypatch.setattr(StartSession, "feed", opened)
    monkeypatch.setattr(StartSession, "commands", lambda session: [])
    return session


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--scale", "typed"], "holds 12 presses of 12: nothing is left to collect"),
        (["--scale", "typed", "--presses", "11"], "holds 12 presses of 12: nothing is left to collect"),
        (["--presses", "11"], "holds 12 presses, and all are learnt from: 11 asks for none beside them"),
    ],
)
def test_where_nothing_is_left_to_collect_it_is_said_and_nothing_is_done_again(words, told, complete) -> None:
    kept = (complete.folder / STATE).read_bytes()
    done = CliRunner().invoke(app, ["start", "--terminal", "--folder", str(complete.folder), *words])
    assert (done.exit_code, told in " ".join(done.output.split())) == (0, True), done.output
    assert "The same by commands" in done.output
    assert (complete.folder / STATE).read_bytes() == kept


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--presses", "15"], "opened for 15"),
        (["--scale", "typed", "--presses", "15"], "opened for 15"),
        (["--scale", "typed", "--more", "3"], "opened for 15"),
        (["--presses", "15", "--more", "3"], "give one of them"),
    ],
)
def test_how_many_presses_are_asked_for_is_heeded_or_refused(words, told, complete) -> None:
    done = CliRunner().invoke(app, ["start", "--terminal", "--folder", str(complete.folder), *words])
    assert (done.exit_code, told in " ".join(done.output.split())) == (2, True), done.output


def test_what_is_chosen_for_the_page_stands_in_its_address_and_what_it_has_no_field_for_is_refused(
    tmp_path, monkeypatch
) -> None:
    served: list[dict] = []
    monkeypatch.setattr(
        "palpate.cli.study.study_verbs.serve_studio", lambda **words: served.append(words["page"])
    )
    words = [
        "start",
        "--folder",
        str(tmp_path / "s"),
        "--camera",
        "0",
        "--scale",
        "/dev/x",
        "--presses",
        "20",
    ]
    assert CliRunner().invoke(app, words).exit_code == 0
    assert CliRunner().invoke(app, words[:3]).exit_code == 0
    assert served == [{"folder": "s", "camera": "0", "scale": "/dev/x", "presses": 20}, {"folder": "s"}]
    done = CliRunner().invoke(app, [*words, "--more", "3", "--seed", "2"])
    assert (done.exit_code, len(served)) == (2, 2)
    assert "no field for --more, --seed: give --terminal" in done.output


def test_a_session_keeps_its_own_camera_and_scale_where_none_is_given(tmp_path, monkeypatch) -> None:
    StartSession(tmp_path).choose("virtual:tactip", "typed", asked=12)

    def none(session: StartSession, **_: object) -> None:
        raise InputError(f"opens {session.state.camera} and {session.state.scale}")

    monkeypatch.setattr(StartSession, "feed", none)

    def told(*words: str) -> str:
        return CliRunner().invoke(app, ["start", "--terminal", "--folder", str(tmp_path), *words]).output

    assert "opens virtual:tactip and typed" in told()
    assert "opens virtual:tactip and virtual" in told("--scale", "virtual")
    assert "opens virtual:tactip and virtual" in told(), "the last that was given"
    assert "opens virtual:palm and virtual" in told("--camera", "virtual:palm"), (
        "another camera, another scale"
    )


def test_a_page_that_is_asked_for_json_is_refused(tmp_path) -> None:
    done = CliRunner().invoke(app, ["start", "--folder", str(tmp_path / "s"), "--json"])
    assert done.exit_code == 2
    assert "no field for --json: give --terminal, too" in done.output
