"""Whole jobs across rooms: certifying a calibration, the demo, sweeps over many settings."""

from palpate.workflows.certification import certify
from palpate.workflows.palm_demo import DemoProtocol, DemoResult, record_demo, run_demo
from palpate.workflows.parameter_sweep import sweep

__all__ = ["DemoProtocol", "DemoResult", "certify", "record_demo", "run_demo", "sweep"]
