"""Plug-ins: what a user wrote, named as ``package.module:Name`` or by an entry point of an installed package.

A registry holds the names that palpate brings along, as such texts too, so that nothing is imported before it
is asked for.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from palpate.core.errors import InputError, PluginError

PLUGIN = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")


@dataclass(frozen=True, slots=True)
class Registry:
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
