"""A rig that is not there: stage, force sensor and camera around any sensor, in real or faster time."""

from palpate.rig.virtual.disturbances import Fault, Variation
from palpate.rig.virtual.virtual_bench import virtual_rig

__all__ = ["Fault", "Variation", "virtual_rig"]
