"""Devices by name: a class of one's own as `package.module:Class`, or an entry point of an installed package.

A device that is opened this way goes through the structural part of the conformance checks before it is
used: what does not import, lacks a method, or hands out another shape or unit is closed, and refused by the
law that it breaks.

Files that name devices: how they are read, and fields that their tables share.

Millimetres stand in a file, since people write it, and metres behind it.
"""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from palpate.core import Clock, InputError, PluginError, Position, storage_errors
from palpate.core.parsing import parser
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


MM = 1e-3
Three = tuple[float, float, float]


MAX_HOST = 253  # characters of a name, by RFC 1035
_HOST = re.compile(rf"[A-Za-z0-9._:-]{{1,{MAX_HOST}}}")


def _names_a_host(host: str) -> str:
    if not _HOST.fullmatch(host):
        raise ValueError(
            f"{host[:40]!r} is no host: give its number or name, of 1 to {MAX_HOST} letters, digits, "
            "'.', '-', '_' and ':', as in 192.168.1.1"
        )
    return host


Host = Annotated[str, AfterValidator(_names_a_host)]
"""Name or number of a device in the network."""


MAX_BYTES = 1 << 20
Of = TypeVar("Of", bound=BaseModel)


class Part(BaseModel):
    """A table of a file: nothing in it changes, and no field is unknown."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def check_below(ceilings: dict[str, float], part: BaseModel) -> None:
    """Refuse a field above its ceiling, with both numbers; fields that were left out are not compared."""
    for name, ceiling in ceilings.items():
        value = getattr(part, name, None)
        if value is not None and value > ceiling:
            raise ValueError(
                f"{name} is {value:g}, and {ceiling:g} is the greatest allowed; give {ceiling:g} "
                f"{_unit(name)} or less"
            )


def _unit(name: str) -> str:
    """Unit of a field, from the end of its name: "mm" of ``step_mm``, "N/s" of ``force_rate_N_s``."""
    for ending in ("N_s", "mm_s"):
        if name.endswith(f"_{ending}"):
            return ending.replace("_", "/")
    return name.rpartition("_")[2]


def check_above(floors: dict[str, float], part: BaseModel) -> None:
    """Refuse a field below its floor, with both numbers; fields that were left out are not compared."""
    for name, floor in floors.items():
        value = getattr(part, name, None)
        if value is not None and value < floor:
            raise ValueError(
                f"{name} is {value:g}, and {floor:g} is the least allowed; give {floor:g} "
                f"{_unit(name)} or more"
            )


def metres(mm: Three) -> Position:
    """Metres of three millimetres."""
    x, y, z = (MM * value for value in mm)
    return x, y, z


@parser("TOML file", InputError, max_bytes=MAX_BYTES)
def read_toml(path: Path) -> dict[str, Any]:
    """The fields of a file that people write; of its first MiB.

    Raises:
        InputError: it is not TOML.
        StorageError: it cannot be read.
    """
    with storage_errors(path):
        data = path.read_bytes()[:MAX_BYTES]
    try:
        return tomllib.loads(data.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as e:
        raise InputError(f"{path} is not TOML: {e}", code="toml") from e


def validated(model: type[Of], path: Path, fields: dict[str, Any]) -> Of:
    """What the fields of a file say.

    Raises:
        InputError: a field that is not one, or out of range; each is named.
    """
    try:
        return model.model_validate(fields)
    except ValidationError as e:
        problems = "; ".join(f"{_field(d['loc'])}: {d['msg']}" for d in e.errors())
        raise InputError(f"{path}: {problems}", code="file-field") from e


def _field(location: tuple[str | int, ...]) -> str:
    """The field's name in the file, without the tags of its kinds."""
    return ".".join(str(part) for part in location if not str(part).startswith("#"))
