"""Fakes of softness devices, with faults on demand, which tests talk to."""

from palpate.softness.fakes.labjack_board import FakeLabJack

__all__ = ["FakeLabJack"]
