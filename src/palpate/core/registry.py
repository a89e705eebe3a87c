"""Things by name: those that palpate has, and those that other packages bring as entry points.

Built-in ones are found without a package's metadata, by a table of ``module:factory``. Nothing is imported
before it is asked for.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from palpate.core.errors import InputError

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
