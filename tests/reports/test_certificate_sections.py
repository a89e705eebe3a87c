"""The page answers first, in sentences that the numbers bear out, and shows what there is to show."""

import html
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread
from typer.testing import CliRunner

from palpate.calibration import CalibrationPlan, calibrate
from palpate.calibration.certificate import most_missed
from palpate.calibration.confounds.skin_region import block_edges
from palpate.calibration.sessions import read_evaluations
from palpate.cli import app
from palpate.estimators import Estimator, read_card
from palpate.estimators.findings import Finding, FindingCode
from palpate.estimators.model_card import Card, InstrumentCard, sealed
from palpate.reports import calibration_figures, write_report
from palpate.reports.calibration_figures import deciding_blocks
from palpate.reports.evaluation_text import frames_of
from palpate.reports.sections import (
    NOT_TESTED,
    SECTIONS,
    ReportedCalibration,
    answer,
    reading_half_width,
)

pytestmark = pytest.mark.usefixtures("figures_drawn_once", "changes_untried")

TEMPLATES = Path(calibration_figures.__file__).parent / "templates"


@pytest.fixture(scope="module")
def made(record_spots_module, tmp_path_factory, changes_untried):
    plan = CalibrationPlan(("x_mm", "height_mm"), "pca-ridge", split="group:press", size_px=(12, 16))
    run = record_spots_module("run", 16)
    return calibrate(run, plan, tmp_path_factory.mktemp("made") / "cal"), run


@pytest.fixture
def calibration(made, tmp_path):
    return Path(shutil.copytree(made[0], tmp_path / "cal"))


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


def test_a_sentence_gives_the_rate_to_the_digits_of_its_interval(calibration) -> None:
    card = read_card(calibration)
    (target, _), wide = card.targets, {"half_width": 0.1}

    def by(share: float, low: float, high: float) -> str:
        ends = {"coverage_90": share, "coverage_90_low": low, "coverage_90_high": high}
        score = target.score.model_copy(update=wide | ends)
        return answer(card, target.model_copy(update={"score": score}), 500, NOT_TESTED)

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
    warning = Finding(
        code=FindingCode.ORDER_NEIGHBORS, values={"share": 0.9, "kind": "random"}, target="height_mm"
    )
    changed(calibration, confounds=confounds.model_copy(update={"findings": (rim, warning), "failed": True}))
    page = page_of(calibration)
    first = section_of(page, "findings")
    assert "the scores" in first
    assert first.index(rim.text) < first.index("--crop 1,2,3,4") < first.index(warning.text)
    assert page.index('id="findings"') < page.index('id="answers"')
    x, height = answers_of(page)
    assert "not rely" in x
    assert "Do not rely" not in height


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


def test_the_worst_cases_are_of_targets_that_are_read() -> None:
    """Of 20 rows the second target, not read, is missed by all of its range; the first grows with the row."""
    errors, span = np.column_stack([np.arange(20) / 40, np.linspace(1, -0.6, 20)]), np.array([1.0, 1.0])
    assert most_missed(errors, span, [True, False]).tolist() == [19, 18, 17, 16, 15, 14]
    assert most_missed(errors, span, [False, True]).tolist() == [0, 1, 2, 3, 4, 19]
    assert most_missed(errors, span, [False, False]).tolist() == [0, 1, 2, 3, 4, 19]
    assert most_missed(errors, np.array([1.0, 10.0]), [True, True])[0] == 19, "in units of the range"


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


@pytest.mark.slow
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


"""What decides of each table, which stands beside the name."""
