"""Tree of commands; each is imported when it is first used."""

from __future__ import annotations

from collections import UserDict
from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.main import get_command

from palpate.cli.command_kinds import Kinds, alone, by_calibration, by_option, words_of
from palpate.cli.verb_support import OUTPUT_HELP, OUTPUT_OPTIONS, Group, take_output_options
from palpate.version import __version__

if TYPE_CHECKING:
    from palpate.core.plugins import PluginRegistry

__all__ = ["HEADINGS", "Root", "Verbs", "app", "start"]

CALIBRATE = Kinds(
    "Calibrate an estimator, or find one sensor's own constants.",
    {
        "image": "palpate.cli.calibrate.calibrate_verbs:calibrate",
        "palm-unit": "palpate.cli.sense.palm_verbs:fit",
        "palm-known": "palpate.cli.sense.palm_verbs:known",
        "tip-unit": "palpate.cli.sense.tip_verbs:calibrate",
        "tip-pose": "palpate.cli.sense.tip_verbs:fit",
        "shear-force": "palpate.cli.sense.shear_verbs:fit",
        "compliance": "palpate.cli.sense.compliance_verbs:calibrate",
    },
    by_option("--method", "image"),
    "--method KIND",
)
READ = Kinds(
    "Read frames by a calibration of any kind.",
    {
        "image": "palpate.cli.calibrate.calibrate_verbs:read",
        "palm-unit": "palpate.cli.sense.palm_verbs:read",
        "tip-unit": "palpate.cli.sense.tip_verbs:force",
        "tip-pose": "palpate.cli.sense.tip_verbs:read",
        "shear-force": "palpate.cli.sense.shear_verbs:shear",
        "compliance": "palpate.cli.sense.compliance_verbs:read",
    },
    by_calibration,
    "--kind KIND",
)
CHECK_WEIGHT = Kinds(
    "Check a calibration by a known weight.",
    {
        "palm-unit": "palpate.cli.sense.palm_verbs:weigh",
        "tip-unit": "palpate.cli.sense.tip_verbs:weigh",
        "shear-force": "palpate.cli.sense.shear_verbs:weigh",
    },
    by_calibration,
    "--kind KIND",
)
RENDER = words_of("Draw what a virtual sensor would see.", "study.render_verbs", "palm", "tactip")
LENS = words_of(
    "A camera's lens: its numbers, and images without its bending.",
    "calibrate.lens_verbs",
    "calibrate", "board", "show", "undistort",
)  # fmt: skip
EXPERIMENT = words_of(
    "Run an experiment on softness with people, and analyze it.",
    "display.trial_verbs",
    "new", "run", "analyze", "export",
)  # fmt: skip
COMPLIANCE = words_of(
    "Measure camera latency and stiffness; compare specimens.",
    "sense.compliance_verbs",
    "latency", "plate", "compare",
)  # fmt: skip
TRANSMIT = words_of(
    "Let a virtual finger feel what a TacTip has touched.", "display.transmit_verbs", "press", "study"
)
OPTICS = words_of(
    "Light, stress and what a material makes of them.",
    "sense.optics_verbs",
    "fringe-order", "colour-table", "fit-c",
)  # fmt: skip
IMPORT = words_of(
    "Bring a recording from elsewhere into a run.", "record.recording_verbs", "images", "palm", "press"
)
PAIRS = words_of(
    "Find objects that feel alike to the arm or to the skin.",
    "display.softness_verbs",
    "kinesthetic", "cutaneous", "compare", "specimens",
)  # fmt: skip
MECHANICS = words_of(
    "Compute force, depth, radius, and pressure by a contact law.",
    "study.mechanics_verbs",
    "hertz", "sphere", "punch", "cone", "layer",
)  # fmt: skip
HEADINGS: dict[str, dict[str, str | Kinds]] = {
    "Record": {
        "start": "record.start_verbs:start",
        "collect": "record.start_verbs:collect",
        "plan": "record.rig_verbs:plan_app",
        "record": "record.rig_verbs:record",
        "rig": "record.rig_verbs:rig_app",
        "studio": "study.study_verbs:studio",
        "import": IMPORT,
        "check": "record.recording_verbs:check",
        "export": "record.recording_verbs:export",
    },
    "Calibrate": {
        "calibrate": CALIBRATE,
        "evaluate": "calibrate.calibrate_verbs:evaluate",
        "report": "calibrate.calibrate_verbs:report",
        "compare": "calibrate.calibrate_verbs:compare",
        "adapt": "calibrate.calibrate_verbs:adapt",
        "lens": LENS,
        "check-weight": CHECK_WEIGHT,
    },
    "Sense": {
        "live": "sense.live_verbs:live",
        "cameras": "sense.preset_verbs:cameras",
        "doctor": "sense.preset_verbs:doctor",
        "sensors": "sense.preset_verbs:app",
        "read": READ,
        "compliance": COMPLIANCE,
        "flow": "sense.optics_verbs:flow",
    },
    "Display": {
        "pairs": PAIRS,
        "display": "display.softness_verbs:display_app",
        "experiment": EXPERIMENT,
        "transmit": TRANSMIT,
    },
    "Study": {"demo": "study.study_verbs:demo", "render": RENDER, "mechanics": MECHANICS, "optics": OPTICS},
}
"""Module and name of each verb or group of verbs, under the headings that `palpate --help` shows."""


ADDED = {"reproduce": ("palpate-reproductions", "Study", "Reproduce published studies on virtual sensors.")}
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
            if not isinstance(place, Kinds):
                module, _, member = place.partition(":")
                place = getattr(import_module(f"palpate.cli.{module}"), member)
            self.data[name] = built(name, heading, place)
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
    """Return the command of a function, of a group of them, or of one with several kinds."""
    if isinstance(verb, Kinds):
        command: Any = verb(name)
    else:
        command = get_command(verb) if isinstance(verb, typer.Typer) else alone(name, verb)
    command.name = name
    command.rich_help_panel = heading
    _show_output_options(command)
    return command


def _show_output_options(command: Any) -> None:
    """End the help of a command, and of each in a group, by the options that all take."""
    command.epilog = OUTPUT_HELP
    for one in getattr(command, "commands", {}).values():
        _show_output_options(one)


def help_of_added(name: str) -> tuple[str, str]:
    """Return heading and help of a command that is added, without importing it."""
    _, heading, sentence = ADDED.get(name, ("", "Added", "Command of an installed package."))
    return heading, sentence


class Root(Group):
    """The group of all verbs."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = Verbs()

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take the options that every command has from wherever they stand."""
        return super().parse_args(ctx, take_output_options(args))

    def list_commands(self, ctx: Any) -> list[str]:
        """Return all names; importing what they stand for is left to whoever needs it."""
        return list(self.commands)

    def get_command(self, ctx: Any, name: str) -> Any:
        """Return a command."""
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
    json_: Annotated[bool, typer.Option("--json", help=OUTPUT_OPTIONS["--json"])] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help=OUTPUT_OPTIONS["--quiet"])] = False,
) -> None:
    """Camera-based touch you can trust: record, calibrate, certify, sense."""
    if version:
        typer.echo(f"palpate {__version__}")
        raise typer.Exit
