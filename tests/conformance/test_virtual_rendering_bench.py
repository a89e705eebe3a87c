"""The virtual display and arm keep every law of their protocols."""

from palpate.check import check_arm, check_display
from palpate.core import ManualClock
from palpate.softness.display_parts import FingerPresses
from palpate.softness.virtual import RenderingBench

NOBODY = FingerPresses(0.0, gap_m=20e-3)


def test_the_virtual_display_conforms() -> None:
    clock = ManualClock()
    found = check_display(RenderingBench(clock, NOBODY).display, clock=clock)
    assert [one for one in found if not one.ok] == []
    assert len(found) > 20


def test_the_virtual_arm_conforms() -> None:
    clock = ManualClock()
    found = check_arm(RenderingBench(clock, NOBODY).arm, clock=clock, way_m=(-10e-3, 10e-3))
    assert [one for one in found if not one.ok] == []
    assert len(found) > 20
