"""Things by name: those that palpate has, and those that other packages bring as entry points.

Built-in ones are found without a package's metadata, by a table of ``module:factory``. Nothing is imported
before it is asked for.

Plug-ins: what a user wrote, named as ``package.module:Name`` or by an entry point of an installed package.

A registry holds the names that palpate brings along, as such texts too, so that nothing is imported before it
is asked for.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from palpate.core.errors import InputError, PluginError

T = TypeVar("T")

OWN = "palpate"


@dataclass(frozen=True)
class Registry(Generic[T]):
    """Factories by name.

    A name may be followed by ``-PRESET``, which the factory is given: ``palm-small`` is ``palm`` with the
    preset ``small``. ``module:factory`` names one that nobody has registered.

    Attributes:
        kind: what they make, as a noun.
        group: of entry points.
        built_in: name -> ``module:factory``.
        faults: of what a factory made, the laws that it breaks, each a sentence; none where it is sound.
    """

    kind: str
    group: str
    built_in: Mapping[str, str]
    faults: Callable[[Any], list[str]]

    def names(self) -> tuple[str, ...]:
        """All of them, the built-in ones first."""
        others = sorted({one.name for one in self._entries()} - set(self.built_in))
        return (*self.built_in, *others)

    def make(self, text: str) -> T:
        """What a name stands for.

        Raises:
            InputError: there is none; it does not import; two packages have taken its name; or what it makes
                breaks a law. The message names it and the law.
        """
        name, preset = self._split(text)
        where = name if ":" in name else self._where(name)
        factory = self._imported(name, where)
        try:
            made = factory(preset) if preset else factory()
        except InputError:
            raise
        except Exception as e:  # whatever a stranger's factory raises is what is to be told
            raise InputError(f"{self.kind} {text!r} ({where}) cannot be made: {type(e).__name__}: {e}") from e
        faults = self.faults(made)
        if faults:
            raise InputError(f"{self.kind} {text!r} ({where}) breaks its contract: {'; '.join(faults)}")
        return made

    def _split(self, text: str) -> tuple[str, str]:
        """The longest name that the text begins with, and the preset after it."""
        names = self.names()
        if text in names or ":" in text:
            return text, ""
        for name in sorted(names, key=len, reverse=True):
            if text.startswith(f"{name}-") and len(text) > len(name) + 1:
                return name, text[len(name) + 1 :]
        raise InputError(f"there is no {self.kind} {text!r}; there are {', '.join(names)}")

    def _where(self, name: str) -> str:
        """``module:factory`` of a name, which only one package may have taken."""
        found = {one.value: _package(one) for one in self._entries() if one.name == name}
        if name in self.built_in:
            found[self.built_in[name]] = OWN
        if len(found) > 1:
            claims = ", ".join(f"{value} of {package}" for value, package in found.items())
            raise InputError(
                f"{self.kind} {name!r} is claimed by {claims}: a name stands for one {self.kind}; remove or "
                "rename all but one"
            )
        return next(iter(found))

    def _imported(self, name: str, where: str) -> Callable[..., T]:
        module, _, attribute = where.partition(":")
        try:
            found: Callable[..., T] = getattr(import_module(module), attribute)
        except Exception as e:  # an import runs a stranger's code
            raise InputError(
                f"{self.kind} {name!r} ({where}) does not import: {type(e).__name__}: {e}; repair or remove "
                "the package that brings it"
            ) from e
        if not callable(found):
            raise InputError(f"{self.kind} {name!r} ({where}) is no function or class that makes one")
        return found

    def _entries(self) -> tuple[EntryPoint, ...]:
        return _entries_of(self.group, tuple(sys.path))


@lru_cache(maxsize=16)
def _entries_of(group: str, path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Read once for a search path: to look through all that is installed takes tens of milliseconds."""
    return tuple(entry_points(group=group))


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else "an unknown package"


PLUGIN = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")


@dataclass(frozen=True, slots=True)
class PluginRegistry:
    """Everything of one kind that can be asked for by name.

    Attributes:
        kind: what it is, in words, such as ``model``.
        group: entry points of installed packages that add to it.
        built_in: name -> ``module:Name`` of what palpate brings along.
    """

    kind: str
    group: str
    built_in: Mapping[str, str]

    @property
    def added(self) -> dict[str, str]:
        """Name -> ``module:Name`` of what installed packages add.

        Raises:
            PluginError: a name is taken twice.
        """
        found: dict[str, str] = {}
        for point in entry_points(group=self.group):
            taken = self.built_in.get(point.name, found.get(point.name))
            if taken is not None and taken != point.value:
                raise PluginError(
                    f"{self.kind} {point.name!r} of {point.value} takes the name of {taken}; an added "
                    f"{self.kind} has a name of its own: rename it in its package's entry points"
                )
            found[point.name] = point.value
        return found

    def text(self, name: str) -> str:
        """Where a name's code is, as ``module:Name``; such a text stands for itself.

        Raises:
            InputError: nothing of the kind has this name; the message lists what there is.
            PluginError: an added one takes a name that exists.
        """
        if name in self.built_in:
            _ = self.added  # which refuses a package that takes the name
            return self.built_in[name]
        if PLUGIN.fullmatch(name):
            return name
        added = self.added
        if name not in added:
            known = ", ".join([*self.built_in, *added])
            raise InputError(f"there is no {self.kind} {name!r}; there are {known}, or give module:Name")
        return added[name]


def imported(text: str, kind: str) -> Any:
    """Import what ``module:Name`` names.

    Args:
        text: which; a name with dots goes into a class.
        kind: what it shall be, for the message.

    Raises:
        PluginError: it does not import, whatever its module raises, or has no such name.
    """
    module, _, names = text.partition(":")
    try:
        found: Any = import_module(module)
        for name in names.split("."):
            found = getattr(found, name)
    except Exception as e:  # a module of somebody else's may raise anything
        raise PluginError(
            f"{kind} {text} does not import ({type(e).__name__}: {e}); check its name, and that its folder "
            "is on PYTHONPATH or its package installed"
        ) from e
    return found


def named(found: Any, kind: str) -> str:
    """The ``module:Name`` by which a class or function can be imported again, as certificates tell it.

    Raises:
        PluginError: it cannot, as a lambda or what is defined inside a function.
    """
    text = f"{getattr(found, '__module__', '')}:{getattr(found, '__qualname__', '')}"
    if not PLUGIN.fullmatch(text) or imported(text, kind) is not found:
        raise PluginError(
            f"{kind} {text.partition(':')[2] or found!r} has no name that it can be imported by; define it "
            "at the top of a module, so that a certificate can say what it is"
        )
    return text
