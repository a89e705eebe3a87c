"""Optional packages: imported here only, so that a missing one always names the extra to install."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from palpate.core.errors import InputError, MissingExtraError

EXTRAS = {
    "dask": ("Dask", "cluster"),
    "distributed": ("Dask", "cluster"),
    "fastapi": ("NiceGUI", "studio"),
    "forcedimension_core": ("forcedimension-core", "haptic-arm"),
    "nicegui": ("NiceGUI", "studio"),
    "picamera2": ("picamera2", "picamera2"),
    "pyarrow": ("pyarrow", "parquet"),
    "rtde_control": ("ur_rtde", "ur"),
    "rtde_receive": ("ur_rtde", "ur"),
    "safetensors": ("safetensors", "train"),
    "serial": ("pyserial", "rig"),
    "starlette": ("NiceGUI", "studio"),
    "torch": ("PyTorch", "train"),
    "uvicorn": ("NiceGUI", "studio"),
}
"""Name of each optional module's package, and the extra of palpate that installs it."""


@contextmanager
def optional_imports(user: str) -> Iterator[None]:
    """Name the extra of an optional package that an import inside this context lacks.

    Args:
        user: What needs the package, as the subject of a sentence.

    Example:
        >>> try:
        ...     with optional_imports("A serial port"):
        ...         raise ModuleNotFoundError("No module named 'serial'", name="serial")
        ... except MissingExtraError as e:
        ...     print("palpate[rig]" in str(e))
        True
    """
    try:
        yield
    except MissingExtraError:
        raise
    except ImportError as e:
        top = (e.name or "").partition(".")[0]
        if top not in EXTRAS:
            raise
        raise MissingExtraError(_message(user, top, e)) from e


def require(module: str, user: str) -> Any:
    """Import an optional module.

    Args:
        module: Name of the module; its package is in `EXTRAS`.
        user: What needs it, as the subject of a sentence.
    """
    top = module.partition(".")[0]
    if top not in EXTRAS:
        raise InputError(f"{module} is no optional module; there are {', '.join(EXTRAS)}")
    try:
        return import_module(module)
    except ImportError as e:
        raise MissingExtraError(_message(user, top, e)) from e


def check_installed(module: str, user: str) -> None:
    """Refuse to go on without an optional module, which is not imported."""
    try:
        found = find_spec(module) is not None
    except (ImportError, ValueError):
        found = False
    if not found:
        raise MissingExtraError(_message(user, module, None))


def _message(user: str, top: str, error: ImportError | None) -> str:
    package, extra = EXTRAS[top]
    missing = error is None or (isinstance(error, ModuleNotFoundError) and error.name == top)
    reason = "" if missing else f", which does not load ({error})"
    return f"{user} needs {package}{reason}. Install it with `pip install 'palpate[{extra}]'`."
