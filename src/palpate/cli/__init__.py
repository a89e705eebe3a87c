"""Command line. `palpate rig stop` and `palpate display stop` act before anything else loads."""

import sys

TYPE_CHECKING = False  # as in `typing`, which is not imported here: a stop would wait for it

if TYPE_CHECKING:
    from palpate.cli.command_tree import HEADINGS, Root, Verbs, app

__all__ = ["HEADINGS", "Root", "Verbs", "app", "main"]

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Return a name of the command tree, which loads typer."""
        if name not in __all__:
            raise AttributeError(f"palpate.cli has no {name!r}")
        from palpate.cli import command_tree

        return getattr(command_tree, name)


def main() -> None:
    """Entry point of the `palpate` command."""
    words = sys.argv[1:]
    if words == ["--version"]:
        from palpate.version import __version__

        print(f"palpate {__version__}")
        return
    from palpate.cli.stop_command import run_stop

    status = run_stop(words)
    if status is not None:
        sys.exit(status)
    from palpate.cli.failures import run_app

    run_app()
