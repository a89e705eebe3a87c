"""Trust in a force sensor: what it learns, what it doubts, and how it names what is wrong.

Nothing here moves or measures: `devices.MotionGuard` asks at every sample, stops, and takes the name.
"""

from palpate.devices.force_trust.air_noise import AirNoise, SampleDating
from palpate.devices.force_trust.fault_names import name_fault
from palpate.devices.force_trust.force_monitor import Doubt, ForceMonitor, Phase
from palpate.devices.force_trust.stiffness_corridor import StiffnessCorridor, StiffnessRange

__all__ = [
    "AirNoise",
    "Doubt",
    "ForceMonitor",
    "Phase",
    "SampleDating",
    "StiffnessCorridor",
    "StiffnessRange",
    "name_fault",
]
