"""Pictures of softness: two objects as each cue tells them, and what a display renders of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.core import new_file
from palpate.mechanics.half_space.hertz import Body
from palpate.reports.calibration_figures import ACCENT, BAD, BAND, COLOURS, INK, STYLE, drawn
from palpate.softness import Mode, Rendered, RenderingLaw, SoftObject
from palpate.softness.display_bench_test import HALF_POWER, BenchTest, PressureResponse
from palpate.softness.rendering_law import LIMIT_WORDS
from palpate.softness.rendering_simulation import Rendering

MM, MM2, KPA = 1e3, 1e6, 1e-3


def write_pair_figure(objects: Mapping[str, Body], finger: Body, greatest_n: float, path: Path) -> None:
    """Draw force over displacement and force over area of objects under one finger.

    Args:
        objects: by their names in the legend.
        greatest_n: end of the curves [N].
    """
    _save(lambda: _pair(objects, finger, greatest_n), path)


def pair_panels(objects: Mapping[str, Body], finger: Body, greatest_n: float) -> str:
    """Draw `write_pair_figure` as a PNG in a data address."""
    with mpl.rc_context(STYLE):
        return drawn(_pair(objects, finger, greatest_n))


def specimen_panels(objects: Sequence[SoftObject]) -> str:
    """Draw force over displacement and over area of objects, as a PNG in a data address."""
    with mpl.rc_context(STYLE):
        figure, arm, skin = _two_cues()
        for one, color in zip(objects, COLOURS, strict=False):
            arm.plot(MM * one.displacement.x, one.displacement.force_n, color=color, label=one.name)
            skin.plot(MM2 * one.area.x, one.area.force_n, color=color)
        arm.legend(frameon=False, fontsize=8)
        return drawn(figure)


def _pair(objects: Mapping[str, Body], finger: Body, greatest_n: float) -> Figure:
    force = np.linspace(0.0, greatest_n, 200)
    figure, arm, skin = _two_cues()
    for (name, body), color, style in zip(
        objects.items(), (ACCENT, INK, BAD), ("-", "--", ":"), strict=False
    ):
        both = body.against(finger)
        arm.plot(MM * both.approach_m(force), force, style, color=color, label=name)
        skin.plot(MM2 * both.area_m2(force), force, style, color=color, label=name)
    arm.legend(frameon=False)
    return figure


def _two_cues() -> tuple[Figure, Axes, Axes]:
    figure = Figure(figsize=(8.4, 3.6), layout="constrained")
    arm, skin = figure.subplots(1, 2, sharey=True)
    _axes(arm, "displacement [mm]", "force [N]", "to the arm (kinesthetic)")
    _axes(skin, "contact area [mm²]", "", "to the skin (cutaneous)")
    return figure, arm, skin


def _save(draw: Callable[[], Figure], path: Path) -> None:
    with mpl.rc_context(STYLE):
        figure = draw()
        with new_file(path) as building:
            figure.savefig(building, format="png", dpi=160)


def write_specimen_figure(classes: Mapping[str, Sequence[SoftObject]], greatest_n: float, path: Path) -> None:
    """Draw force over displacement and force over area of specimens, a row for each class.

    Args:
        greatest_n: end of the curves [N].
    """
    force = greatest_n * np.linspace(0.0, 1.0, 200) ** 2
    shades = mpl.colormaps["viridis"](np.linspace(0.0, 0.88, max(len(each) for each in classes.values())))
    widths = np.linspace(3.6, 1.1, len(shades))  # where curves lie on each other, all are seen
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.8, 0.6 + 2.7 * len(classes)), layout="constrained")
        rows = figure.subplots(len(classes), 2, sharey=True, sharex="col", squeeze=False)
        for (arm, skin), (kind, objects) in zip(rows, classes.items(), strict=True):
            for soft, shade, width in zip(objects, shades, widths, strict=False):
                label = soft.name.removeprefix(f"{kind} ")
                way, area = MM * soft.displacement.at_force(force), MM2 * soft.area.at_force(force)
                arm.plot(way, force, color=shade, lw=width, label=label)
                skin.plot(area, force, color=shade, lw=width)
            arm.legend(frameon=False, fontsize=8)
            last = kind == list(classes)[-1]
            _axes(arm, "displacement [mm]" if last else "", "force [N]", f"{kind}, to the arm")
            _axes(skin, "contact area [mm²]" if last else "", "", f"{kind}, to the skin")
        with new_file(path) as building:
            figure.savefig(building, format="png", dpi=160)


def write_envelope_figure(law: RenderingLaw, path: Path) -> None:
    """Draw an object's two cues, the devices' rendering of them, and the required pressure and travel."""
    state, soft = law.envelope(), law.object
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 6.4), layout="constrained")
        (skin, arm), (pressure, way) = figure.subplots(2, 2)
        area = MM2 * state.area_m2
        end = float(area[-1])
        shown = MM2 * soft.area.x <= end
        skin.plot(
            MM2 * soft.area.x[shown], soft.area.force_n[shown], color=INK, lw=3, alpha=0.25, label="object"
        )
        arm.plot(
            MM * soft.displacement.x, soft.displacement.force_n, color=INK, lw=3, alpha=0.25, label="object"
        )
        skin.plot(area, state.force_n, color=ACCENT, label="display")
        arm.plot(MM * state.displacement_m, state.force_n, color=ACCENT, label="display and arm")
        pressure.plot(area, KPA * state.pressure_pa, color=ACCENT)
        way.plot(area, MM * state.pushed_m, color=INK, label="display")
        way.plot(area, MM * state.arm_m, color=ACCENT, label="arm")
        for axes in (skin, pressure, way):
            _shade(axes, state, labelled=axes is pressure)
            axes.set_xlim(0, end)
        arm.set_xlim(0, max(1.2 * MM * float(state.displacement_m.max()), 0.1))
        arm.set_ylim(skin.get_ylim())
        _axes(skin, "contact area [mm²]", "force [N]", "to the skin")
        _axes(arm, "displacement of the finger [mm]", "force [N]", "to the arm")
        _axes(pressure, "contact area [mm²]", "gauge pressure [kPa]", "chamber")
        _axes(way, "contact area [mm²]", "displacement [mm]", "ways")
        for axes in (skin, arm, way):
            axes.legend(frameon=False)
        if not state.rendered.all():
            pressure.legend(frameon=False)
        share = f"{state.rendered.mean():.0%}"
        figure.suptitle(
            f"{soft.name}, {law.mode.value}: {share} of the display's way is rendered as it is",
            fontsize=11, fontweight="bold", color=INK,
        )  # fmt: skip
        with new_file(path) as building:
            figure.savefig(building, format="png", dpi=160)


def _shade(axes: Axes, state: Rendered, *, labelled: bool) -> None:
    for k, (limit, words) in enumerate(LIMIT_WORDS.items()):
        for low, high in spans(state.limit == limit):
            label = words if labelled else None
            axes.axvspan(
                MM2 * float(state.area_m2[low]), MM2 * float(state.area_m2[high]), label=label,
                color=BAND if k == 0 else BAD, alpha=0.5 if k == 0 else 0.12 + 0.06 * k, lw=0,
            )  # fmt: skip
            labelled = False if label else labelled


def spans(where: np.ndarray) -> list[tuple[int, int]]:
    """Return first and last of each stretch of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], where, [False])).astype(int)))
    return [(int(low), int(high) - 1) for low, high in zip(edges[::2], edges[1::2], strict=True)]


def _axes(axes: Axes, x: str, y: str, title: str) -> None:
    axes.set(xlabel=x, ylabel=y)
    axes.set_title(title, loc="left", fontsize=10)


def write_tracking_figure(felt: Rendering, path: Path) -> None:
    """Draw rendered and object cues, force over time, pressure, and travel."""
    _save(lambda: _tracking(felt), path)


def tracking_panels(felt: Rendering) -> str:
    """Draw `write_tracking_figure` as a PNG in a data address."""
    with mpl.rc_context(STYLE):
        return drawn(_tracking(felt))


def _tracking(felt: Rendering) -> Figure:
    soft, on = felt.law.object, felt.scored
    plate = felt.law.mode is Mode.KINESTHETIC
    figure = Figure(figsize=(9.6, 6.4), layout="constrained")
    (arm, skin), (force, ways) = figure.subplots(2, 2)
    for axes, curve, x, factor in (
        (arm, soft.displacement, felt.displacement_m, MM), (skin, soft.area, felt.area_m2, MM2),
    ):  # fmt: skip
        end = np.interp(1.1 * felt.peak_n, curve.force_n, curve.x)
        shown = np.linspace(curve.x[0], max(float(end), float(x[on].max())), 400)
        axes.plot(factor * shown, np.interp(shown, curve.x, curve.force_n), color=INK, lw=5, alpha=0.2,
                  label="object")  # fmt: skip
        axes.plot(factor * x[on], felt.force_n[on], color=ACCENT, lw=0.9, label="felt")
        axes.legend(frameon=False)
    force.plot(felt.time_s, felt.force_n, color=ACCENT)
    ways.plot(felt.time_s, MM * felt.pushed_m, color=INK, label="display")
    ways.plot(felt.time_s, MM * felt.arm_m, color=ACCENT, label="arm")
    ways.plot(felt.time_s, MM * felt.displacement_m, color=BAD, label="both")
    ways.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    _axes(arm, "displacement of the finger [mm]", "force [N]", "to the arm")
    _axes(skin, "contact area [mm²]", "force [N]", "to the skin" + (": a rigid plate" if plate else ""))
    _axes(force, "time [s]", "force [N]", "presses")
    _axes(ways, "time [s]", "displacement [mm]", "ways")
    figure.suptitle(
        f"{soft.name}, {felt.law.mode.value}, presses at {felt.frequency_hz:g} Hz: simulated",
        fontsize=11, fontweight="bold", color=INK,
    )  # fmt: skip
    return figure


def write_bench_test_figure(test: BenchTest, path: Path) -> None:
    """Draw a bench test: force over indentation at each pressure, the law as lines, and residuals."""
    _save(lambda: _bench_test(test), path)


def bench_test_panels(test: BenchTest) -> str:
    """Draw `write_bench_test_figure` as a PNG in a data address."""
    with mpl.rc_context(STYLE):
        return drawn(_bench_test(test))


def _bench_test(test: BenchTest) -> Figure:
    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    force, off = figure.subplots(1, 2)
    told, direction = test.column("told_pa"), test.column("direction")
    way, measured, pressure = (test.column(name) for name in ("pushed_m", "force_n", "pressure_pa"))
    levels = np.unique(told)
    shades = mpl.colormaps["viridis"](np.linspace(0.0, 0.88, len(levels)))
    drawn_m = np.linspace(0.0, test.shape.height_m, 200)
    for level, shade in zip(levels, shades, strict=True):
        law = pressure[told == level].mean() * test.shape.area_m2(drawn_m) + test.shape.sleeve_n_m * drawn_m
        force.plot(MM * drawn_m, law, color=shade, lw=1.2, label=f"{KPA * level:g} kPa")
        for turn, filled in ((1, shade), (-1, "none")):
            on = (told == level) & (direction == turn)
            force.scatter(MM * way[on], measured[on], s=22, edgecolors=[shade], facecolors=[filled])
            off.scatter(MM * way[on], 1e3 * test.off_n[on], s=22, edgecolors=[shade], facecolors=[filled])
    off.axhline(0.0, color=INK, lw=0.8)
    force.legend(frameon=False, fontsize=8)
    _axes(force, "indentation [mm]", "force [N]", "points as measured, lines P = p A(s) + k s")
    _axes(off, "indentation [mm]", "measured less law [mN]", "filled: pressing, open: on the way back")
    share = f"{100 * test.rms_n / test.peak_n:.2g} % of the peak"
    figure.suptitle(
        f"bench test: law off by {test.rms_n * 1e3:.2g} mN, {share} (RMS)",
        fontsize=11, fontweight="bold", color=INK,
    )  # fmt: skip
    return figure


def bandwidth_panels(answers: Mapping[str, PressureResponse]) -> str:
    """Draw gain and phase of pressures over frequency, as a PNG in a data address."""
    with mpl.rc_context(STYLE):
        return drawn(_bandwidths(answers))


def _bandwidths(answers: Mapping[str, PressureResponse]) -> Figure:
    figure = Figure(figsize=(9.6, 3.9), layout="constrained")
    gain, phase = figure.subplots(1, 2)
    amplitudes = sorted({one.amplitude_pa for one in answers.values()})
    servos = list(dict.fromkeys(name.rpartition(",")[0] for name in answers))
    for name, one in answers.items():
        color = COLOURS[servos.index(name.rpartition(",")[0])]
        style = ("--", "-")[one.amplitude_pa == amplitudes[-1]]
        gain.loglog(one.frequency_hz, one.gain, style, color=color)
        phase.semilogx(one.frequency_hz, np.degrees(one.phase_rad), style, color=color, label=name)
    gain.axhline(HALF_POWER, color=INK, lw=0.6)
    gain.set_ylim(0.1, 4.0)
    phase.set_ylim(-270.0, 20.0)
    phase.legend(frameon=False, fontsize=8, loc="lower left")
    _axes(gain, "frequency [Hz]", "gain", "pressure measured over told; line: -3 dB")
    _axes(phase, "frequency [Hz]", "phase [degrees]", "")
    return figure
