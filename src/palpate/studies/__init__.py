"""Whole jobs across rooms: certifying a calibration, the demo, sweeps over many settings."""

from palpate.studies.certify import certify
from palpate.studies.demo import DemoResult, Protocol, record, run_demo
from palpate.studies.sweep import sweep

__all__ = ["DemoResult", "Protocol", "certify", "record", "run_demo", "sweep"]
