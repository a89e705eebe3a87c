"""The fused march against the plain way to do it: complex 2 x 2 matrices in numpy, one slice after the other.

Run ``python benchmarks/optics/march.py``. 256 x 256 pixels, 64 slices, 3 wavelengths, the same slices and the
same light on both sides; arrays are in memory. Then the exact path of a whole 1420 x 420 image, which samples
an axisymmetric table of stress on 64 slices in 31 bands, and how much memory it takes beyond what was there.
Compiling, once a machine, is not counted.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from palpate.optics import (
    AxisymmetricField,
    MarchedRays,
    Rays,
    StressOpticLaw,
    assumed_camera,
    march_axisymmetric,
    march_spectral,
    plane_amplitude,
)

SIDE_PX, SLICES = 256, 64
WAVELENGTHS = np.array([630e-9, 535e-9, 465e-9])
LAW = StressOpticLaw(3e-9)
POLARISER = np.pi / 4
ROUNDS = 5
WIDE, HIGH, RADIUS, THICKNESS = 1420, 420, 28.5e-3, 10e-3


def slices() -> tuple[np.ndarray, np.ndarray]:
    """Slices under something like a point load, up to about 5 fringes [slices, h, w], in Pa m."""
    x, z = np.meshgrid(np.linspace(-5e-3, 5e-3, SIDE_PX), np.linspace(0.5e-3, 8e-3, SIDE_PX))
    y = np.linspace(-10e-3, 10e-3, SLICES)[:, None, None]
    step = 20e-3 / SLICES
    fall = 0.6 * z / (x**2 + y**2 + z**2 + 1e-6) ** 2.5 * step
    turn = 0.5 * np.sin(y / 4e-3)  # so that the axes turn along the ray
    u, v = fall * (x**2 - z**2), fall * 2 * x * z
    return u * np.cos(turn) - v * np.sin(turn), u * np.sin(turn) + v * np.cos(turn)


def matrices(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Dark-field light [bands, h, w] by products of complex matrices."""
    light = []
    for half_phase in LAW.half_phase(WAVELENGTHS):
        whole = np.broadcast_to(np.eye(2, dtype=complex), (SIDE_PX, SIDE_PX, 2, 2))
        for a, b in zip(u, v, strict=True):
            phase, theta = half_phase * np.hypot(a, b), np.arctan2(b, a) / 2
            c, s = np.cos(theta), np.sin(theta)
            fast, slow = np.exp(1j * phase), np.exp(-1j * phase)
            plate = np.empty((SIDE_PX, SIDE_PX, 2, 2), dtype=complex)
            plate[..., 0, 0] = fast * c**2 + slow * s**2
            plate[..., 1, 1] = fast * s**2 + slow * c**2
            plate[..., 0, 1] = plate[..., 1, 0] = (fast - slow) * c * s
            whole = plate @ whole
        c, s = np.cos(POLARISER), np.sin(POLARISER)
        light.append(abs(np.array([-s, c]) @ (whole @ np.array([c, s]))[..., None])[..., 0] ** 2)
    return np.stack(light)


def timed(call: Callable[[], object], repeats: int) -> float:
    """Milliseconds of the median of a few calls."""
    taken = []
    for _ in range(repeats):
        started = time.perf_counter()
        call()
        taken.append(time.perf_counter() - started)
    return 1e3 * float(np.median(taken))


def row(name: str, times: list[float], ratios: list[float] | None = None) -> None:
    low, median, high = np.quantile(times, [0.25, 0.5, 0.75])
    print(f"{name:34s} {median:9.2f} ms, middle half {low:.2f} to {high:.2f}", end="")
    if ratios:
        low, median, high = np.quantile(ratios, [0.25, 0.5, 0.75])
        print(f" | {median:.0f} times, middle half {low:.0f} to {high:.0f}", end="")
    print()


def full_image(threads: int) -> MarchedRays:
    r, zeta = np.linspace(0, 1, 200) ** 1.5 * RADIUS, np.linspace(0, 1, 80) ** 1.5
    surface = 2e-3 * np.exp(-((r / 4e-3) ** 2))
    z = zeta[:, None] * (THICKNESS - surface)
    decay = 1e5 * 9e-6 / (r**2 + z**2 + 4e-6) ** 2
    stress = np.stack([-decay * r**2, -0.2 * decay * r**2, -decay * z**2, -decay * r * z])
    x = (np.arange(WIDE) + 0.5 - WIDE / 2) * 40e-3 / WIDE
    z = ((np.arange(HIGH) + 0.5) * 11.8e-3 / HIGH - 1e-3)[:, None]
    half = np.sqrt(RADIUS**2 - x**2)
    rays = Rays(x, z, -half, half, np.sqrt(x**2 + z**2 + 9e-6))
    spectrum = assumed_camera()
    return march_axisymmetric(
        AxisymmetricField(r, zeta, surface, THICKNESS, stress),
        rays,
        LAW.half_phase(spectrum.wavelength_m),
        spectrum.weight,
        plane_amplitude(POLARISER, len(spectrum.wavelength_m)),
        SLICES,
        threads=threads,
    )


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
    u, v = slices()
    packed = u.astype(np.float32), v.astype(np.float32)
    bands = LAW.half_phase(WAVELENGTHS), plane_amplitude(POLARISER, 3)
    plain, fused = matrices(u, v), march_spectral(*packed, *bands)
    worst = abs(plain - fused).max()
    assert worst < 1e-4, worst
    order = max(LAW.coefficient_per_pa / WAVELENGTHS) * np.hypot(u.sum(0), v.sum(0)).max()
    cores = len(os.sched_getaffinity(0))
    print(
        f"{SIDE_PX} x {SIDE_PX} px, {SLICES} slices, 3 wavelengths, to {order:.1f} fringes; "
        f"load {os.getloadavg()[0]:.1f} on {cores} cores"
    )
    print(f"largest difference of the light {worst:.1e} (1e-4 is allowed), mean light {plain.mean():.2f}")
    theirs: list[float] = []
    ours: dict[int, list[float]] = {n: [] for n in sorted({1, 2, cores}) if n <= cores}
    for _ in range(ROUNDS):  # taken in turn, so that both see the machine's other work
        theirs.append(timed(lambda: matrices(u, v), 1))
        for n, times in ours.items():
            times.append(timed(lambda n=n: march_spectral(*packed, *bands, threads=n), 9))  # type: ignore[misc]
    row("numpy, complex 2 x 2 matrices", theirs)
    for n, times in ours.items():
        row(f"fused, {n} thread{'s' * (n > 1)}", times, [a / b for a, b in zip(theirs, times, strict=True)])
    half = packed[0][SLICES // 2 :].copy(), packed[1][SLICES // 2 :].copy()
    row(
        "  half the slices, even ray, 1 thread",
        [timed(lambda: march_spectral(*half, *bands, even=True, threads=1), 9) for _ in range(ROUNDS)],
    )
    print("(40 times is wanted)\n")

    full_image(1)
    print(f"exact path of {WIDE} x {HIGH} px, sampling a table, {SLICES} slices, 31 bands, to linear RGB")
    for n in ours:
        row(f"  {n} thread{'s' * (n > 1)}", [timed(lambda n=n: full_image(n), 1) for _ in range(3)])  # type: ignore[misc]
    print(f"  peak memory beyond that before: {peak_mb(lambda: full_image(cores)):.0f} MB")


if __name__ == "__main__":
    main()
