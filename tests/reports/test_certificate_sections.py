"""The page answers first, in sentences that the numbers bear out, and shows what there is to show."""

from __future__ import annotations

import html
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread
from tests.reports.test_certificate_page import held_out
from typer.testing import CliRunner

from palpate.calibration import CalibrationPlan, calibrate, evaluate
from palpate.calibration.certificate import most_missed
from palpate.calibration.confounds.deciding_pixels import block_edges
from palpate.calibration.evaluation import valid_score
from palpate.calibration.sessions import keep_evaluation, read_evaluations
from palpate.cli import app
from palpate.cli.calibrate.calibrate_verbs import _card_text
from palpate.estimators import Estimator, read_card
from palpate.estimators.findings import Finding, FindingCode
from palpate.estimators.model_card import Card, InstrumentCard, RangeCard, TenthCard, sealed
from palpate.recordings.joined_runs import joined
from palpate.reports import calibration_figures, write_report
from palpate.reports.audit_head import remaining_remedy
from palpate.reports.calibration_figures import deciding_blocks, held_rows, target_panels
from palpate.reports.comparison_page import compare_calibrations, comparison_text
from palpate.reports.evaluation_text import frames_of, frames_text, valid_readings_text
from palpate.reports.sections import (
    MIN_GROUPS,
    NOT_TESTED,
    SECTIONS,
    ReportedCalibration,
    answer,
    evidence_sections,
    outer_ranges,
    reading_half_width,
)
from palpate.reports.terminal_text import confounds_text

pytestmark = pytest.mark.usefixtures("figures_drawn_once")

TEMPLATES = Path(calibration_figures.__file__).parent / "templates"


@pytest.fixture(scope="module")
def made(record_spots_module, tmp_path_factory):
    plan = CalibrationPlan(("x_mm", "height_mm"), "pca-ridge", split="group:press", size_px=(24, 32))
    run = record_spots_module("run", 16)
    return calibrate(run, plan, tmp_path_factory.mktemp("made") / "cal"), run


@pytest.fixture
def calibration(made, tmp_path):
    return Path(shutil.copytree(made[0], tmp_path / "cal"))


@pytest.fixture(scope="module")
def by_sessions(record_spots_module, tmp_path_factory):
    """Three sessions, each with a lamp of its own, held out whole."""
    runs = [record_spots_module(f"day{i}", 8, seed=10 + i, lamp=4.0 * i) for i in range(3)]
    plan = CalibrationPlan(("x_mm",), "pca-ridge", split="session", size_px=(24, 32))
    return calibrate(joined(runs), plan, tmp_path_factory.mktemp("sessions") / "cal")


def page_of(calibration: Path, name: str = "page.html") -> str:
    return html.unescape(write_report(calibration, calibration.parent / name).read_text())


def section_of(page: str, name: str) -> str:
    return page[page.index(f'<section id="{name}">') :].split("</section>")[0]


def changed(calibration: Path, **parts) -> Card:
    """The card with other parts, sealed anew."""
    card = sealed(read_card(calibration).model_dump(exclude={"id"}) | parts)
    (calibration / "card.json").write_text(card.model_dump_json())
    return card


def evaluated(calibration: Path, run: Path) -> dict:
    result = CliRunner().invoke(app, ["evaluate", str(calibration), str(run), "--json", "--quiet"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def answers_of(page: str) -> list[str]:
    return re.findall(r"<li[^>]*>((?:x|height): .*?)</li>", section_of(page, "answers"))


def test_a_sentence_says_error_interval_range_and_day(calibration, rng) -> None:
    card = read_card(calibration)
    target, table = held_out(card, 5, rng)
    target = target.model_copy(update={"least": 0.0, "greatest": 6.0})
    ends = outer_ranges(target, table, table.index.to_numpy())
    assert answer(card, target, ends, 500, NOT_TESTED) == (
        "depth: 0.048 mm typical; its own intervals, ±0.10 mm on average, held 90.0 % from 0.00 to 6.00 mm; "
        "not yet tested on another day"
    )


def test_a_sentence_names_an_end_that_fails_and_a_rate_that_is_another(calibration, rng) -> None:
    card = read_card(calibration)
    target, table = held_out(card, 20, rng)
    said = answer(card, target, outer_ranges(target, table, table.index.to_numpy()), 500, NOT_TESTED)
    assert "above 5.41" in said

    def by(share: float, low: float, high: float) -> str:
        ends = {"coverage_90": share, "coverage_90_low": low, "coverage_90_high": high}
        score = target.score.model_copy(update=ends)
        return answer(card, target.model_copy(update={"score": score}), (), 500, NOT_TESTED)

    assert "intervals, ±0.10" in by(0.84, 0.805, 0.871)
    assert "held 98.0" in by(0.98, 0.96, 0.99)
    assert "held 92.0" in by(0.92, 0.89, 0.95)


def test_a_target_that_is_not_read_promises_nothing(calibration) -> None:
    card = read_card(calibration)
    poor = card.targets[0].score.model_copy(update={"mae": 1.0, "mean_mae": 1.0})
    wide = card.targets[1].score.model_copy(update={"half_width": 50.0})
    first, second = (
        t.model_copy(update={"score": s}) for t, s in zip(card.targets, (poor, wide), strict=True)
    )
    changed(calibration, targets=(first, second))
    x, height = answers_of(page_of(calibration))
    assert x.startswith("x: not read by this model: 1.0 mm off")
    assert height.startswith("height: not read by this model: its intervals are 100 mm wide on average")
    assert "90 %" not in x + height


def test_the_leakage_audit_stands_before_the_answers_and_only_where_it_failed(calibration) -> None:
    split, confounds = read_card(calibration).split, read_card(calibration).confounds
    quiet = confounds.model_copy(update={"findings": (), "failed": False})
    found = Finding(code=FindingCode.LOOK_ALIKES, values={"count": 9, "held": 80})
    changed(calibration, confounds=quiet)
    assert 'id="findings"' not in page_of(calibration, "clean.html")
    changed(calibration, split=split.model_copy(update={"clean": False, "findings": (found,)}))
    page = page_of(calibration, "found.html")
    assert page.index(found.text) < page.index('id="answers"') < page.index('id="targets"')
    assert page.index('id="targets"') < page.index('id="scores"')
    assert all("not rely" in one for one in answers_of(page))


def test_a_failed_control_names_its_target_and_remedy_before_the_numbers(calibration) -> None:
    confounds = read_card(calibration).confounds
    shares = {"folds": 0.9, "blocks": 0.8, "model": 0.9, "crop": "1,2,3,4"}
    rim = Finding(code=FindingCode.OUTSIDE_DRIFTS, target="x_mm", values=shares)
    warning = Finding(code=FindingCode.BLOCKS_EXTRAPOLATE, target="height_mm")
    changed(calibration, confounds=confounds.model_copy(update={"findings": (rim, warning), "failed": True}))
    page = page_of(calibration)
    first = section_of(page, "findings")
    assert "the scores" in first
    assert first.index(rim.text) < first.index("--crop 1,2,3,4") < first.index(warning.text)
    assert page.index('id="findings"') < page.index('id="answers"')
    x, height = answers_of(page)
    assert "not rely" in x
    assert "Do not rely" not in height


def test_one_session_is_said_to_be_untested_and_what_that_has_cost(calibration) -> None:
    page = page_of(calibration)
    assert all(NOT_TESTED in one for one in answers_of(page))
    told = re.sub("</?code>", "`", section_of(page, "answers"))
    assert read_card(calibration).sessions.text in told
    assert 'id="sessions"' not in page


def test_an_evaluation_beside_the_card_stands_in_answers_and_a_table(calibration, record_spots) -> None:
    other = record_spots("other", 12, seed=4, lamp=5.0)
    found = evaluated(calibration, other.path)
    page = page_of(calibration)
    assert all("another session" in one for one in answers_of(page))
    assert NOT_TESTED not in page
    assert "not yet tested" not in section_of(page, "answers").lower()
    table = section_of(page, "evaluations")
    assert found["run"]["run_id"] in table
    assert "Another session" in table
    evaluated(calibration, record_spots("third", 12, seed=5).path)
    said = answers_of(page_of(calibration, "two.html"))
    assert all("2 recordings" in one for one in said)


def test_the_run_that_was_learnt_from_is_no_other_day(calibration, made) -> None:
    evaluated(calibration, made[1].path)
    page = page_of(calibration)
    assert all(NOT_TESTED in one for one in answers_of(page))
    assert "other day" in section_of(page, "evaluations")


def test_files_that_are_no_evaluation_of_this_card_are_named_and_left_out(calibration, record_spots) -> None:
    scores = evaluated(calibration, record_spots("other", 12, seed=4).path)
    (kept,) = calibration.glob("evaluation-*.json")
    text = kept.read_text()
    kept.unlink()
    (calibration / "evaluation-altered.json").write_text(text.replace('"n": 60', '"n": 61'))
    (calibration / "evaluation-damaged.json").write_text("{")
    changed(calibration, seed=99)
    (calibration / "evaluation-foreign.json").write_text(text)
    report = ReportedCalibration(calibration, read_card(calibration))
    assert report.evaluations == ()
    told = section_of(page_of(calibration), "evaluations")
    for name in ("altered", "damaged", "foreign"):
        assert f"evaluation-{name}.json" in told
    assert str(calibration) not in told  # the page goes to other people
    assert scores["calibration"] in told  # whose it is
    assert all(NOT_TESTED in one for one in answers_of(page_of(calibration, "again.html")))


def test_each_session_has_its_row_and_few_of_them_no_guarantee(by_sessions) -> None:
    card, report = read_card(by_sessions), ReportedCalibration(by_sessions, read_card(by_sessions))
    page = page_of(by_sessions)
    (said,) = answers_of(page)
    assert "3 sessions" in said
    told = section_of(page, "sessions")
    names = report.table["session"].to_numpy()
    target, inside = card.targets[0], held_rows(card.targets[0], report.table)
    for name in ("day0", "day1", "day2"):
        row = re.search(rf"<tr><td>{name}</td><td>(\d+)</td><td>([\d.]+)</td><td>([\d.]+) %</td></tr>", told)
        assert row is not None
        rows = report.table[names == name]
        error = (rows["estimate:x_mm"] - rows["x_mm"]).abs()
        assert int(row[1]) == len(rows) == 40
        assert float(row[2]) == pytest.approx(error.mean(), rel=0.05)
        assert float(row[3]) == pytest.approx(100 * inside[names == name].mean(), abs=0.51)
    assert f"{card.sessions.factor:.2f} times as wide" in told
    # Three groups, drawn again, would call their coverage known to the digit.
    assert report.scored_groups == 3 < MIN_GROUPS
    assert "groups cannot" in section_of(page, "targets")
    judged = report.targets[0].score
    assert judged.coverage_90_low < 0.5 < judged.coverage_90_high
    assert (judged.mae, judged.coverage_90) == (target.score.mae, target.score.coverage_90)


def test_valid_readings_are_scored_by_themselves(rng) -> None:
    """Six of ten covered readings of eight valid ones; where all are valid, it is the score of all."""
    error, inside = np.arange(10.0), np.array([True] * 6 + [False] * 4)
    valid = np.array([False] * 2 + [True] * 8)
    one = valid_score(error, inside, np.arange(10), valid)
    assert (one.n, one.covered, one.mae) == (8, 0.5, 5.5)
    assert one.low < 0.5 < one.high
    assert valid_score(error, inside, np.arange(10), ~valid).covered == 1.0
    assert valid_score(error, inside, np.arange(10), valid & False).model_dump() == {
        "n": 0, "mae": None, "covered": None, "low": None, "high": None
    }  # fmt: skip


def test_terminal_and_page_say_over_which_target_the_audit_failed(calibration) -> None:
    audit = read_card(calibration).confounds
    assert audit is not None
    fails = ORDER_FAILS.model_copy(update={"target": "x_mm"})
    card = changed(calibration, confounds=audit.model_copy(update={"failed": True, "findings": (fails,)}))
    head = "The audit failed: do not rely on the scores of x"
    assert confounds_text(card)[0] == head
    assert f"<h2>{head}</h2>" in section_of(page_of(calibration), "findings")


ORDER_FAILS = Finding(code=FindingCode.ROWS_SHIFTED, values={"lag": 1, "own": 0.1, "best": 0.9})


def test_a_target_that_is_not_read_has_no_mark_of_a_broken_promise(calibration, record_spots) -> None:
    evaluated(calibration, record_spots("other", 12, seed=4).path)
    card = read_card(calibration)
    (kept,) = read_evaluations(calibration, card)
    said = {"x_mm": ("x is not read: its intervals",), "height_mm": ("height: above 3 mm it reads",)}
    x, height = card.targets
    poor = x.model_copy(update={"score": x.score.model_copy(update={"mae": x.score.mean_mae})})
    unread = card.model_copy(update={"targets": (poor, height)})
    found = evidence_sections._said_of(unread, kept.model_copy(update={"findings": said}))
    assert found == {"findings": list(said["height_mm"]), "unread": list(said["x_mm"])}
    assert set(kept.valid_readings) == {"x_mm", "height_mm"}
    (sentence,) = valid_readings_text(card, kept.valid_readings)
    assert sentence in section_of(page_of(calibration), "evaluations")


def test_the_worst_cases_are_of_targets_that_are_read() -> None:
    """Of 20 rows the second target, not read, is missed by all of its range; the first grows with the row."""
    errors, span = np.column_stack([np.arange(20) / 40, np.linspace(1, -0.6, 20)]), np.array([1.0, 1.0])
    assert most_missed(errors, span, [True, False]).tolist() == [19, 18, 17, 16, 15, 14]
    assert most_missed(errors, span, [False, True]).tolist() == [0, 1, 2, 3, 4, 19]
    assert most_missed(errors, span, [False, False]).tolist() == [0, 1, 2, 3, 4, 19]
    assert most_missed(errors, np.array([1.0, 10.0]), [True, True])[0] == 19, "in units of the range"


def test_many_groups_are_judged_as_the_card_says(calibration) -> None:
    report = ReportedCalibration(calibration, read_card(calibration))
    assert report.scored_groups == 16
    assert report.targets == report.card.targets


ORDER = Finding(code=FindingCode.ORDER_NEIGHBORS, target="x_mm", values={"share": 0.9, "kind": "random"})


def test_what_was_done_about_an_order_is_not_asked_for_again(calibration) -> None:
    """Blocks that were held out, and another session, take their part away."""

    def asked(card: Card, elsewhere: bool = False) -> tuple[bool, ...]:
        said = remaining_remedy(card, ORDER, elsewhere)
        return tuple(part in said for part in ("random order", "--split blocks", "palpate evaluate"))

    card = read_card(calibration)
    assert asked(card) == (True, True, True)
    by_blocks = card.model_copy(update={"split": card.split.model_copy(update={"block_rows": 20})})
    assert asked(by_blocks) == (True, False, True)
    assert asked(card, elsewhere=True) == (True, False, False)
    other = Finding(code=FindingCode.BLOCKS_EXTRAPOLATE, target="x_mm")
    assert remaining_remedy(card, other, elsewhere=True) == other.remedy


def test_sessions_held_out_whole_leave_random_order_to_be_asked_for(by_sessions) -> None:
    said = remaining_remedy(read_card(by_sessions), ORDER)
    assert "random order" in said
    assert "palpate evaluate" not in said


def test_page_and_terminal_ask_for_the_same(calibration, record_spots) -> None:
    audit = read_card(calibration).confounds
    assert audit is not None
    card = read_card(calibration)
    changed(calibration, split=card.split.model_copy(update={"block_rows": 20}))
    card = changed(calibration, confounds=audit.model_copy(update={"findings": (ORDER,)}))
    told = section_of(page_of(calibration), "findings")
    lines = " ".join(_card_text(card, calibration).replace("\n  ", " ").split("\n"))
    for said in (told.replace("<code>", "`").replace("</code>", "`"), lines):
        assert "`palpate evaluate`" in said
        assert "--split blocks" not in said
    evaluated(calibration, record_spots("other", 12, seed=4).path)
    told = section_of(page_of(calibration, "again.html"), "findings")
    assert "other sessions" in told


def test_a_target_that_is_not_read_is_never_valid_and_the_evaluation_says_so(
    calibration, record_spots
) -> None:
    other = record_spots("other", 12, seed=4)
    before = evaluated(calibration, other.path)
    assert before["frames_untold"] == {"x_mm": 0, "height_mm": 0}
    x, height = read_card(calibration).targets
    poor = x.model_copy(update={"score": x.score.model_copy(update={"mae": x.score.mean_mae})})
    for path in calibration.glob("evaluation-*.json"):
        path.unlink()
    card = changed(calibration, targets=(poor, height))
    found = evaluated(calibration, other.path)
    n = found["frames_scored"]
    assert found["frames_untold"] == {"x_mm": n, "height_mm": 0}
    readings = [Estimator.open(calibration).read(other.frame(i)) for i in range(len(other))]
    assert not any(one["x_mm"].valid for one in readings)
    assert found["frames_all_valid"] == found["frames_valid"] >= before["frames_valid"]
    assert 0 < found["frames_valid"] <= sum(one["height_mm"].valid for one in readings)
    (kept,) = read_evaluations(calibration, card)
    assert (kept.frames_untold, kept.frames_all_valid) == (found["frames_untold"], found["frames_all_valid"])
    said = frames_of(card, kept)
    assert "calibration does" in said
    assert f"{found['frames_all_valid']} gave valid readings of all that it reads" in said
    assert said in section_of(page_of(calibration), "evaluations")


def test_frames_that_do_not_tell_a_target_are_counted_beside_those_refused(calibration) -> None:
    card = read_card(calibration)
    said = frames_text(card, 400, 376, {"x_mm": 268, "height_mm": 11}, 112)
    assert all(number in said for number in ("400", "376", "268", "11", "112"))
    none = dict.fromkeys(card.columns, 0)
    assert len(frames_text(card, 400, 376, none, 376)) < len(said)


def test_where_another_session_failed_stands_in_that_answer(calibration, record_spots) -> None:
    other = record_spots("other", 12, seed=4)
    scores = evaluate(Estimator.open(calibration), other)
    sentence = "x: above 3.96 mm it reads 1.2 mm low; 13 of 25 covered where 90 % was promised"
    keep_evaluation(calibration, scores | {"findings_of": {}})
    (path,) = calibration.glob("evaluation-*.json")
    assert "13 of 25" not in page_of(calibration, "before.html")
    path.unlink()
    keep_evaluation(calibration, scores | {"findings_of": {"x_mm": [sentence]}})
    (kept,) = read_evaluations(calibration, read_card(calibration))
    assert kept.findings == {"x_mm": (sentence,)}
    page = page_of(calibration)
    x, height = answers_of(page)
    assert "above 3.96" in x
    assert "3.96" not in height
    assert "2 recordings" not in x
    assert f"✗ {sentence}." in section_of(page, "evaluations")
    assert "reads 1.2" in comparison_text(compare_calibrations(calibration, calibration))


def test_the_page_says_what_is_not_stated_and_a_whole_frame_once(calibration) -> None:
    card = read_card(calibration)
    height, width = card.input.frame_px
    whole = card.confounds.model_copy(update={"skin_px": (0, 0, width, height)})
    changed(calibration, confounds=whole, run=card.run.model_copy(update={"origin": "", "licence": ""}))
    page = page_of(calibration)
    assert "<dd>not stated</dd>" in section_of(page, "source")
    assert "whole frame" in section_of(page, "audit")
    assert "It lies in the box" not in page
    part = card.confounds.model_copy(update={"skin_px": (0, 0, width, height - 1)})
    changed(calibration, confounds=part, run=card.run.model_copy(update={"origin": "a rig", "licence": ""}))
    page = page_of(calibration, "part.html")
    assert "It lies" in page
    assert "rig; licence" in page


def test_the_control_s_share_stands_beside_the_model_s(calibration) -> None:
    card = read_card(calibration)
    first = card.confounds.targets[0].model_copy(
        update={"model_r2": 0.97, "outside_r2": 0.91, "order_r2": -0.001}
    )
    targets = (first, *card.confounds.targets[1:])
    changed(calibration, confounds=card.confounds.model_copy(update={"targets": targets}))
    told = section_of(page_of(calibration), "audit")
    assert "<tr><td>x_mm</td><td>0.97</td><td>0.91</td>" in told
    assert "-0.00" not in told


def test_every_change_of_the_camera_has_its_row(calibration) -> None:
    found = read_card(calibration).robustness
    assert len(found.table) > 20
    row = found.table[3].model_copy(update={"silent": found.beyond + 0.1, "passes": True})
    changed(
        calibration, robustness=found.model_copy(update={"table": (*found.table[:3], row, *found.table[4:])})
    )
    told = section_of(page_of(calibration), "robustness")
    assert told.count("<tr") == len(found.table) + 1
    assert f"✗ {100 * row.silent:.0f} %" in told
    assert told.count("✗") == 2  # and in the legend


def with_instrument(calibration: Path) -> Card:
    """The card whose first target was measured with twice as wide an interval as the model's."""
    first, second = read_card(calibration).targets
    instrument = InstrumentCard(
        instrument="stage 7", certificate="DKD 12", certified_on="2026-01-02",
        standard_uncertainty=first.score.half_width, resolution=0.001, backlash=0.0, bias_removed=0.0,
        half_width=2 * first.score.half_width,
    )  # fmt: skip
    return changed(calibration, targets=(first.model_copy(update={"measured_by": instrument}), second))


def test_an_instrument_s_part_stands_beside_the_model_s_and_in_the_answer(calibration) -> None:
    half = read_card(calibration).targets[0].score.half_width
    card = with_instrument(calibration)
    joined_half = reading_half_width(card.targets[0], ReportedCalibration(calibration, card).table)
    assert joined_half == pytest.approx(np.hypot(half, 2 * half), rel=0.05)
    page = page_of(calibration)
    assert "stage 7" in section_of(page, "instruments")
    assert "not stated" in section_of(page, "instruments")
    x, height = answers_of(page)
    assert "Readings say" in x
    assert "Readings say" not in height


def test_the_map_reddens_and_outlines_the_patches_that_decide(calibration) -> None:
    card = read_card(calibration)
    edges = block_edges(card.input.size_px)
    growth = np.zeros((2, len(edges[0]) - 1, len(edges[1]) - 1), np.float32)
    growth[0, 2, 3], growth[0, 2, 4], growth[0, 5, 5], growth[1] = 3.0, 2.0, 1.0, -0.1
    np.save(calibration / "deciding-pixels.npy", growth)
    chosen = deciding_blocks(growth[0])
    assert np.argwhere(chosen).tolist() == [[2, 3]]
    assert not deciding_blocks(growth[1]).any()
    report = ReportedCalibration(calibration, card)
    found = next(section for section in SECTIONS if section.__name__ == "deciding")(report)
    assert [panel.title for panel in found["panels"]] == ["x", "height"]
    assert [target.column for target in found["undecided"]] == ["height_mm"]
    drawings = [str(panel.drawing) for panel in found["panels"]]
    assert [one.count("stroke: #000000; stroke-width: 0.9") for one in drawings] == [1, 0]
    image = np.atleast_3d(imread(calibration / "example.png"))[..., :3]
    ground = to_hex(str(0.55 + 0.45 * float(image.mean())))
    assert all(f"fill: {ground}" in one for one in drawings), "the bar lies on the map's ground"
    words = (TEMPLATES / "certificate" / "deciding.html").read_text()
    assert not re.search("dark|bright|light", words), "true on a light page and on a dark one"


def test_every_section_has_its_template_and_no_template_is_left() -> None:
    names = [section.__name__ for section in SECTIONS]
    assert sorted(path.stem for path in (TEMPLATES / "certificate").iterdir()) == sorted(names)


def test_steps_are_printed_and_stand_on_the_page(calibration) -> None:
    printed = CliRunner().invoke(app, ["report", str(calibration), "--steps"]).output.splitlines()
    page = page_of(calibration)
    words = read_card(calibration).steps.words
    assert printed == [f"{i}. {sentence}" for i, sentence in enumerate(words, start=1)]
    assert all(sentence in page for sentence in words)
    found = json.loads(CliRunner().invoke(app, ["report", str(calibration), "--steps", "--json"]).output)
    assert found["clip"] == 3.0


def test_what_lies_outside_its_interval_is_drawn_in_another_shape(calibration) -> None:
    """One cross a row outside, one dot a row inside, told apart without colour."""
    report = ReportedCalibration(calibration, read_card(calibration))
    target = report.card.targets[0]
    inside = held_rows(target, report.table)
    outside = int((~inside).sum())
    assert 0 < outside < len(inside)
    drawing = str(target_panels(target, report.table, report.groups)[0].drawing)
    crosses = re.search(r'<g id="PathCollection_1">.*?</g>\s*</g>', drawing, re.DOTALL)
    assert crosses is not None
    assert crosses.group().count("<use") == outside
    dots = re.search(r'stroke-linecap: round[^>]*"', drawing)
    assert dots is not None
    path = drawing[: dots.start()].rpartition('<path d="')[2]
    assert path.count("M") == inside.sum()


def test_figures_take_the_page_s_colours(calibration) -> None:
    report = ReportedCalibration(calibration, read_card(calibration))
    text = "".join(str(p.drawing) for p in target_panels(report.card.targets[0], report.table, report.groups))
    for colour in ("INK", "ACCENT", "BAND", "BAD"):
        assert getattr(calibration_figures, colour) not in text
    for name in ("currentColor", "var(--accent)", "var(--band)", "var(--bad)"):
        assert name in text


def luminance(colour: str) -> float:
    """Relative luminance of ``#rgb`` or ``#rrggbb``, by WCAG 2.2."""
    digits = "".join(2 * c for c in colour[1:]) if len(colour) == 4 else colour[1:]
    parts = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def test_words_and_marks_stand_out_by_day_and_by_night() -> None:
    """A contrast of 4.5 for words and 3 for marks, WCAG 2.2's level AA."""
    style = (TEMPLATES / "page_style.html").read_text()
    themes = [dict(re.findall(r"--(\w+): (#\w+)", rule)) for rule in re.findall(r":root \{(.*?)\}", style)]
    assert len(themes) == 2
    assert luminance(themes[0]["page"]) > 0.9
    assert luminance(themes[1]["page"]) < 0.05
    for theme in themes:
        for name, ground, least in (
            *((word, "page", 4.5) for word in ("ink", "soft", "accent", "bad")),
            ("ink", "ground", 4.5),
            ("ink", "band", 3.0),
            ("warn", "notice", 4.5),
        ):
            pair = sorted((luminance(theme[name]), luminance(theme[ground])))
            assert (pair[1] + 0.05) / (pair[0] + 0.05) >= least, (name, theme)


def test_the_page_fits_a_phone(calibration, tmp_path) -> None:
    pytest.importorskip("websockets", reason="nothing else drives the browser")
    from tests.studio import devtools

    if devtools.chromium() is None:
        pytest.skip("there is no Chromium to look with")
    page = write_report(calibration, tmp_path / "page.html")
    browser = devtools.Browser(tmp_path / "profile")
    try:
        tab = browser.open(page.as_uri(), size=(390, 800))
        assert tab.wait("document.querySelectorAll('svg').length >= 6")
        assert tab.run("document.documentElement.scrollWidth") <= 390
        widest = (
            "Math.max(...[...document.querySelectorAll('svg')].map(s => s.getBoundingClientRect().right))"
        )
        assert tab.run(widest) <= 390
        assert tab.run("getComputedStyle(document.body).colorScheme") == "light dark"
    finally:
        browser.close()


DECIDES = {"scores": "rows covered", "targets": "rows covered", "evaluations": "rows covered here",
           "instruments": "half-width of a reading"}  # fmt: skip
"""What decides of each table, which stands beside the name."""


def with_tables(calibration: Path, record_spots) -> Card:
    """The card with an instrument and tenths, and an evaluation beside it: so that all tables are shown."""
    tenth = TenthCard(start=0.0, end=0.5, n=20, groups=10, covered=18, bias=-0.01, p=0.6)
    first, second = with_instrument(calibration).targets
    ranges = RangeCard(by_truth=None, by_estimate=None, beyond=(0, 0), reach=(0, 0), tenths=(tenth,) * 10)
    card = changed(calibration, targets=(first.model_copy(update={"over_range": ranges}), second))
    evaluated(calibration, record_spots("other", 12, seed=4).path)
    return card


def test_what_decides_stands_beside_the_name(calibration, record_spots) -> None:
    with_tables(calibration, record_spots)
    page = page_of(calibration)
    for name, column in DECIDES.items():
        assert re.findall(r"<th>(.*?)</th>", section_of(page, name))[1] == column
    assert re.search(r"<td>0\.0\d* to 0\.50*</td><td>18 of 20</td>", section_of(page, "targets"))
    s = read_card(calibration).targets[1].score
    first = re.search(r"<td>height \[mm\]</td><td>([\d.]+) %</td>", section_of(page, "scores"))
    assert first is not None
    assert float(first.group(1)) == pytest.approx(100 * s.coverage_90, abs=0.5)


def test_what_decides_is_seen_on_a_phone_without_scrolling(calibration, record_spots, tmp_path) -> None:
    pytest.importorskip("websockets", reason="nothing else drives the browser")
    from tests.studio import devtools

    if devtools.chromium() is None:
        pytest.skip("there is no Chromium to look with")
    with_tables(calibration, record_spots)
    page = write_report(calibration, tmp_path / "page.html")
    browser = devtools.Browser(tmp_path / "profile")
    try:
        tab = browser.open(page.as_uri(), size=(390, 800))
        assert tab.wait("document.querySelectorAll('svg').length >= 6")
        tab.run("document.querySelectorAll('details').forEach(d => d.open = true)")
        for name in DECIDES:
            right = f"document.querySelector('#{name} td:nth-child(2)').getBoundingClientRect().right"
            assert 0 < tab.run(right) <= 390, name
    finally:
        browser.close()
