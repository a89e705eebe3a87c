"""The devices that a rig's file names, each opened as far as it can be, for work by hand."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from palpate.core import (
    NS_PER_S,
    Clock,
    Closing,
    DeviceError,
    ForceSensor,
    FrameSource,
    InputError,
    MonotonicClock,
    PalpateError,
    Position,
    Stage,
    StorageError,
)
from palpate.devices import Limits, Mounting
from palpate.devices.check.interface_check import Role
from palpate.devices.rpc import find, hold, supervisor_name
from palpate.devices.rpc_client import RpcClient
from palpate.rig.commissioning.hand_motion import touch_off
from palpate.rig.mean_force import Hand, discard
from palpate.rig.real.device_hold import DeviceHeldError
from palpate.rig.rig_file import (
    FollowingPart,
    MarlinPart,
    PositionFrom,
    RigFile,
    follow_stage,
    is_virtual,
    open_part,
    open_rig,
    read_rig,
)
from palpate.rig.service import RigClient, rig_name
from palpate.stop_request import (
    ENDED,
    GONE,
    NOT_CONFIRMED,
    STOPPED,
    Holder,
    failed_text,
    holders_of,
    how_stopped,
    stop_all,
)

WATCH_S = 1.0  # for a camera's rate
POLL_S = 0.02
REACH_S = 3.0  # for a process that holds the rig
LET_GO_S = 5.0  # in which a process that was told to end has stopped the stage and is gone
AGAIN_S = 0.05

Client = TypeVar("Client", bound=RpcClient)


@dataclass
class Bench(Closing):
    """Open devices of a rig; None for one that its file does not name, or that failed.

    Attributes:
        failed: why a device could not be opened, by its role.
        stage_part: the stage's table in the rig's file; None for a virtual one.
        origin_m: expected surface of the skin, in the stage's frame [m].
    """

    name: str
    clock: Clock
    mounting: Mounting
    limits: Limits | None
    origin_m: Position
    stage: Stage | None = None
    force: ForceSensor | None = None
    camera: FrameSource | None = None
    failed: dict[str, str] = field(default_factory=dict)
    stage_part: Any = None

    def close(self) -> None:
        """Let go of all devices, the stage first."""
        for device in (self.stage, self.force, self.camera):
            if device is not None:
                device.close()

    def need_stage(self) -> Stage:
        """The stage."""
        if self.stage is None:
            raise DeviceError(self.failed.get("stage", f"the rig {self.name!r} has no [stage]"))
        return self.stage

    def check_may_home(self) -> None:
        """Refuse to home a stage whose switches lie on the skin's side, unless its file says that it may."""
        if isinstance(self.stage_part, MarlinPart) and not self.stage_part.home:
            raise InputError(
                f"the rig {self.name!r} has a Marlin stage, whose homing can drive its tool down to the bed; "
                "nothing moved. Where its switches lie away from the skin, set home = true under [stage]; "
                "else give --position touch-off or --position reference",
                code="homing-not-confirmed",
            )

    def need_force(self) -> ForceSensor:
        """The force sensor."""
        if self.force is None:
            raise DeviceError(self.failed.get("force", f"the rig {self.name!r} has no [force]"))
        return self.force


def open_bench(
    rig: str, roles: tuple[Role, ...] = ("force", "camera", "stage"), *, position: PositionFrom = "stored"
) -> Bench:
    """Open some of a rig's devices; one that fails is told in `failed`, and the others stay open.

    Args:
        rig: a rig's file, or the name of a virtual one.
        roles: which devices.
        position: Source of the stage's position; "nowhere" for homing.

    Raises:
        InputError: there is no such rig; or a field that is not one, or out of range.
    """
    if is_virtual(rig) or (file := read_rig(Path(rig))).virtual is not None:
        whole = open_rig(rig)
        return Bench(
            whole.name,
            whole.clock,
            whole.mounting,
            whole.limits,
            whole.origin_m,
            whole.stage,
            whole.force,
            whole.camera,
        )
    if file.stage is None:
        raise InputError(f"{rig}: {file.name!r} needs [stage] or [virtual]", code="stage-missing")
    x, y, z = (1e-3 * d for d in file.origin_mm)
    bench = Bench(
        name=file.name,
        clock=MonotonicClock(),
        mounting=Mounting(file.force.axes) if file.force else Mounting(),
        limits=file.limits.limits() if file.limits else None,
        origin_m=(x, y, z),
        stage_part=file.stage,
    )
    for role in sorted(roles, key=lambda role: isinstance(getattr(file, role), FollowingPart)):
        try:
            setattr(bench, role, _open(file, role, bench, position))
        except PalpateError as e:
            bench.failed[role] = str(e)
        except BaseException:
            bench.close()
            raise
    if position == "touch-off":
        try:
            hand = Hand(bench.need_stage(), bench.need_force(), bench.mounting, bench.clock)
            touch_off(hand, bench.origin_m, pushed=not isinstance(file.force, FollowingPart))
        except BaseException:
            bench.close()
            raise
    return bench


def _open(file: RigFile, role: Role, bench: Bench, position: PositionFrom) -> Any:
    part, clock = getattr(file, role), bench.clock
    if part is None:
        return None
    if isinstance(part, FollowingPart) and role in ("force", "camera") and bench.stage is not None:
        return follow_stage(role, file, bench.stage, clock)
    return open_part(role, part, clock, position)


def rig_process(rig: str) -> RigClient | None:
    """A client of the process that holds a rig; None where none does. The caller closes it."""
    return _reached(RigClient(rig_name(rig)))


def _reached(client: Client) -> Client | None:
    """The client, where its process answers; else None, and it is closed."""
    if find(client.name) is not None and client.reached(REACH_S):
        return client
    client.close()
    return None


class RigStop(NamedTuple):
    """Confirmed stop of a rig.

    Attributes:
        code: "stopped" by the processes that hold it, "stopped-on-port", or "nothing-moves".
        how: what was done, as a phrase.
        holders: processes that held the rig, or left their address behind, with their answers.
    """

    code: str
    how: str
    holders: list[Holder]


def stop_rig(rig: str) -> RigStop:
    """Stop a rig at once: through the processes that hold it, else on the stage itself.

    A process that has the stage's port and is no supervisor is told to end; then the stage is stopped.

    Raises:
        DeviceError: the stage did not stop, or is not known to stand; says who has it.
    """
    name = rig_name(rig)
    holders = holders_of(name)
    stop_all(holders)
    if how := how_stopped(holders):
        return RigStop(STOPPED, how, holders)
    if is_virtual(rig) or read_rig(Path(rig)).virtual is not None:
        if failed := failed_text(holders):
            raise DeviceError(f"{rig}: nothing was stopped{failed}", code=NOT_CONFIRMED)
        return RigStop("nothing-moves", "no process holds it, and nothing of a virtual rig moves", holders)
    reached = [one for one in holders if one.is_supervisor and one.code != GONE]
    told = "the process that was opening the rig was ended; " if any(o.code == ENDED for o in reached) else ""
    with _held_alone(supervisor_name(name), LET_GO_S if reached else 0.0):
        ended = _stop_on_port(rig)
    how = f"{told}{ended}the stage was opened by itself and told to stop, and it obeyed"
    return RigStop("stopped-on-port", how, holders)


@contextmanager
def _held_alone(name: str, within_s: float) -> Iterator[None]:
    """The right to supervise a rig, without which a stage must not be opened beside its supervisor."""
    end_s = time.monotonic() + within_s
    held: AbstractContextManager[Any] = nullcontext()
    while True:
        try:
            held = hold(name)
            break
        except StorageError:  # a full disk must not keep anybody from stopping a stage
            break
        except DeviceError as e:
            if time.monotonic() > end_s:
                raise DeviceError(
                    f"{e}. It guards the motion and does not answer: nothing was stopped, and the stage may "
                    "move. Use the rig's switch",
                    code=NOT_CONFIRMED,
                ) from e
            time.sleep(AGAIN_S)
    with held:
        yield


def _stop_on_port(rig: str) -> str:
    """Stop a stage on its own port, once whoever has that was told to end; says who that was."""
    ended, end_s = "", time.monotonic() + LET_GO_S
    while True:
        try:
            with closing(_open_stage(rig)) as stage:
                stage.stop()
            return ended
        except DeviceHeldError as e:
            if e.pid is None or time.monotonic() > end_s:
                raise DeviceError(
                    f"{ended}{e}. The stage is not known to stand: use the rig's switch", code=NOT_CONFIRMED
                ) from e
            if not ended:
                with suppress(ProcessLookupError):
                    os.kill(e.pid, signal.SIGTERM)
                ended = f"process {e.pid}, which had the stage, was told to end; "
            time.sleep(AGAIN_S)
        except DeviceError as e:
            raise DeviceError(
                f"{ended}{e}. Nothing was stopped: use the rig's switch", code=NOT_CONFIRMED
            ) from e


def _open_stage(rig: str) -> Stage:
    file = read_rig(Path(rig))
    if file.stage is None:
        raise InputError(f"{rig}: {file.name!r} needs [stage] or [virtual]", code="stage-missing")
    stage: Stage = open_part("stage", file.stage, MonotonicClock(), "unchecked")
    return stage


def bench_status(bench: Bench) -> dict[str, Any]:
    """State of each device: plain values, None where a device does not say; `problems` says why."""
    problems = dict(bench.failed)
    found: dict[str, Any] = {
        "rig": bench.name,
        "stage": None,
        "stage_says": None,
        "position_mm": None,
        "problems": problems,
    }
    if bench.stage is not None:
        try:
            found["stage"] = "moving" if bench.stage.moving() else "stands"
            found["position_mm"] = [round(1e3 * d, 4) for d in bench.stage.position_m()]
        except PalpateError as e:
            problems["stage"] = str(e)
        found["stage_says"] = getattr(bench.stage, "reported", "") or None
    found |= _force_status(bench, problems) | _camera_status(bench, problems)
    return found


def _force_status(bench: Bench, problems: dict[str, str]) -> dict[str, Any]:
    found: dict[str, Any] = {"force_N": None, "force_age_ms": None, "force_rate_hz": None}
    if bench.force is None:
        return found
    try:
        discard(bench.force)
        bench.clock.sleep(WATCH_S / 2)
        samples = bench.force.drain()
        newest = bench.force.latest()
        found["force_rate_hz"] = round(len(samples) / (WATCH_S / 2), 1)
        found["force_age_ms"] = round((bench.clock.now_ns() - newest.time_ns) / 1e6, 1)
        if newest.fault:
            problems["force"] = f"the force sensor says: {newest.fault}"
        else:
            found["force_N"] = [round(f, 4) for f in bench.mounting.to_skin(newest.force_n)]
    except PalpateError as e:
        problems["force"] = str(e)
    return found


def _camera_status(bench: Bench, problems: dict[str, str]) -> dict[str, Any]:
    found: dict[str, Any] = {"camera_rate_hz": None, "camera_stated_hz": None, "frame_age_ms": None}
    camera = bench.camera
    if camera is None:
        return found
    found["camera_stated_hz"] = camera.rate_hz
    try:
        times_ns = frame_times(camera, bench.clock, WATCH_S)
        found["camera_rate_hz"] = round((len(times_ns) - 1) * NS_PER_S / (times_ns[-1] - times_ns[0]), 2)
        found["frame_age_ms"] = round((bench.clock.now_ns() - times_ns[-1]) / 1e6, 1)
    except PalpateError as e:
        problems["camera"] = str(e)
    return found


def frame_times(camera: FrameSource, clock: Clock, seconds: float) -> list[int]:
    """Ends of the exposures of all frames that a camera takes in so many seconds, two at least [ns].

    All that it took are counted, as `grab` alone would not: that waits for a whole exposure after each call.

    Raises:
        DeviceError: it gives none.
    """
    times_ns = [camera.grab(max(seconds, 3.0 / camera.rate_hz))[0]]
    while times_ns[-1] - times_ns[0] < seconds * NS_PER_S:
        clock.sleep(min(POLL_S, 0.5 / camera.rate_hz))
        taken = camera.drain()
        times_ns += [time_ns for time_ns, _ in taken]
        if not taken and clock.now_ns() - times_ns[-1] > (seconds + 3.0 / camera.rate_hz) * NS_PER_S:
            times_ns.append(camera.grab(seconds)[0])  # which says what is wrong with it
    return times_ns


def process_status(rig: str) -> dict[str, Any] | None:
    """Status that the process holding a rig gives, where one does."""
    client = rig_process(rig)
    if client is None:
        return None
    with client, suppress(KeyError):
        told = client.ask_status()
        kept = ("rig", "state", "recording", "held", "message", "position_mm", "force_n", "tared", "devices")
        return {name: told[name] for name in kept}
    return None
