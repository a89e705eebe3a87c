"""Client of a live sensor's process, and the start of that process."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.devices.rpc import Address
from palpate.devices.rpc_client import RpcClient, launch_process

if TYPE_CHECKING:
    from palpate.sensing.live_service import LiveOptions

ONE_THREAD = {"OMP_NUM_THREADS": "1"}
"""Environment of a process that reads live. A frame's matrices are small: with a thread for each core, those
of several sensors wait for each other by spinning."""


class LiveClient(RpcClient):
    """Client of one live sensor process; reconnects whenever the process is gone.

    `status` and `picture` hold the newest values, updated at least ten times a second.

    Example:
        >>> with LiveClient("live palm") as sensor:  # doctest: +SKIP
        ...     sensor.wait_for(lambda status: status["state"] == "live", 10.0)["rate_hz"]
        30.0
    """

    def zero(self) -> None:
        """Take the next frames, on which nothing may press, as those of the untouched sensor."""
        self.ask("zero")

    def use(self, calibration: str) -> dict[str, Any]:
        """Read by another calibration's folder; "" by none."""
        return self.ask("calibration", path=calibration)

    def record(self, run: str) -> dict[str, Any]:
        """Record frames and forces into a new run of this name."""
        return self.ask("record", run=run)

    def record_stop(self) -> dict[str, Any]:
        """End the recording; the run is whole then."""
        return self.ask("record_stop")

    def collect(self, run: str, **options: Any) -> dict[str, Any]:
        """Collect labelled presses into a run of this name; see `LiveService.collect` for the options."""
        return self.ask("collect", run=run, **options)

    def collect_stop(self) -> dict[str, Any]:
        """End the collection; the run is whole then."""
        return self.ask("collect_stop")

    def label(self, force_n: float) -> None:
        """State the weight that lies on the sensor now [N]."""
        self.ask("label", force_n=force_n)

    def shutdown(self) -> None:
        """End the process; what it records is closed whole."""
        self.ask("shutdown")


def launch_live(
    name: str, options: LiveOptions | Mapping[str, Any] | None = None, *, folder: Path | None = None
) -> tuple[subprocess.Popen[bytes], Address]:
    """Start a live sensor process, which outlives its starter, and wait until it answers.

    Args:
        name: Process name, unique for this user.
        options: `LiveOptions` or its plain values; relative paths start at the caller's folder.
        folder: Folder of the address file; the user's own by default.
    """
    plain = dict(options) if isinstance(options, Mapping) else {} if options is None else options.to_dict()
    plain |= {key: str(Path(plain[key]).absolute()) for key in ("calibration", "runs") if plain.get(key)}
    words = ["-m", "palpate.sensing.live_service", "--name", name, "--options", json.dumps(plain)]
    return launch_process(name, words + (["--folder", str(folder)] if folder else []), folder, ONE_THREAD)
