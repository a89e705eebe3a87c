"""Commissioning: a stage moved by hand and homed, a force sensor zeroed and weighed, a rig's file written."""

from palpate.rig.commissioning.hand_motion import AirForce, home_clear, jog, lift_clear, zero
from palpate.rig.commissioning.scaled_force import ScaledForce

__all__ = ["AirForce", "ScaledForce", "home_clear", "jog", "lift_clear", "zero"]
