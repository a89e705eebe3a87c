"""Control of a rendering bench: references, servos, plausibility checks, and the loop."""

from palpate.softness.control.arm_servo import ArmServo
from palpate.softness.control.bench_watch import BenchLimits
from palpate.softness.control.pressure_servo import FlowServo, PidServo, PressureServo
from palpate.softness.control.reference_table import ReferenceTable
from palpate.softness.control.rendering_loop import LoopSample, RenderingLoop

__all__ = [
    "ArmServo", "BenchLimits", "FlowServo", "LoopSample", "PidServo", "PressureServo", "ReferenceTable",
    "RenderingLoop",
]  # fmt: skip
