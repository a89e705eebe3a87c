"""`palpate rig stop` and `palpate display stop`, which act before NumPy, typer, or a rig's file are loaded.

The stop goes to every process that holds the devices. If none confirms it, the stage's own port receives the
byte or line that stops its motion, and only then the drivers load, to confirm that the stage stands.
Everything that this module does not recognize, such as `--help`, is left to the command tree.
"""

from __future__ import annotations

import os
import sys

from palpate.stop_request import (
    NOT_CONFIRMED,
    STOPPED,
    Holder,
    failed_text,
    holders_of,
    how_stopped,
    stop_all,
)

VIRTUAL = "virtual:"
DEFAULT_BENCH = "virtual softness bench"
FIRST_BYTES = {"grbl": b"\x85", "marlin": b"M410\n"}  # what the drivers send first; the position is kept
NOTHING_RENDERS = "nothing-renders"


def run_stop(words: list[str]) -> int | None:
    """Carry out a stop, and return the exit status; None if the words are no complete stop command."""
    if words[:2] == ["rig", "stop"]:
        as_json, rest = _without_json(words[2:])
        if len(rest) == 1 and not rest[0].startswith("-"):
            return _stop_rig(rest[0], as_json)
    elif words[:2] == ["display", "stop"]:
        as_json, rest = _without_json(words[2:])
        if len(rest) == 1 and rest[0].startswith("--name="):
            rest = ["--name", rest[0].removeprefix("--name=")]
        if not rest or (len(rest) == 2 and rest[0] == "--name"):
            return stop_display(rest[1] if rest else DEFAULT_BENCH, as_json)
    return None


def _without_json(words: list[str]) -> tuple[bool, list[str]]:
    return "--json" in words, [word for word in words if word != "--json"]


def _stop_rig(rig: str, as_json: bool) -> int | None:
    virtual = rig.startswith(VIRTUAL)
    holders = holders_of(rig if virtual else os.path.realpath(rig))
    stop_all(holders)
    if how := how_stopped(holders):
        return _print(as_json, f"{rig}: {how}", {"rig": rig, "stopped": True, "how": how, **_facts(holders)})
    if not virtual:
        _stop_on_port(rig)
    return None  # the command tree loads the drivers, and confirms


def stop_display(name: str, as_json: bool) -> int:
    """Stop the rendering on a bench, and return the exit status."""
    holders = [one for one in holders_of(name) if one.is_supervisor]
    stop_all(holders)
    if any(one.code == STOPPED for one in holders):
        text = f"{name}: stopped; the chamber vents and the arm brakes{failed_text(holders)}"
        return _print(as_json, text, {"name": name, "stopped": True, **_facts(holders)})
    if failed := failed_text(holders):
        message = f"{name}: nothing was stopped{failed}. Take the finger away, and use the switch."
        return _print_error(as_json, NOT_CONFIRMED, message, holders)
    message = f"Nothing renders on a bench named {name!r}. Give the name in the bench's file with --name."
    return _print_error(as_json, NOTHING_RENDERS, message, holders)


def _facts(holders: list[Holder]) -> dict[str, object]:
    stopped = [one for one in holders if one.code == STOPPED]
    first = min(stopped, key=lambda one: one.stood_ns or 0)
    return {
        "code": STOPPED,
        "asked_ns": first.asked_ns,
        "stood_ns": first.stood_ns,
        "processes": [one.to_dict() for one in holders],
    }


def _print(as_json: bool, text: str, found: dict[str, object]) -> int:
    import json

    print(json.dumps(found, indent=1) if as_json else text, flush=True)
    return 0


def _print_error(as_json: bool, code: str, message: str, holders: list[Holder]) -> int:
    import json

    if as_json:
        error = {"code": code, "message": message}
        print(json.dumps({"error": error, "processes": [one.to_dict() for one in holders]}, indent=1))
    print(f"palpate: {message} [{code}]", file=sys.stderr, flush=True)
    return 2


def _stop_on_port(rig: str) -> None:
    """Write what stops a stage to its serial port, even if a process that hangs has it."""
    try:
        import tomllib

        with open(rig, "rb") as file:
            stage = tomllib.load(file)["stage"]
        first, port = FIRST_BYTES[str(stage["kind"])], str(stage["port"])
        _write_to_port(port, int(stage.get("baud", 115200)), first)
    except (ImportError, OSError, ValueError, KeyError, TypeError, RecursionError):
        pass  # a stage without a serial port, or a port named by its adapter's serial number


def _write_to_port(port: str, baud: int, data: bytes) -> None:
    """Write to a port; one that no other process has is set to its rate first."""
    import fcntl
    import termios

    handle = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # dropped when the port is closed
        except OSError:
            pass  # its holder has set the rate
        else:
            control = termios.CS8 | termios.CREAD | termios.CLOCAL
            rate = getattr(termios, f"B{baud}", termios.B115200)
            state = [0, 0, control, 0, rate, rate, termios.tcgetattr(handle)[6]]
            termios.tcsetattr(handle, termios.TCSANOW, state)
        os.write(handle, data)
    except termios.error as e:
        raise OSError(str(e)) from e
    finally:
        os.close(handle)
