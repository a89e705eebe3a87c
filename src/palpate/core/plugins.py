"""Things by name: those palpate brings along, those of installed packages, and a user's own `module:Name`.

Sensors, models, splits and devices are all found here. Nothing is imported before it is asked for; the names
of palpate's own need no package's metadata. A text `module:Name` stands for itself.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, distributions, entry_points
from inspect import signature
from typing import Any

from palpate.core.errors import InputError, MissingExtraError, PalpateError, PluginError

OWN = "palpate itself"
"""Path of a name that palpate knows without a module of its own for it."""

PATH = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")


@dataclass(frozen=True, slots=True)
class PluginRegistry:
    """Everything of one kind that can be asked for by name.

    Attributes:
        kind: what it is, as a noun, such as ``model``.
        group: entry points of installed packages that add to it.
        built_in: name -> ``module:Name`` of what palpate brings along, or `OWN`.
        faults: laws, each a sentence, that what `make` made breaks; none where it is sound.
    """

    kind: str
    group: str
    built_in: Mapping[Any, Any]  # of text to text; a check of its items would import what lists them
    faults: Callable[[Any], Sequence[str]] = lambda thing: ()

    def names(self) -> tuple[str, ...]:
        """All names that can be asked for, palpate's own first."""
        added = {point.name for point in installed(self.group) if ":" not in point.name}
        return (*self.built_in, *sorted(added - set(self.built_in)))

    def path_of(self, name: str) -> str:
        """Path of a name's code, as ``module:Name``."""
        if PATH.fullmatch(name):
            return name
        claims = {point.value for point in installed(self.group) if point.name == name}
        if wrong := sorted(value for value in claims if not PATH.fullmatch(value)):
            raise PluginError(
                f"{self.kind} {name!r} of an installed package stands for {wrong[0]!r}; an entry point must "
                "be module:Name"
            )
        own = self.built_in.get(name, "")
        paths = [own] * bool(own) + sorted(claims - {own})
        if not paths:
            names = ", ".join(self.names()) or "none"
            raise InputError(
                f"there is no {self.kind} {name!r}; there are {names}, or give module:Name",
                code="unknown-name",
            )
        if len(paths) > 1:
            raise PluginError(
                f"{self.kind} {name!r} of {paths[1]} takes the name of {paths[0]}; a name stands for one "
                f"{self.kind}: rename it in its package's entry points, or remove the package",
                code="name-taken",
            )
        return paths[0]

    def find(self, name: str) -> Any:
        """Import what a name stands for."""
        path = self.path_of(name)
        thing = import_path(path, self.kind, name)
        if not callable(thing):
            raise PluginError(
                f"{_label(self.kind, name, path)} is no class and no function; name what makes a {self.kind}",
                code="not-callable",
            )
        return thing

    def make(self, text: str) -> Any:
        """Call what a name stands for; of ``NAME-PRESET``, with the preset, if `takes_preset`."""
        name, preset = self._parts(text)
        factory, which = self.find(name), _label(self.kind, text, self.path_of(name))
        if preset and not takes_preset(factory):
            raise InputError(
                f"{which} cannot be made: {self.kind} {name!r} has no presets, as its factory has no first "
                f"parameter `preset`; give {name!r} alone",
                code="preset-unknown",
            )
        with plugin_calls(f"{which} cannot be made: {ERROR}"):
            thing = factory(preset) if preset else factory()
            faults = self.faults(thing)
        if faults:
            raise PluginError(f"{which} breaks its contract: {'; '.join(faults)}", code="contract-broken")
        return thing

    def _parts(self, text: str) -> tuple[str, str]:
        """The longest name that a text begins with, and the preset behind it."""
        if text in self.names() or ":" in text:
            return text, ""
        for name in sorted(self.names(), key=len, reverse=True):
            if text.startswith(f"{name}-") and len(text) > len(name) + 1:
                return name, text[len(name) + 1 :]
        return text, ""


def takes_preset(factory: Callable[..., Any]) -> bool:
    """Tell whether the first parameter of a function or class is called `preset`.

    By the name, since a word would else go into whatever stands first, as the first field of a dataclass.
    """
    try:
        return next(iter(signature(factory).parameters), "") == "preset"
    except ValueError:  # some that are built in tell no parameters
        return False


def installed(group: str) -> tuple[EntryPoint, ...]:
    """Entry points of a group, read again only when a folder of the search path has changed."""
    return _entry_points(group, tuple((folder, _changed_ns(folder)) for folder in sys.path))


@lru_cache(maxsize=32)
def _entry_points(group: str, folders: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    try:
        points = list(entry_points(group=group))  # reads the metadata of all packages: tens of milliseconds
    except Exception:  # one broken package, not necessarily a plug-in of palpate
        points = list(_readable_entry_points(group))
    # Once a process has imported the importlib_metadata package, packages list that package's own class.
    return tuple(EntryPoint(point.name, point.value, point.group) for point in points)


def _readable_entry_points(group: str) -> Iterator[EntryPoint]:
    """Entry points of the packages whose lists can be read; a warning names each of the others."""
    seen: set[str] = set()
    for package in distributions():
        try:
            name, points = re.sub(r"[-_.]+", "-", package.name).lower(), package.entry_points
        except Exception as e:
            folder = getattr(package, "_path", "a package without a folder")
            warnings.warn(f"{folder} is broken, and its entry points are left out ({told(e)})", stacklevel=2)
            continue
        yield from () if name in seen else points.select(group=group)
        seen.add(name)


def _changed_ns(folder: str) -> int:
    try:
        return os.stat(folder or ".").st_mtime_ns
    except OSError:
        return 0


ERROR = "{error}"
"""Place of the error in a message to `plugin_calls`."""


@contextmanager
def plugin_calls(
    message: str, passed: type[Exception] | tuple[type[Exception], ...] = PalpateError
) -> Iterator[None]:
    """Turn whatever a plug-in's code raises, sys.exit too, into an error that names it.

    Args:
        message: what was called, with `ERROR` where the error is told.
        passed: errors that go through as they are.
    """
    try:
        yield
    except passed:
        raise
    except (Exception, SystemExit) as e:  # what is somebody else's may raise anything
        raise PluginError(message.replace(ERROR, told(e), 1), code="plugin-import") from e


def told(error: BaseException) -> str:
    """An error's kind and text; of sys.exit, which has no text, also who called it."""
    text, trace = f"{type(error).__name__}: {error}", error.__traceback__
    while isinstance(error, SystemExit) and trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if not isinstance(error, SystemExit) or trace is None:
        return text
    frame = trace.tb_frame
    return f"{text}, from {frame.f_globals.get('__name__')}:{frame.f_code.co_qualname}"


def import_path(path: str, kind: str, name: str = "") -> Any:
    """Import what ``module:Name`` names.

    Args:
        path: which; a name with dots goes into a class.
        kind: what it shall be, for the message.
        name: the one that it was asked for by, if that is another.
    """
    module, _, attributes = path.partition(":")
    remedy = "check its name, and that its folder is on PYTHONPATH or its package installed"
    with plugin_calls(f"{_label(kind, name, path)} does not import: {ERROR}; {remedy}", MissingExtraError):
        thing: Any = import_module(module)
        for attribute in attributes.split("."):
            thing = getattr(thing, attribute)
    return thing


def _label(kind: str, name: str, path: str) -> str:
    return f"{kind} {path!r}" if name in ("", path) else f"{kind} {name!r} ({path})"


def import_path_of(thing: Any, kind: str) -> str:
    """The ``module:Name`` by which a class or function can be imported again, for a certificate to tell."""
    path = f"{getattr(thing, '__module__', '')}:{getattr(thing, '__qualname__', '')}"
    if not PATH.fullmatch(path) or import_path(path, kind) is not thing:
        raise PluginError(
            f"{kind} {path.partition(':')[2] or thing!r} has no name that it can be imported by; define it "
            "at the top of a module, so that a certificate can say what it is"
        )
    return path


def names_at_first_use(
    package: str, modules: Mapping[str, str], names: list[str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """A package's `__getattr__` and `__dir__` (PEP 562), by which its names load when they are first used.

    Args:
        package: its `__name__`.
        modules: by name, the module that has it, from the package on; from palpate on after a leading dot.
        names: its `__all__`.
    """

    def found(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"{package} has no {name!r}; it has {', '.join(names)}")
        module = modules[name]
        return getattr(import_module(f"palpate{module}" if module[0] == "." else f"{package}.{module}"), name)

    return found, lambda: names
