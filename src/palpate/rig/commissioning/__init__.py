"""Commissioning: a stage moved by hand and homed, a force sensor zeroed and weighed, a rig's file written."""

from palpate.rig.commissioning.hand_motion import jog, lift_clear, zero
from palpate.rig.commissioning.homing import home_clear
from palpate.rig.mean_force import AirForce, Hand

__all__ = ["AirForce", "Hand", "home_clear", "jog", "lift_clear", "zero"]
