"""Commissioning: a stage moved by hand and homed, a force sensor zeroed and weighed, a rig's file written."""
