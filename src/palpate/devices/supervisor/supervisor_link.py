"""Stage and force sensor that a supervisor's process owns, as far as a client may use them."""

from __future__ import annotations

from collections.abc import Sequence

from palpate.core import DeviceError, Position, Travel, Wrench
from palpate.devices.supervisor.guard_messages import sample_of, three
from palpate.devices.supervisor.process_link import GoneWords, Message, ProcessLink

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
