"""Camera-based touch you can trust: optical tactile sensors as calibrated instruments.

The names here load when they are first used, so that `import palpate` is quick.
"""

from palpate.version import __version__

TYPE_CHECKING = False  # as in `typing`, whose import would take a third of the time of `palpate rig stop`

if TYPE_CHECKING:
    from palpate.calibration import CalibrationPlan, calibrate, evaluate
    from palpate.core import Frame, PalpateError, Reading, Readings
    from palpate.core.sensor import sensor
    from palpate.estimators import Estimator
    from palpate.recordings import Manifest, Run, RunWriter, import_images, read_image
    from palpate.reports import write_report
    from palpate.sensing import live, open_live_source, open_source, sense
    from palpate.workflows import certify, run_demo

_NAMES = {
    "calibration": ("CalibrationPlan", "calibrate", "evaluate"),
    "core": ("Frame", "PalpateError", "Reading", "Readings"),
    "core.sensor": ("sensor",),
    "estimators": ("Estimator",),
    "recordings": ("Manifest", "Run", "RunWriter", "import_images", "read_image"),
    "reports": ("write_report",),
    "sensing": ("live", "open_live_source", "open_source", "sense"),
    "workflows": ("certify", "run_demo"),
}

__all__ = [
    "CalibrationPlan",
    "Estimator",
    "Frame",
    "Manifest",
    "PalpateError",
    "Reading",
    "Readings",
    "Run",
    "RunWriter",
    "__version__",
    "calibrate",
    "certify",
    "evaluate",
    "import_images",
    "live",
    "open_live_source",
    "open_source",
    "read_image",
    "run_demo",
    "sense",
    "sensor",
    "write_report",
]


if not TYPE_CHECKING:  # mypy accepts only the names imported above

    def __getattr__(name: str) -> object:
        """Return a public name, imported on first use."""
        from importlib import import_module

        if name == "Plan":
            from warnings import warn

            warn("palpate.Plan is now called palpate.CalibrationPlan", DeprecationWarning, stacklevel=2)
            name = "CalibrationPlan"
        for module, names in _NAMES.items():
            if name in names:
                return getattr(import_module(f"palpate.{module}"), name)
        raise AttributeError(f"palpate has no {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return __all__
