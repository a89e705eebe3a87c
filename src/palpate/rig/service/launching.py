"""Start a rig's process, apart from whoever starts it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from palpate.core.errors import DeviceError
from palpate.core.files import storage_errors
from palpate.rig.service.address import Address, find, path_of

STARTS_S = 120.0  # a virtual rig's first start compiles
LOOK_S = 0.05
TAIL = 400  # characters of what the process said


def launch(
    rig: str, runs: Path, *, accelerated: bool = False, folder: Path | None = None
) -> tuple[subprocess.Popen[bytes], Address]:
    """Start the process and wait until it can be reached. It outlives its starter, and its terminal.

    Args:
        rig: its name.
        runs: the folder that recordings go into.
        accelerated: let a virtual rig's time run as fast as the machine can.
        folder: of the address file, where it is not the user's own.

    Raises:
        DeviceError: it ended at once, or did not begin to listen; the message says what it said.
    """
    log = path_of(rig, folder, "log")
    words = [sys.executable, "-m", "palpate.rig.service", "--rig", rig, "--runs", str(runs.absolute())]
    words += ["--accelerated"] if accelerated else []
    words += ["--folder", str(folder)] if folder else []
    with storage_errors(log):
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    try:
        process = subprocess.Popen(  # noqa: S603 - our own module, by our own interpreter
            words, stdin=subprocess.DEVNULL, stdout=handle, stderr=handle, start_new_session=True
        )
    finally:
        os.close(handle)
    end_s = time.monotonic() + STARTS_S
    while time.monotonic() < end_s and process.poll() is None:
        address = find(rig, folder)
        if address is not None and address.pid == process.pid:
            return process, address
        time.sleep(LOOK_S)
    said = log.read_text(errors="replace").strip()[-TAIL:]
    if process.poll() is None:
        process.terminate()
    raise DeviceError(f"the process of the rig {rig} did not start: {said or 'it said nothing'}")
