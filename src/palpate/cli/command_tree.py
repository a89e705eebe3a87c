"""Tree of commands; each is imported when it is first used."""

from __future__ import annotations

from collections import UserDict
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.main import get_command

from palpate.cli.verb_support import Group
from palpate.version import __version__

__all__ = ["HEADINGS", "Root", "Verbs", "app", "start"]

HEADINGS: dict[str, dict[str, str]] = {
    "Record": {
        "start": "record.start_verbs:start",
        "collect": "record.start_verbs:collect",
        "plan": "record.rig_verbs:plan_app",
        "record": "record.rig_verbs:record",
        "rig": "record.rig_hand_verbs:rig_app",
        "studio": "study.study_verbs:studio",
        "import": "record.recording_verbs:import_run",
        "check": "record.recording_verbs:check",
        "repair": "record.recording_verbs:repair",
        "export": "record.recording_verbs:export",
    },
    "Calibrate": {
        "calibrate": "calibrate.calibrate_verbs:calibrate",
        "evaluate": "calibrate.calibrate_verbs:evaluate",
        "report": "calibrate.calibrate_verbs:report",
        "compare": "calibrate.calibrate_verbs:compare",
        "adapt": "calibrate.calibrate_verbs:adapt",
        "lens": "calibrate.lens_verbs:app",
        "force": "calibrate.shear_calibration_verbs:app",
    },
    "Sense": {
        "live": "sense.live_verbs:live",
        "cameras": "sense.machine_verbs:cameras",
        "doctor": "sense.machine_verbs:doctor",
        "sensors": "sense.preset_verbs:app",
        "sense": "calibrate.calibrate_verbs:sense",
        "compliance": "sense.compliance_verbs:app",
        "flow": "sense.optics_verbs:flow",
        "palm": "sense.palm_verbs:app",
        "tip": "sense.tip_verbs:app",
        "shear": "sense.shear_verbs:shear",
    },
    "Display": {
        "pairs": "display.softness_verbs:pairs",
        "display": "display.softness_verbs:display_app",
        "trial": "display.trial_verbs:trial_app",
        "transmit": "display.transmit_verbs:app",
    },
    "Study": {
        "demo": "study.study_verbs:demo",
        "render": "study.render_verbs:app",
        "reproduce": "study.study_verbs:app",
        "mechanics": "study.mechanics_verbs:mechanics",
        "optics": "sense.optics_verbs:app",
    },
}
"""Module and name of each verb or group of verbs, under the headings that `palpate --help` shows."""


class Verbs(UserDict[str, Any]):
    """Commands by name, each imported and built when it is first asked for: one verb loads no other."""

    def __init__(self) -> None:
        super().__init__()
        for heading, verbs in HEADINGS.items():
            self.data |= {verb: (heading, place) for verb, place in verbs.items()}

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
        command.name = name
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
