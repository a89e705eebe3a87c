"""The process that holds a rig: ``python -m palpate.rig.service --rig virtual:palm --runs FOLDER``."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from pathlib import Path
from types import FrameType

from palpate.core import PalpateError
from palpate.core.failure_log import contained, thread_failures
from palpate.devices.long_running import keep_loaded
from palpate.devices.rpc import Address, hold, publish
from palpate.devices.supervisor.owning_process import raise_priority
from palpate.rig.mean_force import PUSH
from palpate.rig.rig_file import PositionFrom
from palpate.rig.service.rig_client import open_served_rig
from palpate.rig.service.rig_service import RigServer, RigService

LOOK_S = 0.2
SWITCH_S = 0.001  # between threads, so that an emergency stop does not wait for what others compute


def main() -> int:
    """Hold the rig until told to end; a recording that is under way is then aborted, and the probe lifted."""
    parser = argparse.ArgumentParser(description="Hold a rig, and record on it when asked to.")
    parser.add_argument("--rig", default="virtual:palm")
    parser.add_argument("--runs", type=Path, required=True, help="folder that recordings go into")
    parser.add_argument("--folder", type=Path, help="folder of the address file")
    parser.add_argument("--accelerated", action="store_true", help="a virtual rig as fast as it goes")
    parser.add_argument("--position", choices=("stored", "reference", "touch-off"), default="stored")
    options = parser.parse_args()
    ended = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        ended.set()

    sys.setswitchinterval(SWITCH_S)
    raise_priority()  # an emergency stop arrives here while other processes compute
    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with contained(f"the process of {options.rig}"):
        try:
            serve(options.rig, options.runs, options.folder, options.accelerated, ended, options.position)
        except PalpateError as e:
            print(f"palpate: {e}", file=sys.stderr)
            return 2
    return 0


def serve(
    rig: str,
    runs: Path,
    folder: Path | None,
    accelerated: bool,
    ended: threading.Event,
    position: PositionFrom = "stored",
) -> None:
    """Hold the rig until the event is set, or a client asks for the end."""
    with hold(rig, folder):
        if position == "touch-off":
            print(f"palpate: {PUSH}", file=sys.stderr, flush=True)
        service = RigService(open_served_rig(rig, accelerated=accelerated, position=position), runs)
        server = RigServer(service)
        keep_loaded()
        path = publish(Address(rig, server.port, server.token, os.getpid()), folder)
        try:
            with thread_failures(service.report):
                while not (ended.wait(LOOK_S) or server.ended.is_set()):
                    pass
        finally:
            path.unlink(missing_ok=True)
            service.close()  # clients may still watch, and stop it, while it ends
            server.close()


if __name__ == "__main__":
    sys.exit(main())
