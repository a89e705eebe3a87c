"""Guard of a motion that a supervisor carries out: what `MotionGuard` is in one process, over a link.

Stage and force sensor that a supervisor's process owns, as far as a client may use them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from palpate.core import DeviceError, ForceSensor, Position, Travel, Wrench
from palpate.devices.force_bias import Force, ForceBias
from palpate.devices.force_trust import StiffnessRange
from palpate.devices.motion_guard import Clearance, ForceReached, Subscribers
from palpate.devices.motion_limits import Reason, Tripped
from palpate.devices.operator_control import AT_ONCE, OperatorCommand, OperatorControl
from palpate.devices.supervisor.guard_messages import sample_of, three
from palpate.devices.supervisor.process_link import (
    ANSWER_S,
    GoneWords,
    Message,
    ProcessGoneError,
    ProcessLink,
)

TOLD = GoneWords(
    "the process that guards the motion is gone; a move that it had sent ends by itself. Look at the "
    "rig: the probe may stand in the skin",
    "the process that guards the motion does not answer: it hangs, and may not stop or lift the probe; "
    "use the rig's switch",
    "look at the rig: the process that guards the motion has not let go of the devices",
)


class SupervisorLink(ProcessLink):
    """Link to a supervisor's process; see `ProcessLink`.

    Attributes:
        stage, force: the devices, as far as a client may use them.
    """

    def __init__(self, words: Sequence[str], opens: Message) -> None:
        self.force = SupervisedForce(self)
        self.stage = SupervisedStage(self)
        super().__init__(words, opens, TOLD)

    @property
    def scheduling(self) -> dict[str, str]:
        """Scheduling that the process was granted, see `request_priority`."""
        return {name: str(self.facts.get(name, "")) for name in ("scheduling", "remedy")}


class SupervisedStage:
    """A `palpate.core.Stage` that a supervisor owns: it says where it is, and stops; the guard moves it."""

    def __init__(self, link: SupervisorLink) -> None:
        self._link = link

    @property
    def travel(self) -> Travel:
        facts = self._link.facts["travel"]
        return Travel(three(facts[0]), three(facts[1]), *(float(value) for value in facts[2:]))

    @property
    def health(self) -> str:
        """What was lost on the wire, of a driver that counts it; empty where nothing was."""
        return str(self._link.ask("health"))

    def position_m(self) -> Position:
        return three(self._link.ask("position"))

    def move_to(self, position_m: Position, speed_m_s: float) -> None:
        """Refuse: the supervisor's guard alone moves it."""
        raise DeviceError("a supervisor owns the stage; only its guarded moves move it")

    def moving(self) -> bool:
        return bool(self._link.ask("moving"))

    def stop(self) -> None:
        """Bring it to a stand, past whatever the supervisor is doing."""
        self._link.ask("stop")

    def release(self) -> None:
        """Let it move again after an emergency stop."""
        self._link.ask("release")

    def close(self) -> None:
        """Nothing: the supervisor closes it as it ends."""


class SupervisedForce:
    """A `palpate.core.ForceSensor` that a supervisor owns.

    During a run the supervisor drains it, and what it tells is handed out here; at rest it is asked.
    """

    def __init__(self, link: SupervisorLink) -> None:
        self._link = link
        self._told: list[Wrench] = []
        self.guarded = False

    @property
    def rate_hz(self) -> float:
        return float(self._link.facts["rate_hz"])

    @property
    def delay_s(self) -> float:
        """Delay of its samples, where it states one [s]."""
        return float(self._link.facts["delay_s"])

    @property
    def range_n(self) -> tuple[float, float, float]:
        return three(self._link.facts["range_n"])

    def latest(self) -> Wrench:
        """The newest sample; during a run refused as the guard refuses it."""
        return sample_of(self._link.ask("newest", judged=self.guarded))

    def drain(self) -> list[Wrench]:
        if not self.guarded:
            return [sample_of(row) for row in self._link.ask("drain")]
        told, self._told = self._told, []
        return told

    def tell(self, samples: Sequence[Wrench]) -> None:
        """What the supervisor told of it."""
        self._told += samples

    def close(self) -> None:
        """Nothing: the supervisor closes it as it ends."""


class SupervisedGuard:
    """Orders guarded motion of a supervisor, and publishes what it tells. See `MotionGuard`.

    Args:
        link: to the supervisor.
        sensor: the supervisor's force sensor, or a proxy of it.
        bias: follows the supervisor's zero.
        control: its commands are passed on at once, in the thread that asks.

    Attributes:
        samples, positions, looks: as of a `MotionGuard`. What subscribes must keep up: a look that lies
            unanswered for a second stops the motion.

    An exception of a subscriber stops the motion.
    """

    def __init__(
        self, link: SupervisorLink, sensor: ForceSensor, bias: ForceBias, control: OperatorControl
    ) -> None:
        self._link, self._sensor, self._bias, self._control = link, sensor, bias, control
        self._clearance: Clearance | None = None
        self.samples: Subscribers[[Sequence[Wrench]]] = Subscribers()
        self.positions: Subscribers[[Position, int]] = Subscribers()
        self.looks: Subscribers[[]] = Subscribers()
        self._ask("begin")
        link.force.guarded = True
        control.listen(lambda command: link.tell("command", command=command))

    @property
    def clearance(self) -> Clearance | None:
        """Where `lift` goes, and where the supervisor lifts to by itself; None until it is stated."""
        return self._clearance

    @clearance.setter
    def clearance(self, clearance: Clearance) -> None:
        self._clearance = clearance
        self._ask("clearance", z_m=clearance.z_m, speed_m_s=clearance.speed_m_s)

    @property
    def force_n(self) -> Force:
        """The newest force, in the skin's axes [N]."""
        with _as_tripped():
            return self._bias.force(self._sensor.latest())

    def skin_n(self, sample: Wrench) -> Force:
        """Force of a sample, in the skin's axes, without the bias [N]."""
        return self._bias.force(sample)

    def position_m(self) -> Position:
        return three(self._ask("position"))

    def tare(self, stated_hz: float) -> list[Wrench]:
        """Take the sensor's zero and learn its noise, standing in the air; the samples from which it was."""
        zero = self._order("tare", stated_hz=stated_hz)
        bias = self._bias
        bias.force_n, bias.torque_nm = three(zero["force_n"]), three(zero["torque_nm"])
        bias.noise_n = float(zero["noise_n"])
        return [sample_of(row) for row in zero["samples"]]

    def new_tool(self, stated: StiffnessRange | None = None) -> None:
        """Forget the stiffness that was learnt: another tool or skin follows; its range may be stated."""
        self._order("new_tool", stated=None if stated is None else asdict(stated))

    def learn_press(self) -> None:
        """Learn the skin's stiffness from the way down that went well just now."""
        self._order("learn_press")

    def lift(self) -> None:
        """Lift straight up to the clearance, if the probe is below it."""
        self._order("lift")

    def wait(self, seconds: float, *, judged: bool = True) -> list[Wrench]:
        """Let time pass while watching, and return what the sensor measured in it."""
        return [sample_of(row) for row in self._order("wait", seconds, seconds=seconds, judged=judged)]

    def look(self, asks: tuple[OperatorCommand, ...] = AT_ONCE, *, judged: bool = True) -> list[Wrench]:
        """Take in and publish what the sensor measured since, and raise on what must stop a motion."""
        return [sample_of(row) for row in self._order("look", asks=list(asks), judged=judged)]

    def towards(
        self,
        target: Position,
        speed_m_s: float,
        until: ForceReached | None = None,
        step_m: float | None = None,
    ) -> bool:
        """Move in short guarded steps; True as soon as the normal force is reached, stopped there."""
        until_n, any_way = (None, False) if until is None else (until.normal_n, until.any_way)
        reached = self._order(
            "towards",
            target=target,
            speed_m_s=speed_m_s,
            until_N=until_n,
            until_any=any_way,
            step_m=step_m,
        )
        return bool(reached)

    def away(self, target: Position, speed_m_s: float) -> None:
        """Move away from the skin, or beside it, in one go."""
        self._order("away", target=target, speed_m_s=speed_m_s)

    def halt(self) -> None:
        """Bring the stage to a stand."""
        self._ask("stop")

    def close(self) -> None:
        """The run is over: from now on the sensor is asked, and commands are nobody's."""
        self._control.listen(None)
        self._link.force.guarded = False
        if not self._link.gone:
            self._ask("end")

    def _ask(self, do: str, **fields: Any) -> Any:
        with _as_tripped():
            return self._link.ask(do, **fields)

    def _order(self, do: str, lasts_s: float = 0.0, **fields: Any) -> Any:
        """Order something, publish what is told on the way, and return what comes of it."""
        failed: BaseException | None = None
        with _as_tripped():
            number = self._link.order(do, **fields)
            while (event := self._link.next_event(ANSWER_S + lasts_s)).get("id") != number:
                if "look" in event:
                    failed = self._publish(event, failed)
        try:
            self._pass_on(event)
        except BaseException as e:
            failed = failed or e
        if failed is not None:
            raise failed
        return self._link.result_of(event)

    def _publish(self, event: Message, failed: BaseException | None) -> BaseException | None:
        """Publish a look, and say that it was dealt with."""
        try:
            self._pass_on(event)
            self.looks.publish()
        except BaseException as e:
            if failed is None:
                self._link.tell("halt")
            failed = failed or e
        finally:
            self._link.tell("heard", look=event["look"])
        return failed

    def _pass_on(self, message: Message) -> None:
        self._link.force.tell([sample_of(row) for row in message["samples"]])
        try:
            self.samples.publish(self._sensor.drain())
        finally:
            for *at, time_ns in message["positions"]:
                self.positions.publish(three(at), int(time_ns))


@contextmanager
def _as_tripped() -> Iterator[None]:
    """Raise a supervisor that is gone as what ends a motion, by its name."""
    try:
        yield
    except ProcessGoneError as e:
        raise Tripped(Reason.SUPERVISOR, str(e)) from e
