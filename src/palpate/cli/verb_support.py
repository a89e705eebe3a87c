"""Groups of verbs, which report errors as one line; options, progress and readers of words they share."""

from __future__ import annotations

import errno
import json
import math
import os
import shlex
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperGroup

if TYPE_CHECKING:
    from palpate.core import MeasurementResult, Readings
    from palpate.core.provenance import Provenance

OUTPUT_OPTIONS = {"--json": "Print JSON instead of text.", "--quiet": "Show no progress bar."}
"""Options of every command, which may stand anywhere before ``--``."""
OUTPUT_HELP = "Every command takes --json (print JSON) and --quiet (no progress bar)."
_output_given: set[str] = set()
NewRun = Annotated[Path, Argument(help="Run to make; must not exist.")]
NewCalibration = Annotated[Path, Option(help="Calibration folder to make; must not exist.")]
ProvenanceName = Annotated[
    str | None, Option("--provenance", help="measured (default), simulated, or derived from other data.")
]
ForceTable = Annotated[Path, Option(help="CSV or Parquet: samples of force and the frame each is of.")]
ForceColumn = Annotated[str | None, Option(help="Its column of force, if not a usual name.")]
PositionColumn = Annotated[str | None, Option(help="Its column of position, if not a usual name.")]
ForceRate = Annotated[float | None, Option(help="Rate of its rows [Hz], if it has no time_s.")]


INTERRUPTED = "stopped; nothing half-written is left; the same command goes on where it can"
INTERRUPTED_STAGE = (
    "interrupted: what moved was stopped, and the probe is not lifted but stays where it is, perhaps in "
    "contact. Look whether the stage stands; `palpate rig stop` stops it, `palpate rig status` says where it "
    "is, and after a homing that was interrupted its place is not to be believed until it is homed"
)
ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
PIPE_CLOSED = 141  # as a shell tells of a program that SIGPIPE has ended
ONCE_S = 2.0  # after a signal, in which another must not cut short the stop that the first began
MOVING = ("home", "jog", "zero", "check", "setup")
"""Verbs of the group `rig` that move a stage."""


def take_output_options(words: list[str]) -> list[str]:
    """Remember which of `OUTPUT_OPTIONS` the words of a command line hold, and return the others."""
    end = words.index("--") if "--" in words else len(words)
    _output_given.clear()
    _output_given.update(set(words[:end]) & set(OUTPUT_OPTIONS))
    return [word for word in words[:end] if word not in OUTPUT_OPTIONS] + words[end:]


def as_json() -> bool:
    """Whether the command prints JSON instead of text."""
    return "--json" in _output_given


def is_quiet() -> bool:
    """Whether the command shows no progress."""
    return "--quiet" in _output_given


def say(text: str, err: bool = False, nl: bool = True) -> None:
    """Print to stdout or stderr; where that takes nothing more, end by one line, on the other if it can.

    Where whoever read it has gone, as ``head -1`` does, nothing is said, and the status is that of a program
    which the closed pipe ends.
    """
    try:
        typer.echo(text, err=err, nl=nl)
    except OSError as e:
        with suppress(OSError, ValueError):  # what is left in the buffer would be written again at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), (sys.stderr if err else sys.stdout).fileno())
        if e.errno == errno.EPIPE:
            raise typer.Exit(PIPE_CLOSED) from e
        said = f"palpate: nothing more can be printed: {e.strerror or e}; what is on disk is kept"
        with suppress(OSError):
            typer.echo(said, err=True)
        raise typer.Exit(2) from e


class Group(TyperGroup):
    """Commands under their headings, each with the whole first sentence of its help."""

    def invoke(self, ctx: Any) -> Any:
        """Run a verb; an expected error is printed as one line and ends with status 2, Ctrl-C with 130."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as e:
            moved = ctx.info_name == "rig" and ctx.invoked_subcommand in MOVING
            say(f"palpate: {INTERRUPTED_STAGE if moved else INTERRUPTED}", err=True)
            raise typer.Exit(130) from e
        except SystemExit as e:  # a verb ends by typer.Exit: this is of a plug-in, and may claim success
            from palpate.core.plugins import told

            say(f"palpate: a plug-in ended it: {told(e)}", err=True)
            raise typer.Exit(2) from e
        except Exception as e:
            core = sys.modules.get("palpate.core")  # not imported: it loads NumPy, which no help needs
            if core is None or not isinstance(e, core.PalpateError):
                raise
            message = " ".join(str(e).split())
            say(f"palpate: {message}", err=True)
            if as_json():
                say(json.dumps({"error": {"code": e.code, "message": message, "log": None}}))
            raise typer.Exit(2) from e

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section a heading; the names of all sections are as wide, so that sentences align."""
        rows = {name: row for name in self.list_commands(ctx) if (row := self.help_row(ctx, name))}
        width = max(map(len, rows))
        sections: dict[str, list[tuple[str, str]]] = {}
        for name, (heading, sentence) in rows.items():
            sections.setdefault(heading, []).append((name.ljust(width), sentence))
        for heading, shown in sections.items():
            with formatter.section(heading):
                formatter.write_dl(shown)

    def help_row(self, ctx: Any, name: str) -> tuple[str, str] | None:
        """Return the heading and the first sentence of a command's help; None for a hidden command."""
        command = self.get_command(ctx, name)
        if command is None or command.hidden:
            return None
        heading = getattr(command, "rich_help_panel", None) or "Commands"
        return heading, command.get_short_help_str(limit=1000)


@contextmanager
def signals_held() -> Iterator[None]:
    """Hold back what ends the process while files are made, so that none is left half made."""
    held: list[int] = []
    before = {number: signal.signal(number, lambda number, frame: held.append(number)) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in held:
            signal.raise_signal(number)


@contextmanager
def stopped_by_signals(numbers: tuple[signal.Signals, ...] = ENDING) -> Iterator[None]:
    """End by Ctrl-C's own way also where the process is told to end, or its terminal is closed.

    What is recorded is closed whole then, and a stage stopped. Who has the end of the terminal ignored, as by
    nohup, goes on.

    Args:
        numbers: of the signals that end it so.
    """
    asked_s = -math.inf

    def interrupt(number: int, frame: object) -> None:
        nonlocal asked_s
        before_s, asked_s = asked_s, time.monotonic()
        if asked_s - before_s > ONCE_S:
            raise KeyboardInterrupt

    before = {
        number: signal.signal(number, interrupt)
        for number in numbers
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def group(help_text: str) -> typer.Typer:
    """Make a group of verbs; one of a single verb is a group as well."""
    app = typer.Typer(
        cls=Group, add_completion=False, help=help_text, no_args_is_help=True, rich_markup_mode=None
    )
    app.callback()(lambda: None)
    return app


def phases() -> Callable[[str, int, int], None]:
    """A line on stderr for each phase as it begins, for a log or a pipe, where no bar can be drawn."""
    last = ""

    def show(what: str, done: int, total: int) -> None:
        nonlocal last
        phase = ": ".join(what.split(": ")[:2])
        if phase != last and not is_quiet():
            print(phase, file=sys.stderr, flush=True)
        last = phase

    return show


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int], None]]:
    """A bar on stderr, where somebody is looking; what is being done, how far, how long it may take."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(
        *columns, console=console, disable=is_quiet() or not console.is_terminal, transient=True
    ) as bar:
        tasks: dict[str, Any] = {}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                for task in tasks.values():
                    bar.update(task, visible=False)
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total, visible=True)

        yield show


def names_of(text: str) -> tuple[str, ...]:
    """Names from a comma-separated list."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def given_provenance(text: str | None) -> Provenance | None:
    """Provenance that a command's option names; None where it is left out."""
    from palpate.core.provenance import provenance_of

    return None if text is None else provenance_of(text)


def numbers_of(text: str | None, count: int, what: str) -> tuple[int, ...] | None:
    """Whole numbers from ``1,2,3`` or ``96x160``."""
    from palpate.core.errors import InputError

    if text is None:
        return None
    try:
        numbers = tuple(int(part) for part in text.replace("x", ",").split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        example = "x".join(["640", "480", "320", "240"][:count])
        raise InputError(
            f"{what} {text!r} is not {count} whole numbers, as in {example} or {example.replace('x', ',')}"
        )
    return numbers


def floats_of(
    text: str, what: str, example: str, mark: str = ",", count: int | None = None
) -> tuple[float, ...]:
    """Numbers with a mark between them.

    Args:
        count: how many; 0 for any number; by default as many as in the example.
    """
    from palpate.core.errors import InputError

    count = len(example.split(mark)) if count is None else count
    try:
        numbers = tuple(float(part) for part in text.split(mark))
    except ValueError:
        numbers = ()
    if not numbers or (count and len(numbers) != count):
        raise InputError(f"{what} {text!r} are no numbers as in {example}")
    return numbers


def pairs_of(words: list[str], what: str) -> dict[str, str]:
    """Names and what each becomes, from ``name=value``."""
    from palpate.core.errors import InputError

    pairs: dict[str, str] = {}
    for word in words:
        name, equals, value = word.rpartition("=")
        if not equals or not name or not value:
            raise InputError(
                f"{what} {word!r} is not NAME=VALUE, as in --rename Fz=force_N or --unit depth=mm"
            )
        if name in pairs:
            raise InputError(f"{what} names {name!r} twice; say it once")
        pairs[name] = value
    return pairs


def typed_again(verb: str, arguments: list[Any], options: dict[str, Any]) -> str:
    """A command line as it is typed: options that were not given are left out, a flag stands alone."""
    words = ["palpate", *verb.split(), *map(str, arguments)]
    for option, value in options.items():
        if value is True:
            words.append(option)
        elif value not in (None, False, "", []):
            each = value if isinstance(value, list) else [value]
            words += [word for one in each for word in (option, str(one))]
    return shlex.join(words)


def options_of(pairs: list[str]) -> dict[str, Any]:
    """Model options from ``name=value``, the values read as JSON where they are."""
    from palpate.core.errors import InputError

    options: dict[str, Any] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals:
            raise InputError(f"option {pair!r} is not NAME=VALUE, as in epochs=30")
        try:
            content = json.loads(value)
        except json.JSONDecodeError:
            content = value
        options[name] = tuple(content) if isinstance(content, list) else content
    return options


def periods_of(text: str) -> dict[str, float | None]:
    """Circular targets from ``angle_deg,edge_deg=180``, each with its period where one is given."""
    from palpate.core.errors import InputError

    periods: dict[str, float | None] = {}
    for part in names_of(text):
        name, equals, period = (piece.strip() for piece in part.partition("="))
        if name in periods:
            raise InputError(
                f"--circular names {name!r} twice; a target comes round after one period: name it once, "
                "as in edge_deg=180"
            )
        try:
            periods[name] = float(period) if equals else None
        except ValueError as e:
            raise InputError(f"--circular {part!r} is not COLUMN or COLUMN=PERIOD, as in edge_deg=180") from e
    return periods


def classes_of(text: str) -> dict[str, tuple[str, ...]]:
    """Columns of classes from ``touched,grade=soft/medium/hard``, each with its names where given."""
    from palpate.core.errors import InputError

    classes: dict[str, tuple[str, ...]] = {}
    for part in names_of(text):
        column, equals, names = (piece.strip() for piece in part.partition("="))
        if not column or column in classes or (equals and not names):
            raise InputError(
                f"--classes {part!r} is not COLUMN or COLUMN=NAME/NAME, each column once, as in "
                "touched,grade=soft/medium/hard"
            )
        classes[column] = tuple(name.strip() for name in names.split("/")) if equals else ()
    return classes


def vectors_of(pairs: list[str]) -> dict[str, tuple[str, ...]]:
    """Vectors from ``force=force_x_N,force_y_N``."""
    from palpate.core.errors import InputError

    vectors: dict[str, tuple[str, ...]] = {}
    for pair in pairs:
        name, equals, parts = (piece.strip() for piece in pair.partition("="))
        if not equals or not name:
            raise InputError(f"--vector {pair!r} is not NAME=COLUMN,COLUMN, as in force=force_x_N,force_y_N")
        if name in vectors:
            raise InputError(f"--vector is given twice for {name!r}; give each vector a name of its own")
        vectors[name] = names_of(parts)
    return vectors


def print_found(result: Any, text: str) -> None:
    """Print what was found, as text or as JSON."""
    say(json.dumps(result, indent=1, allow_nan=False) if as_json() else text)


def print_record(record: Mapping[str, Any]) -> None:
    """Print a record: as JSON, or as lines."""
    print_found(record, record_text(record))


def record_text(record: Mapping[str, Any], indent: str = "") -> str:
    """A record as lines, one a value, with a part below its name; rows of equal fields are a table.

    Example:
        >>> print(record_text({"force_N": 0.98066, "terms": {"lamp": 1.0}, "untold": []}))
        force [N]: 0.98066
        terms:
          lamp: 1
        untold: none
        >>> print(record_text({"terms": {"lamp": {"value": 0.1, "sd": 0.02}}}))
        terms  value  sd
        lamp   0.1    0.02
    """
    lines = []
    for name, value in record.items():
        label, rows = _label(name), _rows_of(value)
        if not rows:
            lines.append(f"{indent}{label}: {in_line(value)}")
        elif (columns := _columns_of(rows)) is None:
            lines += [f"{indent}{label}:", record_text(rows, f"{indent}  ")]
        else:
            cells = [[label, *map(_label, columns)]]
            cells += [[row, *(in_line(one[key]) for key in columns)] for row, one in rows.items()]
            wide = [max(map(len, column)) for column in zip(*cells, strict=True)]
            lines += [
                indent + "  ".join(f"{cell:{w}}" for cell, w in zip(row, wide, strict=True)).rstrip()
                for row in cells
            ]
    return "\n".join(lines)


def _rows_of(value: Any) -> dict[str, Any]:
    """Records or fields within a value, by name or number; none of a plain value."""
    if isinstance(value, Mapping):
        return dict(value)
    holds = isinstance(value, list) and bool(value) and all(isinstance(one, Mapping) for one in value)
    return {str(i): one for i, one in enumerate(value, 1)} if holds else {}


def _columns_of(rows: Mapping[str, Any]) -> list[str] | None:
    """Fields that all rows share; None where they differ, or hold more than a plain value."""
    fields = [list(row) if isinstance(row, Mapping) else [] for row in rows.values()]
    nested = any(_rows_of(one) for row in rows.values() if isinstance(row, Mapping) for one in row.values())
    return fields[0] if fields[0] and not nested and all(one == fields[0] for one in fields) else None


def _label(name: str) -> str:
    from palpate.core.units import has_unit, split_column

    if not has_unit(name):
        return name.replace("_", " ")
    quantity, unit = split_column(name)
    symbol = "" if unit.symbol == "ratio" else f" [{unit.symbol.replace('_per_', '/')}]"
    return f"{quantity.replace('_', ' ')}{symbol}"


def in_line(value: object) -> str:
    """A value on one line."""
    match value:
        case Mapping():
            return ", ".join(f"{_label(name)} {in_line(one)}" for name, one in value.items()) or "none"
        case list() | tuple():
            return ", ".join(map(in_line, value)) or "none"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.5g}"
    return "none" if value in (None, "") else str(value)


BENCH_UNITS = {"m": "mm", "rad": "deg"}  # other units stay as the calibration has them


def reading_words(readings: Readings) -> list[str]:
    """Parts of a line: readings that have a value, and then those that have none, each reason once.

    Example:
        "x -11.541 mm ± 0.013 mm, inside the calibrated range", "y, rotation –: no contact"
    """
    told: list[str] = []
    without: dict[str, list[str]] = {}
    for one in readings.values():
        if _has_value(one):
            told.append(_in_bench_units(one))
        else:
            without.setdefault(one.verdict, []).append(one.quantity)
    return told + [f"{', '.join(names)} –: {why}" for why, names in without.items()]


def _has_value(reading: MeasurementResult) -> bool:
    value = getattr(reading, "value", "")
    return not math.isnan(value) if isinstance(value, float) else not isinstance(value, str) or bool(value)


def _in_bench_units(reading: MeasurementResult) -> str:
    shown = reading.in_unit(BENCH_UNITS[reading.unit]) if reading.unit in BENCH_UNITS else reading
    return str(shown).replace(" ratio", "")
