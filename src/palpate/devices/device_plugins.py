"""Devices by name: a class of one's own as `package.module:Class`, or an entry point of an installed package.

A device that is opened this way goes through the structural part of the conformance checks before it is
used: what does not import, lacks a method, or hands out another shape or unit is closed, and refused by the
law that it breaks.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from palpate.core import Clock, InputError, PalpateError
from palpate.devices.check.interface_check import Role, check_interface

GROUPS: dict[Role, str] = {
    "stage": "palpate.stages",
    "force": "palpate.force_sensors",
    "camera": "palpate.cameras",
}
"""Entry-point groups in which an installed package registers a device."""


def check_kind(role: Role, kind: str, built_in: Collection[str]) -> None:
    """Refuse a name that nothing has, or that two have; nothing is imported.

    Args:
        role: what the device is to be used as.
        kind: a name of palpate's own, "package.module:Class", or an entry point's name.
        built_in: palpate's own names.

    Raises:
        InputError: there is no such name; or an installed package takes one that exists already.
    """
    if ":" in kind:
        return
    registered = [one for one in entry_points(group=GROUPS[role]) if one.name == kind]
    packages = ", ".join(one.value for one in registered)
    if kind in built_in:
        if registered:
            raise InputError(f"{packages} is registered as {kind!r}, a name of palpate's own; rename it")
    elif not registered:
        raise InputError(
            f"there is no {role} {kind!r}; palpate has {', '.join(sorted(built_in))}, installed packages "
            f"register {_names(role) or 'none'}, and your own class is given as 'package.module:Class'"
        )
    elif len(registered) > 1:
        raise InputError(f"{packages} are all registered as {kind!r}; rename or uninstall all but one")


def open_device(role: Role, kind: str, options: Mapping[str, Any], clock: Clock) -> Any:
    """Open a device by the name of its class, and check its interface.

    Args:
        role: what it is to be used as.
        kind: "package.module:Class", a function that returns the device, or an entry point's name.
        options: passed to it by name; `clock` is passed as well where it takes one.
        clock: that it must stamp on.

    Raises:
        InputError: it does not import, does not take these options, or breaks a law of the interface, which
            the message names; it has been closed again.
        DeviceError: the device is missing, busy or refuses.

    Example:
        >>> from palpate.core import MonotonicClock
        >>> open_device("stage", "bench.axes:Gantry", {"port": "COM3"}, MonotonicClock())
        Traceback (most recent call last):
        ...
        palpate.core.errors.InputError: stage 'bench.axes:Gantry' does not import: No module named 'bench'
    """
    factory = _factory(role, kind)
    device = _called(role, kind, factory, options, clock)
    broken = next((one for one in check_interface(role, device, clock) if not one.ok), None)
    if broken is not None:
        with suppress(Exception):  # what lacks a method may well fail to close
            device.close()
        raise InputError(f"{role} {kind!r} breaks the law {broken.name!r}: {broken.message}")
    return device


def _factory(role: Role, kind: str) -> Callable[..., Any]:
    try:
        if ":" in kind:
            found = EntryPoint(name=kind, value=kind, group=GROUPS[role])
        else:
            (found,) = entry_points(group=GROUPS[role], name=kind)
        module, _, name = found.value.partition(":")
        factory: Any = importlib.import_module(module.strip())
        for part in name.strip().split("."):
            factory = getattr(factory, part)
    except PalpateError:
        raise
    except Exception as e:  # whatever a module of somebody else's raises on import
        raise InputError(f"{role} {kind!r} does not import: {e}") from e
    if not callable(factory):
        raise InputError(f"{role} {kind!r} is no class and no function; name what makes the device")
    return factory


def _called(
    role: Role, kind: str, factory: Callable[..., Any], options: Mapping[str, Any], clock: Clock
) -> Any:
    given = dict(options)
    try:
        signature = inspect.signature(factory)
        if "clock" in signature.parameters:
            given["clock"] = clock
        signature.bind(**given)
    except ValueError:  # of a compiled class that does not tell
        pass
    except TypeError as e:
        raise InputError(
            f"{role} {kind!r} cannot be opened with these options: {e}; it takes {signature}"
        ) from e
    try:
        return factory(**given)
    except PalpateError:
        raise
    except Exception as e:  # a driver is to raise DeviceError; this one is somebody else's
        raise InputError(
            f"{role} {kind!r} breaks the law 'opens, or raises DeviceError': {type(e).__name__}: {e}"
        ) from e


def _names(role: Role) -> str:
    return ", ".join(sorted({one.name for one in entry_points(group=GROUPS[role])}))
