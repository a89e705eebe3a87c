"""The palm's fast path against its exact one: frames a second, first pictures, memory, growth.

Run ``python benchmarks/sensors/palm.py``. A frame is both regions as 8-bit sRGB with the camera's noise, as
`render_views` draws them: two crops of 224 px, or the full 1420 x 420 px of fringes and 700 x 420 px of
mirror. The fast path moves pictures of depths it has marched before to contacts at many places; the exact one
marches and traces every ray anew. Presses are made beforehand, everything is in memory, and compiling, once a
machine, is not counted. Threads are as many as there are processors, or as NUMBA_NUM_THREADS says.
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.core import Contact, Pose
from palpate.sensors import palm
from palpate.sensors.palm import PalmSpec, fringe_view

DEPTHS_M = (1e-3, 3e-3, 5e-3)
PLACES = 20  # for each depth
REACH_M = 15e-3  # from the middle
ROUNDS = 5
NEW_DEPTHS_M = itertools.count(2.0101e-3, 0.01e-3)  # none of them drawn before
ALLOWED = 1e-2  # light, rms: of the fast path against the exact one at 3 mm, in the middle


def contacts(spec: PalmSpec) -> list[Contact]:
    """Contacts at many places and a few depths, in no order."""
    rng = np.random.default_rng(5)
    found = []
    for depth in DEPTHS_M * PLACES:
        away, angle = REACH_M * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
        found.append(palm.press(spec, Pose(away * np.cos(angle), away * np.sin(angle), depth)))
    return [found[i] for i in rng.permutation(len(found))]


def timed(call: Callable[[], object]) -> float:
    """Milliseconds of one call."""
    started = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - started)


def row(name: str, times: list[float], ratios: list[float] | None = None, of: str = "") -> None:
    low, median, high = np.quantile(times, [0.25, 0.5, 0.75])
    print(f"  {name:42s} {median:8.2f} ms, middle half {low:.2f} to {high:.2f}", end="")
    if ratios:
        low, median, high = np.quantile(ratios, [0.25, 0.5, 0.75])
        print(f" | {median:.3g} times {of}, middle half {low:.3g} to {high:.3g}", end="")
    print()


def checked(spec: PalmSpec) -> float:
    """Light that the fast path misses in the middle at 3 mm, rms below the dimple."""
    contact = palm.press(spec, Pose(0.0, 0.0, 3e-3))
    fast, exact = (palm.render_clean(contact, spec, exact=which)[0] for which in (False, True))
    z = spec.fringes.down_m
    error = (fast - exact)[(z > 3e-3) & (z < spec.thickness_m)]
    rms = float(np.sqrt(np.mean(error**2)))
    assert rms < ALLOWED, rms
    return rms


def frames(name: str, spec: PalmSpec, wanted: int) -> None:
    """One preset: fast, exact, and what a depth costs that was not drawn before."""
    rms = checked(spec)
    rng = np.random.default_rng(0)
    pressed = contacts(spec)
    for contact in pressed:
        palm.render_views(contact, spec, rng)  # so that each depth's pictures are kept
    fast, exact, first = [], [], []
    for _ in range(ROUNDS):  # taken in turn, so that all see the machine's other work
        fast.append([timed(lambda c=contact: palm.render_views(c, spec, rng)) for contact in pressed])  # type: ignore[misc]
        exact.append(timed(lambda: palm.render_views(pressed[0], spec, rng, exact=True)))
        new = palm.press(spec, Pose(2e-3, 1e-3, next(NEW_DEPTHS_M)))
        first.append(timed(lambda c=new: palm.render_views(c, spec, rng)))  # type: ignore[misc]
    every = [one for times in fast for one in times]
    print(f"{name}: the fast path's light differs by {rms:.1e} rms ({ALLOWED:g} is allowed)")
    row("exact path", exact)
    ratios = [a / float(np.median(b)) for a, b in zip(exact, fast, strict=True)]
    same = "as fast as the exact path"
    row("fast path, depths drawn before", every, ratios, same)
    row("fast path, a depth's first picture", first, [a / b for a, b in zip(exact, first, strict=True)], same)
    print(f"  {1e3 / float(np.median(every)):.0f} frames a second by the median ({wanted} are wanted)\n")


def growth(spec: PalmSpec) -> None:
    """The exact march of the fringes with twice the pixels, and with twice the bands."""
    w, h = spec.frame_px
    tall = replace(spec, frame_px=(w, 2 * h), fringes=spec.fringes.sampled(1, 2))
    specs = {"once": spec, "twice the pixels": tall, "twice the bands": replace(spec, bands=2 * spec.bands)}
    times: dict[str, list[float]] = {name: [] for name in specs}
    for _ in range(ROUNDS):
        for name, one in specs.items():
            times[name].append(timed(lambda s=one: fringe_view.march_fringes(s, 3e-3, 2e-3, 1e-3)))  # type: ignore[misc]
    print(f"exact march of {spec.fringes.size_px[0]} x {spec.fringes.size_px[1]} px in {spec.bands} bands")
    for name, taken in times.items():
        ratios = None if name == "once" else [a / b for a, b in zip(taken, times["once"], strict=True)]
        row(name, taken, ratios, "as long")
    print("  (2 times is linear)\n")


def peak_mb(call: Callable[[], object]) -> float:
    """Most memory held during a call beyond that before it [MB]; Linux only."""

    def held(name: str) -> float:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith(name)) * 1.024e-3

    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak begins anew
    before = held("VmRSS")
    call()
    return held("VmHWM") - before


def main() -> None:
    cores = len(os.sched_getaffinity(0))
    print(f"load {os.getloadavg()[0]:.1f} on {cores} cores\n")
    full, small = palm.palm(), palm.debug()
    rng = np.random.default_rng(0)
    palm.render_views(palm.press(small, Pose(0.0, 0.0, 1e-3)), small, rng, exact=True)  # compiled by now
    contact = palm.press(full, Pose(2e-3, 1e-3, 3e-3))
    peak = peak_mb(lambda: palm.render_views(contact, full, rng, exact=True))
    print(f"exact path of the full views: peak memory beyond that before {peak:.0f} MB (1000 are allowed)\n")
    frames("Two crops of 224 px", palm.crops(), wanted=60)
    frames("Full views", full, wanted=5)
    growth(full)
    punch = palm.press(full, Pose(2e-3, 1e-3, 0.8e-3), palm.parse_probe("punch:6"))
    print("any other probe, through the stress of linear layers")
    row("full views", [timed(lambda: palm.render_views(punch, full, rng)) for _ in range(3)])


if __name__ == "__main__":
    main()
