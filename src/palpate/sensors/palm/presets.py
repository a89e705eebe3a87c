"""Named palms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from palpate.core.errors import InputError
from palpate.optics.stress_optic import StressOpticLaw
from palpate.sensors.palm.spec import PalmSpec


def palm() -> PalmSpec:
    """The palm as reported, at full size."""
    return PalmSpec()


def small() -> PalmSpec:
    """A quarter of the pixels each way: what networks are fed."""
    return shrunk(palm(), 4, "palm-small")


def demo() -> PalmSpec:
    """A sixth of the pixels each way: what the demo records."""
    return shrunk(palm(), 6, "palm-demo")


def debug() -> PalmSpec:
    """A tenth of the pixels each way: for tests, and for finding faults."""
    return shrunk(palm(), 10, "palm-debug")


def crops() -> PalmSpec:
    """Both regions squeezed to 224 px each way, side by side: the report's input to its networks."""
    return cropped(palm(), 224, "palm-crops")


def solaris() -> PalmSpec:
    """The report's choice; the same as `palm`."""
    return replace(palm(), name="palm-solaris")


def sylgard_184() -> PalmSpec:
    """Stiffer, and of ordinary silicone's stress-optic coefficient; E and C of the order usually printed."""
    return replace(
        palm(), youngs_modulus_pa=1.8e6, stress_optic=StressOpticLaw(1.7e-10), name="palm-sylgard-184"
    )


def casting_resin() -> PalmSpec:
    """Hard: a grasp hardly dents it. E and C of the order of a cured epoxy's; nu that of the tables."""
    return replace(
        palm(),
        youngs_modulus_pa=2.5e9,
        stress_optic=StressOpticLaw(5.5e-11),
        refractive_index=1.55,
        name="palm-casting-resin",
    )


def shrunk(spec: PalmSpec, by: int, name: str) -> PalmSpec:
    """The same palm seen by a camera of fewer pixels, each of them the mean of four rays."""
    w, h = spec.frame_px
    return replace(
        spec,
        frame_px=(w // by, h // by),
        fringes=spec.fringes.sampled(1 / by, 1 / by),
        mirror=spec.mirror.sampled(1 / by, 1 / by),
        rays_per_pixel=(2, 2),
        name=name,
    )


def cropped(spec: PalmSpec, side_px: int, name: str) -> PalmSpec:
    """The same palm, both regions squeezed to squares that fill the frame: fringes left, mirror right."""
    views = (
        replace(
            view.sampled(side_px / view.size_px[0], side_px / view.size_px[1]),
            box_px=(left, 0, side_px, side_px),
        )
        for left, view in ((0, spec.fringes), (side_px, spec.mirror))
    )
    fringes, mirror = views
    across, down = (max(2, round(size / side_px / 2)) for size in spec.fringes.size_px)
    return replace(
        spec,
        frame_px=(2 * side_px, side_px),
        fringes=fringes,
        mirror=mirror,
        rays_per_pixel=(across, down),
        name=name,
    )


PRESETS: dict[str, Callable[[], PalmSpec]] = {
    "palm": palm,
    "small": small,
    "demo": demo,
    "debug": debug,
    "crops": crops,
    "solaris": solaris,
    "sylgard-184": sylgard_184,
    "casting-resin": casting_resin,
}


def preset(name: str) -> PalmSpec:
    """A palm by name.

    Raises:
        InputError: there is none of that name; the message lists those there are.
    """
    if name not in PRESETS:
        raise InputError(f"there is no palm {name!r}; there are {', '.join(PRESETS)}")
    return PRESETS[name]()


__all__ = [
    "PRESETS",
    "casting_resin",
    "cropped",
    "crops",
    "debug",
    "demo",
    "palm",
    "preset",
    "shrunk",
    "small",
    "solaris",
    "sylgard_184",
]
