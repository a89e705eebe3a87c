"""Commands whose arguments depend on a kind: `palpate calibrate --method palm`, `palpate import images`.

Each kind is a function with its own parameters, imported when it is chosen; its `--help` shows its own
options, and ends with the other kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand
from typer.main import get_command

from palpate.cli.verb_support import OUTPUT_HELP
from palpate.core.errors import InputError

__all__ = ["CommandOfKinds", "Kinds", "alone", "by_calibration", "by_option", "by_word", "words_of"]

Chosen = tuple[str, list[str]]


@dataclass(frozen=True)
class Kinds:
    """Description of a command of several kinds.

    Attributes:
        summary: one sentence for the list of commands.
        places: module and function of each kind, the default first.
        choose: gives the kind and the words of its own from the words of a command line; where no kind is
            named, the empty string and ``--help``.
        usage: how a kind is chosen, with ``KIND`` in place of its name.
    """

    summary: str
    places: Mapping[str, str]
    choose: Callable[[list[str]], Chosen]
    usage: str

    def __call__(self, name: str) -> CommandOfKinds:
        """Return the command under a name."""
        return CommandOfKinds(name, self)


def by_option(option: str, default: str) -> Callable[[list[str]], Chosen]:
    """Choose by the value of an option, which may stand anywhere."""

    def choose(words: list[str]) -> Chosen:
        given = word_after(option, words)
        if given is None:
            return default, words
        at = next(i for i, word in enumerate(words) if word.partition("=")[0] == option)
        return given, words[:at] + words[at + (1 if "=" in words[at] else 2) :]

    return choose


def by_word(words: list[str]) -> Chosen:
    """Choose by the first word; without one, the kinds are listed."""
    if words and not words[0].startswith("-"):
        return words[0], words[1:]
    return "", ["--help"]


def words_of(summary: str, module: str, *words: str) -> Kinds:
    """Describe a command whose first word names a function of a module of `palpate.cli`."""
    places = {word: f"palpate.cli.{module}:{word.replace('-', '_')}" for word in words}
    return Kinds(summary, places, by_word, "KIND")


HINTS = {"--force": "compliance", "--sensor": "shear-force", "--skin": "shear-force"}
"""Options that only one kind takes."""


def by_calibration(words: list[str]) -> Chosen:
    """Choose the kind by `HINTS`, or of the calibration after ``--with``."""
    kind, words = by_option("--kind", "")(words)
    if kind or not words:
        return kind, words if kind else ["--help"]
    for option, hinted in HINTS.items():
        if word_after(option, words) is not None:
            return hinted, words
    if given := word_after("--with", words):
        from palpate.estimators.session_folder import calibration_kind

        return calibration_kind(Path(given)), words
    if "--help" in words:
        return "", words
    raise InputError(
        "give the calibration: --with PATH. Without one, --force TABLE reads a press in relative numbers, "
        "and --sensor NAME reads a patterned skin",
        code="calibration-missing",
    )


def word_after(option: str, words: list[str]) -> str | None:
    """Value of an option among words, ``--option VALUE`` or ``--option=VALUE``; None without it."""
    for word, following in zip(words, [*words[1:], ""], strict=True):
        name, equals, value = word.partition("=")
        if name == option:
            return value if equals else following
    return None


class CommandOfKinds(TyperCommand):
    """A command that stands for the one of the kind that is chosen."""

    def __init__(self, name: str, kinds: Kinds) -> None:
        first = kinds.usage.replace("KIND", next(iter(kinds.places)))
        text = f"{kinds.summary}\n\nExample: palpate {name} {first} --help"
        super().__init__(name, callback=lambda: None, help=text, rich_markup_mode=None)
        self.choose, self.places, self.usage = kinds.choose, dict(kinds.places), kinds.usage
        self._built: dict[str, Any] = {}

    @property
    def kinds(self) -> Iterator[tuple[str, Any]]:
        """Words that choose each kind, and its command."""
        for kind in self.places:
            yield self.usage.replace("KIND", kind), self.of(kind)

    def of(self, kind: str) -> Any:
        """Return the command of a kind."""
        if kind not in self.places:
            known = ", ".join(self.places)
            raise InputError(f"palpate {self.name} has no {kind!r}; choose from {known}", code="unknown-kind")
        if kind not in self._built:
            module, _, function = self.places[kind].partition(":")
            command = alone(str(self.name), getattr(import_module(module), function))
            others = ", ".join(self.places)
            shown = f"palpate {self.name} {self.usage} --help shows the options of each: {others}."
            command.epilog = f"{shown} {OUTPUT_HELP}"
            self._built[kind] = command
        return self._built[kind]

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """List the kinds."""
        rows = [(words, command.get_short_help_str(limit=1000)) for words, command in self.kinds]
        with formatter.section("Kinds"):
            formatter.write_dl(rows)
        super().format_epilog(ctx, formatter)

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Choose the kind, and parse the other words as its own."""
        kind, words = self.choose(args)
        if not kind:
            return super().make_context(info_name, words, parent, **extra)
        command = self.of(kind)
        chosen = f"{info_name} {self.usage.replace('KIND', kind)}"
        return command.make_context(chosen, words, parent, **extra)


def alone(name: str, function: Callable[..., Any]) -> Any:
    """Return the command of one function."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name)(function)
    return get_command(app)
