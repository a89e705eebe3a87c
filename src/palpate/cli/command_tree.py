"""Tree of commands; each is imported when it is first used."""

from __future__ import annotations

from collections import UserDict
from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.main import get_command

from palpate.cli.verb_support import Group
from palpate.version import __version__

if TYPE_CHECKING:
    from palpate.core.plugins import PluginRegistry

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
        "mechanics": "study.mechanics_verbs:mechanics",
        "optics": "sense.optics_verbs:app",
    },
}
"""Module and name of each verb or group of verbs, under the headings that `palpate --help` shows."""


ADDED = {
    "reproduce": ("palpate-reproductions", "Study", "Reproduce published studies on virtual sensors."),
}
"""Distribution, heading and help of each command that another distribution of the repository adds."""


def added_commands() -> PluginRegistry:
    """Commands of installed distributions: what their entry points in ``palpate.commands`` name."""
    from palpate.core.plugins import PluginRegistry

    return PluginRegistry("command", "palpate.commands", {})


class Verbs(UserDict[str, Any]):
    """Commands by name, each imported and built when it is first asked for: one verb loads no other.

    Palpate's own come first, and none that is added takes the name of one.
    """

    def __init__(self) -> None:
        super().__init__()
        for heading, verbs in HEADINGS.items():
            self.data |= {verb: (heading, place) for verb, place in verbs.items()}

    def __contains__(self, name: object) -> bool:
        return name in self.data or name in added_commands().names()

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self.data, *added_commands().names())))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __getitem__(self, name: str) -> Any:
        if name not in self.data:
            self.data[name] = self._added(name)
        if isinstance(self.data[name], tuple):
            heading, place = self.data[name]
            module, _, member = place.partition(":")
            verb = getattr(import_module(f"palpate.cli.{module}"), member)
            self.data[name] = built(name, heading, verb)
        return self.data[name]

    def _added(self, name: str) -> Any:
        from palpate.core.plugins import ERROR, plugin_calls

        commands = added_commands()
        if name not in commands.names():
            raise KeyError(name)
        verb = commands.find(name)
        with plugin_calls(f"command {name!r} ({commands.path_of(name)}) cannot be built: {ERROR}"):
            return built(name, help_of_added(name)[0], verb)


def built(name: str, heading: str, verb: Any) -> Any:
    """Return the command of a function, or of a group of them."""
    if not isinstance(verb, typer.Typer):
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        alone.command(name)(verb)
        verb = alone
    command: Any = get_command(verb)
    command.name = name
    command.rich_help_panel = heading
    return command


def help_of_added(name: str) -> tuple[str, str]:
    """Return heading and help of a command that is added, without importing it."""
    _, heading, sentence = ADDED.get(name, ("", "Added", "Command of an installed package."))
    return heading, sentence


class Root(Group):
    """The group of all verbs."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = Verbs()

    def list_commands(self, ctx: Any) -> list[str]:
        """Return all names; importing what they stand for is left to whoever needs it."""
        return list(self.commands)

    def get_command(self, ctx: Any, name: str) -> Any:
        """Return a command.

        Raises:
            MissingExtraError: it belongs to a distribution that is not installed.
            PluginError: an installed distribution adds it, and it does not import or cannot be built.
        """
        try:
            command = super().get_command(ctx, name)
        except Exception:
            if ctx.resilient_parsing:  # a shell completes a word: what is broken is not offered
                return None
            raise
        if command is None and name in ADDED and not ctx.resilient_parsing:
            from palpate.core.errors import MissingExtraError

            raise MissingExtraError(
                f"`palpate {name}` belongs to the distribution {ADDED[name][0]}, which is not installed; "
                "install it from a checkout of palpate: pip install ./reproductions",
                code="missing-distribution",
            )
        return command

    def help_row(self, ctx: Any, name: str) -> tuple[str, str] | None:
        """Return the heading and the help of a command; one that is added is not imported for it."""
        own = any(name in verbs for verbs in HEADINGS.values())
        return super().help_row(ctx, name) if own else help_of_added(name)


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
