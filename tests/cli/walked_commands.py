"""Walk over all commands of `palpate`, in a process of its own: ``python walked_commands.py OUT MISSING...``.

Extras named as MISSING are blocked as if they were not installed. Each command is called with `--help`,
without arguments, and with plausible ones; one JSON line a call goes to OUT. It needs no test dependency, so
it also runs in an environment that holds the wheel alone.
"""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from palpate.core.optional_imports import EXTRAS

VALUES: dict[object, str] = {int: "3", float: "1", str: "virtual:palm"}
TOO_LONG = {"demo", "record", "reproduce"}
"""Commands that compute for minutes; with plausible arguments they are tried elsewhere."""

GRBL = 'name = "a"\n[stage]\nkind = "grbl"\nport = "/dev/null"\n'
UR = """name = "a"
[stage]
kind = "ur-arm"
host = "127.0.0.1"
rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
zero_mm = [0, 0, 0]
tool_rotvec_rad = [0, 0, 0]
least_mm = [-1, -1, -1]
greatest_mm = [1, 1, 1]
"""
ARM = """name = "b"
[display]
kind = "virtual"
[arm]
kind = "force-dimension"
"""


class Blocked:
    """Finder that refuses modules as if they were not installed."""

    def __init__(self, names: set[str]) -> None:
        self.names = names

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        """Refuse a blocked module."""
        top = name.partition(".")[0]
        if top in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=top)


def commands(group: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """All commands and groups, by their words."""
    for name in group.commands:
        command = group.commands[name]
        yield (*words, name), command
        if hasattr(command, "commands"):
            yield from commands(command, (*words, name))
        for chosen, kind in getattr(command, "kinds", ()):
            yield (*words, name, *chosen.split()), kind


def plausible(words: tuple[str, ...], command: Any) -> list[str]:
    """Required arguments and options, with values of their kinds."""
    needed = [one for one in command.params if one.required]
    names = ([] if one.param_type_name == "argument" else [one.opts[0]] for one in needed)
    values = (VALUES.get(one.type_descriptor.annotation, "absent") for one in needed)
    return [word for name, value in zip(names, values, strict=True) for word in (*name, value)]


def special(folder: Path) -> list[list[str]]:
    """Calls that reach each optional package."""
    grbl, arm, bench = folder / "grbl.toml", folder / "ur.toml", folder / "bench.toml"
    table, frames = folder / "table.parquet", folder / "frames"
    grbl.write_text(GRBL)
    arm.write_text(UR)
    bench.write_text(ARM)
    frames.mkdir(exist_ok=True)
    table.write_bytes(b"PAR1aaaaPAR1")
    return [
        ["studio", "--workspace", str(folder / "absent")],
        ["rig", "status", str(grbl)],
        ["rig", "stop", str(grbl)],
        ["rig", "home", str(arm)],
        ["live", "picamera2", "--frames", "1"],
        ["live", "--camera", "picamera2"],
        ["collect", "--camera", "picamera2", "--scale", "/dev/null", "--out", str(folder / "c")],
        ["doctor"],
        ["doctor", "--json"],
        ["cameras"],
        ["calibrate", "absent", "--model", "cnn", "--targets", "x_mm", "--out", str(folder / "cal")],
        ["flow", "absent", "--json"],
    ]


def main(out: Path, missing: list[str], only: str = "") -> None:
    """Call all commands, or those of one first word, and write what came of it."""
    blocked = {module for module, (_, extra) in EXTRAS.items() if extra in missing}
    sys.meta_path.insert(0, Blocked(blocked))  # type: ignore[arg-type]
    from typer.main import get_command

    from palpate.cli.command_tree import app

    os.chdir(out.parent)
    root, runner = get_command(app), CliRunner()
    calls: list[list[str]] = special(out.parent)
    if not (set(EXTRAS) - blocked) & {"nicegui"}:
        calls += [["studio", "--workspace", "."], ["start", "--folder", "session"]]
    for words, command in commands(root):
        calls += [[*words, "--help"], list(words)]
        if (
            not hasattr(command, "commands")
            and not hasattr(command, "kinds")
            and not TOO_LONG & {words[0]}
            and " ".join(words) not in {"studio", "start", "live"}
        ):
            calls.append([*words, *plausible(words, command)])
    with out.open("w") as file:
        for call in calls:
            if " ".join(call) in TOO_LONG | {"studio", "start", "live", "collect", "doctor"}:
                continue
            if only and call[0] != only:
                continue
            done = runner.invoke(app, call, input="")
            error = None if isinstance(done.exception, SystemExit) else done.exception
            row = {
                "call": call,
                "status": done.exit_code,
                "error": repr(error) if error else "",
                "said": done.output[-400:],
            }
            file.write(json.dumps(row) + "\n")
            file.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute(), sys.argv[2:], os.environ.get("ONLY", ""))
