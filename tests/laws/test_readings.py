"""Laws of every kind of reading: arcs wrap, joint regions cover, units convert and cannot be mixed."""

import json
import math
from dataclasses import replace

import jaxtyping
import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core import ColumnError, InputError, Reading, Readings, UnitError
from palpate.core.reading import AlignedBox, CircularReading, Ellipsoid, VectorReading, wrapped

OTHER = {
    "coverage": 0.9,
    "valid": True,
    "why": "",
    "drift": None,
    "calibration": "cal",
    "frame": "7",
    "time_s": 0.0,
}
ANGLES = st.floats(-1e3, 1e3, allow_nan=False)


@pytest.fixture
def shapes_unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """The package as it is outside these tests, where no hook checks shapes before its own code does."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


def scalar(quantity: str = "depth", unit: str = "m", value: float = 6.2e-4) -> Reading:
    return Reading(
        quantity=quantity,
        unit=unit,
        value=value,
        low=value - 4e-5,
        high=value + 4e-5,
        calibrated_range=(0.0, 5e-3),
        **OTHER,
    )


def angle(value: float, half: float) -> CircularReading:
    return CircularReading(
        quantity="twist",
        unit="deg",
        value=value,
        low=value - half,
        high=value + half,
        period=360.0,
        calibrated_range=(-180.0, 180.0),
        **OTHER,
    )


def force(region: Ellipsoid | AlignedBox, value: np.ndarray | None = None) -> VectorReading:
    return VectorReading(
        quantity="force",
        unit="N",
        components=("x", "y", "z"),
        value=np.array([0.1, -0.2, 3.0]) if value is None else value,
        region=region,
        calibrated_range=np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 5.0]]),
        **OTHER,
    )


ALL = (scalar(), angle(10.0, 2.0), force(Ellipsoid(np.eye(3), 2.5)))


def test_the_way_round_past_180_degrees_is_short() -> None:
    assert angle(179.0, 5.0).distance(-179.0) == pytest.approx(-2.0)
    assert angle(-179.0, 5.0).distance(179.0) == pytest.approx(2.0)


@given(a=ANGLES, b=ANGLES)
def test_no_distance_on_a_circle_is_longer_than_half_of_it(a: float, b: float) -> None:
    there = wrapped(a - b, 360.0)
    assert -180.0 <= there < 180.0
    assert_allclose(np.exp(1j * np.deg2rad(b + there)), np.exp(1j * np.deg2rad(a)), atol=1e-9)


@given(value=ANGLES, half=st.floats(0.1, 170.0), turns=st.integers(-3, 3), share=st.floats(-0.99, 0.99))
def test_an_arc_holds_what_is_within_it_whatever_the_turn(
    value: float, half: float, turns: int, share: float
) -> None:
    reading = angle(value, half)
    assert reading.contains(value + share * half + 360.0 * turns)
    beyond = half + 0.005 * (360.0 - 2 * half) + abs(share) * 0.99 * (180.0 - half)
    assert not reading.contains(value + beyond + 360.0 * turns)


def test_an_arc_of_a_whole_turn_holds_every_angle() -> None:
    assert all(angle(12.0, 180.0).contains(one) for one in (-180.0, 0.0, 77.0, 191.9))


@given(value=ANGLES, half=st.floats(0.0, 179.0), turns=st.integers(-3, 3))
def test_both_ends_of_an_arc_are_on_it_whatever_the_turn(value: float, half: float, turns: int) -> None:
    reading = angle(value, half)
    assert reading.contains(reading.low + 360.0 * turns)
    assert reading.contains(reading.high + 360.0 * turns)


def test_an_arc_without_ends_holds_every_angle_and_nothing_else() -> None:
    endless = angle(10.0, math.inf)
    assert all(endless.contains(one) for one in (10.0, -170.0, 1e4))
    assert replace(endless, low=0.0).contains(-1.0)
    assert not any(endless.contains(one) for one in (math.nan, math.inf))
    assert not angle(math.nan, 1.0).contains(0.0)


def test_an_arc_that_does_not_hold_its_value_is_refused() -> None:
    # 170 to -170 is written as 170 to 190: ends upwards.
    with refused("arc-without-value", InputError):
        CircularReading(
            quantity="twist",
            unit="deg",
            value=180.0,
            low=170.0,
            high=-170.0,
            period=360.0,
            calibrated_range=(-180.0, 180.0),
            **OTHER,
        )


@pytest.mark.parametrize("shape", ["ellipsoid", "box"])
def test_a_joint_region_holds_the_truth_at_the_rate_it_states(shape: str, rng: np.random.Generator) -> None:
    """Gaussian errors: P(chi² of 3 <= r²) = 0.9 at r² = 6.2514, and (2 Phi(h) - 1)³ = 0.9 at h = 2.1145."""
    root = np.array([[0.3, 0.0, 0.0], [0.2, 0.1, 0.0], [-0.1, 0.05, 0.4]])
    if shape == "ellipsoid":
        reading, draw = force(Ellipsoid(root @ root.T, np.sqrt(6.2514))), lambda z: root @ z
    else:
        sigma = np.array([0.3, 0.1, 0.4])
        reading, draw = force(AlignedBox(2.1145 * sigma)), lambda z: sigma * z
    n = 20_000
    inside = [reading.contains(reading.value + draw(z)) for z in rng.standard_normal((n, 3))]
    # Four standard errors of a share of n draws.
    assert np.mean(inside) == pytest.approx(0.9, abs=4 * np.sqrt(0.9 * 0.1 / n))


def test_one_component_holds_at_least_as_often_as_all_together(rng: np.random.Generator) -> None:
    root = np.array([[0.3, 0.0, 0.0], [0.2, 0.1, 0.0], [-0.1, 0.05, 0.4]])
    reading = force(Ellipsoid(root @ root.T, np.sqrt(6.2514)))
    x = reading.component("x")
    assert x.column == "force_x_N"
    for z in rng.standard_normal((2000, 3)):
        truth = reading.value + root @ z
        assert x.contains(truth[0]) or not reading.contains(truth)
    with refused("no-component", ColumnError):
        reading.component("w")


def test_a_vector_without_a_value_for_each_component_is_refused() -> None:
    with pytest.raises(InputError, match="3 components"):
        force(AlignedBox(np.ones(2)))
    with pytest.raises(InputError, match="positive definite"):
        Ellipsoid(np.diag([1.0, 0.0]), 2.0)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_a_covariance_is_symmetric_by_its_own_measure(scale: float) -> None:
    """By the trace: in N^2 or m^2, whatever the unit's size."""
    for off in ((0.9, -0.9), (0.9, 0.8999)):
        with pytest.raises(InputError, match="symmetric"):
            Ellipsoid(scale * np.array([[1.0, off[0]], [off[1], 1.0]]), 2.0)
    rounded = np.array([[1.0, 0.9], [np.float32(0.9), 1.0]])
    assert Ellipsoid(scale * rounded, 2.0).contains(np.zeros(2))


@pytest.mark.usefixtures("shapes_unchecked")
@pytest.mark.parametrize(
    "covariance", [np.ones(3), np.ones((2, 3)), np.ones((1, 1, 1)), np.ones((0, 0)), np.full((2, 2), np.nan)]
)
def test_what_is_no_covariance_is_refused(covariance: np.ndarray) -> None:
    with pytest.raises(InputError, match="covariance"):
        Ellipsoid(covariance, 2.0)


@pytest.mark.usefixtures("shapes_unchecked")
@pytest.mark.parametrize("shape", [(2,), (3, 2), (2, 2)])
def test_a_vector_s_range_has_a_least_and_a_greatest_of_each_component(shape: tuple[int, ...]) -> None:
    with refused("range-shape", InputError, match=r"\(2"):
        replace(force(AlignedBox(np.ones(3))), calibrated_range=np.zeros(shape))


def test_an_interval_that_runs_downwards_is_refused() -> None:
    with pytest.raises(InputError, match="downwards"):
        replace(scalar(), low=2.0, high=1.0)
    assert math.isnan(replace(scalar(), value=math.nan, low=math.nan, high=math.nan).low)


@pytest.mark.parametrize(
    ("reading", "symbol", "factor"),
    [(ALL[0], "mm", 1e3), (ALL[1], "rad", np.pi / 180), (ALL[2], "mN", 1e3)],
    ids=["scalar", "circular", "vector"],
)
def test_all_that_has_the_unit_is_converted_and_what_is_held_stays_held(reading, symbol, factor) -> None:
    other = reading.in_unit(symbol)
    assert other.unit == symbol
    assert other.in_unit(symbol) is other
    numbers, converted = (flat(one.to_dict()) for one in (reading, other))
    for name, value in numbers.items():
        scale = factor**2 if "covariance" in name else 1.0 if "radius" in name or "axes" in name else factor
        assert converted[name] == pytest.approx(value * scale, rel=1e-5), name
    if isinstance(reading, VectorReading):
        assert other.contains(factor * (reading.value + 0.9)) == reading.contains(reading.value + 0.9)
    if isinstance(reading, CircularReading):
        assert other.contains(factor * 371.0)
        assert not other.contains(factor * 373.0)


def flat(told, name: str = "") -> dict[str, float]:
    """Every number in plain values, by the way to it."""
    if isinstance(told, dict):
        return {k: v for key, part in told.items() for k, v in flat(part, f"{name}.{key}").items()}
    if isinstance(told, list | tuple):
        return {k: v for i, part in enumerate(told) for k, v in flat(part, f"{name}.{i}").items()}
    return {name: told} if isinstance(told, float) else {}


@pytest.mark.parametrize("reading", ALL, ids=["scalar", "circular", "vector"])
def test_a_unit_of_another_quantity_is_refused(reading) -> None:
    with refused("unit-conversion", UnitError):
        reading.in_unit("kPa")


@pytest.mark.parametrize("reading", ALL, ids=["scalar", "circular", "vector"])
def test_every_kind_is_strict_json_and_a_short_line(reading) -> None:
    json.dumps(reading.to_dict(), allow_nan=False)
    assert reading.quantity in repr(reading)
    assert len(repr(reading)) < 150
    assert "\n" not in repr(reading)
    assert "<" not in reading._repr_html_().removeprefix("<code>").removesuffix("</code>")


def test_a_key_says_the_unit_of_its_value() -> None:
    readings = Readings({"depth_mm": scalar()})
    assert readings["depth_mm"].value == pytest.approx(0.62)
    assert readings["depth_um"].value == pytest.approx(620.0)
    assert readings["depth"].value == readings["depth_m"].value == 6.2e-4
    for key, reading in readings.items():
        assert reading.column == key
    assert repr(readings) == "<Readings depth 0.620 mm ± 0.040 mm, inside the calibrated range>"
    assert "depth_mm" in readings._repr_html_()


def test_a_key_without_a_reading_is_refused_with_those_there_are() -> None:
    readings = Readings({"x_mm": scalar("x"), "x_deg": scalar("x", "rad"), "depth_mm": scalar()})
    with refused("no-reading", ColumnError, match="'force_N'"):
        readings["force_N"]
    with refused("no-reading", ColumnError, match="'x'"):
        readings["x"]
    assert readings["x_rad"].value == 6.2e-4
    assert "force_N" not in readings
    with pytest.raises(ColumnError):
        readings["depth_N"]
