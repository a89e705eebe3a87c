"""Supervisor: owns stage and force sensor, moves them for one client, and stops and lifts without it.

A look that the client leaves unanswered for `MOVING_S` stops the motion. If the client is silent for
`STANDING_S` with the probe below its clearance, or its pipe ends, the guard lifts the probe. The force is
monitored between orders too. One thread executes orders; another reads, and executes stops at once.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

from palpate.core import Clock, DeviceError, ForceSensor, InputError, PalpateError, Position, Stage
from palpate.devices.device_proxies import StageProxy
from palpate.devices.force_bias import ForceBias, Mounting
from palpate.devices.force_trust import StiffnessRange
from palpate.devices.motion_guard import Clearance, ForceReached, MotionGuard
from palpate.devices.motion_limits import Limits, Reason, Tripped
from palpate.devices.operator_control import OperatorCommand, OperatorControl, OperatorInterrupt
from palpate.devices.supervisor.guard_messages import Row, error_fields, sample_row, three

MOVING_S = 1.0  # in which a client deals with what it hears of a motion
STANDING_S = 10.0  # and says something at all, while the probe stands below its clearance
IDLE_S = 0.02  # between two looks at the force while nothing is ordered
OUTSTANDING = 8  # looks that the client has not dealt with; later ones are told as one
LIFTS, LIFT_PAUSE_S = 3, 0.5

Send = Callable[[Mapping[str, Any]], None]


class _HaltedError(Exception):
    """The client wished the motion to end."""


class GuardSupervisor:
    """Carries out a client's orders under guard, and stops and lifts without it.

    Args:
        stage, force: the devices; the caller closes them.
        limits: of every motion.
        mounting: of the force sensor.
        clock: that all is stamped on.
        send: takes a message to the client, and never waits.

    Attributes:
        state: what it does, in words.
        lifted: why it lifted the probe by itself last; empty where it never had to.
    """

    def __init__(
        self, stage: Stage, force: ForceSensor, limits: Limits, mounting: Mounting, clock: Clock, send: Send
    ) -> None:
        self._stage, self._force, self._clock, self._send = StageProxy(stage, clock), force, clock, send
        self._limits, self._mounting = limits, mounting
        self._orders: SimpleQueue[Mapping[str, Any]] = SimpleQueue()
        self._gone = threading.Event()
        self._halted = False
        self._heard_s = time.monotonic()
        self._told, self._answered = 0, 0
        self._asked_s = [0.0] * (OUTSTANDING + 1)
        self._samples: list[Row] = []
        self._positions: list[list[float]] = []
        self._control = OperatorControl()
        self._guard: MotionGuard | None = None
        self._watches = self._attends = self._judges = False
        self._pending: Exception | None = None
        self.state, self.lifted = "waits", ""
        self._does: dict[str, Callable[[Mapping[str, Any]], Any]] = {
            "begin": self._begin, "end": self._end, "towards": self._towards, "away": self._away,
            "lift": lambda _: self._begun().lift(), "wait": self._wait, "look": self._look,
            "tare": self._tare, "clearance": self._set_clearance, "position": self._position,
            "newest": self._newest, "new_tool": self._new_tool,
            "learn_press": lambda _: self._begun().learn_press(), "drain": self._drain,
            "moving": lambda _: self._stage.moving(), "release": lambda _: self._stage.release(),
        }  # fmt: skip
        self._asides = {name: self._does[name] for name in ("position", "newest")}

    def read(self, messages: Iterable[Mapping[str, Any]]) -> None:
        """Take in what the client writes, until it is gone. To be run in a thread of its own."""
        try:
            for message in messages:
                self._heard_s = time.monotonic()
                self._take(message)
        finally:
            self.leave()

    def leave(self) -> None:
        """The client is gone, or the process has to end: `serve` stops, lifts and returns."""
        self._gone.set()
        self._orders.put({})

    def serve(self) -> None:
        """Carry out orders until the client is gone; then nothing moves, and the probe is lifted."""
        why = "the supervisor failed"
        try:
            while not self._gone.is_set():
                try:
                    order = self._orders.get(timeout=IDLE_S)
                except Empty:
                    self._idle()
                    continue
                if order:
                    self._perform(order)
            why = "whoever records is gone"
        finally:
            self._lift(why)

    def stop(self) -> dict[str, int]:
        """Emergency stop, from any thread: nothing moves any more until it is released.

        Returns:
            When it was asked for, and when the stage stood [ns].
        """
        asked_ns = self._clock.now_ns()
        self._control.ask(OperatorCommand.ESTOP)
        return {"asked_ns": asked_ns, "stood_ns": self._stage.hold()}

    def status(self) -> dict[str, Any]:
        """State: what it does, whether an emergency stop holds the stage, and why it lifted last."""
        return {"state": self.state, "held": self._stage.held, "message": self.lifted, "shots": 0}

    def _take(self, message: Mapping[str, Any]) -> None:
        match message.get("do"):
            case "heard":
                self._answered = max(self._answered, int(message["look"]))
            case "alive":
                self._send({"alive": True})
            case "halt":
                self._halted = True
            case "command":
                self._obey(message.get("command"))
            case "stop":
                self._answer(message, self._stop_stage)
            case "health":
                self._answer(message, lambda: self._stage.health)
            case _:
                self._orders.put(message)

    def _obey(self, command: str | None) -> None:
        if command is None:
            self._control.resume()
        elif command == OperatorCommand.ESTOP:
            with suppress(DeviceError):  # whoever moves sees that it does not stop
                self.stop()
        else:
            self._control.ask(OperatorCommand(command))
            if self._guard is not None:
                with suppress(DeviceError):  # likewise
                    self._guard.interrupt(OperatorCommand(command))

    def _stop_stage(self) -> None:
        self._halted = True
        self._stage.stop()

    def _answer_asides(self) -> None:
        """What the client asks while it deals with a look is answered at the next one, in between."""
        while not self._orders.empty():
            if order := self._orders.get():
                self._answer(order, partial(self._asides[str(order.get("do"))], order))

    def _perform(self, order: Mapping[str, Any]) -> None:
        do = self._does.get(str(order.get("do")))
        self._halted = False
        self.state = f"carries out {order.get('do')}"

        def carry_out() -> Any:
            if do is None:
                raise InputError(f"there is nothing called {str(order.get('do'))[:50]!r} to do")
            return do(order)

        self._reply(order, carry_out)
        self.state = "waits"

    def _reply(self, order: Mapping[str, Any], work: Callable[[], Any]) -> None:
        """Carry it out, and say what came of it, with what was seen on the way and not told yet."""
        answer = _answer_of(work)
        if answer.get("reason") == Reason.CLIENT_SILENT:
            self._lift(str(answer["error"]))
        self._send({"id": order.get("id"), **answer, **self._seen()})

    def _answer(self, order: Mapping[str, Any], work: Callable[[], Any]) -> None:
        """Carry out what is asked past all orders."""
        self._send({"id": order.get("id"), **_answer_of(work)})

    def _begin(self, order: Mapping[str, Any]) -> dict[str, Any]:
        """A new run: nothing of the one before is known any more."""
        if self._stage.held:
            raise OperatorInterrupt(OperatorCommand.ESTOP)
        self._control, self._pending = OperatorControl(), None
        bias = self._bias = ForceBias(self._mounting)
        guard = MotionGuard(self._stage, self._force, self._limits, bias, self._clock, self._control)
        guard.samples.subscribe(lambda samples: self._samples.extend(map(sample_row, samples)))
        guard.positions.subscribe(lambda at, time_ns: self._positions.append([*at, time_ns]))
        guard.looks.subscribe(self._tell)
        self._guard, self._watches, self._judges = guard, True, False
        return {}

    def _end(self, order: Mapping[str, Any]) -> None:
        """The run is over: at rest the client reads the devices itself."""
        self._watches = False

    def _begun(self) -> MotionGuard:
        if self._guard is None:
            raise InputError("an order before a run was begun")
        return self._guard

    def _guarding(self) -> MotionGuard:
        """The guard, once the client was told of what happened since its last order."""
        guard = self._begun()
        if self._pending is not None:
            pending, self._pending = self._pending, None
            raise pending
        return guard

    def _towards(self, order: Mapping[str, Any]) -> bool:
        until_n, step_m = order["until_N"], order["step_m"]
        guard, self._judges = self._guarding(), True
        until = None if until_n is None else ForceReached(float(until_n), bool(order["until_any"]))
        with self._attended():
            return guard.towards(three(order["target"]), float(order["speed_m_s"]), until, step_m)

    def _away(self, order: Mapping[str, Any]) -> None:
        guard, self._judges = self._guarding(), False
        guard.away(three(order["target"]), float(order["speed_m_s"]))  # nobody's silence holds that up

    def _wait(self, order: Mapping[str, Any]) -> list[Row]:
        guard, judged = self._guarding(), bool(order["judged"])
        self._judges = judged
        with self._attended():
            return [sample_row(one) for one in guard.wait(float(order["seconds"]), judged=judged)]

    def _look(self, order: Mapping[str, Any]) -> list[Row]:
        self._judges = judged = bool(order["judged"])
        asks = tuple(OperatorCommand(one) for one in order["asks"])
        return [sample_row(one) for one in self._guarding().look(asks, judged=judged)]

    def _tare(self, order: Mapping[str, Any]) -> dict[str, Any]:
        guard, self._judges = self._guarding(), False
        with self._attended():
            samples = guard.tare(float(order["stated_hz"]))
        bias = self._bias
        zero = {"force_n": bias.force_n, "torque_nm": bias.torque_nm, "noise_n": bias.noise_n}
        return zero | {"samples": [sample_row(one) for one in samples]}

    def _new_tool(self, order: Mapping[str, Any]) -> None:
        stated = order["stated"]
        self._begun().new_tool(stated and StiffnessRange(**{name: tuple(stated[name]) for name in stated}))

    def _set_clearance(self, order: Mapping[str, Any]) -> None:
        self._begun().clearance = Clearance(float(order["z_m"]), float(order["speed_m_s"]))

    def _position(self, order: Mapping[str, Any]) -> Position:
        return self._stage.position_m() if self._guard is None else self._guard.position_m()

    def _newest(self, order: Mapping[str, Any]) -> Row:
        return sample_row(self._guard.fresh() if self._guard and order["judged"] else self._force.latest())

    def _drain(self, order: Mapping[str, Any]) -> list[Row]:
        return [sample_row(one) for one in self._force.drain()]

    @contextmanager
    def _attended(self) -> Iterator[None]:
        """An order during which the client has to keep up."""
        self._attends = True
        try:
            yield
        finally:
            self._attends = False

    def _tell(self) -> None:
        """Tell the client of a look, unless it has many to deal with; end the motion where it does not."""
        self._answer_asides()
        if self._halted:
            raise _HaltedError
        if self._told - self._answered < OUTSTANDING:
            self._told += 1
            self._asked_s[self._told % len(self._asked_s)] = time.monotonic()
            self._send({"look": self._told, **self._seen()})
        if self._attends and self._answered < self._told:
            oldest_s = time.monotonic() - self._asked_s[(self._answered + 1) % len(self._asked_s)]
            if oldest_s > MOVING_S:
                raise Tripped(
                    Reason.CLIENT_SILENT,
                    f"whoever records has not dealt with the motion's last {oldest_s:.1f} s; is its disk or "
                    "its computer too slow? The probe was stopped and lifted",
                )

    def _seen(self) -> dict[str, Any]:
        samples, self._samples = self._samples, []
        positions, self._positions = self._positions, []
        return {"samples": samples, "positions": positions}

    def _idle(self) -> None:
        """Between orders: the force stays watched, and a client that says nothing is not waited for."""
        guard = self._guard
        if guard is None or not self._watches or self._pending is not None:
            return
        try:
            if self._judges:
                guard.look((), judged=True)
        except Tripped as e:
            self._pending = e  # for the next order; nothing moves
        silent_s = time.monotonic() - self._heard_s
        if silent_s > STANDING_S and self._below_clearance(guard):
            why = f"whoever records has said nothing for {silent_s:.0f} s"
            self._lift(why)
            self._pending = Tripped(Reason.CLIENT_SILENT, f"{why}; the probe was lifted meanwhile")
            self._judges = False

    def _below_clearance(self, guard: MotionGuard) -> bool:
        with suppress(PalpateError):
            return guard.clearance is not None and guard.position_m()[2] > guard.clearance.z_m + 1e-6
        return False

    def _lift(self, why: str) -> None:
        """Stop, and lift where that is possible and no emergency stop forbids it."""
        guard, self._attends = self._guard, False
        with suppress(PalpateError):
            self._stage.stop()
        if guard is None or guard.clearance is None or self._stage.held:
            return
        self._halted, self.lifted = False, why
        for left in reversed(range(LIFTS)):
            try:
                guard.lift()
                return
            except OperatorInterrupt:
                return
            except PalpateError as e:
                self.lifted = f"{why}; the probe was not lifted: {e}"
                if left:
                    self._clock.sleep(LIFT_PAUSE_S)


def _answer_of(work: Callable[[], Any]) -> dict[str, Any]:
    """What came of it; whatever it is, the client is told, and the supervisor goes on guarding."""
    try:
        return {"ok": True, "result": work()}
    except _HaltedError:
        return {"ok": False, "kind": "DeviceError", "error": "the client halted the motion"}
    except BaseException as e:  # a driver may raise anything, and Ctrl-C does not come here
        return {"ok": False, **error_fields(e)}
