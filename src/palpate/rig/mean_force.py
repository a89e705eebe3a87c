"""Force of a probe that stands: its mean and noise, samples that guard a motion, and a push by hand."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from palpate.core import NS_PER_S, Clock, DeviceError, ForceSensor, Stage, Wrench
from palpate.devices import Guard, Mounting, Reason, Tripped
from palpate.devices.device_proxies import PlainForceSource
from palpate.devices.force_bias import Force, ForceBias

CHANGED_N = 0.05  # a change of force that is contact, unless the noise is larger
SIGMAS = 5.0  # of the force's noise that a threshold must lie above
MIN_SAMPLES = 25
NOISY_S = 2.0  # longest time for which a noisy sensor is heard besides
MEASURE_S = 0.1
POLL_S = 0.002
STALE_S = 0.5
PUSH_N = 0.5  # change of force by a hand that shows that the sensor measures force
PUSH_WAIT_S = 60.0  # longest wait for a push, and for its end
PUSH_MEANS = 20  # means of 0.1 s within which a push rises; a drift does not
RELEASED_N, RELEASED_SHARE = 0.1, 0.2  # force that may be left of a push
RELEASED_S = 1.0  # time for which the force stays so
AXES = "xyz"
PUSH = (
    f"Push the probe's tip towards the stage, by hand, as the skin will, with more than {PUSH_N:g} N, and "
    "let go: the stage moves only once the force sensor has responded"
)


@dataclass(frozen=True, slots=True)
class AirForce:
    """Force that the sensor reads in the air, in the skin's axes, and how that was shown.

    Attributes:
        force_n: mean of its samples [N].
        noise_n: their standard deviation along the press [N].
        rate_hz: of the samples that came [Hz].
        lifted_mm: by how far the probe was lifted [mm].
        samples: that the mean is of.
    """

    force_n: Force
    noise_n: float
    rate_hz: float
    lifted_mm: float
    samples: int = MIN_SAMPLES

    @property
    def error_n(self) -> float:
        """Standard deviation of the mean along the press [N]."""
        return self.noise_n / math.sqrt(self.samples)


class Hand(NamedTuple):
    """What a motion by hand needs: a stage, the force sensor that guards it, its mounting, and time."""

    stage: Stage
    force: ForceSensor
    mounting: Mounting
    clock: Clock

    def felt(self) -> AirForce:
        """Mean of fresh samples in the skin's axes, at a stand."""
        return mean_force(self.force, self.mounting, self.clock)

    def felt_raw(self) -> AirForce:
        """The same in the sensor's own axes."""
        return mean_force(self.force, Mounting(), self.clock)

    def distrust_position(self) -> None:
        """Let nothing move by its stored position until a person has looked: it stands in contact."""
        if callable(forget := getattr(self.stage, "forget_position", None)):
            forget("the probe could not be moved back out of contact; lift it by hand and look why")

    def felt_through(self, guard: Guard) -> AirForce:
        """Mean of fresh samples in the skin's axes, taken through a guard."""
        return guarded_mean(guard, self.force.rate_hz, self.mounting)


def contact_n(a: AirForce, b: AirForce) -> float:
    """Change between two means that noise does not explain [N]."""
    return max(CHANGED_N, SIGMAS * math.hypot(a.error_n, b.error_n))


def _difference(a: AirForce, b: AirForce) -> Force:
    x, y, z = (p - q for p, q in zip(a.force_n, b.force_n, strict=True))
    return x, y, z


class LiveSamples:
    """Samples of a force sensor that guards a motion; silence and repeated samples are detected."""

    def __init__(self, force: ForceSensor, clock: Clock) -> None:
        self._force, self._clock = force, clock
        self._patience_ns = round(max(STALE_S, MIN_SAMPLES / force.rate_hz) * NS_PER_S)
        self._newest: Wrench | None = None
        self._repeats = 0
        self._changed_ns = clock.now_ns()  # of this clock: the stamps of a faulty sensor may lie

    def take(self) -> list[Wrench]:
        """Return the samples since the last call.

        Raises:
            Tripped: A sample is faulty, or no new value came for `STALE_S` (25 samples at least).
        """
        samples = fresh_samples(self._force)
        for one in samples:
            before, self._newest = self._newest, one
            if before is None or (before.force_n, before.torque_nm) != (one.force_n, one.torque_nm):
                self._changed_ns, self._repeats = self._clock.now_ns(), 0
            else:
                self._repeats += 1
        if self._clock.now_ns() - self._changed_ns > self._patience_ns:
            reason = Reason.FORCE_STUCK if self._repeats else Reason.FORCE_STALE
            waited_s = self._patience_ns / NS_PER_S
            raise Tripped(reason, f"no new force came for {waited_s:g} s while the stage moved")
        return samples


def fresh_samples(force: ForceSensor) -> list[Wrench]:
    """Samples since the last call; one that a sensor reports as faulty, or that is no number, raises."""
    samples = PlainForceSource(force).drain()
    for one in samples:
        if one.fault:
            raise Tripped(Reason.FORCE_FAULT, f"the force sensor reports: {one.fault}")
    return samples


def mean_force(force: ForceSensor, mounting: Mounting, clock: Clock, *, brief: bool = False) -> AirForce:
    """Mean of fresh samples, at a stand; on a busy computer samples are waited for up to `STALE_S`.

    A noisy sensor is heard longer, by `NOISY_S` at most, so that its mean tells a contact that a quiet one
    would.

    Args:
        force: sensor, at a stand.
        mounting: of the sensor.
        clock: of the sensor.
        brief: do not hear a noisy sensor longer: a push by hand looks like noise.

    Raises:
        Tripped: too few come, they are faulty, or all of them are the same in every channel.
    """
    discard(force)
    began_ns = clock.now_ns()
    seconds = max(MEASURE_S, 1.5 * MIN_SAMPLES / force.rate_hz)
    clock.sleep(seconds)
    samples = PlainForceSource(force).drain()
    while len(samples) < MIN_SAMPLES and clock.now_ns() - began_ns < (seconds + STALE_S) * NS_PER_S:
        clock.sleep(POLL_S)
        samples += PlainForceSource(force).drain()

    def listen(seconds: float) -> list[Wrench]:
        clock.sleep(seconds)
        return PlainForceSource(force).drain()

    found = _mean_of(samples, None if brief else listen, force.rate_hz, mounting)
    if len({(one.force_n, one.torque_nm) for one in samples if not one.fault}) == 1:
        raise Tripped(
            Reason.FORCE_NOISE,
            f"the force sensor gave {len(samples)} equal samples, in every channel: it does not measure, or "
            "is too coarse to guard a motion; push it by hand and look",
        )
    taken_s = max((clock.now_ns() - began_ns) / NS_PER_S, 1e-9)
    return replace(found, rate_hz=len(samples) / taken_s)


def guarded_mean(guard: Guard, rate_hz: float, mounting: Mounting, wait_s: float = MEASURE_S) -> AirForce:
    """Mean of fresh samples, at a stand, taken through the guard, which misses none of them then.

    Args:
        guard: Of the stage.
        rate_hz: Rate of the force sensor [Hz].
        mounting: Of the sensor; the zero of the guard is not subtracted.
        wait_s: Least time of listening [s].

    Raises:
        Tripped: too few samples come, or they are faulty.
    """

    def listen(seconds: float) -> list[Wrench]:
        return [*guard.wait(seconds, judged=False)]

    guard.look(judged=False)  # older samples belong to another position
    samples = listen(max(wait_s, 1.5 * MIN_SAMPLES / rate_hz))
    if len(samples) < MIN_SAMPLES:  # on a busy computer
        samples += listen(STALE_S)
    return _mean_of(samples, listen, rate_hz, mounting)


def _mean_of(
    samples: list[Wrench],
    listen: Callable[[float], list[Wrench]] | None,
    rate_hz: float,
    mounting: Mounting,
) -> AirForce:
    """Mean of samples; of a noisy sensor so many more that it tells a contact that a quiet one would."""
    bias = ForceBias(mounting)
    bias.measure(samples)
    wanted = 2 * (SIGMAS * bias.noise_n / CHANGED_N) ** 2
    if listen and wanted > len(samples):
        samples += listen(min((wanted - len(samples)) / rate_hz, NOISY_S))
        bias.measure(samples)
    return AirForce(bias.force_n, bias.noise_n, rate_hz, 0.0, len(samples))


def discard(force: ForceSensor) -> None:
    """Drop the samples that came before now, and do not mind those that were lost while nobody asked.

    Raises:
        DeviceError: the sensor has failed.
    """
    try:
        force.drain()
    except DeviceError:  # more came than are kept, as while a person reads; it says so once
        force.drain()


def await_push(force: ForceSensor, clock: Clock, axis: int | None = None) -> Force:
    """Wait until the force sensor responds to a push by hand, and until the hand is gone.

    Noise alone does not show that a sensor measures force: one with a broken bridge has noise too, and a
    search for the skin that it guards ends deep in the skin. A push rises within two seconds and leaves no
    force behind, so that a drift or a jump is none. `PUSH` is what to tell the operator.

    Args:
        axis: Axis of the sensor along which the push must be felt: 0, 1, or 2; None for any.

    Returns:
        Change of force by the push, in the sensor's own axes [N].

    Raises:
        Tripped: No response within `PUSH_WAIT_S` (`FORCE_DEAD`), or the force does not return to what it was
            (`FORCE_NOISE`).
    """
    end_ns = clock.now_ns() + round(PUSH_WAIT_S * NS_PER_S)
    means: deque[AirForce] = deque([mean_force(force, Mounting(), clock, brief=True)], maxlen=PUSH_MEANS)
    while True:
        now = mean_force(force, Mounting(), clock, brief=True)
        for before in means:
            push = _difference(now, before)
            felt_n = math.hypot(*push) if axis is None else abs(push[axis])
            if felt_n >= max(PUSH_N, contact_n(now, before)):
                return _released(force, clock, before, push, axis)
        means.append(now)
        if clock.now_ns() > end_ns:
            raise Tripped(
                Reason.FORCE_DEAD,
                f"the force sensor did not respond to a push by hand of more than {PUSH_N:g} N "
                f"{'' if axis is None else f'along its {AXES[axis]} '}within {PUSH_WAIT_S:g} s, so nothing "
                "moved; check its cable, its axes, and its load path, then repeat",
            )


def _released(force: ForceSensor, clock: Clock, rest: AirForce, push: Force, axis: int | None) -> Force:
    """Wait until the force has been what it was before a push for `RELEASED_S`; the greatest change [N]."""
    end_ns = clock.now_ns() + round(PUSH_WAIT_S * NS_PER_S)
    since_ns = clock.now_ns()
    while clock.now_ns() - since_ns < RELEASED_S * NS_PER_S:
        now = mean_force(force, Mounting(), clock, brief=True)
        change = _difference(now, rest)
        push = max(push, change, key=lambda one: math.hypot(*one) if axis is None else abs(one[axis]))
        if math.hypot(*change) > max(RELEASED_N, RELEASED_SHARE * math.hypot(*push), contact_n(now, rest)):
            since_ns = clock.now_ns()
        if clock.now_ns() > end_ns:
            raise Tripped(
                Reason.FORCE_NOISE,
                f"the force did not return to what it was before the push by hand within {PUSH_WAIT_S:g} s, "
                f"so nothing moved: it is {math.hypot(*change):.2f} N away. Let go of the probe, or let the "
                "sensor warm up, then repeat",
            )
    return push
