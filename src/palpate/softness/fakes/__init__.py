"""Fakes of softness devices, with faults on demand, which tests talk to."""

from palpate.softness.fakes.fake_force_dimension import ArmFaults, DhdStatus, FakeForceDimension
from palpate.softness.fakes.labjack_board import FakeLabJack

__all__ = ["ArmFaults", "DhdStatus", "FakeForceDimension", "FakeLabJack"]
