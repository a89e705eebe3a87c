"""Presses by their pins' centres, without frames: one virtual press, read under any nuisances.

The centres are the true ones with noise. Everything else is as `record_press` and `press_of_centres` have it:
seating, the force's noise and steps, the camera's phase, the frames that are used. A press is made once, and
each nuisance is laid over what was recorded: the force's zero and scale, how late frames are, how far all
pins move, how far the frame yields.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from palpate.calibration.compliance.compliance_calibration import ReferenceTrial
from palpate.core import Float, Int, ndarray
from palpate.estimators.compliance.pin_press import PinPress, press_of_centres
from palpate.workflows.tactip_trials import VirtualPress

NOISE_PX = {127: 0.012, 331: 0.018}  # of a centre along an axis as it is found in rendered frames, by pins
STATES = 18  # depths between which centres are read


@dataclass(frozen=True)
class CentrePress:
    """A virtual press and its pins' centres."""

    made: VirtualPress

    @cached_property
    def _centres(self) -> tuple[Float[ndarray, "p 2"], CubicSpline]:
        """Centres in the air, and over the cube root of force in the contact [px]."""
        made = self.made
        touched = np.flatnonzero(made.true_force_n > 0)
        level = np.cbrt(made.true_force_n[touched])
        wanted = np.linspace(level[0], level[-1], STATES)
        at = np.unique(touched[np.clip(np.searchsorted(level, wanted), 0, len(level) - 1)])
        contacts = [made._contact(int(i)) for i in at]
        xy = np.stack([made.sensor.markers_px(one, made.seating)[0] for one in contacts])
        still, _ = made.sensor.markers_px(made._contact(0), made.seating)
        return still, CubicSpline(np.cbrt(made.true_force_n[at]), xy)

    def trial(self) -> ReferenceTrial:
        """The press without nuisances, and the true area at its frames."""
        press = self.press({})
        return ReferenceTrial(press, self.true_area_m2(press))

    def true_area_m2(self, press: PinPress) -> Float[ndarray, " f"]:
        """Area of the contact at the frames of a press, when they were taken by their times [m^2]."""
        return self.made.true_area_m2[self.made.frame_sample[press.frame]]

    def press(self, sizes: Mapping[str, float]) -> PinPress:
        """The press with nuisances of these sizes, by their fields in `Nuisances`; here they
        may be negative.
        """
        made = self.made
        late = made.time_s[made.frame_sample] - sizes.get("late_s", 0.0)
        shown = np.cbrt(np.interp(late, made.time_s, made.true_force_n))
        still, spline = self._centres
        rng, noise_px = np.random.default_rng([made.seed, 1]), NOISE_PX[made.sensor.spec.pins.count]
        lever = 1 + sizes.get("lever", 0.0)

        def centres(used: Int[ndarray, " u"]) -> Float[ndarray, "f p 2"]:
            levels = shown[: used[-1] + 1]
            xy = spline(np.maximum(levels, spline.x[0]))
            young = levels < spline.x[0]
            xy[young] = still + (levels[young] / spline.x[0])[:, None, None] ** 2 * (xy[young] - still)
            return still + lever * (xy - still) + noise_px * rng.standard_normal(xy.shape)

        return press_of_centres(
            centres,
            made.raw_n * (1 + sizes.get("force_gain", 0.0)) + sizes.get("force_bias_n", 0.0),
            made.frame_sample,
            made.position_m + sizes.get("frame_yield_m_n", 0.0) * made.true_force_n,
            made.time_s,
        )
