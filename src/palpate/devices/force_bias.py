"""Force in the skin's axes from a sample in the sensor's own: signs, and the bias in software.

The convention, stated once: z into the skin, and the normal force is positive in compression; x and y are the
force of the probe on the skin. The bias is the mean of samples without contact, taken off here and never in
the device; raw samples are recorded beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.core import RangeError, Wrench
from palpate.devices.motion_limits import Reason, Tripped

MIN_SAMPLES = 20  # for a mean that is worth taking off

Force = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Mounting:
    """Orientation of the sensor: for the skin's x, y and z, which of the device's axes, and its sign.

    Attributes:
        axes: such as ("x", "y", "-z"), where a device pushed along its own +z reads negative in compression.
    """

    axes: tuple[str, str, str] = ("x", "y", "z")

    def __post_init__(self) -> None:
        letters = [axis.lstrip("+-") for axis in self.axes]
        if sorted(letters) != ["x", "y", "z"] or any(len(axis) > 2 for axis in self.axes):
            raise RangeError(
                f"a sensor mounted as {self.axes}; name x, y and z once each, with + or - before"
            )

    @property
    def normal(self) -> int:
        """Which of the device's axes lies along the press: 0, 1 or 2."""
        return "xyz".index(self.axes[2].lstrip("+-"))

    def to_skin(self, vector: Sequence[float]) -> Force:
        """A device's vector in the skin's axes."""
        x, y, z = self.axes
        return _along(x, vector), _along(y, vector), _along(z, vector)


@dataclass(slots=True)
class ForceBias:
    """Force and torque that the sensor reads without contact, in the skin's axes.

    Attributes:
        mounting: of the sensor.
        force_n, torque_nm: taken off every sample.
        noise_n: standard deviation along z while it was measured [N].
    """

    mounting: Mounting = field(default_factory=Mounting)
    force_n: Force = (0.0, 0.0, 0.0)
    torque_nm: Force = (0.0, 0.0, 0.0)
    noise_n: float = 0.0

    def measure(self, samples: Sequence[Wrench]) -> None:
        """Set it from samples taken without contact."""
        good = [one for one in samples if not one.fault]
        faults = {one.fault for one in samples if one.fault}
        if len(good) < MIN_SAMPLES and faults:
            raise Tripped(Reason.FORCE_FAULT, f"the force sensor says: {', '.join(sorted(faults))}")
        if len(good) < MIN_SAMPLES:
            raise Tripped(
                Reason.FORCE_STALE,
                f"{len(good)} good force samples for the zero of {MIN_SAMPLES}: is the sensor streaming?",
            )
        force = np.array([self.mounting.to_skin(one.force_n) for one in good])
        torque = np.array([self.mounting.to_skin(one.torque_nm) for one in good])
        fx, fy, fz = force.mean(axis=0).tolist()
        tx, ty, tz = torque.mean(axis=0).tolist()
        self.force_n, self.torque_nm = (fx, fy, fz), (tx, ty, tz)
        self.noise_n = float(force[:, 2].std(ddof=1))

    def force(self, sample: Wrench) -> Force:
        """Force of a sample, in the skin's axes, without the bias [N]."""
        x, y, z = self.mounting.to_skin(sample.force_n)
        return x - self.force_n[0], y - self.force_n[1], z - self.force_n[2]

    def torque(self, sample: Wrench) -> Force:
        """Torque of a sample, in the skin's axes, without the bias [Nm]."""
        x, y, z = self.mounting.to_skin(sample.torque_nm)
        return x - self.torque_nm[0], y - self.torque_nm[1], z - self.torque_nm[2]


def _along(axis: str, vector: Sequence[float]) -> float:
    value = vector["xyz".index(axis[-1])]
    return -value if axis[0] == "-" else value
