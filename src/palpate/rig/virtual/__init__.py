"""A rig that is not there: stage, force sensor and camera around one virtual palm, in real or faster time."""

from palpate.rig.virtual.faults import Fault
from palpate.rig.virtual.palm import virtual_palm
from palpate.rig.virtual.variation import Variation

__all__ = ["Fault", "Variation", "virtual_palm"]
