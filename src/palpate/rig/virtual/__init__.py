"""A rig that is not there: stage, force sensor and camera around any sensor, in real or faster time."""

from palpate.rig.virtual.bench import virtual_rig
from palpate.rig.virtual.faults import Fault
from palpate.rig.virtual.variation import Variation

__all__ = ["Fault", "Variation", "virtual_rig"]
