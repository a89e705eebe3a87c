"""A command that a fault of the stage ends presses no harder when it is repeated; measured as true depth."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.rig.rigs import IDEAL, plan, rig

from palpate.core import PalpateError, Position, Stage, Wrench
from palpate.rig import record
from palpate.rig.commissioning.first_touch import _go_above
from palpate.rig.commissioning.hand_motion import jog, lift_clear, retreat
from palpate.rig.mean_force import Hand
from palpate.rig.plans import Listed
from palpate.rig.rig import Rig
from palpate.rig.rig_check import check_rig

MM = 1e-3
START_MM = -0.5


class FaultyStage:
    """A stage whose probe goes elsewhere than it reports, by `true` and `told` about where it was opened."""

    def __init__(self, stage: Stage) -> None:
        self._stage, self.deepest_m, self.lost = stage, -math.inf, ""
        self.began = stage.position_m()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stage, name)

    def told(self, at: Position) -> Position:
        return at

    def true(self, at: Position) -> Position:
        return at

    def position_m(self) -> Position:
        at = self._stage.position_m()
        self.deepest_m = max(self.deepest_m, at[2])
        return self.told(at)

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        self._stage.move_to(self.true(position_m), speed_m_s)

    def moving(self) -> bool:
        self.position_m()
        return self._stage.moving()

    def forget_position(self, why: str) -> None:
        self.lost = why


class Reversed(FaultyStage):
    """Its z runs the other way."""

    def told(self, at: Position) -> Position:
        return at[0], at[1], 2 * self.began[2] - at[2]

    true = told


class Exchanged(FaultyStage):
    """The plugs of its x and z are exchanged."""

    def told(self, at: Position) -> Position:
        x0, _, z0 = self.began
        return x0 + at[2] - z0, at[1], z0 + at[0] - x0

    true = told


class Slack(FaultyStage):
    """Backlash of its z: the probe moves up only after the stage has moved by so much."""

    play_m, up = 1.0 * MM, False

    def told(self, at: Position) -> Position:
        return at[0], at[1], at[2] - self.play_m * self.up

    def true(self, at: Position) -> Position:
        x, y, z = self._stage.position_m()
        self.up = at[2] < self.told((x, y, z))[2]
        return at[0], at[1], at[2] + self.play_m * self.up


class Weak(FaultyStage):
    """Its motor of z moves down and loses all steps up."""

    lost_m = 0.0

    def told(self, at: Position) -> Position:
        return at[0], at[1], at[2] - self.lost_m

    def true(self, at: Position) -> Position:
        self.lost_m = max(self.lost_m, self._stage.position_m()[2] - at[2])
        return at[0], at[1], at[2] + self.lost_m


def jogged(axis: str, mm: float) -> Callable[[Rig, Path], None]:
    def run(made: Rig, folder: Path) -> None:
        jog(
            made.stage, made.force, made.mounting, made.limits, made.clock,
            axis=axis, distance_m=mm * MM, speed_m_s=2 * MM,
        )  # fmt: skip

    return run


def recorded(made: Rig, folder: Path) -> None:
    aside = Listed(kind="listed", at_mm=((2.0, 0.0),))
    record(made, plan(places=aside, clearance_mm=4.0), folder)


def checked(made: Rig, folder: Path) -> None:
    check_rig(made, clear_m=0.1 * MM, close=False)


def zeroed(made: Rig, folder: Path) -> None:
    lift_clear(Hand(made.stage, made.force, made.mounting, made.clock), made.limits)


def led_aside(made: Rig, folder: Path) -> None:
    x, y, z = made.stage.position_m()
    _go_above(Hand(made.stage, made.force, made.mounting, made.clock), made.limits, (x + 3 * MM, y, z))


@pytest.mark.parametrize(
    ("fault", "command"),
    [
        (Reversed, recorded),
        (Reversed, checked),
        (Reversed, zeroed),
        (Reversed, jogged("z", -3.0)),
        (Exchanged, recorded),
        (Exchanged, checked),
        (Exchanged, led_aside),
        (Exchanged, jogged("x", 3.0)),
        (Slack, jogged("z", 3.0)),
        (Weak, checked),
        (Weak, jogged("z", 3.0)),
        (Weak, jogged("x", 3.0)),
    ],
    ids=lambda one: getattr(one, "__qualname__", str(one)).split(".")[0],
)
def test_a_repeated_command_presses_no_harder_than_the_first(
    tmp_path: Path, fault: type[FaultyStage], command: Callable[[Rig, Path], None]
) -> None:
    made = rig(variation=IDEAL)
    placed(made, START_MM)
    stage = fault(made.stage)
    deepest_mm = []
    for k in range(5):
        if stage.lost:  # its position is not taken from the last session
            break
        stage.deepest_m = -math.inf
        with suppress(PalpateError):
            command(replace(made, stage=stage), tmp_path / f"run{k}")
        deepest_mm.append(stage.deepest_m / MM)
    assert max(deepest_mm) < 1.0
    assert max(deepest_mm) > 0.0, "the fault leads into the skin"
    assert max(deepest_mm[2:], default=0.0) < max(deepest_mm[:2]) + 0.15


class ChangedSensor:
    """A force sensor whose zero moves once the probe has been at `where`."""

    def __init__(self, made: Rig, where: Callable[[Position], bool]) -> None:
        self._rig, self._where, self._changed = made, where, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rig.force, name)

    def _felt(self, one: Wrench) -> Wrench:
        self._changed = self._changed or self._where(self._rig.stage.position_m())
        x, y, z = one.force_n
        return replace(one, force_n=(x, y, z + 1.5)) if self._changed else one

    def drain(self) -> list[Wrench]:
        return [self._felt(one) for one in self._rig.force.drain()]

    def latest(self) -> Wrench:
        return self._felt(self._rig.force.latest())


def test_a_jog_aside_that_a_wrong_force_ends_does_not_go_beyond_its_start(tmp_path: Path) -> None:
    made = rig(variation=IDEAL)
    start = placed(made, -0.5)
    force = ChangedSensor(made, lambda at: at[0] > start[0] + 0.5 * MM)
    with pytest.raises(PalpateError):
        jogged("x", 3.0)(replace(made, force=force), tmp_path)
    assert made.stage.position_m()[0] >= start[0] - 1e-6
    assert made.stage.position_m()[2] <= start[2] + 1e-6


@pytest.mark.parametrize("start_mm", [-0.02, -0.5])
def test_a_lift_in_which_the_sensor_changes_ends_no_lower_than_it_began(
    tmp_path: Path, start_mm: float
) -> None:
    made = rig(variation=IDEAL)
    start = placed(made, start_mm)
    force = ChangedSensor(made, lambda at: at[2] < start[2] - 0.65 * MM)
    with pytest.raises(PalpateError):
        jogged("z", -5.0)(replace(made, force=force), tmp_path)
    assert made.stage.position_m()[2] < start[2]


def placed(made: Rig, z_mm: float) -> Position:
    made.stage.move_to((0.0, 0.0, z_mm * MM), 5 * MM)
    while made.stage.moving():
        made.clock.sleep(0.01)
    return made.stage.position_m()


def test_an_interrupted_way_back_forgets_the_position(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = rig(variation=IDEAL)
    placed(made, -0.1)
    stage = Reversed(made.stage)

    def interrupted(*given: object, **named: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("palpate.rig.commissioning.hand_motion.contact_n", interrupted)
    with pytest.raises(KeyboardInterrupt):
        retreat(Hand(stage, made.force, made.mounting, made.clock), 3 * MM, 2 * MM)
    assert stage.lost
