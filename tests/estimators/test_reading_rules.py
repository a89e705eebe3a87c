"""A reading is refused beyond the range, by estimate and by interval, and where it tells nothing."""

import pytest

from palpate.core.reading import ReasonCode
from palpate.estimators.model_card import CircularCard, RangeCard, ScoreCard, TargetCard
from palpate.estimators.reference_uncertainty import doubt, untold

OVER = RangeCard(by_truth=None, by_estimate=None, beyond=(0.5, 0.2), reach=(3.0, 2.0), tenths=())


def target(over: RangeCard | None = OVER, circular: CircularCard | None = None, least=0.5, greatest=18.5):
    score = ScoreCard(
        unit="N", n=1, mae=1, rmse=1, bias=0, r2=0, mean_mae=2,
        coverage_90=1, coverage_90_low=0, coverage_90_high=1, half_width=1,
    )  # fmt: skip
    return TargetCard(
        column="force_N", quantity="force", unit="N", least=least, greatest=greatest, training_mean=5.0,
        centre=0.0, scale=1.0, typical=1.0, coefficients=(0.0, 0.0, 0.0), quantile=1.0, score=score,
        over_range=over, circular=circular,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("place", "code", "distance"),
    [
        ((18.69, 17.0, 20.4), "", ""),
        ((18.71, 17.0, 20.4), ReasonCode.OUTSIDE_RANGE, "0.21 N"),
        ((18.0, 16.0, 20.6), ReasonCode.INTERVAL_OUTSIDE_RANGE, "2.1 N"),
        ((0.01, -2.4, 2.0), "", ""),
        ((-0.01, -2.4, 2.0), ReasonCode.OUTSIDE_RANGE, "0.51 N"),
        ((1.0, -2.6, 2.0), ReasonCode.INTERVAL_OUTSIDE_RANGE, "3.1 N"),
        ((9.0, 0.1, 18.2), ReasonCode.UNDETERMINED, "18.1 N"),
    ],
)
def test_beyond_what_is_usual_within_the_range_a_reading_is_refused(place, code, distance) -> None:
    found = doubt(target(), *place)
    assert found.code == code
    assert distance in found.why


def test_a_card_of_before_refuses_what_lies_wholly_outside_only() -> None:
    """22.7 N with an interval that reaches back into the range was read, and is with such a card."""
    assert not doubt(target(None), 22.7, 15.4, 30.0)
    assert doubt(target(None), 22.7, 18.6, 26.8).code == ReasonCode.OUTSIDE_RANGE
    assert not doubt(target(None), 9.0, -20.0, 38.0)


@pytest.mark.parametrize(
    ("place", "refused"),
    [
        ((-170.0, -180.0, -160.0), False),
        ((179.0, 169.0, 189.0), False),
        ((120.0, 111.0, 129.0), False),
        ((-120.0, -129.0, -111.0), False),
        ((-120.0, -121.0, -119.0), True),
        ((120.0, 119.0, 121.0), True),
        ((0.0, -10.0, 10.0), True),
    ],
)
def test_an_angle_is_in_its_arc_whichever_way_round(place, refused) -> None:
    arc = CircularCard(period=360.0, centre=(0.0, 0.0), scale=(1.0, 1.0))
    assert bool(doubt(target(None, arc, 125.0, 235.0), *place)) == refused
    assert not doubt(target(None, arc, -180.0, 180.0), *place)


def test_an_angle_is_untold_from_the_width_that_its_card_states() -> None:
    arc = CircularCard(period=360.0, centre=(0.0, 0.0), scale=(1.0, 1.0), untold_width=99.0)
    one = target(None, arc, 125.0, 235.0)
    assert not doubt(one, 180.0, 131.0, 229.0)
    untold = doubt(one, 180.0, 130.0, 230.0)
    assert untold.code == ReasonCode.UNDETERMINED
    assert all(number in untold.why for number in ("100 N", "99 N", "125", "235 N"))
    nothing = target(None, arc.model_copy(update={"untold_width": 0.0}), 125.0, 235.0)
    assert doubt(nothing, 180.0, 179.0, 181.0).code == ReasonCode.NOT_LEARNED
    before = arc.model_copy(update={"untold_width": None})
    assert "untold_width" not in before.model_dump()
    assert not doubt(target(None, before, 125.0, 235.0), 180.0, 80.0, 280.0)


def test_an_arc_of_the_whole_turn_tells_nothing() -> None:
    half_turn = CircularCard(period=180.0, centre=(0.0, 0.0), scale=(1.0, 1.0))
    assert doubt(target(None, half_turn, -90.0, 90.0), 0.0, -90.0, 90.0).code == ReasonCode.UNDETERMINED
    assert not doubt(target(None, half_turn, -90.0, 90.0), 0.0, -80.0, 80.0)


@pytest.mark.parametrize(
    ("poor", "number"),
    [({"mae": 1.91}, "1.91 N"), ({"half_width": 9.0}, "18 N"), ({"mae": 1.89, "half_width": 8.99}, "")],
)
def test_of_a_target_that_is_not_read_no_reading_is_valid(poor, number) -> None:
    def scored(one: TargetCard) -> TargetCard:
        return one.model_copy(update={"score": one.score.model_copy(update=poor)})

    place, turn = (9.0, 8.0, 10.0), CircularCard(period=18.0, centre=(0.0, 0.0), scale=(1.0, 1.0))
    for one in (target(), target(None, turn)):
        found = doubt(scored(one), *place)
        assert number in found.why
        assert found.code == (ReasonCode.NOT_LEARNED if number else "")
        assert bool(found) == untold(scored(one), *place[1:])
    before = scored(target(None))
    assert not doubt(before, *place)
    assert not untold(before, *place[1:])
