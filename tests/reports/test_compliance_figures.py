"""Pictures of compliance: every trial is drawn, and what is infinite or missing breaks none."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.calibration.compliance.compliance_calibration import ReferenceTrial
from palpate.calibration.compliance.compliance_reading import AreaCourse, PressReading
from palpate.core.reading import Reading
from palpate.estimators.compliance.pin_press import PinPress
from palpate.estimators.compliance.spread_rate import AsReported
from palpate.reports.compliance_figures import compare_figure, press_figure

FORCE = np.linspace(0.5, 5, 12)
NAMES = ("S1", "new", "S2", "S3")


@pytest.fixture
def pressed(rng) -> ReferenceTrial:
    at = rng.uniform(20, 280, (30, 2))
    moved = FORCE[:, None, None] * rng.standard_normal((30, 2))
    moved[:, 3] = np.nan
    return ReferenceTrial(PinPress(np.arange(12), FORCE, at, moved, 1e-3 * FORCE, 5e-3, ()), 1e-4 * FORCE)


def reported() -> AsReported:
    return AsReported(FORCE, np.full(12, 0.01), np.exp(0.01 * np.arange(12)))


def reading(quantity: str, value: float, low: float, high: float, why: str = "") -> Reading:
    range_ = (1.1e3, 7.6e3)
    return Reading(
        quantity=quantity, value=value, low=low, high=high, unit="N_per_m", coverage=0.9,
        calibrated_range=range_, valid=not why, why=why, drift=None, calibration="c", frame="f", time_s=0.0,
    )  # fmt: skip


def touch(value: float, low: float, high: float, why: str = "", area: bool = True) -> PressReading:
    course = AreaCourse(FORCE, 1e-4 * FORCE[:, None] * [1.0, 0.9, 1.1])
    one = reading("stiffness", value, low, high, why)
    return PressReading(
        one, replace(one, quantity="stiffness_both_cues"), None, None, None, None, course if area else None
    )


def texts(axes) -> str:
    return " ".join(one.get_text() for one in axes.texts)


def test_a_press_shows_its_pins_area_and_stiffness(pressed) -> None:
    figure = press_figure(pressed, touch(5.3e3, 5e3, 5.6e3), reported())
    pins, area, stiffness = figure.axes
    assert "pins" in pins.get_title()
    assert "mm²" in area.get_ylabel()
    assert "5.3 N/mm" in texts(stiffness)
    figure.canvas.draw()


def test_a_press_without_a_calibration_shows_what_is_relative(pressed) -> None:
    figure = press_figure(pressed, None, reported())
    assert len(figure.axes) == 3
    assert "relative" in figure.axes[1].get_title()
    placeless = replace(pressed, press=replace(pressed.press, position_m=None))
    figure = press_figure(placeless, None, reported())
    assert figure.axes[2].get_xlabel() == "frame"
    figure.canvas.draw()


def test_a_comparison_draws_every_trial_of_every_specimen() -> None:
    courses = {name: [(FORCE, i + FORCE), (FORCE, i + 1.1 * FORCE)] for i, name in enumerate(NAMES)}
    cues = {f"cue {k}": {name: [1.0 + i, 1.2 + i, 1.1] for i, name in enumerate(NAMES)} for k in range(5)}
    figure = compare_figure(courses, "area", cues)
    first, *rest = figure.axes
    assert len(first.lines) == 8
    drawn = [one for one in rest if one.axison]
    assert [one.get_ylabel() for one in drawn] == list(cues)
    for one in drawn:
        assert [label.get_text() for label in one.get_xticklabels()] == list(NAMES)
        points = [line for line in one.lines if line.get_marker() == "."]
        assert [len(line.get_ydata()) for line in points] == [3] * 4
    figure.canvas.draw()
