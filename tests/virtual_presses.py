"""Presses of the virtual TacTip for tests: from rendered frames, or from ideal marker centres with noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palpate.calibration.compliance.compliance_calibration import ReferenceSpecimen, ReferenceTrial
from palpate.estimators.compliance.pin_press import UNTOUCHED_N, PinPress, follow_press
from palpate.estimators.compliance.stiffness_curve import (
    CONTACT_N,
    loading,
    moving_average,
    within,
    without_spikes,
)
from palpate.sensors.tactip import TacTipSpec
from palpate.workflows.tactip_trials import VirtualPress, record_press, stiffness_of

KAPPA_N_M = {"rigid": float("inf"), "S1": 7.6e3, "S2": 3.1e3, "S3": 1.1e3, "new": 5.3e3}
REFERENCES = ("rigid", "S1", "S2", "S3")
NOISE_PX = 0.02  # of a pin's centre, as it is found in a frame


def seen(made: VirtualPress) -> ReferenceTrial:
    """Frames rendered, pins followed."""
    press = follow_press(list(made.frames()), made.raw_n, made.frame_sample, made.position_m, made.time_s)
    return ReferenceTrial(press, made.true_area_m2[made.frame_sample[press.frame]])


def ideal(made: VirtualPress, noise_px: float = NOISE_PX) -> ReferenceTrial:
    """True centres with noise, at the frames that `follow_press` would use; no frame is rendered."""
    rng = np.random.default_rng([made.seed, 1])
    smooth = moving_average(without_spikes(made.raw_n))
    part = loading(smooth)
    at = made.frame_sample
    used = np.flatnonzero(np.isin(at, within(smooth, part, CONTACT_N, np.inf)))
    still = max(1, int(np.argmax(smooth[at] >= UNTOUCHED_N)) - 1)

    def centres(frame: int, noise: float) -> np.ndarray:
        true, _ = made.points_px(frame)
        return true + noise * rng.standard_normal(true.shape)

    untouched = centres(0, noise_px / np.sqrt(still))  # mean of the frames before contact
    xy = np.stack([centres(int(frame), noise_px) for frame in used])
    position, time = made.position_m[at[used]] - made.position_m[part.first], made.time_s[at[used]]
    press = PinPress(
        used,
        smooth[at[used]],
        untouched,
        xy - untouched,
        position,
        float((position[-1] - position[0]) / (time[-1] - time[0])),
        (),
        time_s=time,
    )
    return ReferenceTrial(press, made.true_area_m2[at[used]])


def pressed(
    spec: TacTipSpec, specimen: str, count: int, seed: int, *, rendered: bool = True
) -> tuple[ReferenceTrial, ...]:
    """Some trials on one specimen."""
    make = seen if rendered else ideal
    return tuple(make(record_press(spec, specimen, seed + k)) for k in range(count))


def references(
    spec: TacTipSpec,
    specimens: dict[str, str],
    trials: int,
    seed: int,
    *,
    rendered: bool = True,
    names: tuple[str, ...] = REFERENCES,
) -> list[ReferenceSpecimen]:
    """Trials of the references, each with seeds of its own."""
    return [
        ReferenceSpecimen(
            name,
            stiffness_of(specimens[name]),
            pressed(spec, specimens[name], trials, seed + 100 * i, rendered=rendered),
        )
        for i, name in enumerate(names)
    ]


def without_area(given: list[ReferenceSpecimen]) -> list[ReferenceSpecimen]:
    """The same where nobody knows the contact's area."""
    return [replace(r, trials=tuple(replace(t, area_m2=None) for t in r.trials)) for r in given]
