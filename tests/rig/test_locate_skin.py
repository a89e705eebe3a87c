"""Where a layer lies is found by touching it."""

from pathlib import Path

import pytest
from tests.refusals import refused
from tests.rig.rigs import IDEAL, SPEC, near, quick, rig

from palpate.core.errors import InputError, RecordingError
from palpate.recordings.run_reader import Run
from palpate.rig import PLANS, State, record
from palpate.rig.locate_skin import SkinPlacement, locate_skin
from palpate.rig.plans import Around
from palpate.rig.virtual import Variation

AROUND = PLANS["layer"].model_copy(update={"travel_mm_s": 50.0})
ZERO_MM = 0.12  # from first touch to where 0.05 N is passed, with half a step of the search


def found(tmp_path: Path, variation: Variation, askew_mm: tuple[float, float, float]) -> SkinPlacement:
    askew_m = tuple(1e-3 * d for d in askew_mm)
    out = tmp_path / "run"
    assert record(rig(variation=variation, askew_m=askew_m), AROUND, out).state is State.DONE
    return locate_skin(Run.open(out))


@pytest.mark.slow
@pytest.mark.parametrize("askew_mm", [(0.0, 0.0, 0.0), (0.8, -1.2, 0.4), (-1.5, 0.3, -0.6)])
def test_touching_finds_the_layers_place(tmp_path: Path, askew_mm: tuple[float, float, float]) -> None:
    layer = found(tmp_path, IDEAL, askew_mm)
    x, y, z = askew_mm
    assert layer.moved_mm[:2] == pytest.approx((x, y), abs=0.1)
    assert layer.moved_mm[2] == pytest.approx(z + ZERO_MM, abs=0.03)
    assert layer.diameter_mm == pytest.approx((2e3 * SPEC.radius_m,) * 2, abs=0.25)
    assert layer.tilt_mrad == pytest.approx((0, 0), abs=1.0)
    assert layer.origin_mm == pytest.approx(layer.moved_mm, abs=1e-4)


@pytest.mark.slow
def test_touching_finds_the_layers_tilt_through_the_spread_of_approaches(tmp_path: Path) -> None:
    layer = found(tmp_path, Variation(tilt_rad=(0.01, -0.006)), (0.0, 0.0, 0.0))
    # Seating varies by 0.02 mm, over 30 mm.
    assert layer.tilt_mrad == pytest.approx((10.0, -6.0), abs=1.5)
    assert layer.off_plane_mm < 0.06


def test_a_run_of_another_plan_says_nothing_of_the_layer(tmp_path: Path) -> None:
    record(near(), quick(depth_mm=0.4), tmp_path / "run")
    with pytest.raises(RecordingError, match="--plan layer"):
        locate_skin(Run.open(tmp_path / "run"))


@pytest.mark.parametrize(
    ("change", "said"), [({"inside_mm": 24.0}, "position-outside"), ({"beyond_mm": 5.0}, "rim-not-touched")]
)
def test_places_that_tell_nothing_are_refused(change: dict[str, float], said: str) -> None:
    with refused(said, InputError):
        Around(kind="around", **change).places()
