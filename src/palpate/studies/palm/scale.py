"""How large the study is: what is recorded, at which size it is seen, and how long models learn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from palpate.core.errors import InputError
from palpate.rig.plans import Scattered, Stepped

MODELS = ("palm-joint-raw", "palm-force-conditioned", "palm-mlp-delta", "palm-two-stage", "palm-compact")
"""The source's four, in its order, and ours."""

WITHIN_MM, PROBE_MM = 20.5, 10.0
"""How far from the middle the places off the grid lie. The grid ends at 21 mm: farther out a reading
is beyond the calibrated range, and marked so."""

SMALL_NETWORK: Mapping[str, Any] = MappingProxyType({"rendered": 0, "epochs": 60, "batch": 32})
"""palm-compact on recorded presses alone: where one architecture is trained many times over."""


@dataclass(frozen=True, slots=True)
class Scale:
    """One size of the study.

    Attributes:
        name: as it is asked for.
        side_px: of each view, as models see it [px].
        frame_px: of each view, as the camera takes it [px].
        cycles, step_mm, depth_mm, frames: of the protocol at the grid's 37 places; see `Stepped`.
        places: off the grid, pressed once each in a campaign of their own, every `new_step_mm`; for the many
            conditions that are only tested under, every `coarse_step_mm`.
        options: model -> settings that are not its defaults.
        small: settings of the architecture that is trained many times over.
        loads: pictures of each kind of contact that is not one upright ball.
        folds: parts that the grid's places are dealt into; one is held out.
    """

    name: str
    side_px: int
    frame_px: int
    cycles: int
    step_mm: float
    depth_mm: float
    frames: int
    places: int
    new_step_mm: float
    coarse_step_mm: float
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    small: Mapping[str, Any] = field(default_factory=lambda: SMALL_NETWORK)
    loads: int = 60
    folds: int = 5

    def protocol(self) -> Stepped:
        """The palm's, at its 37 places."""
        return Stepped(
            name="palm-protocol",
            cycles=self.cycles,
            step_mm=self.step_mm,
            depth_mm=self.depth_mm,
            frames=self.frames,
            reference_frames=1,
        )

    def new_places(self, seed: int, *, coarse: bool = False) -> Stepped:
        """Places off the grid, in one cycle."""
        return Stepped(
            name="palm-new-places",
            places=Scattered(
                kind="scattered",
                count=self.places,
                apart_mm=2.0,
                seed=seed,
                layer_mm=2 * WITHIN_MM + PROBE_MM,
            ),
            cycles=1,
            step_mm=self.coarse_step_mm if coarse else self.new_step_mm,
            # Taps set the clocks by what the camera sees of them: without a membrane it sees nothing.
            **({"taps": 0} if coarse else {}),
            depth_mm=self.depth_mm,
            frames=1,
            reference_frames=1,
        )


SMALL = Scale(
    name="small",
    side_px=96,
    frame_px=96,
    cycles=2,
    step_mm=0.4,
    depth_mm=4.8,
    frames=1,
    places=24,
    new_step_mm=0.4,
    coarse_step_mm=1.2,
    options={"palm-compact": {"processes": 2}},
    loads=240,
)
FULL = Scale(
    name="full",
    side_px=128,
    frame_px=128,
    cycles=5,
    step_mm=0.1,
    depth_mm=5.0,
    frames=5,
    places=60,
    new_step_mm=0.2,
    coarse_step_mm=0.5,
    options={"palm-compact": {"rendered": 60_000, "epochs": 30, "processes": 8}},
    loads=1000,
)
SCALES: Mapping[str, Scale] = MappingProxyType({scale.name: scale for scale in (SMALL, FULL)})
"""`small` is for two cores, `full` for a GPU. The source records 25 frames at each depth; they
differ by the camera's noise alone, and `full` takes five."""


def scale_of(name: str) -> Scale:
    """A scale by name.

    Raises:
        InputError: there is none of that name.
    """
    if name not in SCALES:
        raise InputError(f"there is no scale {name!r}; there are {', '.join(SCALES)}")
    return SCALES[name]
