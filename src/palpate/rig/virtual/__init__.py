"""A rig that is not there: stage, force sensor and camera around any sensor, in real or faster time.

The names here load when they are first used: a rig's file names the kinds of faults without a rig.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palpate.rig.virtual.disturbances import Fault, Variation
    from palpate.rig.virtual.virtual_bench import virtual_rig

_MODULES = {"Fault": "disturbances", "Variation": "disturbances", "virtual_rig": "virtual_bench"}

__all__ = ["Fault", "Variation", "virtual_rig"]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(f"palpate.rig.virtual.{_MODULES[name]}"), name)
    raise AttributeError(f"palpate.rig.virtual has no {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return __all__
