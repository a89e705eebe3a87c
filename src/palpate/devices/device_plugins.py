"""Devices by name: a class of one's own as `package.module:Class`, or an entry point of an installed package.

A device that is opened this way goes through the structural part of the conformance checks before it is
used: what does not import, lacks a method, or hands out another shape or unit is closed, and refused by the
law that it breaks.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from palpate.core import Clock, InputError, PluginError
from palpate.core.plugins import ERROR, OWN, PluginRegistry, plugin_calls

if TYPE_CHECKING:
    from palpate.devices.check.interface_check import Role

GROUPS: dict[Role, str] = {
    "stage": "palpate.stages",
    "force": "palpate.force_sensors",
    "camera": "palpate.cameras",
    "display": "palpate.softness_displays",
    "arm": "palpate.haptic_arms",
}
"""Entry-point groups in which an installed package registers a device."""


def check_kind(role: Role, kind: str, built_in: Collection[str]) -> None:
    """Refuse a name that nothing has, or that two have; nothing is imported.

    Args:
        role: what the device is to be used as.
        kind: a name of palpate's own, "package.module:Class", or an entry point's name.
        built_in: palpate's own names.

    Raises:
        InputError: there is no such name.
        PluginError: an installed package takes one that exists already.
    """
    PluginRegistry(role, GROUPS[role], dict.fromkeys(sorted(built_in), OWN)).path_of(kind)


def open_device(role: Role, kind: str, options: Mapping[str, Any], clock: Clock) -> Any:
    """Open a device by the name of its class, and check its interface.

    Args:
        role: what it is to be used as.
        kind: "package.module:Class", a function that returns the device, or an entry point's name.
        options: passed to it by name; `clock` is passed as well where it takes one.
        clock: that it must stamp on.

    Raises:
        InputError: it does not take these options.
        PluginError: it does not import, or breaks a law of the interface, which the message names; it has
            been closed again.
        DeviceError: the device is missing, busy or refuses.

    Example:
        >>> from palpate.core import MonotonicClock
        >>> open_device("stage", "bench.axes:Gantry", {"port": "COM3"}, MonotonicClock())
        Traceback (most recent call last):
        ...
        palpate.core.errors.PluginError: stage 'bench.axes:Gantry' does not import: ModuleNotFoundError: ...
    """
    from palpate.devices.check.interface_check import check_interface  # a rig without plug-ins needs none

    factory = PluginRegistry(role, GROUPS[role], {}).find(kind)
    device = _call(role, kind, factory, options, clock)
    fault = next((law for law in check_interface(role, device, clock) if not law.ok), None)
    if fault is not None:
        with suppress(Exception, SystemExit):  # what lacks a method may well fail to close
            device.close()
        raise PluginError(
            f"{role} {kind!r} breaks the law {fault.code!r}: {fault.message}", code="protocol-broken"
        )
    return device


def _call(
    role: Role, kind: str, factory: Callable[..., Any], options: Mapping[str, Any], clock: Clock
) -> Any:
    arguments = dict(options)
    try:
        signature = inspect.signature(factory)
        if "clock" in signature.parameters:
            arguments["clock"] = clock
        signature.bind(**arguments)
    except ValueError:  # of a compiled class that does not tell
        pass
    except TypeError as e:
        raise InputError(
            f"{role} {kind!r} cannot be opened with these options: {e}; it takes {signature}",
            code="device-options",
        ) from e
    with plugin_calls(f"{role} {kind!r} breaks the law 'opens, or raises DeviceError': {ERROR}"):
        return factory(**arguments)
