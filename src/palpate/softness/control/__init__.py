"""Control of a rendering bench: references, servos, plausibility checks, and the loop."""

from palpate.softness.control.bench_watch import BenchLimits
from palpate.softness.control.rendering_loop import LoopSample, RenderingLoop
from palpate.softness.control.servos import ArmServo, FlowServo, PidServo, PressureServo, ReferenceTable

__all__ = [
    "ArmServo", "BenchLimits", "FlowServo", "LoopSample", "PidServo", "PressureServo", "ReferenceTable",
    "RenderingLoop",
]  # fmt: skip
