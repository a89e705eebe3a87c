"""From the devices to the run: force at its own rate, raw and in the skin's axes, stage, frames, events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from palpate.core.device_protocols import Position, Wrench
from palpate.core.frame import Frame
from palpate.devices.force_bias import ForceBias
from palpate.recordings.labels import Label
from palpate.recordings.run_writer import RunWriter


class Recorder:
    """Writes what the rig sees; what the disk refuses is raised where the next thing is recorded."""

    def __init__(self, writer: RunWriter, bias: ForceBias, begun_ns: int) -> None:
        """Args: of what was before `begun_ns` nothing is recorded."""
        self._begun_ns = begun_ns
        self._writer = writer
        self._bias = bias
        self._muted = False

    def mute(self) -> None:
        """Record nothing more: the disk has refused, and the probe is still to be lifted."""
        self._muted = True

    def force(self, samples: Sequence[Wrench]) -> None:
        """Every good sample; faulty ones hold no numbers."""
        for one in samples:
            if not one.fault and not self._muted and one.time_ns >= self._begun_ns:
                force, torque = self._bias.force(one), self._bias.torque(one)
                self._writer.force((*force, *torque), time_ns=one.time_ns)
                self._writer.force((*one.force_n, *one.torque_nm), time_ns=one.time_ns, raw=True)

    def stage(self, position_m: Position, time_ns: int) -> None:
        """Where the stage is."""
        if not self._muted:
            self._writer.stage(position_m, time_ns=time_ns)

    def frame(self, frame: Frame, time_ns: int, labels: Mapping[str, Label]) -> bool:
        """A frame and what is known of it; False where it was dropped."""
        return self._writer.frame(frame.image, time_ns=time_ns, exposure_s=frame.exposure_s, labels=labels)

    def event(self, kind: str, **fields: Any) -> None:
        """That something happened."""
        if not self._muted:
            self._writer.event(kind, **fields)
