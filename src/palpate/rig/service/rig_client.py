"""Client of the process that holds a rig, and the start of that process.

A rig by its name or its file, for the process that holds it.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palpate.core import Clock, DeviceError, ManualClock, MonotonicClock
from palpate.devices.rpc import Address, shared_folder, supervisor_name
from palpate.devices.rpc_client import RpcClient, launch_process
from palpate.rig.rig import Rig
from palpate.rig.rig_file import PositionFrom, is_virtual, read_rig, rig_from, sensor_named
from palpate.rig.virtual.virtual_bench import REAL_TIME_AGE_S, virtual_rig

ESTOP_S = 5.0
SOON_S = 1.0  # in which the rig's process has answered, where a supervisor has stopped the stage already


class RigClient(RpcClient):
    """Asks one rig's process, and reaches for it again whenever it is gone.

    Args:
        name: of the rig, as `rig_name` says it.
        folder: of the address files where it is not the user's own.

    Example:
        >>> with RigClient("virtual:palm") as rig:  # doctest: +SKIP
        ...     rig.plan("palm-reduced")
        ...     rig.start("first")
    """

    def __init__(self, name: str, folder: Path | None = None) -> None:
        super().__init__(name, folder)
        self._supervisor = RpcClient(supervisor_name(name), shared_folder(folder))

    def close(self) -> None:
        """Go away; the processes go on."""
        self._supervisor.close()
        super().close()

    def plan(self, what: str | Mapping[str, Any]) -> dict[str, Any]:
        """Set what is recorded next."""
        return self.ask("plan", plan=what if isinstance(what, str) else dict(what))

    def start(self, out: str) -> dict[str, Any]:
        """Record it into a run of this name, or go on with that run."""
        return self.ask("start", out=out)

    def pause(self) -> None:
        """Stop moving, lift the probe, wait."""
        self.ask("pause")

    def resume(self) -> None:
        """Go on after a pause."""
        self.ask("resume")

    def stop(self) -> None:
        """End after this press."""
        self.ask("stop")

    def abort(self) -> None:
        """Stop moving, lift the probe, end."""
        self.ask("abort")

    def estop(self) -> dict[str, Any]:
        """Emergency stop. When it was asked for and when the stage stood, on the rig's clock [ns]."""
        return self.send_estop()()

    def send_estop(self) -> Callable[[], dict[str, Any]]:
        """Emergency stop, asked for at once; what is returned waits for the answer.

        It goes to the supervisor of the motion, where there is one, and to the rig's process: one of the two
        may hang.
        """
        by_supervisor = _sent(self._supervisor)
        if by_supervisor is None:
            return self.send("estop", ESTOP_S)
        by_process = _sent(self, SOON_S)

        def answer() -> dict[str, Any]:
            if by_process is not None:
                with suppress(DeviceError):
                    return by_process()
            return by_supervisor()

        return answer

    def release(self) -> None:
        """Take the emergency stop back."""
        self.ask("release")

    def shutdown(self) -> None:
        """End the process, unless it records."""
        self.ask("shutdown")

    def ask_status(self) -> dict[str, Any]:
        """The status now."""
        return self.ask("status")


def launch(
    rig: str, runs: Path, *, accelerated: bool = False, folder: Path | None = None
) -> tuple[subprocess.Popen[bytes], Address]:
    """Start the process and wait until it can be reached. It outlives its starter, and its terminal.

    Args:
        rig: its name.
        runs: the folder that recordings go into.
        accelerated: let a virtual rig's time run as fast as the machine can.
        folder: of the address file, where it is not the user's own.
    """
    words = ["-m", "palpate.rig.service", "--rig", rig, "--runs", str(runs.absolute())]
    words += ["--accelerated"] if accelerated else []
    words += ["--folder", str(folder)] if folder else []
    return launch_process(rig, words, folder)


def _sent(client: RpcClient, timeout_s: float = ESTOP_S) -> Callable[[], dict[str, Any]] | None:
    """An emergency stop that was sent; None where nobody can be reached."""
    with suppress(DeviceError):
        return client.send("estop", timeout_s)
    return None


@dataclass(frozen=True, slots=True)
class ServedRig:
    """A rig and how to watch it.

    Attributes:
        rig: its devices.
        real_time: time passes by itself; otherwise only as the rig asks for it.
    """

    rig: Rig
    real_time: bool = True


def open_served_rig(name: str, *, accelerated: bool = False, position: PositionFrom = "stored") -> ServedRig:
    """Open a rig.

    Args:
        name: "virtual:" and a sensor's name, or the path of a rig's file.
        accelerated: let the virtual rig's time run as fast as the machine can; a file says so itself.
        position: Source of the stage's position, see `PositionFrom`.
    """
    if not is_virtual(name):
        file = read_rig(Path(name))
        return ServedRig(
            rig_from(file, name=rig_name(name), position=position),
            file.virtual is None or file.virtual.real_time,
        )
    clock: Clock = ManualClock() if accelerated else MonotonicClock()
    rig = virtual_rig(sensor_named(name), clock=clock, age_s=REAL_TIME_AGE_S)
    return ServedRig(rig, not accelerated)


def rig_name(rig: str) -> str:
    """Name a rig as its process does: by its name, or its file's whole path."""
    if is_virtual(rig):
        sensor_named(rig)
        return rig
    read_rig(Path(rig))
    return str(Path(rig).resolve())
