"""How a fault sets in on an observed rig, and what may be said of it afterwards."""

import math
import os
import signal
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any
from unittest import mock

from tests.rig.fault_matrix.observed_rig import ObservedRig
from tests.rig.guarded_presses import AlteredForce, law_range

from palpate.core import NS_PER_S, DeviceError, Position, Wrench
from palpate.devices import OperatorCommand
from palpate.recordings.segments import mcap_file
from palpate.rig.virtual.disturbances import Kind

AT_ONCE = "at once"  # v times the force's latency, and the stop
TRUST = "0.2 mm"
AGE = "age"  # v times the oldest age, and the stop
STEP = "step"  # the move that was sent
NEXT = "next"  # what is left of the move that was sent, and the next
SEARCH = "search"  # the search for contact
OPEN = "open"  # no matter of motion: nothing is pressed by it

Begin = Callable[[ObservedRig], None]


@dataclass(frozen=True)
class Otherwise:
    """What differs in one state: its names there, why, and `within` where that differs too."""

    names: tuple[str, ...]
    why: str
    within: str = ""


@dataclass(frozen=True)
class RigFault:
    """Fault of one part of a rig.

    Attributes:
        part, name: in the table.
        begin: sets it in.
        names: reasons or states that the recording may end with; "done" where it may be recorded whole.
        stays: why the probe is not lifted after it; empty where it must be.
        within: how far the probe may go on once it shows, towards or along the skin, beside the stop itself.
        shows: "force" where it shows when the force read differs from the true one, "limit" when the true
            force passes the limit; else it shows at once, or when it says so itself.
        elsewhere: what differs in some of the states, and why.
    """

    part: str
    name: str
    begin: Begin
    names: tuple[str, ...]
    stays: str = ""
    within: str = AT_ONCE
    shows: str = ""
    elsewhere: Mapping[str, Otherwise] = field(default_factory=dict)

    def names_in(self, state: str) -> tuple[str, ...]:
        """Names that it may have in a state."""
        return self.elsewhere[state].names if state in self.elsewhere else self.names

    def within_in(self, state: str) -> str:
        """How far the probe may go on in a state."""
        return (self.elsewhere[state].within if state in self.elsewhere else "") or self.within


def of_kind(kind: Kind) -> Begin:
    """A fault that the virtual devices have themselves."""
    return lambda rig: rig.truth.faults.begin(kind, rig.clock.now_ns())


def replacing(device: str, method: str, replaced: Callable[..., Any]) -> Begin:
    """A device whose method does something else from now on."""

    def begin(rig: ObservedRig) -> None:
        known = getattr(rig, device).replaced.get(method)
        if known is None:
            getattr(rig, device).replaced[method] = replaced
        else:  # watched already: what is watched is the replaced one
            getattr(rig, device).replaced[method] = lambda real, *args: known(
                lambda *more: replaced(real, *more), *args
            )

    return begin


def both(*begins: Begin) -> Begin:
    """Several at once."""

    def begin(rig: ObservedRig) -> None:
        for one in begins:
            one(rig)

    return begin


def raising(error: Exception) -> Callable[..., Any]:
    """A method that raises from now on."""

    def replaced(real: Callable[..., Any], *args: Any) -> Any:
        raise error

    return replaced


def raising_once(device: str, method: str, error: Exception) -> Begin:
    """A method that raises once."""

    def begin(rig: ObservedRig) -> None:
        left = [error]

        def replaced(real: Callable[..., Any], *args: Any) -> Any:
            if left:
                raise left.pop()
            return real(*args)

        replacing(device, method, replaced)(rig)

    return begin


def sampling(replaced: Callable[..., Any]) -> Begin:
    """Both ways to read the force sensor do something else from now on."""
    return both(replacing("force", "drain", replaced), replacing("force", "latest", replaced))


def each(change: Callable[[Wrench], Wrench]) -> Callable[..., Any]:
    """A method whose samples are changed."""

    def replaced(real: Callable[..., Any], *args: Any) -> Any:
        found = real(*args)
        return change(found) if isinstance(found, Wrench) else [change(one) for one in found]

    return replaced


no_number = each(lambda one: replace(one, force_n=(*one.force_n[:2], math.nan)))
"""Samples whose normal force is no number."""


def drifting_zero(share: float, seconds: float) -> Begin:
    """A zero along the press that moves from now on by a share of the limit of force, and then rests."""

    def begin(rig: ObservedRig) -> None:
        begun_ns, far_n = rig.clock.now_ns(), share * rig.rig.limits.force_n

        def moved(one: Wrench) -> Wrench:
            x, y, z = one.force_n
            done = min(max((one.time_ns - begun_ns) / NS_PER_S / seconds, 0.0), 1.0)
            return replace(one, force_n=(x, y, z + far_n * done))

        sampling(each(moved))(rig)

    return begin


def late_once(device: str, method: str, seconds: float) -> Begin:
    """A call that comes back late, once."""

    def begin(rig: ObservedRig) -> None:
        left = [seconds]

        def replaced(real: Callable[..., Any], *args: Any) -> Any:
            if left:
                rig.block(left.pop())
            return real(*args)

        replacing(device, method, replaced)(rig)

    return begin


def withheld_once(seconds: float, *, lost: bool = False) -> Begin:
    """Samples that come late together and are stamped when they come, once; or are lost."""

    def begin(rig: ObservedRig) -> None:
        until_ns, kept, last = rig.clock.now_ns() + round(seconds * NS_PER_S), list[Wrench](), list[Wrench]()

        def drain(real: Callable[..., Any]) -> Any:
            fresh, now_ns = real(), rig.clock.now_ns()
            if now_ns < until_ns:
                kept.extend([] if lost else fresh)
                return []
            late = [replace(one, time_ns=now_ns) for one in (*kept, *fresh)] if kept else fresh
            kept.clear()
            return late

        def latest(real: Callable[..., Any]) -> Any:
            if rig.clock.now_ns() >= until_ns:
                return real()
            if not last:
                last.append(real())
            return last[0]

        both(replacing("force", "drain", drain), replacing("force", "latest", latest))(rig)

    return begin


def silent_for(seconds: float) -> Begin:
    """A force sensor that does not answer for some time."""

    def begin(rig: ObservedRig) -> None:
        until_ns = rig.clock.now_ns() + round(seconds * NS_PER_S)

        def replaced(real: Callable[..., Any], *args: Any) -> Any:
            if rig.clock.now_ns() < until_ns:
                raise DeviceError("the force sensor does not answer")
            return real(*args)

        sampling(replaced)(rig)

    return begin


def altered(delay_s: float = 0.0, gain: float = 1.0) -> Begin:
    """A force that comes late under current timestamps, or of another gain, bias included."""

    def begin(rig: ObservedRig) -> None:
        source = SimpleNamespace(drain=rig.force.inner.drain)
        force = AlteredForce(source, rig.clock, delay_s, gain, settle_s=0.0)
        both(
            replacing("force", "drain", lambda real: force.drain()),
            replacing("force", "latest", lambda real: force.latest_or(real)),
        )(rig)

    return begin


def stated_stiffness(rig: ObservedRig) -> None:
    """The rig states the stiffness of its skin to 25 %; it counts where the recording is not begun yet."""
    ranges = dict.fromkeys(rig.plan.indenters, law_range(rig.truth, 1.25))
    rig.rig = replace(rig.rig, stiffness=ranges)


def creeping(rig: ObservedRig) -> None:
    """A stage that goes a hundredth as fast as it is told to, from its next move on."""
    replacing("stage", "move_to", lambda real, at, speed: real(at, speed / 100))(rig)


def slipping(rig: ObservedRig) -> None:
    """A stage that loses 0.1 mm of each move, from its next on."""

    def move_to(real: Callable[..., Any], at: Position, speed: float) -> None:
        start = rig.place_m
        rig.shows_ns = rig.shows_ns or rig.clock.now_ns()
        share = max(1.0 - 0.1e-3 / max(math.dist(start, at), 1e-9), 0.0)
        x, y, z = (a + share * (b - a) for a, b in zip(start, at, strict=True))
        real((x, y, z), speed)

    replacing("stage", "move_to", move_to)(rig)


def jumped(rig: ObservedRig) -> None:
    """A stage whose count is off by half a millimetre along y from now on."""

    def replaced(real: Callable[..., Any]) -> Any:
        x, y, z = real()
        return x, y + 0.5e-3, z

    replacing("stage", "position_m", replaced)(rig)


def deaf_and_stalled(rig: ObservedRig) -> None:
    """A stage that does not stop when told to, and a reason to stop it."""
    of_kind("stage-deaf")(rig)
    of_kind("force-gone")(rig)


def late_frames(seconds: float) -> Begin:
    """A camera whose frames come late from now on."""

    def begin(rig: ObservedRig) -> None:
        def replaced(real: Callable[..., Any], timeout_s: float = 1.0) -> Any:
            if seconds > timeout_s:
                rig.clock.sleep(timeout_s)
                raise DeviceError(f"no frame came within {timeout_s:g} s")
            rig.clock.sleep(seconds)
            return real(timeout_s)

        replacing("camera", "grab", replaced)(rig)
        replacing("camera", "drain", lambda real: [] if seconds > 1 else real())(rig)

    return begin


def backward_stamps(rig: ObservedRig) -> None:
    """A camera whose stamps run backwards from now on."""
    begun_ns = rig.clock.now_ns()

    def back(time_ns: int) -> int:
        return begun_ns - max(time_ns - begun_ns, 0)

    def grab(real: Callable[..., Any], timeout_s: float = 1.0) -> Any:
        time_ns, frame = real(timeout_s)
        return back(time_ns), frame

    def drain(real: Callable[..., Any]) -> Any:
        return [(back(time_ns), frame) for time_ns, frame in real()]

    replacing("camera", "grab", grab)(rig)
    replacing("camera", "drain", drain)(rig)


PATCHES = ExitStack()
"""Changes of the process for one recording, undone after it."""


def disk_that(error: OSError) -> Begin:
    """A disk that refuses every byte from now on."""

    def begin(rig: ObservedRig) -> None:
        def refusing(self: mcap_file.HeldFile, data: bytes) -> None:
            raise error

        PATCHES.enter_context(mock.patch.object(mcap_file.HeldFile, "write", refusing))

    return begin


def slow_disk(rig: ObservedRig) -> None:
    """A disk that takes a twentieth of a second for each write, of the machine's time."""
    real = mcap_file.HeldFile.write
    left = [20]

    def slow(self: mcap_file.HeldFile, data: bytes) -> None:
        if left[0] > 0:
            left[0] -= 1
            time.sleep(0.05)
        real(self, data)

    PATCHES.enter_context(mock.patch.object(mcap_file.HeldFile, "write", slow))


def operator(command: OperatorCommand) -> Begin:
    """A command of the operator."""
    return lambda rig: rig.control.ask(command)


def interrupted(rig: ObservedRig) -> None:
    raise KeyboardInterrupt


def killed(rig: ObservedRig) -> None:
    """The process is gone; what the stage was sent, it still does."""
    rig.last_words()
    os.kill(os.getpid(), signal.SIGKILL)


def computer_stands_still(rig: ObservedRig) -> None:
    """The programme does not run for five seconds."""
    rig.block(5.0)


def failing_watcher(rig: ObservedRig) -> None:
    def hear(_: ObservedRig, call: str) -> None:
        if call == "status":
            raise LookupError("a page that is gone")

    rig.heard = hear


def harder_skin(rig: ObservedRig) -> None:
    """The skin is twenty times as stiff from now on, as where the probe meets a screw."""
    skin = rig.truth._skin
    skin.law = replace(skin.law, force_n=20 * skin.law.force_n)


def raised_skin(rig: ObservedRig) -> None:
    """The skin stands 1.5 mm higher from now on: the probe is in it at the clearance."""
    x, y, z = rig.truth._origin
    rig.truth._origin = (x, y, z - 1.5e-3)
