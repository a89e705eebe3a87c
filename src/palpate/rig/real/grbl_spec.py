"""A Grbl stage's specification under its former name: see `palpate.rig.real.grbl`."""

from palpate.rig.real.grbl.spec import GrblSpec

__all__ = ["GrblSpec"]
