"""Whole jobs across rooms: certifying a calibration, the demo."""

from palpate.studies.certify import certify
from palpate.studies.demo import DemoResult, Protocol, record, run_demo

__all__ = ["DemoResult", "Protocol", "certify", "record", "run_demo"]
