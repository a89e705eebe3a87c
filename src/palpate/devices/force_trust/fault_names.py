"""Name of a force sensor's fault, from what it read before a doubt and reads afterwards, at a stand."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palpate.core import Float, Wrench, ndarray
from palpate.devices.force_bias import ForceBias
from palpate.devices.force_trust.air_noise import AirNoise, six_of
from palpate.devices.force_trust.force_monitor import Doubt
from palpate.devices.motion_limits import Reason

LEVEL = 8  # samples of a level
SIZE = 6.0  # noises that a level differs by
LEAPT = 4.0  # noises of the air, of a sensor that is noisy now
FELL = 0.35  # and of one that is quiet
MIRRORED = 4.0  # by which a force that changed its sign may be more or less than before: the stage runs on
LEVEL_SIZE = 2.0  # noises that the means of some samples may differ by
LAST = 3  # samples of the force just before
SCALED_OFF = 0.02  # of the change, by which all axes may differ from one scale
MIN_SCALE = 0.2  # relative: a smaller change may be the force's own
CAME = 0.5  # of the samples that were due, of a sensor that holds them back rather than measures slowly

Named = tuple[Reason, str]
RISES: dict[str, Named] = {
    "rise": (Reason.FORCE_LIMIT, "is the stage's z turned round?"),
    "struck": (Reason.TOUCHED_EARLY, "does the probe touch something?"),
}
Vector = Float[ndarray, " _"]


def name_fault(
    doubt: Doubt, after: Sequence[Wrench], air: AirNoise | None, bias: ForceBias, listened_s: float
) -> Named:
    """Name what was doubted.

    Args:
        doubt: and the samples before it.
        after: all samples from the doubted one on, oldest first.
        air: what the sensor read in the air; None where nobody knows, as for a rise before the first zero.
        bias: of the sensor.
        listened_s: for how long samples were waited for after the doubt [s].

    Returns:
        The reason, and the doubt with what followed, in words.
    """
    good = [one for one in after if not one.fault]
    reason, words = RISES[doubt.kind] if air is None else _named(doubt, good, air, bias, listened_s)
    return reason, f"{doubt.text}: {words}"


def _named(doubt: Doubt, after: Sequence[Wrench], air: AirNoise, bias: ForceBias, listened_s: float) -> Named:
    if doubt.kind in ("gap", "late"):
        return _of_time(after, air, listened_s)
    six = np.array([six_of(one) for one in after[-40:]])
    if not len(six):
        return Reason.FORCE_STALE, "nothing came after it"
    if len(six) > 1 and not np.diff(six, axis=0).any() and not six.any():
        return Reason.FORCE_DEAD, "the sensor reads zero on all six axes"
    return _of_level(doubt, six, air, bias)


def _of_time(after: Sequence[Wrench], air: AirNoise, listened_s: float) -> Named:
    if not after:
        return Reason.FORCE_STALE, "and nothing came afterwards; is the sensor streaming?"
    came = len(after) * air.period_s / max(listened_s, air.period_s)
    rate = f"{len(after)} samples came in {listened_s * 1e3:.0f} ms"
    if came < CAME:
        return Reason.FORCE_SLOW, f"{rate}, where {1 / air.period_s:.0f} a second came in the air"
    return Reason.FORCE_LATE, f"{rate}, so none is lost: they are held back on their way"


def _of_level(doubt: Doubt, six: Float[ndarray, "n 6"], air: AirNoise, bias: ForceBias) -> Named:
    noise = max(air.noise_n)
    now = six[-LEVEL:].mean(axis=0)
    was = np.mean([one for _, one in doubt.before[-LEVEL:]], axis=0) if doubt.before else np.array(air.mean)
    last = np.mean([one for _, one in doubt.before[-LAST:]], axis=0) if doubt.before else was
    force_now, force_was = _normal(now, bias), _normal(last, bias)
    spread = _spread(six[:, :3], air)
    equal = len(six) > 1 and not np.diff(six, axis=0).any()
    changed = math.dist(now[:3], was[:3]) > SIZE * noise
    if spread > LEAPT:
        return Reason.FORCE_NOISE, f"the noise is {spread:.1f} times that in the air"
    if equal and doubt.before and tuple(six[-1].tolist()) == doubt.before[-1][1]:
        return Reason.FORCE_STUCK, "the sensor repeats what it read and measures no more"
    if changed and doubt.kind != "pull" and (scale := _scale(was[:3], now[:3], noise)) is not None:
        return (
            Reason.FORCE_SCALED,
            f"all axes read {scale:.3g} times what they did: a gain or unit has changed",
        )
    if doubt.kind == "pull" or (force_now < -SIZE * noise and _mirrored(force_now, force_was, noise)):
        return (
            Reason.FORCE_REVERSED,
            "the sign of the normal force is the other one; look at the sensor's axes and mounting",
        )
    if changed and _gone(now, force_was, air, noise):
        return Reason.FORCE_DEAD, "the sensor reads as in the air and feels nothing any more"
    if equal:
        return Reason.FORCE_STUCK, "the sensor repeats what it read and measures no more"
    if doubt.kind in ("soft", "stiff"):
        return (
            Reason.STIFFNESS,
            "the sensor's gain, the skin, or the indenter is another one than stated; weigh a known mass",
        )
    if doubt.kind in ("flat", "holds", "lost", "repeats"):
        return Reason.FORCE_DEAD, "the sensor does not follow the contact any more; does the tool still hold?"
    if doubt.kind in RISES:
        return RISES[doubt.kind]
    if spread < FELL:
        return Reason.FORCE_NOISE, f"the noise is {spread:.2f} of that in the air: does it still measure?"
    return (
        Reason.FORCE_IMPLAUSIBLE,
        "no motion explains it; look at the tool, the sensor's cable and what the probe may have struck",
    )


def _normal(six: Vector, bias: ForceBias) -> float:
    x, y, z, tx, ty, tz = six.tolist()
    return bias.force(Wrench(0, (x, y, z), (tx, ty, tz)))[2]


def _spread(force: Float[ndarray, "n 3"], air: AirNoise) -> float:
    """Noise over that in the air, by second differences, the axes together; 1 where too few came."""
    if len(force) < LEVEL:
        return 1.0
    second = np.diff(force, 2, axis=0) / (math.sqrt(6) * np.array(air.noise_n))
    return float(np.sqrt(np.mean(second**2)))


def _mirrored(force_now: float, force_was: float, noise: float) -> bool:
    """Whether a push has become a pull of about its size."""
    least, most = force_was / MIRRORED, force_was * MIRRORED
    return force_was > 0 and least - SIZE * noise <= -force_now <= most + SIZE * noise


def _gone(now: Vector, force_was: float, air: AirNoise, noise: float) -> bool:
    """Whether a contact was felt, and all axes read as in the air now."""
    return force_was > SIZE * noise and math.dist(now[:3], air.mean[:3]) < SIZE * noise


def _scale(was: Vector, now: Vector, noise: float) -> float | None:
    """Scale by which all axes have changed together; None where they have not, or only one axis tells."""
    size2 = float(was @ was)
    if size2 == 0 or np.sum(np.abs(was) > SIZE * noise) < 2:
        return None
    scale = float(was @ now) / size2
    off = float(np.linalg.norm(now - scale * was))
    if (
        scale > 0
        and abs(scale - 1) > MIN_SCALE
        and off <= LEVEL_SIZE * noise + SCALED_OFF * float(np.linalg.norm(now - was))
    ):
        return scale
    return None
