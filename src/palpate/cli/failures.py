"""Top level of the command line: no exception reaches a user as a traceback."""

from __future__ import annotations

import json
import sys
from contextlib import suppress

INTERRUPTED_STATUS = 130


def run_app() -> None:
    """Run the command tree; an exception that nothing handled ends in one line, a code, and a log."""
    try:
        from palpate.cli.command_tree import app

        app()
    except KeyboardInterrupt:
        # While modules load; a command that has begun reports Ctrl-C itself.
        with suppress(OSError, KeyboardInterrupt):
            print("palpate: interrupted", file=sys.stderr)
        raise SystemExit(INTERRUPTED_STATUS) from None
    except Exception as e:
        raise SystemExit(_report(e, sys.argv[1:])) from None


def _report(error: Exception, words: list[str]) -> int:
    from palpate.core.failure_log import INTERNAL_STATUS, record_failure, report_to_stderr

    command = " ".join(["palpate", *words[:2]])
    failure = record_failure(error, f"`{command}`")
    report_to_stderr(failure)
    if "--json" in words:
        with suppress(OSError):
            print(json.dumps({"error": failure.to_dict()}), flush=True)
    return INTERNAL_STATUS
