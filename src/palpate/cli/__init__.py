"""Verbs of the command line. Each says what it needs, calls one room, and prints what came back."""

from __future__ import annotations

import sys
from collections import UserDict
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.main import get_command

from palpate.cli.verb_support import Group
from palpate.version import __version__

__all__ = ["ALIASES", "HEADINGS", "Group", "Root", "Verbs", "app", "main", "start"]

HEADINGS: dict[str, dict[str, str]] = {
    "Record": {
        "start": "start_verbs:start",
        "collect": "start_verbs:collect",
        "plan": "rig_verbs:plan_app",
        "record": "rig_verbs:record",
        "rig": "rig_hand_verbs:rig_app",
        "studio": "study_verbs:studio",
        "import": "recording_verbs:import_app",
        "check": "recording_verbs:check",
        "repair": "recording_verbs:repair",
        "export": "recording_verbs:export",
    },
    "Calibrate": {
        "calibrate": "calibrate_verbs:calibrate",
        "evaluate": "calibrate_verbs:evaluate",
        "report": "calibrate_verbs:report",
        "compare": "calibrate_verbs:compare",
        "adapt": "calibrate_verbs:adapt",
        "quantise": "calibrate_verbs:quantise",
        "lens": "lens_verbs:app",
        "force": "shear_calibration_verbs:app",
    },
    "Sense": {
        "live": "live_verbs:live",
        "cameras": "machine_verbs:cameras",
        "doctor": "machine_verbs:doctor",
        "sensors": "preset_verbs:app",
        "sense": "calibrate_verbs:sense",
        "compliance": "compliance_verbs:app",
        "flow": "optics_verbs:flow",
        "palm": "palm_verbs:app",
        "tip": "tip_verbs:app",
        "shear": "shear_verbs:shear",
    },
    "Display": {
        "pairs": "softness_verbs:pairs_app",
        "display": "softness_verbs:display_app",
        "trial": "trial_verbs:trial_app",
        "transmit": "transmit_verbs:app",
    },
    "Study": {
        "demo": "study_verbs:demo",
        "render": "render_verbs:app",
        "reproduce": "study_verbs:app",
        "mechanics": "mechanics_verbs:app",
        "optics": "optics_verbs:app",
    },
}
"""Module and name of each verb or group of verbs, under the headings that `palpate --help` shows."""

ALIASES = {"quantize": "quantise"}


class Verbs(UserDict[str, Any]):
    """Commands by name, each imported and built when it is first asked for: one verb loads no other."""

    def __init__(self) -> None:
        super().__init__()
        for heading, verbs in HEADINGS.items():
            self.data |= {verb: (heading, place) for verb, place in verbs.items()}
        self.data |= {alias: self.data[verb] for alias, verb in ALIASES.items()}

    def __getitem__(self, name: str) -> Any:
        if isinstance(self.data[name], tuple):
            self.data[name] = self._built(name, *self.data[name])
        return self.data[name]

    def _built(self, name: str, heading: str, place: str) -> Any:
        module, _, member = place.partition(":")
        verb = getattr(import_module(f"palpate.cli.{module}"), member)
        if not isinstance(verb, typer.Typer):
            alone = typer.Typer(add_completion=False, rich_markup_mode=None)
            alone.command(name)(verb)
            verb = alone
        command: Any = get_command(verb)
        command.name, command.hidden = name, name in ALIASES
        command.rich_help_panel = heading
        return command


class Root(Group):
    """The group of all verbs."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = Verbs()


app = typer.Typer(
    name="palpate",
    cls=Root,
    help="Camera-based touch you can trust: record, calibrate, certify, sense.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback(invoke_without_command=True)
def start(
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    """Camera-based touch you can trust: record, calibrate, certify, sense."""
    if version:
        typer.echo(f"palpate {__version__}")
        raise typer.Exit


def main() -> None:
    """Entry point of the `palpate` command."""
    if sys.argv[1:] == ["--version"]:
        print(f"palpate {__version__}")  # before typer loads what checks options, which takes longer
        return
    app()
